"""What stays on the board, and outranks the computer."""

from esair.minimal import Reaction, guards, reads, writes

TYPE_CHECKING = False
if TYPE_CHECKING:
    Speeds = tuple[float, float]


class Avoid(Reaction):
    """Goes back for 400 ms after a touch."""

    bumper = reads(bool)
    wheels = writes(tuple, priority=10)
    rate = 50
    until = -1

    def react(self, bumper: bool) -> "Speeds | None":
        if bumper:
            self.until = self.now_ms + 400
        return (-0.4, -0.4) if self.now_ms < self.until else None


class Gentle(Reaction):
    """Lets no wheel turn at more than six tenths of its speed."""

    bumper = reads(bool)
    wheels = guards(tuple)

    def react(self, bumper: bool, wheels: "Speeds") -> "Speeds":
        left, right = wheels
        return max(-0.6, min(0.6, left)), max(-0.6, min(0.6, right))
