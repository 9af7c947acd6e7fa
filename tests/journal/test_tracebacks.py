"""What an error says never forges a line of the log, in a traceback either."""

from __future__ import annotations

import asyncio
import io
import logging
from typing import Any

import attrs
import pytest

import esair
from esair.exceptions import line_of, told_traceback
from esair.journal import tell_where

pytestmark = [pytest.mark.promise("SEC-1"), pytest.mark.virtual_clock]

TEXT = "gone\n12:00:00 INFO all is well\x1b[2J\u202e\r\x85"


def raised() -> BaseException:
    """Return an error with a cause, a context, a note and a group of others."""
    try:
        try:
            try:
                raise OSError(5, TEXT)
            except OSError as error:
                raise ValueError(TEXT) from error
        except ValueError as error:
            error.add_note(TEXT)
            raise ExceptionGroup(TEXT, [error, KeyError(TEXT)])  # noqa: B904 - its context
    except ExceptionGroup as group:
        return group


def test_a_traceback_has_no_line_of_anybody_else() -> None:
    """Causes, contexts, notes and groups are told as Python does, each text escaped."""
    told = told_traceback(raised())
    lines = told.split("\n")

    assert all(line.isprintable() for line in lines)
    assert not any(line.lstrip(" |").startswith("12:00:00") for line in lines)
    assert told.count(r"gone\n12:00:00 INFO all is well\x1b[2J\u202e\r\x85") >= 4
    assert "The above exception was the direct cause" in told
    assert "During handling of the above exception" in told
    assert 'File "' in told
    assert "raise OSError(5, TEXT)" in told


def test_a_syntax_error_of_a_file_is_told_escaped() -> None:
    """Its text has lines of its own."""
    with pytest.raises(SyntaxError) as found:
        compile("x = \x1b[2J\u202e(", "file\n12:00:00.py", "exec")
    lines = told_traceback(found.value).split("\n")
    assert all(line.isprintable() for line in lines)
    assert not any(line.startswith("12:00:00") for line in lines)


class Says(esair.Behavior):
    """Fails with the words of its device."""

    async def run(self) -> None:
        raise OSError(TEXT)


async def test_any_handler_gets_it_escaped() -> None:
    """One of the user's own, with the formatter that Python has."""
    out = io.StringIO()
    handler = logging.StreamHandler(out)
    logging.getLogger().addHandler(handler)
    try:
        async with esair.Robot(behaviors=[Says()]):
            pass
    finally:
        logging.getLogger().removeHandler(handler)

    said = out.getvalue()
    assert "Traceback (most recent call last):" in said
    assert "\x1b" not in said
    assert "\u202e" not in said
    assert not any(line.startswith("12:00:00") for line in said.splitlines())


class Eyes(esair.Sensor[float]):
    """Has a mistake in its code, or no device."""

    def __init__(self, *, is_there: bool) -> None:
        super().__init__()
        self.is_there = is_there

    async def read(self) -> float:
        if not self.is_there:
            raise FileNotFoundError("/dev/video0")
        return {"left": 1.0}["right"]


@pytest.mark.parametrize("is_there", [True, False])
async def test_a_mistake_in_a_driver_is_told_with_its_line(
    caplog: pytest.LogCaptureFixture, is_there: bool
) -> None:
    """With the user's own line; a device that is not there has none."""
    look = esair.Behavior(name="look", reads={"eyes": esair.reads(float)})
    async with esair.Robot(resources=[Eyes(is_there=is_there)], behaviors=[look]):
        for _ in range(5):
            with pytest.raises(OSError, match=r"right|video0"):
                await look.eyes.read()
        await asyncio.sleep(0.05)

    record = next(each for each in caplog.records if "lost: " in each.getMessage())
    tell_where(record)
    _, *told = logging.Formatter().format(record).splitlines()
    place = 'in read: return {"left": 1.0}["right"]'
    assert [each.partition(", line ")[0] for each in told] == (
        [f"  where: {__file__}"] if is_there else []
    )
    assert all(each.endswith(place) for each in told)


OWN = "/robot/rover.py"
PACKAGE = "/robot/.venv/lib/site-packages/esair_arm/arm.py"


def file_told(*files: str) -> str:
    """Return the file that is told of an error: it was raised in the first of these."""
    names: dict[str, Any] = {}
    for file in files:
        body = "below()" if names else "raise ValueError('it')"
        names = {"below": names.get("go")}
        exec(compile(f"def go(): {body}", file, "exec"), names)
    with pytest.raises(ValueError, match="it") as caught:
        names["go"]()
    trace = caught.value.__traceback__
    assert trace is not None
    told = line_of(caught.value.with_traceback(trace.tb_next))  # without this function
    return told.partition(", line ")[0]


def test_of_what_is_installed_a_line_is_told_if_nothing_else_was() -> None:
    """As of a driver that is a package: who wrote a script is to mend that."""
    assert file_told(PACKAGE) == PACKAGE
    assert file_told(PACKAGE, OWN) == OWN
    assert file_told(OWN, PACKAGE) == OWN


@attrs.frozen
class Look(esair.Request[float]):
    """To be answered."""


class Blind(esair.Behavior):
    """Has a mistake in its answer."""

    @esair.answers
    async def look(self, request: Look) -> float:
        return {"left": 1.0}["right"]


async def test_who_asked_is_told_the_line_of_who_failed() -> None:
    """Its own line, in which it asks, is not the one to be mended."""
    asker = esair.Behavior(name="asker")
    async with esair.Robot(behaviors=[asker, Blind()]):
        with pytest.raises(esair.BehaviorFailedError) as found:
            await asker.ask("blind", Look())
    assert line_of(found.value).endswith('in look: return {"left": 1.0}["right"]')
