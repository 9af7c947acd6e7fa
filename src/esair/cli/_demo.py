"""``esair demo``: a simulated rover that explores, loses a sensor, and goes on."""

from __future__ import annotations

from pathlib import Path


def demo(
    *,
    fast: bool = False,
    seed: int = 0,
    out: Path | None = None,
    record: Path | None = None,
    kill: bool = False,
) -> int:
    """Watch a simulated rover lose a sensor, stop safely and go on.

    Args:
        fast: Run on a virtual clock, in a few seconds.
        seed: The same number gives the same run.
        out: Where the picture of the run goes (PNG).
        record: Where the recording of the run goes, for esair log and plot (MCAP).
        kill: Kill a robot's process while it drives instead, and show when its wheels
            had their safe frame.
    """
    # What draws takes its time to be imported.
    print("esair demo: a simulated rover; Ctrl-C stops it", flush=True)  # noqa: T201 - this is the command line
    from esair.demo import demo as show

    return show(fast=fast, seed=seed, out=out, record=record, kill=kill)
