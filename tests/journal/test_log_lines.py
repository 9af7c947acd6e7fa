"""Lines of the log: who floods it leaves room for what others say."""

import asyncio
import logging
import re
import threading
from typing import Any, NoReturn

import pytest

import esair
from esair.journal import Beside, Kind, text_of

FLOOD = 500
CLOCKS = "virtual_clock", "real_clock"


@pytest.mark.fault("P05")
@pytest.mark.real_clock
def test_a_source_that_floods_the_log_is_shown_now_and_then_and_counted() -> None:
    """A cable that wiggles says so some times a second; how often it did is told."""
    shown: list[str] = []
    beside = Beside(lambda record: shown.append(record.getMessage()))
    for number in range(FLOOD):
        text = f"sonar: lost: wiggle {number}"
        beside.hand(logging.makeLogRecord({"msg": text, "levelno": logging.WARNING}))
    beside.hand(logging.makeLogRecord({"msg": "wheels: lost: unplugged"}))
    beside.close(5.0)

    assert "wheels: lost: unplugged" in shown
    lines = [each for each in shown if each.startswith("sonar: lost")]
    told = [each for each in shown if each.endswith("were left out: 'sonar: lost'")]
    left = sum(int(number) for each in told for number in re.findall(r"^\d+", each))
    assert len(lines) + left == FLOOD
    assert len(lines) <= FLOOD / 10


@pytest.mark.fault("P05")
@pytest.mark.real_clock
def test_twenty_lines_of_a_source_in_a_second_are_no_flood() -> None:
    """All are shown, and nothing is said of them."""
    shown: list[str] = []
    beside = Beside(lambda record: shown.append(record.getMessage()))
    lines = [f"sonar: lost: wiggle {number}" for number in range(20)]
    for each in lines:
        beside.hand(logging.makeLogRecord({"msg": each}))
    beside.close(5.0)
    assert shown == lines


@pytest.mark.fault("P05")
@pytest.mark.real_clock
def test_what_came_too_fast_is_told_once() -> None:
    """A thousand lines may wait for one that is slow to be shown; those after them are
    counted."""
    shown, begun, go = list[str](), threading.Event(), threading.Event()

    def show(record: logging.LogRecord) -> None:
        begun.set()
        go.wait(10.0)
        shown.append(record.getMessage())

    beside = Beside(show)
    beside.hand(logging.makeLogRecord({"msg": "first"}))
    assert begun.wait(10.0)
    lines = [f"source {number}: lost" for number in range(1003)]
    for each in lines:
        beside.hand(logging.makeLogRecord({"msg": each}))
    assert beside.dropped == 3
    go.set()
    beside.close(10.0)
    told = "3 lines were dropped: they came too fast"
    assert shown == ["first", told, *lines[:1000]]


@pytest.mark.real_clock
def test_what_is_called_beside_comes_after_what_waits() -> None:
    """So a robot knows when its last line is shown; what raises ends nothing."""
    shown, then = list[str](), list[list[str]]()

    def broken() -> None:
        raise ValueError("no")

    beside = Beside(lambda record: shown.append(record.getMessage()))
    beside.hand(logging.makeLogRecord({"msg": "first"}))
    beside.call(broken)
    beside.call(lambda: then.append(list(shown)))
    beside.hand(logging.makeLogRecord({"msg": "second"}))
    beside.close(5.0)
    assert then == [["first"]]
    assert shown == ["first", "second"]


def test_a_line_that_cannot_be_shown_is_told_as_such() -> None:
    """By its logger, and what was wrong; all others have their own text."""
    fine = logging.makeLogRecord({"msg": "%s is lost", "args": ("sonar",)})
    wrong = logging.makeLogRecord({"name": "mine", "msg": "%d", "args": ("sonar",)})
    assert text_of(fine) == "sonar is lost"
    assert text_of(wrong).startswith("a line of 'mine' cannot be shown: TypeError")


@pytest.mark.parametrize(
    "clock", [pytest.param(each, marks=getattr(pytest.mark, each)) for each in CLOCKS]
)
async def test_lines_for_who_looks_for_a_mistake_are_no_events(
    clock: str, caplog: pytest.LogCaptureFixture
) -> None:
    """What is logged with the level INFO, or above, is."""
    caplog.set_level(logging.DEBUG, "esair")
    told: list[tuple[str, str, str]] = []
    async with esair.Robot() as robot:
        robot.journal.listen(
            lambda event: told.append((event.component, event.peer, event.text)),
            kinds=[Kind.LOG],
        )
        logging.getLogger("esair.mine").debug("at length")
        logging.getLogger("esair.mine").info("in short")
        await asyncio.sleep(0.01)
    assert ("esair.mine", "info", "in short") in told
    assert not [text for _, _, text in told if text == "at length"]


class Handling(logging.Handler):
    """Fails at each line."""

    def emit(self, record: logging.LogRecord) -> NoReturn:
        raise ZeroDivisionError("of a handler")


def filtering(record: logging.LogRecord) -> NoReturn:
    raise ZeroDivisionError("of a filter")


@pytest.fixture(params=["handler", "filter"])
def fails(request: pytest.FixtureRequest) -> Any:
    """Log with a handler, or a filter, of the user's that raises."""
    log, handler = logging.getLogger("esair"), Handling()
    if request.param == "handler":
        log.addHandler(handler)
    else:
        log.addFilter(filtering)
    yield request.param
    log.removeHandler(handler)
    log.removeFilter(filtering)


@pytest.mark.promise("ROB-3")
@pytest.mark.parametrize(
    "clock", [pytest.param(each, marks=getattr(pytest.mark, each)) for each in CLOCKS]
)
async def test_a_log_that_raises_ends_nobody(
    clock: str, fails: str, fake_sensor: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """A loss is told at the border, where an error would end the loop; it is printed."""
    sonar = fake_sensor("sonar", 1.0)
    async with esair.Robot(resources=[sonar]) as robot:
        sonar.unplug()
        await asyncio.sleep(0.05)
        assert robot.resources.query("sonar").state is esair.ResourceState.LOST
    assert f"ZeroDivisionError: of a {fails}" in capsys.readouterr().err


class Noting(logging.Handler):
    """Notes each line and the thread that shows it; at some lines it logs itself."""

    def __init__(self) -> None:
        super().__init__()
        self.shown: list[tuple[str, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage()
        self.shown.append((text, threading.current_thread().name))
        if text == "asks":
            logging.getLogger("esair").warning("answers")


@pytest.fixture
def noting() -> Any:
    log, handler = logging.getLogger("esair"), Noting()
    log.addHandler(handler)
    yield handler
    log.removeHandler(handler)


@pytest.mark.real_clock
async def test_lines_are_shown_beside_the_robots_as_long_as_one_runs(
    noting: Noting,
) -> None:
    """By a thread of their own, one for all; before and after by whoever writes them."""
    log, here = logging.getLogger("esair"), threading.current_thread().name
    async with esair.Robot():
        async with esair.Robot(name="other"):
            log.warning("both")
        log.warning("one")
    log.warning("none")
    assert [each for each in noting.shown if each[0] in {"both", "one", "none"}] == [
        ("both", "esair-log"),
        ("one", "esair-log"),
        ("none", here),
    ]


@pytest.mark.real_clock
async def test_a_handler_may_log_itself(noting: Noting) -> None:
    """What it says is shown, too."""
    async with esair.Robot():
        logging.getLogger("esair").warning("asks")
    assert "answers" in [text for text, _ in noting.shown]
