"""``esair peers``: the other robots that a robot uses, and that use it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from esair.cli._errors import heeded
from esair.cli._options import AsJson, Which
from esair.seat import connect


def peers(*, robot: Which = None, machine: AsJson = False) -> int:
    """Show how the other robots are heard, what is used of them, and what they hold.

    Exit code: 0 all of them are heard, 1 one is not.
    """
    with connect(robot) as client:
        found = list(of_status(client.do("status")))
    if machine:
        print(json.dumps(found))  # noqa: T201 - this is the output
    else:
        table = Table(
            "peer", "state", "round trip", "refused", "used here", "holds here"
        )
        for each in found:
            trip = each["round_trip"]
            told = "" if trip is None else f"{1000 * trip:.1f} ms"
            used, holds = ", ".join(each["used"]), ", ".join(each["holds"])
            row = (each["name"], each["state"], told, str(each["refused"]), used, holds)
            table.add_row(*map(Text, row))
        console = Console(highlight=False)
        with heeded(console):
            console.print(table if found else "it has no peers")
    return int(any(each["state"] != "ready" for each in found))


def of_status(status: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield what a picture of a robot says of each of its peers."""
    on_peers = [each for each in status["resources"] if each["medium"] == "PeerBus"]
    for peer in (each for each in on_peers if each["name"] == each["bus"]):
        name, numbers = peer["name"], peer["numbers"]
        used = [each for each in on_peers if each["bus"] == name and each is not peer]
        holds = [each for each in status["resources"] if each.get("holder") == name]
        yield {
            "name": name,
            "state": peer["state"],
            "error": peer["error"],
            "round_trip": numbers.get("round_trip"),
            "refused": int(numbers.get("refused", 0)),
            "used": [f"{each['name']}: {each['state']}" for each in used],
            "holds": [each["name"] for each in holds],
        }
