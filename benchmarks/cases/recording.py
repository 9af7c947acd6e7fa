"""REC-5: what a recording costs: its thread, the loop, and the lateness of a beat."""

from __future__ import annotations

import asyncio
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import attrs

import esair
from benchmarks import harness
from benchmarks.harness import Row, us
from esair.journal import Journal, Kind
from esair.loop import First, every
from esair.messages import Reading, Recording
from esair.recording import Recorder

SECONDS = 2.0
ROUNDS = 5
BEAT = 0.01


@attrs.frozen
class Motion:
    """A value as an inertial unit gives it."""

    x: float
    y: float
    z: float


class Imu(esair.Sensor[Motion]):
    """Declares that value."""

    async def read(self) -> Motion:
        raise NotImplementedError


@attrs.frozen
class Cost:
    """What a run took.

    Attributes:
        share: Of a core.
        loop: Of the loop's thread, for each message, in seconds.
        late: How late a beat of 100 Hz was, in 99 of 100 cases, in seconds.
        dropped: How many messages were not written.
    """

    share: float
    loop: float
    late: float
    dropped: int


async def _messages(rate: int, folder: Path | None, *, turns: bool = False) -> Cost:
    """Publish so many messages a second, recorded (with their turns) or not at all."""
    loop, journal = asyncio.get_running_loop(), Journal()
    recorder = tape = None
    if folder is not None:
        recorder = Recorder(
            Recording(folder / f"{rate}-{time.time_ns()}.mcap"),
            journal,
            components=lambda: [Imu],
        )
        tape = recorder.keep_turns() if turns else None
        recorder.start(loop.time())
    journal.start(loop)
    seconds = 0.05 if harness.smoke else SECONDS
    count, number, late = round(rate * BEAT), 0, []
    cpu, thread, began = time.process_time(), time.thread_time(), loop.time()
    async for tick in every(BEAT):
        late.append(time.monotonic() - began - tick)
        if tape is not None:
            tape.turn(began + tick)
        for _ in range(count):
            number += 1
            value = Motion(number / 7, number / 11, number / 13)
            if tape is not None:
                tape.first(("call", "imu", "read"), First(False, value, None))
            reading = Reading(value, began + tick, number)
            journal.publish(Kind.READING, "imu", "", reading)
        if tick >= seconds:
            break
    elapsed = loop.time() - began
    share = (time.process_time() - cpu) / elapsed
    spent = (time.thread_time() - thread) / number
    dropped = 0
    if recorder is not None:
        recorder.close(10.0)
        dropped = recorder.counts()["dropped"]
    journal.close()
    late.sort()
    return Cost(share, spent, late[int(0.99 * (len(late) - 1))], dropped)


def _more(pairs: list[tuple[Cost, Cost]], part: Callable[[Cost], float]) -> float:
    """Return what a recording adds, where other programs disturb least."""
    return statistics.median(part(kept) - part(bare) for bare, kept in pairs)


async def rows() -> list[Row]:
    found: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for rate in (1000, 5000):
            pairs = [
                (await _messages(rate, None), await _messages(rate, Path(folder)))
                for _ in range(ROUNDS)
            ]
            share = _more(pairs, lambda cost: cost.share)
            cost = _more(pairs, lambda cost: cost.loop)
            late = _more(pairs, lambda cost: cost.late)
            dropped = sum(kept.dropped for _, kept in pairs)
            note = f"{dropped} dropped" if dropped else ""
            goal = 0.05 if rate == 1000 else None
            text = f"REC-5 {rate} messages/s:"
            found += [
                Row(f"{text} of a core", f"{100 * share:.1f} %", "", share, goal, note),
                Row(f"{text} on the loop, each", us(cost), "", 1e6 * cost, 1.0),
                Row(f"{text} p99 lateness, more by", us(late), "", 1e3 * late, 1.0),
            ]
        pairs = [
            (
                await _messages(1000, None),
                await _messages(1000, Path(folder), turns=True),
            )
            for _ in range(ROUNDS)
        ]
        share = _more(pairs, lambda cost: cost.share)
        text = "REC-5 1000 messages/s with their turns: of a core"
        found.append(Row(text, f"{100 * share:.1f} %", "", share, 0.05))
    return found
