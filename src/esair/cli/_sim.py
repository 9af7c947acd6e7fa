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
    record: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    page: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    insecure: bool = False,
    verbose: Annotated[bool, Parameter(name=["--verbose", "-v"])] = False,
) -> int:
    """Run the robot of a robot.toml in simulation, by its sim tables.

    Ctrl-C stops it: every actuator gets its safe command first.

    Args:
        file: The configuration of the robot.
        seconds: Stop after this many seconds.
        record: Record what happens, to this file or folder; to this folder if none
            is named.
        page: Serve the operator's seat to a browser, at HOST:PORT; at port 8740 of
            this computer alone if nothing is named.
        insecure: Another address than this computer's may be without TLS.
        verbose: Show every line of the log.
    """
    return drive(
        file,
        simulated=True,
        seconds=seconds,
        verbose=verbose,
        record=record,
        page=page,
        insecure=insecure,
    )
