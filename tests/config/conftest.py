"""A robot project in a temporary folder, with a module of its own."""

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from esair import config

MODULE = '''
import enum
from pathlib import Path
from typing import Literal

import attrs

import esair
from esair.buses import Bus


@attrs.frozen
class Twist:
    linear: float
    angular: float = 0.0


class Wire(Bus):
    def __init__(self, *, name: str, port: str, baudrate: int = 9600) -> None:
        super().__init__(name=name)
        self.port = port
        self.baudrate = baudrate

    async def _open(self) -> None: ...
    async def _close(self) -> None: ...


class OtherWire(Wire): ...


class Sonar(esair.Sensor[float]):
    rate = esair.setting(10.0, unit="Hz", min=1.0, max=100.0)
    gain = esair.setting(3, min=0, max=7)

    async def read(self) -> float:
        return 1.0


class Double(esair.Derived[float]):
    sonar = esair.reads(float)

    def compute(self, sonar: float) -> float:
        return 2.0 * sonar


class FakeSonar(esair.Sensor[float]):
    def __init__(self, *, value: float = 1.0, **settings) -> None:
        super().__init__(**settings)
        self.value = value

    async def read(self) -> float:
        return self.value


class Wheels(esair.Actuator[Twist]):
    own_timeout = 0.5

    async def write(self, command: Twist) -> None: ...


class Lamp(esair.Actuator[bool]):
    safe = False

    async def write(self, command: bool) -> None: ...


class Picky(esair.Sensor[float]):
    """Takes keywords of many types, and no name."""

    def __init__(
        self,
        pin: int,
        *,
        table: Path | str = "none",
        mode: Literal["slow", "fast"] = "slow",
        offsets: tuple[float, float] = (0.0, 0.0),
        start: Twist | None = None,
        weights: dict[str, float] | None = None,
    ) -> None:
        super().__init__()
        self.pin = pin
        self.table = table
        self.mode = mode
        self.offsets = offsets
        self.start = start
        self.weights = weights

    async def read(self) -> float:
        return 1.0


class OnWire(esair.Sensor[float]):
    bus: OtherWire

    async def read(self) -> float:
        return 1.0


class Broken(esair.Sensor[float]):
    def __init__(self, **settings) -> None:
        super().__init__(**settings)
        raise OSError("the firmware is too old")


class Wander(esair.Behavior):
    wheels = esair.writes(Twist)
    speed: float = 0.3

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(Twist(self.speed))


class Avoid(esair.Reaction):
    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(Twist, priority=10)

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.2) if sonar < 0.4 else None
'''

ROBOT = """
[robot]
name = "rover"

[bus.front]
type = "{m}:Wire"
port = "/dev/serial/by-id/front"
baudrate = 115200
sim = {{ port = "memory" }}

[sensor.sonar]
driver = "{m}:Sonar"
bus = "front"
rate = 20
sim = {{ driver = "{m}:FakeSonar", value = 2.5 }}

[actuator.wheels]
driver = "{m}:Wheels"
bus = "front"
safe = {{ linear = 0.0, angular = 0.0 }}
command_timeout = 0.3
limits = {{ linear = [-1.0, 1.0] }}

[behavior.wander]
driver = "{m}:Wander"
speed = 0.5
restart = {{ max = 5, within = 10 }}

[behavior.avoid]
driver = "{m}:Avoid"

[access.wheels]
wander = "write"
avoid = "write, configure"
"""

_numbers = itertools.count(1)


class Project:
    """A folder with a module and a robot.toml.

    ``{m}`` in a text stands for the name of the module.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.module = f"robot_of_test_{next(_numbers)}"
        self.file = folder / "robot.toml"
        (folder / f"{self.module}.py").write_text(MODULE)

    def write(self, text: str = ROBOT) -> Path:
        """Write a robot.toml, the sound one unless another is given."""
        self.file.write_text(text.format(m=self.module))
        return self.file

    def changed(self, old: str, new: str) -> Path:
        """Write the sound robot.toml with one change."""
        assert ROBOT.count(old) >= 1, f"{old!r} is not in it"
        return self.write(ROBOT.replace(old, new, 1))

    def mistakes(self, *, simulated: bool = False) -> dict[str, str]:
        """Load what was written, which must fail; what is wrong, by key."""
        with pytest.raises(ExceptionGroup) as caught:
            config.load(self.file, simulated=simulated)
        errors = caught.value.exceptions
        assert all(isinstance(error, config.ConfigFileError) for error in errors)
        return {error.key: str(error) for error in errors}  # type: ignore[attr-defined]


@pytest.fixture
def project(tmp_path: Path) -> Iterator[Project]:
    """Hand out a project; its module is forgotten afterwards."""
    made = Project(tmp_path)
    yield made
    for name in [name for name in sys.modules if name.startswith(made.module)]:
        del sys.modules[name]
