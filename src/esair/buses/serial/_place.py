"""Where the port of a serial line is: a path, a USB device, or a URL."""

from __future__ import annotations

import os
import re
from collections.abc import Hashable

from esair.buses.finding import parse_identity
from esair.buses.serial import _ports
from esair.exceptions import ConfigError

_NUMBERED = re.compile(r"/dev/tty(USB|ACM)\d+\Z")


class SerialPlace:
    """Where a port is to be found: a device file, a USB device, or a URL of pyserial.

    Args:
        owner: The name of the bus, for errors.
        port: ``/dev/ttyUSB0``, ``usb:VID:PID[:SERIAL]`` or ``loop://``.

    Raises:
        ConfigError: It is none of them.
    """

    def __init__(self, owner: str, port: str) -> None:
        if not isinstance(port, str) or not port:
            raise ConfigError(
                owner,
                "port",
                "expected the path of a device file, usb:VID:PID[:SERIAL], or a URL "
                f"such as loop://, not {port!r:.80}",
            )
        self.is_usb: bool = port.startswith("usb:")
        if self.is_usb:
            parse_identity(port, component=owner, field="port")
        self.owner = owner
        self.port = port
        self.is_url: bool = "://" in port

    def find(self) -> str:
        """Return the path, or the URL, to open. Blocks.

        Raises:
            ConnectionError: The USB device is not there.
        """
        if not self.is_usb:
            return self.port
        return _ports.find_port(self.port)

    def look(self) -> Hashable | None:
        """Return what is at the place now; None if nothing is. Blocks.

        Another value means that something was plugged in since.
        """
        try:
            path = self.find()
            found = os.stat(path)
        except OSError:
            return None
        return path, found.st_rdev, found.st_ino, found.st_ctime_ns

    def check(self, path: str, fd: int) -> None:
        """Make sure that an open descriptor is of the device that is meant. Blocks.

        Raises:
            ConnectionError: Another device was plugged in while it was opened.
        """
        if not self.is_usb:
            return
        try:
            # Not its path: udev may have made a better name for it meanwhile.
            same = os.stat(self.find()).st_rdev == os.fstat(fd).st_rdev
        except OSError:
            same = False
        if not same:
            raise ConnectionError(f"{path} is no longer {self.port}")

    def advice(self, path: str) -> str:
        """Say how to name a port whose number is chance; empty if it is none. Blocks."""
        if self.is_usb or not _NUMBERED.match(path):
            return ""
        identity = _ports.serial_identity(path)
        better = f"now it is {identity!r}" if identity else "see /dev/serial/by-path"
        return f"{path} is another device after the next start, perhaps: {better}"
