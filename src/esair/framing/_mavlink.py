"""MAVLink, whose checksum takes in what a message of its number looks like."""

from __future__ import annotations

import importlib
from typing import Any, Literal

from esair.exceptions import BadValueError
from esair.framing._length_crc import LengthCrc
from esair.loading import of_extra
from esair.values import check_choice

_UNKNOWN = b"unknown"
"""The checksum of what has none: no frame has one of this length."""


class Mavlink(LengthCrc):
    """Packets of MAVLink, checked by the tables of pymavlink.

    A payload is a packet between its length and its checksum. Messages that the dialect
    does not have cannot be checked: they count as bad frames. Signatures are left out.

    Args:
        version: 2, or 1 for old vehicles.
        dialect: The dialect of pymavlink.
        max_length: The longest payload, in bytes.

    Attributes:
        dialect: The module of the dialect.

    Raises:
        ConfigError: A parameter is wrong.
    """

    def __init__(
        self,
        *,
        version: Literal[1, 2] = 2,
        dialect: str = "ardupilotmega",
        max_length: int = 263,
    ) -> None:
        check_choice("framing", "version", version, (1, 2))
        super().__init__(
            sync=b"\xfd" if version == 2 else b"\xfe",
            counted=-8 if version == 2 else -4,
            byteorder="little",
            max_length=min(max_length, 263 if version == 2 else 259)
            if type(max_length) is int
            else max_length,
        )
        self.version = version
        with of_extra("mavlink"):
            from pymavlink.generator.mavcrc import x25crc

            self.dialect: Any = importlib.import_module(
                f"pymavlink.dialects.v20.{dialect}"
            )
        self._x25: Any = x25crc
        self._id = slice(6, 9) if version == 2 else slice(4, 5)

    def encode(self, payload: bytes) -> bytes:
        """Return the whole packet.

        Raises:
            BadValueError: It is none of the dialect.
        """
        packet = super().encode(payload)
        if packet.endswith(_UNKNOWN):
            raise BadValueError("framing", "payload", "the dialect has no such message")
        return packet

    def _told(self, covered: bytes | bytearray) -> bytes:
        number = int.from_bytes(covered[self._id], "little")
        message = self.dialect.mavlink_map.get(number)
        if message is None:
            return _UNKNOWN
        told: int = self._x25(bytes((*covered, message.crc_extra))).crc
        return told.to_bytes(2, "little")
