"""Where a port is found and whose it is: paths, USB devices, URLs, owners."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import pty
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from tests.patience import within

from esair.buses import SerialBus
from esair.buses.serial import _port as _serial_port
from esair.buses.serial import _ports
from esair.buses.serial._port import Port, SerialPlace, explain, reach_port
from esair.exceptions import ConfigError, DeviceLostError
from esair.loop import Executor

pytestmark = pytest.mark.real_clock


class Terminal:
    """A pseudo-terminal that says who it is."""

    def __init__(self, greeting: bytes) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)
        self.greeting = greeting

    def greet(self) -> None:
        os.write(self.master, self.greeting + b"\n")

    def close(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1


@pytest.fixture
def first() -> Iterator[Terminal]:
    terminal = Terminal(b"first")
    yield terminal
    terminal.close()


@pytest.fixture
def second() -> Iterator[Terminal]:
    terminal = Terminal(b"second")
    yield terminal
    terminal.close()


# Identity.


@pytest.mark.fault("D06")
async def test_a_renumbered_device_is_found_by_its_link(
    tmp_path: Path, first: Terminal, second: Terminal
) -> None:
    """What udev links to counts at each opening, not what it linked to once."""
    link = tmp_path / "usb-Maker_Sonar_1-if00"
    link.symlink_to(first.path)
    bus = SerialBus(name="front", port=str(link))
    await bus.open()
    inbox = bus.frames()
    first.close()
    with pytest.raises(DeviceLostError):
        await inbox.take(timeout=2)

    link.unlink()
    link.symlink_to(second.path)
    await bus.open()

    inbox = bus.frames()
    second.greet()
    assert await inbox.take(timeout=2) == b"second"
    await bus.close()


@pytest.mark.fault("D06")
@pytest.mark.promise("BUS-2")
async def test_a_usb_device_is_found_wherever_it_is(
    monkeypatch: pytest.MonkeyPatch, first: Terminal, second: Terminal
) -> None:
    """Its identity is looked up at each opening."""
    found = {"usb:0403:6001:A1": first.path}
    monkeypatch.setattr(_ports, "find_port", found.__getitem__)
    bus = SerialBus(name="front", port="usb:0403:6001:A1")
    await bus.open()
    assert bus.path == first.path
    await bus.close()

    found["usb:0403:6001:A1"] = second.path
    await bus.open()

    assert bus.path == second.path
    await bus.close()


@pytest.mark.fault("D05")
@pytest.mark.promise("BUS-2")
async def test_a_usb_device_that_is_swapped_while_it_is_opened(
    monkeypatch: pytest.MonkeyPatch, first: Terminal, second: Terminal
) -> None:
    """What was opened is looked at again; another device is let go at once."""
    answers = iter([first.path, first.path, second.path])
    monkeypatch.setattr(_ports, "find_port", lambda _identity: next(answers))
    bus = SerialBus(name="front", port="usb:0403:6001")

    with pytest.raises(DeviceLostError, match="no longer usb:0403:6001"):
        await bus.open()

    await bus.close()
    other = SerialBus(name="other", port=first.path)  # nobody has kept it
    await other.open()
    await other.close()


@pytest.mark.fault("D06")
async def test_a_link_that_udev_has_just_made_is_the_same_device(
    monkeypatch: pytest.MonkeyPatch, first: Terminal, tmp_path: Path
) -> None:
    """The kernel makes the port first and udev its name: what counts is the device."""
    link = tmp_path / "usb-FTDI_FT232R_A1-if00-port0"
    link.symlink_to(first.path)
    answers = iter([first.path, first.path, str(link)])
    monkeypatch.setattr(_ports, "find_port", lambda _identity: next(answers))
    bus = SerialBus(name="front", port="usb:0403:6001")

    await bus.open()

    assert bus.path == first.path
    await bus.close()


async def test_a_usb_device_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """The error names the bus and the identity; the supervisor tries again."""

    def find(identity: str) -> str:
        raise ConnectionError(f"{identity} is not there")

    monkeypatch.setattr(_ports, "find_port", find)
    bus = SerialBus(name="front", port="usb:0403:6001")

    with pytest.raises(DeviceLostError, match=r"'front'.*usb:0403:6001 is not there"):
        await bus.open()

    await bus.close()


@pytest.mark.fault("D06")
async def test_a_number_that_is_chance_is_warned_of(
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    first: Terminal,
) -> None:
    """A raw path is allowed, with a word on what would be better; once."""
    monkeypatch.setattr(SerialPlace, "advice", lambda _place, path: f"{path} is bad")
    bus = SerialBus(name="front", port=first.path)

    with caplog.at_level(logging.WARNING, "esair"):
        for _ in range(2):
            await bus.open()
            await bus.close()

    assert caplog.messages == [f"front: {first.path} is bad"]


@pytest.mark.fault("D06")
@pytest.mark.parametrize(
    ("port", "path", "advice"),
    [
        ("/dev/ttyUSB0", "/dev/ttyUSB0", "usb:0403:6001:A1"),
        ("/dev/ttyACM12", "/dev/ttyACM12", "usb:0403:6001:A1"),
        ("usb:0403:6001", "/dev/ttyUSB0", ""),
        ("/dev/ttyS0", "/dev/ttyS0", ""),
        ("/dev/serial/by-id/usb-x", "/dev/serial/by-id/usb-x", ""),
    ],
)
async def test_which_names_are_chance(
    monkeypatch: pytest.MonkeyPatch, port: str, path: str, advice: str
) -> None:
    """Only the numbers that are given in the order of plugging in."""
    identity = "usb:0403:6001:A1"
    monkeypatch.setattr(_ports, "serial_identity", lambda _path: identity)

    told = SerialPlace("front", port).advice(path)

    assert (advice in told) if advice else told == ""


@pytest.mark.fault("D03", "D04")
async def test_what_is_there_is_seen_without_opening_it(
    tmp_path: Path, first: Terminal, second: Terminal
) -> None:
    """Another arrival at the same path is another value; nothing there is None."""
    link = tmp_path / "port"
    place = SerialPlace("front", str(link))

    assert place.look() is None
    link.symlink_to(first.path)
    seen = place.look()
    assert seen is not None
    assert place.look() == seen
    link.unlink()
    link.symlink_to(second.path)
    assert place.look() not in {None, seen}


# Owners.


@pytest.mark.fault("D07")
async def test_a_port_belongs_to_one_bus(first: Terminal) -> None:
    """The second one is told that it is this very process that has it."""
    one = SerialBus(name="one", port=first.path)
    two = SerialBus(name="two", port=first.path)
    await one.open()

    with pytest.raises(DeviceLostError, match=rf"this process \({os.getpid()}\)"):
        await two.open()

    await one.close()
    await two.open()
    await two.close()


@pytest.mark.fault("D07")
async def test_a_port_of_another_process_names_it(first: Terminal) -> None:
    """So that one knows what to end."""
    script = (
        "import sys, serial\n"
        f"port = serial.Serial({first.path!r}, exclusive=True)\n"
        "print('open', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(  # noqa: ASYNC220 - it is started, not waited for
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdin is not None
        assert other.stdout is not None
        await asyncio.to_thread(other.stdout.readline)
        bus = SerialBus(name="front", port=first.path)

        with pytest.raises(DeviceLostError, match=rf"process {other.pid} \(python"):
            await bus.open()

        other.stdin.close()
        await asyncio.to_thread(other.wait, 10)
    await bus.open()
    await bus.close()


@pytest.mark.fault("D07")
async def test_an_opener_without_a_lock_is_found_too(
    first: Terminal, tmp_path: Path
) -> None:
    """Programs that lock nothing, and ports that nobody has."""
    assert str(os.getpid()) in explain(first.path, OSError(errno.EBUSY, "busy"))
    plain = tmp_path / "file"
    plain.touch()
    assert "another process" in explain(str(plain), OSError(errno.EAGAIN, "locked"))
    assert "somebody else" in explain("/dev/none", OSError(errno.EBUSY, "busy"))


@pytest.mark.fault("O17")
async def test_a_port_that_may_not_be_opened_names_its_group(tmp_path: Path) -> None:
    """To be in that group is what is missing, as a rule."""
    plain = tmp_path / "port"
    plain.touch()

    told = explain(str(plain), PermissionError(errno.EACCES, "no"))

    assert told == f"{plain} may be opened by the group {plain.group()!r} only"


def test_a_port_that_is_not_there_is_told_in_the_words_of_the_kernel() -> None:
    """Once, and not in those of pyserial, which says it twice."""
    error = serial.SerialException(errno.ENOENT, "could not open port: [Errno 2] ...")

    assert explain("/dev/x", error) == (
        "/dev/x cannot be opened: No such file or directory"
    )


# Openings that take too long.


class SlowOpening:
    """Makes every opening of a port wait."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.go = threading.Event()
        self.opened = threading.Event()
        self.ended = threading.Event()
        really = _serial_port.open_port

        def open_port(*args: Any) -> Port:
            self.go.wait(30)
            port = really(*args)
            self.opened.set()
            return port

        def shut(port: Port) -> None:
            shut_really(port)
            self.ended.set()

        shut_really = Port.shut
        monkeypatch.setattr(_serial_port, "open_port", open_port)
        monkeypatch.setattr(Port, "shut", shut)


@pytest.mark.fault("D21")
async def test_a_port_that_opens_too_late_is_closed(
    monkeypatch: pytest.MonkeyPatch, first: Terminal
) -> None:
    """Nobody has it then: the next opening gets it."""
    slow = SlowOpening(monkeypatch)
    monkeypatch.setattr("esair.buses.serial._port.OPEN_TIMEOUT", 0.05)
    bus = SerialBus(name="front", port=first.path)

    with pytest.raises(DeviceLostError, match="stuck"):
        await bus.open()

    slow.go.set()
    assert await asyncio.to_thread(slow.ended.wait, 10)
    await bus.open()
    await bus.close()


@pytest.mark.fault("X09", "D21")
@pytest.mark.parametrize("finished", [False, True])
async def test_an_opening_that_nobody_waits_for_any_more(
    monkeypatch: pytest.MonkeyPatch, first: Terminal, finished: bool
) -> None:
    """Closed while it opens, or in the moment in which it is open: no port is left."""
    slow = SlowOpening(monkeypatch)
    executor = Executor("front")
    place = SerialPlace("front", first.path)
    asking = asyncio.create_task(reach_port(executor, place, 115200, {}, {}))
    await asyncio.sleep(0.02)
    if finished:
        slow.go.set()
        assert slow.opened.wait(10)  # the thread is done, the loop has not looked

    asking.cancel()
    await asyncio.wait({asking})
    slow.go.set()

    assert asking.cancelled()
    assert await asyncio.to_thread(slow.ended.wait, 10)
    assert await executor.join(5.0)


@pytest.mark.fault("D18")
@pytest.mark.longer
async def test_a_close_that_blocks_is_left_to_its_thread(
    monkeypatch: pytest.MonkeyPatch, first: Terminal
) -> None:
    """Some drivers wait half a minute for a device that is stuck; the robot does not."""
    release = threading.Event()
    really = Port.shut

    def shut(port: Port) -> None:
        release.wait(30)
        really(port)

    monkeypatch.setattr(Port, "shut", shut)
    bus = SerialBus(name="front", port=first.path)
    await bus.open()
    beats = 0

    async def beat() -> None:
        nonlocal beats
        while True:
            await asyncio.sleep(0.01)
            beats += 1

    beating = asyncio.create_task(beat())
    begin = time.monotonic()
    await bus.close()
    took = time.monotonic() - begin
    beating.cancel()
    release.set()

    assert within(3.0, took)
    assert beats > 10


@pytest.mark.fault("D02")
async def test_a_write_to_a_port_that_has_just_hung_up(first: Terminal) -> None:
    """The kernel's own error reaches the writer."""
    bus = SerialBus(name="front", port=first.path)
    await bus.open()
    first.close()

    with pytest.raises(DeviceLostError, match="'front'"):
        await bus.write(b"forward\n")

    assert bus.stats.lost == 1
    await bus.close()


# URLs.


class Echo:
    """A device server: what it gets in lines goes back."""

    def __init__(self) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.client: socket.socket | None = None
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self) -> None:
        self.client, _ = self.server.accept()
        while data := self.client.recv(4096):
            self.client.sendall(data)

    def hang_up(self) -> None:
        assert self.client is not None
        self.client.shutdown(socket.SHUT_RDWR)
        self.close()

    def close(self) -> None:
        self.thread.join(5)
        self.server.close()
        if self.client is not None:
            self.client.close()


@pytest.mark.fault("D01")
async def test_a_socket_is_a_line_like_any_other() -> None:
    """It is written and read without a thread, and its end is a loss."""
    echo = Echo()
    bus = SerialBus(name="remote", port=f"socket://127.0.0.1:{echo.port}")
    await bus.open()

    assert await bus.ask(b"hello", timeout=2) == b"hello"
    inbox = bus.frames()
    await asyncio.to_thread(echo.hang_up)
    with pytest.raises(DeviceLostError, match="'remote'"):
        await inbox.take(timeout=2)

    with pytest.raises(DeviceLostError, match="refused"):
        await bus.open()
    await bus.close()


async def test_a_loop_has_no_descriptor_and_works() -> None:
    """Threads wait for it; more than fits in one piece comes back in order."""
    bus = SerialBus(name="loop", port="loop://", write_timeout=5.0)
    await bus.open()
    inbox = bus.frames()

    for number in range(50):
        await bus.send(b"%d " % number + b"x" * 1000)

    got = [(await inbox.take(timeout=5)).split()[0] for _ in range(50)]
    assert got == [b"%d" % number for number in range(50)]
    assert bus.stats.dropped == 0
    await bus.close()


async def test_a_loop_that_fails_is_lost() -> None:
    """An error in a thread reaches everybody on the line."""
    bus = SerialBus(name="loop", port="loop://")
    await bus.open()
    inbox = bus.frames()
    assert bus._open_device is not None

    bus._open_device.device.close()

    with pytest.raises(DeviceLostError):
        await inbox.take(timeout=5)
    assert not bus.is_open
    await bus.open()
    assert await bus.ask(b"hello", timeout=2) == b"hello"
    await bus.close()


@pytest.mark.parametrize("port", ["morse://x", "socket://nowhere", "loop://?x=1"])
async def test_a_url_that_means_nothing(port: str) -> None:
    """It names the bus and the port."""
    bus = SerialBus(name="front", port=port)

    with pytest.raises((ConfigError, DeviceLostError), match="front"):
        await bus.open()

    await bus.close()


async def test_settings_that_no_port_has(first: Terminal) -> None:
    """What pyserial refuses is a mistake of the description, not a lost device."""
    bus = SerialBus(name="front", port=first.path, parity="X")

    with pytest.raises(ConfigError, match=r"front: port: .*parity"):
        await bus.open()

    await bus.close()


async def test_dtr_and_rts_are_set_before_the_port_is_open(
    monkeypatch: pytest.MonkeyPatch, first: Terminal
) -> None:
    """DTR resets many boards, and RTS keeps some transceivers sending."""
    levels: list[tuple[str, bool]] = []
    for name in ("dtr", "rts"):
        monkeypatch.setattr(
            serial.Serial,
            f"_update_{name}_state",
            lambda port, name=name: levels.append((name, getattr(port, name))),
        )
    bus = SerialBus(name="front", port=first.path, dtr=False, rts=False)

    await bus.open()

    assert levels == [("dtr", False), ("rts", False)]
    await bus.close()


def test_a_level_is_true_or_false() -> None:
    """A word, which would count as true, is refused."""
    with pytest.raises(ConfigError, match="front: dtr: expected true or false"):
        SerialBus(name="front", port="/dev/ttyUSB0", dtr="off")  # type: ignore[arg-type]


@pytest.mark.parametrize("port", ["", "usb:403:6001", "usb:0403", "usb:0403:6001:"])
def test_a_place_that_is_none(port: str) -> None:
    """It is refused before anything is opened."""
    with pytest.raises(ConfigError, match="front: port: expected"):
        SerialBus(name="front", port=port)
