"""What an error says never forges a line of the log, in a traceback either."""

from __future__ import annotations

import io
import logging

import pytest

import esair
from esair.exceptions import told_traceback

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
