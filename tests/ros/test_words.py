"""What the process in ROS prints is text from outside."""

from __future__ import annotations

import asyncio
import logging
from types import SimpleNamespace
from typing import Any

import pytest

from esair.buses.ros._ros import Living

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("SEC-1", "ROS-2")
async def test_words_are_escaped_and_a_long_line_ends_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """No escape reaches the log raw; after a line that is too long others are heard."""
    caplog.set_level(logging.INFO, logger="esair")
    nobody: Any = None
    bus: Any = SimpleNamespace(name="ros")
    living = Living(bus, nobody, nobody, nobody, nobody)
    words = asyncio.StreamReader(limit=64)

    living.hear(words)
    for each in (b"\x1b[31mred\n", b"x" * 200 + b"\n", b"last\n"):
        words.feed_data(each)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
    words.feed_eof()
    assert living._hearing is not None
    await living._hearing

    told = [record.getMessage() for record in caplog.records]
    assert told == ["ros: \\x1b[31mred", "ros: last"]
