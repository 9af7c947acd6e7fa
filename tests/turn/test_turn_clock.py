"""The clock of esair.run stands still in a turn; what is measured beside it does not."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

import esair
from esair.journal import Kind
from esair.loop import Player, TapeWriter, TurnLoop
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.real_clock


class Dawdles(esair.Reaction):
    """Takes longer than it may."""

    budget = 0.002
    sonar = esair.reads(float)
    wheel = esair.writes(float)

    def react(self, sonar: float) -> float:
        time.sleep(0.004)
        return sonar


@pytest.mark.promise("TURN-4")
def test_a_step_over_its_budget_is_counted() -> None:
    """Though the clock of the turn says that it took no time."""

    async def main() -> int:
        sonar, wheel = FakeSensor("sonar", 1.0, rate=20.0), FakeActuator("wheel", 0.0)
        async with esair.Robot(
            resources=[sonar, wheel], behaviors=[Dawdles()]
        ) as robot:
            await wheel.until(1.0)
            return robot.journal.counts()["dawdles"]["overruns"]

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        assert runner.run(main()) >= 1


class Blocks(esair.Sensor[float]):
    """Says by its own clock how long it has waited in its thread."""

    rate = 10.0

    def read(self) -> float:  # type: ignore[override]
        before = esair.now()
        time.sleep(0.03)
        return esair.now() - before


class Times(esair.Behavior):
    """Writes what the clock says, from a thread."""

    wheel: Any = esair.writes(float)

    def run(self) -> None:  # type: ignore[override]
        for _ in range(3):
            self.wheel.write(esair.now())
            threading.Event().wait(0.01)


def play(loop: TurnLoop, tape: list[Any]) -> list[float]:
    """Run it, or repeat it; return what was sent."""
    sent: list[float] = []

    async def main() -> None:
        wheel = FakeActuator("wheel", 0.0)
        robot = esair.Robot(resources=[wheel], behaviors=[Times()])
        robot.journal.listen(lambda event: sent.append(event.value), kinds=[Kind.SENT])
        if loop.player is None:
            loop.keep(TapeWriter(tape.append))
        else:
            loop.play()
        async with robot:
            await robot.ended()
        loop.keep(None)

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(main())
    return sent


@pytest.mark.promise("BEH-5")
def test_now_in_a_thread_of_the_robot_is_repeated() -> None:
    """It comes by the door: the same in a replay as in the run."""
    tape: list[Any] = []
    live = play(TurnLoop(), tape)

    assert len(set(live)) == 3
    assert play(TurnLoop(player=Player(tape)), tape) == live


@pytest.mark.promise("BEH-5")
def test_now_in_a_drivers_thread_goes_on() -> None:
    """While the loop sleeps, too."""

    async def main() -> float:
        waited: list[float] = []

        class Looks(esair.Behavior):
            blocks = esair.reads(float)

            async def run(self) -> None:
                waited.append(await self.blocks.read())

        async with esair.Robot(resources=[Blocks()], behaviors=[Looks()]) as robot:
            await robot.ended()
        return waited[0]

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        assert runner.run(main()) >= 0.03
