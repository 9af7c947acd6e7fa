"""What is told amid a turn, or ends amid a stop, means the same on every loop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import pytest
from tests.turn.loops import LOOPS, run

import esair
from esair.buses import Bus
from esair.testing import FakeSensor

pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.parametrize("make", LOOPS.values(), ids=LOOPS.keys()),
]


class Motor(esair.Actuator):
    """Keeps what reaches its driver; asked to, it says at a write that it is gone."""

    value_type = float
    safe = 0.0
    blocking = False

    def __init__(self, **options: Any) -> None:
        super().__init__(name="motor", **options)
        self.sent: list[float] = []

    async def write(self, command: float) -> None:
        self.sent.append(command)


class ThreadedMotor(Motor):
    """The same with a driver that blocks, in a thread."""

    blocking = True

    def write(self, command: float) -> None:  # type: ignore[override]
        self.sent.append(command)


class Line(Bus):
    """A bus that is lost when the test says so."""

    async def _open(self) -> None:
        pass

    async def _close(self) -> None:
        pass


class Drives(esair.Behavior):
    wheels = esair.writes(float, name="motor")


class Stays(esair.Behavior):
    """Takes its time to end."""

    def __init__(self, name: str, seconds: float = 0.1) -> None:
        super().__init__(name=name)
        self.seconds = seconds

    async def run(self) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(self.seconds)


@pytest.mark.promise("CALL-4", "TURN-7")
@pytest.mark.fault("D01")
@pytest.mark.parametrize("kind", [Motor, ThreadedMotor])
def test_nothing_reaches_a_device_that_was_reported_lost(
    make: Callable[[], asyncio.AbstractEventLoop], kind: type[Motor]
) -> None:
    """The very next line's write has the loss as its outcome."""

    async def main() -> None:
        motor, drives = kind(), Drives()
        async with esair.Robot(resources=[motor], behaviors=[drives]):
            await drives.wheels.write(0.3)
            motor.report_lost(ConnectionResetError(104, "unplugged"))
            before = list(motor.sent)
            with pytest.raises(esair.DeviceLostError, match="unplugged"):
                await drives.wheels.write(0.9)
            assert motor.sent == before

            await asyncio.sleep(0.5)  # it was opened again
            await drives.wheels.write(0.2)
            assert motor.sent[-1] == 0.2

    run(make, main())


@pytest.mark.promise("CALL-4")
@pytest.mark.fault("D01")
def test_a_write_that_waits_for_its_thread_does_not_reach_a_lost_device(
    make: Callable[[], asyncio.AbstractEventLoop],
) -> None:
    """The gate closes at once, whatever thread reports the loss."""

    async def main() -> None:
        motor, drives = ThreadedMotor(), Drives()
        async with esair.Robot(resources=[motor], behaviors=[drives]):
            await drives.wheels.write(0.3)
            before = list(motor.sent)
            writing = asyncio.ensure_future(drives.wheels.write(0.9))
            teller = threading.Thread(target=motor.report_lost)
            teller.start()
            teller.join()
            with pytest.raises(esair.DeviceLostError):
                await writing
            assert 0.9 not in motor.sent[len(before) :]

    run(make, main())


@pytest.mark.promise("CALL-4", "TURN-7")
@pytest.mark.fault("D03")
def test_nothing_reaches_a_device_whose_bus_was_lost(
    make: Callable[[], asyncio.AbstractEventLoop],
) -> None:
    """A bus that is lost takes its devices with it, in the same step."""

    async def main() -> None:
        line = Line(name="line")
        motor, drives = Motor(bus=line), Drives()
        async with esair.Robot(resources=[motor], behaviors=[drives]):
            await drives.wheels.write(0.3)
            line.lost(ConnectionResetError(104, "unplugged"))
            before = list(motor.sent)
            with pytest.raises(esair.DeviceLostError, match="unplugged"):
                await drives.wheels.write(0.9)
            assert motor.sent == before

    run(make, main())


@pytest.mark.promise("CALL-4")
def test_a_loss_that_is_over_refuses_nothing(
    make: Callable[[], asyncio.AbstractEventLoop],
) -> None:
    """The loss of an earlier opening, told again, does not touch the next one."""

    async def main() -> None:
        motor, drives = Motor(), Drives()
        async with esair.Robot(resources=[motor], behaviors=[drives]):
            for _ in range(3):
                motor.report_lost()
                motor.report_lost()
                await asyncio.sleep(0.6)
                motor.report_arrived()
                await asyncio.sleep(0.1)
                await drives.wheels.write(0.4)
                assert motor.sent[-1] == 0.4

    run(make, main())


@pytest.mark.promise("ROB-4", "SUP-3", "TURN-7")
def test_a_removal_under_way_at_the_stop_ends_as_one(
    make: Callable[[], asyncio.AbstractEventLoop],
) -> None:
    """What takes away is not interrupted by what takes everything away."""

    async def main() -> None:
        sonar = FakeSensor("sonar", 1.0)
        robot = esair.Robot(
            resources=[sonar, Motor()],
            behaviors=[Stays("one"), Stays("two"), Stays("three")],
        )
        async with robot:
            await asyncio.sleep(0.05)
            going = [
                asyncio.ensure_future(robot.behaviors.remove("one")),
                asyncio.ensure_future(robot.resources.remove("sonar")),
                asyncio.ensure_future(robot.behaviors.replace("two", Stays("new"))),
            ]
            await asyncio.sleep(0.05)
            stopping = asyncio.ensure_future(robot.stop("enough"))
            outcomes = await asyncio.gather(*going, return_exceptions=True)
            await stopping
        assert outcomes == [[], None, []]
        assert robot.stopped
        for command in (robot.behaviors.remove("three"), robot.resources.remove("x")):
            with pytest.raises(esair.StoppingError):
                await command

    run(make, main())


@pytest.mark.promise("ROB-4", "SUP-3", "TURN-7")
def test_what_would_begin_at_the_stop_does_not(
    make: Callable[[], asyncio.AbstractEventLoop],
) -> None:
    """An addition, a restart and the second half of a replacement end as stopping."""

    class Slow(Motor):
        async def close(self) -> None:
            await asyncio.sleep(0.1)

    class Late(Stays):
        async def setup(self) -> None:
            await asyncio.sleep(1.0)

    async def main() -> None:
        robot = esair.Robot(resources=[Slow()], behaviors=[Stays("one"), Stays("two")])
        new = Motor()
        async with robot:
            await asyncio.sleep(0.05)
            going = [
                asyncio.ensure_future(robot.behaviors.add(Late("late"))),
                asyncio.ensure_future(robot.behaviors.restart("one")),
                asyncio.ensure_future(robot.resources.replace("motor", new)),
            ]
            await asyncio.sleep(0.02)
            stopping = asyncio.ensure_future(robot.stop("enough"))
            outcomes = await asyncio.gather(*going, return_exceptions=True)
            await stopping
        assert [type(each) for each in outcomes] == [esair.StoppingError] * 3
        assert new.sent == []

    run(make, main())
