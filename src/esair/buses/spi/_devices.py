"""SPI buses that programs may use."""

from __future__ import annotations

from pathlib import Path

from esair.buses.finding import ROOT, Device, entries, permission
from esair.buses.spi._kernel import selects


def devices(root: Path = ROOT) -> list[Device]:
    """Return the SPI buses that are there, by their numbers."""
    numbers = {
        int(number)
        for place in entries(root / "sys/class/spidev")
        if (number := place.name.removeprefix("spidev").partition(".")[0]).isdecimal()
    }
    found = []
    for bus in sorted(numbers):
        paths = selects(bus, root)
        if paths:
            first = next(iter(paths.values()))
            found.append(
                Device(
                    kind="spi",
                    path=first,
                    address=str(bus),
                    description=f"chip selects {', '.join(map(str, paths))}",
                    state=permission(root / first.lstrip("/")),
                )
            )
    return found


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a bus."""
    return [f"[bus.spi{device.address}]", 'type = "spi"', f"bus = {device.address}"]
