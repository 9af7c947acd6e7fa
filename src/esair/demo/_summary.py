"""The end of the show: what the picture shows, and the run in numbers."""

from __future__ import annotations

from typing import Any

import attrs
from rich.console import Console

from esair.connections import LastCommand
from esair.demo._mapper import Belief
from esair.demo._samples import Event, Sample
from esair.seat.screen import picture
from esair.sim import Arena


@attrs.frozen
class Run:
    """What is left of a run: the picture shows it, and the numbers."""

    arena: Arena
    belief: Belief  # What the rover believes at the end
    samples: tuple[Sample, ...]  # Where it was, and who drove it, in order
    events: tuple[Event, ...]
    seconds: float  # How long it took
    distance: float  # How far the rover drove, in metres
    known: float  # Which part of the floor it knows at the end, 0 to 1
    error: float  # How far its belief of where it is was off at the end, in metres
    bumps: int  # How often it touched something
    status: dict[str, Any]
    # What each actuator was told last, and whether it answered
    told: tuple[LastCommand, ...]
    unmet: tuple[str, ...]  # What should have happened and did not

    @property
    def headline(self) -> str:
        """The run in one line."""
        bumps = "1 bump" if self.bumps == 1 else f"{self.bumps} bumps"
        known = f"{100 * self.known:.0f} % of the floor known"
        error = f"position off by {100 * self.error:.0f} cm"
        return (
            f"{self.distance:.1f} m in {self.seconds:.0f} s, {known}, {error}, {bumps}"
        )

    def show(self, console: Console) -> None:
        """Print it."""
        console.print()
        console.print(picture(self.status, console, height=10_000, hint=""))
        console.print()
        for told in self.told:
            console.print(f"last command: {told}")
        for what in self.unmet:
            console.print(f"[bold red]did not happen in time:[/bold red] {what}")
        console.print(f"[bold]{self.headline}[/bold]")
