"""One segment of a recording: an MCAP file that survives the end of its process."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from esair.exceptions import RecordingError, describe
from esair.recording._plain import schema_of

CHUNK = 1 << 20  # The largest chunk in bytes; time ends it earlier (`Segment.flush`)

_json = json.JSONEncoder(allow_nan=False).encode


class _Out:
    """What the writer writes to; it keeps the error, which the writer would log."""

    def __init__(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        self._file = os.fdopen(descriptor, "w+b")
        with contextlib.suppress(OSError):  # not on every file system
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.size = self._place = 0
        self.error: OSError | None = None

    def write(self, data: bytes) -> int:
        self._keeping(self._file.write, data)
        self._place += len(data)
        self.size = max(self.size, self._place)
        return len(data)

    def seek(self, offset: int, whence: int = 0) -> int:
        self._keeping(self._file.seek, offset, whence)
        self._place = offset + (0, self._place, self.size)[whence]
        return self._place

    def flush(self) -> None:
        self._keeping(self._file.flush)

    def sync(self) -> None:
        self._keeping(os.fsync, self._file.fileno())

    def _keeping(self, call: Callable[..., object], *args: object) -> None:
        if self.error is None:
            try:
                call(*args)
            except OSError as error:
                self.error = error

    def close(self) -> None:
        self._file.close()


class Segment:
    """Writes messages to one file."""

    def __init__(self, path: Path) -> None:
        import foxglove
        from foxglove.mcap import MCAPWriteOptions
        from msgspec.json import Encoder

        self.path = path
        self.messages = 0  # How many messages were handed to the file
        try:
            self._out = _Out(path)
        except OSError as error:
            raise recording_error(path, error) from error
        self._channel_of = foxglove.Channel
        self._schema_of = foxglove.Schema
        # Held here: channels of a context that nobody holds are closed silently.
        self._context = foxglove.Context()
        self._channels: dict[str, Any] = {}
        self._encode = Encoder().encode
        self._writer = foxglove.open_mcap(
            self._out,  # type: ignore[arg-type]
            context=self._context,
            writer_options=MCAPWriteOptions(
                profile="esair", chunk_size=CHUNK, compression_threads=0
            ),
        )

    @property
    def size(self) -> int:
        """How many bytes the file has."""
        return self._out.size

    def note(self, name: str, facts: Mapping[str, str]) -> None:
        """Write facts about the whole recording; what is no text in them is escaped."""
        # The name of a file may be any bytes.
        texts = {
            k: v.encode(errors="backslashreplace").decode() for k, v in facts.items()
        }
        self._guarded(self._writer.write_metadata, name, texts)

    def write(self, topic: str, schema: str, message: Any, when: float) -> None:
        """Write a message."""
        try:
            data = self._encode(message)
        except (OverflowError, TypeError, UnicodeEncodeError):  # 65 bits, NumPy's
            data = _json(message).encode()
        channel = self._channels.get(topic)
        if channel is None:
            shape = {"title": schema, **schema_of(message)}
            channel = self._channels[topic] = self._channel_of(
                topic, schema=shape, message_encoding="json", context=self._context
            )
        self._guarded(channel.log, data, log_time=int(when * 1e9))
        self.messages += 1

    def write_bytes(self, topic: str, encoding: str, data: bytes, when: float) -> None:
        """Write bytes as a message of an encoding that is esair's own."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._channel_of(
                topic,
                schema=self._schema_of(name=encoding, encoding="", data=b""),
                message_encoding=encoding,
                context=self._context,
            )
        self._guarded(channel.log, data, log_time=int(when * 1e9))

    def flush(self) -> None:
        """End the chunk, so that what was written survives the process."""
        self._guarded(self._writer.flush)

    def sync(self) -> None:
        """Have the file survive the loss of power too."""
        self._guarded(self._out.sync)

    def close(self) -> None:
        """Write the index and close the file."""
        try:
            self._guarded(self._writer.close)
        finally:
            self._out.close()

    def _guarded(self, call: Any, *args: Any, **options: Any) -> None:
        try:
            call(*args, **options)
        except (OSError, RuntimeError) as error:
            raise recording_error(self.path, self._out.error or error) from error
        if self._out.error is not None:
            raise recording_error(self.path, self._out.error)


def recording_error(path: Path, error: Exception) -> RecordingError:
    """Return what ends a recording, with the kernel's words where there are some."""
    if isinstance(error, RecordingError):
        return error
    reason = error.strerror if isinstance(error, OSError) else None
    return RecordingError(str(path), reason or describe(error))
