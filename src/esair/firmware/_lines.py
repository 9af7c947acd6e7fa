"""The serial line of a board as this computer's tools see it: lines, and beats between."""

from __future__ import annotations

import json
import time
from typing import Any, Self

import serial

from esair.boards.link import unstuffed
from esair.exceptions import ConfigError

BAUDRATE = 115200


class Lines:
    """A serial port that may go away and come back, as a board's does at its reset.

    Args:
        path: The port.

    Raises:
        ConfigError: It cannot be opened.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._port: Any = None
        self._waiting = b""
        self._beat: list[Any] | None = None

    def __enter__(self) -> Self:
        self._open(once=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def write(self, data: bytes) -> None:
        """Send bytes, if the port is there."""
        try:
            if self._open():
                self._port.write(data)
        except OSError:
            self._close()

    def read(self) -> list[str]:
        """Return the whole lines that have come, after a short wait at most."""
        try:
            if self._open():
                self._waiting += self._port.read(max(1, self._port.in_waiting))
        except OSError:
            self._close()
        *pieces, self._waiting = self._waiting.split(b"\0")
        text = b""
        for piece in pieces:
            payload = unstuffed(piece) if piece else b""
            if payload is None:
                text += piece
            elif payload[:2] == b"B\0":
                self._beat = json.loads(payload[2:])
        if b"\n" in self._waiting:
            whole, _, self._waiting = self._waiting.rpartition(b"\n")
            text += whole + b"\n"
        self._waiting = self._waiting[-4096:]
        return [
            line
            for each in text.splitlines()
            if (line := each.decode("utf-8", "replace").strip())
        ]

    def state(self) -> str | None:
        """Return how a linked board is, in words without what changes all the time."""
        if self._beat is None:
            return None
        _, _, _, late, refused, faults, fault, _, cause, armed, damaged, *_ = self._beat
        words = [f"started by {cause}", "armed" if armed else "not armed"]
        words += [f"{late} late", f"{refused} refused", f"{faults} faults"]
        words += [f"{damaged} damaged messages"] * bool(damaged)
        words += [f"last: {fault}"] * bool(fault)
        return "esair: " + ", ".join(words)

    def _open(self, *, once: bool = False) -> bool:
        if self._port is not None:
            return True
        try:
            self._port = serial.Serial(self._path, BAUDRATE, timeout=0.05)
        except (OSError, ValueError) as error:
            if once:
                raise ConfigError("esair min", "port", str(error)) from error
            time.sleep(0.05)
            return False
        return True

    def _close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None
