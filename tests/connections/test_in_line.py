"""What waits for its turn is looked at once more when that comes."""

from __future__ import annotations

import asyncio
import enum
import threading
import time
from typing import Any

import pytest

import esair
from esair.connections._values import CommandCheck
from esair.journal import Event, Kind
from esair.plan import Plan, examine_resource
from esair.testing import FakeActuator, FakeSensor


class Arm(esair.Actuator[float]):
    """Is written, and homed, on a thread of its own."""

    safe = 0.0
    command_timeout = 5.0

    def __init__(self) -> None:
        super().__init__()
        self.done: list[object] = []

    def write(self, command: float) -> None:
        self.done.append(command)

    @esair.operation
    def home(self) -> None:
        self.done.append("home")


@pytest.mark.promise("ROB-4", "RS-7")
@pytest.mark.real_clock
async def test_an_operation_in_line_does_not_begin_after_a_halt() -> None:
    """Also where the loop has not heard of the halt of a thread yet."""
    arm, go = Arm(), threading.Event()
    user: Any = esair.Behavior(
        name="user", writes={"arm": esair.writes(float, configure=True)}
    )
    async with esair.Robot(resources=[arm], behaviors=[user]) as robot:
        executor = robot.actuators.channels["arm"].driver.executor
        blocker = asyncio.create_task(executor.call(go.wait, timeout=5.0))
        await asyncio.sleep(0.02)
        homing = asyncio.create_task(user.arm.operate("home"))
        await asyncio.sleep(0.02)
        halted = threading.Event()

        def halt() -> None:
            robot.halt("enough")
            go.set()
            time.sleep(0.05)
            halted.set()

        threading.Thread(target=halt).start()
        assert halted.wait(5.0)  # the loop stands still meanwhile
        await blocker
        with pytest.raises(esair.HaltedError, match="enough"):
            await homing
    assert "home" not in arm.done


@pytest.mark.promise("AC-3")
@pytest.mark.real_clock
async def test_a_command_that_expires_while_guards_decide_does_not_leave() -> None:
    """They are code of others, and may take their time."""

    class Slow(esair.Reaction):
        eye = esair.reads(float)
        wheels = esair.guards(float)
        takes = 0.0

        def react(self, eye: float, wheels: float) -> float:
            threading.Event().wait(self.takes)
            return wheels

    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    eye, slow = FakeSensor("eye", 1.0, type=float), Slow()
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[wheels, eye], behaviors=[user, slow]):
        slow.takes = 0.1
        expires = asyncio.get_running_loop().time() + 0.05
        refused = await user.wheels.write(1.0, expires=expires)
        slow.takes = 0.0
        assert not refused
        assert "expired" in refused.rule
    assert 1.0 not in wheels.commands


@pytest.mark.promise("PRO-8")
@pytest.mark.real_clock
async def test_what_a_guard_has_left_and_was_not_sent_is_taken_back() -> None:
    """The journal hears of it: nobody else waits for it."""

    class Cap(esair.Reaction):
        cap = esair.reads(float)
        arm = esair.guards(float)

        def react(self, cap: float, arm: float) -> float:
            return min(cap, arm)

    arm, go = Arm(), threading.Event()
    cap = FakeSensor("cap", 9.0, type=float)
    user: Any = esair.Behavior(name="user", writes={"arm": esair.writes(float)})
    robot = esair.Robot(resources=[arm, cap], behaviors=[user, Cap()])
    told: list[Event] = []
    robot.journal.listen(told.append, kinds=[Kind.SENT, Kind.REFUSED])
    async with robot:
        assert await user.arm.write(3.0)
        channel = robot.actuators.channels["arm"]
        blocker = asyncio.create_task(
            channel.driver.executor.call(go.wait, timeout=5.0)
        )
        await asyncio.sleep(0.02)
        cap.feed(1.0)
        await asyncio.sleep(0.15)
        channel.make_safe()
        await asyncio.sleep(0.02)
        go.set()
        await blocker
        await asyncio.sleep(0.05)
    assert 1.0 not in arm.done
    of_guard = [each.kind for each in told if not each.peer]
    assert of_guard == [Kind.SENT, Kind.REFUSED]


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize(
    ("limits", "asked", "sent"),
    [((0.0, 2.5), 3, 2), ((-2.5, 0.0), -9, -2), ((0.5, 2.0), 0, 1)],
)
def test_a_whole_number_is_moved_into_its_limits(
    limits: tuple[float, float], asked: int, sent: int
) -> None:
    """The nearest whole number that lies within: no rounding leads out again."""
    gear: Any = FakeActuator("gear", safe=1, limits=limits, clamp=True)
    checked = CommandCheck(gear).checked(asked)
    assert checked == sent
    assert type(checked) is int


@pytest.mark.promise("AC-1")
def test_where_no_whole_number_lies_within_nothing_is_sent() -> None:
    """There is nothing near that it could be moved to."""
    gear: Any = FakeActuator("gear", safe=1, limits=(0.2, 0.8), clamp=True)
    with pytest.raises(esair.BadValueError, match=r"expected 0\.2 to 0\.8"):
        CommandCheck(gear).checked(3)


class Gear(enum.IntEnum):
    """Has nothing between its members."""

    NEUTRAL = 0
    FAST = 5


@pytest.mark.promise("RS-8")
def test_what_has_no_steps_has_no_slew() -> None:
    """That is said at the start, not when the first command is between two members."""
    gear: Any = FakeActuator("gear", safe=Gear.NEUTRAL, slew=1.0)
    found = examine_resource(Plan(), gear)
    assert any(each.field == "slew" and "no steps" in str(each) for each in found)
