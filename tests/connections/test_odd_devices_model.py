"""Arbitration, deadlines and safe commands on odd devices, under random schedules."""

from __future__ import annotations

import asyncio
from typing import Any

import attrs
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import esair
from esair.testing import FakeActuator, VirtualLoop

TIMEOUT, DEADLINE = 0.2, 0.15
TURN = min(TIMEOUT, DEADLINE)
"""How long the safe command waits for a motion in flight."""
UNWIND = 0.1
"""How long an abandoned call may take to end before its device is opened again."""
USERS = {"low": 0, "mid": 5, "top": 9}
EARLY = 1e-6


@attrs.define
class Told:
    """One call of the device."""

    command: float
    began: float
    opening: int
    beside: list[Told]
    """Those that have not ended when it begins, of the same opening."""
    ended: float | None = None


class Odd(FakeActuator[float]):
    """Notes when each call begins and ends; ``commands`` has them as they land."""

    deadline = DEADLINE

    def __init__(self) -> None:
        super().__init__("odd", safe=0.0, command_timeout=TIMEOUT)
        self.told: list[Told] = []

    async def write(self, command: float) -> None:
        beside = [
            each
            for each in self.told
            if each.ended is None and each.opening == self.opened
        ]
        told = Told(command, now(), self.opened, beside)
        self.told.append(told)
        try:
            await super().write(command)
        finally:
            told.ended = now()


@attrs.define
class Write:
    """A write of a user, and what came of it."""

    user: str
    hold: float
    asked: float
    answer: Any = None
    answered: float = 0.0


def now() -> float:
    return asyncio.get_running_loop().time()


seconds = st.sampled_from([0.0, 0.0, 0.0071, 0.0511, 0.1037, 0.2113, 0.4019])
writes = st.tuples(seconds, st.sampled_from([None, 0.053, 0.5]))
odd = st.one_of(
    # late; applied at once and acknowledged later; after the deadline
    st.tuples(st.just("slow"), seconds, seconds),
    st.tuples(st.just("swallow"), st.integers(1, 3)),
    st.tuples(st.just("stall")),
    st.tuples(st.just("resume")),
    st.tuples(st.just("fail"), st.sampled_from([OSError, ConnectionError, KeyError])),
    st.tuples(st.just("release"), st.sampled_from(list(USERS))),
)


@pytest.mark.long
@pytest.mark.promise("AC-2", "AC-4", "CALL-1", "CALL-2", "CALL-3")
@pytest.mark.fault("D20", "D21", "D22", "D23", "D25", "R04", "R05")
@settings(max_examples=60, deadline=None)
@given(
    plans=st.fixed_dictionaries({user: st.lists(writes, max_size=8) for user in USERS}),
    oddities=st.lists(st.tuples(seconds, odd), max_size=10),
    at_the_end=st.booleans(),
    seed=st.integers(1, 2**16),
)
def test_odd_devices(
    plans: dict[str, list[Any]], oddities: list[Any], at_the_end: bool, seed: int
) -> None:
    """What is refused never leaves, one call at a time, answers in time, safe last."""
    device = Odd()
    users: dict[str, Any] = {
        name: esair.Behavior(
            name=name, writes={"odd": esair.writes(float, priority=priority)}
        )
        for name, priority in USERS.items()
    }
    asked: dict[float, Write] = {}
    released: list[tuple[str, float]] = []

    async def use(user: str, plan: list[tuple[float, float | None]]) -> None:
        for wait, hold in plan:
            await asyncio.sleep(wait)
            write = Write(user, hold or TIMEOUT, now())
            command = float(len(asked) + 1)
            asked[command] = write
            try:
                write.answer = await users[user].odd.write(command, hold=hold)
            except esair.EsairError as error:
                write.answer = error
            write.answered = now()

    async def be_odd() -> None:
        for wait, (kind, *terms) in oddities:
            await asyncio.sleep(wait)
            match kind:
                case "slow":
                    device.slow(terms[0], acknowledge=terms[1])
                case "fail":
                    device.fail(terms[0]("odd"))
                case "release":
                    users[terms[0]].odd.release()
                    released.append((terms[0], now()))
                case _:
                    getattr(device, kind)(*terms)

    async def play() -> Any:
        async with esair.Robot(resources=[device], behaviors=users.values()) as robot:
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(be_odd())
                for user, plan in plans.items():
                    tasks.create_task(use(user, plan))
            if not at_the_end:
                device.resume()
                device.slow(0.0)
                await asyncio.sleep(10.0)
                assert device.commands[-1] == 0.0
        stopped = list(robot.stopped)
        device.resume()
        await asyncio.sleep(2.0)  # what was abandoned ends
        return stopped

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=seed)) as runner:
        (last,) = runner.run(play())

    sent = [each.command for each in device.told if each.command != 0.0]
    assert len(sent) == len(set(sent))  # nothing is sent twice
    for command, write in asked.items():
        assert write.answered - write.asked < 10 * DEADLINE
        if isinstance(write.answer, esair.Refused):
            assert command not in sent
        if isinstance(write.answer, esair.Written):
            assert device.commands.count(command) == 1
    for told in device.told:
        if told.command != 0.0:
            assert told.beside == []
        for motion in told.beside:  # the safe command has waited its turn
            assert motion.command == 0.0 or told.began - motion.began > TURN - EARLY
    check_priorities(device, asked, released)
    check_dead_man(device)
    if last.answered:
        assert device.commands[-1] == 0.0


def check_priorities(
    device: Odd, asked: dict[float, Write], released: list[tuple[str, float]]
) -> None:
    """Nobody sends while somebody else with a higher priority holds the device."""
    for before, after in zip(device.told, device.told[1:], strict=False):
        if 0.0 in (before.command, after.command) or before.opening != after.opening:
            continue
        first, second = asked[before.command], asked[after.command]
        gave_back = any(
            user == first.user and before.began <= time <= after.began
            for user, time in released
        )
        if after.began < before.began + first.hold - EARLY and not gave_back:
            assert USERS[second.user] >= USERS[first.user]


def check_dead_man(device: Odd) -> None:
    """A motion that ends in time is followed by another, or by the safe command."""
    for n, told in enumerate(device.told):
        if told.command == 0.0 or told.ended is None:
            continue
        if told.ended - told.began <= DEADLINE:
            assert device.told[n + 1 :]
            assert device.told[n + 1].began - told.ended < TIMEOUT + TURN + EARLY
