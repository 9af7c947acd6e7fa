"""Subsumption: layers by priority; the highest that has an opinion moves the wheels.

bumper  ----------##----
sonar   ------####------
wheels  WWWWWWAAAABBWWWW
"""

import esair


class Wander(esair.Reaction):
    """The lowest layer: it always wants something."""

    rate = 10.0
    wheels = esair.writes(str)

    def react(self) -> str:
        return "wander"


class Avoid(esair.Reaction):
    """Above it: turns away from what is near."""

    sonar = esair.reads(bool)
    wheels = esair.writes(str, priority=10)

    def react(self, sonar: bool) -> str | None:
        return "avoid" if sonar else None


class Bump(esair.Reaction):
    """On top: backs off from what it touches."""

    bumper = esair.reads(bool)
    wheels = esair.writes(str, priority=20)

    def react(self, bumper: bool) -> str | None:
        return "back" if bumper else None


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    return esair.Robot(resources=parts, behaviors=[Wander(), Avoid(), Bump()])
