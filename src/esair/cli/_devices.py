"""``esair devices``: what is plugged in, and the lines for it in a robot.toml."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import attrs
from cyclopts import Parameter
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from esair import discovery
from esair.cli._errors import CANNOT_USE, INTERRUPTED, tell, wrong_seconds
from esair.discovery import Device, Plugs, Wakes
from esair.exceptions import EsairError, describe

NOT_FOUND: Final = 1
"""The exit code if nothing was unplugged in time, or a bus could not be scanned."""

GLANCE: Final = 0.5  # How often to look if udev says nothing, in seconds
SETTLE: Final = 0.5  # How long the parts of one device may take to go, in seconds

OFTEN: Final = {
    0x40: "pca9685",
    0x48: "ads1115",
    0x49: "ads1115",
    0x4A: "ads1115",
    0x4B: "ads1115",
    0x68: "mpu6050",
    0x69: "mpu6050",
    0x76: "bme280",
    0x77: "bme280",
}
"""Which of esair's drivers is for a chip that is often at an address."""

Event = Literal["there", "plugged", "unplugged"]

Chips = dict[str, dict[int, str]]
"""What answered on each I²C bus: its state by its address."""


def devices(
    *,
    as_toml: Annotated[bool, Parameter(name="--toml")] = False,
    scan: bool = False,
    watch: bool = False,
    find: bool = False,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
    seconds: Annotated[float | None, Parameter(name="--for")] = None,
    root: Annotated[Path, Parameter(show=False)] = Path("/"),
) -> int:
    """List what is plugged in, with the lines for a robot.toml.

    Serial ports, CAN, I²C, SPI, GPIO, gamepads and cameras.

    Exit code: 0 done, 1 nothing was found in time or a bus could not be scanned,
    2 the command line cannot be used, 130 Ctrl-C.

    Args:
        as_toml: Print only what goes into a robot.toml.
        scan: Look which chips answer on the I²C buses, as carefully as i2cdetect.
        watch: Go on, and tell what is plugged in and out.
        find: Name the device that you unplug now.
        as_json: Print JSON, for programs; with --watch one object per line.
        seconds: End --watch or --find after this many seconds.
        root: Where /sys and /dev are, for a computer that is mounted elsewhere.
    """
    mistake = _mistake(
        {"--toml": as_toml, "--scan": scan, "--watch": watch, "--find": find},
        as_json=as_json,
        seconds=seconds,
    )
    if mistake:
        tell(mistake)
    if mistake or wrong_seconds(seconds):
        return CANNOT_USE
    show: _Json | _Words = _Json() if as_json else _Words(only_toml=as_toml)
    try:
        if watch:
            return _watch(root, show, seconds)
        if find:
            return _find(root, show, seconds)
        return _list(root, show, scan=scan)
    except KeyboardInterrupt:
        return INTERRUPTED


def to_json(device: Device, chips: dict[int, str] | None = None) -> dict[str, Any]:
    """Return a device as ``esair devices --json`` prints it.

    The schema, where ``schema`` grows when a key changes its meaning or goes (keys
    may be added): ``{"schema": 1, "devices": [...]}``, each with ::

        kind         "serial" | "can" | "i2c" | "spi" | "gpio" | "gamepad" | "camera"
        path         string: the device file, or the name of the CAN interface
        address      string: what robot.toml calls it
        description  string
        identity     string: usb:VID:PID[:SERIAL] | null
        by_id        string: its link in /dev/serial/by-id | null
        state        string
        bitrate      integer: bits per second | null
        lines        integer: of a GPIO chip | null
        toml         string: its table in a robot.toml
        chips        with --scan, for I²C: list of
            address      integer
            state        "answers" | "busy": the kernel's own driver has it

    With ``--watch`` each line is ``{"event": "there" | "plugged" | "unplugged",
    "device": {...}}``.
    """
    found = {**attrs.asdict(device), "toml": discovery.toml(device)}
    if chips is not None:
        found["chips"] = [
            {"address": address, "state": state} for address, state in chips.items()
        ]
    return found


def _mistake(verbs: dict[str, bool], *, as_json: bool, seconds: float | None) -> str:
    asked = [name for name, wanted in verbs.items() if wanted]
    if len(asked) > 1:
        return f"{' and '.join(asked)}: expected one of them"
    if as_json and verbs["--toml"]:
        return "--json and --toml: expected one of them (the JSON has the TOML too)"
    if seconds is not None and not (verbs["--watch"] or verbs["--find"]):
        return "--for: expected it with --watch or --find"
    return ""


def _list(root: Path, show: _Json | _Words, *, scan: bool) -> int:
    found = discovery.devices(root)
    chips: Chips = {}
    buses = [device for device in found if scan and device.kind == "i2c"]
    if scan and not buses:
        tell("--scan: there is no I²C bus (sudo modprobe i2c-dev makes them appear)")
    for device in buses:
        try:
            chips[device.path] = asyncio.run(_scan(device))
        except EsairError as error:
            tell(f"{device.path}: {describe(error)}")
    show.listed(found, chips)
    return NOT_FOUND if scan and len(chips) < max(1, len(buses)) else 0


async def _scan(device: Device) -> dict[int, str]:
    from esair.buses import I2CBus

    bus = I2CBus(name="scan", bus=device.path)
    try:
        await bus.open()
        return await bus.scan()
    finally:
        await bus.close()


def _watch(root: Path, show: _Json | _Words, seconds: float | None) -> int:
    with Wakes() as wakes:
        wakes.listen()
        plugs = Plugs(root)
        for device in plugs.there:
            show.change("there", device)
        for _ in _rounds(wakes, seconds):
            came, gone = plugs.look()
            for device in gone:
                show.change("unplugged", device)
            for device in came:
                show.change("plugged", device)
    return 0


def _find(root: Path, show: _Json | _Words, seconds: float | None) -> int:
    with Wakes() as wakes:
        wakes.listen()
        plugs = Plugs(root)
        tell("unplug the device now; Ctrl-C gives up")
        for _ in _rounds(wakes, seconds):
            gone = plugs.look()[1]
            if gone:
                time.sleep(SETTLE)  # its other ports, or the rest of a hub
                show.found(gone + plugs.look()[1])
                return 0
    tell("nothing was unplugged; what has no plug of its own is in: esair devices")
    return NOT_FOUND


def _rounds(wakes: Wakes, seconds: float | None) -> Iterator[None]:
    """Return again and again, when udev has news or it is time for a look."""
    end = math.inf if seconds is None else time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        wakes.wait(min(left, GLANCE))
        yield


class _Json:
    """Answers for programs."""

    def listed(self, found: list[Device], chips: Chips) -> None:
        all_of_them = [to_json(device, chips.get(device.path)) for device in found]
        self._print({"schema": 1, "devices": all_of_them}, indent=2)

    def change(self, event: Event, device: Device) -> None:
        self._print({"event": event, "device": to_json(device)})

    def found(self, gone: list[Device]) -> None:
        self.listed(gone, {})

    def _print(self, answer: dict[str, Any], indent: int | None = None) -> None:
        print(json.dumps(answer, indent=indent), flush=True)  # noqa: T201 - command line


class _Words:
    """Answers for people."""

    def __init__(self, *, only_toml: bool) -> None:
        self._only_toml = only_toml
        self._console = Console(highlight=False)

    def listed(self, found: list[Device], chips: Chips) -> None:
        if not self._only_toml:
            if not found:
                self._console.print("nothing is plugged in that esair can use")
                return
            self._console.print(_table(found, chips))
            self._console.print(Text("For a robot.toml:", "bold"))
        self._toml(found)

    def change(self, event: Event, device: Device) -> None:
        sign, style = _SIGNS[event]
        line = Text(f"{sign} {device.kind:<6} {device.path}", style)
        for part in (device.identity, _what(device)):
            line.append(f"  {part}" if part else "", "not bold")
        self._console.print(line, soft_wrap=True)

    def found(self, gone: list[Device]) -> None:
        for device in gone:
            line = Text("That was ")
            line.append(_what(device) or device.kind, "bold")
            line.append(f": {device.path}")
            line.append(f", {device.identity}" if device.identity else "")
            self._console.print(line, soft_wrap=True)
        self._toml(gone)

    def _toml(self, found: list[Device]) -> None:
        for device in found:
            self._console.out(f"\n{discovery.toml(device)}", end="", highlight=False)


_SIGNS: Final[dict[Event, tuple[str, str]]] = {
    "there": (" ", ""),
    "plugged": ("+", "bold green"),
    "unplugged": ("-", "bold red"),
}


def _table(found: list[Device], chips: Chips) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("kind", style="dim")
    table.add_column("where", style="bold", overflow="fold")
    table.add_column("who", style="cyan", overflow="fold")
    table.add_column("what", overflow="fold", ratio=1)
    for device in found:
        table.add_row(
            device.kind,
            Text(device.path),
            Text(device.identity or ""),
            Text(_what(device)),
        )
        for address, state in chips.get(device.path, {}).items():
            hint = OFTEN.get(address)
            words = f"{state}; {hint} is often here" if hint else state
            table.add_row("", Text(f"  {address:#04x}"), "", Text(words))
        if device.path in chips and not chips[device.path]:
            table.add_row("", "", "", Text("no chip answers", "yellow"))
    return table


def _what(device: Device) -> str:
    lines = "" if device.lines is None else f"{device.lines} lines"
    return ", ".join(part for part in (device.description, device.state, lines) if part)
