"""SPI buses of the Linux kernel: found, opened. The only module that knows spidev."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from pathlib import Path
from typing import Any, Protocol

from esair.buses.finding import ROOT, Device, entries, permission
from esair.exceptions import ConfigError

LIMIT = 4096
"""How many bytes the kernel moves in one transfer, unless it is told otherwise."""

_FILE = re.compile(r"spidev(\d+)\.(\d+)\Z")


class SpiLink(Protocol):
    """An SPI master."""

    def exchange(self, chip: int, data: bytes, speed: int, mode: int) -> bytes:
        """Send bytes to a chip and return those that came at the same time.

        Args:
            chip: The number of its chip select.
            data: What to send.
            speed: Bits per second.
            mode: 0 to 3: polarity and phase of the clock.

        Raises:
            OSError: The transfer failed; ``ENXIO`` if there is no such chip select.
        """

    def close(self) -> None:
        """Let the bus go."""


def selects(bus: int, root: Path = Path("/")) -> dict[int, str]:
    """Return the device files of a bus by the number of their chip select."""
    found = {}
    try:
        names = os.listdir(root / "dev")
    except OSError:
        return {}
    for name in names:
        matched = _FILE.match(name)
        if matched is not None and int(matched[1]) == bus:
            found[int(matched[2])] = f"/dev/{name}"
    return dict(sorted(found.items()))


def presence(bus: int) -> tuple[tuple[str, int, int, int], ...] | None:
    """Look whether a bus is there; another value is another arrival of it."""
    seen = []
    for path in selects(bus).values():
        with contextlib.suppress(OSError):
            found = os.stat(path)
            seen.append((path, found.st_rdev, found.st_ino, found.st_ctime_ns))
    return tuple(seen) or None


def open_bus(owner: str, bus: int) -> SpiLink:
    """Open every chip select of a bus."""
    paths = selects(bus)
    if not paths:
        raise FileNotFoundError(
            errno.ENOENT, f"there is no /dev/spidev{bus}.*: is SPI switched on?"
        )
    try:
        import spidev
    except ImportError as error:
        raise ConfigError(
            owner, "type", "spidev is needed: pip install 'esair[spi]'"
        ) from error
    return KernelLink({chip: _opened(spidev, path) for chip, path in paths.items()})


def _opened(spidev: Any, path: str) -> Any:
    device = spidev.SpiDev()
    try:
        device.open_path(path)
        device.bits_per_word = 8  # another program may have left it at 16
    except OSError as error:
        raise OSError(
            error.errno, f"{path}: {os.strerror(error.errno or 0)}"
        ) from error
    return device


class KernelLink:
    """The open device files of one bus."""

    def __init__(self, selected: dict[int, Any]) -> None:
        self._selected = selected

    def exchange(self, chip: int, data: bytes, speed: int, mode: int) -> bytes:
        """Make a transfer; its settings go to the kernel only where they changed."""
        device = self._selected.get(chip)
        if device is None:
            there = ", ".join(map(str, self._selected))
            raise OSError(errno.ENXIO, f"it has the chip selects {there}")
        if device.mode != mode:
            device.mode = mode
        if device.max_speed_hz != speed:
            device.max_speed_hz = speed
        return bytes(device.xfer2(list(data)))

    def close(self) -> None:
        """Close all of them."""
        for device in self._selected.values():
            with contextlib.suppress(OSError):
                device.close()


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
