"""The serial bus on pseudo-terminals: real descriptors, real time."""

from __future__ import annotations

import asyncio
import os
import pty
import resource
import select
import tty
from collections.abc import Iterator

import pytest

from esair.buses import SerialBus
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceLostError,
    DriverStuckError,
)

pytestmark = pytest.mark.real_clock


class Far:
    """The device's end of a pseudo-terminal."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.port = os.ttyname(self.slave)

    def write(self, data: bytes) -> None:
        os.write(self.master, data)

    def read(self) -> bytes:
        try:
            return os.read(self.master, 65536)
        except BlockingIOError:
            return b""

    def hang_up(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1


@pytest.fixture
def far() -> Iterator[Far]:
    end = Far()
    yield end
    end.hang_up()


async def fill(bus: SerialBus, size: int) -> None:
    """Write more than the kernel has room for."""
    for _ in range(4096):
        await bus.write(b"x" * size)


async def test_each_listener_gets_the_lines_with_its_prefix(far: Far) -> None:
    """Two devices share one line, and neither sees what the other says."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()
    ranges, bumper = bus.frames(b"$RF"), bus.frames(b"$BM")

    far.write(b"$RFSWP,1\r\n$BMSTA,1,0\r\nnoise\n$RFSW")
    far.write(b"P,2\r\n")

    assert await ranges.take(timeout=1) == b"$RFSWP,1\r"
    assert await ranges.take(timeout=1) == b"$RFSWP,2\r"
    assert await bumper.take(timeout=1) == b"$BMSTA,1,0\r"
    assert bus.stats.unheard == 1
    await bus.close()


@pytest.mark.fault("D08")
@pytest.mark.parametrize("cut", range(1, 12))
async def test_a_line_may_come_in_any_two_pieces(far: Far, cut: int) -> None:
    """The pieces in which bytes arrive make no difference."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()
    inbox = bus.frames()
    text = b"$RFSWP,1,2\r\n"

    far.write(text[:cut])
    await asyncio.sleep(0.002)
    far.write(text[cut:])

    assert await inbox.take(timeout=1) == text[:-1]
    await bus.close()


@pytest.mark.fault("D13")
async def test_a_slow_listener_gets_the_newest_lines(far: Far) -> None:
    """A full inbox loses its oldest lines, and counts them."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()
    inbox = bus.frames(b"n", limit=3)
    last = bus.frames(b"end")

    far.write(b"".join(b"n%d\n" % number for number in range(10)) + b"end\n")
    await last.take(timeout=1)

    assert [await inbox.take() for _ in range(3)] == [b"n7", b"n8", b"n9"]
    assert inbox.dropped == 7
    assert bus.stats.dropped == 7
    await bus.close()


@pytest.mark.fault("D11")
async def test_a_line_that_never_ends_takes_no_memory(far: Far) -> None:
    """It is thrown away and counted; the next line is whole again."""
    bus = SerialBus(
        name="front", port=far.port, framing={"type": "lines", "max_length": 100}
    )
    await bus.open()
    inbox = bus.frames()

    far.write(b"x" * 1000)
    await asyncio.sleep(0.01)
    far.write(b"x" * 500 + b"\nwhole\n")

    assert await inbox.take(timeout=1) == b"whole"
    assert bus.stats.received == 1507
    assert bus.framing.discarded >= 1500
    assert bus.stats.bad_frames == 1
    await bus.close()


@pytest.mark.fault("D01")
@pytest.mark.fault("D03")
async def test_a_hang_up_reaches_everybody_on_the_line_at_once(far: Far) -> None:
    """Listeners and the bus itself learn of it, once, whoever was reading."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()
    waiting, idle = bus.frames(b"a"), bus.frames(b"b")
    told: list[BaseException] = []
    bus.on_lost(told.append)
    reading = asyncio.create_task(waiting.take(timeout=2))
    await asyncio.sleep(0)

    far.hang_up()

    with pytest.raises(DeviceLostError, match="'front'"):
        await reading
    with pytest.raises(DeviceLostError):
        await idle.take(timeout=1)
    assert len(told) == 1
    assert not bus.is_open
    await bus.close()


@pytest.mark.fault("D17")
async def test_a_write_after_the_loss_says_so(far: Far) -> None:
    """Nothing is swallowed by a transport that is closing."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()
    inbox = bus.frames()
    far.hang_up()
    with pytest.raises(DeviceLostError):
        await inbox.take(timeout=1)

    with pytest.raises(DeviceLostError, match="not open"):
        await bus.write(b"stop\n")

    await bus.close()


@pytest.mark.fault("D04")
async def test_a_line_that_is_back_can_be_opened_again(far: Far) -> None:
    """After a loss the same bus opens whatever is at its port now."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()
    inbox = bus.frames()
    far.hang_up()
    with pytest.raises(DeviceLostError):
        await inbox.take(timeout=1)
    again = Far()
    bus.port = again.port

    await bus.open()

    inbox = bus.frames()
    again.write(b"hello\n")
    assert await inbox.take(timeout=1) == b"hello"
    await bus.write(b"hi\n")
    await asyncio.sleep(0.01)
    assert again.read() == b"hi\n"
    await bus.close()
    again.hang_up()


async def test_a_port_that_is_not_there_is_a_lost_device() -> None:
    """The error names the port; the supervisor will try again."""
    bus = SerialBus(name="front", port="/dev/there-is-none")

    with pytest.raises(DeviceLostError, match="/dev/there-is-none"):
        await bus.open()

    await bus.close()


@pytest.mark.fault("D16")
@pytest.mark.parametrize("size", [8, 64, 256])
async def test_a_device_that_takes_no_bytes_stops_nobody(far: Far, size: int) -> None:
    """The writer gets an error at its deadline; the event loop never waits for it."""
    bus = SerialBus(name="front", port=far.port, write_timeout=0.2)
    await bus.open()
    longest = 0.0
    loop = asyncio.get_running_loop()

    async def watch() -> None:
        nonlocal longest
        while True:
            begin = loop.time()
            await asyncio.sleep(0.005)
            longest = max(longest, loop.time() - begin)

    watching = asyncio.create_task(watch())
    with pytest.raises(DriverStuckError, match=r"0\.2 s"):
        await fill(bus, size)
    watching.cancel()

    assert bus.stats.discarded > 0
    assert bus.stats.errors == 1
    assert "stuck" in bus.stats.last_error
    assert bus.waiting == 0
    assert longest < 1.0
    begin = loop.time()
    await bus.close()
    assert loop.time() - begin < 1.0


async def test_bytes_that_wait_are_bounded(far: Far) -> None:
    """More than the limit is refused at once, and nothing of it is sent."""
    bus = SerialBus(name="front", port=far.port, out_limit=100)
    await bus.open()

    with pytest.raises(BusyError, match="100"):
        await bus.write(b"x" * 101)

    assert bus.stats.refused == 1
    await bus.close()
    assert far.read() == b""


async def test_bytes_are_counted_in_both_directions(far: Far) -> None:
    """What the kernel took is sent, what it gave is received."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()
    inbox = bus.frames()

    await bus.send(b"who?")
    far.write(b"sonar\n")
    await inbox.take(timeout=1)

    assert far.read() == b"who?\n"
    assert bus.stats.sent == 5
    assert bus.stats.received == 6
    await bus.close()


@pytest.mark.promise("AC-3")
async def test_a_write_leaves_in_the_step_that_asks_for_it(far: Far) -> None:
    """Nothing can come between the last check of a command and its bytes."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()

    writing = bus.write(b"go\n")
    with pytest.raises(StopIteration):
        writing.send(None)

    ready, _, _ = select.select([far.master], [], [], 1.0)
    assert ready
    assert far.read() == b"go\n"
    await bus.close()


async def test_what_was_written_before_the_close_still_arrives(far: Far) -> None:
    """The last command, which is the safe one, is not thrown away by the close."""
    bus = SerialBus(name="front", port=far.port)
    await bus.open()

    await bus.write(b"stop\n")
    await bus.close()

    assert far.read() == b"stop\n"


@pytest.mark.fault("D27")
async def test_descriptors_beyond_select_work(far: Far) -> None:
    """A port with a descriptor above 1023 is read and written like any other."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < 1200:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(1200, hard), hard))
    many = [os.open(os.devnull, os.O_RDONLY) for _ in range(1030)]
    try:
        bus = SerialBus(name="front", port=far.port)
        await bus.open()
        inbox = bus.frames()
        far.write(b"hello\n")
        assert await inbox.take(timeout=1) == b"hello"
        await bus.write(b"hi\n")
        await bus.close()
    finally:
        for fd in many:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert far.read() == b"hi\n"


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({}, "port"),
        ({"port": "usb:403:6001"}, "port"),
        ({"port": "/dev/x", "baudrate": 0}, "baudrate"),
        ({"port": "/dev/x", "out_limit": 0}, "out_limit"),
        ({"port": "/dev/x", "bad_limit": 0}, "bad_limit"),
        ({"port": "/dev/x", "write_timeout": 0.0}, "write_timeout"),
        ({"port": "/dev/x", "write_timeout": float("nan")}, "write_timeout"),
        ({"port": "/dev/x", "framing": 3}, "framing"),
        ({"port": "/dev/x", "framing": "morse"}, "framing"),
        ({"port": "/dev/x", "framing": {"type": "lines", "delimiter": ""}}, "framing"),
    ],
)
def test_a_wrong_description_names_its_field(
    options: dict[str, object], field: str
) -> None:
    """Nothing is opened to find out."""
    with pytest.raises(ConfigError) as caught:
        SerialBus(name="front", **options)  # type: ignore[arg-type]

    assert caught.value.field == field
