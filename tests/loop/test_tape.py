"""What a tape keeps of a run, and what a robot is told when it is over."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from esair.exceptions import DeviceLostError
from esair.loop import Player, TapeWriter
from esair.loop._tape import SPOILED, WAITS, Entry, First

pytestmark = pytest.mark.virtual_clock

READ, WRITE = ("sonar", "read"), ("call", "motor", "write")


class Threads:
    """A door that only notes what is brought to it."""

    def __init__(self) -> None:
        self.divert: Callable[[Entry], object] | None = None
        self.brought: list[Entry] = []

    def bring(self, entry: Entry) -> None:
        self.brought.append(entry)

    def end(self, _tag: Any, function: Callable[..., object], *terms: Any) -> None:
        function(*terms)


def begun(player: Player) -> Threads:
    door: Any = Threads()
    player.begin(door)
    threads: Threads = door
    return threads


def test_each_call_and_each_arrival_has_its_number() -> None:
    """Of those with its tag; a tape that is closed keeps nothing more."""
    kept: list[Any] = []
    tape = TapeWriter(kept.append)
    tape.turn(0.5)
    first = First(value=7)
    assert [tape.first(READ, first), tape.first(WRITE, first)] == [1, 1]
    assert tape.first(READ, first) == 2
    tape.arrived(READ, "a")
    tape.arrived(READ, "b")
    tape.arrived(READ, "c", number=9)
    tape.spoil("it slept")
    tape.close()
    tape.turn(1.0)
    tape.arrived(READ, "d")
    assert kept == [
        0.5,
        *((READ, first), (WRITE, first), (READ, first)),
        *((READ, 1, "a"), (READ, 2, "b"), (READ, 9, "c")),
        (SPOILED, 0, "it slept"),
    ]


def test_what_is_not_on_the_tape_any_more_is_lost() -> None:
    """By the name of the device: what waits, what asks, and what begins to wait."""
    over: list[str] = []
    player = Player([0.0, (READ, First(value=7))], lambda: over.append("over"))
    begun(player)
    assert player.has_first(READ)
    assert player.first(READ) == (1, First(value=7))
    assert player.first(READ) == (2, WAITS)
    ends: list[Any] = []
    player.expect(READ, 2, ends.append)
    player.expect(WRITE, 1, ends.append)
    player.end()
    player.end()
    player.expect(READ, 3, ends.append)
    errors = [error for _, error in ends]
    assert all(isinstance(error, DeviceLostError) for error in errors)
    assert ["sonar" in str(error) for error in errors] == [True, False, True]
    assert "motor" in str(errors[1])
    number, first = player.first(READ)
    assert number == 3
    assert isinstance(first.error, DeviceLostError)
    assert over == ["over"]


def test_what_threads_have_brought_comes_when_the_tape_is_over() -> None:
    """They wait for the turn in which it came in, and that does not come."""
    player = Player([0.0])
    door = begun(player)
    entry = Entry(1, ("thread", "drive", "1"), print, ())
    assert door.divert is not None
    door.divert(entry)
    assert door.brought == []
    player.end()
    assert door.brought == [entry]
    assert door.divert is None


def test_turns_come_at_their_moments() -> None:
    """One after the other, with what came in; until there is no more."""
    player = Player([1.0, (READ, 1, "a"), 2.0, (READ, 2, "b"), 3.0])
    begun(player)
    came: list[Any] = []
    player.listen(READ, came.append)
    assert (player.began, player.moment, player.turns) == (1.0, 1.0, 1)
    player.take()
    assert came == ["a"]
    assert player.next_turn() == 2.0
    player.take()
    assert came == ["a", "b"]
    assert player.reaches(2.5)
    assert (player.moment, player.next_turn()) == (3.0, None)
    assert not player.reaches(3.5)


def test_a_tape_that_cannot_be_read_ends_there() -> None:
    """It is a file of anybody; what came before it counts."""
    player = Player([1.0, 2.0, 7, 3.0])
    begun(player)
    assert player.error is None
    assert player.next_turn() == 2.0
    assert isinstance(player.error, TypeError)
    assert player.next_turn() is None
    missed = Player([1.0, (READ, 1, "nobody")])
    begun(missed)
    missed.take()
    assert missed.missed == 1
