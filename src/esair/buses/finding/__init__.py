"""How things that are plugged in are found: what the media share.

Nothing here opens a device. What is found of one medium is in the folder of the medium;
all of it together is `esair.discovery`.
"""

from esair.buses.finding._device import Device, permission, pick, quoted, who_may
from esair.buses.finding._sysfs import ROOT, entries, read
from esair.buses.finding._usb import (
    UsbIdentity,
    identity_of,
    parse_identity,
    usb_device,
    words_of,
)
from esair.buses.finding._wakes import Wakes
from esair.buses.finding._watch import watch

__all__ = [
    "ROOT",
    "Device",
    "UsbIdentity",
    "Wakes",
    "entries",
    "identity_of",
    "parse_identity",
    "permission",
    "pick",
    "quoted",
    "read",
    "usb_device",
    "watch",
    "who_may",
    "words_of",
]
