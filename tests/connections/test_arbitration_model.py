"""Priority, hold and command timeout against a small model, under random schedules."""

from __future__ import annotations

import asyncio
from typing import Any

import attrs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import esair
from esair.testing import FakeActuator, VirtualLoop

TIMEOUT = 0.2
USERS = {"low": 0, "mid": 5, "top": 9}


@attrs.define
class Model:
    """Who holds the actuator, and what its device was told, in thirty lines."""

    told: list[float] = attrs.Factory(lambda: [0.0])
    holder: str | None = None
    until: float = 0.0
    dead_man: float | None = None

    def pass_time(self, now: float) -> None:
        if self.dead_man is not None and now >= self.dead_man:
            self.told.append(0.0)
            if self.dead_man >= self.until:
                self.holder = None
            self.dead_man = None

    def write(
        self, now: float, user: str, value: float, hold: float | None
    ) -> str | None:
        """Return who refuses it; None if it is sent."""
        held = self.holder is not None and now < self.until
        if held and self.holder != user and USERS[user] <= USERS[str(self.holder)]:
            return self.holder
        self.told.append(value)
        self.holder, self.until = user, now + (hold or TIMEOUT)
        self.dead_man = now + TIMEOUT
        return None

    def release(self, user: str) -> None:
        if self.holder == user:
            self.holder = None


moves = st.one_of(
    st.tuples(
        st.just("write"),
        st.sampled_from(list(USERS)),
        st.integers(1, 99).map(float),
        st.sampled_from([None, 0.053, 0.5]),
    ),
    st.tuples(st.just("release"), st.sampled_from(list(USERS))),
    # No time is a multiple of another: in real time deadlines do not tie.
    st.tuples(
        st.just("wait"), st.sampled_from([0.0071, 0.0511, 0.1037, 0.2113, 0.7019])
    ),
)


@pytest.mark.promise("AC-2", "AC-1")
@pytest.mark.fault("R03", "R13", "T04")
@settings(max_examples=60, deadline=None)
@given(moves=st.lists(moves, max_size=25), seed=st.integers(1, 2**16))
def test_the_channel_decides_as_the_model(moves: list[Any], seed: int) -> None:
    """The same writes pass, the same are refused by the same holder, safe comes when due."""
    model = Model()
    wheels = FakeActuator("wheels", safe=0.0, command_timeout=TIMEOUT)
    users = {
        name: esair.Behavior(
            name=name, writes={"wheels": esair.writes(float, priority=priority)}
        )
        for name, priority in USERS.items()
    }

    async def play() -> None:
        loop = asyncio.get_running_loop()
        async with esair.Robot(resources=[wheels], behaviors=users.values()):
            for kind, *terms in moves:
                model.pass_time(loop.time())
                if kind == "wait":
                    await asyncio.sleep(terms[0])
                    model.pass_time(loop.time())
                elif kind == "release":
                    users[terms[0]].wheels.release()
                    model.release(terms[0])
                else:
                    name, value, hold = terms
                    outcome = await users[name].wheels.write(value, hold=hold)
                    refused_by = model.write(loop.time(), name, value, hold)
                    assert getattr(outcome, "holder", None) == refused_by
                assert wheels.commands == model.told
        assert wheels.commands[-1] == 0.0

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=seed)) as runner:
        runner.run(play())


@pytest.mark.promise("AC-2", "AC-4")
@pytest.mark.fault("R04", "R05", "R09")
@settings(max_examples=40, deadline=None)
@given(
    delays=st.lists(st.sampled_from([0.0, 0.011, 0.047, 0.31]), min_size=1, max_size=5),
    removed_at=st.sampled_from([0.013, 0.103, 0.291]),
    seed=st.integers(1, 2**16),
)
def test_slow_drivers_and_many_writers(
    delays: list[float], removed_at: float, seed: int
) -> None:
    """Commands never overlap in the driver, a removed writer writes no more, safe is last."""
    running, commands = [0], []

    class Slow(esair.Actuator[float]):
        safe = 0.0
        overlaps = 0

        async def write(self, command: float) -> None:
            running[0] += 1
            commands.append((asyncio.get_running_loop().time(), command))
            self.overlaps += running[0] > 1 and command != 0.0
            try:
                await asyncio.sleep(delays[len(commands) % len(delays)])
            finally:
                running[0] -= 1

    class Writer(esair.Behavior):
        def __init__(self, number: int) -> None:
            super().__init__(
                name=f"writer_{number}",
                writes={"slow": esair.writes(float, priority=number)},
            )
            self.number = number

        async def run(self) -> None:
            while True:
                await self.slow.write(float(self.number))  # type: ignore[attr-defined]
                await asyncio.sleep(0.017 * self.number)

    slow = Slow()
    ended = 0.0

    async def play() -> None:
        nonlocal ended
        async with esair.Robot(
            resources=[slow], behaviors=[Writer(n) for n in (1, 2, 3)]
        ) as robot:
            await asyncio.sleep(removed_at)
            await robot.behaviors.remove("writer_3")
            ended = asyncio.get_running_loop().time()
            await asyncio.sleep(0.3)

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=seed)) as runner:
        runner.run(play())

    assert slow.overlaps == 0
    assert commands[-1][1] == 0.0
    assert all(time <= ended for time, command in commands if command == 3.0)
