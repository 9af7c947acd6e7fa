"""P22: how late steps are beside busy processes, as it is and in real time."""

from __future__ import annotations

import asyncio
import statistics

from benchmarks.cases.components import reacting_robot
from benchmarks.harness import Row, ms, repeated
from esair.cli._measure import Late, busy
from esair.loop import PRIORITY, TurnLoop, refusal

SECONDS = 5.0
PROCESSES = 8


async def rows() -> list[Row]:
    """Measured on the loop that ships, in the main thread: its own, not this one."""
    return await asyncio.to_thread(_rows)


def _rows() -> list[Row]:
    if refused := refusal(PRIORITY):
        return [Row("P22 in real time", "", "", 0.0, None, f"not measured: {refused}")]
    with busy(PROCESSES):
        hundred = [_late(None, realtime=True) for _ in repeated(5)]
        plain = _late(None, realtime=False)
        thousand = [_late(1000.0, realtime=True) for _ in repeated(5)]
        fast = _late(1000.0, realtime=False)
    lost = statistics.median(each.lost for each in hundred)
    p99 = statistics.median(each.share(0.99) for each in hundred)
    p999 = statistics.median(each.share(0.999) for each in thousand)
    beside = f"beside {PROCESSES} busy processes, without real time"
    return [
        Row(
            "P22 100 Hz: steps lost", f"{lost:g}", "0", lost, 0.0,
            f"{plain.lost} of {plain.lost + len(plain.seconds)} {beside}",
        ),
        Row(
            "P22 100 Hz: p99 lateness", ms(p99 / 1e3), "1 ms", p99, 1.0,
            f"{plain.share(0.99):.1f} ms {beside}",
        ),
        Row(
            "P22 1 kHz: p99.9 lateness", ms(p999 / 1e3), "2 ms", p999 / 2, 1.0,
            f"{fast.share(0.999):.1f} ms {beside}",
        ),
    ]  # fmt: skip


def _late(rate: float | None, *, realtime: bool) -> Late:
    late = Late("")
    robot = reacting_robot(1, acting=1, realtime=realtime)
    with asyncio.Runner(loop_factory=TurnLoop) as runner:
        runner.run(late.run(robot, SECONDS, rate))
    return late
