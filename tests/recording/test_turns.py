"""The turns of a run as bytes: any value and any error, and nothing that runs code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from esair.codec import Kinds
from esair.exceptions import DeviceLostError, RecordingBrokenError
from esair.loop import First
from esair.recording import Kept
from esair.recording._turns import Turns

HERE = Path("run.mcap")


@attrs.frozen
class Pose:
    """What a driver gives."""

    x: float
    y: float


class Odd(Exception):  # noqa: N818 - somebody else's
    """An error that cannot be made by its arguments."""

    def __init__(self, *, code: int) -> None:
        super().__init__(f"code {code}")
        self.code = code


KINDS = Kinds([Pose, Odd])


def kept_of(chunks: list[bytes]) -> tuple[list[Any], str | None]:
    """Return the items of chunks, read, and why there are no more."""
    kept = Kept(HERE, chunks, KINDS)
    items = [
        item if type(item) is float else (*item[:-1], kept.read(item[-1]))
        for item in kept
    ]
    return items, kept.spoiled


def through(*items: Any) -> list[Any]:
    """Return items after they were bytes."""
    turns = Turns(KINDS)
    turns.tape.turn(0.0)
    for item in items:
        turns.tape.arrived(("device", "news"), item)
    kept, spoiled = kept_of(list(iter(turns.chunk, b"")))
    assert spoiled is None
    return [item[2] for item in kept[1:]]


@pytest.mark.promise("REP-2")
def test_values_of_drivers_come_back() -> None:
    """Plain ones, those of attrs classes, arrays, times."""
    pose, first = Pose(1.0, float("inf")), First(waits=False, value=3, error=None)
    array = np.arange(6.0).reshape(2, 3)
    values = through(pose, first, {"a": [1, b"x", None]}, array, np.float32(2.5))

    assert values[:3] == [pose, tuple(first), {"a": [1, b"x", None]}]
    assert (values[3] == array).all()
    assert values[4] == np.float32(2.5)


@pytest.mark.promise("REP-2")
def test_errors_come_back_with_all_that_is_asked_of_them() -> None:
    """Class, number of the system, attributes, cause; also in a circle."""
    lost, gone, odd = DeviceLostError("sonar", "gone"), OSError(19, "no"), Odd(code=7)
    lost.__cause__, gone.__cause__ = gone, lost
    back, system, strange = through((lost, gone, odd))[0]

    assert (type(back), str(back), back.resource) == (type(lost), str(lost), "sonar")
    assert (type(system), system.errno) == (OSError, 19)
    assert back.__cause__.errno == 19
    assert back.__cause__.__cause__ is back
    assert (type(strange), strange.code, str(strange)) == (Odd, 7, "code 7")


@pytest.mark.promise("REP-2")
def test_a_value_that_cannot_be_kept_ends_what_can_be_repeated() -> None:
    """Whole turns before it stay: a robot would miss in the last what came beside it."""
    turns = Turns(KINDS)
    for moment in (0.0, 1.0, 2.0):
        turns.tape.turn(moment)
        turns.tape.arrived(("bumper", "pushed"), moment)
    turns.tape.arrived(("sonar", "pushed"), lambda: None)
    turns.tape.arrived(("bumper", "pushed"), 9.0)
    turns.tape.turn(3.0)
    items, spoiled = kept_of(list(iter(turns.chunk, b"")))

    pushed = "bumper", "pushed"
    assert items == [0.0, (pushed, 1, 0.0), 1.0, (pushed, 2, 1.0)]
    assert "what sonar pushed gave cannot be kept: builtins.function" in str(spoiled)


@pytest.mark.promise("REP-2", "REC-3")
def test_the_last_turn_of_a_cut_recording_is_none() -> None:
    """But for the moment of the first one: there was a run."""
    turns, pushed = Turns(KINDS), ("bumper", "pushed")
    turns.tape.turn(0.0)
    turns.tape.arrived(pushed, 7.0)
    data = turns.chunk()
    assert list(Kept(HERE, [data], KINDS, whole=False)) == [0.0]
    turns.tape.turn(1.0)
    cut = Kept(HERE, [data, turns.chunk()], KINDS, whole=False)
    assert [item if type(item) is float else item[1] for item in cut] == [0.0, 1]


@pytest.mark.promise("REP-2")
@pytest.mark.parametrize("missing", [0, 1])
def test_a_missing_part_is_noticed(missing: int) -> None:
    """Nothing is repeated without its beginning, and nothing past a gap."""
    turns, chunks = Turns(KINDS), []
    for moment in (0.0, 1.0, 2.0):
        turns.tape.turn(moment)
        chunks.append(turns.chunk())
    del chunks[missing]

    if missing == 0:
        with pytest.raises(RecordingBrokenError, match="beginning is not there"):
            kept_of(chunks)
    else:
        assert kept_of(chunks) == ([0.0], "a part of it is missing")


@pytest.mark.promise("REC-4")
@pytest.mark.parametrize(("limit", "held"), [(5, 1 << 20), (100, 5000)])
def test_a_disk_that_is_stuck_takes_no_memory(
    monkeypatch: pytest.MonkeyPatch, limit: int, held: int
) -> None:
    """What waits is bounded before anybody writes; what was kept says that it ended."""
    monkeypatch.setattr("esair.recording._turns.LIMIT", limit)
    monkeypatch.setattr("esair.recording._turns.HELD", held)
    turns = Turns(KINDS)
    turns.tape.turn(0.0)
    for _ in range(20):
        turns.tape.arrived(("camera", "news"), (bytes(1000), None))
    items, spoiled = kept_of(list(iter(turns.chunk, b"")))
    assert len(items) <= 6
    assert "fast enough" in str(spoiled)
