"""What was plugged in and out since the last look."""

from __future__ import annotations

from pathlib import Path

from esair.buses.finding import ROOT, Device
from esair.discovery._devices import devices


class Plugs:
    """Compares what is plugged in with what was.

    Args:
        root: Where ``/sys`` and ``/dev`` are.

    Attributes:
        there: What was there at the last look.
    """

    def __init__(self, root: Path = ROOT) -> None:
        self._root = root
        self.there = devices(root)

    def look(self) -> tuple[list[Device], list[Device]]:
        """Look again; returns what has come and what has gone. Blocks for a moment.

        One that was renumbered has gone and come.
        """
        before, self.there = self.there, devices(self._root)
        return _without(self.there, before), _without(before, self.there)


def _without(those: list[Device], others: list[Device]) -> list[Device]:
    keys = {other.key for other in others}
    return [each for each in those if each.key not in keys]
