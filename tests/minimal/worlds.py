"""Random robots that run in STD and in MIN: the same classes, on every interpreter.

It is imported by the tests, and copied to MicroPython as it is, so it knows nothing but
the language. A world is plain data (JSON)::

    {"reactions": [{"inputs": [[sensor, max_age in steps or None], ...],
                    "outputs": [[actuator, priority, hold in steps or None], ...],
                    "timed": whether it has a rate,
                    "decisions": [what it decides, or None, ...]}, ...],
     "actuators": [{"timeout": in steps, "limits": [low, high] or None}, ...],
     "journal": [[reading of sensor 0, or None if it has none, ...], ...]}
"""

from esair.minimal import Actuator, Loop, Reaction, Sensor, reads, writes

RATE = 50.0


class Moment:
    """Which line of the journal counts."""

    line = -1


class Journal(Sensor):
    """Gives what its column of the journal says."""

    def __init__(self, number, journal, moment):
        Sensor.__init__(self, "s%d" % number)
        self.number = number
        self.journal = journal
        self.moment = moment

    def read(self):
        value = self.journal[self.moment.line][self.number]
        if value is None:
            raise OSError(5)
        return value


class Recorder(Actuator):
    """Writes down what it is told."""

    safe = 0.0

    def __init__(self, number, about, told):
        Actuator.__init__(self, "m%d" % number)
        self.command_timeout = (about["timeout"] - 0.5) / RATE
        if about["limits"]:
            self.limits = tuple(about["limits"])
        self.told = told

    def write(self, command):
        self.told(self.name, command)


class Decider(Reaction):
    """Decides by a table: which line of it, say the readings together."""

    decisions = ()

    def decide(self, *readings):
        number = 0
        for reading in readings:
            number = number * 3 + reading
        decision = self.decisions[number % len(self.decisions)]
        return special(decision)


def special(decision):
    """JSON has no NaN."""
    if decision == "nan":
        return float("nan")
    if decision == "inf":
        return float("inf")
    if isinstance(decision, dict):
        return {key: special(decision[key]) for key in decision}
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


def make_reaction(number, about):
    """Make a reaction class, and one of it."""
    attributes = {}
    for key, (sensor, max_age) in zip("abc", about["inputs"]):
        seconds = None if max_age is None else (max_age - 0.25) / RATE
        attributes[key] = reads(int, name="s%d" % sensor, max_age=seconds)
    for key, (actuator, priority, hold) in zip("xyz", about["outputs"]):
        seconds = None if hold is None else (hold - 0.5) / RATE
        attributes[key] = writes(
            float, name="m%d" % actuator, priority=priority, hold=seconds
        )
    if about["timed"]:
        attributes["rate"] = RATE
    attributes["decisions"] = about["decisions"]
    base = (One, Two, Three)[len(about["inputs"]) - 1]
    return type("Some", (base,), attributes)(name="r%d" % number)


def make_reactions(world):
    return [make_reaction(i, about) for i, about in enumerate(world["reactions"])]


def play(world):
    """Run a world in MIN; return what each actuator was told, in which step."""
    moment = Moment()
    told = {}

    def tell(name, command):
        told.setdefault(name, []).append([moment.line, command])

    count = len(world["journal"][0])
    sensors = [Journal(i, world["journal"], moment) for i in range(count)]
    actuators = [Recorder(i, each, tell) for i, each in enumerate(world["actuators"])]
    loop = Loop(make_reactions(world), sensors, actuators, rate=RATE)
    loop.open()
    for line in range(len(world["journal"])):
        moment.line = line
        loop.step()
    moment.line += 1
    loop.close()
    return told
