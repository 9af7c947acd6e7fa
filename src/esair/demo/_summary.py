"""The table at the end: what was driven, how regularly, and what went wrong."""

from __future__ import annotations

import attrs
from rich.console import Console
from rich.table import Table

from esair.connections import LastCommand
from esair.demo._pace import Pace
from esair.demo._story import Fault


@attrs.frozen
class Row:
    """How one component did.

    Attributes:
        name: Its name.
        state: What it was doing at the end, in a word.
        count: How often it did what it does.
        rate: How often a second.
        late: What 99 of 100 were not later than, in seconds; None if not known.
        trouble: Losses, faults, restarts, steps left out, in words.
    """

    name: str
    state: str
    count: int
    rate: float
    late: float | None
    trouble: str = ""

    @classmethod
    def of_pace(cls, name: str, state: str, pace: Pace, trouble: str = "") -> Row:
        """Make a row from what was counted."""
        return cls(name, state, pace.count, pace.rate, pace.lateness(0.99), trouble)


@attrs.frozen
class Summary:
    """The run in numbers.

    Attributes:
        seconds: How long it took.
        distance: How far the rover drove, in metres.
        known: Which part of the floor it knows at the end, 0 to 1.
        error: How far its belief of where it is was off at the end, in metres.
        bumps: How often it touched something.
        rows: How the components did.
        faults: What went wrong, and what it cost.
        told: What each actuator was told last, and whether it answered.
        unmet: What should have happened and did not.
    """

    seconds: float
    distance: float
    known: float
    error: float
    bumps: int
    rows: tuple[Row, ...]
    faults: tuple[Fault, ...]
    told: tuple[LastCommand, ...]
    unmet: tuple[str, ...]

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
        console.print(f"[bold]{self.headline}[/bold]")
        console.print(self._components())
        console.print(self._faults())
        console.print(self._actuators())
        for what in self.unmet:
            console.print(f"[bold red]did not happen in time:[/bold red] {what}")

    def _components(self) -> Table:
        table = Table(title="components", title_justify="left", expand=False)
        for head in ("name", "at the end"):
            table.add_column(head)
        for head in ("count", "rate", "late (p99)"):
            table.add_column(head, justify="right")
        table.add_column("trouble")
        for row in self.rows:
            late = "" if row.late is None else f"{1000 * row.late:.1f} ms"
            rate = f"{row.rate:.1f} Hz" if row.rate else ""
            table.add_row(row.name, row.state, str(row.count), rate, late, row.trouble)
        return table

    def _faults(self) -> Table:
        table = Table(title="faults and what they cost", title_justify="left")
        table.add_column("fault")
        for head in ("noticed", "wheels safe", "back", "fresh motion"):
            table.add_column(head, justify="right")
        table.add_column("cost")
        for fault in self.faults:
            times = (fault.noticed, fault.safe, fault.back, fault.moved)
            table.add_row(
                fault.text, *(f"{1000 * time:.0f} ms" for time in times), fault.cost
            )
        return table

    def _actuators(self) -> Table:
        table = Table(title="what every actuator was told last", title_justify="left")
        for head in ("actuator", "command", "safe", "answered"):
            table.add_column(head)
        for told in self.told:
            answered = "yes" if told.answered else f"NO: {told.error}"
            table.add_row(
                told.resource, str(told.command), "yes" if told.safe else "NO", answered
            )
        return table
