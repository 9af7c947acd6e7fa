"""Recordings read back: whole ones, and what a cut file still has."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from esair.exceptions import RecordingBrokenError


class Recorded(NamedTuple):
    """An event of a recording; its value is plain: numbers, texts, lists, objects.

    Attributes:
        number: The number of the event.
        time: When, on the clock of the robot that recorded, in seconds.
        kind: What happened (a `esair.journal.Kind` as text).
        component: To which component.
        peer: The other one, if there is one.
        value: What it is about.
        text: Why.
    """

    number: int
    time: float
    kind: str
    component: str
    peer: str
    value: Any
    text: str


def records_of(path: Path) -> Iterator[Any]:
    """Yield the records of an MCAP file up to where it is cut or damaged."""
    from mcap.stream_reader import StreamReader

    with path.open("rb") as file:
        try:
            yield from StreamReader(file, emit_chunks=False).records
        except OSError:
            raise
        except Exception:  # the reader meets whatever the cut has left there
            return


def events_of(path: str | Path) -> Iterator[Recorded]:
    """Yield the events of a recording, as far as it is readable, in their order.

    Raises:
        RecordingBrokenError: It is no recording of esair at all.
    """
    from mcap.records import Channel, Header, Message

    topics: dict[int, str] = {}
    is_ours = False
    for record in records_of(Path(path)):
        if isinstance(record, Header):
            is_ours = record.profile == "esair"
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and is_ours:
            message = json.loads(record.data)
            told = message.get("esair", message)
            yield Recorded(
                told["number"],
                told["time"],
                told["kind"],
                told["component"],
                told["peer"],
                told.get("value"),
                told["text"],
            )
    if not is_ours:
        raise RecordingBrokenError(str(path), "it is no recording of esair")


def facts_of(path: str | Path) -> dict[str, dict[str, str]]:
    """Return the facts that a recording tells about itself, by name."""
    from mcap.records import Metadata

    return {
        record.name: dict(record.metadata)
        for record in records_of(Path(path))
        if isinstance(record, Metadata)
    }
