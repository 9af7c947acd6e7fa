"""Components in processes of their own: the same class, the same robot.

Nothing here is imported unless a component is placed; `_server` imports what a child needs.
"""

from typing import TYPE_CHECKING

from esair.loading import late

if TYPE_CHECKING:
    from esair.placement._runner import PlacedRunner
    from esair.placement._seat import Seat, Seats, StepSeat

__all__ = ["PlacedRunner", "Seat", "Seats", "StepSeat"]

__getattr__, __dir__ = late(
    __name__, {"_runner": "PlacedRunner", "_seat": "Seat Seats StepSeat"}
)
