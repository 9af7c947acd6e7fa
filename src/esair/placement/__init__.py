"""Components in processes of their own: the same class, the same robot.

Nothing here is imported unless a component is placed; `_nursery` imports what a child needs.
"""

from typing import TYPE_CHECKING

from esair.loading import late

if TYPE_CHECKING:
    from esair.placement._seat import PlacedRunner, Seat, Seats, StepSeat

__all__ = ["PlacedRunner", "Seat", "Seats", "StepSeat"]

__getattr__, __dir__ = late(__name__, {"_seat": "PlacedRunner Seat Seats StepSeat"})
