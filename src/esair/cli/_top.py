"""``esair top``: what a robot is doing, as a screen that lives."""

from __future__ import annotations

import collections
import contextlib
import json
import sys
import time

from rich.console import Console
from rich.live import Live
from rich.text import Text

from esair.cli._errors import NOT_DONE, tell
from esair.cli._options import AsJson, Which
from esair.seat import Client, connect
from esair.seat.screen import HAPPENED, event_line, picture

KEPT = 100  # How many events are kept for the screen


def top(*, robot: Which = None, machine: AsJson = False) -> int:
    """Show what a robot is doing, in a table.

    State, holder, rate, age, late steps, losses and refusals of each component.

    On a terminal that can draw until Ctrl-C, with what happens below; else once, as
    plain text.
    """
    with connect(robot) as client:
        if machine or not sys.stdout.isatty() or Console().is_dumb_terminal:
            _once(client, machine=machine)
            return 0
        with contextlib.suppress(KeyboardInterrupt):
            _live(client)
            tell(f"robot {client.name!r} has said nothing for 5 s")
            return NOT_DONE
    return 0


def _once(client: Client, *, machine: bool) -> None:
    client.do("status")
    time.sleep(1.0)  # a rate needs two looks
    status = client.do("status")
    if machine:
        print(json.dumps(status))  # noqa: T201 - this is the output
        return
    console = Console(width=120, no_color=True, highlight=False)
    console.print(picture(status, console, height=10_000))


def _live(client: Client) -> None:
    console = Console(highlight=False)
    happened: collections.deque[Text] = collections.deque(maxlen=KEPT)
    offset = time.time() - time.monotonic()
    client.do("log", {"kinds": [kind.value for kind in HAPPENED]})
    client.do("watch", {"every": 0.25})
    with Live(console=console, screen=True, auto_refresh=False) as live:
        for found in client.lines(timeout=5.0):
            if "event" in found:
                when = time.localtime(found["event"]["time"] + offset)
                clock = time.strftime("%H:%M:%S", when)
                happened.append(event_line(found["event"], clock))
            elif "status" in found:
                shown = picture(found["status"], console, happened=happened)
                live.update(shown, refresh=True)
