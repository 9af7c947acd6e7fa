"""Gamepads and joysticks of the kernel's input system, with a dead man's button.

::

    [sensor.pad]
    driver = "gamepad"
    device = "usb:045e:028e"      # or a path, or the beginning of its name
    dead_man = "tl"               # the left shoulder; nothing moves unless it is held

    pip install 'esair[gamepad]'

The package evdev is built from its source, which needs a compiler and the headers of Python
and Linux (``apt install python3-dev linux-libc-dev gcc``).

A pad that loses its radio link says nothing for seconds, until the kernel gives it up:
its sticks and buttons stay as they were; one with a dongle of its own may never say that it
is gone. Where that matters it needs a cable, or ``still_after = 1.0``: a hand that has not
moved at all for so long holds nothing any more.

Source: the kernel's ``Documentation/input/gamepad.rst`` and ``linux/input-event-codes.h``.
"""

from esair.drivers.gamepad._find import devices, find_pad, toml
from esair.drivers.gamepad._pad import AXES, BUTTONS, Axis, Pad, PadState
from esair.drivers.gamepad._sensor import Gamepad, PadLink

__all__ = [
    "AXES",
    "BUTTONS",
    "Axis",
    "Gamepad",
    "Pad",
    "PadLink",
    "PadState",
    "devices",
    "find_pad",
    "toml",
]
