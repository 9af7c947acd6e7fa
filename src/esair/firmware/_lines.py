"""The serial line of a board as this computer's tools see it: lines, and beats between."""

from __future__ import annotations

import time
from typing import Any, Self

import serial

from esair.buses.serial import explain, find_port
from esair.drivers.board.wire import READ, Beat, BoardState, Wire, refusal, unstuffed
from esair.exceptions import ConfigError, EsairError

BAUDRATE = 115200


class Lines:
    """A serial port that may go away and come back, as a board's does at its reset.

    Args:
        place: The port: a path, or ``usb:...``, which may have another path each time.

    Raises:
        ConfigError: It cannot be opened, or another program has it, which is named.
    """

    def __init__(self, place: str) -> None:
        self._place = place
        self._port: Any = None
        self._waiting = b""
        self._wire = Wire(READ)
        self.beat: BoardState | None = None
        """How a linked board was at its last one."""

    def __enter__(self) -> Self:
        self._open(once=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def write(self, data: bytes) -> None:
        try:
            if self._open():
                self._port.write(data)
        except OSError:
            self._close()

    def take(self) -> bytes:
        """Return what has come, after a short wait at most."""
        try:
            if self._open():
                return bytes(self._port.read(max(1, self._port.in_waiting)))
        except OSError:
            self._close()
        return b""

    def read(self) -> list[str]:
        """Return the whole lines that have come, after a short wait at most.

        Raises:
            ConfigError: The board speaks another version of the link.
        """
        *pieces, self._waiting = (self._waiting + self.take()).split(b"\0")
        text = b""
        for piece in pieces:
            payload = unstuffed(piece) if piece else b""
            if payload is None:
                text += piece
            for each in self._wire.said(payload) if payload else ():
                if isinstance(each, Beat):
                    if each.state is None:
                        told = refusal(each.version)
                        raise ConfigError("esair min", self._place, told)
                    self.beat = each.state
        if b"\n" in self._waiting:
            whole, _, self._waiting = self._waiting.rpartition(b"\n")
            text += whole + b"\n"
        self._waiting = self._waiting[-4096:]
        words = (each.decode("utf-8", "replace").strip() for each in text.splitlines())
        # What is left of a message that was cut is no line.
        return [
            each
            for each in words
            if each and each.isprintable() and "\ufffd" not in each
        ]

    def state(self) -> str | None:
        """Return how a linked board is, in words without what changes all the time."""
        beat = self.beat
        if beat is None:
            return None
        words = [f"started by {beat.cause}", "armed" if beat.armed else "not armed"]
        words += [f"{beat.late} late", f"{beat.refused} refused"]
        words += [f"{beat.faults} faults"]
        words += [f"{beat.damaged} damaged messages"] * bool(beat.damaged)
        words += [f"{beat.lost} messages left out"] * bool(beat.lost)
        words += [f"last: {beat.fault}"] * bool(beat.fault)
        return "esair: " + ", ".join(words)

    def _open(self, *, once: bool = False) -> bool:
        if self._port is not None:
            return True
        path = self._place
        try:
            path = find_port(path) if path.startswith("usb:") else path
            self._port = serial.Serial(
                path, BAUDRATE, timeout=0.05, write_timeout=2.0, exclusive=True
            )
        except (OSError, ValueError, EsairError) as error:
            if once:
                told = explain(path, error)
                raise ConfigError("esair min", "port", told) from error
            time.sleep(0.05)
            return False
        return True

    def _close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None
