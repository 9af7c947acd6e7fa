"""A tree of files as the kernel's ``/sys`` and udev's ``/dev`` are."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest


class FakeTree:
    """What is plugged into a computer that does not exist.

    Attributes:
        root: Where its ``/sys`` and ``/dev`` are.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "dev").mkdir()
        (root / "sys/devices").mkdir(parents=True)

    def usb(
        self,
        place: str,
        vendor: str,
        product: str,
        *,
        serial: str | None = None,
        maker: str = "",
        words: str = "",
    ) -> Path:
        """Plug a USB device in; returns its directory."""
        device = self.root / "sys/devices/pci0/usb1" / place
        (device / f"{place}:1.0").mkdir(parents=True)
        given = {
            "idVendor": vendor,
            "idProduct": product,
            "serial": serial,
            "manufacturer": maker,
            "product": words,
        }
        for name, text in given.items():
            if text is not None:
                (device / name).write_text(f"{text}\n")
        return device

    def tty(
        self, name: str, device: Path | None, *, by_id: str = "", by_path: str = ""
    ) -> None:
        """Give a device a serial port, with the links that udev makes."""
        part = self.root / "sys/devices/virtual" if device is None else device
        place = part / "tty" / name
        place.mkdir(parents=True)
        if device is not None:
            self._link(place / "device", device)
        self._link(self.root / "sys/class/tty" / name, place)
        (self.root / "dev" / name).touch()
        for kind, link in (("by-id", by_id), ("by-path", by_path)):
            if link:
                self._link(
                    self.root / "dev/serial" / kind / link, self.root / "dev" / name
                )

    def usb_serial(
        self, name: str, place: str, vendor: str, product: str, **more: str
    ) -> None:
        """Plug a USB device with one serial port in."""
        links = {key: more.pop(key, "") for key in ("by_id", "by_path")}
        device = self.usb(place, vendor, product, **more)
        self.tty(name, device / f"{place}:1.0", **links)

    def unplug(self, name: str) -> None:
        """Take the node of a port and what the kernel knows of it away."""
        (self.root / "dev" / name).unlink()
        (self.root / "sys/class/tty" / name).unlink()

    def can(self, name: str, *, flags: str, device: Path | None = None) -> None:
        """Add a CAN interface."""
        self._net(name, "280", flags, device)

    def ethernet(self, name: str) -> None:
        """Add a network interface that is none of CAN."""
        self._net(name, "1", "0x1003", None)

    def i2c(self, number: int, name: str, device: Path | None = None) -> None:
        """Add an I²C adapter."""
        part = device or self.root / "sys/devices/platform/i2c"
        adapter = part / f"i2c-{number}"
        place = adapter / "i2c-dev" / f"i2c-{number}"
        place.mkdir(parents=True)
        (place / "name").write_text(f"{name}\n")
        self._link(place / "device", adapter)
        self._link(self.root / "sys/class/i2c-dev" / place.name, place)
        (self.root / "dev" / place.name).touch()

    def gpio(self, number: int, label: str, lines: int) -> None:
        """Add a GPIO chip, with its entry in the old class."""
        part = self.root / f"sys/devices/platform/pinctrl{number}"
        chip = part / f"gpiochip{number}"
        chip.mkdir(parents=True)
        self._link(self.root / "sys/bus/gpio/devices" / chip.name, chip)
        old = part / "gpio" / f"gpiochip{512 + number * 64}"
        old.mkdir(parents=True)
        (old / "label").write_text(f"{label}\n")
        (old / "ngpio").write_text(f"{lines}\n")
        self._link(old / "device", part)
        self._link(self.root / "sys/class/gpio" / old.name, old)
        (self.root / "dev" / chip.name).touch()

    def _net(self, name: str, kind: str, flags: str, device: Path | None) -> None:
        part = self.root / "sys/devices/virtual" if device is None else device
        place = part / "net" / name
        place.mkdir(parents=True)
        (place / "type").write_text(f"{kind}\n")
        (place / "flags").write_text(f"{flags}\n")
        if device is not None:
            self._link(place / "device", device)
        self._link(self.root / "sys/class/net" / name, place)

    @staticmethod
    def _link(link: Path, target: Path) -> None:
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(os.path.relpath(target, link.parent))


@pytest.fixture(scope="session")
def new_tree(tmp_path_factory) -> Callable[[], FakeTree]:
    """For a test that needs many computers."""
    return lambda: FakeTree(tmp_path_factory.mktemp("tree"))


@pytest.fixture
def tree(tmp_path) -> FakeTree:
    """A computer with nothing plugged in."""
    return FakeTree(tmp_path)
