"""What hangs with the bare packages, each shown there, and shown absent here.

The bare packages run in a child process: what hangs there never comes back.
"""

from __future__ import annotations

import asyncio
import os
import pty
import resource
import subprocess
import sys
import termios
import textwrap
import time
import tty
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

import pytest
import serial  # type: ignore[import-untyped]
from tests.patience import within

from esair.buses import SerialBus
from esair.exceptions import BusyError, DeviceLostError, DriverStuckError
from esair.loop import SAFE, Urgency, urgency

pytestmark = pytest.mark.real_clock

PATIENCE = 20.0
"""How long a child process may take in all, in seconds; it ends far sooner."""

LONGEST_STALL = 1.0
"""How long the event loop may be kept, in seconds; far more than it is."""

PORT = """\
    import asyncio, faulthandler, os, pty, sys, termios, tty
    import serial, serial_asyncio

    master, slave = pty.openpty()
    tty.setraw(slave)
    port = os.ttyname(slave)


    class Protocol(asyncio.Protocol):
        lost = False
        received = b""

        def data_received(self, data):
            self.received += data

        def connection_lost(self, exc):
            self.lost = True
"""


def child(script: str) -> subprocess.CompletedProcess[str]:
    """Run a script that uses the bare packages."""
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", textwrap.dedent(PORT + script)],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


@contextmanager
def terminal() -> Iterator[tuple[int, int]]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    try:
        yield master, slave
    finally:
        os.close(master)
        os.close(slave)


@asynccontextmanager
async def turning() -> AsyncIterator[None]:
    """Fail if the event loop is kept meanwhile."""
    longest = 0.0

    async def beat() -> None:
        nonlocal longest
        while True:
            before = time.monotonic()
            await asyncio.sleep(0.005)
            longest = max(longest, time.monotonic() - before)

    beating = asyncio.create_task(beat())
    try:
        yield
    finally:
        beating.cancel()
        await asyncio.wait({beating})
    assert longest < LONGEST_STALL


async def write_on(bus: SerialBus) -> None:
    """Write until the kernel has looked at what the device has sent."""
    async with asyncio.timeout(PATIENCE):
        while True:
            await bus.write(b"forward\n")
            await asyncio.sleep(0.001)


async def is_stuck(bus: SerialBus) -> bool:
    try:
        await bus.write(b"stop\n")
    except DriverStuckError:
        return True
    return False


@pytest.mark.fault("D16")
@pytest.mark.long
def test_bare_a_write_that_must_not_wait_never_returns() -> None:
    """pyserial tries again and again while the device takes nothing (pyserial#280)."""
    ended = child("""\
    async def main():
        faulthandler.dump_traceback_later(1.0, exit=True)  # the loop cannot help
        device = serial.Serial(port, timeout=0, write_timeout=0)
        termios.tcflow(slave, termios.TCOOFF)
        device.write(b"forward 1.0")
        print("written")

    asyncio.run(main())
    """)

    assert ended.returncode == 1
    assert ended.stdout == ""
    assert 'serialposix.py", line' in ended.stderr
    assert " in write" in ended.stderr


@pytest.mark.fault("D16")
@pytest.mark.parametrize("size", [8, 16, 64, 256])
async def test_here_a_write_ends_at_its_deadline(size: int) -> None:
    """The writer gets an error, the loop turns, nothing that waited is sent later."""
    with terminal() as (master, slave):
        bus = SerialBus(name="front", port=os.ttyname(slave), write_timeout=0.1)
        await bus.open()
        termios.tcflow(slave, termios.TCOOFF)

        async with turning():
            for _ in range(2):
                with pytest.raises(DriverStuckError, match=r"0\.1 s"):
                    await bus.write(b"x" * size)

        assert bus.stats.discarded == 2 * size
        termios.tcflow(slave, termios.TCOON)
        await bus.write(b"stop\n")
        assert os.read(master, 4096) == b"stop\n"
        await bus.close()


@pytest.mark.fault("D16")
@pytest.mark.parametrize(
    ("level", "heard"), [(0, b"\nstop\n"), (SAFE, b"forward\nstop\n")]
)
async def test_here_what_the_kernel_has_taken_is_thrown_away_too(
    monkeypatch: pytest.MonkeyPatch, level: int, heard: bytes
) -> None:
    """A port keeps some 4096 bytes for a device that takes none; what is safe stays."""

    def thrown_away(_: serial.Serial) -> None:
        termios.tcflush(master, termios.TCIFLUSH)

    with terminal() as (master, slave):
        bus = SerialBus(name="front", port=os.ttyname(slave), write_timeout=0.1)
        await bus.open()
        urgency.set(Urgency(level))
        await bus.write(b"forward\n")
        urgency.set(Urgency())
        monkeypatch.setattr(serial.Serial, "out_waiting", 8)
        monkeypatch.setattr(serial.Serial, "reset_output_buffer", thrown_away)
        termios.tcflow(slave, termios.TCOOFF)
        with pytest.raises(DriverStuckError):
            await bus.write(b"faster\n")

        termios.tcflow(slave, termios.TCOON)
        await bus.write(b"stop\n")
        told = b""
        while not told.endswith(b"stop\n"):
            told += os.read(master, 4096)
        assert told == heard
        await bus.close()


@pytest.mark.fault("D16")
async def test_here_the_kernel_gets_no_more_than_is_sent_soon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A port would take 4096 bytes, and at 9600 baud a stop would come 4 s late."""
    held, asked = 200, 0

    def out_waiting(_: serial.Serial) -> int:
        nonlocal asked
        asked += 1
        return held

    monkeypatch.setattr(serial.Serial, "out_waiting", property(out_waiting))
    with terminal() as (master, slave):
        port = os.ttyname(slave)
        bus = SerialBus(name="front", port=port, baudrate=9600, write_timeout=0.1)
        await bus.open()
        await bus.write(b"forward\n")
        assert os.read(master, 4096) == b"forward\n"

        held = 300
        with pytest.raises(DriverStuckError):
            await bus.write(b"faster\n")
        assert bus.stats.discarded == 7
        assert asked < 50  # it is no busy wait

        writes = [asyncio.ensure_future(bus.write(each)) for each in (b"a\n", b"b\n")]
        await asyncio.sleep(0.02)
        assert bus.waiting == 4
        held = 100
        await asyncio.gather(*writes)
        assert os.read(master, 4096) == b"a\nb\n"

        held = 300  # what is safe waits for nothing: it would be thrown away
        write = asyncio.ensure_future(bus.write(b"c\n"))
        await asyncio.sleep(0.01)
        urgency.set(Urgency(SAFE))
        await bus.write(b"stop\n")
        with pytest.raises(BusyError):
            await write
        assert os.read(master, 4096) == b"stop\n"
        held = 0
        await bus.close()


@pytest.mark.fault("D16")
async def test_here_everybody_who_waits_is_told() -> None:
    """What is thrown away with the first write's deadline is not sent for the others."""
    with terminal() as (master, slave):
        bus = SerialBus(name="front", port=os.ttyname(slave))
        await bus.open()
        termios.tcflow(slave, termios.TCOOFF)

        done = await asyncio.gather(
            bus.write(b"one\n", timeout=0.1),
            bus.write(b"two\n", timeout=PATIENCE),
            bus.write(b"three\n", timeout=PATIENCE),
            return_exceptions=True,
        )

        assert [type(each) for each in done] == [DriverStuckError] * 3
        assert bus.stats.discarded == 14
        termios.tcflow(slave, termios.TCOON)
        await bus.write(b"stop\n")
        assert os.read(master, 4096) == b"stop\n"
        await bus.close()


@pytest.mark.fault("D16")
async def test_here_an_xoff_of_the_device_costs_the_writer_its_deadline() -> None:
    """One byte of a device with software flow control stops nobody else."""
    with terminal() as (master, slave):
        bus = SerialBus(
            name="front", port=os.ttyname(slave), write_timeout=0.1, xonxoff=True
        )
        await bus.open()
        os.write(master, b"\x13")

        async with turning():
            with pytest.raises(DriverStuckError):
                await write_on(bus)
            os.write(master, b"\x11")
            async with asyncio.timeout(PATIENCE):
                while await is_stuck(bus):
                    pass
            await bus.close()


@pytest.mark.fault("D18")
@pytest.mark.long
def test_bare_a_close_never_finishes() -> None:
    """pyserial-asyncio waits for the device to take what was written before."""
    ended = child("""\
    async def main():
        loop = asyncio.get_running_loop()
        transport, protocol = await serial_asyncio.create_serial_connection(
            loop, Protocol, port
        )
        await asyncio.sleep(0.1)
        termios.tcflow(slave, termios.TCOOFF)
        transport.write(b"forward 1.0")
        transport.close()
        await asyncio.sleep(1.0)
        print(protocol.lost, flush=True)
        os._exit(0)

    asyncio.run(main())
    """)

    assert ended.stdout == "False\n"


@pytest.mark.fault("D18")
@pytest.mark.longer
async def test_here_a_close_is_quick() -> None:
    """What waits is thrown away, in a thread; the port can be opened again at once."""
    with terminal() as (_master, slave):
        bus = SerialBus(name="front", port=os.ttyname(slave), write_timeout=PATIENCE)
        await bus.open()
        termios.tcflow(slave, termios.TCOOFF)
        writing = asyncio.create_task(bus.write(b"forward 1.0\n"))
        await asyncio.sleep(0)

        async with turning():
            begin = time.monotonic()
            await bus.close()
            took = time.monotonic() - begin

        with pytest.raises(DeviceLostError, match="closed"):
            await writing
        assert within(1.5, took)
        termios.tcflow(slave, termios.TCOON)
        await bus.open()
        await bus.close()


@pytest.mark.fault("D17")
def test_bare_a_write_after_the_close_is_swallowed() -> None:
    """pyserial-asyncio says nothing, and sends nothing."""
    ended = child("""\
    async def main():
        loop = asyncio.get_running_loop()
        transport, protocol = await serial_asyncio.create_serial_connection(
            loop, Protocol, port
        )
        transport.close()
        transport.write(b"stop")
        await asyncio.sleep(0.1)
        os.set_blocking(master, False)
        try:
            print(os.read(master, 100))
        except BlockingIOError:
            print("nothing came, nobody was told")

    asyncio.run(main())
    """)

    assert ended.stdout == "nothing came, nobody was told\n"


@pytest.mark.fault("D17")
async def test_here_a_write_after_the_close_says_so() -> None:
    """Whoever writes learns that nothing was sent."""
    with terminal() as (_master, slave):
        bus = SerialBus(name="front", port=os.ttyname(slave))
        await bus.open()
        await bus.close()

        with pytest.raises(DeviceLostError, match="not open"):
            await bus.write(b"stop\n")


@pytest.mark.fault("D27")
def test_bare_a_high_descriptor_is_a_storm() -> None:
    """pyserial uses select(): above 1023 it raises at each turn and hears nothing."""
    ended = child("""\
    import resource

    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(2048, hard), hard))
    many = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    errors = []


    async def main():
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda loop, context: errors.append(context))
        transport, protocol = await serial_asyncio.create_serial_connection(
            loop, Protocol, port
        )
        await asyncio.sleep(0.1)
        os.write(master, b"hello")
        await asyncio.sleep(0.2)
        print(len(errors) > 100, protocol.received, type(errors[0]["exception"]))
        sys.stdout.flush()
        os._exit(0)

    asyncio.run(main())
    """)

    assert ended.stdout == "True b'' <class 'ValueError'>\n"


@pytest.mark.fault("D27")
async def test_here_a_high_descriptor_is_one_like_any_other() -> None:
    """Read, written, hung up and closed, with no error on the way."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < 2048:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(2048, hard), hard))
    many = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    errors: list[object] = []
    asyncio.get_running_loop().set_exception_handler(
        lambda _loop, context: errors.append(context)
    )
    try:
        with terminal() as (master, slave):
            bus = SerialBus(name="front", port=os.ttyname(slave))
            await bus.open()
            assert bus._open_device.fileno() > 1023
            inbox = bus.frames()

            os.write(master, b"hello\n")
            assert await inbox.take(timeout=2) == b"hello"
            await bus.write(b"hi\n")
            assert os.read(master, 100) == b"hi\n"
        with pytest.raises(DeviceLostError):
            await inbox.take(timeout=2)
        await bus.close()
    finally:
        for fd in many:
            os.close(fd)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert errors == []


@pytest.mark.fault("D19")
async def test_here_a_port_is_closed_before_it_is_opened_again() -> None:
    """A hundred hang-ups and openings in a row, with no descriptor left behind."""
    before = len(os.listdir("/proc/self/fd"))
    bus = None
    for _ in range(100):
        with terminal() as (_master, slave):
            if bus is None:
                bus = SerialBus(name="front", port=os.ttyname(slave))
            bus.port = os.ttyname(slave)
            await bus.open()
            inbox = bus.frames()
        with pytest.raises(DeviceLostError):
            await inbox.take(timeout=2)
    assert bus is not None
    await bus.close()

    assert bus.stats.lost == 100
    assert len(os.listdir("/proc/self/fd")) == before
