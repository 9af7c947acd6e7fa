"""A device as a robot.toml names it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable

from esair.discovery._can import VIRTUAL
from esair.discovery._device import Device


def toml(device: Device) -> str:
    """Return the table of a robot.toml for a device, ready to be pasted.

    What only the user can know, such as a bit rate, is the usual value; for GPIO it
    is an input on the first line.
    """
    name = re.sub("[^a-z0-9]+", "_", device.path.rpartition("/")[2].lower())
    head = f"# {device.description or device.kind}"
    if device.address not in {device.path, device.path.rpartition("-")[2]}:
        head += f", now {device.path}"
    lines: Iterable[str]
    match device.kind:
        case "serial":
            lines = (
                f"[bus.{name}]",
                'type = "serial"',
                f"port = {_quoted(device.address)}",
                "baudrate = 115200",
            )
        case "can":
            lines = (
                *_how_to_start(device),
                f"[bus.{name}]",
                'type = "can"',
                'interface = "socketcan"',
                f"channel = {_quoted(device.address)}",
            )
        case "i2c":
            number = device.address.isdecimal()
            lines = (
                f"[bus.{name}]",
                'type = "i2c"',
                f"bus = {device.address if number else _quoted(device.address)}",
            )
        case "gpio":
            lines = (
                f"[sensor.{name}_line0]",
                'driver = "gpio"',
                f"chip = {_quoted(device.address)}",
                "line = 0",
            )
    return "\n".join((head, *lines)) + "\n"


def _how_to_start(device: Device) -> tuple[str, ...]:
    if not device.state.startswith("down"):
        return ()
    is_set = device.bitrate is not None or device.description == VIRTUAL
    kind = "" if is_set else " type can bitrate 500000"
    return (f"# it is down: sudo ip link set {device.path} up{kind}",)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
