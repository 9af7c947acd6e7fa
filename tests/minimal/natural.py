"""Robots as people wire them, drawn at random: the same classes on every interpreter.

Nothing is aligned: reactions with and without a rate stand beside each other, sensors are
read at rates of their own and are lost for a while, commands are floats and tuples, time
is taken from ``now_ms`` and ``elapsed_ms``, guards weaken what passes. It is imported by
the tests, and copied to MicroPython as it is, so it knows nothing but the language.

A world is plain data (JSON)::

    {"steps": how many, "sensors": [{"rate": in Hz or None, "values": [one for each time
     it is read, None if it raises, ...]}, ...],
     "actuators": [{"kind": one of KINDS, "timeout": in seconds, "limits": "", "refuse" or
     "clamp"}, ...],
     "reactions": [{"kind": one of REACTIONS, "rate": in Hz or None, "inputs": [[sensor,
     max_age], ...], "outputs": [[actuator, priority, hold, blind, latch], ...]}, ...]}
"""

# ruff: noqa: B905, UP031 - MicroPython's language: no strict=, no formats beyond %

from esair.minimal import Actuator, Loop, Reaction, Sensor, guards, reads, writes

RATE = 50

KINDS = {"number": 0.0, "pair": (0.0, 0.0), "count": 0}
"""The safe commands; the type of the others is the same."""


class Given(Sensor):
    """Gives the next value at each reading; keeps the last one at the end."""

    fault_limit = 1000000  # in STD it would be opened anew

    def __init__(self, number, about):
        Sensor.__init__(self, "s%d" % number)
        self.rate = about["rate"]
        self.values = about["values"]
        self.asked = 0

    def read(self):
        value = self.values[min(self.asked, len(self.values) - 1)]
        self.asked += 1
        if value is None:
            raise OSError(5)
        return value


class Told(Actuator):
    """Writes down what it is told."""

    def __init__(self, number, about, tell):
        Actuator.__init__(self, "m%d" % number)
        self.safe = KINDS[about["kind"]]
        self.command_timeout = about["timeout"]
        if about["limits"]:
            self.limits = (-0.8, 0.8)
            self.clamp = about["limits"] == "clamp"
        self.tell = tell

    def write(self, command):
        self.tell(self.name, command)


class Natural(Reaction):
    """Answers in the type of its actuator."""

    number = 0

    def as_command(self, value):
        kind = self.kinds[0]
        if kind == "pair":
            return (value, -0.5 * value)
        # Not at the border of two integers, where rounding would decide.
        return int(value * 10 + 0.0501) if kind == "count" else value


class Follow(Natural):
    """In proportion; no opinion when far away."""

    def react(self, a):
        return None if a > 1.6 else self.as_command(0.3 * a)


class Avoid(Natural):
    """Turns away from what is near, with hysteresis."""

    near = False

    def react(self, a):
        self.near = a < (0.9 if self.near else 0.6)
        return self.as_command(-0.4) if self.near else None


class Sum(Natural):
    """Counts how long it was near, in milliseconds, and acts on that."""

    near_ms = 0

    def react(self, a):
        self.near_ms = self.near_ms + self.elapsed_ms if a < 0.9 else 0
        return self.as_command(0.001 * self.near_ms) if self.near_ms > 90 else None


class Back(Natural):
    """Goes back for 300 ms after a bump."""

    until = -1

    def react(self, a):
        if a < 0.35:
            self.until = self.now_ms + 300
        return self.as_command(-0.7) if self.now_ms < self.until else None


class Fuse(Natural):
    """Takes the mean of two."""

    def react(self, b, a):
        return self.as_command(0.25 * (a + b) + 0.05 * a)


class Maybe(Natural):
    """Goes on without the second."""

    def react(self, a, b):
        return self.as_command(0.2 * a if b is None else 0.1 * b)


class Both(Natural):
    """Moves two actuators, or one of them."""

    def react(self, a):
        if a > 1.8:
            return None
        found = {"x": self.as_command(0.5 * a)}
        if a < 1.2:
            value = 0.25 * a
            found["y"] = value if self.kinds[1] == "number" else (value, value)
        return found


class Wrong(Natural):
    """Wants what is bad by itself when near: no number, the wrong type, too much."""

    def react(self, a):
        if a > 0.9:
            return self.as_command(0.4 * a)
        return "x" if a < 0.5 else float("nan") if a < 0.7 else 0.9


class Half(Natural):
    """Moves two actuators; for one of them what it wants is bad when near."""

    def react(self, a):
        found = {"x": self.as_command(0.5 * a), "y": None}
        if a < 1.2:
            value = float("inf") if a < 0.8 else 0.25 * a
            found["y"] = value if self.kinds[1] == "number" else (value, value)
        return found


class Slower(Natural):
    """A guard: no more than what is near allows."""

    def react(self, a, x):
        if a < 0.3:
            return None
        return part(x, 1.0 if a > 1.2 else 0.5)

    def blind(self, x):
        return part(x, 0.25)


class Stops(Natural):
    """A guard that lets nothing pass for 100 ms after something near."""

    until = -1

    def react(self, a, x):
        if a < 0.5:
            self.until = self.now_ms + 100
        return None if self.now_ms < self.until else x


def part(command, share):
    """Return that much of a command."""
    if isinstance(command, tuple):
        return tuple([each * share for each in command])
    return int(command * share) if isinstance(command, int) else command * share


KNOWN = Follow, Avoid, Sum, Back, Fuse, Maybe, Both, Wrong, Half, Slower, Stops
REACTIONS = {each.__name__: each for each in KNOWN}


def make_reaction(number, about, actuators):
    cls = REACTIONS[about["kind"]]
    attributes = {"rate": about["rate"]}
    for key, (sensor, max_age) in zip("ab", about["inputs"]):
        optional = cls is Maybe and key == "b"
        attributes[key] = reads(
            float, name="s%d" % sensor, max_age=max_age, optional=optional
        )
    kinds = []
    for key, (actuator, priority, hold, blind, latch) in zip("xy", about["outputs"]):
        kinds.append(actuators[actuator]["kind"])
        name = "m%d" % actuator
        if cls in (Slower, Stops):
            attributes[key] = guards(None, name=name, priority=priority, latch=latch)
        else:
            attributes[key] = writes(
                None, name=name, priority=priority, hold=hold, blind=blind
            )
    attributes["kinds"] = kinds
    return type("Some", (cls,), attributes)("r%d" % number)


def make_parts(world, tell):
    """Make the reactions, the sensors, and the actuators, which tell."""
    actuators = world["actuators"]
    return (
        [
            make_reaction(i, each, actuators)
            for i, each in enumerate(world["reactions"])
        ],
        [Given(i, each) for i, each in enumerate(world["sensors"])],
        [Told(i, each, tell) for i, each in enumerate(actuators)],
    )


def play(world):
    """Run a world in MIN; return what each actuator was told, and when, in ms."""
    told = {}  # type: ignore[var-annotated]
    loops = []  # type: ignore[var-annotated]

    def tell(name, command):
        told.setdefault(name, []).append([loops[0].now_ms, command])

    reactions, sensors, actuators = make_parts(world, tell)
    loops.append(Loop(reactions, sensors, actuators, rate=RATE))
    for _ in range(world["steps"]):
        loops[0].step()
    return told
