"""Dead men: what is silent for too long is told so, all behind one timer."""

from __future__ import annotations

import asyncio

import pytest

from esair.loop import DeadMan

pytestmark = pytest.mark.virtual_clock


class Talker:
    """Is heard of now and then."""

    def __init__(self, patience: float) -> None:
        self.loop = asyncio.get_running_loop()
        self.patience = patience
        self.heard = self.loop.time()
        self.died: list[float] = []
        self.began = self.heard
        self.man = DeadMan(self.loop, self.dies, self.dead)

    def dies(self) -> float:
        return self.heard + self.patience

    def dead(self) -> None:
        self.died.append(round(self.loop.time() - self.began, 6))

    def talk(self) -> None:
        self.heard = self.loop.time()
        self.man.arm()


async def test_who_is_silent_dies_once_and_at_its_moment() -> None:
    """Each has its own moment; being heard of moves it."""
    silent, talking = Talker(0.2), Talker(0.3)
    silent.talk()
    for _ in range(5):
        talking.talk()
        await asyncio.sleep(0.1)
    assert (silent.died, talking.died) == ([0.2], [])
    await asyncio.sleep(2.0)
    assert (silent.died, talking.died) == ([0.2], [0.7])


async def test_who_is_disarmed_does_not_die_and_may_be_armed_again() -> None:
    """It keeps its place, and counts from when it was heard of last."""
    one, other = Talker(0.2), Talker(5.0)
    other.talk()
    one.talk()
    one.man.disarm()
    await asyncio.sleep(0.1)
    one.talk()
    await asyncio.sleep(1.0)
    assert (one.died, other.died) == ([0.3], [])
    other.man.disarm()


async def test_who_gets_impatient_dies_sooner() -> None:
    """Its patience was changed while it was not watched."""
    one = Talker(5.0)
    other = Talker(9.0)
    other.talk()
    one.talk()
    one.man.disarm()
    one.patience = 0.2
    one.talk()
    await asyncio.sleep(8.0)
    assert one.died == [0.2]
    other.man.disarm()


async def test_one_that_raises_does_not_keep_the_others_alive() -> None:
    """The error goes to the loop; the others die in their time."""

    class Broken(Talker):
        def dead(self) -> None:
            raise ValueError("broken")

    told: list[object] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: told.append(context["exception"]))
    broken, other = Broken(0.2), Talker(0.2)
    broken.talk()
    other.talk()
    await asyncio.sleep(1.0)
    loop.set_exception_handler(None)
    assert other.died == [0.2]
    assert [str(error) for error in told] == ["broken"]


async def test_the_last_one_takes_the_timer_with_it() -> None:
    """A loop whose robots have ended has nothing to wait for."""
    one = Talker(1000.0)
    before = len(one.loop._scheduled)  # type: ignore[attr-defined]
    one.talk()
    one.man.disarm()
    left = [each for each in one.loop._scheduled if not each.cancelled()]  # type: ignore[attr-defined]
    assert len(left) == before


async def test_a_moment_between_two_nanoseconds_is_reached() -> None:
    """Called a hair early, it was looked for again in the same instant, for ever."""
    loop = asyncio.get_running_loop()
    found: list[float] = []

    dies = loop.time() + 1.0000000005838672e-06
    DeadMan(loop, lambda: dies, lambda: found.append(loop.time())).arm()
    await asyncio.sleep(0.001)
    assert len(found) == 1
