"""What an actuator gets, for each state, blindness and asker: run in MIN or its plain form."""

from esair.minimal import Actuator, Reaction, Sensor, reads, writes

SAYS = {"low": 0.125, "mid": 0.5, "high": 1.0}
STATES = {"nobody": None, "mid, its hold runs": 1, "mid, its hold ended": 8}
STATES["mid, its time is out"] = 20
"""Who stands, and so many steps ago it asked."""


class Eye(Sensor):
    due = True

    def read(self):
        if not self.due:
            raise OSError(5)
        return 1


class Wheel(Actuator):
    safe = 0.0
    command_timeout = 0.3
    now = None

    def write(self, command):
        self.now = command


class Mind(Reaction):
    act = None

    def react(self, eye):
        if self.act == "blind":
            raise ValueError(self.name)
        return self.act


def mind(name, priority):
    ports = {
        "eye": reads(int, name=name + "_eye", max_age=60.0),
        "wheel": writes(float, priority=priority, hold=0.1),
    }
    return type("Some", (Mind,), ports)(name)


def outcome(loop_class, state, blind, asks):
    """Return what the wheel has at the end, in the words of the table."""
    minds = {"low": mind("low", 1), "mid": mind("mid", 5), "high": mind("high", 10)}
    eyes = {name: Eye(name + "_eye") for name in minds}
    wheel = Wheel()
    loop = loop_class(list(minds.values()), list(eyes.values()), [wheel], rate=50)
    loop.open()
    ago = STATES[state]
    minds["mid"].act = None if ago is None else -0.5
    loop.step()  # each decides once: nobody is blind
    for eye in eyes.values():
        eye.due = False
    for _ in range((ago or 1) - 1):
        loop.step()
    for name, reaction in minds.items():
        if name in (blind, asks):
            eyes[name].due = True
            reaction.act = "blind" if name == blind else SAYS[name]
    loop.step()
    words = {0.0: "safe", -0.5: "goes on", 0.125: "low", 0.5: "mid", 1.0: "high"}
    return words[wheel.now or 0.0]
