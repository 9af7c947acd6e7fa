"""``esair sim``: the robot of a file, with its simulated devices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from esair.cli._drive import drive


def sim(
    file: Path,
    /,
    *,
    seconds: Annotated[float | None, Parameter(name="--for")] = None,
    verbose: Annotated[bool, Parameter(name=["--verbose", "-v"], negative=())] = False,
) -> int:
    """Run the robot of a robot.toml in simulation: the sim tables count.

    Ctrl-C stops it: every actuator gets its safe command first.

    Args:
        file: The configuration of the robot.
        seconds: Stop after this many seconds.
        verbose: Show every line of the log.
    """
    return drive(file, simulated=True, seconds=seconds, verbose=verbose)
