"""ROS is one more peer: topics, services and actions, on a graph in memory."""

from __future__ import annotations

import asyncio
import logging
import math
import sys
from typing import Any

import attrs
import pytest
from tests.ros.parts import STILL, TWIST, Citizen, Count, Done, Light, Motion, twist

import esair
from esair.buses.peer import PeerBus
from esair.buses.ros import FakeRos, Link, Ros, form_of
from esair.drivers.peer import Peer, PeerSensor
from esair.peers import Drive, Share, Sharing
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Hand(esair.Behavior):
    """A behavior in the hands of a test."""

    range = esair.reads(float)
    wheels = esair.writes(Motion, priority=1)

    async def run(self) -> None:
        await asyncio.get_running_loop().create_future()


@attrs.frozen
class Pose:
    """It has a class where ROS has a number."""

    linear: Motion
    angular: float


async def publish(citizen: Citizen, seconds: float, topic: str = "/cmd_vel") -> None:
    """Publish at 50 Hz, as a teleop does."""
    for _ in range(round(seconds * 50)):
        citizen.fake.publish(topic, twist(0.3))
        await asyncio.sleep(0.02)


@pytest.mark.promise("ROS-2")
async def test_a_topic_drives_by_registration_and_priority() -> None:
    """What comes by it reaches the wheels; ``why`` tells the topic, and lower ones wait."""
    citizen, hand = Citizen(), Hand()
    async with citizen.running(hand) as robot:
        driving = asyncio.create_task(publish(citizen, 0.5))
        await asyncio.sleep(0.3)
        why = robot.resources.why("wheels")
        assert (why.holder, why.priority) == ("ros:/cmd_vel", 5)
        refused = await hand.wheels.write(Motion(1.0, 0.0))
        assert not refused
        assert refused.holder == "ros:/cmd_vel"
        await driving
    assert citizen.wheels.commands.count(Motion(0.3, 0.0)) >= 20
    assert Motion(1.0, 0.0) not in citizen.wheels.commands


@pytest.mark.promise("ROS-2")
async def test_a_topic_that_falls_silent_leaves_the_wheels_safe() -> None:
    """Within command_timeout and 50 ms after the last command."""
    citizen = Citizen()
    async with citizen.running():
        await publish(citizen, 0.5)
        last = asyncio.get_running_loop().time() - 0.02
        await citizen.wheels.until(Motion(0.0, 0.0), timeout=1.0)
        assert asyncio.get_running_loop().time() - last <= 0.25


@pytest.mark.promise("ROS-2", "AC-1")
async def test_a_command_beyond_the_limits_is_left_out(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Who publishes it hears nothing of that: what comes after it drives as before."""
    citizen = Citizen()
    citizen.wheels.limits = {"linear": (-1.0, 1.0)}
    async with citizen.running() as robot:
        for _ in range(10):
            citizen.fake.publish("/cmd_vel", twist(5.0))
            await asyncio.sleep(0.02)
        await publish(citizen, 0.1)
        assert citizen.wheels.commands[-1] == Motion(0.3, 0.0)
        assert robot.behaviors.query("ros:/cmd_vel").restarts == 0
    lines = [each.getMessage() for each in caplog.records]
    assert lines.count("ros:/cmd_vel: wheels: linear: expected -1 to 1, not 5") == 1
    assert Motion(5.0, 0.0) not in citizen.wheels.commands


@pytest.mark.promise("ROS-2", "SC-3")
@pytest.mark.parametrize("seconds", [0.3, 3.0, 60.0])
async def test_a_topic_that_is_no_number_for_a_while_drives_again(
    seconds: float,
) -> None:
    """However long: who publishes it is put right, and nobody restarts a sensor for that."""
    citizen = Citizen()
    async with citizen.running() as robot:
        await publish(citizen, 0.1)
        for _ in range(round(seconds * 50)):
            citizen.fake.publish("/cmd_vel", twist(math.nan))
            await asyncio.sleep(0.02)
        assert citizen.wheels.commands[-1] == STILL
        await publish(citizen, 2.2)
        assert citizen.wheels.commands[-1] == Motion(0.3, 0.0)
        assert robot.resources.query("cmd_vel").state is esair.ResourceState.READY


@pytest.mark.promise("ROS-2", "SC-3")
@pytest.mark.parametrize(
    ("kind", "field"),
    [
        ("std_msgs/msg/Float64MultiArray", "data"),
        ("sensor_msgs/msg/JointState", "position"),
    ],
)
async def test_no_number_in_a_row_moves_nothing(kind: str, field: str) -> None:
    """A joint for which nothing is said does not go to zero: the arm is safe."""
    fake, still, there = FakeRos(), (0.5, 0.5), (0.7, 0.6)
    arm = FakeActuator("arm", safe=still, command_timeout=0.2)
    link = Link("/arm", kind, "topic", "in", "wanted", form_of(kind, tuple, field))
    bus = PeerBus(name="ros", network=Ros([link], me="rover", begin=fake))
    wanted = PeerSensor(name="wanted", remote="/arm", bus=bus, type=tuple)
    robot = esair.Robot(
        name="rover",
        resources=[arm, Peer(name="ros", bus=bus), wanted],
        behaviors=[Drive(topic="/arm", sensor="wanted", actuator="arm")],
    )
    async with robot:
        await asyncio.sleep(0.5)
        for first in (0.7, math.nan, 0.7):
            for _ in range(130):
                fake.publish("/arm", {field: [first, 0.6]})
                await asyncio.sleep(0.02)
            assert arm.commands[-1] == (there if first == 0.7 else still)
    assert set(arm.commands) == {still, there}


@pytest.mark.promise("ROS-2")
async def test_two_topics_have_two_priorities() -> None:
    """The higher one wins, as with any two behaviors."""
    citizen = Citizen(topics=("/nav/cmd_vel", "/teleop/cmd_vel"))
    async with citizen.running() as robot:
        both = [
            asyncio.create_task(publish(citizen, 0.5, topic))
            for topic in ("/nav/cmd_vel", "/teleop/cmd_vel")
        ]
        await asyncio.sleep(0.3)
        assert robot.resources.why("wheels").holder == "ros:/teleop/cmd_vel"
        await asyncio.gather(*both)


@pytest.mark.promise("ROS-2")
async def test_a_policy_and_a_command_know_the_topic_by_its_name() -> None:
    """It may be denied, ended and begun again as any behavior."""
    policy = esair.Policy("wheels", allow={"ros:/cmd_vel": esair.Access.WRITE})
    citizen = Citizen()
    async with citizen.running(policies=[policy]) as robot:
        await publish(citizen, 0.2)
        assert Motion(0.3, 0.0) in citizen.wheels.commands
        await robot.behaviors.command("remove ros:/cmd_vel")
        assert citizen.wheels.commands[-1] == Motion(0.0, 0.0)
        await publish(citizen, 0.2)
        assert citizen.wheels.commands[-1] == Motion(0.0, 0.0)


@pytest.mark.promise("ROS-2")
async def test_what_was_held_up_here_moves_nothing() -> None:
    """A command that lay in the robot's side for longer than command_timeout is refused."""
    citizen = Citizen()
    async with citizen.running():
        bridge = citizen.fake._bridge
        assert bridge is not None
        bridge.ticked -= 0.5  # its process was stopped for half a second
        before = len(citizen.wheels.commands)
        citizen.fake.publish("/cmd_vel", twist(0.3))
        await asyncio.sleep(0.1)
        assert Motion(0.3, 0.0) not in citizen.wheels.commands[before:]
        await asyncio.sleep(0.2)
        await publish(citizen, 0.1)
        assert citizen.wheels.commands[-1] == Motion(0.3, 0.0)


@pytest.mark.promise("ROS-1")
async def test_a_topic_is_a_sensor_and_a_sensor_a_topic() -> None:
    """By its local name, as plain values; a sensor is published at its rate."""
    citizen, hand = Citizen(), Hand()
    async with citizen.running(hand):
        citizen.fake.publish("/range", {"data": 1.5})
        await asyncio.sleep(0.1)
        assert await hand.range.read() == 1.5
        citizen.sonar.feed(0.25)
        await asyncio.sleep(0.5)
    assert ("/sonar", {"data": 0.25}) in citizen.fake.published


@pytest.mark.promise("ROS-1", "ROB-3")
async def test_what_cannot_be_published_ends_nothing_else(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """One line says what it is; the rest of the robot is in ROS as before."""
    citizen = Citizen()
    pose = FakeSensor("pose", Pose(Motion(1.0, 2.0), 0.0))
    form = form_of(TWIST, Pose)
    citizen.network.links.append(Link("/pose", TWIST, "topic", "out", "pose", form))
    sharing: Any = next(each for each in citizen.behaviors if each.name == "ros")
    shares = [*sharing.shares.values(), Share("pose", "read")]
    citizen.behaviors.remove(sharing)
    citizen.behaviors.append(Sharing(bus=citizen.bus, shares=shares))
    async with citizen.running(resources=[pose]) as robot:
        citizen.sonar.feed(0.25)
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("ros").restarts == 0
    assert ("/sonar", {"data": 0.25}) in citizen.fake.published
    assert sum("not 'Motion'" in each.getMessage() for each in caplog.records) == 1


@pytest.mark.promise("ROS-1")
async def test_ros_asks_a_behavior() -> None:
    """A service and an action are asks: answered, refused, with progress, cancelled."""
    citizen = Citizen()
    async with citizen.running():
        ros, news = citizen.fake, list[Any]()
        assert await ros.call("/light", {"data": True}) == (
            "answered",
            {"success": True, "message": "lit"},
        )
        how, told = await ros.call("/light", {"data": False})
        assert how == "declined"
        assert "it stays lit" in told

        goal = ros.call("/count", {"order": 3}, news.append)
        await asyncio.sleep(0.1)
        assert news == [{"sequence": [0, 1]}]
        goal.cancel()
        await asyncio.sleep(0.1)
        assert citizen.lamp.cancelled == 1

        citizen.lamp.go.set()
        how, told = await ros.call("/count", {"order": 3})
        assert (how, told) == ("answered", {"sequence": [0, 1, 1, 2]})
        assert citizen.lamp.seen == [Light(True), Light(False), Count(3), Count(3)]


@pytest.mark.promise("ROS-1")
async def test_a_behavior_asks_ros() -> None:
    """A service and an action of ROS are behaviors; nobody there: refused."""
    citizen, hand, cancelled = Citizen(), Hand(), []

    async def light(message: Any, _: Any) -> Any:
        return {"success": message["data"], "message": "far"}

    async def count(message: Any, progress: Any) -> Any:
        progress({"sequence": [0]})
        try:
            await asyncio.sleep(0.1 * message["order"])
        except asyncio.CancelledError:
            cancelled.append(message)
            raise
        return {"sequence": [0, 1]}

    async with citizen.running(hand):
        with pytest.raises(esair.RefusedError, match="nobody serves /far_light"):
            await hand.ask("far_light", Light(True))
        citizen.fake.services = {"/far_light": light, "/far_count": count}
        assert await hand.ask("far_light", Light(True)) == Done(True, "far")
        news: list[Any] = []
        answer = await hand.ask("far_count", Count(3), progress=news.append)
        assert (answer, news) == ((0, 1), [{"sequence": [0]}])
        with pytest.raises(esair.BehaviorUnavailableError):
            await hand.ask("far_count", Count(90), timeout=0.3)
        await asyncio.sleep(0.1)
        assert cancelled == [{"order": 90}]


@pytest.mark.promise("ROS-1", "SC-1")
async def test_the_last_of_a_burst_is_heard() -> None:
    """It came sooner than the rate allows, and nothing comes after it."""
    citizen, hand = Citizen(), Hand()
    async with citizen.running(hand):
        for number in (1.0, 2.0):
            citizen.fake.publish("/range", {"data": number})
        await asyncio.sleep(0.1)
        assert await hand.range.read() == 2.0


@pytest.mark.promise("ROS-1", "NET-3")
async def test_a_gap_ends_what_each_side_has_asked_for() -> None:
    """Its process was stopped for less than two seconds: nobody works or waits in vain."""
    citizen, hand, cancelled = Citizen(), Hand(), asyncio.Event()

    async def count(*_: Any) -> None:
        try:
            await asyncio.sleep(1000.0)
        finally:
            cancelled.set()

    async with citizen.running(hand):
        citizen.fake.services = {"/far_count": count}
        asked = citizen.fake.call("/count", {"order": 3})
        asking = asyncio.ensure_future(hand.ask("far_count", Count(3), timeout=None))
        await asyncio.sleep(0.1)
        citizen.fake.stall()
        await asyncio.sleep(1.5)
        citizen.fake._stalled = False
        with pytest.raises(esair.OutcomeUnknownError):
            await asking
        await asyncio.sleep(2.0)
        assert citizen.lamp.cancelled == 1
        assert asked.result()[0] == "lost"
        assert cancelled.is_set()
        assert citizen.fake.begun == 1


@pytest.mark.promise("ROS-1", "BS-10")
async def test_a_request_that_cannot_be_read_has_an_answer() -> None:
    """However many there are: others are answered after them."""
    citizen = Citizen()
    async with citizen.running():
        wrong = [citizen.fake.call("/count", {"order": "two"}) for _ in range(64)]
        await asyncio.sleep(2.0)
        assert {each.result()[0] for each in wrong} == {"lost"}
        how, _ = await citizen.fake.call("/light", {"data": True})
        assert how == "answered"


@pytest.mark.promise("ROS-2")
async def test_the_end_of_its_process_is_a_restart() -> None:
    """LOST, begun again, READY; the wheels are safe, an ask is not known, nobody else fell."""
    citizen, hand = Citizen(), Hand()
    begun = asyncio.Event()

    async def light(message: Any, _: Any) -> Any:
        begun.set()
        await asyncio.sleep(100.0)

    async with citizen.running(hand) as robot:
        citizen.fake.services = {"/far_light": light}
        await publish(citizen, 0.2)
        asking = asyncio.create_task(hand.ask("far_light", Light(True)))
        await begun.wait()
        citizen.fake.kill()
        with pytest.raises(esair.OutcomeUnknownError):
            await asking
        assert robot.resources.query("ros").state is esair.ResourceState.LOST
        await citizen.wheels.until(Motion(0.0, 0.0), timeout=0.3)

        await asyncio.sleep(2.0)
        assert citizen.fake.begun == 2
        assert robot.resources.query("ros").state is esair.ResourceState.READY
        await publish(citizen, 0.2)
        assert citizen.wheels.commands[-1] == Motion(0.3, 0.0)
        for each in citizen.behaviors:
            assert robot.behaviors.query(each.name).restarts == 0


@pytest.mark.promise("ROS-2")
async def test_a_process_that_hangs_is_ended() -> None:
    """It says nothing for two seconds: ended, and begun again."""
    citizen = Citizen()
    async with citizen.running() as robot:
        citizen.fake.stall()
        await asyncio.sleep(1.5)
        assert robot.resources.query("ros").state is not esair.ResourceState.READY
        await asyncio.sleep(2.0)
        assert citizen.fake.begun == 2
        assert robot.resources.query("ros").state is esair.ResourceState.READY


@pytest.mark.promise("ROS-2")
async def test_why_there_is_no_process_is_told_of_what_it_had() -> None:
    """Not that nothing was heard; when it is there nothing of it is left."""

    async def nowhere(*_: object) -> Any:
        raise FileNotFoundError("/nowhere/python3")

    citizen = Citizen(nowhere)
    async with citizen.running() as robot:
        assert "/nowhere/python3" in str(robot.resources.query("range").error)
        citizen.network.begin = citizen.fake
        await asyncio.sleep(6.0)
        assert robot.resources.query("ros").state is esair.ResourceState.READY
        citizen.fake.stall()
        await asyncio.sleep(1.5)
        assert "/nowhere" not in str(robot.resources.query("range").error)


@pytest.mark.promise("ROS-2")
async def test_a_process_that_has_not_spoken_yet_is_starting() -> None:
    """That is what its parts are LOST for: ROS needs a second or more for its start."""

    async def slow(bus: PeerBus, setup: dict[str, Any]) -> Any:
        await asyncio.sleep(1.0)
        return await citizen.fake(bus, setup)

    citizen = Citizen(slow)
    async with citizen.robot() as robot:
        assert "its process is starting" in str(robot.resources.query("range").error)
        await asyncio.sleep(2.0)
        assert robot.resources.query("ros").state is esair.ResourceState.READY
        citizen.fake.stall()
        await asyncio.sleep(1.5)
        assert "starting" not in str(robot.resources.query("range").error)


@pytest.mark.promise("ROS-3")
async def test_another_type_is_one_warning(caplog: pytest.LogCaptureFixture) -> None:
    """It names both types and whose it is; it is told once, also after a restart."""
    other = (
        "/cmd_vel",
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
        "nav",
    )
    citizen = Citizen()
    with caplog.at_level(logging.WARNING):
        async with citizen.running():
            citizen.fake.others = [other, other]
            await asyncio.sleep(2.0)
            citizen.fake.others = [other]
            await asyncio.sleep(2.0)
    told = [
        each.getMessage()
        for each in caplog.records
        if "TwistStamped" in each.msg % each.args
    ]
    assert len(told) == 1
    assert "geometry_msgs/msg/Twist here" in told[0]
    assert "by nav" in told[0]


@pytest.mark.promise("ROS-2")
async def test_bytes_of_the_process_move_counters_only() -> None:
    """Frames that are none are counted; what was right before stays right."""
    citizen = Citizen()
    async with citizen.running():
        bridge, bus = citizen.fake._bridge, citizen.bus
        assert bridge is not None
        before = bus.stats.bad_frames
        for what, *parts in (
            ("reading", "/none", 0.0, {}),
            ("reading", "/cmd_vel", 0.0, {"linear": 3}),
            ("reading", "/cmd_vel", -1.0, twist(1.0)),
            ("ask", 1, "/nobody", {}),
            ("import", "os"),
            ("reading",),
        ):
            bridge.say(what, *parts)
        await asyncio.sleep(0.1)
        assert bus.stats.bad_frames - before == 6
        assert citizen.wheels.commands.count(Motion(1.0, 0.0)) == 0
        await publish(citizen, 0.1)
        assert citizen.wheels.commands[-1] == Motion(0.3, 0.0)


@pytest.mark.promise("ROS-2")
def test_rclpy_is_never_here() -> None:
    """The robot's process has nothing of ROS."""
    assert "rclpy" not in sys.modules
