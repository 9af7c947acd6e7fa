"""What servos are told and answer, as bytes on their line."""

from __future__ import annotations

from typing import Any, Final

from dynamixel_sdk import Protocol2PacketHandler  # type: ignore[import-untyped]

from esair.framing import LengthCrc

PING, READ, WRITE, STATUS = 0x01, 0x02, 0x03, 0x55
SYNC_READ, SYNC_WRITE = 0x82, 0x83

_HEADER: Final = b"\xff\xff\xfd"
_crc: Any = Protocol2PacketHandler().updateCRC


class Packets(LengthCrc):
    """Packets of Dynamixel's protocol 2.0: a payload is id, instruction, parameters.

    A header within them is stuffed; the checksum is that of the maker's package.
    """

    def __init__(self) -> None:
        super().__init__(
            sync=_HEADER + b"\0",
            header=1,
            length_size=2,
            byteorder="little",
            counted=2,
            max_length=1024,
        )

    def feed(self, data: bytes) -> list[bytes]:
        """Take the bytes that arrived; return the payloads that are complete now."""
        return [each.replace(_HEADER + b"\xfd", _HEADER) for each in super().feed(data)]

    def encode(self, payload: bytes) -> bytes:
        """Return the whole packet."""
        return super().encode(payload.replace(_HEADER, _HEADER + b"\xfd"))

    def _told(self, covered: bytes | bytearray) -> bytes:
        whole = self.sync + covered
        return int(_crc(0, whole, len(whole))).to_bytes(2, "little")


FEETECH: Final = LengthCrc(sync="FF FF", header=1, counted=1, crc="sum-8/inverted")
"""Packets of Feetech, which are those of Dynamixel's protocol 1."""
