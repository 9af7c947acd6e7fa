"""Follow a black line with two sensors and two motors."""

import esair


class Follow(esair.Reaction):
    """Turn to the side that sees the line; straight on between both."""

    left_line = esair.reads(bool)
    right_line = esair.reads(bool)
    left = esair.writes(float)
    right = esair.writes(float)
    rate = 50

    def react(self, left_line: bool, right_line: bool) -> dict[str, float]:
        return {
            "left": 0.1 if left_line else 0.4,
            "right": 0.1 if right_line else 0.4,
        }


class ClearLeft(esair.Reaction):
    """Nothing drives on towards what is closer than 0.15 m."""

    ahead = esair.reads(float, max_age=0.3)
    left = esair.guards(float)

    def react(self, ahead: float, left: float) -> float | None:
        return None if ahead < 0.15 and left > 0.0 else left


class ClearRight(esair.Reaction):
    """The same, for the other wheel."""

    ahead = esair.reads(float, max_age=0.3)
    right = esair.guards(float)

    def react(self, ahead: float, right: float) -> float | None:
        return None if ahead < 0.15 and right > 0.0 else right
