"""``esair measure``: how late the steps of a robot are on this computer, under load."""

from __future__ import annotations

import asyncio
import bisect
import contextlib
import functools
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import attrs
from cyclopts import Parameter
from rich import box
from rich.console import Console
from rich.table import Table

import esair
from esair import config
from esair.cli._errors import CANNOT_USE, is_no_picture, tell, wrong_seconds
from esair.cli._log import shown_log
from esair.cli._options import MaybeNamed, Out
from esair.loop import PRIORITY, Job, Scheduler, TurnLoop, check_priority, refusal

BINS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, float("inf"))
"""Up to how many milliseconds late a line of the histogram is."""

SETTLE = 0.5
"""How long a robot runs before it is measured, in seconds."""

PROBE = 100.0
"""How often is looked where no step of the robot has a rate, in Hz."""

BUSY = (
    "import os, signal\nsignal.signal(signal.SIGINT, signal.SIG_DFL)\n"
    "parent = os.getppid()\nwhile os.getppid() == parent: sum(range(10_000))"
)
"""What a busy process does, as long as its parent lives; of Ctrl-C it says nothing."""

WIDTH = 16  # of the longest bar


def measure(
    file: Path,
    /,
    *,
    real: bool = False,
    seconds: Annotated[float, Parameter(name="--for")] = 10.0,
    load: int | None = None,
    rate: float | None = None,
    realtime: Annotated[list[int] | None, MaybeNamed] = None,
    out: Out = None,
) -> int:
    """Show how late the steps of a robot are here under load, without and with real time.

    Each step that has a rate is looked at, and each poll: when it began, against when it
    was due. The robot runs twice, in simulation.

    Args:
        file: The configuration of the robot.
        real: Run the robot on its real hardware. It moves.
        seconds: How long to measure each, in seconds.
        load: How many busy processes there are beside it; four for each core unless given.
        rate: Have one more step that does nothing, so many times a second, as cyclictest.
        realtime: The priority that is measured; 50 unless given.
        out: A picture of it (PNG), too.
    """
    load = 4 * (os.cpu_count() or 1) if load is None else load
    if wrong_seconds(seconds):
        return CANNOT_USE
    if load < 0 or (rate is not None and not 0.0 < rate <= 1e4):
        tell("expected a --load of 0 or more, and a --rate above 0 and up to 10000 Hz")
        return CANNOT_USE
    asked = (realtime or [PRIORITY])[0]
    priority = check_priority("--realtime", asked)
    assert priority is not None
    ways: list[tuple[str, bool | int]] = [("as it is", False)]
    if refused := refusal(priority):
        tell(f"not in real time: {refused}")
    else:
        ways.append((f"--realtime={priority}", priority))
    if out is not None and is_no_picture(out):  # told before it measures
        return CANNOT_USE
    found = []
    with busy(load), shown_log(verbose=False):
        for title, way in ways:
            described = config.load(file, simulated=not real)
            make = functools.partial(_robot, way)
            with asyncio.Runner(loop_factory=TurnLoop) as runner:
                late = Late(title)
                runner.run(late.run(config.build(described, make), seconds, rate))
            found.append(late)
    console = Console(highlight=False, markup=False)
    console.print(f"{described.name}: {seconds:g} s each, {load} busy processes beside")
    console.print(_table(found))
    for told in about_computer():
        console.print(told, soft_wrap=True)
    if out is not None:
        _draw(found, out, f"{described.name}, {load} busy processes")
        console.print(str(out))
    return 0


def _robot(realtime: bool | int, **given: Any) -> esair.Robot:
    return esair.Robot(**{**given, "realtime": realtime, "record": None})


@contextlib.contextmanager
def busy(processes: int) -> Iterator[None]:
    """Have so many processes compute meanwhile."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        started.extend(
            subprocess.Popen([sys.executable, "-I", "-S", "-c", BUSY])
            for _ in range(processes)
        )
        yield
    finally:
        for each in started:
            each.kill()
        for each in started:
            each.wait()


@attrs.define
class Late:
    """How late the steps of one run were.

    Attributes:
        title: How it was run.
        seconds: How late each was, in seconds.
        lost: How many were left out, because the next was due already.
    """

    title: str
    seconds: list[float] = attrs.field(factory=list)
    lost: int = 0

    async def run(self, robot: esair.Robot, wanted: float, rate: float | None) -> None:
        """Run a robot, and look at its steps for so many seconds."""
        async with robot:
            await asyncio.sleep(SETTLE)
            scheduler = Scheduler.of(asyncio.get_running_loop())
            jobs = [each for each in scheduler.jobs() if each.name]
            if rate is not None or not jobs:
                period = 1.0 / (rate or PROBE)
                jobs.append(scheduler.every(period, lambda _now: None, name="probe"))
            await asyncio.sleep(SETTLE)
            before = sum(each.skipped for each in jobs)
            for job in jobs:
                job.function = self._looked_at(job)
            await asyncio.sleep(wanted)
            self.lost = sum(each.skipped for each in jobs) - before

    def _looked_at(self, job: Job) -> Callable[[float], Any]:
        step, took = job.function, self.seconds.append

        def look(now: float) -> Any:
            took(time.monotonic() - job.moment)
            return step(now)

        return look

    def share(self, part: float) -> float:
        """Return how late all but a part of them were at most, in milliseconds."""
        if not self.seconds:
            return 0.0
        ordered = sorted(self.seconds)
        return 1e3 * ordered[min(int(part * len(ordered)), len(ordered) - 1)]

    def counts(self) -> list[int]:
        """Return how many steps are in each of `BINS`."""
        found = [0] * len(BINS)
        for each in self.seconds:
            found[bisect.bisect_left(BINS, 1e3 * each)] += 1
        return found


def _table(found: Sequence[Late]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("late", justify="right")
    for late in found:
        table.add_column(late.title)
    counts = [late.counts() for late in found]
    most = max(1, *(max(each) for each in counts))
    names = [*(f"<= {each:g} ms" for each in BINS[:-1]), f"> {BINS[-2]:g} ms"]
    for number, name in enumerate(names):
        cells = [
            f"{'█' * -(-WIDTH * each[number] // most):{WIDTH}} {each[number]:7}"
            for each in counts
        ]
        table.add_row(name, *cells, end_section=name is names[-1])
    for name, part in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999), ("worst", 1.0)):
        table.add_row(name, *(f"{late.share(part):.3f} ms" for late in found))
    made = [(late.lost, late.lost + len(late.seconds)) for late in found]
    table.add_row("steps lost", *(f"{lost} of {due}" for lost, due in made))
    return table


def about_computer() -> Iterator[str]:
    """Say which settings of this computer cost real time, and how to change them."""
    governors = Path("/sys/devices/system/cpu").glob("cpu*/cpufreq/scaling_governor")
    slow = [each for each in governors if _text(each) not in {"performance", ""}]
    if slow:
        yield (
            f"{len(slow)} cores save power, which costs time to wake up: "
            "sudo cpupower frequency-set -g performance"
        )
    if _text(Path("/proc/sys/kernel/sched_rt_runtime_us")) == "-1":
        yield (
            "real time may take a core for ever, so that nobody can log in to stop it: "
            "sudo sysctl kernel.sched_rt_runtime_us=950000"
        )
    if _text(Path("/sys/kernel/realtime")) != "1":
        yield "the kernel is not PREEMPT_RT: a driver of it may make a step late"


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _draw(found: Sequence[Late], target: Path, title: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5))
    axes = figure.subplots()
    for late in found:
        told = f"{late.title}: p99 {late.share(0.99):.2f} ms, {late.lost} lost"
        steps = [max(1e3 * each, 1e-3) for each in late.seconds]
        edges = [10 ** (n / 10 - 3) for n in range(61)]  # 1 us to 1000 s
        axes.hist(steps, bins=edges, histtype="step", linewidth=1.5, label=told)
    axes.set(
        xscale="log", yscale="log", xlabel="late (ms)", ylabel="steps", title=title
    )
    axes.legend()
    figure.savefig(target, dpi=120)
