"""An arrival is told once, in the event loop, and nothing is left of the waiting."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Callable

import pytest

from esair.buses import finding
from esair.discovery import Wakes, watch
from esair.testing import Leaks

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("BUS-2")]

PATIENCE = 60.0


@pytest.fixture(autouse=True)
def many_looks(monkeypatch) -> None:
    """Do not take longer than the rules need."""
    monkeypatch.setattr(finding, "PERIOD", 0.01)


class Place:
    """Where a device is or is not; counts who looks, and on which thread."""

    def __init__(self, value: object = None) -> None:
        self.value = value
        self.looks = 0
        self.threads: set[threading.Thread] = set()

    def __call__(self):
        self.looks += 1
        self.threads.add(threading.current_thread())
        if isinstance(self.value, Exception):
            raise self.value
        return self.value


async def until(condition: Callable[[], object]) -> None:
    """Wait for something that another thread does."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        await asyncio.sleep(0.005)


async def looked_at(place: Place, times: int = 2) -> None:
    """Wait until somebody has looked, and what was seen had time to be told."""
    before = place.looks
    await until(lambda: place.looks >= before + times)
    await asyncio.sleep(0)


async def test_an_arrival_is_told_in_the_loop() -> None:
    """The looking is done in a thread, the telling is not."""
    place, told = Place(), []
    forget = watch(place, lambda: told.append(threading.current_thread()))
    await looked_at(place)
    assert told == []

    place.value = 1
    await until(lambda: told)
    await looked_at(place)

    assert told == [threading.current_thread()]
    assert {thread.name for thread in place.threads} == {"esair-hotplug"}
    forget()


@pytest.mark.parametrize(
    ("seen", "values", "arrivals"),
    [
        (None, ["a"], 1),
        ("a", ["a"], 0),  # lost, but never gone: a port that is busy
        ("a", ["a", None, "a"], 1),
        ("a", ["b"], 1),  # gone and back between two looks
        (None, ["a", "a", "a"], 1),  # there, but cannot be opened
        (None, ["a", "b"], 2),  # its permissions have changed
        (None, [OSError(), "a", ValueError(), "a"], 2),
        (None, [None, None], 0),
    ],
)
async def test_only_another_value_than_the_last_is_an_arrival(
    seen, values, arrivals
) -> None:
    """What is there all the time is told once at most."""
    place, told = Place(values[0]), []
    forget = watch(place, lambda: told.append(1), seen=seen)

    for value in values:
        place.value = value
        await looked_at(place)
    forget()

    assert len(told) == arrivals


async def test_after_forget_nothing_is_told() -> None:
    """Not even what was seen before, and is on its way."""
    place, told = Place(), []
    forget = watch(place, lambda: told.append(1))
    await looked_at(place)

    place.value = 1
    before = place.looks
    end = time.monotonic() + PATIENCE
    while place.looks <= before + 1 and time.monotonic() < end:
        time.sleep(0.01)  # noqa: ASYNC251 - the loop cannot be told meanwhile
    forget()
    await asyncio.sleep(0.01)

    assert place.looks > before + 1
    assert told == []


async def test_one_thread_serves_all_and_ends_with_the_last() -> None:
    """No thread and no descriptor is left."""
    leaks = Leaks()
    places = [Place() for _ in range(20)]
    forgets = [watch(place, lambda: None) for place in places]
    for place in places:
        await looked_at(place, 1)

    assert len(set().union(*(place.threads for place in places))) == 1
    for forget in forgets:
        forget()
        forget()  # twice is harmless

    assert await leaks.check(PATIENCE) == []


async def test_who_comes_while_the_thread_ends_is_served() -> None:
    """The last one goes and another comes, again and again."""
    leaks = Leaks()
    for _ in range(50):
        watch(Place(), lambda: None)()
        place, told = Place(1), asyncio.Event()
        forget = watch(place, told.set)
        async with asyncio.timeout(PATIENCE):
            await told.wait()
        forget()

    assert await leaks.check(PATIENCE) == []


async def test_one_that_is_broken_holds_up_nobody() -> None:
    """What it raises counts as nothing being there."""
    broken, place = Place(ZeroDivisionError()), Place(1)
    told: list[str] = []
    forgets = [
        watch(broken, lambda: told.append("broken")),
        watch(place, lambda: told.append("good")),
    ]
    await until(lambda: told)
    await looked_at(broken)

    assert told == ["good"]
    for forget in forgets:
        forget()


def test_a_loop_that_is_closed_takes_the_thread_with_it() -> None:
    """Somebody forgot to forget."""
    place = Place()

    async def main() -> None:
        watch(place, lambda: None)
        await looked_at(place)

    asyncio.run(main())

    (thread,) = place.threads
    thread.join(PATIENCE)
    assert not thread.is_alive()


async def test_a_wake_ends_the_sleep_at_once() -> None:
    """From another thread; and nothing is left of it."""
    leaks = Leaks()
    with Wakes() as wakes:
        wakes.listen()
        timer = threading.Timer(0.05, wakes.wake)
        timer.start()
        begin = time.monotonic()
        wakes.wait(PATIENCE)
        assert time.monotonic() - begin < PATIENCE / 2
        timer.join()
        begin = time.monotonic()
        wakes.wait(0.02)
        assert time.monotonic() - begin >= 0.015

    assert await leaks.check() == []


async def test_without_pyudev_only_the_time_counts(monkeypatch) -> None:
    """It is an extra."""
    monkeypatch.setitem(__import__("sys").modules, "pyudev", None)
    place, told = Place(), []
    with Wakes() as wakes:
        wakes.listen()
        assert not wakes.has_events

    forget = watch(place, lambda: told.append(1))
    await looked_at(place)
    place.value = 1
    await until(lambda: told)
    forget()


async def test_a_broken_monitor_does_not_keep_the_thread_awake(monkeypatch) -> None:
    """Its descriptor is dropped, instead of being ready for ever."""
    import pyudev

    class Broken:
        """A monitor whose queue has overflowed."""

        def __init__(self) -> None:
            self.read, self.write = os.pipe()
            os.write(self.write, b"!")

        @classmethod
        def from_netlink(cls, _context, source):
            assert source in {"udev", "kernel"}
            return made

        def filter_by(self, _subsystem): ...

        def start(self): ...

        def fileno(self):
            return self.read

        def poll(self, _timeout):
            raise OSError(105, "No buffer space available")

    made = Broken()
    monkeypatch.setattr(pyudev, "Monitor", Broken)
    with Wakes() as wakes:
        wakes.listen()
        assert wakes.has_events
        wakes.wait(PATIENCE)
        assert not wakes.has_events
        begin = time.monotonic()
        wakes.wait(0.05)
        assert time.monotonic() - begin >= 0.04
    os.close(made.read)
    os.close(made.write)
