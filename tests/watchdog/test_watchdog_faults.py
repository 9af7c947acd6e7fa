"""What can be wrong with the watchdog itself, or with the lines it watches."""

from __future__ import annotations

import asyncio
import contextlib
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
from tests.watchdog.test_watchdog import dogs_of

import esair
from esair.buses import SerialBus
from esair.watchdog import Outlet, SafeFrames, Watchdog, _watchdog
from esair.watchdog._program import Device

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


@pytest.fixture
async def patient() -> AsyncIterator[Watchdog]:
    """One that ends no process whose tests are held up while something moves."""
    each = Watchdog(limit=60.0)
    await each.start()
    yield each
    await each.close()


def pid_of(dog: Watchdog) -> int:
    assert dog._process is not None
    return dog._process.pid


def looks_of(dog: Watchdog) -> int:
    return dog._numbers[_watchdog._LOOKS]


def lines_of(dog: Watchdog) -> list[str]:
    """Return which terminals it holds open."""
    held = []
    for each in Path(f"/proc/{pid_of(dog)}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # it has just let it go
            held.append(os.readlink(each))
    return [each for each in held if each.startswith("/dev/pts/")]


async def until(condition: object, within: float = 30.0) -> None:
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
    await until(lambda: looks_of(dog))
    os.kill(pid_of(dog), signal.SIGSTOP)

    def noticed() -> int:
        dog.beat()
        return deaths.count

    await until(noticed)
    assert not dog.runs


@pytest.mark.long
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


@pytest.mark.promise("GRD-4")
@pytest.mark.parametrize("late", [0.0, 0.7, 1.4])
async def test_a_late_answer_arms(dog: Watchdog, line: Line, late: float) -> None:
    """It is waited for; nothing is told as watched before."""
    outlet = Outlet("serial", descriptor=line.near)
    os.kill(pid_of(dog), signal.SIGSTOP)
    arming = asyncio.create_task(dog.arm("wheels", SAFE, outlet))
    await asyncio.sleep(late)
    assert not arming.done()
    assert not dog.watches("wheels")
    os.kill(pid_of(dog), signal.SIGCONT)
    assert not await arming
    assert dog.watches("wheels")
    assert lines_of(dog) == [line.port]


@pytest.mark.promise("GRD-4")
@pytest.mark.parametrize("gives_up", [True, False])
async def test_who_waits_no_more_for_an_answer(
    dog: Watchdog, line: Line, gives_up: bool
) -> None:
    """A wait that is given up changes nothing; a device that is closed is let go."""
    outlet = Outlet("serial", descriptor=line.near)
    os.kill(pid_of(dog), signal.SIGSTOP)
    arming = asyncio.create_task(dog.arm("wheels", SAFE, outlet))
    await asyncio.sleep(0.05)
    if gives_up:
        arming.cancel()
    else:
        await dog.drop("wheels", within=0.05)
    os.kill(pid_of(dog), signal.SIGCONT)
    assert not await dog.arm("lamp", SAFE, outlet)
    assert dog.watches("wheels") == gives_up
    assert len(lines_of(dog)) == 1 + gives_up
    await asyncio.gather(arming, return_exceptions=True)


@pytest.mark.promise("GRD-4")
@pytest.mark.parametrize(
    "nowhere",
    [
        Outlet("i2c", target={"path": "/nowhere"}),
        Outlet("can", target={"channel": "nowhere0"}),
    ],
)
async def test_a_watch_stays_until_the_next_one_stands(
    dog: Watchdog, line: Line, nowhere: Outlet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refused, or without an answer, a re-arming keeps it; a late answer renews it."""
    monkeypatch.setattr(_watchdog, "ANSWER_WITHIN", 0.1)
    outlet = Outlet("serial", descriptor=line.near)
    assert not await dog.arm("wheels", SAFE, outlet)
    refused = await dog.arm("wheels", SAFE, nowhere)
    assert refused
    assert nowhere.kind == "can" or os.strerror(errno.ENOENT) in refused
    assert dog.watches("wheels")
    before = dog._places["wheels"]
    os.kill(pid_of(dog), signal.SIGSTOP)
    assert "has not answered" in await dog.arm("wheels", SAFE, outlet)
    assert dog._places["wheels"] == before
    os.kill(pid_of(dog), signal.SIGCONT)
    await until(lambda: dog._places["wheels"] > before)
    await until(lambda: lines_of(dog) == [line.port])


@pytest.mark.promise("GRD-4")
async def test_more_than_its_channel_takes_waits_in_order(
    dog: Watchdog, line: Line
) -> None:
    """Nothing that was asked of one that stands still is lost, nor is a descriptor."""
    outlet = Outlet("serial", descriptor=line.near)
    frames = SafeFrames([b"\0" * 5000])
    os.kill(pid_of(dog), signal.SIGSTOP)
    mine = len(os.listdir("/proc/self/fd"))
    asked = [asyncio.create_task(dog.arm(f"w{n}", frames, outlet)) for n in range(60)]
    await asyncio.sleep(0.05)
    assert len(os.listdir("/proc/self/fd")) > mine  # kept, for those that wait
    gone = [asyncio.create_task(dog.drop(f"w{n}")) for n in range(60)]
    os.kill(pid_of(dog), signal.SIGCONT)
    assert await asyncio.gather(*asked) == ["it was closed"] * 60
    await asyncio.gather(*gone)
    assert not await dog.arm("wheels", SAFE, outlet)
    assert lines_of(dog) == [line.port]
    assert len(os.listdir("/proc/self/fd")) == mine


@pytest.mark.promise("GRD-4")
async def test_one_that_never_looks_is_replaced(
    monkeypatch: pytest.MonkeyPatch, deaths: Deaths
) -> None:
    """A start may be slow, but not for ever."""
    monkeypatch.setattr(_watchdog, "START_WITHIN", 0.3)
    dog = Watchdog(limit=0.1, on_death=deaths)
    await dog.start()
    os.kill(pid_of(dog), signal.SIGSTOP)
    began = time.monotonic()

    def noticed() -> int:
        dog.beat()
        return deaths.count

    await until(noticed)
    assert time.monotonic() - began >= 0.3
    await dog.close()
    assert dogs_of(os.getpid()) == []


@pytest.mark.promise("GRD-4")
async def test_a_silent_one_is_noticed_sooner_while_something_moves(
    dog: Watchdog, deaths: Deaths, line: Line
) -> None:
    """Within two limits; until then, and a moment longer, a death wakes it."""
    assert not await dog.arm("w", SAFE, Outlet("serial", descriptor=line.near))
    pid = pid_of(dog)
    os.kill(pid, signal.SIGSTOP)
    dog.moving("w", True)
    dog.beat()
    began = time.monotonic()
    while not deaths.count and time.monotonic() < began + 5.0:
        dog.beat()
        await asyncio.sleep(0.02)
    assert 0.1 < time.monotonic() - began < 5.0
    assert not dog.watches("w")
    os.kill(pid, 0)  # it is there still, and is told of no motion
    await until(lambda: dogs_of(os.getpid()) == [])


@pytest.mark.promise("GRD-4")
async def test_a_fork_of_the_robot_gives_no_sign_of_life(patient: Watchdog) -> None:
    """What it counts, and what it tells of motions, is its own."""
    dog = patient
    dog.moving("wheels", True)
    beats = dog._numbers[_watchdog._BEATS]
    child = os.fork()
    if child == 0:
        dog.moving("wheels", False)
        for _ in range(10):
            dog.beat()
        os._exit(0)
    os.waitpid(child, 0)  # noqa: ASYNC222 - it ends at once
    assert dog._numbers[_watchdog._MOVING] == 1
    assert dog._numbers[_watchdog._BEATS] == beats
    dog.moving("wheels", False)


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


async def test_frames_may_be_long(dog: Watchdog, line: Line) -> None:
    """As words of the channel they are twice as long, and one word all the same."""
    frames = SafeFrames([b"\0" * 64], repeat=1000)
    outlet = Outlet("serial", descriptor=line.near)
    assert not await dog.arm("wheels", frames, outlet)
    assert dog.runs


async def test_what_one_device_cannot_take_is_its_own_fault(line: Line) -> None:
    """Whatever its write raises: who sends to it goes on with the next one."""
    told = {"name": "lamp", "wire": "gpio", "target": {}, "frames": ["00" * 2000]}
    device = Device(told, [line.near])
    device.begin([device])
    assert device.is_left()
    assert "too long" in device.error


def test_frames_with_a_gap_are_each_sent_after_silence() -> None:
    """What was cut in half before them has ended then."""
    told = {"name": "valve", "wire": "serial", "target": {}, "frames": ["01", "02"]}
    near, far = os.pipe()
    device = Device({**told, "gap": 0.01}, [far])
    began = time.monotonic()
    device.begin([device])
    came: list[float] = []
    while device.is_left():
        if len(device.left) < 2 - len(came):
            came.append(time.monotonic() - began)
    came.append(time.monotonic() - began)
    assert came[0] >= 0.01
    assert came[1] >= 0.02
    assert os.read(near, 3) == b"\1\2"
    os.close(near)
    os.close(far)


def on_one_line(line: int, *frames: bytes, gap: float = 0.0) -> list[Device]:
    """Return a device for each frame, with a descriptor of its own of the same line."""
    told = {"name": "valve", "wire": "serial", "target": {}, "gap": gap}
    devices = [
        Device({**told, "frames": [frame.hex()]}, [os.dup(line)]) for frame in frames
    ]
    for device in devices:
        device.begin(devices)
    return devices


def test_devices_on_one_line_keep_silence_between_their_frames() -> None:
    """Each of them hears what the others are told, and may answer."""
    near, far = os.pipe()
    first, second = on_one_line(far, b"1", b"2", gap=0.01)
    while first.is_left():
        pass
    sent = time.monotonic()
    while second.is_left():
        pass
    assert time.monotonic() - sent >= 0.015
    for each in (near, far, first.descriptor, second.descriptor):
        os.close(each)


def test_a_frame_that_a_full_line_has_cut_is_whole_before_another_one() -> None:
    """Of two devices on it neither would understand both."""
    near, far = os.pipe()
    first, second = on_one_line(far, b"1" * 100_000, b"2" * 10_000)
    assert first.is_left()
    came = os.read(near, 50_000)
    assert second.is_left()
    assert not first.is_left()
    came += os.read(near, 100_000)
    assert not second.is_left()
    came += os.read(near, 100_000)
    assert came == b"1" * 100_000 + b"2" * 10_000
    for each in (near, far, first.descriptor, second.descriptor):
        os.close(each)


async def test_hundreds_may_be_armed_at_the_same_time(dog: Watchdog) -> None:
    """They wait until there is room in the channel, both ways."""
    outlet = Outlet("i2c", target={"path": "/nowhere"})
    asked = (dog.arm(f"lamp {n}", SAFE, outlet) for n in range(700))
    refused = await asyncio.gather(*asked)
    assert all(os.strerror(errno.ENOENT) in why for why in refused)


@pytest.mark.promise("GRD-1")
async def test_it_does_not_wait_for_a_robot_that_does_not_hear(dog: Watchdog) -> None:
    """One that is stuck leaves answers unread, and is watched all the same."""
    process = dog._process
    assert process is not None
    for place in range(2000):  # more than there is room for the answers
        with contextlib.suppress(BlockingIOError):
            process.send({"op": "drop", "place": place})
        time.sleep(0.0001)  # noqa: ASYNC251 - it is stuck

    def looks() -> int:
        return dog._numbers[_watchdog._LOOKS]

    before, end = looks(), time.monotonic() + 5.0
    while looks() == before and time.monotonic() < end:
        time.sleep(0.01)  # noqa: ASYNC251 - it is stuck
    assert looks() > before


@pytest.mark.promise("GRD-1")
async def test_what_moves_moves_still_when_it_is_armed_again(
    patient: Watchdog, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its settings were changed, or its watchdog is a new one: it was told no stop."""
    monkeypatch.setattr(_watchdog, "ANSWER_WITHIN", 60.0)  # it may be starved
    dog = patient
    outlet = Outlet("serial", descriptor=line.near)
    assert not await dog.arm("wheels", SAFE, outlet)
    dog.moving("wheels", True)
    assert not await dog.arm("wheels", SAFE, outlet)
    assert dog._numbers[_watchdog._MOVING] == 1
    await until(lambda: lines_of(dog) == [line.port])


@pytest.mark.promise("GRD-3")
async def test_a_start_that_is_broken_off_leaves_no_watchdog() -> None:
    """A signal may come while it is started."""
    dog = Watchdog()
    starting = asyncio.create_task(dog.start())
    await asyncio.sleep(0)
    starting.cancel()
    await asyncio.gather(starting, return_exceptions=True)
    await dog.close()
    await until(lambda: dogs_of(os.getpid()) == [])


@pytest.mark.parametrize("limit", [0.001, 1e8])
async def test_every_limit_can_be_kept(limit: float, line: Line) -> None:
    """Also one of years, which no clock of the kernel can wait for."""
    dog = Watchdog(limit=limit)
    await dog.start()
    assert not await dog.arm("wheels", SAFE, Outlet("serial", descriptor=line.near))
    assert dog.runs
    await dog.close()


@pytest.mark.long
async def test_both_may_be_paused(deaths: Deaths) -> None:
    """As in a container: what counts is how often the robot looked in vain."""
    dog = Watchdog(limit=0.001, on_death=deaths)
    await dog.start()
    os.kill(pid_of(dog), signal.SIGSTOP)
    await asyncio.sleep(0.05)
    dog.beat()
    await asyncio.sleep(0.05)
    dog.beat()
    os.kill(pid_of(dog), signal.SIGCONT)
    await asyncio.sleep(0.05)
    assert deaths.count == 0
    await dog.close()


@pytest.mark.promise("GRD-2")
async def test_process_1_of_a_container_has_no_watchdog(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The kernel would end both at once, and stops no such process for anybody."""
    monkeypatch.setattr(os, "getpid", lambda: 1)
    with pytest.raises(OSError, match="docker run --init"):
        await Watchdog().start()


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


class Odd(BaseException):
    """What a driver may raise as well."""


@pytest.mark.promise("GRD-2")
@pytest.mark.fault("D25")
async def test_whatever_is_raised_instead_of_frames_is_told(
    line: Line, caplog: pytest.LogCaptureFixture
) -> None:
    """The actuator is not watched; the robot starts."""

    class Odder(Wheels):
        def safe_frames(self) -> SafeFrames:
            raise Odd

    bus = SerialBus(name="front", port=line.port)
    robot = esair.Robot(resources=[Odder(name="wheels", bus=bus)], watchdog=True)
    async with asyncio.timeout(20.0), robot:
        await until(lambda: ready(robot))
    assert "wheels: UNWATCHED: its safe_frames raised Odd" in caplog.text


@pytest.mark.promise("GRD-3", "ROB-2")
@pytest.mark.fault("D25")
async def test_a_bus_that_wants_to_end_the_program_does_not_end_the_stop(
    line: Line, caplog: pytest.LogCaptureFixture
) -> None:
    """It is told; no watchdog is left behind."""

    class Odd(SerialBus):
        async def close(self) -> None:
            await super().close()
            raise SystemExit

    bus = Odd(name="front", port=line.port)
    async with esair.Robot(resources=[Wheels(bus=bus)], watchdog=True):
        pass
    assert "bus front: close: RuntimeError: a task raised SystemExit" in caplog.text
    assert dogs_of(os.getpid()) == []


@pytest.mark.promise("GRD-1")
@pytest.mark.fault("O05")
async def test_a_robot_that_is_continued_is_halted(line: Line) -> None:
    """What its driver was doing when it was stopped ends now: safe is sent after it."""
    bus = SerialBus(name="front", port=line.port)
    robot = esair.Robot(
        resources=[Wheels(bus=bus)], watchdog=True, watchdog_death="alarm"
    )
    async with robot:
        assert robot._keeper is not None
        dog = robot._keeper.watchdog
        dog._numbers[_watchdog._LATCH] = 1  # it was made safe, and then continued
        os.kill(pid_of(dog), signal.SIGKILL)
        await until(lambda: robot.halted)


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
