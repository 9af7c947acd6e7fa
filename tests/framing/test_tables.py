"""Framings of real devices as tables: the bytes of their makers, and resync that is ours."""

import random
from typing import Any

import pytest

from esair.framing import LengthCrc
from esair.testing import FakeSerial

LX16A: dict[str, Any] = {
    "sync": "55 55",
    "header": 1,
    "counted": 2,
    "crc": "sum-8/inverted",
}
MSP: dict[str, Any] = {
    "sync": "24 4D 3E",
    "sent": "24 4D 3C",
    "counted": -1,
    "crc": "xor-8",
}
UBX: dict[str, Any] = {
    "sync": "B5 62",
    "header": 2,
    "length_size": 2,
    "byteorder": "little",
    "crc": "fletcher-8",
    "max_length": 1024,
}

SENT = [
    # Hiwonder, Bus Servo Communication Protocol: move servo 1 to 500 in 1000 ms.
    (LX16A, "01 01 F4 01 E8 03", "55 55 01 07 01 F4 01 E8 03 16"),
    # Betaflight, MSP 1: a request for MSP_API_VERSION (1), and for MSP_IDENT (100).
    (MSP, "01", "24 4D 3C 00 01 01"),
    (MSP, "64", "24 4D 3C 00 64 64"),
    # u-blox M8 Receiver description: a poll of MON-VER, and CFG-RATE of 1 Hz.
    (UBX, "0A 04", "B5 62 0A 04 00 00 0E 34"),
    (UBX, "06 08 E8 03 01 00 01 00", "B5 62 06 08 06 00 E8 03 01 00 01 00 01 39"),
]


@pytest.mark.parametrize(("table", "payload", "wire"), SENT)
def test_the_makers_bytes_are_sent(table, payload: str, wire: str) -> None:
    """As their documents print them."""
    assert LengthCrc(**table).encode(bytes.fromhex(payload)) == bytes.fromhex(wire)


@pytest.mark.parametrize("table", [LX16A, MSP, UBX, {**UBX, "trailer": "0D 0A"}])
def test_what_is_sent_is_found_again_in_garbage(table) -> None:
    """Whatever is between and however it is cut; no byte is lost without a count."""
    chance = random.Random(7)
    table = {key: value for key, value in table.items() if key != "sent"}
    framing = LengthCrc(**table)
    payloads = [chance.randbytes(chance.randint(3, 40)) for _ in range(200)]
    stream = b"".join(
        chance.randbytes(chance.randint(0, 4)) + framing.encode(each)
        for each in payloads
    )
    stream += bytes(2100)
    found: list[bytes] = []
    at = 0
    while at < len(stream):
        size = chance.randint(1, 9)
        found += framing.feed(stream[at : at + size])
        at += size

    rest = iter(found)
    assert sum(each in rest for each in payloads) >= 190  # garbage may look like a head
    good = sum(len(framing.encode(each)) for each in found)
    framing.reset()
    assert good + framing.discarded == len(stream)


@pytest.mark.parametrize("bit", range(8 * 10))
def test_a_flipped_bit_is_no_frame(bit: int) -> None:
    """Of a servo's frame, and the next one is found."""
    wire = bytearray.fromhex("55 55 01 07 01 F4 01 E8 03 16")
    wire[bit // 8] ^= 1 << bit % 8
    framing = LengthCrc(**LX16A)
    good = bytes.fromhex("55 55 02 04 1C 01 DC 55 55 02 04 1C 01 DC")

    found = framing.feed(bytes(wire) + good + bytes(300))

    assert bytes.fromhex("02 1C 01") in found
    assert bytes.fromhex("01 01 F4 01 E8 03") not in found


@pytest.mark.virtual_clock
async def test_an_echo_is_no_answer() -> None:
    """On one wire for both directions a request comes back before its answer."""
    table = {"type": "length-crc", **LX16A}
    line = FakeSerial(name="servos", framing=table, echo=True)
    answer = LengthCrc(**LX16A).encode(bytes.fromhex("01 1C F4 01"))
    line.on_frame = lambda _message: bytes.fromhex("01 1C F4 01")
    await line.open()

    for _ in range(3):
        assert await line.ask(bytes.fromhex("01 1C"), prefix=b"\x01") == (
            bytes.fromhex("01 1C F4 01")
        )
    assert line.stats.bad_frames == 0

    line.on_frame = None
    line.on_write = lambda data: b"\0" + data[1:] + answer  # two spoke at once
    assert await line.ask(bytes.fromhex("01 1C"), prefix=b"\x01") == (
        bytes.fromhex("01 1C F4 01")
    )
    assert line.stats.bad_frames >= 1
    await line.close()
