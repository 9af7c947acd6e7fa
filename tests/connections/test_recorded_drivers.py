"""A run of plain drivers is repeated from its tape: what they gave, and their errors."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import Any

import pytest

import esair
from esair.journal import Kind
from esair.loop import Player, TapeWriter, TurnLoop

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("REP-2", "RES-1")]

REPEATED = {Kind.READING, Kind.SENT, Kind.SAFE, Kind.UNANSWERED}


class Counter(esair.Sensor[float]):
    """Each third reading fails."""

    blocking = False
    rate = 50.0
    number = 0

    def read(self) -> float:
        self.number += 1
        if self.number % 3 == 0:
            raise OSError("no acknowledge")
        return float(self.number)


class Pin(esair.Actuator[float]):
    """A plain method, one of whose commands has to be awaited."""

    blocking = False
    safe = 0.0

    def write(self, command: float) -> Awaitable[None] | None:  # type: ignore[override]
        return asyncio.sleep(0.001) if command == 2.0 else None


class Follow(esair.Reaction):
    counter = esair.reads(float)
    pin = esair.writes(float)

    def react(self, counter: float) -> float:
        return counter


def run(loop: TurnLoop, tape: list[Any]) -> list[Any]:
    """Run the robot, or repeat its run; return what its devices said and were told."""
    events: list[Any] = []

    async def main() -> None:
        robot = esair.Robot(resources=[Counter(), Pin()], behaviors=[Follow()])
        robot.journal.listen(events.append)
        if loop.player is None:
            loop.keep(TapeWriter(tape.append))
        else:
            loop.play()
        async with robot:
            await asyncio.sleep(0.3)
        loop.keep(None)

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(main())
    return [
        (event.kind, event.component, getattr(event.value, "value", event.value))
        for event in events
        if event.kind in REPEATED
    ]


def test_what_plain_drivers_do_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the command, without a call of a driver."""
    tape: list[Any] = []
    live = run(TurnLoop(), tape)
    assert (Kind.SENT, "pin", 2.0) in live
    assert len(live) > 10

    def never(*_: object) -> Any:
        raise AssertionError("a driver was called")

    monkeypatch.setattr(Counter, "read", never)
    monkeypatch.setattr(Pin, "write", never)
    assert run(TurnLoop(player=Player(tape)), tape) == live


def test_who_asks_gets_the_error_of_the_driver_while_it_is_recorded() -> None:
    """And the same when it is repeated."""
    told: list[str] = []

    class Broken(esair.Sensor[float]):
        blocking = False
        rate = 1.0

        def read(self) -> float:
            raise ValueError("no acknowledge")

    async def main() -> None:
        user: Any = esair.Behavior(name="user", reads={"broken": esair.reads(float)})
        loop: Any = asyncio.get_running_loop()
        tape: list[Any] = []
        loop.keep(TapeWriter(tape.append))
        async with esair.Robot(resources=[Broken()], behaviors=[user]):
            with pytest.raises(esair.DeviceFaultError) as raised:
                await user.broken.read()
            told.append(str(raised.value))
        loop.keep(None)

    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(main())
    assert "ValueError: no acknowledge" in told[0]
