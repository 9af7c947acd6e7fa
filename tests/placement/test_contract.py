"""The contract suite of sensors holds for a driver that lives in a process of its own."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.testing import SensorContract

FIRST = "1.5 0"


class FileSonar(esair.Sensor[float]):
    """Reads a file, which is its part: distance, and how often it was set up anew."""

    deadline = 0.5
    scale = esair.setting(1.0, min=0.5, max=4.0)

    def __init__(self, path: str) -> None:
        super().__init__(name="sonar", rate=20.0)
        self.path = path
        self.runs = ""

    def _ask(self) -> list[str]:
        try:
            return Path(self.path).read_text(encoding="utf-8").split()
        except FileNotFoundError as error:
            raise esair.DeviceLostError(self.name, "its file is not there") from error

    async def open(self) -> None:
        self.runs = self._ask()[1]

    async def is_set_up(self) -> bool:
        return self._ask()[1] == self.runs

    async def read(self) -> float:
        return self.scale * float(self._ask()[0])

    async def apply(self, **settings: Any) -> None:
        self._ask()


@pytest.mark.placements
@pytest.mark.promise("PLC-1")
@pytest.mark.xdist_group("placement")
class TestFileSonar(SensorContract):
    """Its file can be taken away, whatever process reads it."""

    @pytest.fixture(autouse=True)
    def _part(self, tmp_path: Path) -> None:
        self.part = tmp_path / "sonar"
        self.part.write_text(FIRST, encoding="utf-8")

    def make(self) -> FileSonar:
        return FileSonar(str(self.part))

    async def unplug(self, device: Any) -> None:
        self.part.unlink()

    silence = unplug

    async def speak(self, device: Any) -> None:
        self.part.write_text(FIRST, encoding="utf-8")

    async def power_cycle(self, device: Any) -> None:
        self.part.write_text("1.5 1", encoding="utf-8")
        await asyncio.sleep(0)


@pytest.mark.placements
def test_what_the_rulebook_refuses_is_skipped_with_its_reason(place: Any) -> None:
    """An actuator stays where its safe command is: as a task it is no matter."""
    from esair.testing import FakeActuator

    wheels = FakeActuator("wheels", safe=0.0)
    assert place(wheels) is wheels
    assert wheels.placement is None
