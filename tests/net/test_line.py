"""The ways to one endpoint: when new ones are opened, and when they are closed."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from typing import Any, cast

import pytest
from tests.net.parts import free_port

from esair.buses.peer import Network, _line
from esair.buses.peer._line import PAUSE, Line, pause

pytestmark = pytest.mark.promise("NET-3")

TIMEOUT = 0.2


class FakeWay:
    """A way that remembers what it was told."""

    def __init__(self) -> None:
        self.heard, self.hears, self.is_open = 0.0, True, True

    def hear(self, wanted: bool) -> None:
        self.hears = wanted

    def close(self) -> None:
        self.is_open = False


class Place:
    """An endpoint, as well as it can be reached, and the line to it; time is made up."""

    def __init__(self, line: Line, made: list[FakeWay]) -> None:
        self.line, self.made = line, made
        self.now = 100.0
        self.answer: bool | None = None
        """What becomes of a knock that begins now."""
        self.knocks: list[bool | None] = []
        self.open = 0

    def pass_by(self, seconds: float) -> None:
        for _ in range(round(seconds / PAUSE)):
            self.now += PAUSE
            self.line.step(self.now)

    def say(self, way: FakeWay) -> None:
        """Let something come by a way, first."""
        way.heard = self.now
        self.line.best = cast(Any, way)

    def living(self) -> list[FakeWay]:
        return [each for each in self.made if each.is_open]


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> Iterator[Place]:
    """A line whose peer is silent from the beginning."""
    made: list[FakeWay] = []

    def make(_line: Line) -> Any:
        made.append(FakeWay())
        return made[-1]

    line = Line("127.0.0.1", 7447, TIMEOUT, make)
    found = Place(line, made)

    class FakeKnock:
        def __init__(self, *_: Any) -> None:
            self._answer = found.answer
            found.knocks.append(found.answer)
            found.open += 1

        def answer(self) -> bool | None:
            return self._answer

        def close(self) -> None:
            found.open -= 1

    monkeypatch.setattr(_line, "Knock", FakeKnock)
    line.silent = line.restless = True
    yield found
    line.end()
    assert found.open == 0


def test_nothing_is_opened_in_a_cut(place: Place) -> None:
    """A packet of a cut costs a second: only knocks are sent, and given up."""
    place.pass_by(2.0)
    assert place.made == []
    assert len(place.knocks) == round(2.0 / PAUSE)
    assert place.open <= TIMEOUT / PAUSE + 2


def test_several_ways_are_opened_when_it_can_be_reached(place: Place) -> None:
    """The next knock connects, however long the cut was."""
    for length in (0.3, 3.0, 30.0):
        place.pass_by(length)
        place.answer = True
        count = len(place.made)
        place.pass_by(0.1)
        assert len(place.made) == count + 5
        place.answer = None
        place.pass_by(2.0)  # it is cut again


def test_a_peer_that_is_stopped_is_waited_for(place: Place) -> None:
    """Knocks connect and nobody speaks: what it has to refuse afterwards is little."""
    place.answer = True
    place.pass_by(10.0)
    assert len(place.made) == len(place.living()) == 5
    assert len(place.knocks) <= 11


def test_a_way_that_was_good_outlives_a_stop(place: Place) -> None:
    """That on which it was heard is kept, and heard."""
    place.answer = True
    place.pass_by(0.2)
    good = place.made[3]
    for _ in range(9):
        place.say(good)
        place.line.silent = False
        place.pass_by(0.1)
        place.line.silent = True
        place.pass_by(1.0)
    assert good.is_open
    assert good.hears
    assert len(place.living()) <= 22


def test_two_ways_stay_when_all_is_well(place: Place) -> None:
    """For a while all are heard, then that by which the newest came first."""
    place.answer = True
    place.pass_by(0.2)
    place.line.silent = False
    for way in (*place.made, place.made[2]):
        place.say(way)
    place.pass_by(0.4)
    assert place.line.restless
    assert all(each.is_open and each.hears for each in place.made)
    place.pass_by(0.2)
    assert not place.line.step(place.now)
    assert not place.line.restless
    assert [each for each in place.living() if each.hears] == [place.made[2]]
    assert len(place.living()) == 2
    assert place.open == 0


def test_a_way_that_is_broken_is_closed_when_it_is_mended(place: Place) -> None:
    """To close it before that holds threads of zenoh up; after ten seconds it is closed."""
    place.answer = True
    place.pass_by(0.2)
    place.line.silent = False
    for way in place.made[:3]:
        place.say(way)
    place.pass_by(0.7)
    assert place.line.step(place.now)
    assert len(place.living()) == 4
    assert [each.hears for each in place.made[3:]] == [True, True]
    place.made[3].heard = place.now
    place.pass_by(0.1)
    assert len(place.living()) == 3
    place.pass_by(10.0)
    assert not place.line.step(place.now)
    assert len(place.living()) == 2


def test_a_port_where_nobody_listens_is_tried_on(place: Place) -> None:
    place.answer = False
    place.pass_by(1.0)
    assert place.made == []
    place.answer = True
    place.pass_by(0.1)
    assert len(place.made) == 5


def test_a_line_goes_on_where_no_way_can_be_made(place: Place) -> None:
    """Those that were made are kept, and the rest is tried again."""
    place.answer = True
    make, place.line._make = place.line._make, lambda line: 1 / 0  # type: ignore[assignment,return-value]
    place.pass_by(0.05)
    with pytest.raises(ZeroDivisionError):
        place.pass_by(0.05)
    place.line._make = make
    place.pass_by(1.2)
    assert len(place.living()) == 5


def test_an_answer_to_a_knock_is_not_waited_for() -> None:
    """Between two knocks it is looked at as soon as it comes; the next one has its time."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        line = Line("127.0.0.1", server.getsockname()[1], TIMEOUT, _made)
        line.silent = True
        line.step(100.0)
        began = time.monotonic()
        pause([line])
        assert time.monotonic() - began < 0.8 * PAUSE
        line.step(100.001)
        assert len(line.end()) == 5
    line = Line("127.0.0.1", free_port(), TIMEOUT, _made)
    line.silent = True
    for now in (100.0, 100.001, 100.002):
        line.step(now)
    assert line.knocks == []  # nobody listens: there is no haste
    line.end()


def test_where_no_way_leads_nobody_is_in_haste() -> None:
    """As without a cable: a knock that cannot begin has its answer, once in a while."""
    line = Line("255.255.255.255", 7447, TIMEOUT, _made)
    line.silent = True
    began, steps = time.monotonic(), 0
    while time.monotonic() - began < 4.0 * PAUSE:
        line.step(time.monotonic())
        pause([line])
        steps += 1
    assert steps < 20
    assert len(line.knocks) <= 1
    line.end()


def test_who_keeps_the_lines_ends_with_them_at_any_moment() -> None:
    """Also where they end while it begins to look at them: its end is waited for."""
    network = Network(me="base", connect=["tcp/127.0.0.1:7447"])
    network._lines = (network._line(network.connect[0]),)

    class Wake(threading.Event):
        def clear(self) -> None:
            network._lines = ()
            self.set()
            super().clear()

    network._wake = Wake()
    keeper = threading.Thread(target=network._keep, daemon=True)
    keeper.start()
    keeper.join(1.0)
    assert not keeper.is_alive()


def _made(_line: Line) -> Any:
    return FakeWay()


def test_a_knock_is_a_connection() -> None:
    """It connects where somebody listens, and not where nobody does."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()
        knock = _line.Knock(socket.AF_INET, address)
        assert knock.answer() is True
        knock.close()
    knock = _line.Knock(socket.AF_INET, ("127.0.0.1", free_port()))
    assert knock.answer() is False
    knock.close()
