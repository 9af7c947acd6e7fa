"""The I²C bus when chips, adapters and wires fail."""

from __future__ import annotations

import asyncio
import errno
import threading
from collections.abc import Callable
from typing import Any

import pytest

import esair
from esair.buses import I2CBus
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    NoTurnError,
)
from esair.testing import FakeI2c


async def until(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    async with asyncio.timeout(5.0):
        while not condition():  # noqa: ASYNC110 - nobody tells
            await asyncio.sleep(0.001)


SILENT = [errno.ENXIO, errno.EREMOTEIO]
BROKEN = [errno.EIO, errno.EPROTO, errno.EBADMSG]


@pytest.mark.fault("I01")
@pytest.mark.parametrize("code", SILENT)
@pytest.mark.parametrize("after", range(4))
async def test_what_is_idempotent_is_repeated_when_nobody_answers(
    fake_i2c, code: int, after: int
) -> None:
    """The n-th transfer that is not acknowledged costs a pause, not the reading."""
    bus = fake_i2c(chips={0x68: {0x75: 0x68, 0x10: 1}})
    await bus.open()
    bus.fail(code, after=after, times=2)

    for _ in range(4):
        assert await bus.read(0x68, 0x75) == b"\x68"
    await bus.write(0x68, 0x10, b"\x02", idempotent=True)
    assert await bus.transfer(0x68, b"\x10", read=1, idempotent=True) == b"\x02"

    assert bus.stats.retries == 2
    assert bus.stats.errors == 0
    await bus.close()


@pytest.mark.fault("I01")
@pytest.mark.parametrize("code", SILENT)
async def test_nothing_else_is_repeated_when_nobody_answers(fake_i2c, code) -> None:
    """A write may have been half done: its caller decides."""
    bus = fake_i2c(chips={0x68: b""})
    await bus.open()
    uses = [
        lambda: bus.write(0x68, 0x10, b"\x02"),
        lambda: bus.transfer(0x68, b"\x10", read=1),
        lambda: bus.read(0x68, 0x3A, idempotent=False),
        lambda: bus.transaction(lambda link: link.read_byte_data(0x68, 0)),
    ]

    for use in uses:
        bus.fail(code)
        with pytest.raises(DeviceFaultError, match="does not answer") as caught:
            await use()
        assert caught.value.errno == code

    assert bus.log == []
    assert bus.stats.retries == 0
    assert bus.stats.errors == len(uses)
    assert "does not answer" in bus.stats.last_error
    await bus.close()


@pytest.mark.fault("I01")
async def test_a_chip_that_stays_silent_is_asked_a_few_times(fake_i2c) -> None:
    """The error names it; the others on the bus are not touched."""
    bus = fake_i2c(chips={0x68: b"", 0x40: {0: 7}})
    await bus.open()
    bus.silent(0x68)

    with pytest.raises(DeviceFaultError, match="chip 0x68 does not answer"):
        await bus.read(0x68, 0)
    with pytest.raises(DeviceFaultError, match="chip 0x69 does not answer"):
        await bus.read(0x69, 0)
    assert await bus.read(0x40, 0) == b"\x07"
    bus.silent(0x68, silent=False)
    assert await bus.read(0x68, 0) == b"\x00"

    assert bus.stats.retries == 6
    assert bus.stats.errors == 2
    assert bus.is_open
    await bus.close()


@pytest.mark.fault("I02")
@pytest.mark.parametrize("code", BROKEN)
@pytest.mark.parametrize("idempotent", [True, False])
async def test_a_broken_transfer_is_a_fault_with_its_number(
    fake_i2c, code: int, idempotent: bool
) -> None:
    """Nothing of it is used or repeated, and the bus stays open."""
    bus = fake_i2c(chips={0x68: b""})
    await bus.open()
    bus.fail(code)

    with pytest.raises(DeviceFaultError, match="chip 0x68 failed") as caught:
        await bus.read(0x68, 0x75, idempotent=idempotent)

    assert caught.value.errno == code
    assert bus.stats.retries == 0
    assert bus.is_open
    assert await bus.read(0x68, 0x75) == b"\x00"
    await bus.close()


@pytest.mark.fault("I03")
@pytest.mark.parametrize("code", [errno.EAGAIN, errno.EBUSY])
async def test_a_bus_that_another_master_has_is_asked_again(fake_i2c, code) -> None:
    """Nothing of the transfer was done, so even a write is repeated; not for ever."""
    bus = fake_i2c(chips={0x68: b""})
    await bus.open()

    bus.fail(code, times=3)
    await bus.write(0x68, 0x10, b"\x02")
    assert bus.stats.retries == 3
    assert bus.stats.errors == 0

    bus.fail(code, times=None)
    with pytest.raises(
        DeviceFaultError, match="another master keeps the bus"
    ) as caught:
        await bus.read(0x68, 0x10)
    assert caught.value.errno == code
    assert bus.stats.retries == 6
    await bus.close()


@pytest.mark.fault("I03")
async def test_a_part_of_a_transaction_is_not_repeated_unasked(fake_i2c) -> None:
    """Its first transfers were done; only its author knows whether they may be again."""
    bus = fake_i2c(chips={0x68: {0: 5}})
    await bus.open()

    def both(link: Any) -> Any:
        first = link.read_byte_data(0x68, 0)
        return first + link.read_byte_data(0x68, 0)

    bus.fail(errno.EAGAIN, after=1)
    with pytest.raises(DeviceFaultError):
        await bus.transaction(both)
    bus.fail(errno.EAGAIN, after=1)
    assert await bus.transaction(both, idempotent=True) == 10

    assert len(bus.log) == 1 + 1 + 2
    await bus.close()


@pytest.mark.fault("I03")
async def test_the_pauses_grow_vary_and_end_with_the_deadline(fake_i2c) -> None:
    """Two masters that lose to each other do not try in step."""
    loop = asyncio.get_running_loop()
    seen = set()
    for name in ("left", "right"):
        bus = fake_i2c(name, chips={0x68: b""})
        await bus.open()
        bus.fail(errno.EAGAIN, times=3)
        begin = loop.time()
        await bus.read(0x68, 0)
        seen.add(round(loop.time() - begin, 6))
        bus.fail(errno.EAGAIN, times=None)
        begin = loop.time()
        with pytest.raises(DeviceFaultError):
            await bus.read(0x68, 0, timeout=0.002)
        assert loop.time() - begin <= 0.002
        await bus.close()

    assert len(seen) == 2
    assert all(0.0035 <= seconds <= 0.0105 for seconds in seen)


@pytest.mark.fault("I04")
async def test_an_adapter_that_gave_up_is_stuck(fake_i2c) -> None:
    """A chip held the clock for longer than the adapter waits; it is not a value."""
    bus = fake_i2c(chips={0x68: b""})
    await bus.open()
    bus.fail(errno.ETIMEDOUT)

    with pytest.raises(DriverStuckError, match="chip 0x68"):
        await bus.read(0x68, 0)

    assert await bus.read(0x68, 0) == b"\x00"
    await bus.close()


async def stick() -> None:
    """All get an error in time, the later ones at once; what waited is not made late."""
    bus = FakeI2c(chips={0x68: b"", 0x40: b""}, timeout=0.1)
    await bus.open()
    loop = asyncio.get_running_loop()
    bus.stall()
    begin = loop.time()

    failed = await asyncio.gather(
        bus.write(0x68, 0x10, b"\x11"),
        bus.write(0x40, 0x10, b"\x22"),
        return_exceptions=True,
    )
    assert [type(each) for each in failed] == [DriverStuckError, NoTurnError]
    assert "a transfer with chip 0x68 did not return in 0.1 s" in str(failed[0])
    assert loop.time() - begin < 2.0
    assert bus.stuck_since is not None
    begin = loop.time()
    with pytest.raises(NoTurnError, match="a transfer"):
        await bus.write(0x40, 0x10, b"\x33")
    assert loop.time() - begin < bus.timeout
    assert bus.stats.refused == 1

    bus.resume()
    await until(lambda: bus.stuck_since is None)
    assert [each.written for each in bus.log] == [b"\x10\x11"]  # it was on the wire
    assert await bus.read(0x40, 0x10) == b"\x00"
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("I04")
async def test_a_stuck_transfer_stops_the_whole_bus_until_it_returns() -> None:
    """All get an error in time, the later ones at once; what waited is not made late."""
    await stick()


@pytest.mark.real_clock
@pytest.mark.fault("I04")
async def test_a_stuck_transfer_stops_the_whole_bus_until_it_returns_on_its_thread() -> (
    None
):
    """All get an error in time, the later ones at once; what waited is not made late."""
    await stick()


async def stretch() -> None:
    """A stretched clock is waited for within the time; longer is stuck, then good."""
    bus = FakeI2c(chips={0x68: {1: 9}}, timeout=0.5)
    await bus.open()

    bus.stretch(0.05)
    assert await bus.read(0x68, 1) == b"\x09"
    with pytest.raises(DriverStuckError):
        await bus.read(0x68, 1, timeout=0.01)
    await until(lambda: bus.stuck_since is None)
    bus.stretch(0.0)
    assert await bus.read(0x68, 1) == b"\x09"
    await bus.close()


@pytest.mark.virtual_clock
@pytest.mark.fault("I04", "D20")
async def test_a_slow_chip_costs_its_users_deadline() -> None:
    """A stretched clock is waited for within the time; longer is stuck, then good."""
    await stretch()


@pytest.mark.real_clock
@pytest.mark.fault("I04", "D20")
async def test_a_slow_chip_costs_its_users_deadline_on_its_thread() -> None:
    """A stretched clock is waited for within the time; longer is stuck, then good."""
    await stretch()


class Register(esair.Sensor[int]):
    """One register of a chip."""

    deadline = 0.5

    def __init__(self, *, address: int, **options) -> None:
        super().__init__(**options)
        self.address = address

    async def read(self) -> int:
        """Read it."""
        data: bytes = await self.bus.read(self.address, 0)
        return data[0]


@pytest.mark.fault("I04", "D14")
async def test_all_devices_on_a_stuck_bus_are_stale(fake_i2c) -> None:
    """None passes an old value off as current; all are back when the bus is."""
    bus = fake_i2c(chips={0x68: {0: 1}, 0x40: {0: 2}})
    sensors = [
        Register(name="left", address=0x68, bus=bus, rate=50.0),
        Register(name="right", address=0x40, bus=bus, rate=50.0),
    ]

    needs = {name: esair.reads(int, max_age=0.1) for name in ("left", "right")}
    user = esair.Behavior(name="user", reads=needs, writes={})

    async with esair.Robot(resources=sensors, behaviors=[user]):
        assert await user.left.read() == 1
        assert await user.right.read() == 2
        bus.stall()
        await asyncio.sleep(0.5)
        for port in (user.left, user.right):
            with pytest.raises((TimeoutError, OSError)):
                await port.read()
        bus.resume()
        await asyncio.sleep(10.0)
        assert await user.left.read() == 1
        assert await user.right.read() == 2


@pytest.mark.virtual_clock
@pytest.mark.fault("I06")
async def test_a_chip_of_a_driver_of_the_kernel_is_not_taken(
    tmp_path, monkeypatch
) -> None:
    """It says how to take it back; nothing is forced, and nothing is repeated."""
    driver = tmp_path / "bus/i2c/drivers/lm75"
    device = tmp_path / "1-0048"
    driver.mkdir(parents=True)
    device.mkdir()
    (device / "driver").symlink_to(driver)
    from esair.buses.i2c import _kernel as _i2c_kernel

    owner = _i2c_kernel.owner("/dev/i2c-1", 0x48, tmp_path)
    assert owner == device / "driver"
    assert _i2c_kernel.owner("/dev/i2c-1", 0x49, tmp_path) is None

    monkeypatch.setattr(_i2c_kernel, "owner", lambda _path, _address: owner)
    bus = I2CBus(name="body")
    bus.path, bus.is_open = "/dev/i2c-1", True
    monkeypatch.setattr(bus, "_same_place", lambda: True)
    error = bus._explained(OSError(errno.EBUSY, "busy"), 0x48, 0.2)

    assert isinstance(error, DeviceFaultError)
    assert error.errno == errno.EBUSY
    assert f"echo 1-0048 > {device}/driver/unbind" in str(error)


@pytest.mark.fault("I06")
async def test_a_scan_tells_chips_of_the_kernel_from_those_that_answer(
    fake_i2c,
) -> None:
    """Whoever has the chip keeps it."""
    bus = fake_i2c(chips={0x20: b"", 0x50: b"", 0x68: b""})
    await bus.open()
    bus.fail(errno.EBUSY, times=None, address=0x50)

    assert await bus.scan() == {0x20: "answers", 0x50: "busy", 0x68: "answers"}

    assert bus.stats.errors == 0
    await bus.close()


@pytest.mark.fault("D01")
async def test_an_adapter_that_is_gone_is_a_loss_of_the_bus(fake_i2c) -> None:
    """Everybody on the bus learns of it, not only who asked."""
    bus = fake_i2c(chips={0x68: {0x75: 0x68}})
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    bus.fail(errno.ENODEV)

    with pytest.raises(DeviceLostError):
        await bus.read(0x68, 0x75)

    assert len(told) == 1
    with pytest.raises(DeviceLostError, match="not open"):
        await bus.read(0x68, 0x75)
    await bus.open()
    assert await bus.read(0x68, 0x75) == b"\x68"
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.fault("D21")
async def test_a_stuck_bus_does_not_hold_up_the_loop_or_its_own_close() -> None:
    """The thread is left behind, as a daemon; the next opening has another one."""
    bus = FakeI2c("held", chips={0x68: {0: 3}}, timeout=0.05)
    await bus.open()
    bus.stall()
    with pytest.raises(DriverStuckError):
        await bus.read(0x68, 0)
    stuck = [each for each in threading.enumerate() if each.name == "esair-held"]

    loop = asyncio.get_running_loop()
    begin = loop.time()
    await bus.close()
    assert loop.time() - begin < 2.0
    assert [each.daemon for each in stuck] == [True]
    bus.resume()
    await bus.open()
    assert await bus.read(0x68, 0) == b"\x03"
    await bus.close()
    for thread in stuck:
        thread.join(5.0)
        assert not thread.is_alive()


@pytest.mark.real_clock
@pytest.mark.fault("D22")
async def test_a_caller_that_gave_up_is_not_obeyed_late() -> None:
    """A write that was cancelled while it waited never reaches the chip."""
    bus = FakeI2c(chips={0x40: b""}, timeout=5.0)
    await bus.open()
    bus.stall()
    first = asyncio.ensure_future(bus.read(0x40, 0))
    await asyncio.sleep(0)
    second = asyncio.ensure_future(bus.write(0x40, 0x10, b"\x64"))
    await asyncio.sleep(0)
    second.cancel()
    await asyncio.wait({second})
    bus.resume()

    assert await first == b"\x00"
    assert await bus.read(0x40, 0x10) == b"\x00"
    assert [each.written for each in bus.log] == [b"\x00", b"\x10"]
    await bus.close()


@pytest.mark.virtual_clock
async def test_other_errors_of_a_transaction_are_its_own() -> None:
    """A mistake in the caller's function comes out as it is."""
    bus: I2CBus = FakeI2c(chips={0x40: b""})
    await bus.open()

    with pytest.raises(KeyError):
        await bus.transaction(lambda _: dict[str, int]()["nothing"])

    assert bus.stats.errors == 0
    await bus.close()


@pytest.mark.real_clock
@pytest.mark.promise("RES-3")
async def test_a_transfer_that_is_cut_by_a_loss_is_lost_too() -> None:
    """Whatever it fails with: its bus has gone, and can tell of no fault any more."""
    bus = FakeI2c(chips={0x50: b"\0"})
    await bus.open()
    begun, go = threading.Event(), threading.Event()

    def cut(_link: Any) -> None:
        begun.set()
        go.wait(5.0)
        raise OSError(errno.EIO, "Input/output error")

    transfer = asyncio.ensure_future(bus.transaction(cut, address=0x50, timeout=5.0))
    await until(begun.is_set)
    bus.lost(DeviceLostError("i2c", "it was unplugged"))
    go.set()
    with pytest.raises(DeviceLostError):
        await transfer
    await bus.close()
