"""What was held before its steps: they decide on what is known now, not when it began."""

from __future__ import annotations

import asyncio
import pickle
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import esair
from esair.journal import Kind
from esair.loop import Player, TapeWriter, TurnLoop
from esair.testing import FakeActuator

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("SC-3", "TURN-4")]


class Clock(esair.Sensor[float]):
    """Says when it has measured."""

    rate = 50.0

    def read(self) -> float:
        time.sleep(0.002)
        return time.monotonic()


class PushedClock(esair.Sensor[float]):
    """The same, pushed from a thread."""

    period = 0.15

    def stream(self) -> Iterator[float]:
        while True:
            time.sleep(0.005)
            yield time.monotonic()


class Copied(esair.Derived[float]):
    """What the clock says, computed."""

    clock = esair.reads(float)

    def compute(self, clock: float) -> float:
        return clock


class Decides(esair.Reaction):
    """Keeps how old the time was that it decided on."""

    clock = esair.reads(float, max_age=0.15)
    wheel = esair.writes(float)

    def __init__(self, **ports: Any) -> None:
        super().__init__(**ports)
        self.ages: list[float] = []

    def react(self, clock: float) -> float:
        self.ages.append(time.monotonic() - clock)
        return 1.0 + len(self.ages)


class DecidesOnBoth(esair.Reaction):
    """Keeps by how much what is computed lags behind its source."""

    clock = esair.reads(float, max_age=0.15)
    copied = esair.reads(float)

    def __init__(self) -> None:
        super().__init__()
        self.lags: list[float] = []

    def react(self, clock: float, copied: float) -> None:
        self.lags.append(clock - copied)


class Holds(esair.Behavior):
    """Wakes with each reading, and computes without an await."""

    clock = esair.reads(float)
    computes: Callable[[float], object] = staticmethod(time.sleep)

    async def run(self) -> None:
        async for _ in self.clock:
            self.computes(0.3)
            await asyncio.sleep(0.4)  # it counts from when the turn began


def run_on(
    loop: TurnLoop, resources: list[Any], behaviors: list[Any], tape: list[Any] | None
) -> list[Any]:
    """Run a robot for a second, or repeat that; tells what it decided and was told."""
    events: list[Any] = []

    async def main() -> None:
        robot = esair.Robot(resources=resources, behaviors=behaviors)
        robot.journal.listen(events.append)
        if loop.player is not None:
            loop.play()
        elif tape is not None:
            loop.keep(TapeWriter(tape.append))
        async with robot:
            await asyncio.sleep(1.0)
        loop.keep(None)

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(main())
    return [
        (each.kind, each.component, each.value)
        for each in events
        if each.kind in {Kind.SENT, Kind.SAFE, Kind.APPLIED}
    ]


def wheel() -> FakeActuator[float]:
    return FakeActuator("wheel", safe=0.0, command_timeout=5.0)


@pytest.mark.parametrize("kind", [Clock, PushedClock])
def test_no_step_decides_on_what_got_too_old_in_its_turn(kind: type[Any]) -> None:
    """Whoever held the loop after the border and before the step."""
    decides = Decides()
    run_on(TurnLoop(), [kind(name="clock"), wheel()], [decides, Holds()], None)
    assert decides.ages
    assert max(decides.ages) < 0.2


def test_what_is_computed_is_of_what_came_while_the_turn_was_held() -> None:
    """The border that comes between asks for computations, and they come first."""
    both, holds = DecidesOnBoth(), Holds()
    sources = [PushedClock(name="clock"), Copied(name="copied")]
    run_on(TurnLoop(), sources, [both, holds], None)
    assert len(both.lags) > 20
    assert set(both.lags) == {0.0}


def test_a_step_that_gave_way_does_so_again_in_a_replay() -> None:
    """There nothing holds the loop, and all the same is decided in the same turns."""

    def play(loop: TurnLoop) -> list[Any]:
        holds = Holds()
        if loop.player is not None:
            holds.computes = float  # type: ignore[method-assign]
        parts = [PushedClock(name="clock"), wheel()]
        return run_on(loop, parts, [Decides(), holds], tape)

    tape: list[Any] = []
    live = play(TurnLoop())
    tape = pickle.loads(pickle.dumps(tape))

    assert sum(each[0] == ("turn", "gave way") for each in tape if type(each) is tuple)
    assert play(TurnLoop(player=Player(tape))) == live
