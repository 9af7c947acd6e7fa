"""Drives of CiA 402: enabled by motion, stopped by what is safe, faults told."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator
from contextlib import aclosing
from pathlib import Path
from typing import Any

import pytest
from canopen.objectdictionary import export_od
from tests.drivers.parts import OnCan, opened

import esair
from esair.buses import Frame
from esair.drivers.canopen import CanopenSensor
from esair.drivers.canopen.drive import Drive, DriveState, State, standard
from esair.drivers.canopen.fake_drive import FakeDrive
from esair.drivers.canopen.position import Move, PositionDrive
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
)
from esair.messages import ResourceState
from esair.testing import ActuatorContract, FakeCan, SensorContract

PATIENCE = 10.0
UNIT = math.tau / 4096  # rad, and rad/s, for one increment

pytestmark = pytest.mark.virtual_clock


def made(kind: Any, wire: Any, **keywords: Any) -> Any:
    return kind(bus=wire, **{"node": 5, "sdo_timeout": PATIENCE, **keywords})


def state_of(far: FakeDrive) -> State:
    return far.drive_state


@pytest.fixture
def wire() -> FakeCan:
    return FakeCan("drive")


@pytest.fixture
async def far(wire: FakeCan) -> AsyncIterator[FakeDrive]:
    drive = FakeDrive(wire)
    yield drive
    drive.stop()


class Wired(OnCan):
    def on_wire(self) -> Any:
        self.far = FakeDrive(self.wire)
        return self.wire

    async def silence(self, device: Any) -> None:
        device.sdo_timeout = 0.02
        self.far.stop()

    async def speak(self, device: Any) -> None:
        device.sdo_timeout = PATIENCE
        self.far.boot()


class TestDrive(Wired, ActuatorContract):
    def make(self) -> Any:
        return made(Drive, self.on_wire(), factor=UNIT)

    def commands(self) -> list[Any]:
        return [1.0, -2.0]


class TestDriveThatHalts(Wired, ActuatorContract):
    def make(self) -> Any:
        return made(Drive, self.on_wire(), stop="halt", sync=0.01)

    def commands(self) -> list[Any]:
        return [100.0, -100.0]


class TestPositionDrive(Wired, ActuatorContract):
    def make(self) -> Any:
        return made(PositionDrive, self.on_wire(), factor=UNIT)

    def commands(self) -> list[Any]:
        return [Move(1.0), Move(-1.0)]


class TestDriveState(Wired, SensorContract):
    def make(self) -> Any:
        return made(DriveState, self.on_wire(), velocity_factor=UNIT)


@pytest.mark.parametrize("sync", [None, 0.01])
async def test_a_drive_is_led_to_operation_enabled_and_turns(
    wire: FakeCan, far: FakeDrive, sync: float | None
) -> None:
    """By the first command that moves; then a command is one PDO, with the SYNC."""
    drive = made(Drive, wire, factor=UNIT, sync=sync)
    async with opened(drive):
        assert state_of(far) is State.DISABLED
        await drive.write(0.0)
        await asyncio.sleep(0.1)
        assert state_of(far) is State.DISABLED, "what is safe gives no power"

        await drive.write(math.pi)
        await asyncio.sleep(0.5)
        assert state_of(far) is State.ENABLED
        assert far.velocity == pytest.approx(2048, abs=1)
        wire.sent.clear()
        await drive.write(-math.pi)
        await asyncio.sleep(0.5)
        assert far.velocity == pytest.approx(-2048, abs=1)
        commands = [each for each in wire.sent if each.id == 0x205]
        assert [each.data.hex() for each in commands] == ["0f0000f8ffff"]
        assert (far.syncs > 50) is (sync is not None)


@pytest.mark.parametrize(
    ("stop", "left"), [("quick_stop", State.DISABLED), ("halt", State.ENABLED)]
)
async def test_what_is_safe_stops_the_drive(
    wire: FakeCan, far: FakeDrive, stop: Any, left: State
) -> None:
    """By its ramp, at once; a fresh command starts it again."""
    drive = made(Drive, wire, stop=stop)
    async with opened(drive):
        for _ in range(3):
            await drive.write(3000.0)
            await asyncio.sleep(0.5)
            assert far.velocity == 3000
            await drive.write(0.0)
            await asyncio.sleep(0.03)
            assert 0 < far.velocity < 3000, "by a ramp"
            await asyncio.sleep(0.5)
            assert (far.velocity, state_of(far)) == (0, left)


async def test_a_command_right_after_a_stop_moves(
    wire: FakeCan, far: FakeDrive
) -> None:
    """Whatever the drive told before it had heard the stop."""
    drive = made(Drive, wire)
    async with opened(drive):
        for pause in range(40):
            await drive.write(1000.0)
            await asyncio.sleep(0.002 * pause)
            await drive.write(0.0)
            await asyncio.sleep(0.001 * pause)
        await drive.write(1000.0)
        await asyncio.sleep(0.3)
        assert (state_of(far), far.velocity) == (State.ENABLED, 1000)


async def test_a_drive_that_is_halted_goes_on_to_no_position_of_before(
    wire: FakeCan, far: FakeDrive
) -> None:
    """Bit 4 falls and rises while it is halted: frames may be far apart on a full bus."""
    drive = made(PositionDrive, wire, stop="halt")
    words: list[int] = []

    def note(frame: Frame) -> None:
        if frame.id == 0x205:
            words.append(int.from_bytes(frame.data[:2], "little"))

    async with opened(drive):
        await drive.write(Move(10_000.0))
        await asyncio.sleep(0.5)
        await drive.write(Move(stop=True))
        await asyncio.sleep(0.5)
        wire.on_send(note)
        await drive.write(Move(0.0))
        assert words == [0x12F, 0x3F]
        await asyncio.sleep(3.0)
        assert far.position == pytest.approx(0.0, abs=1.0)


async def test_a_stop_ends_an_enabling(wire: FakeCan, far: FakeDrive) -> None:
    """It does not wait for it, and no motion follows it."""
    drive = made(Drive, wire)
    async with opened(drive):
        moving = asyncio.ensure_future(drive.write(1000.0))
        await asyncio.sleep(0)
        await drive.write(0.0)
        with pytest.raises(BusyError):
            await moving
        await asyncio.sleep(0.2)
        assert far.velocity == 0
        assert state_of(far) is not State.ENABLED


@pytest.mark.promise("GRD-2")
@pytest.mark.parametrize(
    ("stop", "left"), [("quick_stop", State.DISABLED), ("halt", State.ENABLED)]
)
async def test_the_watchdogs_frames_stop_it_as_its_safe_command(
    wire: FakeCan, far: FakeDrive, stop: Any, left: State
) -> None:
    """As bytes for the socket, told at the opening; also where a PDO waits for a SYNC."""
    drive = made(Drive, wire, sync=0.01, stop=stop)

    async def send() -> None:
        for frame in frames:
            number, length = int.from_bytes(frame[:4], "little"), frame[4]
            await wire.send(number, frame[8 : 8 + length])
        await asyncio.sleep(0.2)

    async with opened(drive):
        frames = drive.safe_frames().frames
        await send()
        assert (far.velocity, state_of(far)) == (0, State.DISABLED)
        await drive.write(1000.0)
        await asyncio.sleep(0.5)
        assert far.velocity == 1000
        drive._sync._task.cancel()  # this process hangs
        await send()
        assert (far.velocity, state_of(far)) == (0, left)


@pytest.mark.parametrize(("one", "other"), [(0.02, 1.0), (1.0, 0.02)])
async def test_a_drive_tells_as_often_as_any_needs_it(
    wire: FakeCan, far: FakeDrive, one: float, other: float
) -> None:
    """Whoever needs it more often would find it silent."""
    drive = made(Drive, wire, name="drive", tell_every=one)
    state = made(DriveState, wire, name="state", tell_every=other)
    async with esair.Robot(resources=[drive, state]) as robot:
        await asyncio.sleep(5.0)
        losses = [robot.resources.query(name).losses for name in ("drive", "state")]
        assert losses == [0, 0]


@pytest.mark.promise("SUP-2")
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("kinds", [(Drive, DriveState), (DriveState, Drive)])
async def test_who_has_no_sync_does_not_miss_that_of_another(
    wire: FakeCan, far: FakeDrive, kinds: tuple[Any, Any], first: int
) -> None:
    """It goes with the device that needs it, in whatever order they were opened."""
    devices = [made(kinds[0], wire, name="one", sync=0.02)]
    devices.insert(first, made(kinds[1], wire, name="other"))
    async with esair.Robot(resources=devices) as robot:
        await asyncio.sleep(1.0)
        await robot.resources.remove("one")
        await asyncio.sleep(1.0)
        assert robot.resources.query("other").losses == 0


@pytest.mark.promise("SC-3")
async def test_a_drive_that_comes_later_moves_no_object_unseen(
    wire: FakeCan, far: FakeDrive, tmp_path: Path
) -> None:
    """It sets up PDOs in which others are received; once it has, no more."""
    eds = tmp_path / "drive.eds"
    export_od(standard(5), str(eds))
    store = far.local.data_store
    store[0x1800] = {1: b"\x85\1\0\0", 2: b"\xff", 5: b"\x14\0"}
    store[0x1A00] = {0: b"\1", 1: b"\x20\0\x64\x60"}
    far.position = 1000.0
    keywords = {"object": 0x6064, "pdo": True, "eds": eds, "name": "position"}
    got: set[int] = set()

    class Look(esair.Behavior):
        position = esair.reads(int)

        async def run(self) -> None:
            with contextlib.suppress(DeviceLostError):
                async for value in self.position:
                    got.add(value)

    position = made(CanopenSensor, wire, **keywords)
    async with esair.Robot(resources=[position], behaviors=[Look()]) as robot:
        await asyncio.sleep(1.0)
        await robot.resources.add(made(DriveState, wire, name="state"))
        await asyncio.sleep(1.0)
        await robot.resources.remove("state")
        await robot.resources.add(made(DriveState, wire, name="state"))
        await asyncio.sleep(1.0)
        assert robot.resources.query("position").losses == 1
        await robot.behaviors.restart("look")
        await asyncio.sleep(0.1)
    assert got == {1000}


@pytest.mark.promise("SC-3")
async def test_half_a_reading_is_silence(wire: FakeCan, far: FakeDrive) -> None:
    """Its second PDO comes no more, though the first one does."""
    state = made(DriveState, wire, name="state", tell_every=0.01)
    async with esair.Robot(resources=[state]) as robot:
        await asyncio.sleep(0.5)
        assert robot.resources.query("state").state is ResourceState.READY
        far.local.data_store[0x1801][5] = bytes(2)  # its event timer
        await asyncio.sleep(0.3)
        assert robot.resources.query("state").state is not ResourceState.READY


@pytest.mark.promise("AC-1")
async def test_a_position_is_rounded_to_what_it_has(
    wire: FakeCan, far: FakeDrive
) -> None:
    """It is told, and beyond no limit."""
    drive = made(PositionDrive, wire, factor=10.0, limits=(-100.0, 107.0))
    async with opened(drive):
        assert await drive.write(Move(40.0)) is None
        assert await drive.write(Move(44.0)) == Move(40.0)
        assert await drive.write(Move(107.0)) == Move(100.0)
        assert far.moves[-1] == 10


async def test_a_position_is_gone_to_and_a_newer_one_at_once(
    wire: FakeCan, far: FakeDrive
) -> None:
    """Each is a new set-point, for which bit 4 must rise."""
    drive = made(PositionDrive, wire)
    async with opened(drive):
        await drive.write(Move(500.0))
        await asyncio.sleep(0.1)
        await drive.write(Move(-200.0))
        await asyncio.sleep(1.0)
        assert far.moves == [500, -200]
        assert far.position == pytest.approx(-200, abs=1)
        await drive.write(Move(5000.0))
        await asyncio.sleep(0.5)
        await drive.write(Move(stop=True))
        await asyncio.sleep(0.5)
        assert 100 < far.position < 1000
        assert far.velocity == 0


@pytest.mark.promise("AC-1")
async def test_a_drive_that_looks_seldom_misses_no_position(wire: FakeCan) -> None:
    """Bit 4 is lowered, and raised again, only as the drive has seen it (bit 12)."""

    class Slow(FakeDrive):
        """Looks 10 ms after a command at the newest one."""

        newest = b""

        def _apply(self, number: int, data: bytes) -> None:
            if not self.newest:
                asyncio.get_running_loop().call_later(0.01, self._look, number)
            self.newest = data

        def _look(self, number: int) -> None:
            data, self.newest = self.newest, b""
            super()._apply(number, data)

    far = Slow(wire)
    drive = made(PositionDrive, wire)
    async with opened(drive):
        for position in (500.0, -200.0, 300.0):
            await drive.write(Move(position))
            assert far.moves[-1] == position
        drive.stop = "halt"
        write = asyncio.ensure_future(drive.write(Move(7.0)))
        await asyncio.sleep(0.005)
        await drive.write(Move(stop=True))
        with pytest.raises(BusyError):
            await write
        await drive.write(Move(8.0))
        assert far.moves[-1] == 8
    far.stop()


@pytest.mark.promise("AC-1")
async def test_a_position_that_is_not_acknowledged_is_a_fault(
    wire: FakeCan, far: FakeDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive that heeds no new position is not taken for one that goes there."""
    drive = made(PositionDrive, wire)
    async with opened(drive):
        await drive.write(Move(500.0))
        monkeypatch.setattr(far, "_take_set_point", lambda _risen: None)
        with pytest.raises(DeviceFaultError, match="bit 12"):
            await drive.write(Move(-200.0))


async def test_positions_need_no_zero_among_them(wire: FakeCan, far: FakeDrive) -> None:
    """Where a joint goes from 1 to 2 rad, its stop is within the limits, too."""
    drive = made(PositionDrive, wire, limits=(1.0, 2.0), factor=UNIT)
    assert drive.safe == Move(1.0, stop=True)
    async with esair.Robot(resources=[drive]) as robot:
        assert robot.resources.query(drive.name).state is esair.ResourceState.READY


@pytest.mark.fault("D05")
async def test_a_fault_is_told_in_the_words_of_the_emergency(
    wire: FakeCan, far: FakeDrive
) -> None:
    """It is opened again, cleared once, and not enabled until a fresh command."""
    drive = made(Drive, wire, name="motor")
    policy = esair.Policy("motor", allow={"me": esair.Access.WRITE})
    async with esair.Robot(resources=[drive], policies=[policy]) as robot:
        right = await robot.resources.register("me", "motor", esair.Access.WRITE)
        await robot.actuators.write(right, 1000.0)
        await asyncio.sleep(0.05)
        assert state_of(far) is State.ENABLED
        far.fault(0x2310)
        await asyncio.sleep(0.05)
        status = robot.resources.query("motor")
        assert "0x2310 (Current)" in str(status.error)
        await asyncio.sleep(5.0)
        assert robot.resources.query("motor").state is esair.ResourceState.READY
        assert state_of(far) is State.DISABLED


async def test_a_fault_that_remains_is_told_at_the_opening(
    wire: FakeCan, far: FakeDrive
) -> None:
    """With its code."""
    far.fault(0x3210, clears=False)
    drive = made(Drive, wire)
    await wire.open()
    with pytest.raises(DeviceFaultError, match="error code 0x3210"):
        await drive.open()
    await drive.close()
    await wire.close()


async def test_a_drive_that_does_not_follow_is_told(
    wire: FakeCan, far: FakeDrive
) -> None:
    """With the state in which it stays."""
    drive = made(Drive, wire)
    async with opened(drive):
        far._become(State.NOT_READY)
        with pytest.raises(
            DeviceFaultError, match=r"1 s: it is not ready to switch on"
        ):
            await drive.write(1.0)


async def test_somebody_else_takes_the_power(wire: FakeCan, far: FakeDrive) -> None:
    """A drive that is disabled behind our back is a fault, not a silence."""
    drive = made(Drive, wire)
    errors: list[Any] = []
    async with opened(drive):
        drive._listener = errors.append
        await drive.write(10.0)
        await asyncio.sleep(0.1)
        far._become(State.READY)
        await asyncio.sleep(0.1)
    assert [str(error) for error in errors if "it is ready to switch on" in str(error)]


async def test_what_a_drive_measures(wire: FakeCan, far: FakeDrive) -> None:
    """In the units of its factors; of both its PDOs, short ones count."""
    drive = made(Drive, wire, factor=UNIT)
    state = made(DriveState, wire, position_factor=UNIT, velocity_factor=UNIT)
    stream: Any
    async with opened(drive, state), aclosing(state.stream()) as stream:
        await drive.write(math.tau)
        await anext(stream)
        await asyncio.sleep(1.0)
        wire.feed(0x185, b"\0")
        for _ in range(80):
            reading = await anext(stream)
        assert reading.velocity == pytest.approx(math.tau, rel=1e-2)
        assert reading.position == pytest.approx(far.position * UNIT, rel=0.1)
        assert reading.state is State.ENABLED
        assert state.bad_frames == 1


@pytest.mark.promise("SC-3")
async def test_a_drive_that_tells_nothing_more_is_lost(
    wire: FakeCan, far: FakeDrive
) -> None:
    """Nor does one half of what it tells make a reading, with a half from before."""
    state = made(DriveState, wire, name="state")
    user = esair.Behavior(name="user", reads={"state": esair.reads(Any)}, writes={})
    async with esair.Robot(resources=[state], behaviors=[user]) as robot:
        reading = await user.state.reading(fresh=True)
        state.sdo_timeout = 0.02
        far.stop()
        for _ in range(10):
            await asyncio.sleep(0.02)
            wire.feed(0x285, bytes(4))
        newest = await user.state.reading()
        assert newest.sequence <= reading.sequence + 2
        await asyncio.sleep(0.3)
        assert robot.resources.query("state").losses == 1


async def test_one_bus_has_one_sync(wire: FakeCan, far: FakeDrive) -> None:
    """Two devices share it; another period is refused; after the last it ends."""
    one, two = made(Drive, wire, sync=0.01), made(DriveState, wire, sync=0.01)
    other = made(DriveState, wire, sync=0.02, name="other")
    async with opened(one, two):
        with pytest.raises(ConfigError, match=r"SYNC every 0\.01 s"):
            await other.open()
        await other.close()
        wire.sent.clear()
        await asyncio.sleep(0.1)
        assert sum(frame.id == 0x80 for frame in wire.sent) in {9, 10, 11}
        await two.close()
        await one.close()
        wire.sent.clear()
        await asyncio.sleep(0.1)
        assert [frame for frame in wire.sent if frame.id == 0x80] == []
        await one.open()
        await two.open()


class Haul(esair.Behavior):
    """Turns the winch for a while."""

    winch = esair.writes(float)

    async def run(self) -> None:
        for _ in range(20):
            await self.winch.write(0.5)
            await asyncio.sleep(0.05)
        await asyncio.sleep(1e6)


@pytest.mark.promise("RES-4")
@pytest.mark.parametrize("after", [3, 6, 10, 16, 26])
async def test_a_drive_that_restarts_while_it_is_set_up_is_set_up_again(
    wire: FakeCan, far: FakeDrive, after: int
) -> None:
    """Its boot-up message says so: half of what it was told would be gone."""
    requests = iter(range(1, 1000))

    def heard(frame: Any) -> None:
        if frame.id == 0x605 and next(requests) == after:
            far.power_cycle()

    wire.on_send(heard)
    winch = made(Drive, wire, name="winch", factor=0.001)
    async with esair.Robot(resources=[winch], behaviors=[Haul()]) as robot:
        await asyncio.sleep(0.6)
        assert robot.resources.query("winch").losses == 1
        assert far.velocity == 500


@pytest.mark.promise("BUS-4", "AC-2", "CALL-2")
@pytest.mark.parametrize("sync", [None, 0.02])
@pytest.mark.parametrize("seconds", [0.03, 0.13, 1.3])
async def test_a_drive_that_missed_its_stop_is_stopped(
    sync: float | None, seconds: float
) -> None:
    """Its plug was loose: it is missed by what it does not tell, or by what it tells then."""
    wire = FakeCan("wire")
    far = FakeDrive(wire, node=5)
    winch = Drive(name="winch", bus=wire, node=5, factor=0.001, sync=sync)
    async with esair.Robot(resources=[winch], behaviors=[Haul()]) as robot:
        await asyncio.sleep(0.93 + winch.command_timeout)  # just before it is due
        assert far.velocity
        wire.silence()
        await asyncio.sleep(seconds)
        wire.speak()
        await asyncio.sleep(3.0)
        assert far.drive_state is not State.ENABLED
        assert not far.velocity
        assert robot.resources.query("winch").state is esair.ResourceState.READY
