"""Lines of the log: who floods it leaves room for what others say."""

import logging
import re

import pytest

from esair.journal import Beside

FLOOD = 500


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
