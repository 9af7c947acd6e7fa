"""The recorder: it hears the journal and writes what it hears, in a thread of its own.

It writes segments: MCAP files that survive the end of its process.
"""

from __future__ import annotations

import collections
import contextlib
import fcntl
import hashlib
import inspect
import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from esair.codec import kinds_of
from esair.exceptions import RecordingError, describe
from esair.journal import Event, Journal
from esair.loop import TapeWriter
from esair.messages import Recording
from esair.recording._messages import plain, schema_of, seen_as, size_of
from esair.recording._reading import TURNS, numbers_of
from esair.recording._recover import left_cut
from esair.recording._turns import GIVEN, HELD, TOPIC, Turns, bulk_of

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
        is_known = topic in self._channels
        shape = None if is_known else {"title": schema, **schema_of(message)}
        self._log(topic, "json", shape, data, when)

    def write_bytes(self, topic: str, encoding: str, data: bytes, when: float) -> None:
        """Write bytes as a message of an encoding that is esair's own."""
        shape = self._schema_of(name=encoding, encoding="", data=b"")
        self._log(topic, encoding, shape, data, when)

    def _log(
        self, topic: str, encoding: str, shape: Any, data: bytes, when: float
    ) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._channel_of(
                topic, schema=shape, message_encoding=encoding, context=self._context
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


BACKLOG = 65_536
"""How many events may wait to be written; those that come then are dropped, and counted.

`HELD` bounds the bytes of pictures among them.
"""

FLUSH = 0.2  # How often what was written is made to survive the process, in seconds
SYNC = 1.0  # How often it is made to survive the loss of power, in seconds

FULL = 4096
"""How many events may wait where time is virtual: it waits for the recorder then."""

LAST = 2.0
"""How long the end may take to write what waits, in seconds; the rest is dropped."""

PATIENT = 60.0  # The same where time is virtual

SLICE = 0.0004
"""How long events are written at once, in seconds: who computes holds up the loop."""

TRIES = 100  # Free names of a file that others take first, until it is an error

LOOK = 0.03  # How long it waits for more where everything is written, in seconds

VALUE_LIMIT = 1 << 20
"""The greatest size of a message in bytes; a larger value is left out, and told once."""

LOST = "events were not recorded: they came faster than they could be written"

_PAUSE = 0.0001

_log = logging.getLogger("esair")


class Recorder:
    """Writes the journal of one robot to a file, until it is closed or cannot.

    Recording changes nothing: the recorder hears, and its thread writes.

    Args:
        recording: Where, and within which bounds.
        journal: What it hears.
        name: The name of the robot.
        facts: What else is written: versions, configuration, seed.
        components: Returns the components of the robot; what they declare is kept.
        waits: Whether the loop waits for it: its time is virtual.
    """

    def __init__(
        self,
        recording: Recording,
        journal: Journal,
        *,
        name: str = "robot",
        facts: Iterable[tuple[str, dict[str, str]]] = (),
        components: Callable[[], Iterable[Any]] = tuple,
        waits: bool = False,
    ) -> None:
        self.recording = recording
        self.written: int = 0
        """How many events are in the file."""
        self.dropped: int = 0
        """How many were not written: too many waited."""
        self.left_out: int = 0
        """How many values could not be encoded, or were too large."""
        self.error: RecordingError | None = None
        """Why the recording has ended early; None if it has not."""
        self.path: Path = _place(recording.path, name)
        self._journal = journal
        self._facts = [*facts]
        self._components = components
        self._waits = waits
        self._segments: collections.deque[Path] = collections.deque()
        self._number = 0
        self._waiting: collections.deque[Event] = collections.deque()
        self._came = self._went = 0  # Bytes of pictures: one thread adds to each
        self._told_once: set[str] = set()
        self._offset = 0.0
        self._turns: Turns | None = None
        self._over = threading.Event()
        self._is_late = False  # The end has come, and takes no longer
        self._told_loss = False
        self._segment = self._first_segment(name)
        self._thread = threading.Thread(
            target=self._work, name="esair-recorder", daemon=True
        )
        self._listener = journal.listen(self._hear, backlog=BACKLOG)
        self._listener.is_waited_for = waits

    def start(self, now: float) -> None:
        """Begin to write.

        Args:
            now: The robot's clock at this moment, to tell wall time from it.
        """
        self._offset = time.time() - now
        facts = {"offset": repr(self._offset), "python": sys.version.split()[0]}
        self._facts.append(("clock", {**facts, "run": os.urandom(8).hex()}))
        _log.info("recording: %s", self.path)
        self._thread.start()

    def keep_turns(self) -> TapeWriter:
        """Return what the event loop writes its turns on, for an exact replay."""
        self._turns = Turns(kinds_of(self._components, GIVEN))
        return self._turns.tape

    def note(self, name: str, facts: dict[str, str]) -> None:
        """Write facts that are known only now; before `start`."""
        self._facts.append((name, facts))

    def close(self, timeout: float | None = None) -> bool:
        """Write what waits, and the index; tells whether that was done in time.

        What cannot be written in time is dropped, and the recording says so.
        """
        self._listener.stop()
        self._over.set()
        if self._thread.ident is None:
            return True
        if timeout is None:
            timeout = PATIENT if self._waits else LAST
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._is_late = True
            self._thread.join(timeout / 2)
        return not self._thread.is_alive()

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "written": self.written,
            "dropped": self.dropped + self._listener.dropped,
            "left_out": self.left_out,
        }

    def lost(self) -> str:
        """Return what the recording lacks, in words; empty if nothing."""
        if self.error is not None:
            return f"{self.error}; what came then is not in it"
        if self._thread.is_alive():
            return f"recording {self.path}: its end could not be written in time"
        count = self.counts()["dropped"]
        return f"recording {self.path}: {count} {LOST}" if count else ""

    # In the loop.

    def _hear(self, event: Event) -> None:
        size = bulk_of(event.value)
        if self._waits and len(self._waiting) >= FULL:
            while len(self._waiting) > FULL // 2 and self._thread.is_alive():
                time.sleep(_PAUSE)
        if len(self._waiting) >= BACKLOG or self._came - self._went + size > HELD:
            self.dropped += 1
        else:
            self._came += size
            self._waiting.append(event)

    # In the thread.

    def _work(self) -> None:
        try:
            self._write_all()
        except Exception as error:  # whatever it is: the robot goes on
            self.error = recording_error(self._segment.path, error)
            self._listener.stop()
            with contextlib.suppress(RecordingError, OSError):
                self._segment.close()
            self._waiting.clear()
            _log.error("%s; the robot goes on without it", self.error)

    def _recover_old(self) -> None:
        """Have a process make whole what an earlier robot has left cut."""
        cut = [str(path) for path in left_cut(self.path.parent)]
        if cut:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "esair.recording", *cut],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
            threading.Thread(
                target=process.wait, name="esair-recover", daemon=True
            ).start()

    def _write_all(self) -> None:
        self._recover_old()
        for name, facts in self._facts:
            self._segment.note(name, facts)
        flushed = synced = time.monotonic()
        while True:
            over = self._over.is_set()
            now = time.monotonic()
            until = now + SLICE
            while self._waiting and now < until:
                self._write(self._waiting.popleft())
                now = time.monotonic()
            if now - flushed >= FLUSH:
                flushed = now
                self._write_turns()
                self._segment.flush()
            if now - synced >= SYNC:
                synced = now
                self._tell_loss()
                self._segment.sync()
                self._make_room()
            if not over:
                if not self._waiting:
                    self._over.wait(LOOK)
                elif not self._waits:
                    time.sleep(_PAUSE)
            elif self._is_late or not self._waiting:
                self._write_end()
                return

    def _write_end(self) -> None:
        while self._waiting:  # there is no time left for them
            self._waiting.popleft()
            self.dropped += 1
        self._write_turns()
        chunks = 0 if self._turns is None else self._turns.chunks
        counts = {**self.counts(), "events": self._journal.number, "turns": chunks}
        self._segment.note("end", {k: str(v) for k, v in counts.items()})
        self._segment.close()

    def _tell_loss(self) -> None:
        """Say once, while it runs, that events are lost; the stop says how many."""
        if not self._told_loss and self.counts()["dropped"]:
            self._told_loss = True
            _log.warning("recording %s: %s", self.path, LOST)

    def _write_turns(self) -> None:
        """Write all turns until now."""
        turns = self._turns
        while turns is not None and (data := turns.chunk()):
            self._segment.write_bytes(TOPIC, TURNS, data, time.time())
            time.sleep(_PAUSE)

    def _write(self, event: Event) -> None:
        self._went += bulk_of(event.value)
        try:
            self._segment.write(
                *seen_as(event, self._offset, lambda value: self._bounded(event, value))
            )
            self.written += 1
        except RecordingError:
            raise
        except Exception as error:  # a value may be an object of any class
            self._leave_out(event, describe(error))
            return
        if self._segment.size >= self.recording.segment:
            self._segment.close()
            self._segment = self._next_segment()
            for name, facts in self._facts:
                self._segment.note(name, facts)
            self._make_room()

    def _bounded(self, event: Event, value: Any) -> Any:
        size = size_of(value)
        if size > VALUE_LIMIT:
            self._leave_out(event, f"{size} bytes, at most {VALUE_LIMIT} are recorded")
            return None
        return plain(value)

    def _leave_out(self, event: Event, why: str) -> None:
        self.left_out += 1
        if event.component not in self._told_once:
            self._told_once.add(event.component)
            _log.warning(
                "recording: a value of %s is left out: %s", event.component, why
            )

    # Segments.

    def _first_segment(self, name: str) -> Segment:
        for _ in range(TRIES):
            try:
                return self._next_segment()
            except RecordingError as error:
                if not isinstance(error.__cause__, FileExistsError):
                    raise
            # Another robot, which starts at the same moment, was quicker.
            self._number, self.path = 0, _place(self.recording.path, name)
        return self._next_segment()

    def _next_segment(self) -> Segment:
        self._number += 1
        path = self.path
        if self._number > 1:
            path = path.with_stem(f"{path.stem}.{self._number}")
        segment = Segment(path)
        self._segments.append(path)
        return segment

    def _make_room(self) -> None:
        """Let the oldest segments go while there are too many bytes, or too few free."""
        while len(self._segments) > 1:
            total = sum(path.stat().st_size for path in self._segments if path.exists())
            if total <= self.recording.max_bytes and not self._is_full():
                return
            oldest = self._segments.popleft()
            oldest.unlink(missing_ok=True)
            _log.info("recording: %s was deleted to make room", oldest.name)
        if self._is_full():
            told = f"less than {self.recording.min_free} bytes are free on the disk"
            raise RecordingError(str(self._segment.path), told)

    def _is_full(self) -> bool:
        state = os.statvfs(self.path.parent)
        return state.f_bavail * state.f_frsize < self.recording.min_free


def _place(path: Path, name: str) -> Path:
    """Return a file that is not there yet; what is not named ``.mcap`` is a folder."""
    is_folder = path.suffix != ".mcap" or path.is_dir()
    try:
        (path if is_folder else path.parent).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise recording_error(path, error) from error
    if is_folder:
        path /= time.strftime(f"{name}-%Y%m%d-%H%M%S.mcap")
    place, number = path, 1
    while os.path.lexists(place) or any(numbers_of(place)):
        number += 1
        place = path.with_stem(f"{path.stem}-{number}")
    return place


def facts_about(
    robot: str, components: Iterable[object], configuration: str = "", seed: str = ""
) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield what a recording has to say about its robot: versions, code, settings.

    Args:
        robot: Its name.
        components: Its resources and behaviors; the hashes of their code are told.
        configuration: The text of its robot.toml.
        seed: The seed of its random numbers.
    """
    from importlib.metadata import version

    yield "robot", {"name": robot, "seed": seed, "robot.toml": configuration}
    yield "versions", {"esair": version("esair"), "python": sys.version.split()[0]}
    code: dict[str, str] = {}
    for component in components:
        kind = type(component)
        try:
            source = inspect.getsource(kind)
        except (OSError, TypeError):
            continue
        name = f"{kind.__module__}.{kind.__qualname__}"
        code[name] = hashlib.sha256(source.encode()).hexdigest()[:16]
    yield "code", code
