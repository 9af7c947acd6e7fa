"""Commands that can be changed: what was checked is what leaves, whoever has them."""

from __future__ import annotations

import asyncio
import ctypes
import math
from collections.abc import Callable
from typing import Any

import attrs
import pytest

import esair
from esair.journal import Kind
from esair.testing import FakeSensor

pytestmark = pytest.mark.virtual_clock

Arms = dict[str, float]

KINDS = (Kind.COMMAND, Kind.SENT, Kind.APPLIED)


class Both(esair.Actuator[Arms]):
    """Scales what it is given in its place, as drivers do that pack bytes."""

    safe = {"left": 0.0, "right": 0.0}  # noqa: RUF012

    def __init__(self) -> None:
        super().__init__(name="arms")
        self.told: list[Arms] = []

    async def write(self, command: Arms) -> None:
        self.told.append(dict(command))
        for name in command:
            command[name] = (command[name] + 7.0) * 1000.0


class Judge(esair.Reaction):
    """A guard that changes the command that it gets, and returns it."""

    sonar = esair.reads(float)
    arms = esair.guards(dict)

    def __init__(self, change: Callable[[Arms], object]) -> None:
        super().__init__()
        self._change = change

    def react(self, sonar: float, arms: Arms) -> Arms | None:
        self._change(arms)
        return arms


def user() -> Any:
    return esair.Behavior(name="user", writes={"arms": esair.writes(dict, hold=9.0)})


def near() -> FakeSensor[float]:
    return FakeSensor("sonar", 1.0, type=float)


@pytest.mark.promise("PRO-6", "AC-1")
@pytest.mark.parametrize(
    "change",
    [
        lambda arms: arms.update(left=0.6),
        lambda arms: arms.update(left=math.nan),
        lambda arms: arms.clear(),
    ],
    ids=["more", "nan", "nothing"],
)
async def test_a_guard_cannot_make_more_of_it_in_its_place(change: Any) -> None:
    """It has crashed, and nothing passes."""
    arms, op = Both(), user()
    async with esair.Robot(
        resources=[near(), arms], behaviors=[Judge(change), op]
    ) as robot:
        assert not await op.arms.write({"left": 0.5, "right": 0.5})
        await asyncio.sleep(0.05)
        assert robot.behaviors.query("judge").error is not None
    assert all(told == Both.safe for told in arms.told)


@pytest.mark.promise("PRO-7", "PRO-8")
async def test_a_guard_may_make_less_of_it_in_its_place() -> None:
    """It is said who did it; what was asked is what is judged again."""

    def halve(arms: Arms) -> None:
        arms["left"] /= 2

    class Patient(Both):
        command_timeout = 9.0

    arms, op, sonar = Patient(), user(), near()
    async with esair.Robot(resources=[sonar, arms], behaviors=[Judge(halve), op]):
        asked = {"left": 0.5, "right": 0.5}
        written = await op.arms.write(asked)
        assert (written.asked, written.by) == (asked, "judge")
        assert asked == {"left": 0.5, "right": 0.5}
        await asyncio.sleep(2.0)
        assert arms.told[1:] == [{"left": 0.25, "right": 0.5}]


@pytest.mark.promise("AC-5")
async def test_a_driver_may_change_what_it_is_given() -> None:
    """Neither the answer, nor who reads what was applied, sees that."""
    applied: list[Arms] = []

    class Look(esair.Reaction):
        now = esair.reads(dict, name="arms.applied")

        def react(self, now: Arms) -> None:
            applied.append(dict(now))

    arms, op = Both(), user()
    async with esair.Robot(resources=[arms], behaviors=[Look(), op]):
        written = await op.arms.write({"left": 0.5, "right": 0.5})
        assert written.command == {"left": 0.5, "right": 0.5}
        await asyncio.sleep(0.01)
        assert applied[-1] == {"left": 0.5, "right": 0.5}
    assert arms.told[1] == {"left": 0.5, "right": 0.5}
    assert arms.told[-1] == {"left": 0.0, "right": 0.0}


@pytest.mark.promise("AC-5")
async def test_a_frozen_command_may_have_parts_that_are_not() -> None:
    """They are copied as well."""

    @attrs.frozen
    class Pose:
        joints: list[float]

    class Arm(esair.Actuator[Pose]):
        safe = Pose([0.0, 0.0])

        async def write(self, command: Pose) -> None:
            command.joints.reverse()

    class Look(esair.Reaction):
        sonar = esair.reads(float)
        arm = esair.guards(Pose)

        def react(self, sonar: float, arm: Pose) -> Pose | None:
            arm.joints[0] = 9.0
            return arm

    op: Any = esair.Behavior(name="user", writes={"arm": esair.writes(Pose)})
    async with esair.Robot(resources=[Arm(), near()], behaviors=[op]) as robot:
        written = await op.arm.write(Pose([0.1, 0.2]))
        assert written.command == Pose([0.1, 0.2])
        await robot.behaviors.add(Look())
        await asyncio.sleep(0.5)
        assert not await op.arm.write(Pose([0.1, 0.2]))


@pytest.mark.promise("PRO-6")
async def test_a_guard_passes_a_command_that_cannot_be_compared() -> None:
    """As it was asked: what it has changed in its own copy counts for nothing."""

    class Shout(ctypes.Structure):
        """Compares with nothing: two of them are two."""

        _fields_ = [("loud", ctypes.c_double)]

    class Horn(esair.Actuator[Shout]):
        safe = Shout(0.0)

        async def write(self, command: Shout) -> None:
            told.append(command.loud)

    told: list[float] = []

    class Pass(esair.Reaction):
        sonar = esair.reads(float)
        horn = esair.guards(Shout)

        def react(self, sonar: float, horn: Shout) -> Shout:
            horn.loud = 9.0
            return horn

    op: Any = esair.Behavior(name="user", writes={"horn": esair.writes(Shout)})
    async with esair.Robot(resources=[Horn(), near()], behaviors=[Pass(), op]):
        written = await op.horn.write(Shout(0.5))
        assert written
        assert written.by is None
        assert told[-1] == 0.5


@pytest.mark.promise("TURN-5")
async def test_the_journal_has_what_was_asked() -> None:
    """Also where the command is another one when a listener hears of it."""
    heard: list[Any] = []
    arms, op = Both(), user()
    robot = esair.Robot(resources=[arms], behaviors=[op])
    robot.journal.listen(lambda event: heard.append(dict(event.value)), kinds=KINDS)
    async with robot:
        asked = {"left": 0.5, "right": 0.5}
        await op.arms.write(asked)
        asked["left"] = 0.9
        await asyncio.sleep(0.01)
    assert heard == [{"left": 0.5, "right": 0.5}] * len(KINDS)


@pytest.mark.promise("TURN-5")
async def test_the_journal_has_what_was_asked_while_nothing_may_move() -> None:
    """Also of a write that the halt has refused."""
    heard: list[Any] = []
    op = user()
    robot = esair.Robot(resources=[Both()], behaviors=[op])
    robot.journal.listen(lambda event: heard.append(event.value), kinds=(Kind.COMMAND,))
    async with robot:
        robot.halt("a hand is in the gripper")
        asked = {"left": 0.5, "right": 0.5}
        assert not await op.arms.write(asked)
        asked["left"] = 0.9
        await asyncio.sleep(0.01)
    assert heard == [{"left": 0.5, "right": 0.5}]
