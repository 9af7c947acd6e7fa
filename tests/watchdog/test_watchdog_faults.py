"""What can be wrong with the watchdog itself, or with the lines it watches."""

from __future__ import annotations

import asyncio
import errno
import os
import resource
import signal
import socket
import sys
import time
import tty
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Literal

import pytest

import esair
from esair.buses import SerialBus
from esair.watchdog import Outlet, SafeFrames, Watchdog, _watchdog

pytestmark = pytest.mark.real_clock

SAFE = SafeFrames([b"STOP\n"])


class Wheels(esair.Actuator[float]):
    """Says each command as a line."""

    safe = 0.0
    bus: SerialBus

    async def write(self, command: float) -> None:
        await self.bus.send(b"GO" if command else b"STOP")

    def safe_frames(self) -> SafeFrames:
        return SAFE


class Line:
    """A line with both ends."""

    def __init__(self) -> None:
        self.far, self.near = os.openpty()
        tty.setraw(self.near)
        os.set_blocking(self.far, False)

    @property
    def port(self) -> str:
        return os.ttyname(self.near)

    def heard(self) -> bytes:
        try:
            return os.read(self.far, 4096)
        except BlockingIOError:
            return b""


@pytest.fixture
def line() -> Iterator[Line]:
    each = Line()
    yield each
    for end in (each.far, each.near):
        if end >= 0:
            os.close(end)


class Deaths:
    """Counts how often a watchdog died."""

    count = 0

    def __call__(self) -> None:
        self.count += 1


@pytest.fixture
def deaths() -> Deaths:
    return Deaths()


@pytest.fixture
async def dog(deaths: Deaths) -> AsyncIterator[Watchdog]:
    each = Watchdog(limit=0.1, on_death=deaths)
    await each.start()
    yield each
    await each.close()


def pid_of(dog: Watchdog) -> int:
    assert dog._process is not None
    return dog._process.pid


def lines_of(dog: Watchdog) -> list[str]:
    """Return which terminals it holds open."""
    held = [os.readlink(each) for each in Path(f"/proc/{pid_of(dog)}/fd").iterdir()]
    return [each for each in held if each.startswith("/dev/pts/")]


async def until(condition: object, within: float = 5.0) -> None:
    assert callable(condition)
    end = time.monotonic() + within
    while not condition() and time.monotonic() < end:  # noqa: ASYNC110 - a process
        await asyncio.sleep(0.01)
    assert condition()


def ready(robot: esair.Robot) -> bool:
    return robot.resources.query("wheels").state is esair.ResourceState.READY


@pytest.mark.promise("GRD-3")
@pytest.mark.fault("O06")
async def test_a_watchdog_that_is_stopped_is_ended(
    dog: Watchdog, deaths: Deaths
) -> None:
    """It does not look any more: it is as good as dead, and is told as that."""
    os.kill(pid_of(dog), signal.SIGSTOP)

    def noticed() -> int:
        dog.beat()
        return deaths.count

    await until(noticed)
    assert not dog.runs


async def test_one_that_looks_is_left_alone(dog: Watchdog, deaths: Deaths) -> None:
    """However long the robot beats."""
    for _ in range(100):
        dog.beat()
        await asyncio.sleep(0.012)
    assert dog.runs
    assert deaths.count == 0


async def test_an_idle_robot_never_trips_it(dog: Watchdog) -> None:
    """No beat for three limits, and nothing moves: this process still lives."""
    await asyncio.sleep(0.3)
    assert dog.runs
    assert not dog.latched


async def test_a_line_that_hangs_up_is_let_go(dog: Watchdog, line: Line) -> None:
    """Or its number would not become free again."""
    outlet = Outlet("serial", descriptor=line.near)
    assert not await dog.arm("wheels", SAFE, outlet)
    port = line.port
    assert port in lines_of(dog)
    os.close(line.far)
    line.far = -1
    await until(lambda: not dog.watches("wheels"))
    assert port not in lines_of(dog)


@pytest.mark.promise("GRD-2")
async def test_what_is_armed_too_late_is_let_go(
    dog: Watchdog, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was told as not watched: the watchdog must not keep its port."""
    monkeypatch.setattr(_watchdog, "ANSWER_WITHIN", 0.1)
    outlet = Outlet("serial", descriptor=line.near)
    os.kill(pid_of(dog), signal.SIGSTOP)
    assert "has not answered" in await dog.arm("wheels", SAFE, outlet)
    monkeypatch.undo()
    os.kill(pid_of(dog), signal.SIGCONT)
    assert not await dog.arm("lamp", SAFE, outlet)
    assert lines_of(dog) == [line.port]


async def test_too_many_descriptors_are_told(dog: Watchdog, line: Line) -> None:
    """The actuator is not watched, with the reason; the watchdog goes on."""
    outlet = Outlet("serial", descriptor=line.near)
    assert not await dog.arm("wheels", SAFE, outlet)  # it has loaded what it needs
    await dog.drop("wheels")
    resource.prlimit(pid_of(dog), resource.RLIMIT_NOFILE, (3, 64))
    why = await dog.arm("wheels", SAFE, outlet)
    assert why == "its descriptor did not arrive: too many are open"
    resource.prlimit(pid_of(dog), resource.RLIMIT_NOFILE, (64, 64))
    assert not await dog.arm("wheels", SAFE, outlet)


async def test_descriptors_that_cannot_be_sent_are_told(
    dog: Watchdog, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the system hands none on, the actuator is not watched; the dog goes on."""

    def send_fds(*_: object) -> int:
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))

    outlet = Outlet("serial", descriptor=line.near)
    with monkeypatch.context() as patch:
        patch.setattr(socket, "send_fds", send_fds)
        why = await dog.arm("wheels", SAFE, outlet)
    assert why.startswith("the watchdog cannot be told: ")
    assert os.strerror(errno.EOPNOTSUPP) in why
    assert not dog.watches("wheels")
    assert not await dog.arm("wheels", SAFE, outlet)


async def test_a_chip_that_cannot_be_opened_is_told(dog: Watchdog) -> None:
    """In the words of the kernel."""
    outlet = Outlet("i2c", target={"path": "/nowhere"})
    why = await dog.arm("lamp", SafeFrames([b"\0"], address=0x40), outlet)
    assert os.strerror(errno.ENOENT) in why


@pytest.mark.promise("GRD-3")
@pytest.mark.parametrize("policy", ["stop", "alarm"])
async def test_a_robot_whose_watchdog_cannot_be_started(
    policy: Literal["stop", "alarm"],
    line: Line,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It starts halted, or, by policy, only says so."""
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    bus = SerialBus(name="front", port=line.port)
    robot = esair.Robot(
        resources=[Wheels(bus=bus)], watchdog=True, watchdog_death=policy
    )
    async with robot:
        assert bool(robot.halted) == (policy == "stop")
    assert "the watchdog cannot be started: FileNotFoundError" in caplog.text
    assert ("halted by the watchdog" in caplog.text) == (policy == "stop")


@pytest.mark.promise("GRD-2")
async def test_two_robots_with_watchdogs_on_one_port(line: Line) -> None:
    """The second does not get the port, so its watchdog does not write there either."""

    def make() -> esair.Robot:
        wheels = Wheels(bus=SerialBus(name="front", port=line.port))
        return esair.Robot(resources=[wheels], watchdog=True)

    async with make() as first:
        await until(lambda: ready(first))
        async with make() as second:
            await asyncio.sleep(0.1)
            assert not ready(second)
        line.heard()
        await asyncio.sleep(0.05)
        assert line.heard() == b""
