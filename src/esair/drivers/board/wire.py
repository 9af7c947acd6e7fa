"""What goes over the line between a board and a computer; pure, without any I/O.

What a board speaks, its first beat says. The version before is understood, for who
watches a board, and nothing is told to it: it takes what is old for new.
"""

from __future__ import annotations

import json
import struct
from binascii import crc32
from collections.abc import Mapping
from typing import Any, Final

import attrs

from esair.boards.link import DAY_MS, LONGEST, VERSION, packed, unpacked
from esair.boards.start import CAUSES

READ: Final = (3, VERSION)
"""The versions of the link that this computer understands."""

_BEAT: Final = struct.Struct("<BBBBHI")
_COUNTS: Final = struct.Struct("<IIIHH")
_REASONS: Final = {
    "h": "it holds it",
    "b": "it is blind",
    "g": "it lets nothing pass",
    "n": "the board is not armed",
    "l": "it came too late",
    "x": "the board takes no such command",
    "f": "it failed on the board",
}
"""What a board says of a command that was not done, by letter."""

PLACES: Final = 32
"""So many actuators a message tells apart: the rest of its byte numbers the commands."""

NAMES: Final = LONGEST - 4 - struct.calcsize("<BII")
"""Bytes that all names of a board have, in the one message that tells them."""

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


@attrs.frozen
class Answer:
    """What came of a command: ``reason`` if it was not done, and ``who`` is against it.

    Attributes:
        name: The actuator.
        number: That of the command, as `Wire.command` has counted it.
        done: What was done of it; None for all.
    """

    name: str
    number: int
    reason: str = ""
    who: str = ""
    done: Any = None


def refusal(version: int) -> str:
    """Say that a board speaks another version."""
    return (
        f"the board speaks version {version} of the link, this computer {VERSION}: "
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

    Args:
        read: The versions that are understood.

    Attributes:
        version: What it speaks; 0 before its first beat.
        named: Whether its sensors and actuators are known by name.
        period: How long its steps are, in seconds: it takes one message in each.
            Known with the names.
        sensors: The names of its sensors.
        owes: Whether its last beat has no answer yet.
        numbers: Of the last command of each actuator.
    """

    def __init__(self, read: tuple[int, ...] = (VERSION,)) -> None:
        self._read = read
        self.version: Any = 0
        self.named: bool = False
        self.period: float = 1.0
        self._free = 0
        self._counts: tuple[int, ...] = ()
        self.owes: bool = False
        self.numbers: dict[str, int] = {}
        self._newest = 0
        self.sensors: list[str] = []
        self._actuators: list[str] = []
        self._seen: dict[str, None] = {}
        self._fault = ""
        self._form = "f"

    def read(self, message: bytes) -> list[Beat | Heard | Answer]:
        """Return what a message with its checksum says; nothing if it is damaged."""
        payload = message[:-4]
        return self.said(payload) if message == signed(payload) else []

    def said(self, payload: bytes) -> list[Beat | Heard | Answer]:
        """Return what a message says, whose checksum is right and gone."""
        try:
            return self._said(payload)
        except Exception:  # it is of another version, or none of ours
            return []

    def _said(self, payload: bytes) -> list[Beat | Heard | Answer]:
        kind = payload[:1]
        if kind == b"B":  # of version 1, or for a computer that speaks only that
            self.version = int(json.loads(payload[2:].decode())[0])
            return [Beat(self.version, None)] * (self.version not in self._read)
        if kind == b"b":
            beat = self._beat(payload)
            return [beat] * (beat.state is None or bool(self._counts))
        if kind == b"n" and self.version in self._read:
            rate, self._free = struct.unpack_from("<II", payload, 1)
            self.period = 1000 / rate
            sensors, _, actuators = payload[9:].decode().partition(";")
            self.sensors = sensors.split(",")
            self._actuators = actuators.split(",")[:PLACES]
            self.named = True
        elif kind == b"s" and self.named:
            return self._readings(payload)
        elif kind == b"a" and self.named:
            return self._answers(payload)
        return []

    def _beat(self, payload: bytes) -> Beat:
        if payload[1] not in self._read:
            self.version = payload[1]
            return Beat(self.version, None)
        _, self.version, flags, cause, days, now = _BEAT.unpack_from(payload)
        self.owes, self._newest = self.version == VERSION, now
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

    def _answers(self, payload: bytes) -> list[Beat | Heard | Answer]:
        found: list[Beat | Heard | Answer] = []
        at = 1
        while at < len(payload):
            name, number = self._actuators[payload[at] & 31], payload[at] >> 5
            how, at = chr(payload[at + 1]), at + 2
            who = done = None
            if how == "w":
                done, at = unpacked(payload, at)
            elif how in "hbg":
                who, at = unpacked(payload, at)
            reason = "" if how in "Tw" else _REASONS[how]
            found.append(Answer(name, number, reason, str(who or ""), tuples(done)))
        return found if at == len(payload) else []

    def _readings(self, payload: bytes) -> list[Beat | Heard | Answer]:
        found: list[Beat | Heard | Answer] = []
        at = 1
        while at < len(payload):
            name = self.sensors[payload[at]]
            gone = payload[at + 1] == ord("x")
            value, at = (None, at + 2) if gone else unpacked(payload, at + 1)
            if gone:
                self._seen.pop(name, None)
            else:
                self._seen[name] = None
            found.append(Heard(name, tuples(value), gone))
        return found if at == len(payload) else []

    def beat(self, armed: bool | None) -> list[bytes]:
        """Return the messages that answer the last beat of the board, to arm it or not."""
        if self.version != VERSION:
            return []
        self.owes = False
        flags = (not self.named) + (0 if armed is None else 2 if armed else 4)
        time = self._newest >> 4 & 0xFFFF
        return [signed(struct.pack("<BBBH", ord("h"), VERSION, flags, time))]

    def rates(self, asked: Mapping[str, float]) -> list[bytes]:
        """Return the messages that ask for sensors, each at a rate in Hz."""
        wanted = b""
        for name, rate in asked.items():
            if self.named and name in self.sensors:
                interval = min(65535, max(1, int(1000 / rate)))
                wanted += struct.pack("<BH", self.sensors.index(name), interval)
        size = _ROOM // 3 * 3
        return [
            signed(b"r" + wanted[at : at + size]) for at in range(0, len(wanted), size)
        ]

    def command(self, name: str, value: Any) -> bytes | None:
        """Return what `commands` take for a command; None for an unknown actuator."""
        if name not in self._actuators:
            return None
        buffer = bytearray(len(repr(value)) * 9 + 16)
        self.numbers[name] = number = self.numbers.get(name, 0) + 1 & 7
        buffer[0] = self._actuators.index(name) | number << 5
        end = packed(buffer, 1, value, self._form)
        return bytes(buffer[:end])

    def commands(self, waiting: Mapping[str, bytes]) -> tuple[bytes, list[str]]:
        """Return the message of the first commands that wait, and whose they are."""
        data, names = b"w", list[str]()
        for name, command in waiting.items():
            if names and len(data) + len(command) > _ROOM:
                break
            data += command
            names.append(name)
        return signed(data), names


def tuples(value: Any) -> Any:
    """Return a value with its rows as tuples."""
    if isinstance(value, list | tuple):
        return tuple(map(tuples, value))
    return value
