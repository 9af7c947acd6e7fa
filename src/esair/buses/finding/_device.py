"""One thing that is plugged in."""

from __future__ import annotations

import json

import attrs


@attrs.frozen
class Device:
    """One thing that is plugged in, as far as it can be known without opening it.

    Attributes:
        kind: The medium, such as ``"serial"`` or ``"can"``; or ``"gpio"``.
        path: Where it is now: a device file, or the name of a CAN interface.
        address: What a robot.toml calls it, so that it is found again after it was
            plugged in elsewhere; the path if nothing better is known.
        description: What it says about itself, in words.
        identity: ``usb:VID:PID`` or ``usb:VID:PID:SERIAL``; None if it is no USB device.
        by_id: Its link in ``/dev/serial/by-id``; None if it has none.
        state: What is known about its state, in words, such as ``"up, 500 kbit/s"`` or
            ``"no permission: join the group dialout"``.
        bitrate: Bits per second of a CAN interface; None if it is not known.
        lines: How many lines a GPIO chip has; None if it is not known.
    """

    kind: str
    path: str
    address: str
    description: str = ""
    identity: str | None = None
    by_id: str | None = None
    state: str = ""
    bitrate: int | None = None
    lines: int | None = None

    @property
    def key(self) -> tuple[str, str, str | None]:
        """What tells it from another device, and from itself elsewhere."""
        return self.kind, self.path, self.identity


def quoted(text: str) -> str:
    """Return a text as TOML writes it."""
    return json.dumps(text, ensure_ascii=False)
