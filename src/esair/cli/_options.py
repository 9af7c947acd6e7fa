"""Options that several verbs have in common."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import attrs
from cyclopts import Parameter

Which = Annotated[
    str | None,
    Parameter(name=["--robot", "-r"], help="The name of the robot, if several run."),
]
AsJson = Annotated[bool, Parameter(name="--json", help="JSON, for other programs.")]
Seconds = Annotated[float | None, Parameter(name="--for")]
Verbose = Annotated[bool, Parameter(name=["--verbose", "-v"])]
Out = Annotated[Path | None, Parameter(name=["--out", "-o"])]
Components = Annotated[list[str] | None, Parameter(name=["--component", "-c"])]


def one_at_most(_: object, words: Sequence[object] | None) -> None:
    """Refuse more than one word: an option that may also stand alone takes a list."""
    if words is not None and len(words) > 1:
        raise ValueError(f"expected one at most, not {' '.join(map(str, words))!r}")


MaybeNamed = Parameter(consume_multiple=True, validator=one_at_most)


@Parameter(name="*")  # its fields are options themselves
@attrs.frozen
class Running:
    """How a robot of a file is run.

    Attributes:
        seconds: Stop after this many seconds.
        record: Record what happens, to this file or folder; to this folder if none
            is named.
        page: Serve the operator's seat to a browser, at HOST:PORT; at port 8740 of
            this computer alone if nothing is named. The address is printed, with its
            token.
        insecure: Another address than this computer's may be without TLS.
        realtime: Go before what else the computer does, with this priority: 1 to 98, 50 if
            none is named. Where that is not allowed it is said what to do.
        placement: Where components live, whatever the file says, as NAME=process or
            NAME=task.
        verbose: Show every line of the log.
        traceback: Show how an error came about, too.
    """

    seconds: Seconds = None
    record: Annotated[list[Path] | None, MaybeNamed] = None
    page: Annotated[list[str] | None, MaybeNamed] = None
    insecure: bool = False
    realtime: Annotated[list[int] | None, MaybeNamed] = None
    placement: list[str] | None = None
    verbose: Verbose = False
    traceback: bool = False
