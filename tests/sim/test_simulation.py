"""The simulated devices, through the buses of the robot's side."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

import pytest

from esair.buses import CanBus, Inbox, SerialBus
from esair.drivers.mpu6050 import GRAVITY, Mpu6050
from esair.drivers.wheel_motor import (
    LEFT,
    RIGHT,
    WheelCommand,
    command_id,
    decode_feedback,
    encode_command,
    feedback_id,
)
from esair.exceptions import ConfigError, DeviceLostError
from esair.sim import SimCanBus, SimI2CBus, SimSerialBus, Simulation
from esair.sim._simulation import _of_loop

Check = Callable[[Simulation], Awaitable[None]]


async def ask(bus: SerialBus, answer: bytes, *question: str | int) -> list[str]:
    """Say a sentence and return the answer."""
    payload = ",".join(map(str, question)).encode()
    return fields_of(await bus.ask(payload, prefix=answer, timeout=1))


def fields_of(sentence: bytes) -> list[str]:
    """Return what stands between the commas."""
    return sentence.decode("ascii").split(",")


async def take_all(inbox: Inbox[bytes]) -> None:
    """Take lines until the bus is lost."""
    async for _ in inbox:
        pass


async def check_range_finder(simulation: Simulation) -> None:
    """It says who it is, sweeps as often as it is told, and refuses the rest."""
    bus = SimSerialBus(name="front")
    await bus.open()

    assert await ask(bus, b"RFIAM", "RFWHO") == ["RFIAM", "fan41", "1.0"]
    assert await ask(bus, b"RFACK", "RFRTE", 20) == ["RFACK", "RTE", "20"]
    assert await ask(bus, b"RFNAK", "RFRTE", 21) == ["RFNAK", "RFRTE"]
    inbox = bus.frames(b"RFSWP")
    first = fields_of(await inbox.take(timeout=1))
    second = fields_of(await inbox.take(timeout=1))

    assert int(second[1]) == int(first[1]) + 1
    assert second[2:4] == ["-12000", "600"]
    assert len(second[4:]) == 41
    truth = simulation.world.distance_ahead(math.radians(-120), 2.5)
    assert truth is not None
    assert int(second[4]) / 1000 == pytest.approx(truth, abs=0.06)
    await bus.close()


async def check_bumper(simulation: Simulation) -> None:
    """It speaks ten times a second, and at once when something is touched."""
    bus = SimSerialBus(name="skirt", line="skirt")
    await bus.open()
    inbox = bus.frames(b"BMSTA")

    assert await ask(bus, b"BMIAM", "BMWHO") == ["BMIAM", "skirt2", "1.0"]
    assert fields_of(await inbox.take(timeout=1))[2:] == ["0", "0"]
    simulation.world.target[:] = [12.0, 12.0]
    for _ in range(100):
        state = fields_of(await inbox.take(timeout=1))[2:]
        if "1" in state:
            break
        simulation.world.target[:] = [12.0, 12.0]

    assert "1" in state
    await bus.close()


async def check_motors(simulation: Simulation) -> None:
    """They obey their own frames, tell how they turn, and stop when nobody speaks."""
    bus = SimCanBus(name="drive")
    await bus.open()
    inbox = bus.frames(feedback_id(LEFT))

    turning = None
    for sequence in range(100):  # 5 s; half of one on a computer with time for it
        for side, speed in ((LEFT, 4.0), (RIGHT, 6.0)):
            data = encode_command(side, WheelCommand(speed, True, sequence))
            await bus.send(command_id(side), data)
        await asyncio.sleep(0.05)
        while len(inbox):
            turning = decode_feedback(LEFT, (await inbox.take(timeout=1)).data)
        if sequence >= 9 and turning and turning.speed == pytest.approx(4.0, abs=0.3):
            break
    assert turning is not None
    moved = simulation.world.distance
    await asyncio.sleep(0.8)
    while len(inbox):
        standing = decode_feedback(LEFT, (await inbox.take(timeout=1)).data)

    assert turning.speed == pytest.approx(4.0, abs=0.3)
    assert turning.angle > 0.5
    assert turning.enabled
    assert not turning.timed_out
    assert moved > 0.05
    assert standing.timed_out
    assert not standing.enabled
    assert standing.speed == pytest.approx(0.0, abs=0.05)
    await bus.close()


async def check_imu(simulation: Simulation) -> None:
    """It is an MPU-6050 for the driver of one."""
    bus = SimI2CBus(name="body")
    await bus.open()
    imu = Mpu6050(bus=bus)
    await imu.open()
    await asyncio.sleep(0.1)

    motion = await imu.read()

    assert motion.acceleration[2] == pytest.approx(GRAVITY, abs=0.5)
    assert abs(motion.turn_rate[2]) < 0.06
    await bus.close()


async def check_unplug(simulation: Simulation) -> None:
    """A pulled cable is a loss; the same bus finds the device when it is back."""
    bus = SimSerialBus(name="front")
    await bus.open()
    inbox = bus.frames()
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await inbox.take(timeout=1)

    simulation.front.unplug()
    with pytest.raises(DeviceLostError):
        await take_all(inbox)
    with pytest.raises(DeviceLostError):
        await bus.open()
    simulation.front.plug()
    await bus.open()

    assert len(told) == 1
    assert await ask(bus, b"RFIAM", "RFWHO") == ["RFIAM", "fan41", "1.0"]
    await bus.close()


async def check_noise(simulation: Simulation) -> None:
    """Damaged sentences are counted by the part and disturb nothing."""
    bus = SimSerialBus(name="front")
    await bus.open()

    await bus.write(b"$RFRTE,20*00\r\n$nonsense\r\n")
    answer = await ask(bus, b"RFIAM", "RFWHO")

    assert answer[0] == "RFIAM"
    assert simulation._range_finder.bad_sentences == 2
    await bus.close()


CHECKS: list[Check] = [
    check_range_finder, check_bumper, check_motors,
    check_imu, check_unplug, check_noise,
]  # fmt: skip
NAMES = [check.__name__.removeprefix("check_") for check in CHECKS]


@pytest.mark.real_clock
@pytest.mark.parametrize("check", CHECKS, ids=NAMES)
async def test_device_on_a_real_transport(check: Check) -> None:
    """Pseudo-terminals, python-can, and the methods of smbus2, in real time."""
    async with Simulation(seed=1) as simulation:
        assert not simulation.in_memory
        await check(simulation)


@pytest.mark.virtual_clock
@pytest.mark.parametrize("check", CHECKS, ids=NAMES)
async def test_device_on_a_wire_in_memory(check: Check) -> None:
    """The same bytes and frames, on a virtual clock."""
    async with Simulation(seed=1) as simulation:
        assert simulation.in_memory
        await check(simulation)


@pytest.mark.long
@pytest.mark.virtual_clock
async def test_time_passes_with_the_loops_clock() -> None:
    """A minute of the loop is a minute of the world."""
    async with Simulation() as simulation:
        await asyncio.sleep(60.0)
        assert simulation.world.time == pytest.approx(60.0, abs=0.011)
        assert simulation.late == 0


@pytest.mark.virtual_clock
async def test_a_loop_that_was_held_up_is_followed_for_a_limited_time() -> None:
    """After a long stall the world does not race to catch up."""
    loop = asyncio.get_running_loop()
    async with Simulation() as simulation:
        await asyncio.sleep(1.0)
        loop.advance(10.0)  # type: ignore[attr-defined]
        await asyncio.sleep(0.02)

        assert simulation.world.time == pytest.approx(1.0 + 0.5, abs=0.05)
        assert simulation.late == pytest.approx(950, abs=5)


@pytest.mark.virtual_clock
async def test_buses_without_a_simulation_share_a_new_one() -> None:
    """It begins with the first bus and ends with the last one."""
    buses: list[SerialBus | CanBus] = [
        SimSerialBus(name="front"),
        SimCanBus(name="drive"),
    ]

    await asyncio.gather(*(bus.open() for bus in buses))
    loop = asyncio.get_running_loop()
    simulation = _of_loop[loop]
    assert await Simulation.join(buses[0]) is simulation
    await buses[0].close()
    assert _of_loop[loop] is simulation
    await buses[1].close()

    assert loop not in _of_loop


@pytest.mark.virtual_clock
async def test_an_unknown_line_is_named_with_the_nearest() -> None:
    """A mistake in a configuration file is told as one."""
    async with Simulation():
        bus = SimSerialBus(name="front", line="frnt")
        with pytest.raises(ConfigError, match="did you mean 'front'"):
            await bus.open()
        await bus.close()


@pytest.mark.virtual_clock
async def test_a_line_has_one_owner() -> None:
    """A second bus on a wire in memory is refused, as the port's lock would do it."""
    async with Simulation():
        first, second = SimSerialBus(name="first"), SimSerialBus(name="second")
        await first.open()
        with pytest.raises(DeviceLostError, match="somebody else"):
            await second.open()
        await first.close()
        await second.open()
        await second.close()
