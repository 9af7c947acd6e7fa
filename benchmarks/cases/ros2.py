"""P19: timers at 100 Hz, to those of real ROS 2 in a process of its own."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import esair
from benchmarks import harness
from benchmarks.harness import Row, repeated, us

SECONDS = 2.0
SCRIPT = Path(__file__).parent.parent / "ros2_timers.py"
EXECUTORS = ("EventsExecutor", "SingleThreadedExecutor")
"""The quickest first; it is passed over where it does not call its timers."""

GOALS = {100: 0.25, 1000: 0.10}


class Tick(esair.Reaction):
    """What a timer is in esair."""

    rate = 100.0

    def react(self) -> None:
        return None


async def rows() -> list[Row]:
    if harness.ros_python is None:
        return [
            Row(
                "P19 timers at 100 Hz, to ROS 2",
                *("", "", 0.0, None),
                note="not measured: --ros, a Python with ros-kilted-rclpy",
            )
        ]
    return [await _row(timers, goal) for timers, goal in GOALS.items()]


async def _row(timers: int, goal: float) -> Row:
    passed = []
    for executor in EXECUTORS:
        mine, theirs, made = [], [], []
        for _ in repeated(3):
            mine.append(await _tick(timers))
            cpu, share = await _ros(executor, timers)
            theirs.append(cpu)
            made.append(share)
        shares = ", ".join(f"{share:.2f}" for share in made)
        note = f"{executor}, which made {shares} of its steps"
        if min(made) == 0.0 or max(made) > 1.1:
            passed.append(f"{note}: not counted")
            continue
        ratio = sorted(a / b for a, b in zip(mine, theirs, strict=True))[len(mine) // 2]
        return Row(
            f"P19 {timers} timers at 100 Hz, CPU of a step, to ROS 2's {executor}",
            us(min(mine)),
            us(min(theirs)),
            ratio,
            goal if executor == EXECUTORS[0] else None,  # the goal is to the quickest
            "; ".join([note, *passed]),
        )
    return Row(
        f"P19 {timers} timers at 100 Hz", "", "", 0.0, None, note="; ".join(passed)
    )


async def _tick(timers: int) -> float:
    """Return the CPU of a step, in seconds."""
    names = [f"tick_{number}" for number in range(timers)]
    async with esair.Robot(behaviors=[Tick(name=name) for name in names]) as robot:
        await asyncio.sleep(0.5)
        before, cpu = _steps(robot), time.process_time()
        await asyncio.sleep(SECONDS)
        return (time.process_time() - cpu) / max(1, _steps(robot) - before)


def _steps(robot: esair.Robot) -> int:
    return sum(robot.behaviors.query(name).steps for name in robot.behaviors.names())


async def _ros(executor: str, timers: int) -> tuple[float, float]:
    """Return the CPU of a step in seconds, and which part of those due was made."""
    process = await asyncio.create_subprocess_exec(
        *(str(harness.ros_python), str(SCRIPT), executor, str(timers), str(SECONDS)),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    text, _ = await process.communicate()
    lines = text.decode().split()
    if len(lines) < 2:
        return 1.0, 0.0
    return float(lines[-2]), float(lines[-1])
