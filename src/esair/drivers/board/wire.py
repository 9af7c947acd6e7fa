"""What goes over the line between a board and a computer; pure, without any I/O.

The last two versions of the link are spoken: 3, and 2, which has one command and one rate
in a message, and all counts in each beat. What a board speaks, its first beat says.
"""

from __future__ import annotations

import json
import struct
from binascii import crc32
from collections.abc import Mapping
from typing import Any, Final

import attrs

from esair.boards.link import DAY_MS, VERSION, packed, unpacked
from esair.boards.start import CAUSES

SPOKEN: Final = (2, VERSION)
"""The versions of the link that this computer speaks."""

_BEAT: Final = struct.Struct("<BBBBHI")
_COUNTS: Final = struct.Struct("<IIIHH")
_ROOM: Final = 48
"""Bytes of a message at most, unless one command is longer: a step reads them one by one."""


@attrs.frozen
class BoardState:
    """How a board is.

    Attributes:
        now_ms: Its time, in milliseconds since its start.
        steps: How many steps it has made.
        late: How many steps it has left out because they came too late.
        refused: How many commands it has refused.
        faults: How many times a part of it has failed.
        fault: The last fault; empty if there was none.
        memory: The bytes of memory that were free on it when it had started.
        cause: Why it has started: ``"power-on"``, ``"watchdog"``, ...
        armed: Whether its actuators may move.
        damaged: How many messages of this computer it could not read.
        sensors: The names of those of its sensors that have given a reading.
        actuators: The names of its actuators.
        lost: How many messages it has left out because the line was full.
    """

    now_ms: int = 0
    steps: int = 0
    late: int = 0
    refused: int = 0
    faults: int = 0
    fault: str = ""
    memory: int = 0
    cause: str = ""
    armed: bool = False
    damaged: int = 0
    sensors: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()
    lost: int = 0


@attrs.frozen
class Beat:
    """A beat: the version that the board speaks, and how it is if that is known here."""

    version: int
    state: BoardState | None


@attrs.frozen
class Heard:
    """A reading of a sensor; ``gone`` if it gives none on the board."""

    name: str
    value: Any
    gone: bool = False


def refusal(version: int) -> str:
    """Say that a board speaks another version."""
    spoken = " and ".join(map(str, SPOKEN))
    return (
        f"the board speaks version {version} of the link, this computer {spoken}: "
        "build and deploy it anew"
    )


def stuffed(payload: bytes) -> bytes:
    """Return a message with its checksum, stuffed so that only its ends are zero."""
    data = payload + (crc32(payload) & 0xFFFFFFFF).to_bytes(4, "little")
    found = bytearray(b"\0")
    for piece in data.split(b"\0"):
        while len(piece) >= 254:
            found.append(255)
            found += piece[:254]
            piece = piece[254:]
        found.append(len(piece) + 1)
        found += piece
    found.append(0)
    return bytes(found)


def unstuffed(data: bytes) -> bytes | None:
    """Return the payload of what was between two zeros; None if it is damaged."""
    found = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            return None
        found += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            found.append(0)
    payload = bytes(found[:-4])
    if len(found) < 5 or bytes(found[-4:]) != crc32(payload).to_bytes(4, "little"):
        return None
    return payload


def signed(payload: bytes) -> bytes:
    """Return a message with its checksum."""
    return payload + crc32(payload).to_bytes(4, "little")


class Wire:
    """One board, as its messages tell it.

    Attributes:
        version: What it speaks; 0 before its first beat.
        named: Whether its sensors and actuators are known by name.
        period: How long its steps are, in seconds: it takes one message in each.
            Known with the names.
    """

    def __init__(self) -> None:
        self.version: Any = 0
        self.named: bool = False
        self.period: float = 1.0
        self._free = 0
        self._counts: tuple[int, ...] = ()
        self._sensors: list[str] = []
        self._actuators: list[str] = []
        self._seen: dict[str, None] = {}
        self._fault = ""
        self._form = "f"

    def read(self, message: bytes) -> list[Beat | Heard]:
        """Return what a message with its checksum says; nothing if it is damaged."""
        payload = message[:-4]
        return self.said(payload) if message == signed(payload) else []

    def said(self, payload: bytes) -> list[Beat | Heard]:
        """Return what a message says, whose checksum is right and gone."""
        try:
            return self._said(payload)
        except (ValueError, TypeError, LookupError, struct.error):
            return []  # it is of another version, or none of ours

    def _said(self, payload: bytes) -> list[Beat | Heard]:
        kind = payload[:1]
        if kind == b"B":  # of version 1, or for a computer that speaks only that
            self.version = int(json.loads(payload[2:].decode())[0])
            return [Beat(self.version, None)] * (self.version not in SPOKEN)
        if kind == b"b":
            beat = self._beat(payload)
            return [beat] * (beat.state is None or bool(self._counts))
        if kind == b"n" and self.version in SPOKEN:
            rate, self._free = struct.unpack_from("<II", payload, 1)
            self.period = 1000 / rate
            sensors, _, actuators = payload[9:].decode().partition(";")
            self._sensors = sensors.split(",")
            self._actuators = actuators.split(",")
            self.named = True
        elif kind == b"s" and self.named:
            return self._readings(payload)
        return []

    def _beat(self, payload: bytes) -> Beat:
        if payload[1] not in SPOKEN:
            self.version = payload[1]
            return Beat(self.version, None)
        _, self.version, flags, cause, days, now = _BEAT.unpack_from(payload)
        if len(payload) > _BEAT.size:
            self._counts = _COUNTS.unpack_from(payload, _BEAT.size)
            text = payload[_BEAT.size + _COUNTS.size :].decode("utf-8", "replace")
            self._fault = text or self._fault
        late, refused, faults, damaged, lost = self._counts or [0] * 5
        self._form = "d" if flags & 2 else "f"
        state = BoardState(
            now_ms=days * DAY_MS + now,
            steps=round((days * DAY_MS + now) / 1000 / self.period) - late,
            late=late,
            refused=refused,
            faults=faults,
            fault=self._fault if faults else "",
            memory=self._free,
            cause=CAUSES[cause] if cause < len(CAUSES) else "another cause",
            armed=bool(flags & 1),
            damaged=damaged,
            sensors=tuple(self._seen),
            actuators=tuple(self._actuators),
            lost=lost,
        )
        return Beat(self.version, state)

    def _readings(self, payload: bytes) -> list[Beat | Heard]:
        found: list[Beat | Heard] = []
        at = 1
        while at < len(payload):
            name = self._sensors[payload[at]]
            if payload[at + 1] == ord("x"):
                found.append(self._reading(name, gone=True))
                at += 2
            else:
                value, at = unpacked(payload, at + 1)
                found.append(self._reading(name, value))
        return found if at == len(payload) else []

    def _reading(self, name: str, value: Any = None, *, gone: bool = False) -> Heard:
        if gone:
            self._seen.pop(name, None)
        else:
            self._seen[name] = None
        return Heard(name, tuples(value), gone)

    def beat(self, armed: bool | None) -> list[bytes]:
        """Return the messages of a beat that this computer sends, to arm or not."""
        if self.version not in SPOKEN:
            return []
        flags = (not self.named) + (0 if armed is None else 2 if armed else 4)
        return [signed(bytes([ord("h"), self.version, flags]))]

    def rates(self, asked: Mapping[str, float]) -> list[bytes]:
        """Return the messages that ask for sensors, each at a rate in Hz."""
        wanted = b"".join(
            struct.pack(
                "<BH",
                self._sensors.index(name),
                min(65535, max(1, int(1000 / rate))),
            )
            for name, rate in asked.items()
            if self.named and name in self._sensors
        )
        size = 3 if self.version == 2 else _ROOM // 3 * 3
        return [
            signed(b"r" + wanted[at : at + size]) for at in range(0, len(wanted), size)
        ]

    def command(self, name: str, value: Any) -> bytes | None:
        """Return what `commands` take for a command; None for an unknown actuator."""
        if name not in self._actuators:
            return None
        buffer = bytearray(len(repr(value)) * 9 + 16)
        buffer[0] = self._actuators.index(name)
        end = packed(buffer, 1, value, self._form)
        return bytes(buffer[:end])

    def commands(self, waiting: Mapping[str, bytes]) -> tuple[bytes, list[str]]:
        """Return the message of the first commands that wait, and whose they are."""
        data, names = b"w", list[str]()
        for name, command in waiting.items():
            if names and (self.version == 2 or len(data) + len(command) > _ROOM):
                break
            data += command
            names.append(name)
        return signed(data), names


def tuples(value: Any) -> Any:
    """Return a value with its rows as tuples."""
    if isinstance(value, list | tuple):
        return tuple(map(tuples, value))
    return value
