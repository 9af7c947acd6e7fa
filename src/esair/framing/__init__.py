"""Frames on serial lines, as pure code: bytes in, payloads out, no I/O.

`FRAMINGS` has the names for a configuration.
"""

from esair.framing._cobs import Cobs
from esair.framing._framing import Framing, Looks
from esair.framing._length_crc import LengthCrc
from esair.framing._lines import Lines, Raw
from esair.framing._mavlink import Mavlink
from esair.framing._modbus import ModbusRtu, ModbusTcp
from esair.framing._nmea import (
    SentenceError,
    Sentences,
    checksum,
    decode_sentence,
    encode_sentence,
)

__all__ = [
    "FRAMINGS",
    "Cobs",
    "Framing",
    "LengthCrc",
    "Lines",
    "Looks",
    "Mavlink",
    "ModbusRtu",
    "ModbusTcp",
    "Raw",
    "SentenceError",
    "Sentences",
    "checksum",
    "decode_sentence",
    "encode_sentence",
]

FRAMINGS: dict[str, type[Framing]] = {
    "lines": Lines,
    "nmea": Sentences,
    "cobs": Cobs,
    "length-crc": LengthCrc,
    "raw": Raw,
    "modbus-rtu": ModbusRtu,
    "modbus-tcp": ModbusTcp,
    "mavlink": Mavlink,
}
"""The framings by the names that a configuration uses."""
