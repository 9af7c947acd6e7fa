"""GPIO chips: who they are and how many lines they have."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from esair.buses.finding import ROOT, Device, entries, quoted, read


def devices(root: Path = ROOT) -> list[Device]:
    """Return the GPIO chips that are there, by their numbers."""
    gpiod = _gpiod() if root == ROOT else None
    known = {
        place.name: _look(place, root) if gpiod is None else _ask(gpiod, place.name)
        for place in entries(root / "sys/bus/gpio/devices")
        if place.name.startswith("gpiochip") and (root / "dev" / place.name).exists()
    }
    labels = [label for label, _, _ in known.values()]
    return [
        Device(
            kind="gpio",
            path=f"/dev/{name}",
            # Numbers depend on the order in which drivers come.
            address=label if label and labels.count(label) == 1 else f"/dev/{name}",
            description=label,
            state=state,
            lines=lines,
        )
        for name, (label, lines, state) in known.items()
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for an input on the first line of a chip."""
    return [
        f"[sensor.{name}_line0]",
        'driver = "gpio"',
        f"chip = {quoted(device.address)}",
        "line = 0",
    ]


def _gpiod() -> Any:
    """Return the bindings of libgpiod; None if they are not there, or those of 1.x."""
    with contextlib.suppress(ImportError):
        import gpiod

        return gpiod if hasattr(gpiod, "LineSettings") else None
    return None


def _ask(gpiod: Any, name: str) -> tuple[str, int | None, str]:
    try:
        with gpiod.Chip(f"/dev/{name}") as chip:
            info = chip.get_info()
    except PermissionError:
        return "", None, "no permission"
    except OSError:  # it is just being unplugged
        return "", None, ""
    label = "".join(each if each.isprintable() else "?" for each in info.label)
    return label, info.num_lines, ""


def _look(place: Path, root: Path) -> tuple[str, int | None, str]:
    """Look into the old class of GPIO, which says it without opening the chip."""
    parent = place.resolve().parent
    for old in entries(root / "sys/class/gpio"):
        if (old / "ngpio").exists() and (old / "device").resolve() == parent:
            lines = read(old / "ngpio")
            return read(old / "label"), int(lines) if lines.isdecimal() else None, ""
    return "", None, ""
