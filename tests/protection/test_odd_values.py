"""Values, errors and streams of any class: what they do when looked at stays in."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncIterator
from typing import Any, NamedTuple

import attrs
import pytest

import esair
from esair import BehaviorState
from esair.flaws import parts_of
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


class Ends:
    """Ends the program when its text is wanted."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def __repr__(self) -> str:
        raise self.error


class Lies(float):
    """Is less than nothing, and more than nothing."""

    def __lt__(self, other: object) -> bool:
        return False

    __le__ = __gt__ = __ge__ = __lt__

    def __float__(self) -> float:
        return -7.0


class NamelessError(Exception):
    """Raises when it is asked for its class."""

    @property  # type: ignore[misc]
    def __class__(self) -> Any:  # type: ignore[override]
        raise RuntimeError("no class")


class Returns(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float)
    gives: Any = 0.5

    def react(self, sonar: float) -> Any:
        return self.gives if sonar > 1.0 else 0.5


class Drive(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        await asyncio.sleep(1e6)


class Raises(esair.Behavior):
    async def run(self) -> None:
        await asyncio.sleep(0.1)
        raise NamelessError("odd")


class Floods(esair.Sensor[float]):
    """Has always one more value, and never waits."""

    async def stream(self) -> AsyncIterator[float]:
        number = 0.0
        while True:
            number += 1.0
            yield number


@pytest.mark.promise("ROB-3", "AC-1")
@pytest.mark.parametrize("error", [SystemExit(2), KeyboardInterrupt(), OSError("odd")])
@pytest.mark.parametrize("inside", [False, True])
async def test_what_a_reaction_returns_ends_no_robot(
    error: BaseException, *, inside: bool
) -> None:
    """Its text is wanted for the error that names it."""
    sonar = FakeSensor("sonar", 1.0, type=float)
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    returns = Returns()
    returns.gives = {"wheel": Ends(error)} if inside else Ends(error)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[returns]) as robot:
        await asyncio.sleep(0.05)
        assert wheels.commands[-1] == 0.5
        sonar.feed(2.0)
        await asyncio.sleep(0.05)
        assert wheels.commands[-1] == 0.0
        sonar.feed(1.0)
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("returns").state is BehaviorState.RUNNING
        assert wheels.commands[-1] == 0.5


@pytest.mark.promise("AC-1", "AC-5")
async def test_a_number_of_a_class_of_its_own_is_a_plain_one() -> None:
    """It may compare as it likes: what is checked is what leaves."""
    wheels: FakeActuator[float] = FakeActuator(
        "wheels", safe=0.0, limits=(-1.0, 1.0), clamp=True
    )
    drive = Drive()
    async with esair.Robot(resources=[wheels], behaviors=[drive]):
        assert await drive.wheels.write(Lies(5.0))
        assert wheels.commands[-1] == 1.0
        assert await drive.wheels.write(Lies(0.25))
        assert wheels.commands[-1] == 0.25
        assert type(wheels.commands[-1]) is float


@pytest.mark.promise("SUP-4")
async def test_an_error_that_cannot_be_asked_for_its_class_is_a_failure() -> None:
    """Of its component, which begins anew."""
    raises = Raises()
    async with esair.Robot(behaviors=[raises]) as robot:
        await asyncio.sleep(0.15)
        assert robot.behaviors.query("raises").state is BehaviorState.RESTARTING
        assert "NamelessError" in str(robot.behaviors.query("raises").error)


@pytest.mark.real_clock
@pytest.mark.promise("TURN-4", "BUS-1")
@pytest.mark.fault("D13")
async def test_a_stream_that_never_waits_keeps_nobody_waiting() -> None:
    """What comes in at once is bounded; the newest wins."""
    loop = asyncio.get_running_loop()
    async with esair.Robot(resources=[Floods()]):
        late = 0.0
        for _ in range(30):
            asked = loop.time() + 0.01
            await asyncio.sleep(0.01)
            late = max(late, loop.time() - asked)
    assert late < 0.2


@attrs.frozen
class Twist:
    linear: float
    steps: int = 0


@dataclasses.dataclass(frozen=True)
class Plain:
    linear: float
    steps: int = 0


class Named(NamedTuple):
    linear: float
    steps: int = 0


class Steps(int):
    """Is within all limits, if one asks it."""

    __lt__ = __le__ = __gt__ = __ge__ = lambda *_: True  # type: ignore[assignment]


class Endless(float):
    """Says that it is finite."""

    def __sub__(self, other: object) -> float:
        return 0.0


class Agrees(float):
    """Is within all limits, if one asks it."""

    __lt__ = __le__ = __gt__ = __ge__ = lambda *_: True  # type: ignore[assignment]


def _named(linear: float, steps: int) -> dict[str, float]:
    return {"linear": linear, "steps": steps}


SHAPES: list[Any] = [Twist, Plain, Named, _named]


@pytest.mark.promise("AC-1", "AC-5")
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("clamp", [False, True])
async def test_a_field_cannot_compare_as_it_likes(shape: Any, *, clamp: bool) -> None:
    """Its limits count for the number that it is, and a plain one leaves."""
    wheels: FakeActuator[Any] = FakeActuator(
        "wheels",
        safe=shape(0.0, 0),
        limits={"linear": (-1.0, 1.0), "steps": (0, 5)},
        clamp=clamp,
    )
    drive: Any = esair.Behavior(name="drive", writes={"wheels": esair.writes(Any)})
    async with esair.Robot(resources=[wheels], behaviors=[drive]):
        for odd, near in (
            (shape(Agrees(7.0), 1), shape(1.0, 1)),
            (shape(0.5, Steps(9)), shape(0.5, 5)),
        ):
            if clamp:
                assert await drive.wheels.write(odd)
                assert wheels.commands[-1] == near
            else:
                with pytest.raises(esair.BadValueError, match="expected"):
                    await drive.wheels.write(odd)
        assert await drive.wheels.write(shape(Agrees(0.5), Steps(3)))
        assert repr(wheels.commands[-1]) == repr(shape(0.5, 3))
        parts = [part for _, part in parts_of(wheels.commands[-1])]
        assert {float, int} <= set(map(type, parts)) <= {float, int, str}


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize("shape", SHAPES)
async def test_a_field_cannot_say_that_it_is_finite(shape: Any) -> None:
    """Whatever its own class computes."""
    wheels: FakeActuator[Any] = FakeActuator("wheels", safe=shape(0.0, 0))
    drive: Any = esair.Behavior(name="drive", writes={"wheels": esair.writes(Any)})
    async with esair.Robot(resources=[wheels], behaviors=[drive]):
        with pytest.raises(esair.BadValueError, match="finite"):
            await drive.wheels.write(shape(Endless("inf"), 0))


@pytest.mark.promise("AC-1")
async def test_a_field_cannot_change_faster_than_it_may() -> None:
    """How fast it changes counts for the number that it is."""
    wheels: FakeActuator[Any] = FakeActuator(
        "wheels", safe=Twist(0.0), slew={"linear": 1.0}
    )
    drive: Any = esair.Behavior(name="drive", writes={"wheels": esair.writes(Any)})
    async with esair.Robot(resources=[wheels], behaviors=[drive]):
        written = await drive.wheels.write(Twist(Lies(5.0)))
        assert abs(written.command.linear) <= 0.2


@pytest.mark.promise("PRO-6")
async def test_a_guard_cannot_let_more_pass_than_was_asked() -> None:
    """Whatever the number that it returns says of itself."""

    class More(esair.Reaction):
        wheels = esair.guards(Twist)
        sonar = esair.reads(float)

        def react(self, sonar: float, wheels: Twist) -> Twist:
            return Twist(Agrees(9.0))

    wheels: FakeActuator[Any] = FakeActuator("wheels", safe=Twist(0.0))
    sonar = FakeSensor("sonar", 1.0, type=float)
    drive: Any = esair.Behavior(name="drive", writes={"wheels": esair.writes(Any)})
    async with esair.Robot(resources=[wheels, sonar], behaviors=[drive, More()]):
        assert not await drive.wheels.write(Twist(0.5))
    assert set(wheels.commands) == {Twist(0.0)}


@pytest.mark.promise("SC-3")
async def test_a_reading_cannot_compare_as_it_likes() -> None:
    """What is outside of its limits reaches no action."""
    sonar = FakeSensor("sonar", 1.0, type=float)
    sonar.limits = (0.0, 4.0)
    user: Any = esair.Behavior(name="user", reads={"sonar": esair.reads(float)})
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        sonar.feed(Agrees(9.0))
        with pytest.raises(esair.DeviceFaultError, match="expected 0 to 4"):
            await user.sonar.read(fresh=True)


@dataclasses.dataclass(frozen=True)
class Move:
    """Is equal to each move of the same joint."""

    joint: str
    speed: float = dataclasses.field(compare=False)


class Half(esair.Reaction):
    """Lets half of it pass when it is near."""

    sonar = esair.reads(float)
    arm = esair.guards(Move)

    def react(self, sonar: float, arm: Move) -> Move:
        return arm if sonar > 1.0 else Move(arm.joint, arm.speed / 2)


class Watch(esair.Reaction):
    """Keeps the arm still where it cannot see."""

    sonar = esair.reads(float)
    arm = esair.writes(Move, priority=9)

    def react(self, sonar: float) -> None:
        return None


@pytest.mark.promise("PRO-1", "PRO-2", "PRO-8")
@pytest.mark.parametrize(("sees", "left"), [(Half, 0.5), (Watch, 0.0)])
async def test_commands_that_are_equal_need_not_be_the_same(
    sees: type[esair.Reaction], left: float
) -> None:
    """What a class says of it decides neither what is less nor what is safe."""
    arm = FakeActuator("arm", safe=Move("elbow", 0.0), command_timeout=9.0)
    sonar: FakeSensor[float] = FakeSensor("sonar", 2.0, type=float)
    user: Any = esair.Behavior(name="user", writes={"arm": esair.writes(Move)})
    async with esair.Robot(resources=[arm, sonar], behaviors=[user, sees()]):
        await user.arm.write(Move("elbow", 1.0))
        if sees is Half:
            sonar.feed(0.5)
        else:
            sonar.unplug()
        await asyncio.sleep(0.1)
        assert [each.speed for each in arm.commands] == [0.0, 1.0, left]
