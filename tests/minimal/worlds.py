"""Random robots that run in STD and in MIN: the same classes, on every interpreter.

It is imported by the tests, and copied to MicroPython as it is, so it knows nothing but
the language. A world is plain data (JSON)::

    {"sensors": [it is read in every how manyth step, ...],
     "actuators": [{"kind": one of KINDS, "timeout": in steps, "limits": as the attribute,
                    or None, "clamp": whether it clamps}, ...],
     "reactions": [{"inputs": [[sensor, max_age in steps or None], ...],
                    "outputs": [[actuator, priority, hold in steps or None], ...],
                    "every": it runs in every how manyth step, or None for each reading,
                    "dies": which reading kills it, or None,
                    "decisions": [what it decides, or None, ...]}, ...],
     "journal": [[reading of sensor 0, or None if it raises, ...], ...]}
"""

# ruff: noqa: B905, UP031 - MicroPython's language: no strict=, no formats beyond %

from collections import namedtuple

from esair.minimal import Actuator, Loop, Reaction, Sensor, reads, writes

RATE = 50.0


class Twist(namedtuple("Twist", ("linear", "angular"))):
    pass


KINDS = {"number": 0.0, "count": 0, "switch": False, "pair": (0.0, 0.0)}
KINDS["twist"] = Twist(0.0, 0.0)
"""The safe commands; the type of the others is the same."""


class Moment:
    """Which line of the journal counts."""

    line = -1


class Journal(Sensor):
    """Gives what its column of the journal says."""

    fault_limit = 1000000  # in STD it would be opened anew

    def __init__(self, number, world, moment):
        Sensor.__init__(self, "s%d" % number)
        self.number = number
        self.rate = RATE / world["sensors"][number]
        self.journal = world["journal"]
        self.moment = moment

    def read(self):
        value = self.journal[self.moment.line][self.number]
        if value is None:
            raise OSError(5)
        return value


class Recorder(Actuator):
    """Writes down what it is told."""

    def __init__(self, number, about, told):
        Actuator.__init__(self, "m%d" % number)
        self.safe = KINDS[about["kind"]]
        self.command_timeout = (about["timeout"] + 0.5) / RATE
        self.limits = about["limits"]
        self.clamp = about["clamp"]
        self.told = told

    def write(self, command):
        # As plain data: what JSON makes of a named tuple is not the same everywhere.
        self.told(self.name, tuple(command) if isinstance(command, tuple) else command)


class Decider(Reaction):
    """Decides by a table: which line of it, say the readings together."""

    decisions = ()
    dies = None
    dead = False

    def decide(self, *readings):
        number = 0
        for reading in readings:
            number = number * 3 + reading
        if number == self.dies:
            self.dead = True
        if self.dead:
            raise ValueError(number)
        return self.decisions[number % len(self.decisions)]


def special(decision, kind):
    """Make of plain data what a reaction decides."""
    if decision == "nan":
        return float("nan")
    if decision == "inf":
        return float("inf")
    if isinstance(decision, list):
        parts = [special(each, kind) for each in decision]
        return Twist(*parts) if kind == "twist" else tuple(parts)
    return decision


class One(Decider):
    def react(self, a):
        return self.decide(a)


class Two(Decider):
    def react(self, b, a):  # not in the order of the attributes
        return self.decide(a, b)


class Three(Decider):
    def react(self, c, a, b):
        return self.decide(a, b, c)


def make_reaction(number, about, actuators):
    """Make a reaction class, and one of it."""
    kinds = {}
    attributes = {"dies": about["dies"]}
    for key, (sensor, max_age) in zip("abc", about["inputs"]):
        seconds = None if max_age is None else (max_age + 0.5) / RATE
        attributes[key] = reads(int, name="s%d" % sensor, max_age=seconds)
    for key, (actuator, priority, hold) in zip("xyz", about["outputs"]):
        kinds[key] = actuators[actuator]["kind"]
        seconds = None if hold is None else (hold + 0.5) / RATE
        attributes[key] = writes(
            None, name="m%d" % actuator, priority=priority, hold=seconds
        )
    if about["every"]:
        attributes["rate"] = RATE / about["every"]
    decisions = []
    for decision in about["decisions"]:
        if isinstance(decision, dict):
            decisions.append({k: special(decision[k], kinds[k]) for k in decision})
        else:
            decisions.append(special(decision, kinds["x"]))
    attributes["decisions"] = decisions
    base = (One, Two, Three)[len(about["inputs"]) - 1]
    return type("Some", (base,), attributes)(name="r%d" % number)


def make_reactions(world):
    return [
        make_reaction(number, about, world["actuators"])
        for number, about in enumerate(world["reactions"])
    ]


def make_devices(world, moment, tell):
    """Make the sensors, and the actuators, which tell ``tell(name, command)``."""
    return (
        [Journal(i, world, moment) for i in range(len(world["sensors"]))],
        [Recorder(i, each, tell) for i, each in enumerate(world["actuators"])],
    )


def play(world):
    """Run a world in MIN; return what each actuator was told, and in which step."""
    return run(world)[1]


def run(world):
    """Run a world in MIN; return the loop, and what each actuator was told."""
    moment = Moment()
    told = {}  # type: ignore[var-annotated]

    def tell(name, command):
        told.setdefault(name, []).append([moment.line, command])

    sensors, actuators = make_devices(world, moment, tell)
    loop = Loop(make_reactions(world), sensors, actuators, rate=RATE)
    loop.open()
    for line in range(len(world["journal"])):
        moment.line = line
        loop.step()
    moment.line += 1
    loop.close()
    return loop, told
