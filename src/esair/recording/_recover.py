"""A cut recording made whole: everything that is readable, with an index."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from esair.exceptions import RecordingBrokenError
from esair.recording._reading import (
    MAGIC,
    Fact,
    Message,
    Shown,
    Start,
    Topic,
    need_unpackers,
    parts_of,
    segments_of,
)

RECOVERED = "-recovered"
"""What the name of a recovered file has more than that of the original."""

OLD_FILES = 16
"""How many recordings beside the new one are looked at, whether they were cut."""


class Recovered(NamedTuple):
    """What was recovered.

    Attributes:
        path: The new file.
        messages: How many messages it has.
        was_whole: Whether the original had its end already, and nothing was damaged.
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
        return file.read() == MAGIC
    return False


def left_cut(folder: Path) -> list[Path]:
    """Return the newest recordings of a folder that were cut and are not recovered.

    One that another robot is writing is not cut; what cannot be read, or is not of this
    user, is left alone, and so is a folder where somebody else could have put it.
    """
    try:
        state = folder.stat()
    except OSError:
        return []
    others = stat.S_IWGRP | stat.S_IWOTH
    if state.st_mode & others and not state.st_mode & stat.S_ISVTX:
        return []
    newest = sorted(folder.glob("*.mcap"))[-OLD_FILES:]
    return [path for path in newest if _is_cut(path)]


def _is_cut(path: Path) -> bool:
    try:
        if os.path.lexists(path.with_stem(f"{path.stem}{RECOVERED}")):
            return False
        own = os.O_NOFOLLOW | os.O_NONBLOCK
        with open(path, "rb", opener=lambda at, how: os.open(at, how | own)) as file:
            state = os.fstat(file.fileno())
            if not stat.S_ISREG(state.st_mode) or state.st_uid != os.geteuid():
                return False
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)  # Its writer's alone
            return not _ends(file)
    except OSError:
        return False


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[BinaryIO]:
    """Write a file under another name first; it is there as a whole or not at all.

    It is this user's alone, and whatever had its name is replaced, never written to: a
    link that somebody has put there leads nowhere. A device or a pipe stays what it is:
    that is an `OSError`.
    """
    of_process = path.is_symlink() and os.readlink(path).startswith("/proc/")
    if of_process or (path.exists() and not path.is_file()):
        told = "expected a file, not a device, pipe or folder"
        raise FileExistsError(errno.EEXIST, told, str(path))
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    partial = f".{path.name}.{os.urandom(6).hex()}.part"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        descriptor = os.open(partial, flags, 0o600, dir_fd=folder)
        try:
            with os.fdopen(descriptor, "wb") as file:
                yield file
            os.replace(partial, path.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException as error:
            os.unlink(partial, dir_fd=folder)
            if isinstance(error, OSError) and not error.filename:  # as of a full disk
                error.filename = str(path)
            raise
    finally:
        os.close(folder)


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
    path = next(segments_of(Path(path)))
    new = Path(target) if target else path.with_stem(f"{path.stem}{RECOVERED}")
    with replaced(new) as file:
        messages, was_whole = _copied(path, file)
    return Recovered(new, messages, was_whole)


def _copied(path: Path, file: BinaryIO) -> tuple[int, bool]:
    """Write what is readable of a recording; return how much it is, and if it is all."""
    need_unpackers()
    from mcap.writer import CompressionType, Writer

    writer = Writer(file, compression=CompressionType.ZSTD)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    messages = 0
    begun = was_whole = False
    for part in parts_of(path):
        if isinstance(part, Start):
            if begun:
                continue
            writer.start(part.profile, "esair recover")
            begun = True
        elif not begun:
            break
        elif isinstance(part, Shown):
            schemas[part.number] = writer.register_schema(
                part.name, part.encoding, part.data
            )
        elif isinstance(part, Topic):
            if part.number not in channels:
                channels[part.number] = writer.register_channel(
                    part.name, part.encoding, schemas.get(part.schema, 0), part.facts
                )
        elif isinstance(part, Message):
            if part.channel in channels:
                writer.add_message(
                    channels[part.channel],
                    part.logged,
                    bytes(part.data),
                    part.published,
                    part.sequence,
                )
                messages += 1
        elif isinstance(part, Fact):
            writer.add_metadata(part.name, part.told)
        else:
            was_whole = True
    if not begun:
        raise RecordingBrokenError(str(path), "it is no recording of esair")
    finish: Any = writer.finish  # it says no types
    finish()
    return messages, was_whole
