"""The last command of an actuator, as a reading."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

import esair
from esair.plan import Plan, examine
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("PRO-11")]


class Look(esair.Behavior):
    """Remember everything that the wheels have applied."""

    applied = esair.reads(float, name="wheels.applied")

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[float] = []

    async def run(self) -> None:
        async for value in self.applied:
            self.seen.append(value)


class Drive(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        await asyncio.sleep(0.1)
        for speed in (1.0, 4.0):
            await self.wheels.write(speed)
            await asyncio.sleep(0.05)
        await asyncio.sleep(10.0)


class Half(esair.Reaction):
    """Let half pass."""

    bumper = esair.reads(bool)
    wheels = esair.guards(float)

    def react(self, bumper: bool, wheels: float) -> float | None:
        return None if bumper else wheels / 2


@pytest.mark.parametrize("seconds", [0.0, 0.01])
async def test_it_is_what_the_device_has_taken(seconds: float) -> None:
    """Limited, weakened by a guard, withdrawn, and made safe: all of it, in order."""
    wheels: FakeActuator[float] = FakeActuator(
        "wheels", safe=0.0, limits=(-2.0, 2.0), clamp=True, command_timeout=0.2
    )
    wheels.slow(seconds)
    bumper = FakeSensor("bumper", False, type=bool)
    look = Look()
    async with esair.Robot(
        resources=[wheels, bumper], behaviors=[look, Drive(), Half()]
    ):
        await asyncio.sleep(0.19)
        bumper.feed(True)
        await asyncio.sleep(0.3)
        assert look.seen == [0.5, 1.0, 0.0]
        assert wheels.commands == [0.0, 0.5, 1.0, 0.0]


@pytest.mark.parametrize("seconds", [0.0, 0.01])
async def test_it_is_what_a_guard_has_left_of_what_stands(seconds: float) -> None:
    """Nobody wrote that: the guard's new reading has made it less."""

    class Cap(esair.Reaction):
        cap = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, cap: float, wheels: float) -> float:
            return min(wheels, cap)

    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0, command_timeout=9.0)
    wheels.slow(seconds)
    cap = FakeSensor("cap", 9.0, type=float)
    look = Look()
    async with esair.Robot(resources=[wheels, cap], behaviors=[look, Drive(), Cap()]):
        await asyncio.sleep(0.25)
        cap.feed(2.0)
        await asyncio.sleep(0.05)
        assert wheels.commands == [0.0, 1.0, 4.0, 2.0]
        assert look.seen == [1.0, 4.0, 2.0]


async def test_it_is_what_the_driver_says_that_it_has_applied() -> None:
    """Which may be another value than it was told."""

    class Wheels(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 1.0

        async def write(self, command: float) -> float:
            return round(command)

    look = Look()

    class Drive(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await asyncio.sleep(0.05)
            await self.wheels.write(1.7)
            await asyncio.sleep(1.0)

    async with esair.Robot(resources=[Wheels()], behaviors=[look, Drive()]):
        await asyncio.sleep(0.1)
        assert look.seen == [2.0]


async def test_it_comes_and_goes_with_its_actuator() -> None:
    """Lost, back, removed, added, replaced: it is never what another one was told."""

    class Hear(esair.Reaction):
        applied = esair.reads(float, name="wheels.applied")
        lamp = esair.writes(float)

        def react(self, applied: float) -> float:
            return applied

    class Drive(esair.Behavior):
        wheels = esair.writes(float)
        speed = 1.0

        async def run(self) -> None:
            async for _ in esair.every(0.05):
                try:
                    await self.wheels.write(self.speed)
                except (esair.DeviceLostError, esair.ResourceRemovedError):
                    continue

    def wheels() -> FakeActuator[float]:
        return FakeActuator("wheels", safe=0.0)

    lamp: FakeActuator[float] = FakeActuator("lamp", safe=-1.0)
    first, drive = wheels(), Drive()
    async with esair.Robot(resources=[first, lamp], behaviors=[Hear(), drive]) as robot:
        await lamp.until(1.0, timeout=1.0)
        first.unplug()
        await lamp.until(-1.0, timeout=0.1)
        drive.speed = 2.0
        first.plug()
        await lamp.until(2.0, timeout=0.5)
        await robot.resources.remove("wheels")
        await lamp.until(-1.0, timeout=0.1)
        drive.speed = 3.0
        await robot.resources.add(wheels())
        await lamp.until(3.0, timeout=0.5)
        drive.speed = 4.0
        await robot.resources.replace("wheels", wheels())
        await lamp.until(4.0, timeout=0.5)
        assert robot.resources.query("wheels").users == ("drive",)


class LookOnce(esair.Behavior):
    applied = esair.reads(float, name="wheels.applied")

    async def run(self) -> None:
        self.met = ""
        try:
            await self.applied.read()
        except esair.DeviceLostError as error:
            self.met = str(error)


async def test_who_asks_while_the_actuator_is_lost_learns_that_at_once() -> None:
    """Nobody has read its last command before; it does not wait for one."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        wheels.unplug()
        await asyncio.sleep(0.01)
        look = LookOnce()
        await robot.behaviors.add(look)
        await asyncio.sleep(0.01)
        assert "unplugged" in look.met


async def test_one_that_stays_is_unknown_until_its_driver_says_where() -> None:
    """`esair.HOLD` is no command that anybody could read."""

    class Arm(esair.Actuator[float]):
        safe = esair.HOLD
        command_timeout = 0.2
        at: float | None = None

        async def write(self, command: Any) -> float | None:
            return self.at if command is esair.HOLD else None

    arm = Arm()
    async with esair.Robot(resources=[arm]) as robot:
        right = await robot.resources.register("user", "arm.applied", esair.Access.READ)
        with pytest.raises(esair.StaleReadingError):
            await robot.sensors.read(right, timeout=0.1)
        arm.at = 0.7
        await robot.resources.restart("arm")
        assert (await robot.sensors.read(right)).value == 0.7


async def test_the_right_to_it_is_that_to_read_the_actuator() -> None:
    """By the policy of the actuator; open without one."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    policy = esair.Policy("wheels", allow={"drive": esair.Access.WRITE})
    (found,) = [
        each.text
        for each in examine(
            Plan(resources=[wheels], behaviors=[Look()], policies=[policy])
        )
        if each.is_error
    ]
    assert "allow 'look' READ there" in found
    async with esair.Robot(resources=[wheels], policies=[policy]) as robot:
        with pytest.raises(esair.AccessDeniedError, match="'wheels'"):
            await robot.resources.register("look", "wheels.applied", esair.Access.READ)
        with pytest.raises(esair.UnknownNameError):
            await robot.resources.register("look", "lamp.applied", esair.Access.READ)


@pytest.mark.parametrize(
    ("port", "told"),
    [
        (esair.reads(str, name="wheels.applied"), "'wheels.applied' gives float"),
        (esair.reads(float, name="sonar.applied"), "no resource is named"),
        (esair.writes(float, name="wheels.applied"), "name"),
    ],
)
def test_a_port_that_does_not_fit_stops_the_start(port: Any, told: str) -> None:
    """As of any resource."""

    class Odd(esair.Behavior):
        it = port

        async def run(self) -> None: ...

    sonar = FakeSensor("sonar", 1.0, type=float)
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    found = examine(Plan(resources=[wheels, sonar], behaviors=[Odd()]))
    (wrong,) = [each.text for each in found if each.is_error]
    assert told in wrong


class Lies(FakeActuator[Any]):
    """Its driver says that it has applied what no device can."""

    waits = 0.0

    async def write(self, command: Any) -> Any:
        await super().write(command)
        await asyncio.sleep(self.waits)
        return command if command == 0.0 else math.nan


@pytest.mark.promise("AC-1", "SC-3")
@pytest.mark.parametrize("waits", [0.0, 0.03])
async def test_what_was_applied_is_a_number(waits: float) -> None:
    """NaN reaches nobody who writes, or reads what was applied."""
    wheels = Lies("wheels", safe=0.0, command_timeout=0.2)
    wheels.waits = waits
    drive, look = Drive(), Look()
    async with esair.Robot(resources=[wheels], behaviors=[drive, look]) as robot:
        await asyncio.sleep(0.3)
        error = robot.behaviors.query("drive").error
        assert isinstance(error, esair.DeviceFaultError)
        assert "it has applied: expected a finite number, not nan" in str(error)
    assert 1.0 in wheels.commands
    assert set(look.seen) <= {0.0}


class Doubtful(FakeActuator[float]):
    """Applies what it is told, and does not always say so."""

    deadline = 0.2
    how = ""

    async def write(self, command: float) -> None:
        await super().write(command)
        if command == 4.0 and self.how == "raises":
            raise ValueError("checksum")
        if command == 4.0 and self.how == "silent":
            await asyncio.sleep(5.0)


@pytest.mark.promise("PRO-11", "SC-3")
@pytest.mark.parametrize("how", ["raises", "silent", "cancelled"])
async def test_what_may_have_been_applied_is_not_known(how: str) -> None:
    """A guard that looks at it is blind until something was applied again."""
    wheels = Doubtful("wheels", safe=esair.HOLD, command_timeout=60.0)
    wheels.how = "silent" if how == "cancelled" else how

    class Steer(esair.Behavior):
        wheels = esair.writes(float)
        applied = esair.reads(float, name="wheels.applied")

        async def run(self) -> None:
            self.seen: list[Any] = []
            for speed in (1.0, 4.0, 2.0):
                try:
                    async with asyncio.timeout(0.1 if how == "cancelled" else 1.0):
                        await self.wheels.write(speed)
                except (esair.EsairError, TimeoutError):
                    await asyncio.sleep(0.3)
                try:
                    self.seen.append(await self.applied.read(timeout=0.05))
                except esair.StaleReadingError:
                    self.seen.append(None)
            await asyncio.sleep(100.0)

    steer = Steer()
    async with esair.Robot(resources=[wheels], behaviors=[steer]):
        await asyncio.sleep(3.0)
    assert steer.seen == [1.0, None, 2.0]


class Refusing(esair.Actuator[float]):
    """Has an owner elsewhere, who refuses what he likes."""

    safe = 0.0
    command_timeout = 0.2

    def __init__(self, *, waits: float) -> None:
        super().__init__(name="wheels")
        self.waits = waits
        self.refuses: tuple[float, ...] = ()
        self.told: list[float] = []

    async def write(self, command: float) -> Any:
        if self.waits:
            await asyncio.sleep(self.waits)
        self.told.append(command)
        if command in self.refuses:
            return esair.Refused("owner", 0, "not now", esair.now(), None)
        return None


@pytest.mark.promise("PRO-11", "AC-4")
@pytest.mark.parametrize("waits", [0.0, 0.01])
async def test_what_the_device_has_refused_is_not_applied(waits: float) -> None:
    """Its owner may do anything else with it: what it does is not known."""
    wheels = Refusing(waits=waits)
    user: Any = esair.Behavior(
        name="user",
        reads={"applied": esair.reads(float, name="wheels.applied")},
        writes={"wheels": esair.writes(float)},
    )
    async with esair.Robot(resources=[wheels], behaviors=[user]):
        await user.wheels.write(1.0)
        assert await user.applied.read() == 1.0
        wheels.refuses = (2.0,)
        assert not await user.wheels.write(2.0)
        with pytest.raises(esair.StaleReadingError):
            _ = user.applied.newest


@pytest.mark.promise("AC-4", "ROB-2")
@pytest.mark.parametrize("waits", [0.0, 0.01])
@pytest.mark.parametrize("moves", [False, True])
async def test_a_safe_command_that_is_refused_is_sent_again(
    waits: float, moves: bool
) -> None:
    """Until it is taken, or somebody moves it; who may look sees that it is not safe."""
    wheels = Refusing(waits=waits)
    user: Any = esair.Behavior(
        name="user",
        reads={"applied": esair.reads(float, name="wheels.applied")},
        writes={"wheels": esair.writes(float)},
    )
    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        await user.wheels.write(1.0)
        wheels.refuses = (0.0,)
        await asyncio.sleep(1.0)
        refused = wheels.told.count(0.0)
        assert 3 <= refused <= 8
        assert not robot.actuators.channel("wheels").is_safe
        with pytest.raises(esair.StaleReadingError):
            _ = user.applied.newest
        wheels.refuses = ()
        if moves:
            for _ in range(10):  # longer than until it would be sent again
                assert await user.wheels.write(2.0, hold=0.1)
                await asyncio.sleep(0.05)
            assert wheels.told.count(0.0) == refused
            return
        await asyncio.sleep(0.5)
        assert robot.actuators.channel("wheels").is_safe
        assert await user.applied.read() == 0.0
        assert wheels.told.count(0.0) == refused + 1


@pytest.mark.promise("AC-4", "ROB-2")
async def test_a_safe_command_that_is_refused_when_it_opens_is_sent_again() -> None:
    """It may move there still, and nobody here has written yet."""
    wheels = Refusing(waits=0.0)
    wheels.refuses = (0.0,)
    async with esair.Robot(resources=[wheels]) as robot:
        await asyncio.sleep(0.5)
        assert wheels.told.count(0.0) >= 3
        wheels.refuses = ()
        await asyncio.sleep(0.3)
        assert robot.actuators.channel("wheels").is_safe


@pytest.mark.promise("AC-4", "GRD-4")
async def test_what_was_refused_while_a_watchdog_answers_late_is_sent_again() -> None:
    """It is not ready before that; then it is told at once what it has refused."""
    wheels = Refusing(waits=0.0)

    class Eye:
        async def open(self) -> None:
            await asyncio.sleep(2.0)

        async def arm(self) -> None: ...

        async def drop(self, _within: float | None = None) -> None: ...

        def is_safe(self) -> None: ...

    async with esair.Robot(resources=[wheels]) as robot:
        life = robot._resources.lives["wheels"]
        life.device.watch = Eye()  # type: ignore[assignment]
        wheels.refuses = (0.0,)
        restarting = asyncio.create_task(robot.resources.restart("wheels"))
        await asyncio.sleep(1.0)
        wheels.refuses = ()
        await restarting
        assert not robot.actuators.channel("wheels").is_safe
        await asyncio.sleep(0.5)
        assert robot.actuators.channel("wheels").is_safe
        life.device.watch = None
