"""Steps that take too long: counted, logged, and in the end an error."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, VirtualLoop

pytestmark = pytest.mark.virtual_clock


class Slow(esair.Reaction):
    """Takes as long for each step as a test says."""

    wheels = esair.writes(float)
    rate = 10.0
    budget = 0.02
    restart = esair.Restart(max=1, within=30.0)

    def __init__(self, *takes: float) -> None:
        super().__init__()
        self.takes = list(takes)

    def react(self) -> float:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        if self.takes:
            loop.advance(self.takes.pop(0))
        return 1.0


@pytest.mark.fault("B09")
async def test_a_slow_step_is_counted_and_logged_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It goes on; only steps over the budget count."""
    slow, wheels = Slow(0.01, 0.03, 0.02, 0.05, 0.05), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[slow]) as robot:
        await asyncio.sleep(2.0)
        status = robot.behaviors.query("slow")

    assert (status.state, status.overruns) == (esair.BehaviorState.RUNNING, 3)
    lines = [r.getMessage() for r in caplog.records if "overrun" in r.getMessage()]
    assert lines == ["slow: overrun 1: step took 0.03 s, its budget is 0.02 s"]


@pytest.mark.fault("B09")
@pytest.mark.parametrize(
    ("takes", "restarts"),
    [((0.03, 0.03, 0.01, 0.03, 0.03), 0), ((0.03, 0.03, 0.03), 1)],
)
async def test_too_many_slow_steps_in_a_row_are_an_error(
    takes: tuple[float, ...], restarts: int
) -> None:
    """Its actuator is made safe, and its restart policy applies."""
    slow, wheels = Slow(*takes), FakeActuator("wheels", safe=0.0)
    slow.overrun_limit = 2
    async with esair.Robot(resources=[wheels], behaviors=[slow]) as robot:
        await asyncio.sleep(2.0)
        status = robot.behaviors.query("slow")

    assert status.restarts == restarts
    assert status.state is esair.BehaviorState.RUNNING
    assert wheels.commands.count(0.0) == 3 + restarts
    if restarts:
        assert isinstance(status.error, esair.BehaviorFailedError)
        assert "overrun 3 in a row" in str(status.error)


@pytest.mark.fault("B09")
async def test_a_reaction_that_is_always_slow_fails_for_good() -> None:
    """Everything else keeps running."""
    slow, wheels = Slow(*[0.03] * 100), FakeActuator("wheels", safe=0.0)
    slow.overrun_limit = 0
    idle = esair.Behavior(name="idle")
    async with esair.Robot(resources=[wheels], behaviors=[slow, idle]) as robot:
        await asyncio.sleep(2.0)

        assert robot.behaviors.query("slow").state is esair.BehaviorState.FAILED
        assert robot.behaviors.query("idle").state is esair.BehaviorState.RUNNING
        assert wheels.commands[-1] == 0.0


@pytest.mark.fault("B09")
@pytest.mark.parametrize("field", ["budget", "overrun_limit"])
@pytest.mark.parametrize("value", [-1, float("nan"), "1", True])
async def test_a_budget_is_a_number(field: str, value: Any) -> None:
    """Anything else is a mistake of the developer."""
    slow, wheels = Slow(), FakeActuator("wheels", safe=0.0)
    setattr(slow, field, value)

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(resources=[wheels], behaviors=[slow]):
            pytest.fail("it started")

    assert caught.group_contains(esair.ConfigError, match=field)


@pytest.mark.fault("B21")
@pytest.mark.real_clock
async def test_debug_mode_names_who_blocks_the_loop(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A behavior by the name of its task, a reaction by its own."""

    class Sleeper(esair.Behavior):
        async def run(self) -> None:
            time.sleep(0.15)  # noqa: ASYNC251 - the mistake that is looked for

    class Napper(esair.Reaction):
        rate = 20.0  # it takes three periods: nobody else may starve

        def react(self) -> None:
            time.sleep(0.15)

    loop = asyncio.get_running_loop()
    debug = loop.get_debug()
    loop.set_debug(True)
    caplog.set_level(logging.WARNING)
    try:
        async with esair.Robot(behaviors=[Sleeper(), Napper()]) as robot:
            async with asyncio.timeout(20.0):
                while not robot.behaviors.query("napper").overruns:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
    finally:
        loop.set_debug(debug)

    said = [record.getMessage() for record in caplog.records]
    assert any("name='sleeper'" in line and "took" in line for line in said)
    assert any(line.startswith("napper: overrun 1: step took") for line in said)
