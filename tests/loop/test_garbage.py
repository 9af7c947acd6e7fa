"""The collector works in the gaps, and takes little of them."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator

import pytest

from esair.loop import _garbage
from esair.loop._garbage import Collector

pytestmark = pytest.mark.real_clock


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    """One for which each collection is a long one."""
    monkeypatch.setattr(_garbage, "LONG", 0.0)
    collector = Collector()
    collector.start()
    yield collector
    collector.stop()


@pytest.mark.promise("ROB-7")
def test_what_is_set_aside_is_not_even_counted(collector: Collector) -> None:
    """A collection takes less than it would take to count what it need not look at."""
    held = [[number] for number in range(300_000)]
    gc.freeze()
    collected = min(cost(collector.collect) for _ in range(5))
    counted = min(cost(gc.get_freeze_count) for _ in range(5))
    assert collected < counted
    assert len(held) == 300_000


@pytest.mark.promise("ROB-7")
def test_all_is_looked_at_when_there_is_twice_as_much(
    collector: Collector, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What became garbage after it was set aside is collected in the end."""
    monkeypatch.setattr(_garbage, "FEW", 1_000)
    circle: list[object] = []
    circle.append(circle)
    held = [[number] for number in range(3_000)]
    collector.collect()
    del circle
    before = collector.collected
    collector.collect()
    assert collector.collected > before
    assert len(held) == 3_000


def cost(function: Callable[[], object]) -> float:
    """Return what a call takes of this thread, in seconds."""
    began = time.thread_time()
    function()
    return time.thread_time() - began
