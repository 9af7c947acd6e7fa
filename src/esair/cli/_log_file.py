"""``esair log`` and ``esair recover``: what is in a recording, as text; a whole one."""

from __future__ import annotations

import contextlib
import json
import logging
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from esair.cli._errors import CANNOT_USE, has_unknown, tell
from esair.cli._options import AsJson, Components, Out, Which
from esair.journal import Kind
from esair.messages import OPERATOR
from esair.seat import connect
from esair.values import printable

ITEMS = 8
"""How many items of a list are printed; of a longer one, how many more there are."""

NAMES = 10_000
"""How many names of components are known, so that a misspelt one is told."""

SEGMENTS = 8
"""Of how many segments it is told where they are damaged."""

TEXT = 400  # How much of a value is printed; all of it with --json


def log(
    file: Path | None = None,
    /,
    *,
    follow: Annotated[bool, Parameter(name=["--follow", "-f"])] = False,
    robot: Which = None,
    component: Components = None,
    kind: Annotated[list[str] | None, Parameter(name=["--kind", "-k"])] = None,
    machine: AsJson = False,
) -> int:
    """Print a recording, or what a robot does now, line by line.

    Args:
        file: A recording; also one that was cut.
        follow: What a robot on this computer does, from now on, instead of a file.
        component: Only events of these components.
        kind: Only events of these kinds, such as refused or crashed.
    """
    if follow == (file is not None):
        tell("log: expected a recording, or -f for a robot that runs")
        return CANNOT_USE
    if has_unknown("--kind", kind or [], [str(each) for each in Kind]):
        return CANNOT_USE
    if file is None:
        with contextlib.suppress(KeyboardInterrupt):
            return _follow(robot, component or [], kind or [], machine=machine)
        return 0
    return _show(file, component or [], kind or [], machine=machine)


@contextlib.contextmanager
def _heard() -> Iterator[list[str]]:
    """Keep what is logged: it is told in one line, when all is shown."""
    warned: list[str] = []

    def hear(record: logging.LogRecord) -> bool:
        if len(warned) < SEGMENTS:
            warned.append(record.getMessage())
        return False

    log = logging.getLogger("esair")
    log.addFilter(hear)
    try:
        yield warned
    finally:
        log.removeFilter(hear)


def _show(file: Path, component: list[str], kind: list[str], *, machine: bool) -> int:
    from esair.recording import Gaps, events_of, facts_of

    named: set[str] = set()
    with _heard() as warned:
        gaps = Gaps(facts_of(file))
        for event in events_of(file):
            gaps.hear(event)
            if len(named) < NAMES:
                named |= {event.component, event.peer} - {""}
            if component and not {event.component, event.peer} & set(component):
                continue
            if not kind or event.kind in kind:
                _print(event.time + gaps.offset, event._asdict(), machine=machine)
    if told := "; ".join([*warned, *filter(None, [gaps.told()])]):
        tell(printable(told if warned else f"{file}: {told}"))
    return CANNOT_USE if has_unknown("--component", component, named) else 0


def _follow(
    robot: str | None, components: list[str], kinds: list[str], *, machine: bool
) -> int:
    offset = time.time() - time.monotonic()
    with connect(robot) as client:
        status = client.do("status")
        rows = [*status["resources"], *status["behaviors"]]
        known = {status["robot"], OPERATOR, *(each["name"] for each in rows)}
        has_unknown("--component", components, known)  # it may come later
        client.do("log", {"components": components, "kinds": kinds})
        for found in client.lines():
            if "event" in found:
                event = found["event"]
                _print(event["time"] + offset, event, machine=machine)
    return 0


def _print(when: float, event: Mapping[str, Any], *, machine: bool = False) -> None:
    if machine:
        print(json.dumps(event), flush=True)  # noqa: T201 - this is the output
        return
    who = f"{event['peer']} > " if event["peer"] else ""
    value = "" if event["value"] is None else shown(_for_people(event))
    line = " ".join(part for part in (value, event["text"]) if part)
    print(  # noqa: T201 - this is the output
        f"{_clock(when)}.{int(when % 1 * 1000):03} {printable(event['kind'])[:20]:<10} "
        f"{printable(who + event['component'])} {printable(line)}".rstrip(),
        flush=True,
    )


def _clock(when: float) -> str:
    try:
        return time.strftime("%H:%M:%S", time.localtime(when))
    except (OverflowError, ValueError, OSError):  # the time of no clock
        return "--:--:--"


def _for_people(event: Mapping[str, Any]) -> Any:
    """Return a value without the times of a refusal, which are no clock's."""
    if event["kind"] != "refused" or not isinstance(event["value"], dict):
        return event["value"]
    return {k: v for k, v in event["value"].items() if k not in {"since", "until"}}


def shown(value: Any, width: int = TEXT) -> str:
    """Return a plain value as a text for people; of what is long only what it is."""
    text = json.dumps(_light(value))
    return text if len(text) <= width else f"{text[:width]}..."


def _light(value: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {"shape", "dtype", "data"}:  # an array of NumPy
            return f"{value['dtype']} array of {' x '.join(map(str, value['shape']))}"
        return {name: _light(part) for name, part in value.items()}
    if isinstance(value, list) and len(value) > ITEMS:
        more = f"... {len(value) - ITEMS} more"
        return [*(_light(part) for part in value[:ITEMS]), more]
    return [_light(part) for part in value] if isinstance(value, list) else value


def recover(file: Path, /, *, out: Out = None) -> int:
    """Make a whole recording of what is readable of a cut one.

    Args:
        file: A recording that was cut; it stays as it is.
        out: The new file; beside the old one unless given.
    """
    from esair.recording import recover as make_whole

    found = make_whole(file, out)
    state = "it was whole" if found.was_whole else "it was cut or damaged"
    print(f"{found.path}: {found.messages} messages; {state}")  # noqa: T201 - the output
    return 0
