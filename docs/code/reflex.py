"""Two reflexes for a computer and for a microcontroller."""

from esair.minimal import Reaction, reads, writes


class Stop(Reaction):
    """Stand still while something is near."""

    near = 0.3
    """What is near, in metres."""

    sonar = reads(float, max_age=0.5)
    wheels = writes(float, priority=10)

    def react(self, sonar: float) -> "float | None":
        return 0.0 if sonar < self.near else None


class Cruise(Reaction):
    """Drive on."""

    rate = 20.0
    wheels = writes(float)

    def react(self) -> float:
        return 0.5
