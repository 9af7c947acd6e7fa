"""What events cost a step: those pay who listen, by kind."""

from __future__ import annotations

import asyncio
import collections
import sys
from collections.abc import Iterable
from types import FrameType

import pytest
from benchmarks.cases.components import reacting_robot
from benchmarks.counts import Count, counted

from esair.journal import Event, Kind
from esair.testing import VirtualLoop

REACTIONS = 20


def writing_step(kinds: Iterable[Kind] | None, *, plain: bool) -> tuple[Count, int]:
    """Count a step that reads and writes; returns how many events were heard, too."""
    kept: collections.deque[Event] = collections.deque()

    async def main() -> Count:
        robot = reacting_robot(REACTIONS, acting=1, plain=plain)
        if kinds is not None:
            listener = robot.journal.listen(kept.append, kinds=kinds)
            listener.is_waited_for = (
                True  # else it hears less in a turn that takes long
            )
        async with robot:
            await asyncio.sleep(1.0005)
            kept.clear()
            return await counted(lambda: asyncio.sleep(0.1), 10 * REACTIONS)

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        count = runner.run(main())
    return count, len(kept)


@pytest.mark.parametrize("plain", [False, True])
def test_events_cost_those_who_listen(*, plain: bool) -> None:
    """In byte codes: at most half as much again for all kinds, nothing for another one."""
    nobody, _ = writing_step(None, plain=plain)
    everything, heard = writing_step(Kind, plain=plain)
    another, none = writing_step([Kind.LOG], plain=plain)
    assert heard >= 3 * 10 * REACTIONS  # a command, sent, applied; readings
    assert none == 0
    assert everything.codes <= 1.5 * nobody.codes
    assert another.codes <= 1.05 * nobody.codes


def test_who_has_traced_before_traces_on() -> None:
    """Counting is no end of what measures which lines are tested."""
    seen: list[str] = []

    def look(frame: FrameType, _event: str, _argument: object) -> None:
        seen.append(frame.f_code.co_name)

    def another() -> None:
        """It is called when all is counted."""

    before = sys.gettrace()
    sys.settrace(look)
    try:
        count = asyncio.run(counted(lambda: asyncio.sleep(0), 1))
        another()
    finally:
        sys.settrace(before)
    assert count.calls > 0
    assert seen[-1] == "another"
