"""The drivers for CAN on SocketCAN: their contracts, with fake parts on the same bus."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from esair.buses import CanBus
from esair.drivers.canopen import CanopenActuator, CanopenSensor
from esair.drivers.canopen.fake import FakeCanopenNode
from esair.drivers.dbc import DbcActuator, DbcSensor
from esair.drivers.dbc.fake import FakeDbcNode
from esair.drivers.odrive import Message, OdriveAxis, OdriveState, frame_id
from esair.drivers.odrive.fake import FakeOdrive
from esair.testing import ActuatorContract, SensorContract

pytestmark = pytest.mark.real_clock

FILES = Path(__file__).parents[1] / "drivers"
CHANNEL = "vcan8"
OBEYED = (
    0x100,  # the command of rover.dbc
    *(frame_id(3, message) for message in Message if message > Message.HEARTBEAT),
    0x000,  # NMT
    0x605,  # SDO of node 5
)


def ip(command: str) -> None:
    subprocess.run(["ip", "link", *command.split()], check=True, timeout=30)


class FarEnd:
    """The other end of the bus, as the fake parts want it."""

    def __init__(self) -> None:
        self.bus = CanBus(name="far", channel=CHANNEL)
        self._listeners: list[Callable[[Any], Any]] = []
        self._waiting: asyncio.Queue[Any] = asyncio.Queue()
        self._tasks: set[asyncio.Task[None]] = set()

    def on_send(self, listener: Callable[[Any], Any]) -> None:
        self._listeners.append(listener)

    def feed(self, number: int, data: bytes, *, extended: bool = False) -> None:
        self._waiting.put_nowait((number, data, extended))

    async def open(self) -> None:
        await self.bus.open()
        self._tasks = {
            asyncio.ensure_future(self._hear()),
            asyncio.ensure_future(self._say()),
        }

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.wait(self._tasks)
        await self.bus.close()

    async def _hear(self) -> None:
        with contextlib.suppress(ConnectionError):
            async for frame in self.bus.frames(*OBEYED, limit=1024):
                for listener in self._listeners:
                    listener(frame)

    async def _say(self) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                number, data, extended = await self._waiting.get()
                await self.bus.send(number, data, extended=extended)


@pytest.fixture(scope="module")
def interface() -> Iterator[str]:
    ip(f"add {CHANNEL} type vcan")
    ip(f"set {CHANNEL} up")
    yield CHANNEL
    ip(f"del {CHANNEL}")


@pytest.fixture
def channel(interface: str) -> Iterator[str]:
    yield interface
    if Path(f"/sys/class/net/{interface}/operstate").read_text().strip() == "down":
        ip(f"set {interface} up")


class OnCan:
    """A suite whose devices are on the bus; ``parts`` are stopped at its end."""

    silent_for = 2.0

    @pytest_asyncio.fixture(autouse=True)
    async def _far(self, channel: str) -> AsyncIterator[None]:
        self.far: Any = FarEnd()
        self.parts: list[Any] = []
        await self.far.open()
        yield
        for part in self.parts:
            part.stop()
        await self.far.close()

    def bus(self) -> CanBus:
        return CanBus(name="drive", channel=CHANNEL)

    def node(self) -> dict[str, Any]:
        eds = FILES / "motor.eds"
        self.parts.append(FakeCanopenNode(self.far, eds, node=5))
        return {"bus": self.bus(), "node": 5, "eds": eds, "sdo_timeout": 5.0}

    async def unplug(self, _device: Any) -> None:
        await asyncio.to_thread(ip, f"set {CHANNEL} down")
        await asyncio.sleep(0.1)

    async def silence(self, _device: Any) -> None:
        self.parts[-1].stop()

    async def speak(self, _device: Any) -> None:
        self.parts[-1].start()

    async def power_cycle(self, _device: Any) -> None:
        self.parts[-1].power_cycle()


class OnDbc(OnCan):
    keeps_nothing = "each frame says all that the node needs"

    def dbc_node(self) -> FakeDbcNode:
        self.parts.append(FakeDbcNode(self.far, FILES / "rover.dbc"))
        return self.parts[-1]  # type: ignore[no-any-return]

    async def speak(self, _device: Any) -> None:
        self.parts[-1].send_every(0.01, "WheelFeedback", speed=1.5, mode=1, current=3)


class TestDbcSensor(OnDbc, SensorContract):
    def make(self) -> Any:
        self.dbc_node().send_every(0.01, "WheelFeedback", speed=1.5, mode=1, current=3)
        return DbcSensor(
            bus=self.bus(),
            database=FILES / "rover.dbc",
            message="WheelFeedback",
            silent_after=1.0,
        )


class TestDbcActuator(OnDbc, ActuatorContract):
    is_heard = False  # nothing answers a frame

    def make(self) -> Any:
        self.dbc_node()
        return DbcActuator(
            bus=self.bus(),
            database=FILES / "rover.dbc",
            message="WheelCommand",
            fixed={"gear": "low"},
            sequence="count",
            safe={"left": 0.0, "right": 0.0},
            cycle=0.02,
        )

    def commands(self) -> list[Any]:
        return [{"left": 2.0, "right": -2.0}]


class TestOdriveAxis(OnCan, ActuatorContract):
    def make(self) -> Any:
        self.parts.append(FakeOdrive(self.far, node=3, boot_time=3.0))
        return OdriveAxis(bus=self.bus(), node=3, heartbeat_timeout=2.0)

    def commands(self) -> list[Any]:
        return [1.0, -20.0]


class TestOdriveState(OnCan, SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> Any:
        self.parts.append(FakeOdrive(self.far, node=3))
        return OdriveState(bus=self.bus(), node=3, heartbeat_timeout=2.0)


class OnCanopen(OnCan):
    async def silence(self, device: Any) -> None:
        device.sdo_timeout = 0.1
        await super().silence(device)

    async def speak(self, device: Any) -> None:
        device.sdo_timeout = 5.0
        self.parts[-1].boot()


class TestCanopenSensor(OnCanopen, SensorContract):
    def make(self) -> Any:
        made = CanopenSensor(object="Position actual value", **self.node())
        made.deadline = 10.0
        return made


class TestCanopenActuator(OnCanopen, ActuatorContract):
    def make(self) -> Any:
        made = CanopenActuator(object="Target velocity", safe=0, **self.node())
        made.deadline = 10.0
        return made

    def commands(self) -> list[Any]:
        return [1000, -1000]


@pytest.mark.fault("C10")
async def test_a_29_bit_id_is_another_one(channel: str) -> None:
    """The panel's frames have such an id; a standard one with that number does not."""
    far, near = FarEnd(), CanBus(name="drive", channel=channel)
    await far.open()
    await near.open()
    panel = DbcSensor(bus=near, database=FILES / "rover.dbc", message="Panel")
    node: Any = FakeDbcNode(far, FILES / "rover.dbc")  # type: ignore[arg-type]
    stream: Any = panel.stream()
    waiting = asyncio.ensure_future(anext(stream))
    await asyncio.sleep(0.05)
    node.send("Panel", page=1, button=3, knob=50)
    async with asyncio.timeout(10):
        assert await waiting == {"page": 1, "button": 3, "knob": 50}
    await stream.aclose()
    await near.close()
    await far.close()
