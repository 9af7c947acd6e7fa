"""``esair top``: what a robot is doing, as a screen that lives."""

from __future__ import annotations

import collections
import json
import sys
import time
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console
from rich.live import Live
from rich.text import Text

from esair.cli._errors import CANNOT_USE, tell
from esair.exceptions import EsairError
from esair.seat import Client, NoRobotError, connect
from esair.seat.screen import HAPPENED, event_line, picture
from esair.values import printable

NOT_SHOWN = 1  # The exit code if the robot ended before it was seen
KEPT = 100  # How many events are kept for the screen


def top(
    *,
    robot: Annotated[str | None, Parameter(name=["--robot", "-r"])] = None,
    machine: Annotated[bool, Parameter(name="--json")] = False,
) -> int:
    """Show what a robot is doing, in a table.

    State, holder, rate, age, late steps, losses and refusals of each component.

    On a terminal until Ctrl-C, with what happens below; else once, as plain text.

    Args:
        robot: The name of the robot, if several run.
        machine: One picture in JSON, for other programs.
    """
    try:
        with connect(robot) as client:
            if machine or not sys.stdout.isatty():
                return _once(client, machine=machine)
            return _live(client)
    except NoRobotError as error:
        tell(printable(str(error)))
        return CANNOT_USE
    except (EsairError, TimeoutError) as error:
        tell(printable(str(error)))
        return NOT_SHOWN


def _once(client: Client, *, machine: bool) -> int:
    client.do("status")
    time.sleep(1.0)  # a rate needs two looks
    status = client.do("status")
    if machine:
        print(json.dumps(status))  # noqa: T201 - this is the output
        return 0
    console = Console(width=120, no_color=True, highlight=False)
    console.print(picture(status, console, height=10_000))
    return 0


def _live(client: Client) -> int:
    console = Console(highlight=False)
    happened: collections.deque[Text] = collections.deque(maxlen=KEPT)
    offset = time.time() - time.monotonic()
    client.do("log", {"kinds": [kind.value for kind in HAPPENED]})
    client.do("watch", {"every": 0.25})
    try:
        with Live(console=console, screen=True, auto_refresh=False) as live:
            for found in client.lines(timeout=5.0):
                if "event" in found:
                    when = time.localtime(found["event"]["time"] + offset)
                    clock = time.strftime("%H:%M:%S", when)
                    happened.append(event_line(found["event"], clock))
                elif "status" in found:
                    shown = picture(found["status"], console, happened=happened)
                    live.update(shown, refresh=True)
    except KeyboardInterrupt:
        return 0
    tell(f"robot {client.name!r} has said nothing for 5 s")
    return NOT_SHOWN
