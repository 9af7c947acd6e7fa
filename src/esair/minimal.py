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

# ruff: noqa: A002, B905, RUF005, UP031, UP037
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
        if __debug__:  # else a `Loop` does it
            _give_name(self)


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


class _Input:
    """A sensor, and its newest reading."""

    def __init__(self, sensor: "Any") -> None:
        self.name = sensor.name
        self.read = sensor.read
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
        self.timeout = _steps(actuator.command_timeout, rate)
        self.clamp = actuator.clamp
        limits = actuator.limits or {}
        if not isinstance(limits, dict):
            limits = {"": limits}
        self.limits = [(field,) + tuple(limits[field]) for field in limits]
        """Of each limited field: its name, or nothing, its least and greatest value."""
        self.number: "Any" = type(self.safe)
        """The type of commands for which `least` and `most` are the whole check."""
        if self.number not in (int, float):
            self.number = None
        self.least, self.most = self.limits[0][1:] if limits else (-_MOST, _MOST)
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

    owner: "Any" = None

    def __init__(self, key: str, output: "Any", need: "Any", rate: float) -> None:
        self.key = key
        self.output = output
        self.priority = need.priority
        self.hold = _steps(need.hold, rate) if need.hold else output.timeout


class _Task:
    """A reaction with its wiring: its inputs with their names and greatest ages."""

    def __init__(self, reaction: "Any", inputs: "Any", ports: "Any") -> None:
        self.name = reaction.name
        self.react = reaction.react
        self.timed = reaction.rate is not None
        self.inputs = inputs
        self.ports = ports
        for port in ports:
            port.owner = self


def _checked(output: "Any", command: "Any") -> "Any":
    """Return the command that may be sent: its type, finite, within the limits."""
    kind = type(output.safe)
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
    if isinstance(value, (str, bytes)):
        return True
    if isinstance(value, dict):
        value = list(value.keys()) + list(value.values())
    elif not isinstance(value, (tuple, list)):
        value = getattr(value, "__dict__", {}).values()
    return all(depth and _finite(each, depth - 1) for each in value)


class _Runner:
    """Runs what is wired: all that a tiny board has of a `Loop`."""

    step: "Callable[[], None]"
    steps: int
    late: int
    refused: int
    faults: int
    fault: "Any"
    _every: int
    _inputs: "Any"
    _outputs: "Any"
    _paced: "Any"
    _opened: "Any"
    _closed: "Any"
    _running: bool
    _alarm: int

    def run(
        self, steps: "int | None" = None, feed: "Callable[[], Any] | None" = None
    ) -> None:
        """Open the devices and run; every exit ends with each actuator's safe command.

        Args:
            steps: How many steps; None for ever.
            feed: Called after each step: the hook for a hardware watchdog.
        """
        period, rest = divmod(_SECOND * 1000, self._every)
        debt = 0
        try:
            self.open()
            due = _ticks()
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
        finally:
            self.close()

    def open(self) -> None:
        """Open every device, and give each actuator its safe command.

        `run` does this, and the first `step`.
        """
        self._running = True
        for source in self._inputs:
            source.time = -1
            source.failed = 0
        for each in self._opened:
            each()
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
        for part in self._closed:
            try:
                part.close()
            except Exception as error:
                self._note(part, error)
            except BaseException as error:
                stop = error
        if stop is not None:
            raise stop

    # Sensors.

    def _turn(self, now: int) -> None:
        """Find out who has its turn in this step."""
        for node, pace in self._paced:
            node.phase += pace
            node.due = node.phase >= self._every
            if node.due:
                node.phase -= self._every

    def _may_run(self, task: "Any", now: int) -> bool:
        """Tell whether a reaction has news; park it if a reading is too old."""
        news = task.timed
        for _, source, max_age in task.inputs:
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

    def _share(self, task: "Any", command: "Any", now: int) -> None:
        """Send what a reaction has decided for each of its ports."""
        ports = task.ports
        several = type(command) is dict
        if len(ports) == 1 and not (several and ports[0].key in command):
            self._write(ports[0], command, now)  # its commands are dictionaries
            return
        known = 0
        for port in ports:
            if several and port.key in command:
                known += 1
        if command is None or (several and known == len(command)):
            for port in ports:
                self._write(port, command.get(port.key) if several else None, now)
            return
        keys = [port.key for port in ports]
        self._note(task, ValueError("expected commands for %s" % keys))
        self._drop(task)

    def _write(self, port: "Any", command: "Any", now: int) -> None:
        """Send a command, unless somebody else holds the actuator or it is no good.

        None gives the actuator back.
        """
        output = port.output
        holder = output.holder
        if command is None:
            if holder is port:
                output.holder = output.steady = None
            return
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


# One step, as text: a function that is made for its wiring has no loops and no look-ups,
# which makes it three times as fast. Each # is a number. L is the loop; in place of a
# reading or a command it says that there is none.
_BEGIN = """
  now = L.steps = L.steps + 1
  now += L.late
  if now >= L._alarm: L._look(now)
"""
_READ = """
  v# = L
  try:
   %ss#.value = v# = r#(); s#.time = now
  except Exception as e: s#.failed = now; L._note(s#, e)
"""
_DECIDE = """
  try:
   %sif %sL._may_run(t#, now): c = d#(%s)
   else: c = L
  except Exception as e: c = L; L._note(t#, e); L._drop(t#)
"""
# What mostly happens is that the holder goes on; all else is in _share.
_WRITE = """
  if c is None:
   if o#.holder is p#: o#.holder = o#.steady = None
  elif o#.steady is p# and (
   c is o#.last or type(c) is o#.number and o#.least <= c <= o#.most
  ):
   o#.written = now
   try: w#(c)
   except Exception as e: L._note(o#, e); L._make_safe(o#)
  el"""
_SHARE = """if c is not L: L._share(t#, c, now)
"""


def step_text(inputs: "Any", tasks: "Any", paced: "Any", quick: bool = True) -> str:
    """Return ``make``: called with a loop and all nodes, it returns a step.

    It is shorter, and slower, if it need not be quick.
    """
    turns = [each[0] for each in paced]
    text = ["L", "", _BEGIN + "  L._turn(now)" if paced else _BEGIN]

    def add(number: int, *parts: str) -> None:
        for i, part in enumerate(parts):
            text[i] += part.replace("#", str(number))

    for i, source in enumerate(inputs):
        due = "if s#.due: " if source in turns else ""
        add(i, ",s#", " r# = s#.read\n", _READ % due)
    for i, task in enumerate(tasks):
        fresh, values, older = [], [], []
        for key, source, _ in task.inputs:
            number = inputs.index(source)
            fresh.append("v%d is not L" % number)
            values.append("%s=v%d" % (key, number))
            older.append("%s=s%d.value" % (key, number))
        if len(values) == 1 and not _flags(task.react) & 8:
            values[0] = values[0].split("=")[1]  # by position is faster, if it is known
        news = due = ""
        if task in turns:
            due = "t#.due and "
        elif values:
            news = "if %s: c = d#(%s)\n   el" % (" and ".join(fresh), ",".join(values))
        add(i, ",t#", " d# = t#.react\n", _DECIDE % (news, due, ",".join(older)))
        if quick and len(task.ports) == 1:
            add(i, "", " p#, = t#.ports; o# = p#.output; w# = o#.write\n", _WRITE)
        else:
            add(i, "", "", "  ")
        add(i, "", "", _SHARE)
    return "def make(%s):\n%s def step():%s return step\n" % tuple(text)


class Loop(_Runner):
    """Reads sensors, lets reactions decide, and writes actuators, at a fixed rate.

    Args:
        reactions: In the order in which they decide.
        sensors: Of MIN, or on a computer those of STD that have a plain ``read``.
        actuators: Of MIN, or on a computer those of STD that have a plain ``write``.
        rate: Steps per second.

    Attributes:
        steps: How many steps were made.
        late: How many steps were left out because they came too late.
        refused: How many commands met an actuator that somebody else held.
        faults: How many times a sensor, reaction or actuator raised an error, or a
            command was no good (wrong type, not finite, outside the limits).
        fault: The name of the component with the last fault, and the error.
        step: Makes one step, for tests and for boards with a loop of their own. Time is
            counted in periods: such a loop adds to `late` the periods that it missed,
            and calls `close` at its end.

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
            if isinstance(part, type):
                raise ValueError("%s: expected an object, not a class" % part.__name__)
            _give_name(part)
        if __debug__:
            found = mistakes(reactions, sensors, actuators, rate)
            if found:
                raise ValueError("; ".join(found))
        self.steps = self.late = self.refused = self.faults = 0
        self.fault = None
        self._running = False
        self._alarm = 0
        devices = sensors + actuators
        self._opened = [each.open for each in devices if _is_plain(each, "open")]
        self._closed = [each for each in devices if _is_plain(each, "close")]
        inputs: "Any" = [_Input(each) for each in sensors]
        outputs: "Any" = [_Output(each, rate) for each in actuators]
        named = {each.name: each for each in inputs + outputs}
        tasks: "Any" = []
        for part in reactions:
            terms, ports = [], []
            for key, need in declared(part):
                node = named[need.name or key]
                if hasattr(need, "max_age"):
                    age = need.max_age and _steps(need.max_age, rate)
                    terms.append((key, node, age))
                else:
                    ports.append(_Port(key, node, need, rate))
            tasks.append(_Task(part, terms, ports))
        every = self._every = int(rate * 1000 + 0.5)
        self._paced = []
        for node, part in zip(inputs + tasks, sensors + reactions):
            pace = every if part.rate is None else int(part.rate * 1000 + 0.5)
            if pace < every:
                node.phase = every - pace
                self._paced.append((node, pace))
        self._inputs, self._outputs, self._tasks = inputs, outputs, tasks
        scope: "Any" = {}
        exec(step_text(inputs, tasks, self._paced), scope)
        self.step = scope["make"](self, *(inputs + tasks))


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


def _steps(seconds: float, rate: float) -> int:
    """The number of steps after which a duration has passed."""
    count = int(seconds * rate)
    return count if count >= seconds * rate - 1e-4 else count + 1


def _is_plain(part: "Any", name: str) -> bool:
    """Tell whether a part has a method that can be called without an event loop."""
    method = getattr(part, name, None)
    return method is not None and not _flags(method) & 0x380


def _flags(method: "Any") -> int:
    """What a computer knows about a function; 0 on a board."""
    return getattr(getattr(method, "__code__", None), "co_flags", 0)


def _give_name(part: "Any") -> None:
    if not part.name:
        part.name = _snake_case(type(part).__name__)


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
        found: "list[str]" = []
        longest = (_MASK // 2) / _SECOND

        def tell(name: str, text: str, *values: "Any") -> None:
            found.append(name + ": " + text % values)

        def check(
            name: str, field: str, value: "Any", most: float, unit: str = "seconds"
        ) -> None:
            if not (isinstance(value, (int, float)) and 0 < value <= most * 1.0001):
                text = "%s: expected %s > 0, at most %g, not %r"
                tell(name, text, field, unit, most, value)

        def check_method(part: "Any", name: str, base: "Any" = None) -> None:
            method = getattr(part, name, None)
            module = getattr(method, "__module__", None) or ""
            if base:
                module = ""
                if getattr(type(part), name, None) is getattr(base, name):
                    method = None
                if method is None:
                    tell(part.name, "it must have a method %s", name)
            # Those of STD itself do nothing: they are left out, not refused.
            if method and not _is_plain(part, name) and module[:6] != "esair.":
                tell(part.name, "%s: expected a plain method, not async", name)

        check("loop", "rate", rate, 100000, "Hz")
        if found:
            return found
        devices = sensors + actuators
        for parts in (reactions, devices):
            names = [part.name for part in parts]
            for name in names:
                if names.count(name) > 1:
                    tell(name, "there are two of this name")
                wrong = [
                    each
                    for each in name.replace("_", "")
                    if not (each.islower() or each.isdigit())
                ]
                if wrong or not name[0].islower():
                    tell(name, "a name has small letters, digits and _")
        for part in devices:
            check_method(part, "open")
            check_method(part, "close")
        for part in sensors + reactions:
            pace = getattr(part, "rate", None)
            if pace is not None:
                check(part.name, "rate", pace, rate, "Hz")
        for part in sensors:
            check_method(part, "read", Sensor)
        for part in actuators:
            check_method(part, "write", Actuator)
            name = part.name
            if not hasattr(part, "safe"):
                tell(name, "safe: an actuator must declare its safe command")
                continue
            before = len(found)
            timeout = part.command_timeout
            check(name, "command_timeout", timeout, longest)
            if len(found) == before and timeout < 1.0 / rate:
                tell(name, "command_timeout: shorter than one step")
            if getattr(part, "slew", None) is not None:
                tell(name, "slew: only STD has it")
            if part.clamp and isinstance(part.limits, dict):
                tell(name, "clamp: only STD has it for fields")
            if len(found) == before:
                try:
                    _checked(_Output(part, rate), part.safe)
                except Exception as error:
                    tell(name, "safe or limits: %r", error)
        for part in reactions:
            check_method(part, "react", Reaction)
            inputs = []
            for key, need in declared(part):
                where = part.name + ": " + key
                kind, known, field = "actuator", actuators, "hold"
                if hasattr(need, "max_age"):
                    kind, known, field = "sensor", sensors, "max_age"
                    inputs.append(key)
                name, names = need.name or key, [each.name for each in known]
                if name not in names:
                    tell(where, "there is no %s %r, only %s", kind, name, names)
                if need.configure:
                    tell(where, "configure: only STD has it")
                seconds = getattr(need, field)
                if seconds is not None:
                    check(where, field, seconds, longest)
            if not inputs and part.rate is None:
                tell(part.name, "rate: it reads nothing, so it needs one")
            code: "Any" = getattr(part.react, "__code__", None)
            # On a board nobody knows the parameters.
            if hasattr(code, "co_varnames") and not code.co_flags & 8:
                taken = code.co_varnames[1 : code.co_argcount]
                if sorted(taken) != sorted(inputs) or code.co_kwonlyargcount:
                    text = "react: its parameters %s must be its readings %s"
                    tell(part.name, text, list(taken), inputs)
        return found
