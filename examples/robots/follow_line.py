"""Follow a black line with two eyes; no wheel drives on towards what is near."""

import esair


class Follow(esair.Reaction):
    """Turn to the side that sees the line; straight on between both."""

    left_eye = esair.reads(bool)
    right_eye = esair.reads(bool)
    left = esair.writes(float, blind="safe")
    right = esair.writes(float, blind="safe")

    def react(self, left_eye: bool, right_eye: bool) -> dict[str, float]:
        return {"left": 0.1 if left_eye else 0.4, "right": 0.1 if right_eye else 0.4}


class Clear(esair.Reaction):
    """Guard one wheel; the file says which."""

    ahead = esair.reads(float, max_age=0.3)  # m
    wheel = esair.guards(float)

    def react(self, ahead: float, wheel: float) -> float | None:
        return wheel if ahead > 0.15 or wheel < 0.0 else esair.REFUSE
