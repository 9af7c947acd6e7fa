"""USB devices by who they are: vendor, product, serial number."""

from __future__ import annotations

import re
from pathlib import Path

import attrs

from esair.buses.finding._sysfs import read
from esair.exceptions import ConfigError

_FORM = re.compile(r"usb:([0-9A-Fa-f]{4}):([0-9A-Fa-f]{4})(?::(.+))?\Z")


@attrs.frozen
class UsbIdentity:
    """Who a USB device says it is.

    Attributes:
        vendor: Who made it, 0 to 0xFFFF.
        product: Which of the vendor's products it is, 0 to 0xFFFF.
        serial: Which piece of it; empty if it has no number, or any may be meant.
    """

    vendor: int
    product: int
    serial: str = ""

    def fits(self, other: UsbIdentity) -> bool:
        """Return whether another device is the one that is meant by this."""
        return (self.vendor, self.product) == (other.vendor, other.product) and (
            not self.serial or self.serial == other.serial
        )

    def __str__(self) -> str:
        text = f"usb:{self.vendor:04x}:{self.product:04x}"
        return f"{text}:{self.serial}" if self.serial else text


def parse_identity(
    text: str, *, component: str = "discovery", field: str = "identity"
) -> UsbIdentity:
    """Read ``usb:VID:PID`` or ``usb:VID:PID:SERIAL``.

    Raises:
        ConfigError: It is neither; told of a component and its field.
    """
    found = _FORM.match(text)
    if found is None:
        raise ConfigError(
            component,
            field,
            "expected usb:VID:PID or usb:VID:PID:SERIAL, both numbers with four "
            f"hexadecimal digits, not {text!r:.80}",
        )
    vendor, product, serial = found.groups()
    return UsbIdentity(int(vendor, 16), int(product, 16), serial or "")


def usb_device(place: Path, root: Path) -> Path | None:
    """Return the USB device that something in ``/sys`` is a part of.

    Args:
        place: The directory of the part; links are followed.
        root: Where ``/sys`` is; nothing above it is looked at.
    """
    top = (root / "sys").resolve()
    place = place.resolve()
    while place != top and top in place.parents:
        if (place / "idVendor").is_file():
            return place
        place = place.parent
    return None


def identity_of(device: Path | None) -> str | None:
    """Return ``usb:VID:PID[:SERIAL]`` of a USB device, by its directory in ``/sys``."""
    if device is None:
        return None
    try:
        vendor = int(read(device / "idVendor"), 16)
        product = int(read(device / "idProduct"), 16)
    except ValueError:  # it is just being unplugged
        return None
    serial = read(device / "serial")
    # A blank memory gives characters that are none, and no two devices differ.
    return str(UsbIdentity(vendor, product, serial if "?" not in serial else ""))


def words_of(device: Path) -> str:
    """Return what a USB device calls itself, with its maker's name once."""
    maker, product = read(device / "manufacturer"), read(device / "product")
    if product.startswith(maker):
        return product
    return f"{maker} {product}".strip()
