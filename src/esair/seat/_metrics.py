"""All counters of a robot as text for Prometheus."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from esair.seat._operator import Console

_STRANGE = re.compile(r"[^a-zA-Z0-9_]")


def metrics(console: Console) -> str:
    """Return every counter, the states, and whether the robot is halted."""
    robot, status = console.robot, console.status.picture()
    families: dict[str, list[str]] = {
        "esair_up_seconds gauge": [f"esair_up_seconds {status['up']:.3f}"],
        "esair_halted gauge": [f"esair_halted {int(status['halted'] is not None)}"],
    }
    for row in (*status["resources"], *status["behaviors"]):
        labels = f'component="{_label(row["name"])}",kind="{row["kind"]}"'
        families.setdefault("esair_state gauge", []).append(
            f'esair_state{{{labels},state="{_label(row["state"])}"}} 1'
        )
        for key in ("rate", "age"):
            if row.get(key) is not None:
                families.setdefault(f"esair_{key} gauge", []).append(
                    f"esair_{key}{{{labels}}} {row[key]:.6g}"
                )
    for component, counters in robot.journal.counts().items():
        for name, number in counters.items():
            family = f"esair_{_STRANGE.sub('_', name)}"
            families.setdefault(f"{family} untyped", []).append(
                f'{family}{{component="{_label(component)}"}} {number}'
            )
    lines = []
    for family, samples in families.items():
        lines += [f"# TYPE {family}", *samples]
    return "\n".join(lines) + "\n"


def _label(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
