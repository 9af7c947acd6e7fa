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

# ruff: noqa: A002, B905, T201, UP031, UP037
# MicroPython knows less of the language: what is newer is not used here.

import time

const = int  # MicroPython's compiler knows the word, and leaves out what is never run
TYPE_CHECKING = const(0)
if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable
    from typing import Any, Literal

_ENDLESS = (-float("inf"), float("inf"))
_EMPTY: "dict[str, Any]" = {}

# Moments are whole milliseconds that wrap, on boards at this or a multiple of it.
_MASK = const(0x3FFFFFFF)
_HALF = const(0x20000000)
_NEVER = const(-0x20000001)

_ticks = getattr(time, "ticks_ms", None) or (lambda: time.monotonic_ns() // 1000000)
_sleep = getattr(time, "sleep_ms", None) or (lambda ticks: time.sleep(ticks / 1000))


class Need:
    """What a reaction declares to use, as a class attribute."""

    type: "Any"
    name: "str | None"
    configure = False


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
        self.type, self.name, self.configure = type, name, configure
        self.max_age, self.every, self.optional = max_age, every, optional


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
        self.type, self.name, self.configure = type, name, configure
        self.priority, self.hold, self.blind = priority, hold, blind


class Guards(Need):
    """Every command for an actuator passes a reaction; made by `guards`."""

    def __init__(
        self,
        type: "Any" = None,
        name: "str | None" = None,
        priority: int = 0,
        latch: bool = False,
    ) -> None:
        self.type, self.name, self.priority, self.latch = type, name, priority, latch


reads = Reads
writes = Writes
guards = Guards


class _Part:
    """Something with a name."""

    name: str = ""

    def __init__(self, name: "str | None" = None) -> None:
        self.name = name or self.name
        give_name(self)

    def open(self) -> None:
        """Make a device ready. What it raises ends the program, at its start."""

    def close(self) -> None:
        """Let a device go."""


class Sensor(_Part):
    """A device that gives values.

    Args:
        name: Its name; the class name in snake case unless given.
    """

    rate: "float | None" = None
    """How often it is read, in Hz; None for every step of the loop."""

    def read(self) -> "Any":
        """Return one value. Raise, whatever it is, if there is none."""
        raise NotImplementedError


class Actuator(_Part):
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
    """A sensor, and its newest reading.

    Attributes:
        due: Whether it is read in this step.
        value: What it has given last.
        time: When that was; negative before the first.
    """

    def __init__(self, loop: "Any", part: "Any") -> None:
        self.time, self.due = _NEVER, True
        self.value: "Any" = None
        self.name, self.read = part.name, part.read
        loop.pace(self, part.rate)


class _Port:
    """What one reaction may do with one actuator, and what it has asked for.

    Attributes:
        time: When it has asked for its command.
        command: What it has asked for; checked when it is sent.
        bars: Whether it holds the actuator safe while its reaction is blind.
    """

    def __init__(self, task: "Any", key: str, need: "Any", output: "Any") -> None:
        self.time = -1
        self.command: "Any" = None
        self.task, self.key, self.output, self.name = task, key, output, task.name
        self.priority = need.priority
        self.hold = _ms(need.hold) if need.hold else output.timeout
        self.bars = need.blind != "release"


class _Task:
    """A reaction with its wiring.

    Attributes:
        due: Whether it is its turn in this step; None to run whenever there is news.
        ports: What it writes, by attribute.
        values: What it reads, by attribute.
        need: Of a guard: what it declares; `key` is its attribute, `output` what it
            guards, `command` what it lets pass.
    """

    def __init__(self, loop: "Any", reaction: "Any") -> None:
        self.due: "bool | None" = None if reaction.rate is None else True
        self.blind = self.first = True
        self.loop, self.reaction, self.name = loop, reaction, reaction.name
        self.latched, self.saw = False, -1
        self.ports: "Any" = {}
        self.values: "Any" = {}
        self.need: "Any" = None
        self.output: "Any" = None
        self.now_ms = self.priority = 0
        self.key = ""
        loop.pace(self, reaction.rate)

    def lose_sight(self) -> None:
        """Be blind: whatever it moves, or bars, is safe until it sees again."""
        self.blind = True
        for port in self.ports.values():
            port.time = -1
            port.output.lose(port)
        if self.output:
            self.output.review()

    def wake(self, **readings: "Any") -> None:
        """Hear, as a guard, that there is news: it decides on what stands."""
        self.output.news = True

    def share(self, command: "Any", now: int) -> None:
        """Ask for what a reaction has decided for each of its ports."""
        if command is None:
            command = _EMPTY
        for key in command:
            self.ports[key]  # it raises for what is none of its ports
        for key in self.ports:
            port = self.ports[key]
            port.command = command.get(key)
            if port.command is not None:
                port.time = now
            elif port.output.holder is port:  # it gives it back at once
                port.output.holder = port.output.steady = None

    def passes(self, command: "Any", moving: "Any") -> "Any":
        """Return what a guard lets pass of a command: None, or never more than it."""
        reaction, now = self.reaction, self.loop.now_ms
        if self.latched:
            return None
        try:
            if self.blind:
                self.latched = self.need.latch and moving is not None
                self.command = None if self.need.latch else reaction.blind(command)
            else:
                reaction.elapsed_ms = 0 if self.first else now - reaction.now_ms
                reaction.now_ms, self.first = now, False
                self.values[self.key] = command
                self.command = reaction.react(**self.values)
                self.latched = self.need.latch and self.command is None
            if self.command is None or self.command is command:
                return self.command
            passed = self.output.checked(self)
            if passed is None or _less(passed, command, self.output.safe) == passed:
                return passed
            raise ValueError("more than asked", passed)
        except Exception as error:
            self.loop.note(self.name, error)
            return None


class _Output:
    """An actuator, and whose will it does.

    Attributes:
        steady: The port that holds it, if its next write has no questions.
        last: What was sent last: it was checked, and cannot change.
        limits: Of each limited field, or of the whole: its least and greatest value.
        ports: Of the highest priority first, as the guards.
        holder: The port that keeps lower priorities away.
        writer: The port whose command stands; None if it is safe.
        asked: The command that stands, as it was before the guards.
        news: Whether a guard sees something new.
        bad: Whether it has not taken its safe command.
    """

    def __init__(self, loop: "Any", part: "Any") -> None:
        self.steady = self.last = self.writer = self.asked = None
        self.holder: "Any" = None
        self.written = 0
        self.loop, self.name, self.send = loop, part.name, part.write
        self.safe, self.type = part.safe, type(part.safe)
        self.timeout = _ms(part.command_timeout)
        self.clamp, limits = part.clamp, part.limits or {}
        self.limits = limits if isinstance(limits, dict) else {"": limits}
        self.ports: "Any" = []
        self.guards: "Any" = []
        self.single: "Any" = [0]
        self.news = self.bad = False

    def settle(self, now: int) -> None:
        """Do the will of the best who asks, if nobody holds it against them."""
        if self.bad:
            self.make_safe(self.holder)
            if self.bad:
                return
        loop, bar = self.loop, _ENDLESS[not self.loop.armed]
        best: "Any" = None
        still = False
        holder, since = self.holder, now - self.written
        if holder and since >= holder.hold:
            holder = None
        for port in self.ports:
            if port.time == now and (
                not best or (port is holder and port.priority == best.priority)
            ):
                best = port
            if port.bars and (port.task.blind or port.task.saw == now):
                still = True
                if port.task.blind and port.priority > bar:
                    bar = port.priority
        if best and (
            best.priority <= bar
            or (holder and best is not holder and best.priority <= holder.priority)
        ):
            loop.refused += 1
            best = None
        if best:
            command = self.checked(best)
            if command is None:
                self.settle(now)
                return
            self.holder, self.written, self.asked = best, now, command
            self.review(best)
            if self.writer and not self.guards:
                self.steady = best
        elif self.writer and (
            since >= self.timeout
            or (self.holder.priority <= bar if self.holder else bar > _ENDLESS[0])
            or (still and not holder and self.holder)
        ):
            self.make_safe(holder)
        elif self.news and self.writer:
            self.review()

    def review(self, best: "Any" = None) -> None:
        """Send what the guards let pass: of a new command, or less of what stands."""
        self.news = False
        writer = self.writer
        if not (best or writer):
            return
        command = self.asked
        for guard in self.guards:
            if command is not None:
                command = guard.passes(command, writer)
        if command is None:
            self.loop.refused += best is not None
            if writer:
                self.make_safe(self.holder)
            return
        if best:
            self.writer = best
        else:
            command = _less(command, self.last, self.safe)
            if command == self.last:
                return
        self.last = command
        try:
            self.send(command)
        except Exception as error:
            self.loop.note(self.name, error)
            self.make_safe()

    def lose(self, port: "Any") -> None:
        """Be safe if a port that is blind now has moved it, or bars who has."""
        writer, self.steady = self.writer, None
        if writer is port or (
            port.bars
            and writer
            and (writer.priority <= port.priority or not self.holder)
        ):
            self.make_safe()
        elif self.holder is port:
            self.holder = None

    def make_safe(self, holder: "Any" = None) -> None:
        """Send the safe command."""
        self.holder = holder
        self.writer = self.steady = None
        self.last = self.safe
        self.bad = True  # tried again at each step; no other command goes before it
        try:
            self.send(self.safe)
            self.bad = False
        except Exception as error:
            self.loop.note(self.name, error)

    def close(self) -> None:
        """Send the safe command, unless it has taken it already."""
        if self.bad:
            self.make_safe()

    def checked(self, port: "Any") -> "Any":
        """Return what may be sent; None for what is no good, as if it was never said."""
        command, kind = port.command, self.type
        try:
            if type(command) is not kind:
                if type(command) is dict:
                    port.time = -1
                    port.task.share(command, self.loop.now_ms)
                    return None if port.time < 0 else self.checked(port)
                if kind is float and type(command) is int:
                    command = float(command)
                elif not isinstance(command, kind) or type(command) is bool:
                    raise ValueError("wrong type", command)
            parts, endless = command, _ENDLESS
            if not isinstance(command, tuple):
                parts = self.single
                parts[0] = command
            for each in parts:
                if each != each or each in endless:
                    raise ValueError("not finite", command)
            for field in self.limits:
                low, high = self.limits[field]
                value = getattr(command, field) if field else command
                if not low <= value <= high:
                    if not self.clamp:
                        raise ValueError("over limits", command)
                    command = kind(low if value < low else high)
        except Exception as error:
            self.loop.note(port.name, error)
            port.time = -1
            return None
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
        armed: Whether actuators may move.
        inputs: The sensors by name, each with the value and time of its newest reading.
        outputs: The actuators by name.

    Raises:
        KeyError: A reaction uses what is not there. ``esair min build`` says more of
            what is wrong.
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
        self.armed = armed
        self.inputs: "Any" = {}
        self.outputs: "Any" = {}
        self._debt, self._said = 0, -1000
        self._every = _ms(rate)  # steps in 1000 s
        self._turns: "Any" = None
        self._paced: "Any" = []
        parts = list(sensors), list(actuators)
        self._parts = [one for one in parts[0] + parts[1] if isinstance(one, _Part)]
        for part in parts[0]:
            self.inputs[give_name(part)] = _Input(self, part)
        for part in parts[1]:
            self.outputs[give_name(part)] = _Output(self, part)
        self._tasks: "Any" = []
        for reaction in reactions:
            self._wire(reaction)

    def _wire(self, reaction: "Any") -> None:
        give_name(reaction)
        task = _Task(self, reaction)
        timed, react, terms, port = reaction, reaction.react, [], None
        for key, need in declared(reaction):
            is_read = hasattr(need, "max_age")
            node = (self.inputs if is_read else self.outputs)[need.name or key]
            if is_read:
                age = need.max_age or 3000 / min(node.pace, self._every)
                terms.append((key, node, _ms(age), need.optional))
                task.values[key] = None
            elif hasattr(need, "latch"):
                task.key, task.need, task.output = key, need, node
                task.priority = need.priority
                node.guards.append(task)
                node.guards.sort(key=_rank)
                timed, react = task, task.wake
            else:
                port = task.ports[key] = _Port(task, key, need, node)
                node.ports.append(port)
                node.ports.sort(key=_rank)
        if len(task.ports) != 1:
            port = None
        wired = task, timed, terms, react, port, task.values
        self._tasks.insert(len(self._tasks) if task.output else 0, wired)  # guards last

    def pace(self, part: "Any", rate: "float | None") -> None:
        """Give a sensor or a reaction its turns, if it is slower than the loop."""
        part.pace = self._every if rate is None else _ms(rate)
        if part.pace < self._every:
            part.phase = self._every
            self._paced.append(part)

    def step(self) -> None:
        """Make one step, for tests and for boards with a loop of their own.

        Time is counted in periods: such a loop calls `skip` when it has missed some,
        and `close` at its end.
        """
        if not self._turns:
            self.open()
        next(self._turns)

    def _steps(self) -> "Generator[None]":
        """Make a step each time: a generator has at hand what it works with."""
        gap, odd = divmod(1000000, self._every)
        inputs, outputs = list(self.inputs.values()), list(self.outputs.values())
        odd += len(self._paced)
        doomed: "Any" = []
        while True:
            now = self.now_ms
            while doomed:  # a reading got too old since the last step
                for node in doomed:
                    node.blind = True
                doomed.pop(0).lose_sight()
            for node in inputs:
                if node.due:
                    try:
                        node.value = node.read()
                        node.time = now
                    except Exception as error:
                        self.note(node.name, error)
            for node, timed, terms, react, port, values in self._tasks:
                news = node.due
                for key, source, age, optional in terms:
                    value = source.value
                    if source.time == now:
                        if news is None:
                            news = True
                    elif now - source.time > age:
                        if not optional:
                            if not node.blind:
                                node.lose_sight()
                            break
                        value = None
                        if values[key] is not None:
                            news = True
                    elif now - source.time > age - gap and not optional:
                        doomed.append(node)
                    values[key] = value
                else:
                    if timed is node and node.blind:
                        node.blind, news = False, True  # a guard sees at once
                    if news:
                        try:
                            if node.blind:
                                node.blind, node.saw = False, now
                                if node.first:
                                    node.first = False
                                    timed.now_ms = now
                            timed.elapsed_ms = now - timed.now_ms
                            timed.now_ms = now
                            command = react(**values)
                            if port is None or command is None:
                                node.share(command, now)
                            else:
                                port.command = command
                                port.time = now
                        except Exception as error:
                            self.note(node.name, error)
                            node.lose_sight()
            for node in outputs:
                best = node
                for port in node.ports:
                    if port.time == now:
                        if best is node:
                            best = port
                        else:
                            self.refused += 1
                if best is node.steady:
                    command = best.command
                    if command is not node.last:
                        command = node.last = node.checked(best)
                    if command is not None:
                        node.written = now
                        try:
                            node.send(command)
                        except Exception as error:
                            self.note(node.name, error)
                            node.make_safe()
                        continue
                node.settle(now)
            self.steps += 1
            if odd:
                for node in self._paced:
                    node.phase %= self._every
                self.skip(1)
                self.late -= 1  # it was not left out
            else:
                self.now_ms = now + gap
            yield

    def skip(self, steps: int) -> None:
        """Leave out steps that come too late."""
        self.late += steps
        self._debt += 1000000 * steps
        self.now_ms += self._debt // self._every
        self._debt %= self._every
        for node in self._paced:
            node.phase += node.pace * steps
            node.due = node.phase >= self._every

    def run(
        self, steps: "int | None" = None, feed: "Callable[[], Any] | None" = None
    ) -> None:
        """Open the devices and run; every exit ends with each actuator's safe command.

        Args:
            steps: How many steps; None for ever.
            feed: Called after each step: the hook for a hardware watchdog.
        """
        last = None if steps is None else self.steps + steps
        try:
            self.open()
            begin = _ticks()
            while self.steps != last:
                self.step()
                if feed:
                    feed()
                left = ((begin + self.now_ms - _ticks() + _HALF) & _MASK) - _HALF
                if left < 0:
                    self.skip(-left * self._every // 1000000)
                elif self.steps != last:
                    _sleep(left)
        finally:
            self.close()

    def open(self) -> None:
        """Open every device, and give each actuator its safe command.

        `run` does this, and the first `step`.
        """
        self.now_ms = self._debt = 0
        for node in self.inputs.values():
            node.time = _NEVER
        for wired in self._tasks:
            wired[0].first = True
            wired[0].lose_sight()
        for part in self._parts:
            part.open()
        for output in self.outputs.values():
            output.make_safe()
        self._turns = self._steps()
        self.step = self._turns.__next__  # type: ignore[method-assign]

    def close(self) -> None:
        """Give each actuator its safe command, three tries each, and close all."""
        if self._turns:
            self._turns.close()
            del self.step
        self._turns = stop = None
        for output in self.outputs.values():
            output.bad = True
        for each in list(self.outputs.values()) * 3 + self._parts:
            try:
                each.close()
            except Exception as error:
                self.note(each.name, error)
            except BaseException as error:  # Ctrl-C: the safe command first
                stop = error
        if stop:
            raise stop

    def arm(self, armed: bool = True) -> None:
        """Let actuators move from the next step on, or keep them safe."""
        self.armed = armed
        for output in self.outputs.values():
            output.steady = None

    def reset(self, name: str) -> bool:
        """Let a guard that has latched decide again; tell whether it does."""
        for wired in self._tasks:
            task = wired[0]
            if task.name == name:
                task.latched = task.latched and task.blind
                return not task.latched
        return False

    def note(self, name: str, fault: BaseException) -> None:
        """Count a fault, and print it: a line a second at most."""
        self.faults += 1
        self.fault = (name, fault)
        now = _ticks()
        if (now - self._said) & _MASK >= 1000:
            self._said = now  # a serial line is slow
            print("esair: %s: %r, fault %d" % (name, fault, self.faults))


def _less(value: "Any", most: "Any", safe: "Any") -> "Any":
    """Return a command with each number moved between that of another and of safe."""
    if isinstance(most, tuple):
        parts = map(_less, value, most, safe)
        return tuple(parts) if type(most) is tuple else type(most)(*parts)
    if value == safe or (
        type(most) is not str and min(most, safe) <= value <= max(most, safe)
    ):
        return value
    return most


def _rank(port: "Any") -> "Any":
    return -port.priority, port.name


def _ms(value: float) -> int:
    return int(value * 1000 + 0.5)


def declared(reaction: "Any") -> "Iterable[tuple[str, Any]]":
    """Return what a reaction declares to use, by attribute."""
    needs = getattr(reaction, "needs", None)  # of STD
    if not isinstance(needs, dict):
        needs = {}
        for key in dir(reaction):
            need = getattr(type(reaction), key, None)
            if isinstance(need, Need):
                needs[key] = need
    return needs.items()


def give_name(part: "Any") -> str:
    """Give a part the name of its class, in snake case, unless it has one; return it."""
    if not part.name:
        kind, found = type(part).__name__, ""
        for before, letter, after in zip("_" + kind, kind, kind[1:] + "_"):
            if letter.isupper() and (after.islower() or not before.isupper()):
                found += "_"
            found += letter.lower()
        part.name = found.replace("__", "_").strip("_")
    name: str = part.name
    return name
