"""A cut recording made whole: everything that is readable, with an index."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from esair.exceptions import RecordingBrokenError
from esair.recording._reading import records_of, segments_of

RECOVERED = "-recovered"
"""What the name of a recovered file has more than that of the original."""

OLD_FILES = 16
"""How many recordings beside the new one are looked at, whether they were cut."""


class Recovered(NamedTuple):
    """What was recovered.

    Attributes:
        path: The new file.
        messages: How many messages it has.
        was_whole: Whether the original had its end already.
    """

    path: Path
    messages: int
    was_whole: bool


def is_whole(path: Path) -> bool:
    """Tell whether a recording was closed in order: it ends as MCAP files end."""
    with path.open("rb") as file:
        return _ends(file)


def _ends(file: BinaryIO) -> bool:
    with contextlib.suppress(OSError):
        file.seek(-8, os.SEEK_END)
        return file.read() == b"\x89MCAP0\r\n"
    return False


def left_cut(folder: Path) -> list[Path]:
    """Return the newest recordings of a folder that were cut and are not recovered.

    One that another robot is writing is not cut; what cannot be read is left alone.
    """
    return [
        path for path in sorted(folder.glob("*.mcap"))[-OLD_FILES:] if _is_cut(path)
    ]


def _is_cut(path: Path) -> bool:
    try:
        if not path.is_file() or path.with_stem(f"{path.stem}{RECOVERED}").exists():
            return False
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)  # Its writer has it alone
            return not _ends(file)
    except OSError:
        return False


def recover(path: str | Path, target: str | Path | None = None) -> Recovered:
    """Write an indexed file with all that is readable; the original is untouched.

    Args:
        path: A recording, cut anywhere. Where it was deleted to make room, its oldest
            segment that is left.
        target: The new file; beside the original, with ``-recovered`` in its name,
            unless given.

    Raises:
        RecordingBrokenError: Not even its beginning is there.
    """
    from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
    from mcap.writer import CompressionType, Writer

    path = next(segments_of(Path(path)))
    new = Path(target) if target else path.with_stem(f"{path.stem}{RECOVERED}")
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    messages = 0
    begun = False
    partial = new.with_suffix(".part")
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        for record in records_of(path):
            if isinstance(record, Header):
                writer.start(record.profile, "esair recover")
                begun = True
            elif not begun:
                break
            elif isinstance(record, Schema):
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = writer.register_channel(
                    record.topic,
                    record.message_encoding,
                    schemas.get(record.schema_id, 0),
                    dict(record.metadata),
                )
            elif isinstance(record, Message) and record.channel_id in channels:
                writer.add_message(
                    channels[record.channel_id],
                    record.log_time,
                    record.data,
                    record.publish_time,
                    record.sequence,
                )
                messages += 1
            elif isinstance(record, Metadata):
                writer.add_metadata(record.name, dict(record.metadata))
            elif isinstance(record, Attachment):
                writer.add_attachment(
                    record.create_time,
                    record.log_time,
                    record.name,
                    record.media_type,
                    record.data,
                )
        if begun:
            finish: Any = writer.finish  # it says no types
            finish()
    if not begun:
        partial.unlink()
        raise RecordingBrokenError(str(path), "it is no recording of esair")
    partial.replace(new)
    return Recovered(new, messages, is_whole(path))
