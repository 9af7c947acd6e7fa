"""A rover keeps its distance from a wall. It has a mistake: see find-out-why.md."""

import itertools

import esair


class Sonar(esair.Sensor[float]):
    """Distance to the wall in metres; now and then it misses an echo."""

    rate = 20.0

    def __init__(self) -> None:
        super().__init__()
        self._echoes = itertools.chain(
            [1.2, 1.0, 0.8, 0.6, 0.5, 0.4, 4.0, 0.35, 0.3], itertools.repeat(0.3)
        )

    async def read(self) -> float:
        return next(self._echoes)


class Wheel(esair.Actuator[float]):
    """Speed in m/s."""

    safe = 0.0
    limits = (0.0, 1.0)
    command_timeout = 0.5

    async def write(self, command: float) -> None:
        """It pretends to drive."""


class Keep(esair.Reaction):
    """The farther the wall, the faster; half a metre from it, stop."""

    rate = 20.0
    sonar = esair.reads(float)
    wheel = esair.writes(float)

    def react(self, sonar: float) -> float:
        return max(0.0, min(1.0, sonar - 0.5))
