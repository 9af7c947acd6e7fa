"""What the process in ROS prints is text from outside."""

from __future__ import annotations

import asyncio
import logging
import socket
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


@pytest.mark.promise("ROS-2")
@pytest.mark.parametrize(
    ("line", "level"),
    [
        ("[WARN] [1.5] [rover]: New publisher, incompatible QoS", logging.WARNING),
        ("[ERROR] [1.5] [rover]: /number: does not fit", logging.ERROR),
        ("[FATAL] [1.5] [rover]: no more", logging.CRITICAL),
        ("[RTPS_TRANSPORT_SHM Error] Failed init_port", logging.ERROR),
        ("[INFO] [1.5] [rover]: WARN is a word", logging.INFO),
        ("[INFO] [1.5] [rover]: the pump says [ERROR]", logging.INFO),
    ],
)
async def test_a_line_is_as_grave_as_ros_says(
    caplog: pytest.LogCaptureFixture, line: str, level: int
) -> None:
    """A warning of ROS, or of DDS below it, is one of the robot."""
    caplog.set_level(logging.INFO, logger="esair")
    nobody: Any = None
    bus: Any = SimpleNamespace(name="ros")
    living = Living(bus, nobody, nobody, nobody, nobody)
    words = asyncio.StreamReader()

    living.hear(words)
    words.feed_data(line.encode() + b"\n")
    words.feed_eof()
    assert living._hearing is not None
    await living._hearing

    assert [each.levelno for each in caplog.records] == [level]


@pytest.mark.real_clock
@pytest.mark.promise("BS-10", "ROS-1")
async def test_what_comes_once_has_room_beside_large_readings() -> None:
    """Who asked would wait for ever for an answer that was dropped for an image."""
    mine, its = socket.socketpair()
    reader, writer = await asyncio.open_connection(sock=mine)
    nobody: Any = None
    living = Living(nobody, nobody, reader, writer, writer)
    head = [0] * 5
    with its:
        assert living.send(["publish", *head, "/image", 0.0, "x" * (3 << 20)])
        assert not living.send(["publish", *head, "/image", 0.0, ""])
        assert living.send(["answer", *head, 1, "answered", None])
        writer.transport.abort()
        await asyncio.sleep(0)
