"""A rover that is driven by hand: a dead man's button, and a guard against obstacles."""

import attrs

import esair
from esair.drivers.gamepad import Pad


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


class Teleop(esair.Reaction):
    """Drive as the stick says; it says nothing while the button is not held."""

    pad = esair.reads(Pad, max_age=0.3)
    wheels = esair.writes(Twist, priority=50)

    def react(self, pad: Pad) -> Twist:
        return Twist(0.6 * pad.axis("y"), -1.5 * pad.axis("x"))


class KeepClear(esair.Reaction):
    """As fast ahead as the rover can still stop; blind, it may only back off."""

    ahead = esair.reads(float, max_age=0.3)
    wheels = esair.guards(Twist)

    def react(self, ahead: float, wheels: Twist) -> Twist:
        most = max(0.0, 0.8 * (ahead - 0.2))
        return attrs.evolve(wheels, linear=min(wheels.linear, most))

    def blind(self, wheels: Twist) -> Twist:
        return attrs.evolve(wheels, linear=min(wheels.linear, 0.0))
