"""Every blind hold counts, also one's own: against a model that knows only who is blind."""

from __future__ import annotations

import asyncio
import itertools
import random
from collections.abc import Callable, Sequence
from typing import Any, Literal

import attrs
import pytest

import esair
from esair.loop import TurnLoop
from esair.testing import FakeActuator, FakeSensor, VirtualLoop

pytestmark = pytest.mark.promise("PRO-1", "PRO-2")

SLOT = 0.06  # s, between two writes: longer than any hold of a write
TIMEOUT = 0.02  # s
LOOPS: dict[str, Callable[[], asyncio.AbstractEventLoop]] = {
    "virtual": VirtualLoop,
    "shipped": TurnLoop,
}
SEEN, SET_UP, RUNS, BESIDE, TORN_DOWN, OVER = range(6)  # the rounds of slots


@attrs.define
class Truth:
    """Who is blind over one actuator, by what the holders themselves go through."""

    actuator: str
    began: float = 0.0
    blind: dict[str, int] = attrs.field(factory=dict)
    """With which priority each one bars it that is blind now."""
    expected: dict[float, bool] = attrs.field(factory=dict)
    told: dict[float, Any] = attrs.field(factory=dict)

    async def write(self, port: Any, priority: int, value: float) -> None:
        """Write, with what the model says about it beside."""
        self.expected[value] = all(priority > bar for bar in self.blind.values())
        self.told[value] = await port.write(value)
        port.release()  # here it is not about who holds what

    async def until(self, turn: int, place: int = 0) -> None:
        """Wait for a slot of one holder, or for the beginning of a round."""
        at = self.began + (turn * 5 + place) * SLOT
        await asyncio.sleep(at - asyncio.get_running_loop().time())


class Holder(esair.Behavior):
    """Writes in its setup, in its run and in its teardown; it is blind until it runs."""

    wheels: Any
    truth: Truth
    place: int
    priority: int

    async def write(self, turn: int) -> None:
        await self.truth.until(turn, self.place)
        value = self.place + turn / 10
        await self.truth.write(self.wheels, self.priority, value)

    async def setup(self) -> None:
        await self.write(SET_UP)
        await self.truth.until(SET_UP, 5)

    async def run(self) -> None:
        self.truth.blind.pop(self.name, None)
        await self.write(RUNS)
        await self.truth.until(BESIDE)
        await self.beside()
        await self.truth.until(TORN_DOWN)

    async def beside(self) -> None:
        """Do what this kind is about."""

    async def teardown(self) -> None:
        await self.write(TORN_DOWN)


class Dark(esair.Reaction):
    """Has never heard its sensor."""

    sonar = esair.reads(float, name="dark")
    wheels: Any

    def react(self, sonar: float) -> float | None:
        return None


class Seeing(Dark):
    """Sees, and has no opinion."""

    sonar = esair.reads(float, name="sonar")


class Performer(Holder):
    """Performs a reaction that does not see, and writes beside it."""

    async def beside(self) -> None:
        port = esair.writes(float, name=self.truth.actuator, priority=self.priority)
        step = type("Step", (Dark,), {"wheels": port})(name=f"{self.name}_step")
        self.truth.blind[step.name] = self.priority
        beside = asyncio.ensure_future(self.write(BESIDE))
        await self.perform(step, timeout=5 * SLOT)
        del self.truth.blind[step.name]
        await beside


class Plain(Holder):
    """Holds nothing while it is blind."""


KINDS = {"own": Holder, "plain": Plain, "step": Performer, "dark": Dark, "sees": Seeing}
PRIORITIES = (10, 20)

Kind = tuple[str, int]
EACH: list[Kind] = list(itertools.product(KINDS, PRIORITIES))


def holder(kind: Kind, truth: Truth, place: int) -> Any:
    """Make one holder; what comes first by name is the one with the first place."""
    base, priority = KINDS[kind[0]], kind[1]
    holds = issubclass(base, Dark) or kind[0] == "own"
    blind: Literal["safe", "release"] = "safe" if holds else "release"
    port = esair.writes(float, name=truth.actuator, priority=priority, blind=blind)
    name = f"{'_abcd'[place]}_{truth.actuator}"
    fields = {"truth": truth, "place": place, "priority": priority, "wheels": port}
    made = type(kind[0].title(), (base,), fields)(name=name)
    if kind[0] in ("own", "dark"):
        truth.blind[name] = priority
    return made


async def attempt(histories: Sequence[Sequence[Kind]]) -> list[str]:
    """Let each history happen to an actuator of its own; return what was wrong."""
    loop = asyncio.get_running_loop()
    truths, actors = [], []
    wheels = [
        FakeActuator(f"w{number}", safe=0.0, command_timeout=TIMEOUT)
        for number, _ in enumerate(histories)
    ]
    for each, history in zip(wheels, histories, strict=True):
        truths.append(truth := Truth(each.name, loop.time()))
        actors += [holder(kind, truth, place) for place, kind in enumerate(history, 1)]
    dark: FakeSensor[float] = FakeSensor("dark", type=float, rate=100.0)
    dark.stall()
    sonar = FakeSensor("sonar", 1.0, type=float, rate=100.0)
    for truth in truths:
        truth.began = loop.time()
    async with esair.Robot(
        resources=[*wheels, sonar, dark], behaviors=actors, start_patience=2 * SLOT
    ):
        await truths[0].until(OVER)
    wrong = []
    for truth, device, history in zip(truths, wheels, histories, strict=True):
        for value, passes in truth.expected.items():
            moved, told = value in device.commands, truth.told.get(value)
            if not (moved == passes == bool(told)):
                wrong.append(f"{history}: {value}: expected {passes}, {told}, {moved=}")
        if device.commands[-1] != 0.0:
            wrong.append(f"{history}: ends on {device.commands[-1]}")
        assert truth.expected or {"dark", "sees"}.issuperset(dict(history))
    return wrong


def run(loop: str, histories: Sequence[Sequence[Kind]]) -> None:
    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        for begin in range(0, len(histories), 40):
            assert runner.run(attempt(histories[begin : begin + 40])) == []


@pytest.mark.parametrize("loop", LOOPS)
def test_no_pair_of_holders_lets_a_command_through(loop: str) -> None:
    """Whatever their kinds, priorities and the order of their names."""
    pairs = list(itertools.product(EACH, repeat=2))
    run(loop, pairs if loop == "virtual" else random.Random(1).sample(pairs, 20))


@pytest.mark.longer
def test_no_three_or_four_holders_let_a_command_through(
    request: pytest.FixtureRequest,
) -> None:
    """Neither own holds nor names make a difference among more of them."""
    dice, long = random.Random(2), request.config.getoption("--esair-long")
    triples = list(itertools.product(EACH, repeat=3))
    fours = list(itertools.product(EACH, repeat=4))
    run("virtual", triples if long else dice.sample(triples, 40))
    run("virtual", dice.sample(fours, 2_000 if long else 40))


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("name", ["a_captain", "z_captain"])
def test_the_name_of_a_behavior_decides_nothing(loop: str, name: str) -> None:
    """A behavior with a hold of its own cannot drive past a reaction that is blind."""
    answers: list[Any] = []

    class Captain(esair.Behavior):
        wheels = esair.writes(float, priority=10, blind="safe")

        async def setup(self) -> None:
            answers.append(await self.wheels.write(0.7))

        async def run(self) -> None:
            answers.append(await self.wheels.write(0.7))

    class Avoid(Dark):
        wheels = esair.writes(float, priority=10)

    async def main() -> list[float]:
        dark: FakeSensor[float] = FakeSensor("dark", type=float)
        dark.stall()
        wheels = FakeActuator("wheels", safe=0.0)
        behaviors: list[Any] = [Captain(name=name), Avoid()]
        async with esair.Robot(
            resources=[wheels, dark], behaviors=behaviors, start_patience=0.05
        ) as robot:
            await asyncio.sleep(0.1)
            await robot.behaviors.restart(name)
            await asyncio.sleep(0.1)
        return wheels.commands

    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        commands = runner.run(main())
    assert set(commands) == {0.0}
    assert [bool(each) for each in answers] == [False] * len(answers)
    assert len(answers) == 4


@attrs.frozen
class Twist:
    """A command with two parts."""

    linear: float
    angular: float


@pytest.mark.parametrize("loop", LOOPS)
def test_what_equals_safe_passes_and_holds_nothing(loop: str) -> None:
    """It is no motion: nobody is refused for it, nobody is kept away by it."""
    answers: list[Any] = []

    class Stop(esair.Behavior):
        wheels = esair.writes(Twist, priority=5)

        async def run(self) -> None:
            answers.append(await self.wheels.write(Twist(0.0, 0.0), hold=60.0))
            answers.append(self.wheels.why().holder)
            answers.append(await self.wheels.write(Twist(0.0, 0.1)))
            answers.append(await self.wheels.write(Twist(-0.0, 0.0)))

    class Avoid(Dark):
        wheels = esair.writes(Twist, priority=10)

    async def main() -> None:
        dark: FakeSensor[float] = FakeSensor("dark", type=float)
        dark.stall()
        wheels = FakeActuator("wheels", safe=Twist(0.0, 0.0), slew={"linear": 0.1})
        async with esair.Robot(
            resources=[wheels, dark], behaviors=[Stop(), Avoid()], start_patience=0.05
        ) as robot:
            await asyncio.sleep(0.2)
            told = len(wheels.commands)
            await asyncio.sleep(1.0)
            assert len(wheels.commands) == told  # no dead man, no hold takes it back
            await robot.behaviors.remove("avoid")
            assert robot.resources.why("wheels").holder is None
        assert set(wheels.commands) == {Twist(0.0, 0.0)}

    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        runner.run(main())
    assert [bool(each) for each in answers] == [True, True, False, True]
    assert answers[1] == "avoid"


@pytest.mark.virtual_clock
async def test_safe_is_a_motion_where_safe_is_a_place_to_go() -> None:
    """There a blind hold has the actuator stay, and lets nobody send it to safe."""
    answers: list[Any] = []

    class Home(esair.Behavior):
        arm = esair.writes(float, priority=5)

        async def run(self) -> None:
            answers.append(await self.arm.write(0.0))

    class Avoid(Dark):
        wheels = esair.writes(float, name="arm", priority=10)

    dark: FakeSensor[float] = FakeSensor("dark", type=float)
    dark.stall()
    arm = FakeActuator("arm", safe=0.0)
    arm.safe_moves = True
    async with esair.Robot(resources=[arm, dark], behaviors=[Home(), Avoid()]):
        await asyncio.sleep(1.5)
        assert [bool(each) for each in answers] == [False]
