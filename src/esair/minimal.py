"""ESAIR MIN: sensors, reactions and actuators on a microcontroller.

Nothing but the language: this one file runs on CPython and on MicroPython, and imports
nothing else of esair. The same reactions, and the same plain sensors and actuators, run
in a `esair.Robot` (STD) too, and decide the same on the same readings::

    from esair.minimal import Actuator, Loop, Reaction, Sensor, reads, writes

    class Avoid(Reaction):
        sonar = reads(float, max_age=0.5)
        wheels = writes(tuple, priority=10)

        def react(self, sonar):
            return (0.0, 1.2) if sonar < 0.4 else None

    loop = Loop(reactions=[Avoid()], sensors=[Sonar()], actuators=[Wheels()], rate=50)
    loop.run()

Everything is wired when the `Loop` is made. Each step reads the sensors, then lets each
reaction decide, in the order given; a command leaves at once if nobody of the same or a
higher priority holds the actuator. No memory is allocated in the steady state.
"""

# ruff: noqa: A002, B905, PERF401, RUF005, SIM110, UP031, UP037
# MicroPython knows less of the language: what is newer is not used here.

try:
    import utime as time  # type: ignore[import-not-found]  # MicroPython's older name
except ImportError:
    import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from typing import Any

_INFINITE = float("inf")
_MOST = 3.4e38
"""No finite number beyond it takes the short way of checking."""

# Moments are whole numbers that may wrap: elapsed = (later - earlier) & _MASK.
if hasattr(time, "ticks_us"):
    _SECOND = 1000000
    _MASK = time.ticks_add(0, -1)
    _ticks = time.ticks_us

    def _sleep(ticks: int) -> None:
        time.sleep_ms(ticks // 1000)
        time.sleep_us(ticks % 1000)

else:
    _SECOND = 1000000000
    _MASK = (1 << 62) - 1
    _ticks = time.monotonic_ns

    def _sleep(ticks: int) -> None:
        time.sleep(ticks / _SECOND)


class _Declared:
    """What a reaction declares to use, as a class attribute."""

    made = 0
    """How many there are: the order of the attributes, which some classes forget."""

    def __init__(self, type: "Any", name: "str | None", configure: bool) -> None:
        _Declared.made = self.made = _Declared.made + 1
        self.type = type
        self.name = name
        self.configure = configure


class Reads(_Declared):
    """A reaction reads a sensor; made by `reads`."""

    def __init__(
        self,
        type: "Any" = None,
        name: "str | None" = None,
        max_age: "float | None" = None,
        configure: bool = False,
    ) -> None:
        _Declared.__init__(self, type, name, configure)
        self.max_age = max_age


class Writes(_Declared):
    """A reaction writes an actuator; made by `writes`."""

    def __init__(
        self,
        type: "Any" = None,
        name: "str | None" = None,
        priority: int = 0,
        hold: "float | None" = None,
        configure: bool = False,
    ) -> None:
        _Declared.__init__(self, type, name, configure)
        self.priority = priority
        self.hold = hold


reads = Reads
writes = Writes


class _Part:
    """Something with a name."""

    name: str = ""

    def __init__(self, name: "str | None" = None) -> None:
        if name:
            self.name = name


class _Device(_Part):
    """A piece of hardware: a sensor or an actuator."""

    def open(self) -> None:
        """Make the device ready. What it raises ends the program, at its start."""

    def close(self) -> None:
        """Let the device go."""


class Sensor(_Device):
    """A device that gives values.

    Args:
        name: Its name; the class name in snake case unless given.
    """

    rate: "float | None" = None
    """How often it is read, in Hz; None for every step of the loop."""

    def read(self) -> "Any":
        """Return one value. Raise, whatever it is, if there is none."""
        raise NotImplementedError


class Actuator(_Device):
    """A device that takes commands. It has to declare ``safe``.

    Args:
        name: Its name; the class name in snake case unless given.
    """

    command_timeout: float = 0.2
    """After this many seconds without a write the device gets ``safe``; never 0."""

    limits: "object" = None
    """Least and greatest value: ``(low, high)``, or those of each field by its name."""

    clamp: bool = False
    """Move a number to the nearest limit, instead of refusing it."""

    def write(self, command: "Any") -> "Any":
        """Send a command to the device; it is checked already."""
        raise NotImplementedError


class Reaction(_Part):
    """One small decision each step, on the newest readings.

    It runs in each step with a new reading of one of its sensors, or at a fixed
    ``rate``. While a reading is missing or too old it is parked, and what it moved is
    made safe.

    Args:
        name: Its name; the class name in snake case unless given.
    """

    rate: "float | None" = None
    """How often it runs, in Hz; None to run on every new reading."""

    def react(self, *args: "Any", **readings: "Any") -> "Any":
        """Decide on the newest readings, which come by the names of their attributes.

        Returns:
            A command; several as ``{"left": ..., "right": ...}``; or None for "no
            opinion", which gives the actuator back at once.
        """
        raise NotImplementedError


class _Paced:
    """Something that has its turn in each step, or less often."""

    def set_pace(self, rate: "float | None", every: int) -> bool:
        """Have a turn at a rate (Hz) of a loop; tells whether turns are left out."""
        self.pace = every if rate is None else int(rate * 1000 + 0.5)
        self.phase = every - self.pace
        self.due = True
        return self.phase > 0


class _Input(_Paced):
    """A sensor, and its newest reading."""

    def __init__(self, sensor: "Any") -> None:
        self.name = sensor.name
        self.read = sensor.read
        self.forget()

    def forget(self) -> None:
        """Have no reading."""
        self.value: "Any" = None
        self.time = -1
        self.failed = 0
        """When it last gave no reading; after `time`: the reading is no longer news."""


class _Output:
    """An actuator, and whose will it does."""

    def __init__(self, actuator: "Any", rate: float) -> None:
        self.name = actuator.name
        self.write = actuator.write
        self.safe = actuator.safe
        self.kind = type(actuator.safe)
        self.timeout = _steps(actuator.command_timeout, rate)
        self.clamp = actuator.clamp
        limits = actuator.limits or ()
        self.least, self.most = -_MOST, _MOST
        if isinstance(limits, dict):
            self.limits = tuple([(key,) + tuple(limits[key]) for key in limits])
        else:
            self.limits = (("",) + tuple(limits),) if limits else ()
            if limits:
                self.least, self.most = limits
        self.number = self.kind if self.kind in (int, float) else None
        """The type of commands for which `least` and `most` are the whole check."""
        self.last: "Any" = None
        """A command that was checked, and cannot change."""
        self.bad = False
        """Whether it has not taken its safe command."""
        self.holder: "Any" = None
        self.writer: "Any" = None
        self.steady: "Any" = None
        """The port that holds it and has written last: its next write has no questions."""
        self.written = 0


class _Port:
    """What one reaction may do with one actuator."""

    def __init__(
        self, key: str, owner: "Any", output: "Any", need: "Any", rate: float
    ) -> None:
        self.key = key
        self.owner = owner
        self.output = output
        self.priority = need.priority
        self.hold = _steps(need.hold, rate) if need.hold else output.timeout


class _Task(_Paced):
    """A reaction with its wiring."""

    def __init__(
        self, reaction: "Any", inputs: "Any", outputs: "Any", rate: float
    ) -> None:
        self.name = reaction.name
        self.react = reaction.react
        self.timed = reaction.rate is not None
        names, terms, ports = [], [], []
        for key, need in declared(reaction):
            if hasattr(need, "max_age"):
                names.append(key)
                age = need.max_age
                terms.append((inputs[need.name or key], age and _steps(age, rate)))
            else:
                ports.append(_Port(key, self, outputs[need.name or key], need, rate))
        self.names = names
        self.inputs = tuple(terms)
        self.ports = tuple(ports)
        self.port = ports[0] if len(ports) == 1 else None
        self.first: "Any" = terms[0][0] if len(terms) == 1 else _Never
        # By name, as the order of the parameters is not known on a board. The text is
        # made of names of attributes, and evaluated once.
        self.call = eval(
            "lambda r%s:lambda:r(%s)"
            % (
                "".join([",a%d" % i for i in range(len(names))]),
                ",".join(["%s=a%d.value" % (k, i) for i, k in enumerate(names)]),
            )
        )(self.react, *[each[0] for each in terms])


class _Never:
    """In place of the only input of a reaction that has several, or none, or a pace."""

    time = -1
    value = None


def _steps(seconds: float, rate: float) -> int:
    """The number of steps after which a duration has passed."""
    count = int(seconds * rate)
    return count if count >= seconds * rate - 1e-4 else count + 1


def declared(reaction: "Any") -> "list[tuple[str, Any]]":
    """Return what a reaction declares to use, by attribute, in the order written."""
    needs = getattr(reaction, "needs", None)
    if isinstance(needs, dict):  # a reaction of STD
        return list(needs.items())
    found = []
    for key in dir(reaction):
        need = getattr(type(reaction), key, None)
        if isinstance(need, _Declared):
            found.append((key, need))
    found.sort(key=lambda each: each[1].made)
    return found


class Loop:
    """Reads sensors, lets reactions decide, and writes actuators, at a fixed rate.

    Args:
        reactions: In the order in which they decide.
        sensors: Whatever has a plain ``read``.
        actuators: Whatever has a plain ``write``, and a ``safe`` command.
        rate: Steps per second.

    Attributes:
        steps: How many steps were made.
        late: How many steps were left out because they came too late.
        refused: How many commands met an actuator that somebody else held.
        faults: How many times a sensor, reaction or actuator raised an error, or a
            command was no good (wrong type, not finite, outside the limits).
        fault: The name of the component with the last fault, and the error.

    Raises:
        ValueError: The parts do not fit together; every mistake is named.
    """

    def __init__(
        self,
        reactions: "Iterable[Any]" = (),
        sensors: "Iterable[Any]" = (),
        actuators: "Iterable[Any]" = (),
        rate: float = 50,
    ) -> None:
        reactions, sensors = list(reactions), list(sensors)
        actuators = list(actuators)
        for part in reactions + sensors + actuators:
            if not part.name:
                part.name = _snake_case(type(part).__name__)
        if __debug__:
            found = mistakes(reactions, sensors, actuators, rate)
            if found:
                raise ValueError("; ".join(found))
        self.steps = self.late = self.refused = self.faults = 0
        self.fault: "Any" = None
        self._every = int(rate * 1000 + 0.5)
        self._running = False
        self._alarm = 0
        self._devices = sensors + actuators
        self._outputs = tuple([_Output(each, rate) for each in actuators])
        nodes = [_Input(each) for each in sensors]
        inputs = {each.name: each for each in nodes}
        outputs = {each.name: each for each in self._outputs}
        tasks = [_Task(each, inputs, outputs, rate) for each in reactions]
        paced: "list[Any]" = []
        for node, part in zip(nodes + tasks, sensors + reactions):  # type: ignore[operator]
            if node.set_pace(part.rate, self._every):
                paced.append(node)
        for task in tasks:
            if task in paced:
                task.first = _Never
        self._paced = tuple(paced)
        self._inputs = tuple([each for each in nodes if each not in paced])
        self._slow = tuple([each for each in nodes if each in paced])
        self._tasks = tuple(tasks)
        self.step = _fused(self)  # type: ignore[method-assign]

    def run(
        self, steps: "int | None" = None, feed: "Callable[[], Any] | None" = None
    ) -> None:
        """Open the devices and run; every exit ends with each actuator's safe command.

        Args:
            steps: How many steps; None for ever.
            feed: Called after each step: the hook for a hardware watchdog.
        """
        try:
            self.open()
            self._run(steps, feed)
        finally:
            self.close()

    def _run(self, steps: "Any", feed: "Any") -> None:
        period, rest = divmod(_SECOND * 1000, self._every)
        due = _ticks()
        debt = 0
        while steps is None or steps > 0:
            self.step()
            if feed is not None:
                feed()
            if steps is not None:
                steps -= 1
            debt += rest  # the part of a tick that each period is longer
            due = (due + period + debt // self._every) & _MASK
            debt %= self._every
            left = (due - _ticks()) & _MASK
            if left > _MASK >> 1:  # it is late already
                skipped = ((-left) & _MASK) // period
                self.late += skipped
                due = (due + skipped * period) & _MASK
            elif steps != 0:
                _sleep(left)

    def open(self) -> None:
        """Open every device, and give each actuator its safe command.

        `run` does this, and the first `step`.
        """
        self._running = True
        for source in self._inputs + self._slow:
            source.forget()
        for each in self._devices:
            if _is_plain(each, "open"):
                each.open()
        for output in self._outputs:
            self._make_safe(output)

    def close(self) -> None:
        """Give each actuator its safe command, three tries each, and close all."""
        self._running = False
        self._alarm = 0
        stop = None
        for output in self._outputs:
            for _ in range(3):
                try:
                    self._make_safe(output)
                    if not output.bad:
                        break
                except BaseException as error:  # Ctrl-C: the safe command first
                    stop = error
        for each in self._devices:
            try:
                if _is_plain(each, "close"):
                    each.close()
            except Exception as error:
                self._note(each, error)
            except BaseException as error:
                stop = error
        if stop is not None:
            raise stop

    def step(self) -> None:
        """Make one step, for tests and for boards with a loop of their own.

        Time is counted in periods: such a loop adds to `late` the periods that it
        missed. It calls `close` at its end.
        """
        now = self.steps = self.steps + 1
        now += self.late
        if now >= self._alarm:
            self._look(now)
        for source in self._inputs:
            try:
                source.value = source.read()
                source.time = now
            except Exception as error:
                self._no_reading(source, now, error)
        if self._paced:
            self._turn(now)
        command = None
        for task in self._tasks:
            source = task.first
            try:
                if source.time == now:
                    command = task.react(source.value)
                elif self._may_run(task, now):
                    command = task.call()
                else:
                    continue
            except Exception as error:
                self._crashed(task, error)
                continue
            port = task.port
            if port is None:
                self._write_all(task, command, now)
                continue
            output = port.output
            if command is None:
                if output.holder is port:
                    output.holder = output.steady = None
            elif output.steady is port and (
                command is output.last
                or (
                    command.__class__ is output.number
                    and output.least <= command <= output.most
                )
            ):
                # What mostly happens: the holder goes on. All else is in _write.
                output.written = now
                try:
                    output.write(command)
                except Exception as error:
                    self._failed(output, error)
            elif command.__class__ is dict:
                self._write_all(task, command, now)
            else:
                self._write(port, command, now)

    # Sensors.

    def _turn(self, now: int) -> None:
        """Find out who has its turn in this step, and read those sensors."""
        for node in self._paced:
            node.phase += node.pace
            node.due = node.phase >= self._every
            if node.due:
                node.phase -= self._every
        for source in self._slow:
            if source.due:
                try:
                    source.value = source.read()
                    source.time = now
                except Exception as error:
                    self._no_reading(source, now, error)

    def _no_reading(self, source: "Any", now: int, error: BaseException) -> None:
        source.failed = now
        self._note(source, error)

    def _may_run(self, task: "Any", now: int) -> bool:
        """Tell whether a reaction has its turn; park it if a reading is too old."""
        if not task.due:
            return False
        news = task.timed
        for source, max_age in task.inputs:
            age = now - source.time
            if age == 0:
                news = True
            elif (
                source.time < 0 or age >= max_age
                if max_age
                else source.failed > source.time
            ):
                self._drop(task)
                return False
        return bool(news)

    # Actuators.

    def _write_all(self, task: "Any", command: "Any", now: int) -> None:
        port = task.port
        if port is not None and port.key not in command:
            self._write(port, command, now)  # its commands are dictionaries
            return
        if command is not None:
            known = [each.key for each in task.ports]
            if type(command) is not dict or [k for k in command if k not in known]:
                self._note(task, ValueError("expected commands for %s" % known))
                self._drop(task)
                return
        for port in task.ports:
            one = None if command is None else command.get(port.key)
            if one is not None:
                self._write(port, one, now)
            elif port.output.holder is port:
                port.output.holder = port.output.steady = None

    def _write(self, port: "Any", command: "Any", now: int) -> None:
        """Send a command, unless somebody else holds the actuator or it is no good."""
        output = port.output
        holder = output.holder
        if (
            holder is not port
            and holder is not None
            and port.priority <= holder.priority
            and now - output.written < holder.hold
            and holder.owner is not port.owner
        ):
            self.refused += 1
            return
        if output.bad:
            return
        if command is not output.last:
            try:
                command = _checked(output, command)
            except Exception as error:
                self._note(output, error)
                return
        output.holder = output.writer = output.steady = port
        output.written = now
        self._alarm = min(self._alarm, now + output.timeout)
        try:
            output.write(command)
        except Exception as error:
            self._failed(output, error)

    def _failed(self, output: "Any", error: BaseException) -> None:
        self._note(output, error)
        self._make_safe(output)

    def _look(self, now: int) -> None:
        """Make safe whatever nobody has written for its command timeout."""
        if not self._running:
            self.open()
        alarm = now + 1000000
        for output in self._outputs:
            if output.bad:
                self._make_safe(output)
                if output.bad:
                    alarm = 0
            elif output.writer is not None and now - output.written >= output.timeout:
                holder = output.holder
                self._make_safe(output)
                if holder is not None and now - output.written < holder.hold:
                    output.holder = holder  # a longer hold keeps lower priorities away
            if output.writer is not None:
                alarm = min(alarm, output.written + output.timeout)
        self._alarm = alarm

    def _crashed(self, task: "Any", error: BaseException) -> None:
        self._note(task, error)
        self._drop(task)

    def _decided(self, task: "Any", command: "Any", now: int) -> None:
        """Send what a reaction has decided, by the long way."""
        if task.port is None or command.__class__ is dict:
            self._write_all(task, command, now)
        else:
            self._write(task.port, command, now)

    def _drop(self, task: "Any") -> None:
        """Give back what a reaction holds, safe if it does the reaction's will."""
        for port in task.ports:
            output = port.output
            if output.writer is port:
                self._make_safe(output)
            elif output.holder is port:
                output.holder = None

    def _make_safe(self, output: "Any") -> None:
        """Send the safe command; nobody holds the actuator afterwards."""
        output.holder = output.writer = output.steady = None
        try:
            output.write(output.safe)
            output.bad = False
        except Exception as error:
            output.bad = True
            self._alarm = 0  # tried again at each step; no other command goes before it
            self._note(output, error)

    def _note(self, part: "Any", error: BaseException) -> None:
        self.faults += 1
        self.fault = (part.name, error)


def _fused(loop: "Any") -> "Any":
    """Return the step of a loop as one function without inner loops and look-ups.

    It does what `Loop.step` does, three times as fast: its text is made for the wiring.
    """
    given = {"L": loop, "N": _Never}
    text = " now=L.steps=L.steps+1\n now+=L.late\n if now>=L._alarm:L._look(now)\n"
    fresh = {}
    for i, source in enumerate(loop._inputs):
        given["s%d" % i] = source
        given["r%d" % i] = source.read
        fresh[source] = "v%d" % i
        text += (
            " try:\n  s#.value=v#=r#()\n  s#.time=now\n"
            " except Exception as e:\n  v#=N\n  L._no_reading(s#,now,e)\n"
        ).replace("#", str(i))
    if loop._paced:
        text += " L._turn(now)\n"
    for i, task in enumerate(loop._tasks):
        given["t%d" % i] = task
        given["d%d" % i] = task.react
        values = [fresh.get(each[0]) for each in task.inputs]
        text += " try:\n  "
        if values and None not in values and task not in loop._paced:
            text += "if %s:c=d#(%s)\n  el" % (
                " and ".join([each + " is not N" for each in values]),
                ",".join(["%s=%s" % pair for pair in zip(task.names, values)])
                if len(values) > 1
                else values[0],
            )
        text += (
            "if L._may_run(t#,now):c=t#.call()\n  else:c=N\n"
            " except Exception as e:\n  c=N\n  L._crashed(t#,e)\n"
        )
        if task.port is not None:
            given["p%d" % i] = task.port
            given["o%d" % i] = output = task.port.output
            given["w%d" % i] = output.write
            text += (
                " if c is None:\n  if o#.holder is p#:o#.holder=o#.steady=None\n"
                " elif o#.steady is p# and(c is o#.last"
                " or c.__class__ is o#.number and o#.least<=c<=o#.most):\n"
                "  o#.written=now\n  try:w#(c)\n"
                "  except Exception as e:L._failed(o#,e)\n"
                " el"
            )
        else:
            text += " "
        text += "if c is not N:L._decided(t#,c,now)\n"
        text = text.replace("#", str(i))
    scope: "Any" = {}
    exec(
        "def make(%s):\n def step():\n %s return step"
        % (",".join(given), text.replace("\n ", "\n  ")),
        scope,
    )
    return scope["make"](**given)


def _is_plain(part: "Any", name: str) -> bool:
    """Tell whether a part has a method that can be called without an event loop."""
    method = getattr(part, name, None)
    code = getattr(method, "__code__", None)
    return method is not None and not getattr(code, "co_flags", 0) & 0x380


def _checked(output: "Any", command: "Any") -> "Any":
    """Return the command that may be sent: its type, finite, within the limits."""
    kind = output.kind
    if type(command) is not kind:
        if kind is float and type(command) is int:
            command = float(command)
        elif not isinstance(command, kind) or (kind is int and type(command) is bool):
            raise ValueError("wrong type", command)
    if not _finite(command, 8):
        raise ValueError("not finite", command)
    for field, low, high in output.limits:
        value = command
        if field:
            value = command[field] if kind is dict else getattr(command, field)
        if not low <= value <= high:
            if not output.clamp:
                raise ValueError("outside the limits", command)
            command = kind(low if value < low else high)
    if isinstance(command, (int, float, tuple)) and _flat(command):
        output.last = command  # it cannot change: checked once and for all
    return command


def _flat(command: "Any") -> bool:
    if isinstance(command, tuple):
        for each in command:
            if not isinstance(each, (int, float)):
                return False
    return True


def _finite(value: "Any", depth: int) -> bool:
    if isinstance(value, (int, float)):
        return -_INFINITE < value < _INFINITE
    if isinstance(value, (str, bytes)) or value is None:
        return True
    parts: "Any"
    if isinstance(value, dict):
        parts = list(value.keys()) + list(value.values())
    elif isinstance(value, (tuple, list)):
        parts = value
    else:
        parts = list(getattr(value, "__dict__", {}).values())
    for each in parts:
        if depth == 0 or not _finite(each, depth - 1):
            return False
    return True


def _snake_case(name: str) -> str:
    found = ""
    for i, letter in enumerate(name):
        if letter.lower() != letter and i:  # an upper-case letter begins a word
            before, after = name[i - 1], name[i + 1 : i + 2]
            if before.lower() == before or after.upper() != after:
                found += "_"
        found += letter.lower()
    return found.replace("__", "_").strip("_")


if __debug__:

    def mistakes(
        reactions: "list[Any]",
        sensors: "list[Any]",
        actuators: "list[Any]",
        rate: float,
    ) -> "list[str]":
        """Return what is wrong with the parts of a loop, and how they fit together."""
        found = []
        if not _good(rate, 100000):
            return ["loop: rate: expected Hz > 0, not %r" % (rate,)]
        for kind, parts in (("reaction", reactions), ("device", sensors + actuators)):
            names = [part.name for part in parts]
            for name in names:
                if names.count(name) > 1:
                    found.append("%s: there are two %ss of this name" % (name, kind))
        for part in sensors + reactions:
            if part.rate is not None and not _good(part.rate, rate * 1.0001):
                found.append(
                    "%s: rate: expected Hz > 0, not above the %s of the loop, not %r"
                    % (part.name, rate, part.rate)
                )
        for part in sensors + actuators:
            for name in ("open", "close"):
                method = getattr(part, name, None)
                module = getattr(method, "__module__", None) or ""
                # Those of STD itself do nothing: they are left out, not refused.
                if method and not module.startswith("esair."):
                    found += _wrong_async(part, name)
        for part in sensors:
            found += _wrong_method(part, "read")
        for part in actuators:
            found += _wrong_method(part, "write") + _wrong_actuator(part, rate)
        for part in reactions:
            found += _wrong_method(part, "react")
            found += _wrong_reaction(part, sensors, actuators)
        return found

    def _good(number: "Any", most: float) -> bool:
        return isinstance(number, (int, float)) and 0 < number <= most

    def _seconds(name: str, number: "Any") -> "list[str]":
        most = (_MASK // 2) / _SECOND
        if _good(number, most):
            return []
        return ["%s: expected seconds > 0, at most %d, not %r" % (name, most, number)]

    def _wrong_method(part: "Any", name: str) -> "list[str]":
        method = getattr(part, name, None)
        for base in (Sensor, Actuator, Reaction):
            if getattr(type(part), name, None) is getattr(base, name, part):
                method = None
        if method is None:
            return ["%s: it must have a method %s" % (part.name, name)]
        return _wrong_async(part, name)

    def _wrong_async(part: "Any", name: str) -> "list[str]":
        if not _is_plain(part, name):
            return ["%s: %s: expected a plain method, not async" % (part.name, name)]
        return []

    def _wrong_actuator(part: "Any", rate: float) -> "list[str]":
        name = part.name
        if not hasattr(part, "safe"):
            return ["%s: safe: an actuator must declare its safe command" % name]
        found = _seconds(name + ": command_timeout", part.command_timeout)
        if not found and part.command_timeout < 1.0 / rate:
            found.append("%s: command_timeout: shorter than one step" % name)
        if getattr(part, "slew", None) is not None:
            found.append("%s: slew: only STD has it" % name)
        if part.clamp and isinstance(part.limits, dict):
            found.append("%s: clamp: only STD has it for fields" % name)
        if not found:
            try:
                _checked(_Output(part, rate), part.safe)
            except Exception as error:
                found.append("%s: safe or limits: %r" % (name, error))
        return found

    def _wrong_reaction(
        part: "Any", sensors: "list[Any]", actuators: "list[Any]"
    ) -> "list[str]":
        found = []
        inputs = []
        for key, need in declared(part):
            where = "%s: %s" % (part.name, key)
            is_input = hasattr(need, "max_age")
            if is_input:
                inputs.append(key)
            name = need.name or key
            known = [each.name for each in (sensors if is_input else actuators)]
            if name not in known:
                kind = "sensor" if is_input else "actuator"
                found.append(
                    "%s: there is no %s %r, only %s" % (where, kind, name, known)
                )
            if need.configure:
                found.append("%s: configure: only STD has it" % where)
            seconds = need.max_age if is_input else need.hold
            if seconds is not None:
                found += _seconds(where, seconds)
        if not inputs and part.rate is None:
            found.append("%s: rate: it reads nothing, so it needs one" % part.name)
        code: "Any" = getattr(part.react, "__code__", None)
        if hasattr(code, "co_varnames"):  # on a board nobody knows the parameters
            taken = code.co_varnames[1 : code.co_argcount]
            if sorted(taken) != sorted(inputs) or code.co_kwonlyargcount:
                found.append(
                    "%s: react: its parameters %s must be its readings %s"
                    % (part.name, list(taken), inputs)
                )
        return found
