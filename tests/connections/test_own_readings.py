"""Who reads cannot change what others read: each has a value of their own."""

from __future__ import annotations

import asyncio
import copy
from typing import Any

import attrs
import numpy as np
import pytest

import esair
from esair.flaws import is_fixed, owned, read_only
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


@attrs.define
class Pose:
    """Can be changed."""

    heading: float


@attrs.frozen
class Scan:
    """Cannot be changed itself, but what is in it can."""

    ranges: list[float]


@attrs.frozen
class Twist:
    """Cannot be changed."""

    linear: float
    name: str | None
    steps: tuple[int, ...]


def _clean(value: Any) -> None:
    """Throw out what is taken for noise, in place."""
    match value:
        case Pose():
            value.heading = 9.0
        case Scan():
            value.ranges[0] = 9.0
        case dict():
            value["a"] = 9.0
        case _:
            value[0] = 9


def _nearest(value: Any) -> float:
    match value:
        case Pose():
            return value.heading
        case Scan():
            return min(value.ranges)
        case dict():
            return float(min(value.values()))
        case _:
            return float(min(value))


class Follow(esair.Reaction):
    """Cleans up its own reading, and drives."""

    lidar = esair.reads(Any)
    wheels = esair.writes(float, blind="release")

    def react(self, lidar: Any) -> float:
        _clean(lidar)
        return 0.5


class Near(esair.Reaction):
    """Lets nothing move while something is near."""

    lidar = esair.reads(Any)
    wheels = esair.guards(float)

    def react(self, lidar: Any, wheels: float) -> float | None:
        return None if _nearest(lidar) < 1 else wheels


VALUES = [
    [0.0, 2.0],
    bytearray(b"\x00\x02"),
    {"a": 0.0, "b": 2.0},
    Pose(0.0),
    Scan([0.0, 2.0]),
    np.array([0.0, 2.0]),
]


@pytest.mark.promise("REA-2", "ROB-3", "PRO-5")
@pytest.mark.parametrize("value", VALUES, ids=lambda each: type(each).__name__)
async def test_a_reaction_cannot_change_what_a_guard_sees(value: Any) -> None:
    """Not by what it does to its own reading either: an array cannot be written to."""
    lidar = FakeSensor("lidar", value, rate=20.0)
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[lidar, wheels], behaviors=[Follow(), Near()]):
        await asyncio.sleep(1.0)
    assert set(wheels.commands) == {0.0}


@pytest.mark.promise("REA-2")
@pytest.mark.parametrize("value", VALUES[:-1], ids=lambda each: type(each).__name__)
async def test_each_who_reads_has_a_value_of_their_own(value: Any) -> None:
    """However they read it, and what was heard long ago as well."""
    lidar = FakeSensor("lidar", value, rate=20.0)
    user: Any = esair.Behavior(name="user", reads={"lidar": esair.reads(Any)})
    async with esair.Robot(resources=[lidar], behaviors=[user]):
        port = user.lidar
        _clean(await port.read())
        _clean((await port.reading())[0])
        _clean(port.newest.value)
        at = (await port.reading()).time
        heard, time, _ = port.history(1)[0]
        assert time == at
        _clean(heard)
        async for each in port:
            _clean(each)
            break
        assert _nearest(await port.read()) == 0.0
        assert _nearest(await port.read(fresh=True)) == 0.0


@pytest.mark.promise("SC-4")
async def test_one_that_came_late_is_known_by_its_stamp() -> None:
    """Of values that can be changed, too; one without a stamp does not count as one."""
    lidar: Any = FakeSensor("lidar", [0.0], rate=20.0)
    user: Any = esair.Behavior(name="user", reads={"lidar": esair.reads(list)})
    async with esair.Robot(resources=[lidar], behaviors=[user]):
        await user.lidar.read(fresh=True)
        lidar.feed(esair.Stamped([1.0], age=0.1))
        assert await user.lidar.read(fresh=True) == [1.0]
        newest = await user.lidar.reading()
        assert newest.arrived - newest.time == pytest.approx(0.1)
        lidar.feed(esair.Stamped([2.0], age=5.0))
        assert await user.lidar.read() == [1.0]


def test_what_cannot_be_changed_is_not_copied() -> None:
    """It costs nothing; what has to be copied, and cannot, is shared."""
    twist = Twist(1.0, None, (1, 2))
    assert is_fixed(Twist)
    assert is_fixed(tuple[float, ...])
    assert not is_fixed(Scan)
    assert not is_fixed(tuple[list[float], int])
    assert not is_fixed(bytearray)
    assert owned(twist) is twist
    marker = object()
    assert owned(marker) is marker
    counting = [1], iter([1]), (each for each in [1])
    assert owned(counting) is counting


class Reuses(esair.Sensor[Any]):
    """Fills one buffer again and again, as drivers do that save memory."""

    rate = 100.0
    blocking = False

    def __init__(self, buffer: Any) -> None:
        super().__init__()
        self.buffer = buffer
        self.rounds = 0

    def read(self) -> Any:
        self.rounds += 1
        match self.buffer:
            case Pose():
                self.buffer.heading = float(self.rounds)
            case Scan():
                self.buffer.ranges[:] = [self.rounds] * 2
            case dict():
                self.buffer.update(a=self.rounds, b=self.rounds)
            case np.ndarray():
                self.buffer[:] = self.rounds
            case _:
                self.buffer[:] = type(self.buffer)([self.rounds] * 2)
        return self.give(self.buffer)

    def give(self, buffer: Any) -> Any:
        return buffer


@pytest.mark.promise("SC-1", "SC-2")
@pytest.mark.parametrize("buffer", VALUES, ids=lambda each: type(each).__name__)
async def test_a_driver_cannot_change_what_it_has_given(buffer: Any) -> None:
    """What was read stays, and so does the history, when its buffer is filled again."""
    sensor = Reuses(copy.deepcopy(buffer))
    user: Any = esair.Behavior(
        name="user", reads={"it": esair.reads(Any, name="reuses")}
    )
    async with esair.Robot(resources=[sensor], behaviors=[user]):
        first = await user.it.reading(fresh=True)
        was = _nearest(first.value)
        await user.it.read(fresh=True)
        assert _nearest(first.value) == was
        seen = [_nearest(each.value) for each in user.it.history(9)]
        assert seen == sorted(set(seen))


def _shown(array: Any) -> Any:
    """A view that cannot be written to, of what can."""
    view = array[:]
    view.flags.writeable = False
    return view


@pytest.mark.promise("SC-1", "SC-2")
@pytest.mark.parametrize(
    ("give", "seen"),
    [
        (memoryview, bytes),
        (lambda buffer: memoryview(buffer).toreadonly(), bytes),
        (lambda buffer: (1, [memoryview(buffer)]), lambda value: bytes(value[1][0])),
        (lambda buffer: Scan(memoryview(buffer)), lambda value: bytes(value.ranges)),  # type: ignore[arg-type]
        (lambda buffer: _shown(np.frombuffer(buffer, np.uint8)), bytes),
    ],
    ids=["view", "read_only", "nested", "field", "array"],
)
async def test_a_view_of_a_buffer_is_no_way_round_that(give: Any, seen: Any) -> None:
    """Wherever it is in a value: what it shows is copied when it comes."""
    sensor = Reuses(bytearray(2))
    sensor.give = give  # type: ignore[method-assign]
    user: Any = esair.Behavior(
        name="user", reads={"it": esair.reads(Any, name="reuses")}
    )
    async with esair.Robot(resources=[sensor], behaviors=[user]):
        first = await user.it.reading(fresh=True)
        was = seen(first.value)
        await user.it.read(fresh=True)
        assert seen(first.value) == was
        assert len({seen(each.value) for each in user.it.history(9)}) > 1


def test_a_view_keeps_its_form() -> None:
    """Numbers, rows and columns; one of what nobody can change is no copy."""
    grid = memoryview(bytearray(48)).cast("d", [2, 3])
    mine: Any = owned(grid)
    assert (mine.format, mine.shape, mine.readonly) == ("d", (2, 3), True)
    assert owned(mine) is not grid
    fixed = memoryview(b"12")
    assert owned([fixed, [1]])[0] is fixed


def test_an_array_that_nobody_writes_to_is_not_copied() -> None:
    """A driver that gives a new one each time says so."""
    frame = np.zeros((4, 4))
    assert not np.shares_memory(read_only(frame), frame)
    frame.flags.writeable = False
    assert read_only(frame) is frame
    bytes_of = np.frombuffer(b"1234", np.uint8)
    assert read_only(bytes_of) is bytes_of
