"""``esair run``: the robot of a file, on its real hardware."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from esair.cli._drive import drive


def run(
    file: Path,
    /,
    *,
    seconds: Annotated[float | None, Parameter(name="--for")] = None,
    verbose: Annotated[bool, Parameter(name=["--verbose", "-v"], negative=())] = False,
) -> int:
    """Run the robot of a robot.toml on its real hardware.

    Ctrl-C stops it: every actuator gets its safe command first.

    Args:
        file: The configuration of the robot.
        seconds: Stop after this many seconds.
        verbose: Show every line of the log.
    """
    return drive(file, simulated=False, seconds=seconds, verbose=verbose)
