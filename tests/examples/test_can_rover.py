"""The rover on a CAN bus, with motors that are none."""

import asyncio

import can_rover
import pytest

import esair
from esair.drivers.dbc.fake import FakeDbcNode

pytestmark = pytest.mark.virtual_clock


def speeds(node: FakeDbcNode) -> list[float]:
    """The speeds that the left motor was told."""
    return [heard.signals["left"] for heard in node.heard]


async def test_drives_forth_and_back_and_stops(fake_can) -> None:
    """The last frame on the bus is the safe command, and each has its number."""
    can = fake_can("drive")
    motors = FakeDbcNode(can, can_rover.DATABASE)
    motors.send_every(0.02, "WheelFeedback", left=0.5, right=0.5, current=1.0)

    async with can_rover.make_robot(can):
        await asyncio.sleep(5.0)
    await asyncio.sleep(0.0)
    motors.stop()

    assert {0.5, -0.5} <= set(speeds(motors))
    assert speeds(motors)[-1] == 0.0
    counters = [heard.signals["counter"] for heard in motors.heard]
    assert counters == [number % 256 for number in range(len(counters))]


async def test_goes_slowly_while_the_motors_take_too_much(fake_can) -> None:
    """And on as before when they do no more."""
    can = fake_can("drive")
    motors = FakeDbcNode(can, can_rover.DATABASE)
    motors.send_every(0.02, "WheelFeedback", left=0.5, right=0.5, current=1.0)

    async with can_rover.make_robot(can):
        await asyncio.sleep(0.5)
        assert set(speeds(motors)[2:]) == {0.5}
        motors.stop()
        motors.send_every(0.02, "WheelFeedback", left=0.5, right=0.5, current=9.0)
        await asyncio.sleep(0.3)
        assert speeds(motors)[-1] == pytest.approx(0.1)
        motors.stop()
        motors.send_every(0.02, "WheelFeedback", left=0.5, right=0.5, current=1.0)
        await asyncio.sleep(0.7)
        assert speeds(motors)[-1] == 0.5
        motors.stop()


async def test_stands_still_while_the_motors_say_nothing(fake_can) -> None:
    """What would ease cannot see what they take."""
    can = fake_can("drive")
    motors = FakeDbcNode(can, can_rover.DATABASE)

    async with can_rover.make_robot(can) as robot:
        await asyncio.sleep(0.5)
        why = robot.resources.why("wheels")

    assert set(speeds(motors)) == {0.0}
    assert "ease is blind" in str(why)


async def test_a_bus_that_is_pulled_out_and_put_back(fake_can) -> None:
    """What comes first afterwards is the safe command."""
    can = fake_can("drive")
    motors = FakeDbcNode(can, can_rover.DATABASE)
    motors.send_every(0.02, "WheelFeedback", left=0.5, right=0.5, current=1.0)

    async with can_rover.make_robot(can) as robot:
        await asyncio.sleep(0.5)
        can.unplug()
        await asyncio.sleep(1.0)
        assert robot.resources.query("wheels").state is not esair.ResourceState.READY
        before = len(motors.heard)
        can.plug()
        await asyncio.sleep(1.0)

        assert speeds(motors)[before] == 0.0
        assert speeds(motors)[-1] == 0.5
