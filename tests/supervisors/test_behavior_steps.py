"""A behavior as a step of another one."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("BEH-3")]


class Go(esair.Behavior):
    """Drives for a while, and says how it was."""

    wheels = esair.writes(float, priority=7)

    def __init__(self, speed: float, seconds: float, error: str = "") -> None:
        super().__init__()
        self.speed, self.seconds, self.error = speed, seconds, error
        self.story: list[str] = []

    async def setup(self) -> None:
        self.story.append("setup")

    async def run(self) -> str:
        end = esair.now() + self.seconds
        async for _ in esair.every(0.05):
            if esair.now() >= end:
                break
            await self.wheels.write(self.speed)
        if self.error:
            raise RuntimeError(self.error)
        return f"went {self.speed * self.seconds:g}"

    async def teardown(self) -> None:
        self.story.append("teardown")


class Elsewhere(esair.Behavior):
    placement = "process"


class Captain(esair.Behavior):
    """Performs what a test gives it."""

    wheels = esair.writes(float, priority=3)
    restart = esair.Restart(max=0)

    def __init__(self, act: Any) -> None:
        super().__init__()
        self.act = act
        self.outcome: Any = None

    async def run(self) -> None:
        try:
            self.outcome = await self.act(self)
        except Exception as error:
            self.outcome = error
        await asyncio.sleep(1e6)


async def told(act: Any, seconds: float = 10.0, **more: Any) -> tuple[Any, list[float]]:
    """Return the outcome of what a captain does, and what the wheels were told."""
    wheels = FakeActuator("wheels", safe=0.0)
    captain = Captain(act)
    behaviors = [captain, *more.pop("behaviors", [])]
    async with esair.Robot(resources=[wheels], behaviors=behaviors, **more):
        await asyncio.sleep(seconds)
        outcome = captain.outcome
    return outcome, wheels.commands


async def test_its_return_value_is_the_outcome() -> None:
    """From setup to teardown; then its actuator is safe, and it may be performed again."""
    go = Go(0.5, 2.0)

    async def twice(self: Captain) -> list[str]:
        return [await self.perform(go), await self.perform(go)]

    outcome, commands = await told(twice)
    assert outcome == ["went 1", "went 1"]
    assert go.story == ["setup", "teardown"] * 2
    assert commands.count(0.5) == 80
    assert commands[-1] == 0.0


async def test_one_that_says_so_is_blind_until_it_runs() -> None:
    """Its hold is in force while it is set up; then lower priorities write again."""
    passed: dict[int, set[bool]] = {}

    class Watch(esair.Behavior):
        wheels = esair.writes(float, priority=5, blind="safe")

        async def setup(self) -> None:
            await asyncio.sleep(1.0)

        async def run(self) -> None:
            await asyncio.sleep(1.0)

    class Drive(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await asyncio.sleep(0.05)
            async for _ in esair.every(0.1):
                second = int(esair.now() - began)
                passed.setdefault(second, set()).add(bool(await self.wheels.write(1.0)))

    async def act(self: Captain) -> None:
        await asyncio.sleep(1.0)
        await self.perform(Watch())

    began = esair.now()
    policy = esair.Policy("wheels", allow={"*": esair.Access.WRITE})
    await told(act, 3.9, behaviors=[Drive()], policies=[policy])
    assert passed == {0: {True}, 1: {False}, 2: {True}, 3: {True}}


async def test_its_error_is_the_performers() -> None:
    """Who handles it goes on; the wheels were made safe."""

    async def act(self: Captain) -> str:
        try:
            await self.perform(Go(0.5, 0.2, "stuck"))
        except RuntimeError as error:
            assert not self.wheels.why().holder
            return str(error)
        return ""

    outcome, commands = await told(act)
    assert outcome == "stuck"
    assert commands[-1] == 0.0


async def test_a_timeout_is_an_error_that_names_it() -> None:
    """A TimeoutError; its teardown has run."""
    go = Go(0.5, 100.0)

    async def act(self: Captain) -> None:
        await self.perform(go, timeout=1.0)

    outcome, _ = await told(act)
    assert isinstance(outcome, TimeoutError)
    assert str(outcome) == (
        "'go' could not come to its end for 1 s (it is a step of captain)"
    )
    assert go.story == ["setup", "teardown"]


async def test_it_moves_nothing_when_its_time_is_long_over() -> None:
    """It may clean up; one that heeds no cancellation is fenced off, and its error told."""

    class Deaf(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            while True:
                with contextlib.suppress(asyncio.CancelledError):
                    await self.wheels.write(0.5)
                    await asyncio.sleep(0.05)

    async def act(self: Captain) -> None:
        await self.perform(Deaf(), timeout=1.0)

    outcome, commands = await told(act, grace=0.5)
    assert isinstance(outcome, esair.NotRegisteredError)
    assert commands.count(0.5) == 31  # at once when it was cancelled, too
    assert commands[-1] == 0.0


async def test_it_is_given_no_right_when_its_time_is_long_over() -> None:
    """One that registers anew moves nothing either."""

    class Stubborn(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            port: Any = self.wheels
            while True:
                with contextlib.suppress(asyncio.CancelledError):
                    try:
                        await port.write(0.5)
                    except esair.NotRegisteredError:
                        port = await self.register("wheels", esair.Access.WRITE)
                        await port.write(0.7)
                    await asyncio.sleep(0.05)

    async def act(self: Captain) -> None:
        await self.perform(Stubborn(), timeout=1.0)

    outcome, commands = await told(act, grace=0.5)
    assert isinstance(outcome, esair.NotRegisteredError)
    assert 0.7 not in commands
    assert commands[-1] == 0.0


async def test_it_has_no_right_to_a_device_that_is_back_when_its_time_is_over() -> None:
    """Its ports had theirs again as if it were in time."""

    class Insists(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            port: Any = self.wheels
            while True:
                with contextlib.suppress(asyncio.CancelledError, esair.EsairError):
                    await port.write(0.5)
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(0.05)

    async def act(self: Captain) -> None:
        await self.perform(Insists(), timeout=1.0)

    first, second = (FakeActuator("wheels", safe=0.0) for _ in range(2))
    async with esair.Robot(
        resources=[first], behaviors=[Captain(act)], grace=0.5
    ) as robot:
        await asyncio.sleep(1.2)
        assert 0.5 in first.commands
        await robot.resources.remove("wheels")
        await asyncio.sleep(0.8)
        await robot.resources.add(second)
        await asyncio.sleep(1.0)
        assert set(second.commands) == {0.0}


class AsksAnew(esair.Behavior):
    """Heeds no cancellation, and asks for its right anew before each command."""

    async def run(self) -> None:
        while True:
            with contextlib.suppress(asyncio.CancelledError, esair.EsairError):
                wheels = await self.register("wheels", esair.Access.WRITE, priority=3)
                await wheels.write(0.5)
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(0.05)


class HasOthersMove(esair.Behavior):
    """Heeds no cancellation, and has others move."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        while True:
            with contextlib.suppress(asyncio.CancelledError, esair.EsairError):
                await self.perform(Go(0.5, 0.2))
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(0.05)


@pytest.mark.parametrize("cls", [AsksAnew, HasOthersMove])
async def test_it_gets_no_new_right_when_its_time_is_long_over(cls: Any) -> None:
    async def act(self: Captain) -> None:
        await self.perform(cls(), timeout=1.0)

    _, commands = await told(act, grace=0.5)
    assert 0.5 in commands
    assert commands.count(0.5) <= 40
    assert commands[-1] == 0.0


async def test_it_ends_with_its_performer() -> None:
    """Nothing of it moves after the removal."""

    async def act(self: Captain) -> None:
        await self.perform(Go(0.5, 100.0))

    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Captain(act)]) as robot:
        await wheels.until(0.5, timeout=1.0)
        assert robot.behaviors.query("captain").detail == "performs go"
        await robot.behaviors.remove("captain")
        after = len(wheels.commands)
        await asyncio.sleep(2.0)
        assert wheels.commands[after - 1 :] == [0.0]


async def test_it_writes_with_its_performers_priority_at_most() -> None:
    """Seven is declared, three is what the captain has: who has five keeps it out."""

    class Five(esair.Behavior):
        wheels = esair.writes(float, priority=5)

        async def run(self) -> None:
            async for _ in esair.every(0.05):
                await self.wheels.write(2.0)

    async def act(self: Captain) -> str:
        return await self.perform(Go(0.5, 1.0))  # type: ignore[no-any-return]

    outcome, commands = await told(act, behaviors=[Five()])
    assert outcome == "went 0.5"
    assert 0.5 not in commands[3:]


async def test_a_policy_for_the_performer_counts() -> None:
    """What it may not do, no step of it may."""
    rule = esair.Policy(
        "wheels", allow={"captain": esair.Access.WRITE}, max_priority={"captain": 3}
    )

    class Arm(Go):
        arm = esair.writes(float)

    async def act(self: Captain) -> None:
        await self.perform(Arm(0.5, 1.0))

    outcome, commands = await told(act, policies=[rule])
    assert isinstance(outcome, esair.EsairError | ExceptionGroup)
    assert set(commands) == {0.0}


async def test_several_at_a_time_in_a_task_group() -> None:
    """One that fails ends the others; there is no new word."""

    async def act(self: Captain) -> str:
        said = ""
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.perform(Go(0.5, 100.0)))
                group.create_task(self.perform(Go(0.0, 0.3, "bang")))
        except* RuntimeError as errors:
            said = str(errors.exceptions[0])
        return said

    outcome, commands = await told(act)
    assert outcome == "bang"
    assert commands[-1] == 0.0
    assert commands.count(0.5) <= 8


async def test_it_speaks_in_its_performers_name() -> None:
    """What others put is the performer's, whoever of both takes it."""

    class Listens(esair.Behavior):
        async def run(self) -> tuple[str, Any]:
            return await self.receive_from(timeout=2.0)

    async def act(self: Captain) -> Any:
        return await self.perform(Listens())

    captain = Captain(act)
    async with esair.Robot(
        resources=[FakeActuator("wheels", safe=0.0)], behaviors=[captain]
    ) as robot:
        await asyncio.sleep(0.1)
        await robot.behaviors.put(5, sender="captain", receiver="captain")
        await asyncio.sleep(0.1)
        assert captain.outcome == ("captain", 5)


async def test_only_its_run_need_be_async() -> None:
    """Its setup and teardown may be plain."""
    done: list[str] = []

    class Half(esair.Behavior):
        def setup(self) -> None:  # type: ignore[override]
            done.append("setup")

        async def run(self) -> str:
            done.append("run")
            return "over"

        def teardown(self) -> None:  # type: ignore[override]
            done.append("teardown")

    async def act(self: Captain) -> Any:
        return await self.perform(Half())

    outcome, _ = await told(act)
    assert outcome == "over"
    assert done == ["setup", "run", "teardown"]


async def test_a_step_may_be_plain_and_have_steps() -> None:
    """In a thread of its own, with what it performs."""

    class Plain(esair.ThreadBehavior):
        wheels = esair.writes(float)

        def run(self) -> str:
            self.wheels.write(0.7)
            return f"plain, {self.perform(Go(0.5, 0.2))}"

    async def act(self: Captain) -> Any:
        return await self.perform(Plain())

    outcome, commands = await told(act)
    assert outcome == "plain, went 0.1"
    assert 0.7 in commands
    assert commands[-1] == 0.0


async def test_a_sensor_that_goes_and_comes_is_its_own_to_handle() -> None:
    """Its port raises, and lives again: the step is not ended."""

    class Reads(esair.Behavior):
        sonar = esair.reads(float)

        async def run(self) -> list[str]:
            found = []
            for _ in range(3):
                try:
                    found.append(str(await self.sonar.read()))
                except esair.ResourceRemovedError:
                    found.append("gone")
                await asyncio.sleep(1.0)
            return found

    async def act(self: Captain) -> Any:
        return await self.perform(Reads())

    captain = Captain(act)
    async with esair.Robot(
        resources=[
            FakeActuator("wheels", safe=0.0),
            FakeSensor("sonar", 1.0, type=float),
        ],
        behaviors=[captain],
    ) as robot:
        await asyncio.sleep(0.5)
        await robot.resources.remove("sonar")
        await asyncio.sleep(1.0)
        await robot.resources.add(FakeSensor("sonar", 2.0, type=float))
        await asyncio.sleep(2.0)
    assert captain.outcome == ["1.0", "gone", "2.0"]


@pytest.mark.parametrize("wrong", ["in use", "takes", "until", "placed", "nothing"])
async def test_what_cannot_be_a_step_is_told(wrong: str) -> None:
    """One that runs already, is asked, is placed; a condition, nothing of the kind."""

    class Dock(esair.Request[int]): ...

    class Taker(esair.Behavior):
        orders = esair.takes(Dock)

    other = Go(0.0, 1e6)

    async def act(self: Captain) -> None:
        if wrong == "placed":
            await self.perform(Elsewhere())
        elif wrong == "in use":
            await self.perform(other)
        elif wrong == "takes":
            await self.perform(Taker())
        elif wrong == "until":
            await self.perform(Go(0.0, 1.0), until=lambda: True)  # type: ignore[call-overload]
        else:
            await self.perform(3)  # type: ignore[call-overload]

    outcome, _ = await told(act, behaviors=[other])
    assert isinstance(outcome, esair.ConfigError | esair.BadValueError), outcome


class Registers(esair.Behavior):
    """Uses what it registers for while it runs."""

    async def run(self) -> Any:
        self.port = await self.register("wheels", esair.Access.WRITE)
        return await self.port.write(0.25)


async def test_what_it_registers_for_is_its_own_and_ends_with_it() -> None:
    """With its performer's name, by the declaration in its performer's class."""
    step = Registers()

    async def act(captain: Captain) -> Any:
        return await captain.perform(step)

    outcome, commands = await told(act)
    assert outcome.command == 0.25
    assert commands[1] == 0.25
    with pytest.raises(esair.EsairError):
        await step.port.write(0.25)


async def test_its_priority_is_bound_by_that_of_the_same_resource() -> None:
    """What its performer has elsewhere lends it nothing; nor what it has not declared."""
    names = "left", "middle", "right"
    ports = {name: esair.writes(float, priority=7) for name in names}
    step: Any = esair.Behavior(name="step", writes=ports)
    seen: dict[str, int] = {}

    async def run() -> None:
        seen.update((each, getattr(step, each).registration.priority) for each in names)

    step.run = run
    own = {
        "left": esair.writes(float, priority=9),
        "right": esair.writes(float, priority=2),
    }
    performer: Any = esair.Behavior(name="performer", writes=own)
    resources = [FakeActuator(name, safe=0.0) for name in names]
    rule = [esair.Policy(name, allow={"*": esair.Access.WRITE}) for name in names]
    async with esair.Robot(resources=resources, behaviors=[performer], policies=rule):
        await performer.perform(step)
    assert seen == {"left": 7, "middle": 0, "right": 2}


@pytest.mark.promise("PRO-1")
async def test_what_could_not_begin_protects_nothing_more() -> None:
    """It was blind until its setup had ended, which it never has."""

    class Look(esair.Behavior):
        wheels = esair.writes(float, priority=9, blind="safe")

        async def setup(self) -> None:
            await asyncio.sleep(0.1)
            raise RuntimeError("no map")

    async def act(captain: Captain) -> Any:
        with pytest.raises(RuntimeError, match="no map"):
            await captain.perform(Look())
        return await captain.wheels.write(0.25)

    outcome, commands = await told(act)
    assert isinstance(outcome, esair.Written)
    assert [each for each in commands if each] == [0.25]
