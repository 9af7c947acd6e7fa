"""What the robot's own code collects: a queue that only grows has no bound."""

from __future__ import annotations

import asyncio
import collections
import itertools
import queue
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from esair.torture._world import World

GROWTH = 10  # By how much something must grow between two looks to be suspected
MOST = 20_000  # How much may be in one box at all
DEPTH = 3  # How deep in the objects of a component a box is looked for


class Boxes:
    """Counts, four times in a story, what lies in the boxes of the user's own code."""

    def __init__(self) -> None:
        # The sizes of each box so far, by component and name
        self.sizes: dict[tuple[str, str], list[int]] = {}

    def look(self, world: World) -> None:
        """Take the sizes once more, and say what only grows."""
        if world.ends is not None:
            return
        seen: set[int] = set()
        names = world.robot.resources.names()
        devices = [world.robot.resources.get(name) for name in names]
        for each in (*world.actions(), *filter(_is_own, devices)):
            for name, size in _boxes(vars(each).items(), seen, DEPTH):
                self.sizes.setdefault((each.name, name), []).append(size)
        tasks = [
            task
            for task in asyncio.all_tasks(world.loop)
            if not task.get_name().startswith("torture")
        ]
        whole = (world.robot.name, "the number of its tasks")
        self.sizes.setdefault(whole, []).append(len(tasks))
        for (component, name), sizes in self.sizes.items():
            if is_growing(sizes) or sizes[-1] > MOST:
                text = f"{name} only grows: {', '.join(map(str, sizes))}"
                world.judge.say("queue", component, text)


def is_growing(sizes: list[int]) -> bool:
    """Tell whether a box has only grown, about as much in each quarter of a story."""
    last = sizes[-4:]
    steps = [after - before for before, after in itertools.pairwise(last)]
    return len(last) == 4 and min(steps) >= max(GROWTH, max(steps) / 3)


def _is_own(component: object) -> bool:
    """Tell whether a class is the user's; a fake of esair keeps what it was told."""
    return not type(component).__module__.startswith("esair.")


def _boxes(
    items: Any, seen: set[int], depth: int, path: str = ""
) -> Iterator[tuple[str, int]]:
    for name, value in items:
        if id(value) in seen or value is None or isinstance(value, str | int | float):
            continue
        seen.add(id(value))
        where = f"{path}.{name}" if path else str(name)
        size = _size(value)
        if size is not None:
            yield where, size
        elif depth and not type(value).__module__.startswith(("esair.", "asyncio")):
            inner = getattr(value, "__dict__", None)
            if isinstance(inner, dict) and not isinstance(value, type):
                yield from _boxes(list(inner.items()), seen, depth - 1, where)


def _size(value: Any) -> int | None:
    """Return how much is in a box without a bound; None if it is none."""
    if isinstance(value, collections.deque):
        return len(value) if value.maxlen is None else 0
    if isinstance(value, asyncio.Queue | queue.Queue):
        return value.qsize() if value.maxsize <= 0 else 0
    if isinstance(value, queue.SimpleQueue):
        return value.qsize()
    if isinstance(value, list | dict | set | bytearray):
        return len(value)
    return None
