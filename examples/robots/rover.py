"""A rover that is driven by hand: a dead man's button, and a guard against obstacles."""

import esair
from esair.drivers.gamepad import Pad


class Teleop(esair.Reaction):
    """Drive as the stick says; it says nothing while the button is not held."""

    pad = esair.reads(Pad, max_age=0.3)
    left = esair.writes(float, priority=50)
    right = esair.writes(float, priority=50)

    def react(self, pad: Pad) -> dict[str, float]:
        forward, turn = 0.6 * pad.axis("y"), 0.4 * pad.axis("x")
        return {"left": forward + turn, "right": forward - turn}


class KeepClear(esair.Reaction):
    """A wheel turns ahead only as fast as the rover can still stop; blind, only back."""

    ahead = esair.reads(float, max_age=0.3)
    wheel = esair.guards(float)

    def react(self, ahead: float, wheel: float) -> float:
        return min(wheel, max(0.0, 0.8 * (ahead - 0.2)))

    def blind(self, wheel: float) -> float:
        return min(wheel, 0.0)
