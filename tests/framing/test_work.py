"""How much work garbage costs, counted and not timed."""

from __future__ import annotations

import random
from typing import Any

import pytest

from esair.drivers.line import LineError, decode_value
from esair.framing import Cobs, Framing, LengthCrc, Sentences

SIZE = 1 << 18
GARBAGE = {
    "random": random.Random(7).randbytes(SIZE),
    "zeros": bytes(SIZE),
    "sync": b"\xaa" * SIZE,
    "ones": b"\x01" * SIZE,
}


WRONG: list[tuple[Framing, bytes]] = [
    (framing, garbage)
    for framing in (LengthCrc(), LengthCrc(sync=b"\xaa"))
    for garbage in GARBAGE.values()
]
WRONG += [
    (Sentences(), b"$GP*00\n"),
    (Sentences(), b"$*00\r\n"),
    (Sentences(), b"$" + b"A" * 255 + b"*00\n"),
    (Sentences(), b"*00\n"),
    (Cobs(), b"\xff\0"),
    (Cobs(), b"\x01\x02\0\0"),
]


def fed(framing: Framing, data: bytes, size: int = 1000) -> list[bytes]:
    got: list[bytes] = []
    for begin in range(0, len(data), size):
        got += framing.feed(data[begin : begin + size])
    return got


@pytest.mark.fault("D11", "D12")
@pytest.mark.parametrize(
    ("framing", "garbage"),
    WRONG,
    ids=[f"{type(each).__name__}-{data[:8]!r}" for each, data in WRONG],
)
def test_garbage_is_looked_at_in_few_places(framing: Any, garbage: bytes) -> None:
    """A burst byte by byte, then one place in 128; the frames after it are found."""
    framing = framing.fresh()
    garbage = (garbage * (SIZE // len(garbage) + 1))[:SIZE]
    assert fed(framing, garbage) == []
    assert framing.looks.count <= 2048 + SIZE / 128 + 16
    frame = framing.encode(b"here I am")
    found = framing.feed(frame * 8000)
    assert b"here I am" in found
    assert found[-1:] == [b"here I am"]
    assert len(found) > 1000


@pytest.mark.long
@pytest.mark.fault("D08")
@pytest.mark.parametrize(
    ("framing", "garbage"),
    [(LengthCrc(), GARBAGE["random"][:40_000]), (Sentences(), b"$GP*00\n" * 6000)],
)
def test_what_is_left_out_does_not_depend_on_the_pieces(
    framing: Any, garbage: bytes
) -> None:
    """Nor is anything lost from the count."""
    stream = garbage + framing.encode(b"good") * 3000
    results = []
    for size in (1, 7, 1000, len(stream)):
        each = framing.fresh()
        got = fed(each, stream, size)
        results.append((got, each.looks.count, each.bad_frames))
    assert all(each == results[0] for each in results)


def test_a_long_number_is_refused_by_its_length() -> None:
    """Not by an expression that looks at it again and again."""
    with pytest.raises(LineError):
        decode_value(b"range=" + b"7" * 4000)
    with pytest.raises(LineError):
        decode_value(b"range=" + b"7" * 60 + b"x")
    assert decode_value(b"range=-1.5e-3") == ("range", -0.0015)
