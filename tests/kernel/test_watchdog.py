"""The watchdog on SocketCAN and on GPIO lines of a real kernel, from the far end."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import os
import select
import signal
import socket
import statistics
import struct
import subprocess
import sys
import termios
import time
import traceback
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.kernel.test_gpio import Chip
from tests.watchdog import victim
from tests.watchdog.test_watchdog import DEAD, STUCK

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("GRD-1")]

DRIVEN = Path(__file__).with_name("driven.py")
PATIENCE = 40.0
"""The guest has one slow processor."""

FRAME = struct.Struct("=IB3x8s")
COMMAND = 0x100
N_SLCAN = 17
SO_RCVBUFFORCE = 33


def ip(command: str) -> None:
    subprocess.run(["ip", "link", *command.split()], check=True, timeout=30)


class Robot:
    """The process of a robot that drives."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(DRIVEN), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def drives(self) -> None:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line == "driving\n", self.end()

    def end(self) -> str:
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        _, errors = self.process.communicate(timeout=PATIENCE)
        return errors


@pytest.fixture
def vcan() -> Iterator[str]:
    name = "vcan7"
    ip(f"add {name} type vcan")
    ip(f"set {name} up")
    yield name
    ip(f"del {name}")


def listen(channel: str) -> socket.socket:
    can = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    # A flood must not push the last frames out of our own queue.
    can.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 27)
    can.bind((channel,))
    return can


def all_heard(can: socket.socket, robot: Robot, quiet: float = 1.0) -> list[bytes]:
    """Return the commands on the bus, until the robot is dead and the bus is quiet."""
    heard: list[bytes] = []
    end, last = time.monotonic() + PATIENCE, time.monotonic()
    while time.monotonic() < end:
        dead = robot.process.poll() is not None  # before the look: safe came first
        if select.select([can], [], [], 0.05)[0]:
            last = time.monotonic()
            identifier, _, data = FRAME.unpack(can.recv(16))
            if identifier == COMMAND:
                heard.append(data)
        elif dead and time.monotonic() - last > quiet:
            break
    return heard


def moves(data: bytes) -> bool:
    """Whether a command of the rover tells a wheel to turn."""
    return data[:4] != bytes(4)


@pytest.mark.parametrize("way", ["kill", "stop", "sleep", "flood"])
def test_safe_is_the_last_command_on_the_bus(vcan: str, way: str) -> None:
    """However the process died, and however much it was sending."""
    with listen(vcan) as can:
        robot = Robot("can", vcan, way, "kill")
        try:
            heard = all_heard(can, robot)
        finally:
            said = robot.end()
    assert any(moves(data) for data in heard), said
    assert not moves(heard[-1]), said
    assert "esair watchdog: " in said
    assert "out safe" in said


@pytest.mark.promise("GRD-3")
@pytest.mark.parametrize("way", [*DEAD, *STUCK])
def test_the_time_it_takes(vcan: str, way: str, request: pytest.FixtureRequest) -> None:
    """Two hundred times: always safe; the times are printed, not judged: the guest is slow."""
    if not request.config.getoption("--esair-soak"):
        pytest.skip("two hundred processes each: --esair-soak")
    times = [died_on(vcan, way) for _ in range(200)]
    times.sort()
    middle, slow = statistics.median(times), times[197]
    sys.stderr.write(
        f"CAN, {way}: p50 {middle:.1f} ms, p99 {slow:.1f} ms, max {times[-1]:.1f} ms\n"
    )


def died_on(channel: str, way: str) -> float:
    """Let a process die while it drives; return what its last motion stood for, in ms."""
    with listen(channel) as can:
        child = os.fork()  # to start another interpreter takes the guest seconds
        if child == 0:
            try:
                asyncio.run(victim.main(channel, way, "kill"))
            except BaseException:
                traceback.print_exc()
            os._exit(1)
        heard: list[tuple[float, bytes]] = []
        dead = os.pidfd_open(child)
        end, over = time.monotonic() + PATIENCE, False
        while (
            not (over and heard and heard[-1][1] == victim.STOP)
            and time.monotonic() < end
        ):
            waits = [can.fileno()] if over else [can.fileno(), dead]
            ready = select.select(waits, [], [], 0.3)[0]
            over = over or dead in ready
            if can.fileno() in ready:
                heard.append((time.monotonic(), can.recv(16)))
            elif over and not ready:
                break
        os.close(dead)
        os.waitpid(child, 0)
        while select.select([can], [], [], 0.05)[0]:  # nothing comes after it
            heard.append((time.monotonic(), can.recv(16)))
    (safe, last), (moved, motion) = heard[-1], heard[-2]
    assert (motion, last) == (victim.GO, victim.STOP)
    return (safe - moved) * 1000


class SlowLine:
    """An adapter on a serial line that takes its frames slowly: its queue is full."""

    def __init__(self) -> None:
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        before = set(Path("/sys/class/net").iterdir())
        fcntl.ioctl(self.near, termios.TIOCSETD, struct.pack("i", N_SLCAN))
        (made,) = set(Path("/sys/class/net").iterdir()) - before
        self.name = made.name
        ip(f"set {self.name} type can bitrate 125000")
        up = subprocess.Popen(["ip", "link", "set", self.name, "up"])
        while up.poll() is None:  # it says how quick the bus is, and opens it
            if select.select([self.far], [], [], 0.05)[0]:
                os.read(self.far, 64)
        assert up.returncode == 0

    def frames(self, until: float) -> Iterator[bytes]:
        """Take them one by one, slower than a flood; empty where there is none."""
        text = b""
        while time.monotonic() < until:
            if select.select([self.far], [], [], 0.05)[0]:
                text += os.read(self.far, 22)
                *whole, text = text.split(b"\r")
                yield from whole
                time.sleep(0.001)
            else:
                yield b""

    def close(self) -> None:
        os.close(self.far)
        os.close(self.near)


def test_a_slow_bus_under_a_flood_ends_safe() -> None:
    """What waits in the kernel goes first; safe is sent again until there is room."""
    line = SlowLine()
    robot = Robot("can", line.name, "flood", "kill")
    commands: list[bytes] = []
    try:
        last = time.monotonic()
        for frame in line.frames(time.monotonic() + PATIENCE):
            if frame.startswith(b"t100"):
                commands.append(bytes.fromhex(frame[5:21].decode()))
                last = time.monotonic()
            elif robot.process.poll() is not None and time.monotonic() - last > 3.0:
                break
    finally:
        said = robot.end()
        line.close()
    assert any(moves(data) for data in commands), said
    assert not moves(commands[-1]), said
    assert "out safe" in said


@pytest.mark.kernel("built")
@pytest.mark.parametrize("way", ["stop", "sleep"])
def test_a_line_of_a_frozen_robot_is_driven_safe(way: str) -> None:
    """The lamp is pulled up from outside: only who drives it keeps it low."""
    chip = Chip()
    chip.drive(4, True)
    robot = Robot("gpio", chip.path, way, "freeze")
    try:
        robot.drives()
        assert chip.level(4)
        end = time.monotonic() + PATIENCE
        while chip.level(4) and time.monotonic() < end:
            time.sleep(0.01)
        assert not chip.level(4)
        robot.process.send_signal(signal.SIGCONT)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            assert not chip.level(4)
    finally:
        robot.end()
        chip.remove()
