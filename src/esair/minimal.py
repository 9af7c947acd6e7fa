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

# ruff: noqa: A002, B905, SLF001, UP031, UP037
# MicroPython knows less of the language: what is newer is not used here.

# MicroPython's compiler knows the word `const`: it takes the number itself, and leaves
# out what is never run. So what only a computer needs takes no memory of a board.
const: "Any" = str
_COMPUTER = const(0)
if _COMPUTER:
    const = int
    TYPE_CHECKING = False
    if TYPE_CHECKING:
        from collections.abc import Callable, Generator, Iterable
        from typing import Any, Literal

_ENDS = (-1e999, 1e999)  # infinite
_ROWS = (tuple, list)

# Moments are whole milliseconds since the start, less the "days" that are over: for
# greater numbers a board takes memory from its heap. Its clock wraps at four days.
_DAY = const(0x10000000)
_MASK = const(0xFFFFFFF)
_LONGEST = const(0x100000)  # period
_NEVER = const(-0x20000001)

if _COMPUTER:
    import time

    def _ticks() -> int:
        return time.monotonic_ns() // 1000000

    def _sleep(value: int) -> None:
        time.sleep(value / 1000)

else:
    from time import sleep_ms as _sleep, ticks_ms as _ticks  # type: ignore # noqa: I001, PGH003


class Need:
    """What a reaction declares to use; made by `reads`, `writes` and `guards`."""

    type: "Any"
    name: "str | None"
    configure: bool
    max_age: "float | None"
    every: bool
    optional: bool
    priority: int
    hold: "float | None"
    blind: "Literal['safe', 'release']"
    latch: bool


def reads(
    type: "Any" = None,
    name: "str | None" = None,
    max_age: "float | None" = None,
    every: bool = False,
    optional: bool = False,
    configure: bool = False,
) -> Need:
    """Declare, as a class attribute, that a reaction reads a sensor; as `esair.reads`."""
    need = Need()
    need.name, need.max_age, need.optional = name, max_age, optional
    if _COMPUTER:
        need.type, need.every, need.configure = type, every, configure
    return need


def writes(
    type: "Any" = None,
    name: "str | None" = None,
    priority: int = 0,
    hold: "float | None" = None,
    blind: "Literal['safe', 'release']" = "safe",
    configure: bool = False,
) -> Need:
    """Declare that a reaction writes an actuator; as `esair.writes`."""
    need = Need()
    need.name, need.priority = name, priority
    need.hold, need.blind = hold, blind
    if _COMPUTER:
        need.type, need.configure = type, configure
    return need


def guards(
    type: "Any" = None,
    name: "str | None" = None,
    priority: int = 0,
    latch: bool = False,
) -> Need:
    """Declare that every command for an actuator passes a reaction; as `esair.guards`."""
    need = Need()
    need.name, need.priority, need.latch = name, priority, latch
    if _COMPUTER:
        need.type, need.configure = type, False
    return need


class _Part:
    """Something with a name."""

    name: str = ""
    rate: "float | None" = None

    def __init__(self, name: "str | None" = None) -> None:
        self.name = name or self.name
        give_name(self)

    def open(self) -> None:
        """Make a device ready. What it raises ends the program, at its start."""

    if _COMPUTER:

        def close(self) -> None:
            """Let a device go."""

    else:
        close = open  # noqa: A003


class Sensor(_Part):
    """A device that gives values.

    Args:
        name: Its name; the class name in snake case unless given.
    """

    rate: "float | None"
    """How often it is read, in Hz; None for every step of the loop."""

    if _COMPUTER:

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

    if _COMPUTER:

        def write(self, command: "Any") -> "Any":
            """Send a command to the device; it is checked already."""
            raise NotImplementedError


class Reaction(_Part):
    """One small decision each step, on the newest readings.

    It runs in each step with a new reading of one of its sensors, or at a fixed
    ``rate``. While a reading that it needs is missing or too old, or after it has raised
    or wanted what is no command, it is blind: what it may write is safe, unless a higher
    priority moves it.

    Args:
        name: Its name; the class name in snake case unless given.
    """

    rate: "float | None"
    """How often it runs, in Hz; None to run on every new reading."""

    now_ms: int
    """The moment of this step, in whole milliseconds since the robot started.

    On a board that is 12 days old each look at it takes 64 bytes of memory.
    """

    elapsed_ms: int = 0
    """Milliseconds since its previous step; 0 at the first."""

    _days = _ms = 0

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
    """A sensor, if it is due in this step, its newest value, and the time of that."""

    name: str
    _ms: int

    def __init__(self, loop: "Any", part: "Any") -> None:
        self.due = True
        self.value: "Any" = None
        self.last: "Any" = None
        self.read = part.read
        loop.insert(self, part, loop.inputs)


class _Task:
    """A reaction, its ports by attribute, and its turn: at news if ``due`` is None."""

    blind: bool
    elapsed_ms = _ms = 0

    def __init__(self, loop: "Any", reaction: "Any") -> None:
        self.due: "Any" = reaction.rate  # always, or at news if it is None
        self.reaction, self.said = reaction, self
        if _COMPUTER:
            vars(reaction).pop("now_ms", None)  # of STD
        self.ports: "Any" = {}
        self.values: "Any" = {}
        loop.insert(self, reaction)
        timed, react = reaction, reaction.react
        terms: "Any" = []
        port: "Any" = self
        for key, need in declared(reaction):
            name = need.name or key
            if hasattr(need, "max_age"):
                source = loop.inputs[name]
                age = need.max_age or 3000 / min(source.pace, loop.every)
                terms.append((key, source, _ms(age), need.optional))
            else:
                port = self.ports[key] = _Port(self, key, need, loop.outputs[name])
                loop.ages.append(port)
                if hasattr(need, "latch"):
                    timed, react = self, self.wake
        if len(self.ports) > 1:
            port = self
        place = len(loop.tasks) if timed is self else 0  # guards last
        loop.tasks.insert(place, (self, timed, terms, react, port, self.values))

    def dark(self) -> None:
        """Be blind: whatever it moves, or bars, is safe until it sees again."""
        if not self.blind:
            self.blind = True
            self.wake()

    def wake(self, **readings: "Any") -> None:
        """Let what it writes or guards be looked at closely."""
        for port in self.ports.values():
            port.output.sure = None
            port._ms = -1
            if hasattr(port, "latch"):
                port.output.due = True

    def ask(self, said: "Any", now: int) -> None:
        """Ask for what a reaction has said for each of its ports, as one port does."""
        for key in said or ():
            self.ports[key]  # it raises for what is none of its ports
        for key in self.ports:  # without `items`: those are made each time
            self.ports[key].ask(None if said is None else said.get(key), now)


class _Port:
    """What one reaction may do with one actuator, and what it has asked for, and when.

    It asked for ``said``; ``command`` is that as it may be sent. While its reaction is
    blind it keeps away the priority ``bar``, and less.
    """

    _ms: int
    command: "Any"
    bar = _ENDS[0]
    shut = False

    def __init__(self, task: "Any", key: str, need: "Any", output: "Any") -> None:
        self.said: "Any" = self
        self.task, self.key, self.output = task, key, output
        self.priority = need.priority
        if hasattr(need, "latch"):
            self.latch, beside = need.latch, output.guards
        else:
            self.hold = _ms(need.hold or 0) or output.hold
            if (_COMPUTER and not need.blind) or need.blind == "safe":
                self.bar = need.priority
            beside = output.ports
        beside.append(self)

        def priority(port: "Any") -> "Any":  # it has a name already, a lambda has not
            return -port.priority, port.task.name

        beside.sort(key=priority)

    def ask(self, said: "Any", now: int) -> None:
        """Ask for a command; None gives the actuator back. Raise for a bad one."""
        if said is None:
            if self.output.holder is self:
                self.output.holder = None
        elif said.__class__ is dict:
            self.task.ask(said, now)
        else:
            self.command = self.output.checked(said)
            self.said, self._ms = said, now

    def checked(self, command: "Any") -> "Any":
        """Return what a guard lets pass of a command: None, or never more than it."""
        task, output = self.task, self.output
        timed, now, passed = task.reaction, output.loop._ms, None
        if self.shut:
            return None
        try:
            if not task.blind:
                timed.elapsed_ms = now - timed._ms if timed.elapsed_ms >= 0 else 0
                timed._ms = now
                task.values[self.key] = command
                passed = timed.react(**task.values)
            elif not self.latch:
                passed = timed.blind(command)
            elif not output.writer or output.last == output.safe:
                return None
            if passed is not None:
                if passed is not command:
                    passed = output.checked(passed)
                    if passed != _less(passed, command, output.safe):
                        raise ValueError("more", passed)
                return passed
        except Exception as error:
            output.loop.note(task.name, error)
        self.shut = self.latch
        return None


class _Output:
    """An actuator, and whose will it does."""

    name: str
    writer: "Any"  # the port whose command stands; None if it is safe
    last: "Any"  # that command
    _ms: int  # when it was sent
    holder: "Any"  # the port that keeps lower priorities away
    sure: "Any"  # the writer, if nothing can be in its way
    bad: bool  # it has not taken its safe command
    due = False  # a guard sees something new

    def __init__(self, loop: "Any", part: "Any") -> None:
        self.loop, self.write = loop, part.write
        loop.insert(self, part, loop.outputs)
        loop.parts.append(self)
        self.safe, self.type = part.safe, part.safe.__class__
        self.hold = _ms(part.command_timeout)
        self.clamp, limits = part.clamp, part.limits or {}
        self.limits = limits if isinstance(limits, dict) else {"": limits}
        self.ports: "Any" = []
        self.guards: "Any" = []

    def checked(self, command: "Any") -> "Any":
        """Return a command of somebody as it may be sent; raise if it is a fault."""
        # With one more name, or a `try`, its frame would be taken from the heap.
        if command.__class__ is not self.type or self.limits:
            command = self.fit(command)
        _check(command, _ENDS)
        return command

    def fit(self, command: "Any") -> "Any":
        """Return a command in the type and the limits of the actuator, or raise."""
        kind = self.type
        if kind is float and command.__class__ is int:
            command = kind(command)
        elif not isinstance(command, kind) or (
            command.__class__ is bool and kind is int
        ):
            raise ValueError("type", command)
        for field in self.limits:
            low, high = self.limits[field]
            each = getattr(command, field) if field else command
            if not low <= each <= high:
                if not self.clamp or each - each != 0:  # no clamp is for NaN
                    raise ValueError("limits", command)
                command = kind(low if each < low else high)
        return command

    def step(self, now: int, late: int = 0) -> None:
        """Do the will of the best who asks, as it is by now, or was so much before."""
        self.close()
        if self.bad:
            return
        loop, holder, age = self.loop, self.holder, now - late - self._ms
        self.sure = best = None
        bar = _ENDS[not loop.armed]
        over = not holder or age >= holder.hold
        for port in self.ports:
            if port.task.blind:
                bar = max(bar, port.bar)
                if port is self.writer:
                    self.writer = None
                if port is holder:
                    holder = None
            elif port._ms == now and (
                not best
                or (port is holder and not over and port.priority == best.priority)
            ):
                best = port
        if (
            bar > _ENDS[0]
            and self.writer
            and self.last != self.safe
            and (not holder or age > holder.hold or holder.priority <= bar)
        ):
            holder = self.writer = None
            for guard in self.guards:  # it has moved until this moment
                guard.shut |= guard.latch & guard.task.blind
        still = best and best.priority <= bar and best.command == self.safe
        if still:
            bar = _ENDS[0]  # what is safe passes who is blind, and holds nothing
        if over:
            holder = None
        if holder and best is not holder:
            bar = max(bar, holder.priority)
        self.holder = holder
        if not best or best.priority <= bar:
            loop.refused += not not best  # noqa: SIM208 - the smallest
            best = still = None
        elif not still:
            self.holder, self._ms, age = best, now, 0
            if not self.guards:
                self.sure = best
        if age >= self.hold:
            self.writer = None  # before a guard looks at what it stopped
        if still:
            self.tell(self.writer and self.safe, self.writer)
        elif best or (self.due and self.last != self.safe):
            self.ask(best)
        if self.last is not None and not self.writer:
            self.tell()

    def ask(self, port: "Any") -> None:
        """Send what the guards let pass: of a new command, or less of what stands."""
        self.due = stop = False
        writer = port or self.writer
        if writer:
            command = writer.command
            for guard in self.guards:
                if not stop or guard.latch:  # one more keeps no latch open
                    passed = guard.checked(command)
                    stop = stop or passed is None
                    if not stop:
                        command = passed
            if stop:
                self.loop.refused += not not port  # noqa: SIM208 - the smallest
                self.writer = None
            else:
                if not port:
                    command = _less(command, self.last, self.safe)
                if port or command != self.last:
                    self.tell(command, writer)

    def tell(self, command: "Any" = None, writer: "Any" = None) -> None:
        """Send a command of somebody, or the safe one if it is nobody's."""
        # Safe is tried again at each step, and no other command goes before it.
        self.writer, self.last, self.bad = writer, command, not writer
        if self.bad:
            self.sure, command = None, self.safe
        try:
            self.write(command)
            self.bad = False
        except Exception as error:
            self.loop.note(self.name, error)
            if not self.bad:
                self.open()

    def open(self) -> None:
        """Begin anew: nobody holds it, and it is safe."""
        self.holder = None
        self.tell()

    def close(self) -> None:
        """Send the safe command, unless it has taken it already."""
        if self.bad:
            self.tell()


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

    now_ms: int
    steps: int
    late: int = 0
    refused: int = 0
    faults: int = 0
    _days = _ms = last = phase = said = 0
    fault: "Any"
    _run: "Any"
    fault = _run = None

    def __init__(
        self,
        reactions: "Iterable[Any]" = (),
        sensors: "Iterable[Any]" = (),
        actuators: "Iterable[Any]" = (),
        rate: float = 50,
        armed: bool = True,
    ) -> None:
        self.armed: bool = armed
        self.say: "Callable[[str], Any]" = print
        self.inputs: "Any" = {}
        self.outputs: "Any" = {}
        self.every: int = _ms(rate)  # steps in 1000 s
        self.pace: "Any" = []  # who has one of its own
        self.parts: "Any" = []
        self.ages: "Any" = [self]
        self.tasks: "Any" = []
        for part in actuators:
            _Output(self, part)
        for part in sensors:
            _Input(self, part)
        for reaction in reactions:
            _Task(self, reaction)

    def insert(self, task: "Any", part: "Any", parts: "Any" = None) -> None:
        """Take a part in, under its name, and give it its turns if it is a slow one."""
        task.name = give_name(part)
        aged = part
        if parts is not None:
            parts[task.name] = aged = task
            if not _COMPUTER or isinstance(part, _Part):  # one of STD opens elsewhere
                self.parts.append(part)
        self.ages.append(aged)
        if _COMPUTER and not hasattr(part, "rate"):  # an actuator of STD
            part.rate = None
        task.pace = _ms(part.rate) if part.rate else self.every
        if task.pace < self.every:
            task.phase = self.every
            self.pace.append(task)

    def step(self) -> None:
        """Make one step, for tests and for boards with a loop of their own.

        Time is counted in periods: such a loop calls `skip` when it has missed some,
        and `close` at its end.
        """
        if not self._run:
            self.open()
        self._run()

    def _steps(self) -> "Generator[None]":
        """Make a step each time: a generator has at hand what it works with."""
        paced, every = self.pace, self.every
        gap, odd = divmod(1000000, every)
        inputs, outputs = list(self.inputs.values()), list(self.outputs.values())
        dark: "Any" = []  # who is blind, or will be before the next step
        while True:
            try:
                now = self._ms
                while now >> 28:  # a day is over
                    self.said = 0
                    for node in self.ages:
                        node._days += 1
                        node._ms = max(node._ms - _DAY, _NEVER)
                    now = self._ms
                for node in paced:
                    node.due = node.phase >= every
                    node.phase %= every
                while dark:  # as it was since the last step, before anybody sees again
                    for node in dark:
                        node.dark()
                    for port in dark.pop(0).ports.values():  # reactions, then guards
                        port.output.step(now, 1)
                for node in inputs:
                    if node.due:
                        try:
                            value = node.read()
                            if value is not node.last:
                                node.last = _check(value)
                                node.value = value
                            node._ms = now
                        except Exception as error:
                            self.note(node.name, error)
                for node, timed, terms, react, port, values in self.tasks:
                    news = node.due
                    for key, source, age, optional in terms:
                        value, old = source.value, now - source._ms
                        if not old:
                            if news is None:
                                news = True
                        elif optional:
                            if old > age:
                                value = None
                                if news is None and values.get(key) is not None:
                                    news = True
                        elif old > age - gap:
                            dark.append(node)
                            if old > age:
                                node.dark()
                                break
                        values[key] = value
                    else:
                        if timed is node and node.blind:
                            news = True  # a guard sees at once
                        if news:
                            try:
                                if node.blind:
                                    node.blind = False
                                    if timed.elapsed_ms < 0:
                                        timed._ms = now
                                timed.elapsed_ms = now - timed._ms
                                timed._ms = now
                                command = react(**values)
                                if command is port.said:
                                    port._ms = now
                                else:
                                    port.ask(command, now)
                            except Exception as error:
                                self.note(node.name, error)
                                node.dark()
                                dark.append(node)
                        elif node.blind:
                            dark.append(node)
                for node in outputs:
                    best = node
                    for port in node.ports:
                        if port._ms == now:
                            if best is node:
                                best = port
                            else:
                                self.refused += 1
                    if best is node.sure:
                        node._ms = now
                        node.last = value = best.command
                        try:
                            node.write(value)
                        except Exception as error:
                            self.note(node.name, error)
                            node.open()
                    else:
                        node.step(now)
                if odd or paced:
                    self.skip(1)
                    self.late -= 1  # it was not left out
                else:
                    self._ms = now + gap
            except BaseException:  # it cannot go on
                self.close()
                raise
            yield

    def skip(self, steps: int) -> None:
        """Leave out steps that come too late."""
        self.late += steps
        self.phase += 1000000 * steps
        self._ms += self.phase // self.every
        self.phase %= self.every
        for node in self.pace:
            node.phase += node.pace * steps

    def run(
        self, steps: "int | None" = None, feed: "Callable[[], Any] | None" = None
    ) -> None:
        """Open the devices and run; every exit ends with each actuator's safe command.

        Args:
            steps: How many steps; None for ever.
            feed: Called after each step: the hook for a hardware watchdog.
        """
        try:
            try:
                self.open()
                begin = _ticks() - _LONGEST
                while steps != 0:
                    self.step()
                    if steps:
                        steps -= 1
                    if feed:
                        feed()
                    # It may sleep too long.
                    while (
                        late := (_ticks() - begin - self._ms & _MASK) - _LONGEST
                    ) < 0:
                        _sleep(-late)
                    self.skip(late * self.every // 1000000)
            finally:
                self.close()
        finally:  # Ctrl-C may have come once more, before that could begin
            self.close()

    def open(self) -> None:
        """Open every device, and give each actuator its safe command.

        `run` does this, and the first `step`.
        """
        self.last = self.steps + self.late  # the times begin anew
        self.phase = self.said = 0
        for node in self.ages:
            node._days = 0
            node._ms = _NEVER if isinstance(node, _Input) else 0
        for task, *_ in self.tasks:
            task.reaction.elapsed_ms = -1
            task.blind = True
            task.wake()
        self.step = self._run = self._steps().__next__  # type: ignore[method-assign]
        failed: "Any" = None
        for part in self.parts:  # actuators first, each made safe on its own
            try:
                part.open()
            except Exception as error:
                failed = error
        if failed:
            self.close()
            raise failed

    def close(self) -> None:
        """Give each actuator its safe command, three tries each, and close all.

        What is closed already stays as it is.
        """
        if not self._run:
            return
        stop = None
        outputs = list(self.outputs.values())
        for each in outputs:
            each.bad = True
        for each in outputs * 3 + self.parts:
            try:
                each.close()
            except BaseException as error:
                if isinstance(error, Exception):
                    self.note(each.name, error)
                else:  # Ctrl-C: the safe command first
                    stop = error
        self._run = None
        del self.step
        if stop:
            raise stop

    def arm(self, armed: bool = True) -> None:
        """Let actuators move from the next step on, or keep them safe."""
        self.armed = armed
        for output in self.outputs.values():
            output.sure = None

    def reset(self, name: str) -> bool:
        """Let a guard that has shut decide again; tell whether it does."""
        for port in self.ages:
            if hasattr(port, "latch") and port.task.name == name:
                port.shut = port.shut and port.task.blind
                return not port.shut
        return False

    def note(self, name: str, fault: BaseException) -> None:
        """Count a fault, and print it: a line a second at most."""
        self.faults += 1
        self.fault = (name, fault)
        if self._ms >= self.said:  # until then enough was said
            self.said = self._ms + 1000
            self.say("esair: %s: %r, fault %d" % (name, fault, self.faults))


def _clock(self: "Any", name: str) -> int:
    """Return the time of a node: a number that is made only when somebody asks."""
    now: int = (self._days << 28) + self._ms
    if name == "steps":
        now = (now * self.every + self.phase) // 1000000  # periods
        return self.last + now - self.late  # type: ignore[no-any-return]
    if name != "now_ms":
        raise AttributeError(name)
    return now


Reaction.__getattr__ = Loop.__getattr__ = _clock  # type: ignore[attr-defined]


def _check(value: "Any", limits: "Any" = ()) -> "Any":
    """Return a finite number, no value for a row, which may change; raise for NaN.

    In a row of readings, such as a scan, infinity stands for "nothing in reach".
    """
    if isinstance(value, _ROWS):
        deep = not limits  # commands are flat
        if deep and value.__class__ not in _ROWS:  # each is a field
            limits = _ENDS
        for each in value:
            if isinstance(each, _ROWS):
                if not deep:
                    break
                _check(each)
            elif each != each or each in limits:
                break
        else:
            return _ROWS  # what no sensor gives
    elif value == value and value not in _ENDS:
        return value
    raise ValueError("finite", value)


def _less(value: "Any", command: "Any", safe: "Any") -> "Any":
    """Return a value with each number moved between that of a command and of safe."""
    if isinstance(command, tuple):
        parts = map(_less, value, command, safe)
        kind = command.__class__
        return tuple(parts) if kind is tuple else kind(*parts)
    if value != safe and (
        command.__class__ is str
        or not min(command, safe) <= value <= max(command, safe)
    ):
        return command
    return value


def _ms(value: float) -> int:
    return round(value * 1000)


def declared(reaction: "Any") -> "Any":
    """Return what a reaction declares to use, by attribute."""
    needs: "Any" = {}
    kind = reaction.__class__
    if _COMPUTER:
        needs = getattr(reaction, "needs", needs)  # of STD
    for key in dir(kind):
        need = getattr(kind, key, None)
        if need.__class__ is Need:
            needs[key] = need
    return needs.items()


def give_name(part: "Any") -> str:
    """Give a part the name of its class, in snake case, unless it has one; return it."""
    name: str = part.name
    if not name:
        kind = part.__class__.__name__
        for before, letter, after in zip("_" + kind, kind, kind[1:] + "_"):
            if (
                letter.isupper()
                and before != "_"
                and (after.islower() or not before.isupper())
            ):
                name += "_"
            name += letter.lower()
        part.name = name = name.strip("_")
    return name
