"""A belt behind a door, and a cart that must not run into what is ahead."""

import attrs

import esair


@attrs.frozen
class Drive:
    """How the cart moves."""

    speed: float  # m/s, forward
    turn: float  # rad/s


class Door(esair.Reaction):
    """While the door is open nothing moves; only the user starts it again."""

    door = esair.reads(bool)
    belt = esair.guards(float, latch=True)

    def react(self, door: bool, belt: float) -> float | None:
        return None if door else belt


class Slow(esair.Reaction):
    """The nearer something is, the slower the cart may go on."""

    ahead = esair.reads(float, max_age=0.3)
    wheels = esair.guards(Drive)

    def react(self, ahead: float, wheels: Drive) -> Drive | None:
        most = max(0.0, 0.5 * (ahead - 0.3))
        return attrs.evolve(wheels, speed=min(wheels.speed, most))

    def blind(self, wheels: Drive) -> Drive | None:
        return attrs.evolve(wheels, speed=min(wheels.speed, 0.0))  # back off, or turn
