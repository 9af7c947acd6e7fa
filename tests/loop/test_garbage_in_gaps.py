"""When garbage is collected, and how much: on a model of the interpreter's collector."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Literal

import pytest

from esair.loop import Scheduler, _garbage
from esair.loop._garbage import Collector, Gaps

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("ROB-7")]

ROUND = 701 * 12
"""How many objects come between two counts of the old ones, with Python's thresholds."""

Fate = Literal["kept", "dies young", "dies old"]


class Interpreter:
    """Stands for ``gc``, ``sys`` and ``time``: it counts, and a look at an object takes.

    As in Python up to 3.12: what was frozen is not looked at, and a full collection that
    nobody asks for waits for a quarter of what was there.
    """

    def __init__(self) -> None:
        self.seconds = 2e-7  # that a look at one object takes
        self.blocks = 1_000_000
        self.enabled = True
        self.callbacks: list[Callable[[str, dict[str, int]], None]] = []
        self.looked_at: list[int] = []  # at how many objects, by each full collection
        self.pile = 0  # how many objects were garbage at most
        self._cpu = 0.0
        self._threshold = (700, 10, 10)
        self._count = [0, 0, 0]
        self._alive: list[dict[str, int]] = [{}, {}, {}]
        self._frozen: dict[str, int] = {}
        self._stats = [{"collected": 0, "collections": 0} for _ in range(3)]
        self._total = self._pending = 0

    def come(self, number: int, fate: Fate = "dies old") -> None:
        """So many objects come."""
        while number > 0:
            some = min(number, self._threshold[0] + 1 - self._count[0])
            self._count[0] += some
            self._add(self._alive[0], fate, some)
            number -= some
            garbage = sum(each.get("dies old", 0) for each in self._alive)
            self.pile = max(self.pile, garbage)
            if self._count[0] > self._threshold[0]:
                full = self._count[2] > self._threshold[2]
                if full and self._pending >= self._total / 4:
                    self.collect(2)
                else:
                    self.collect(int(self._count[1] > self._threshold[1]))

    @property
    def alive(self) -> int:
        """How many objects there are that can be looked at."""
        return sum(sum(each.values()) for each in self._alive)

    def collect(self, generation: int = 2) -> int:
        info = {"generation": generation, "collected": 0, "uncollectable": 0}
        self._tell("start", info)
        self._count[: generation + 1] = [0] * (generation + 1)
        seen: dict[str, int] = {}
        for each in self._alive[: generation + 1]:
            for fate, number in each.items():
                self._add(seen, fate, number)
            each.clear()
        self._cpu += sum(seen.values()) * self.seconds
        if generation == 2:
            self.looked_at.append(sum(seen.values()))
            info["collected"] = seen.pop("dies old", 0)
        else:
            self._count[generation + 1] += 1
        info["collected"] += seen.pop("dies young", 0)
        for fate, number in seen.items():
            self._add(self._alive[min(generation + 1, 2)], fate, number)
        left = sum(seen.values())
        if generation == 2:
            self._total, self._pending = left, 0
        elif generation == 1:
            self._pending += left
        self._stats[generation]["collected"] += info["collected"]
        self._stats[generation]["collections"] += 1
        self._tell("stop", info)
        return info["collected"]

    def freeze(self) -> None:
        for each in self._alive:
            for fate, number in each.items():
                self._add(self._frozen, fate, number)
            each.clear()
        self._count = [0, 0, 0]

    def unfreeze(self) -> None:
        for fate, number in self._frozen.items():
            self._add(self._alive[2], fate, number)
        self._frozen.clear()

    def get_threshold(self) -> tuple[int, ...]:
        return self._threshold

    def set_threshold(self, young: int, middle: int, old: int) -> None:
        self._threshold = (young, middle, old)

    def get_count(self) -> tuple[int, ...]:
        return tuple(self._count)

    def get_stats(self) -> list[dict[str, int]]:
        return self._stats

    def isenabled(self) -> bool:
        return self.enabled

    def getallocatedblocks(self) -> int:
        return self.blocks

    def thread_time(self) -> float:
        return self._cpu

    def _add(self, to: dict[str, int], fate: str, number: int) -> None:
        to[fate] = to.get(fate, 0) + number

    def _tell(self, phase: str, info: dict[str, int]) -> None:
        for each in tuple(self.callbacks):
            each(phase, info)


@pytest.fixture
def python(monkeypatch: pytest.MonkeyPatch) -> Interpreter:
    python = Interpreter()
    for module in ("gc", "sys", "time"):
        monkeypatch.setattr(_garbage, module, python)
    return python


@pytest.fixture
def collector(python: Interpreter, monkeypatch: pytest.MonkeyPatch) -> Collector:
    """One of a robot that is up."""
    collector = Collector()
    monkeypatch.setattr(_garbage, "collector", collector)
    collector.start()
    collector.is_up()
    python.looked_at.clear()
    return collector


# Where no gap comes: the interpreter is told when.


def test_what_comes_is_at_most_what_one_pause_can_collect(
    python: Interpreter, collector: Collector
) -> None:
    """20 ms, and not much less: each pause costs as much as it is long."""
    python.come(400_000)
    assert all(abs(each - 100_000) <= ROUND / 2 + 701 for each in python.looked_at)
    counts = collector.counts()
    assert counts["collections"] == counts["forced"] == len(python.looked_at) == 3
    assert counts["collected"] == sum(python.looked_at)
    assert counts["longest_forced_us"] == round(max(python.looked_at) * 0.2)
    assert counts["longest_us"] == 0


@pytest.mark.parametrize(("microseconds", "most"), [(1.0, 20_000), (0.4, 50_000)])
def test_what_an_object_takes_is_learned(
    python: Interpreter, collector: Collector, microseconds: float, most: int
) -> None:
    """On a slow computer, or of large ones, fewer are let come, after one pause."""
    python.seconds = microseconds * 1e-6
    python.come(400_000)
    assert collector.longest_forced == pytest.approx(
        python.looked_at[0] * python.seconds
    )
    assert all(abs(each - most) <= ROUND / 2 + 701 for each in python.looked_at[1:])


def test_a_quick_computer_lets_more_come_by_and_by(
    python: Interpreter, collector: Collector
) -> None:
    """One quick collection may be a lucky one."""
    python.seconds = 1e-7
    python.come(1_000_000)
    lengths = [each * python.seconds for each in python.looked_at]
    assert lengths == sorted(lengths)
    assert lengths[0] == pytest.approx(0.010, abs=5e-4)
    assert lengths[1] == pytest.approx(0.0133, abs=5e-4)
    assert 0.017 < lengths[-1] <= 0.0205


def test_what_dies_young_does_not_count(
    python: Interpreter, collector: Collector
) -> None:
    """The interpreter frees that by itself, in microseconds: no pause is due for it."""
    for _ in range(20):
        python.come(200_000, "dies young")
        python.come(2_000)
    assert not python.looked_at
    python.come(70_000)
    assert len(python.looked_at) == 1


@pytest.mark.parametrize(
    ("blocks", "most"), [(1_000_000, 250_000), (200_000, 50_000), (0, 20_000)]
)
def test_while_robots_start_or_stop_as_much_may_come_as_is_there(
    python: Interpreter, blocks: int, most: int
) -> None:
    """What they are made of is kept; of a small program, and of one that cannot tell, few."""
    python.blocks = 500_000  # when esair is imported
    collector = Collector()
    python.blocks = blocks
    collector.start()
    python.come(most - ROUND)
    assert not python.looked_at
    python.come(2 * ROUND)
    assert len(python.looked_at) == 1
    collector.is_up()
    collector.is_down()
    python.looked_at.clear()
    python.come(most - ROUND)
    assert not python.looked_at
    python.come(2 * ROUND)
    assert len(python.looked_at) == 1
    collector.stop()


def test_what_died_young_before_the_last_collection_counts_no_more(
    python: Interpreter, collector: Collector
) -> None:
    """Else a pile as large as that could come before the next one."""
    python.come(300_000, "dies young")
    python.come(210_000)
    assert [abs(each - 100_000) < ROUND for each in python.looked_at] == [True, True]
    python.come(300_000, "dies young")
    collector.collect()
    python.looked_at.clear()
    python.come(110_000)
    assert len(python.looked_at) == 1
    assert (collector.collections, collector.forced) == (4, 3)


def test_a_stop_is_not_held_up_by_what_came_before(
    python: Interpreter, collector: Collector
) -> None:
    """Not even if a collection was due with the very next object."""
    while not python.looked_at:
        python.come(701, "kept")
    (came,) = python.looked_at
    collector.collect()
    python.looked_at.clear()
    python.come(came - 1, "kept")
    collector.is_down()
    python.come(100_000, "kept")
    assert not python.looked_at


def test_a_small_program_is_not_let_grow_to_a_large_one(
    python: Interpreter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What came since the last time has doubled before it takes a pause to collect."""
    python.blocks = 120_000
    collector = Collector()
    collector.start()
    collector.is_up()
    python.looked_at.clear()
    python.come(200_000)
    assert all(abs(each - 30_000) <= ROUND / 2 + 701 for each in python.looked_at)
    assert len(python.looked_at) >= 5


def test_a_program_is_as_large_as_it_is_when_its_robot_is_up(
    python: Interpreter,
) -> None:
    """What has come at its start is no growth, and nothing to be looked at again."""
    python.blocks = 100_000
    collector = Collector()
    collector.start()
    python.blocks = 1_000_000
    collector.is_up()
    python.looked_at.clear()
    assert collector.fits(0.01)
    python.come(80_000)
    assert not python.looked_at


def test_the_interpreter_gets_its_settings_back(python: Interpreter) -> None:
    """From the last robot; one more of them changes nothing."""
    python.set_threshold(700, 10, 3)
    python.come(5_000, "kept")
    collector = Collector()
    collector.start()
    collector.is_up()
    assert python.alive == 0
    collector.start()
    collector.is_up()
    python.come(5_000, "kept")
    collector.is_down()
    collector.stop()
    assert (len(python.callbacks), python.alive) == (1, 5_000)
    assert python.get_threshold() != (700, 10, 3)
    collector.is_down()
    collector.stop()
    assert python.get_threshold() == (700, 10, 3)
    assert not python.callbacks
    assert python.alive == 10_000


def test_counts_are_those_since_the_first_robot(
    python: Interpreter, collector: Collector
) -> None:
    """One that starts beside it takes nothing away; the first of the next ones does."""
    python.come(110_000)
    collector.collect()
    collector.start()
    counts = collector.counts()
    assert (counts["collections"], counts["forced"]) == (2, 1)
    collector.stop()
    collector.is_down()
    collector.stop()
    collector.start()
    assert set(collector.counts().values()) == {0}
    collector.stop()


# What is kept.


def test_what_there_is_when_a_robot_is_up_is_not_looked_at(
    python: Interpreter,
) -> None:
    """It is as long as the program is large, and all of it is kept."""
    python.come(8_000, "kept")
    collector = Collector()
    collector.start()
    collector.is_up()
    assert (python.looked_at, collector.collections) == ([0], 0)
    python.come(3_000)
    collector.collect()
    assert python.looked_at == [0, 3_000]


def test_what_is_kept_is_looked_at_once(
    python: Interpreter, collector: Collector
) -> None:
    """A long history fills: each object of it costs one look, and not one each time."""
    python.come(600_000, "kept")
    assert len(python.looked_at) >= 5
    assert sum(python.looked_at) <= 600_000
    assert max(python.looked_at) <= 100_000 + ROUND


def test_garbage_is_not_set_aside(python: Interpreter, collector: Collector) -> None:
    """What was in use at a pause of mostly garbage may be garbage at the next one."""
    python.seconds = 1.5e-7
    python.come(20_000, "kept")
    python.come(90_000)
    assert len(python.looked_at) == 1
    assert python.alive >= 20_000


@pytest.mark.parametrize(("blocks", "kept"), [(300_000, 80_000), (1_000_000, 40_000)])
def test_what_a_long_pause_has_kept_is_set_aside(
    python: Interpreter, blocks: int, kept: int
) -> None:
    """From 10 ms on if it is most of what came; from 20 ms on in any case."""
    python.blocks = blocks
    collector = Collector()
    collector.start()
    collector.is_up()
    python.looked_at.clear()
    python.come(kept, "kept")
    python.come(110_000 - kept)
    assert len(python.looked_at) == 1
    assert python.alive < kept


def test_what_grows_in_gaps_is_set_aside_when_it_takes_long(
    python: Interpreter, collector: Collector
) -> None:
    """Else each gap would have to be as long as a look at all that was ever kept."""
    for _ in range(100):
        python.come(1_000, "kept")
        python.come(1_000)
        collector.collect()
    assert collector.longest < 0.0035
    assert collector.collected == 100_000
    assert python.alive < 12_000


@pytest.mark.parametrize(("blocks", "looks"), [(1_900_000, False), (2_100_000, True)])
def test_what_was_set_aside_is_looked_at_again_once_the_program_has_doubled(
    python: Interpreter, collector: Collector, blocks: int, looks: bool
) -> None:
    """In a gap that is long enough for all of it, and only once."""
    python.blocks = blocks
    python.come(110_000, "kept")
    python.looked_at.clear()
    assert collector.fits(0.1) is not looks
    assert collector.fits(0.16)
    python.come(1_000)
    collector.collect()
    assert (python.looked_at[0] > 100_000) is looks
    python.come(1_000)
    collector.collect()
    assert python.looked_at[-1] <= 12_000
    assert collector.fits(0.1)


# In gaps.


@pytest.fixture
def real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the virtual loop count as one with gaps."""
    told = SimpleNamespace(virtual=False)
    monkeypatch.setattr(_garbage, "turn_of", lambda _loop: told)


class Steps:
    """A robot whose steps make garbage; knows when it was collected."""

    def __init__(self, python: Interpreter, period: float, litter: int) -> None:
        self.loop = asyncio.get_running_loop()
        self.began = self.loop.time()
        self.python, self.litter = python, litter
        self.stepped: list[float] = []
        self.collected: list[tuple[float, int]] = []
        """When there was a full collection, and at how many objects it has looked."""
        python.callbacks.append(self._hear)
        self.job = Scheduler.of(self.loop).every(period, self._step)
        self.gaps = Gaps(self.loop)

    def _step(self, _now: float) -> None:
        self.stepped.append(self.loop.time() - self.began)
        self.python.come(self.litter)

    def _hear(self, phase: str, info: dict[str, int]) -> None:
        if phase == "stop" and info["generation"] == 2:
            moment = self.loop.time() - self.began
            self.collected.append((moment, self.python.looked_at[-1]))

    async def run(self, seconds: float) -> None:
        self.gaps.start()
        self.collected.clear()
        await asyncio.sleep(seconds)
        self.gaps.stop()
        self.job.stop()


@pytest.fixture
def started(
    python: Interpreter, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Collector]:
    """One of a robot that has started, and is not up yet."""
    collector = Collector()
    monkeypatch.setattr(_garbage, "collector", collector)
    collector.start()
    yield collector
    collector.stop()


@pytest.mark.usefixtures("real_time")
async def test_a_collection_in_a_gap_is_short(
    python: Interpreter, started: Collector
) -> None:
    """It takes a millisecond, from the second on: as often as so much has come."""
    python.come(50_000, "kept")  # until it is up
    steps = Steps(python, 0.01, 1_000)
    await steps.run(5.0)
    (first, many), again, *others = steps.collected
    assert 0.25 <= first <= 0.265
    assert 24_000 <= many <= 27_000
    assert again == (first, 0)  # whether what took so long is kept
    assert all(4_000 <= number <= 6_000 for _, number in others)
    assert 85 <= len(others) <= 100
    assert (started.forced, started.longest_forced) == (0, 0.0)
    assert started.longest == pytest.approx(many * 2e-7)


@pytest.mark.usefixtures("real_time")
async def test_a_gap_is_used_sooner_on_a_slow_computer(
    python: Interpreter, started: Collector
) -> None:
    """What an object takes is learned in gaps, too: then few wait for each."""
    python.seconds = 1e-6
    steps = Steps(python, 0.01, 1_000)
    await steps.run(3.0)
    late = [number for when, number in steps.collected if when > 2.0]
    assert late
    assert max(late) <= 2_000


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("kept", [200, 400, 600])
async def test_what_is_kept_beside_it_is_not_taken_for_garbage(
    python: Interpreter, started: Collector, kept: int
) -> None:
    """Each object seemed to take longer, until no gap was long enough for a pile."""
    steps = Steps(python, 0.01, 1_000 - kept)
    keeps = Scheduler.of(steps.loop).every(0.01, lambda _now: python.come(kept, "kept"))
    await steps.run(10.0)
    keeps.stop()
    assert started.forced == 0
    assert max(number for when, number in steps.collected if when > 1.0) <= 11_500


@pytest.mark.usefixtures("real_time")
async def test_nothing_is_due_for_as_long_as_a_collection_takes(
    python: Interpreter, started: Collector
) -> None:
    """Where gaps are shorter, twenty are let pass before one is used all the same."""
    steps = Steps(python, 0.002, 100)
    await steps.run(0.25)
    assert steps.collected == []
    steps = Steps(python, 0.002, 100)
    await steps.run(2.0)
    moment, _ = steps.collected[0]
    assert 19 <= sum(0.25 <= each <= moment for each in steps.stepped) <= 22
    assert started.forced >= 1
    assert started.longest_forced > 0.002
    late = [number * 2e-7 for when, number in steps.collected if when > 1.0]
    assert late
    assert max(late) < 0.002


@pytest.mark.usefixtures("real_time")
async def test_few_objects_are_no_reason_to_collect(
    python: Interpreter, started: Collector
) -> None:
    """A gap is used from 500 on, and looked for four times a second."""
    steps = Steps(python, 0.1, 40)
    await steps.run(3.0)
    assert [number for _, number in steps.collected] == [520, 520]


@pytest.mark.usefixtures("real_time")
async def test_who_does_not_want_it_collects_by_himself(
    python: Interpreter, started: Collector
) -> None:
    """He has said ``gc.disable()``: then nobody else collects either."""
    python.enabled = False
    steps = Steps(python, 0.1, 5_000)
    python.set_threshold(10**9, 10, 10)
    await steps.run(2.0)
    assert steps.collected == []


@pytest.mark.usefixtures("real_time")
async def test_gaps_are_used_until_the_last_robot_of_the_loop_stops(
    python: Interpreter, started: Collector
) -> None:
    """One that stops takes nothing from the other."""
    steps = Steps(python, 0.01, 1_000)
    steps.gaps.start()
    steps.gaps.start()
    await asyncio.sleep(1.0)
    steps.gaps.stop()
    steps.collected.clear()
    await asyncio.sleep(1.0)
    assert len(steps.collected) >= 15
    steps.gaps.stop()
    steps.collected.clear()
    await asyncio.sleep(0.2)
    assert steps.collected == []
    steps.job.stop()
    started.collect()
    steps.collected.clear()
    python.come(140_000, "kept")  # more than a pause can look at, while it stops
    assert steps.collected == []


async def test_on_the_virtual_clock_there_are_no_gaps(
    python: Interpreter, started: Collector
) -> None:
    """Looks that never end would hide a deadlock."""
    steps = Steps(python, 0.01, 1_000)
    await steps.run(0.5)
    assert steps.collected == []
