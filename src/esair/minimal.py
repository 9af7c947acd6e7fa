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

Everything is wired when the `Loop` is made. A step reads the sensors, then lets each
reaction decide, then settles each actuator once: the highest priority wins, whatever the
order in the lists; blind reactions and guards have their say; at most one command leaves.
No memory is allocated in the steady state. What is wrong with the parts is found where
there is room for it: by ``esair min build``.
"""

# ruff: noqa: A002, C419, RUF005, T201, UP031, UP037
# MicroPython knows less of the language: what is newer is not used here.

import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from typing import Any, Literal

_INFINITE = float("inf")
_LEAST = -_INFINITE

# Moments are whole milliseconds that may wrap: elapsed = (later - earlier) & _MASK.
if hasattr(time, "ticks_ms"):
    _MASK = time.ticks_add(0, -1)  # type: ignore[attr-defined]
    _ticks = time.ticks_ms
    _sleep = time.sleep_ms  # type: ignore[attr-defined]
else:
    _MASK = (1 << 62) - 1

    def _ticks() -> int:
        return time.monotonic_ns() // 1000000

    def _sleep(ticks: int) -> None:
        time.sleep(ticks / 1000)


class Need:
    """What a reaction declares to use, as a class attribute."""

    made = 0
    """How many there are: the order of the attributes, which some classes forget."""

    def __init__(self, type: "Any", name: "str | None", configure: bool) -> None:
        Need.made = self.made = Need.made + 1
        self.type = type
        self.name = name
        self.configure = configure


class Reads(Need):
    """A reaction reads a sensor; made by `reads`."""

    def __init__(
        self,
        type: "Any" = None,
        name: "str | None" = None,
        max_age: "float | None" = None,
        every: bool = False,
        optional: bool = False,
        configure: bool = False,
    ) -> None:
        Need.__init__(self, type, name, configure)
        self.max_age = max_age
        self.every = every
        self.optional = optional


class Writes(Need):
    """A reaction writes an actuator; made by `writes`."""

    def __init__(
        self,
        type: "Any" = None,
        name: "str | None" = None,
        priority: int = 0,
        hold: "float | None" = None,
        blind: "Literal['safe', 'release']" = "safe",
        configure: bool = False,
    ) -> None:
        Need.__init__(self, type, name, configure)
        self.priority = priority
        self.hold = hold
        self.blind = blind


class Guards(Need):
    """Every command for an actuator passes a reaction; made by `guards`."""

    def __init__(
        self,
        type: "Any" = None,
        name: "str | None" = None,
        priority: int = 0,
        latch: bool = False,
    ) -> None:
        Need.__init__(self, type, name, False)
        self.priority = priority
        self.latch = latch


reads = Reads
writes = Writes
guards = Guards


class _Part:
    """Something with a name."""

    name: str = ""

    def __init__(self, name: "str | None" = None) -> None:
        self.name = name or self.name
        give_name(self)


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

    A command is a number, a truth value, a text, or a flat tuple of them.

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
    ``rate``. While a reading that it needs is missing or too old it is blind: what it
    may write is safe, unless a higher priority moves it.

    Args:
        name: Its name; the class name in snake case unless given.
    """

    rate: "float | None" = None
    """How often it runs, in Hz; None to run on every new reading."""

    now_ms: int = 0
    """The moment of this step, in whole milliseconds since the robot started."""

    elapsed_ms: int = 0
    """Milliseconds since its previous step; 0 at the first."""

    def react(self, *args: "Any", **readings: "Any") -> "Any":
        """Decide on the newest readings, which come by the names of their attributes.

        Returns:
            A command; several as ``{"left": ..., "right": ...}``; or None for "no
            opinion", which gives the actuator back at once. A guard returns what may
            pass of the command that it was given, or None for nothing.
        """
        raise NotImplementedError

    def blind(self, command: "Any") -> "Any":
        """Return what a guard lets pass while it is blind: nothing unless overridden."""


class _Input:
    """A sensor, and its newest reading."""

    def __init__(self, sensor: "Any", rate: float) -> None:
        self.due = True
        """Whether it is read in this step."""
        self.value: "Any" = None
        self.time: "int | None" = None
        self.name = sensor.name
        self.period = 1000.0 / min(sensor.rate or rate, rate)


class _Port:
    """What one reaction may do with one actuator, and what it has asked for."""

    def __init__(self, key: str, output: "Any", priority: float) -> None:
        self.time = -1
        """When it has asked for its command."""
        self.command: "Any" = None
        self.name = self.key = key
        self.output = output
        self.priority = priority
        self.hold = output.timeout
        self.blind = False
        """Whether it holds the actuator safe, because its reaction is blind."""
        self.holds_blind = True


class _Task:
    """A reaction with its wiring."""

    def __init__(self, loop: "Any", reaction: "Any") -> None:
        self.due: "bool | None" = True
        """Whether it is its turn in this step; None to run whenever there is news."""
        self.blind = True
        self.first = True
        self.loop = loop
        self.name = reaction.name
        self.reaction = reaction
        self.ports: "Any" = []
        self.optional: "Any" = []
        self.values: "Any" = {}
        self.guards: "Any" = None
        """The key of what it guards, if it does, then whether it latches."""
        self.news = self.latched = False
        self.safe: "Any" = None
        """What is safe for what it guards."""
        self.priority = 0

    def old(self, key: str, source: "Any", age: float, now: int) -> "Any":
        """Return a reading that is not new; itself if it is missing or too old."""
        if source.time is not None and now - source.time < age:
            return source.value
        if key in self.optional:
            return None
        if not self.blind:
            self.lose_sight()
        return self

    def lose_sight(self) -> None:
        """Give back what it holds: whatever it moves is safe until it sees again."""
        self.blind = self.news = True
        for port in self.ports:
            port.blind = port.holds_blind
            port.output.steady = None
            _release(port)
            port.output.orphan = port.output.orphan or port.output.writer is port

    def see(self, now: int) -> None:
        """Be no longer blind."""
        self.blind = False
        if self.first:
            self.first = False
            self.reaction.now_ms = now
        for port in self.ports:
            port.blind = False

    def wake(self, *args: "Any", **readings: "Any") -> None:
        """Hear that there is news: a guard decides when there is a command."""
        self.news = True

    def share(self, command: "Any", now: int) -> None:
        """Ask for what a reaction has decided for each of its ports."""
        if command is None:
            for port in self.ports:
                _release(port)
            return
        known = 0
        for port in self.ports:
            known += port.key in command
        if type(command) is not dict or known != len(command):
            raise ValueError("expected commands for its ports", command)
        for port in self.ports:
            port.command = command.get(port.key)
            if port.command is None:
                _release(port)
            else:
                port.time = now

    def passes(self, command: "Any", now: int) -> "Any":
        """Return what a guard lets pass of a command: None, or never more than it."""
        key, latch = self.guards
        passed = None
        if not self.latched:
            try:
                if self.blind:
                    passed = self.reaction.blind(command)
                else:
                    reaction = self.reaction
                    reaction.elapsed_ms = now - reaction.now_ms
                    reaction.now_ms = now
                    self.values[key] = command
                    passed = self.reaction.react(**self.values)
                if passed is not None and not _within(passed, command, self.safe):
                    raise ValueError("a guard lets pass more than was asked", passed)
            except Exception as error:
                passed = None
                self.loop.note(self.name, error)
            self.latched = latch and (passed is None or self.blind)
        return passed


class _Output:
    """An actuator, and whose will it does."""

    def __init__(self, loop: "Any", actuator: "Any") -> None:
        self.steady: "Any" = None
        """The port that holds it, if its next write has no questions."""
        self.last: "Any" = None
        """What was sent last: it was checked, and cannot change."""
        self.written = 0
        self.loop = loop
        self.name = actuator.name
        self.send = actuator.write
        self.safe = actuator.safe
        self.timeout = _ms(actuator.command_timeout)
        self.clamp = actuator.clamp
        limits = actuator.limits or {}
        if not isinstance(limits, dict):
            limits = {"": limits}
        self.limits = [(field,) + tuple(limits[field]) for field in limits]
        """Of each limited field: its name, or nothing, its least and greatest value."""
        self.ports: "Any" = []
        """Of the highest priority first."""
        self.guards: "Any" = []
        self.holder: "Any" = None
        self.writer: "Any" = None
        """The port whose command stands; None if it is safe."""
        self.asked: "Any" = None
        self.orphan = False
        """Whether the writer is gone."""
        self.bad = False
        """Whether it has not taken its safe command."""

    def settle(self, best: "Any", now: int) -> None:
        """Do the will of the best who asks, if nobody holds it against them."""
        if best is None or best is not self.steady:
            best = self.arbitrate(best, now)
            if best is None:
                return
        try:
            command = self.checked(best.command, best.key)
        except Exception as error:
            self.loop.note(self.name, error)
            self.settle_next(best, now)
            return
        self.holder = self.writer = best
        self.written = now
        if self.guards:
            self.asked = command
            command = self.passed()
            if command is None:
                self.loop.refused += 1
                if self.last is not self.safe:
                    self.make_safe(best)
                return
        else:
            self.steady = best
        self.last = command
        self.send(command)

    def settle_next(self, bad: _Port, now: int) -> None:
        """Do the will of the next best: a command that is no good was never said."""
        bad.time = -1
        for port in self.ports:
            if port.time == now:
                self.settle(port, now)
                return
        self.settle(None, now)

    def arbitrate(self, best: "Any", now: int) -> "Any":
        """Return whose command is sent in this step; see to what stands if nobody's."""
        self.steady = None
        holder, writer = self.holder, self.writer
        held = holder is not None and now - self.written < holder.hold
        if best is not None and holder is not None and best.priority <= holder.priority:
            if holder.time == now:
                best = holder
            elif held:
                self.loop.refused += 1
                best = None
        for port in self.ports:
            if port.blind:
                if best is not None and best.priority <= port.priority:
                    self.loop.refused += 1
                    best = None
                if writer is not None and writer.priority <= port.priority:
                    self.orphan = True
                break
        if self.bad or (
            best is None
            and writer is not None
            and (self.orphan or now - self.written >= self.timeout)
        ):
            self.make_safe(holder if held and not self.orphan else None)
        elif best is None and writer is not None:
            self.look_again()
        self.orphan = False
        return None if self.bad else best

    def look_again(self) -> None:
        """Put what stands to the guards again, if they have news: it only gets less."""
        for guard in self.guards:
            if guard.news:
                command = self.passed()
                if command is None:
                    self.make_safe(self.holder)
                elif command != self.last and _within(command, self.last, self.safe):
                    self.last = command
                    self.send(command)
                return

    def passed(self) -> "Any":
        """Return what the guards let pass of what was asked; None for nothing."""
        command = self.asked
        for guard in self.guards:
            guard.news = False
            if command is not None:
                command = guard.passes(command, self.loop.now_ms)
        return command

    def make_safe(self, holder: "Any" = None) -> None:
        """Send the safe command."""
        self.holder, self.writer, self.steady = holder, None, None
        self.last = self.safe
        try:
            self.send(self.safe)
            self.bad = False
        except Exception as error:
            self.bad = True  # tried again at each step; no other command goes before it
            self.loop.note(self.name, error)

    def checked(self, command: "Any", key: "str | None" = None) -> "Any":
        """Return the command that may be sent: its type, finite, within the limits."""
        kind = type(self.safe)
        if type(command) is dict and key in command:
            command = command[key]
        if type(command) is not kind:
            if kind is float and type(command) is int:
                command = float(command)
            elif not isinstance(command, kind) or type(command) is bool:
                raise ValueError("wrong type", command)
        if isinstance(command, tuple):
            for each in command:
                if not (isinstance(each, str) or _LEAST < each < _INFINITE):
                    raise ValueError("not finite", command)
        elif not isinstance(command, str) and not _LEAST < command < _INFINITE:
            raise ValueError("not finite", command)
        for field, low, high in self.limits:
            value = getattr(command, field) if field else command
            if not low <= value <= high:
                if not self.clamp:
                    raise ValueError("outside the limits", command)
                command = kind(low if value < low else high)
        return command


class Loop:
    """Reads sensors, lets reactions decide, and writes actuators, at a fixed rate.

    Args:
        reactions: In any order.
        sensors: Of MIN, or on a computer those of STD that have a plain ``read``.
        actuators: Of MIN, or on a computer those of STD that have a plain ``write``.
        rate: Steps per second, at most 1000.
        armed: Whether actuators move at once, or only after `arm`.

    Attributes:
        now_ms: The time of this step, in milliseconds since the start.
        steps: How many steps were made.
        late: How many steps were left out because they came too late.
        refused: How many commands met an actuator that somebody else held, a blind
            reaction, or a guard.
        faults: How many times a sensor, reaction or actuator raised an error, or a
            command was no good (wrong type, not finite, outside the limits).
        fault: The name of the component with the last fault, and the error.
        inputs: The sensors by name, each with the value and time of its newest reading.
        outputs: The actuators by name.

    Raises:
        ValueError: A reaction uses what is not there.
    """

    def __init__(
        self,
        reactions: "Iterable[Any]" = (),
        sensors: "Iterable[Any]" = (),
        actuators: "Iterable[Any]" = (),
        rate: float = 50,
        armed: bool = True,
    ) -> None:
        self.now_ms = self.steps = self.late = self.refused = self.faults = 0
        self.fault: "Any" = None
        self._said = 0
        self._running = False
        self._every = int(rate * 1000 + 0.5)
        self._gap = 1000000 // self._every
        self._debt = 0
        self._paced: "Any" = []
        self._odd = True
        sensors, actuators = list(sensors), list(actuators)
        devices = sensors + actuators
        for part in devices:
            give_name(part)
        self._opened = [each.open for each in devices if _is_plain(each, "open")]
        self._closed = [each for each in devices if _is_plain(each, "close")]
        inputs: "Any" = []
        for sensor in sensors:
            node: "Any" = _Input(sensor, rate)
            self._pace(node, sensor.rate)
            inputs.append((node, sensor.read))
        self.inputs = named = {each[0].name: each[0] for each in inputs}
        self.outputs = moved = {each.name: _Output(self, each) for each in actuators}
        self._locks = []
        for output in self.outputs.values():
            lock = _Port("arm", output, _INFINITE)
            lock.blind = not armed
            output.ports.append(lock)
            self._locks.append(lock)
        self._tasks: "Any" = []
        tasks: "Any" = []
        for reaction in reactions:
            give_name(reaction)
            node = _Task(self, reaction)
            self._pace(node, reaction.rate)
            if reaction.rate is None:
                node.due = None
            react, terms = reaction.react, []
            for key, need in declared(reaction):
                name = need.name or key
                if name not in (named if hasattr(need, "max_age") else moved):
                    raise ValueError("%s: %s: there is no %r" % (node.name, key, name))
                if hasattr(need, "max_age"):
                    source = named[name]
                    age = need.max_age
                    age = 3 * source.period if age is None else age * 1000
                    terms.append((key, source, int(age + 0.5)))
                    if getattr(need, "optional", False):
                        node.optional.append(key)
                elif hasattr(need, "hold"):
                    node.ports.append(_port(node.name, key, moved[name], need))
                else:
                    node.guards = (key, need.latch)
                    node.safe = moved[name].safe
                    node.priority = need.priority
                    moved[name].guards.append(node)
                    react = node.wake
            node.lose_sight()
            port = node.ports[0] if len(node.ports) == 1 else None
            single = len(terms) == 1 and not (node.guards or _flags(react) & 8)
            tasks.append(
                (node, reaction, tuple(terms), react, port, node.values, single)
            )
            self._tasks.append(node)
        outputs = []
        for output in self.outputs.values():
            output.ports.sort(key=lambda each: (-each.priority, each.name))
            output.guards.sort(key=lambda each: (-each.priority, each.name))
            outputs.append((output, output.ports, output.send))
        self._wired = (inputs, tasks, outputs)

    def _pace(self, node: "Any", rate: "float | None") -> None:
        pace = self._every if rate is None else int(rate * 1000 + 0.5)
        if pace < self._every:
            node.pace = pace
            node.phase = self._every - pace
            self._paced.append(node)

    def step(self) -> None:
        """Make one step, for tests and for boards with a loop of their own.

        Time is counted in periods: such a loop calls `skip` when it has missed some,
        and `close` at its end.
        """
        if self._odd:
            self._prepare()
        now = self.now_ms
        inputs, tasks, outputs = self._wired
        for node, read in inputs:
            if node.due:
                try:
                    node.value = read()
                    node.time = now
                except Exception as error:
                    self.note(node.name, error)
        for node, reaction, terms, react, port, values, single in tasks:
            news = node.due
            for key, source, age in terms:
                if source.time == now:
                    if news is None:
                        news = True
                    value = source.value
                else:
                    value = node.old(key, source, age, now)
                    if value is node:
                        break
                if not single:
                    values[key] = value
            else:
                if news:
                    try:
                        if node.blind:
                            node.see(now)
                        reaction.elapsed_ms = now - reaction.now_ms
                        reaction.now_ms = now
                        command = react(value) if single else react(**values)
                        if command is None or port is None:
                            node.share(command, now)
                        else:
                            port.command = command
                            port.time = now
                    except Exception as error:
                        self.note(node.name, error)
                        node.lose_sight()
        for node, ports, send in outputs:
            best = node
            for port in ports:
                if port.time == now:
                    if best is node:
                        best = port
                    else:
                        self.refused += 1
            try:
                if best is node.steady and best.command is node.last:
                    node.written = now
                    send(best.command)
                else:
                    node.settle(None if best is node else best, now)
            except Exception as error:
                self.note(node.name, error)
                node.make_safe()
        self.steps += 1
        self.now_ms = now + self._gap

    def _prepare(self) -> None:
        """Find out who has its turn in this step, and when the next one is."""
        if not self._running:
            self.open()
        self._debt += 1000000 % self._every
        self._gap = 1000000 // self._every + self._debt // self._every
        self._debt %= self._every
        for node in self._paced:
            node.phase += node.pace
            node.due = node.phase >= self._every
            if node.due:
                node.phase %= self._every
        self._odd = bool(self._paced or 1000000 % self._every)

    def skip(self, periods: int) -> None:
        """Leave out steps that come too late."""
        self.late += periods
        self._debt += 1000000 * periods
        self.now_ms += self._debt // self._every
        self._debt %= self._every
        for node in self._paced:
            node.phase += node.pace * periods

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
            begin = _ticks() - self.now_ms
            while steps is None or steps > 0:
                self.step()
                if feed is not None:
                    feed()
                if steps is not None:
                    steps -= 1
                left = (begin + self.now_ms - _ticks()) & _MASK
                if left > _MASK >> 1:  # it is late already
                    self.skip(((-left) & _MASK) * self._every // 1000000)
                elif steps != 0:
                    _sleep(left)
        finally:
            self.close()

    def open(self) -> None:
        """Open every device, and give each actuator its safe command.

        `run` does this, and the first `step`.
        """
        self._running = self._odd = True
        self.now_ms = self._debt = 0
        for node, _ in self._wired[0]:
            node.time = None
        for node in self._tasks:
            node.first = True
            node.lose_sight()
        for each in self._opened:
            each()
        for output in self.outputs.values():
            output.make_safe()

    def close(self) -> None:
        """Give each actuator its safe command, three tries each, and close all."""
        self._running = False
        self._odd = True
        stop = None
        for output in self.outputs.values():
            for _ in range(3):
                try:
                    output.make_safe()
                    if not output.bad:
                        break
                except BaseException as error:  # Ctrl-C: the safe command first
                    stop = error
        for part in self._closed:
            try:
                part.close()
            except Exception as error:
                self.note(part.name, error)
            except BaseException as error:
                stop = error
        if stop is not None:
            raise stop

    def arm(self, armed: bool = True) -> None:
        """Let actuators move from the next step on, or keep them safe."""
        for lock in self._locks:
            lock.blind = not armed
            lock.output.steady = None

    def reset(self, name: str) -> bool:
        """Let a guard that has latched decide again; tell whether it does."""
        for node in self._tasks:
            if node.name == name:
                node.latched = node.latched and node.blind
                return not node.latched
        return False

    def note(self, name: str, error: BaseException) -> None:
        """Count a fault, and print it: a line a second at most."""
        self.faults += 1
        self.fault = (name, error)
        now = _ticks()
        if self.faults == 1 or (now - self._said) & _MASK >= 1000:
            self._said = now  # a serial line is slow
            print("esair: %s: %r, fault %d" % (name, error, self.faults))


def _port(name: str, key: str, output: "Any", need: "Any") -> _Port:
    port = _Port(key, output, need.priority)
    port.name = name
    port.hold = _ms(need.hold) if need.hold else output.timeout
    port.holds_blind = getattr(need, "blind", "safe") == "safe"
    output.ports.append(port)
    return port


def _release(port: _Port) -> None:
    """Give an actuator back at once; what was sent stands until its time is over."""
    if port.output.holder is port:
        port.output.holder = port.output.steady = None


def _within(value: "Any", asked: "Any", safe: "Any") -> bool:
    """Tell whether a command is no more than another: each number lies towards safe."""
    if isinstance(asked, tuple):
        if len(value) != len(asked):
            return False
        return all([_within(value[i], asked[i], safe[i]) for i in range(len(asked))])
    if type(asked) is bool or isinstance(asked, str):
        return bool(value in (asked, safe))
    return bool(min(asked, safe) <= value <= max(asked, safe))


def _ms(seconds: float) -> int:
    return int(seconds * 1000 + 0.5)


def _is_plain(part: "Any", name: str) -> bool:
    """Tell whether a part has a method that can be called without an event loop."""
    method = getattr(part, name, None)
    return method is not None and not _flags(method) & 0x380


def _flags(method: "Any") -> int:
    """What a computer knows about a function; 0 on a board."""
    return getattr(getattr(method, "__code__", None), "co_flags", 0)


def declared(reaction: "Any") -> "list[tuple[str, Any]]":
    """Return what a reaction declares to use, by attribute, in the order written."""
    needs = getattr(reaction, "needs", None)
    if isinstance(needs, dict):  # a reaction of STD
        return list(needs.items())
    found = []
    for key in dir(reaction):
        need = getattr(type(reaction), key, None)
        if isinstance(need, Need):
            found.append((key, need))
    found.sort(key=lambda each: each[1].made)
    return found


def give_name(part: "Any") -> None:
    """Give a part the name of its class, in snake case, unless it has one."""
    if isinstance(part, type):
        raise ValueError("%s: expected an object, not a class" % part.__name__)
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
