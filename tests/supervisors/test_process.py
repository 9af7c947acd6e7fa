"""What belongs to the whole process is nobody's to change: whoever does is named."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import esair

pytestmark = pytest.mark.real_clock


class Meddler(esair.Behavior):
    """Does in its setup what a test says."""

    def __init__(self, what: Callable[[], object], *, late: bool = False) -> None:
        super().__init__(name="meddler")
        self.what = what
        self.late = late

    async def setup(self) -> None:
        if not self.late:
            self.what()

    async def run(self) -> None:
        if self.late:
            self.what()
        await asyncio.Event().wait()


@pytest.fixture(autouse=True)
def put_back() -> Iterator[None]:
    """Leave the handlers and the policy as they were."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    policy = asyncio.get_event_loop_policy()
    yield
    asyncio.set_event_loop_policy(policy)
    for number, handler in before.items():
        signal.signal(number, handler)


class Policy(asyncio.DefaultEventLoopPolicy):
    """A policy of somebody's own."""


MEDDLING = [
    (lambda: signal.signal(signal.SIGTERM, signal.SIG_IGN), "the handler of SIGTERM"),
    (
        lambda: asyncio.get_running_loop().add_signal_handler(
            signal.SIGHUP, lambda: None
        ),
        "the handler of SIGHUP",
    ),
    (lambda: asyncio.set_event_loop_policy(Policy()), "the event loop policy"),
    (
        lambda: asyncio.get_running_loop().set_task_factory(None),
        "the task factory of the event loop",
    ),
]


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    said = [record.getMessage() for record in caplog.records]
    return [line for line in said if "the whole process" in line]


@pytest.mark.fault("B22")
@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(("what", "named"), MEDDLING)
async def test_who_changes_the_process_is_named_when_it_is_added(
    what: Callable[[], object],
    named: str,
    late: bool,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """In its setup, or in the first step of its run."""
    async with esair.Robot() as robot:
        await robot.behaviors.add(esair.Behavior(name="good"))
        assert warnings(caplog) == []
        await robot.behaviors.add(Meddler(what, late=late))
        await robot.behaviors.add(esair.Behavior(name="better"))
    (line,) = warnings(caplog)
    assert line.startswith(f"meddler: changed {named},")


@pytest.mark.fault("B22")
async def test_who_changes_the_process_at_the_start_is_among_those_named(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """All setups run at the same time there, so all are named."""
    meddler: Any = Meddler(MEDDLING[0][0])
    async with esair.Robot(behaviors=[esair.Behavior(name="good"), meddler]):
        pass
    (line,) = warnings(caplog)
    assert line.startswith("good or meddler: changed the handler of SIGTERM,")
