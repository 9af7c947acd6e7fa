"""``esair run``: the robot of a file, on its real hardware."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from esair.cli._drive import drive
from esair.cli._errors import CANNOT_USE, tell


def run(
    file: Path,
    /,
    *,
    seconds: Annotated[float | None, Parameter(name="--for")] = None,
    loop: Literal["asyncio", "uvloop"] = "asyncio",
    record: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    page: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    insecure: bool = False,
    verbose: Annotated[bool, Parameter(name=["--verbose", "-v"])] = False,
) -> int:
    """Run the robot of a robot.toml on its real hardware.

    Ctrl-C stops it: every actuator gets its safe command first.

    Args:
        file: The configuration of the robot.
        seconds: Stop after this many seconds.
        loop: The event loop: Python's own, or uvloop if it is installed.
        record: Record what happens, to this file or folder; to this folder if none
            is named.
        page: Serve the operator's seat to a browser, at HOST:PORT; at port 8740 of
            this computer alone if nothing is named.
        insecure: Another address than this computer's may be without TLS.
        verbose: Show every line of the log.
    """
    factory = None
    if loop == "uvloop":
        try:
            import uvloop
        except ImportError:
            tell("--loop: uvloop is not installed: pip install 'esair[uvloop]'")
            return CANNOT_USE
        factory = uvloop.new_event_loop
    return drive(
        file,
        simulated=False,
        seconds=seconds,
        verbose=verbose,
        record=record,
        page=page,
        insecure=insecure,
        loop_factory=factory,
    )
