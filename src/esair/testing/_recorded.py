"""Recordings as fakes: sensors that give again what they gave, at the same times."""

from __future__ import annotations

import asyncio
import collections
import math
import os
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from esair import abc
from esair.actions import Derived
from esair.codec import kinds_of
from esair.connections import is_loss
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    RecordingBrokenError,
    hint_for,
)
from esair.journal import Kind
from esair.loop import First
from esair.messages import Stamped
from esair.recording import (
    GIVEN,
    Kept,
    Recorded,
    chunks_of,
    events_of,
    facts_of,
    plain,
)
from esair.resources import Sensor
from esair.testing._fakes import FakeSensor
from esair.values import snake_case, value_type


class RecordedSensor(FakeSensor[Any]):
    """A sensor of a recording; it has all the words of a `FakeSensor` beside.

    After a fault it is silent for a moment, as every sensor that pushes.
    """

    _run: RecordedRun
    _fault: BaseException | None = None

    async def open(self) -> None:
        """Be opened; the first one of the recording begins it."""
        await super().open()
        self._run.begin()

    def raise_fault(self, error: BaseException) -> None:
        """Raise an error instead of a value, now."""
        self._fault = error
        self._news.set()

    def feed_old(self, value: Any, age: float) -> None:
        """Push a value that was measured some time ago."""
        self.feed(value)
        self._fed[-1] = Stamped(value, age=age)

    async def stream(self) -> AsyncIterator[Any]:
        """Push what was recorded, and what a test feeds beside."""
        self._fed.clear()
        while True:
            await self._news.wait()
            self._news.clear()
            if self._fault is not None:
                fault, self._fault = self._fault, None
                raise fault
            await self._faults.call()
            while self._fed:
                yield self._fed.popleft()


class RecordedRun:
    """The sensors of a recorded run, for any test; made by `recording`.

    Attributes:
        sensors: The sensors, by name: values, losses and faults come when they came,
            counted from the moment at which the robot opens the first of them.
        duration: How long the recorded run took, in seconds.
    """

    def __init__(self, sensors: dict[str, RecordedSensor], duration: float) -> None:
        self.sensors = sensors
        self.duration = duration
        self._acts: list[tuple[float, int, Callable[..., object], tuple[Any, ...]]] = []
        self._has_begun = False
        for sensor in sensors.values():
            sensor._run = self  # noqa: SLF001 - two halves of one

    def __getitem__(self, name: str) -> RecordedSensor:
        """Return a sensor.

        Raises:
            KeyError: The recording has none of this name.
        """
        if name not in self.sensors:
            hint = hint_for(name, self.sensors)
            raise KeyError(f"the recording has no sensor {name!r}{hint}")
        return self.sensors[name]

    def __iter__(self) -> Iterator[RecordedSensor]:
        return iter(self.sensors.values())

    def at(self, seconds: float, act: Callable[..., object], *args: Any) -> None:
        """Lay a fault, or anything else, over the recording.

        Args:
            seconds: When, since the first sensor is opened.
            act: What is called, such as ``run["sonar"].unplug``.
            *args: What with.

        Raises:
            ConfigError: That is no time, or cannot be called.
            RuntimeError: It has begun.
        """
        if not (isinstance(seconds, int | float) and math.isfinite(seconds)):
            told = f"expected seconds since the begin, not {seconds!r:.80}"
            raise ConfigError("recording", "at", told)
        if not callable(act):
            told = f"expected what is called, such as sensor.unplug, not {act!r:.80}"
            raise ConfigError("recording", "at", told)
        if self._has_begun:
            told = "the recording has begun: say so before the robot starts"
            raise RuntimeError(told)
        self._acts.append((seconds, len(self._acts), act, args))

    def begin(self) -> None:
        """Begin to give what was recorded."""
        if self._has_begun:
            return
        self._has_begun = True
        loop = asyncio.get_running_loop()
        acts = collections.deque(sorted(self._acts, key=lambda each: each[:2]))
        began = loop.time()

        def go_on() -> None:
            while acts and began + acts[0][0] <= loop.time() + 1e-9:
                _, _, act, args = acts.popleft()
                act(*args)
            if acts:
                loop.call_at(began + acts[0][0], go_on)

        go_on()


def recording(
    path: str | os.PathLike[str], *, types: Mapping[str, Any] | None = None
) -> RecordedRun:
    """Return the sensors of a recorded run as fakes.

    Values have their own classes if the recording can be repeated (`esair replay`);
    else, and where they were computed (`esair.Derived`), they are made of plain ones:
    numbers, texts, lists, dictionaries. Those of a computed sensor need its class to be
    loaded under its own name, or its type.

    Args:
        path: A recording of esair.
        types: The types of the sensors' values, by name; any unless given.

    Raises:
        RecordingBrokenError: It is none, or no sensor has given anything in it.
        OSError: It cannot be read.

    Example:
        >>> run = esair.testing.recording("run.mcap")
        >>> run.at(2.0, run["sonar"].unplug)
        >>> async with esair.Robot(resources=[*run, wheels], behaviors=[Avoid()]):
        ...     await asyncio.sleep(run.duration)
    """
    place = Path(path)
    wanted_kinds = {Kind.READING, Kind.UP, Kind.DOWN}
    last = 0.0
    events: list[Recorded] = []
    for each in events_of(place):
        last = max(last, each.time)
        if each.kind in wanted_kinds:
            events.append(each)
    names = sorted({each.component for each in events if each.kind == Kind.READING})
    if not names:
        raise RecordingBrokenError(str(place), "no sensor has given anything in it")
    wanted = types or {}
    sensors = {name: RecordedSensor(name, type=wanted.get(name, Any)) for name in names}
    ups = (each.time for each in events if each.kind == Kind.UP)
    began = min(ups, default=events[0].time)
    run = RecordedRun(sensors, last - began)
    given = _given(place)
    computed = {snake_case(kind.__name__): kind for kind in _loaded(Derived)}
    kinds = {name: value_type(kind, Sensor) for name, kind in computed.items()}
    for seconds, act, args in _acts(events, sensors, given, began, kinds | {**wanted}):
        run.at(seconds, act, *args)
    return run


Act = tuple[float, Callable[..., object], tuple[Any, ...]]


def _acts(
    events: Iterable[Recorded],
    sensors: Mapping[str, RecordedSensor],
    given: Mapping[str, list[tuple[float, Any, BaseException | None]]],
    began: float,
    kinds: Mapping[str, Any],
) -> Iterator[Act]:
    """Yield what happens to sensors, and when."""
    values: dict[tuple[str, float], list[Any]] = {}
    for name, answers in given.items():
        for time, value, error in answers:
            if name in sensors and error is None:
                values.setdefault((name, time), []).append(value)
            elif name in sensors and error is not None and not is_loss(error):
                yield time - began, sensors[name].raise_fault, (error,)
    was_up: set[str] = set()
    for event in events:
        sensor = sensors.get(event.component)
        if sensor is None:
            continue
        seconds = max(0.0, event.time - began)
        if event.kind == Kind.READING:
            own = values.get((event.component, event.time), [])
            value = next((v for v in own if plain(v) == event.value), None)
            if value is None:
                value = _made_of(event.value, kinds.get(event.component, Any))
            if event.measured is not None and event.measured < event.time:
                age = event.time - event.measured
                yield seconds, sensor.feed_old, (value, age)
            else:
                yield seconds, sensor.feed, (value,)
        elif event.kind == Kind.DOWN:
            yield seconds, sensor.unplug, ()
        elif event.kind == Kind.UP:
            if event.component in was_up:
                yield seconds, sensor.plug, ()
            was_up.add(event.component)


def _made_of(value: Any, kind: Any) -> Any:
    """Return a plain value as one of a type; as it is if it cannot be one."""
    from esair.config import INVALID, convert  # with much that a test may not need

    found = convert(value, kind, "", lambda *_: None, Path())
    return value if found is INVALID else found


def _given(
    path: Path,
) -> dict[str, list[tuple[float, Any, BaseException | None]]]:
    """Return what drivers have given, with their own classes, and their errors."""
    found: dict[str, list[tuple[float, Any, BaseException | None]]] = {}
    if "replay" not in facts_of(path) or next(chunks_of(path), None) is None:
        return found
    kept = Kept(path, chunks_of(path), kinds_of(_components, GIVEN, strangers=True))
    now = 0.0
    for item in kept:
        if type(item) is float:
            now = item
            continue
        tag = item[0]
        is_read = len(tag) == 3 and (tag[0], tag[2]) == ("call", "read")
        if not is_read and not (len(tag) == 2 and tag[1] == "pushed"):
            continue
        end = kept.read(item[-1])
        if type(end) is First:  # it waits
            continue
        if not isinstance(end, tuple) or len(end) not in {2, 3}:
            raise RecordingBrokenError(str(path), "its turns are damaged")
        name = tag[1] if is_read else tag[0]
        # What was given without a wait begins with that; what was pushed ends with
        # the number of the opening.
        value, error = end[1:] if is_read and len(end) == 3 else end[:2]
        if type(value) is Stamped:
            value = value.value
        if error is not None and not isinstance(error, Exception):
            error = DeviceFaultError(name, repr(error))
        found.setdefault(name, []).append((now, value, error))
    return found


def _components() -> list[type]:
    """Return the classes of all components that are loaded: a test has its robot's."""
    return _loaded(abc.Resource, abc.Action)


def _loaded(*kinds: type) -> list[type]:
    """Return these classes, and all that are made of them."""
    waiting: list[type] = [*kinds]
    found: list[type] = []
    while waiting:
        kind = waiting.pop()
        found.append(kind)
        waiting += kind.__subclasses__()
    return found
