"""Serial ports: which there are, and which of them a USB device is."""

from __future__ import annotations

import os
import platform
import stat
from pathlib import Path

import attrs

from esair.buses import finding
from esair.buses.finding import ROOT, Device

_UNUSED = "0"
"""The type of a port that the kernel provides for, and the computer does not have."""

_BETWEEN = frozenset({"driver", "port", "ctrl"})
"""What stands between a port and its driver: no link, or the kernel's serial core."""


def find_port(identity: str, root: Path = ROOT) -> str:
    """Return the path of the serial port that a USB device is. Blocks for a moment.

    Args:
        identity: ``usb:VID:PID`` or ``usb:VID:PID:SERIAL``, the numbers hexadecimal.
        root: Where ``/sys`` and ``/dev`` are.

    Returns:
        The name that stays the same, in ``/dev/serial/by-id``, if there is one.

    Raises:
        ConfigError: It is not the form of an identity.
        ConnectionError: No such device is there, or several are.
    """
    wanted = finding.parse_identity(identity)
    ports = devices(root)
    fitting = [port for port in ports if _fits(wanted, port)]
    if len(fitting) == 1:
        return fitting[0].by_id or fitting[0].path
    if not fitting:
        there = ", ".join(port.identity for port in ports if port.identity) or "none"
        raise ConnectionError(
            f"{identity} is not there; of USB serial ports there is {there}"
        )
    raise ConnectionError(
        f"{identity} are {len(fitting)} ports: "
        + ", ".join(f"{port.path} ({port.identity})" for port in fitting)
        + "; "
        + _remedy(fitting)
    )


def serial_identity(path: str, root: Path = ROOT) -> str | None:
    """Return ``usb:VID:PID[:SERIAL]`` of a serial port; None if it is no USB device.

    Args:
        path: Its path, or a link to it.
        root: Where ``/sys`` and ``/dev`` are.
    """
    node = root / path.lstrip("/")
    place = root / "sys/class/tty" / os.path.basename(os.path.realpath(node))
    if not place.exists():  # a container may call it what it likes
        try:
            found = os.stat(node)
        except OSError:
            return None
        if not stat.S_ISCHR(found.st_mode):
            return None
        number = f"{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}"
        place = root / "sys/dev/char" / number
    return finding.identity_of(finding.usb_device(place / "device", root))


def devices(root: Path = ROOT) -> list[Device]:
    """Return the serial ports that are there, by their names."""
    if root == ROOT and platform.system() != "Linux":
        found, by_path = _ports_of_pyserial(), {}
    else:
        found = _ports_of_sysfs(root)
        by_path = _links(root / "dev/serial/by-path", root)
    return [
        attrs.evolve(port, address=_address(port, found, by_path)) for port in found
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a port."""
    return [
        f"[bus.{name}]",
        'type = "serial"',
        f"port = {finding.quoted(device.address)}",
        "baudrate = 115200",
    ]


def _ports_of_sysfs(root: Path) -> list[Device]:
    links = _links(root / "dev/serial/by-id", root)
    found = []
    for place in finding.entries(root / "sys/class/tty"):
        path = f"/dev/{place.name}"
        if not (place / "device").exists() or not (root / path[1:]).exists():
            continue  # a console or pseudo-terminal, or not in this container
        usb = finding.usb_device(place / "device", root)
        if usb is None and finding.read(place / "type") == _UNUSED:
            continue
        found.append(
            Device(
                kind="serial",
                path=path,
                address=path,
                description=_words(place, usb),
                identity=finding.identity_of(usb),
                by_id=links.get(path),
                state=finding.permission(root / path[1:]),
            )
        )
    return found


def _links(directory: Path, root: Path) -> dict[str, str]:
    """Return the first link to each port."""
    found: dict[str, str] = {}
    for link in finding.entries(directory):
        target = os.path.relpath(os.path.realpath(link), os.path.realpath(root))
        found.setdefault(f"/{target}", f"/{link.relative_to(root)}")
    return found


def _words(place: Path, usb: Path | None) -> str:
    if usb is not None:
        return finding.words_of(usb) or "USB serial port"
    device = (place / "device").resolve()
    for part in (device, *device.parents[:3]):
        driver = os.path.basename(os.path.realpath(part / "driver"))
        if driver not in _BETWEEN:
            return f"port of the computer ({driver})"
    return "port of the computer"


def _ports_of_pyserial() -> list[Device]:
    from serial.tools import list_ports

    found = []
    for port in sorted(list_ports.comports(), key=lambda each: str(each.device)):
        identity = None
        if port.vid is not None and port.pid is not None:
            identity = str(
                finding.UsbIdentity(port.vid, port.pid, port.serial_number or "")
            )
        words = "".join(
            each if each.isprintable() else "?" for each in port.description or ""
        )
        found.append(
            Device(
                kind="serial",
                path=port.device,
                address=port.device,
                description=words,
                identity=identity,
            )
        )
    return found


def _address(port: Device, ports: list[Device], by_path: dict[str, str]) -> str:
    """Return how it is found again: by who it is, or else by where it is plugged in."""
    if port.identity is not None:
        wanted = finding.parse_identity(port.identity)
        alike = [other for other in ports if _fits(wanted, other)]
        if len(alike) == 1:
            return port.identity
        if port.by_id and all(other.by_id for other in alike):
            return port.by_id  # the ports of one device
    return by_path.get(port.path, port.path)


def _fits(wanted: finding.UsbIdentity, port: Device) -> bool:
    return port.identity is not None and wanted.fits(
        finding.parse_identity(port.identity)
    )


def _remedy(fitting: list[Device]) -> str:
    if len({port.identity for port in fitting}) == len(fitting):
        return "add the serial number of the one that is meant"
    return "say which one by its path in /dev/serial/by-id or /dev/serial/by-path"
