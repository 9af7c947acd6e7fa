"""Lines of the log: who floods it leaves room for what others say."""

import asyncio
import logging
import re
from typing import Any, NoReturn

import pytest

import esair
from esair.journal import Beside

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
