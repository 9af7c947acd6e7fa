"""How much work garbage costs, counted and not timed."""

from __future__ import annotations

import random

import pytest

from esair.drivers.line import LineError, decode_value
from esair.framing import LengthCrc

SIZE = 1 << 18
GARBAGE = {
    "random": random.Random(7).randbytes(SIZE),
    "zeros": bytes(SIZE),
    "sync": b"\xaa" * SIZE,
    "ones": b"\x01" * SIZE,
}


@pytest.mark.fault("D11", "D12")
@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE)
@pytest.mark.parametrize("sync", [b"", b"\xaa"])
def test_garbage_is_looked_at_in_few_places(garbage: bytes, sync: bytes) -> None:
    """A burst byte by byte, then one place in 128; the frames after it are found."""
    framing = LengthCrc(sync=sync)
    for begin in range(0, SIZE, 1000):
        framing.feed(garbage[begin : begin + 1000])
    assert framing.looks <= 2048 + SIZE / 128 + 8
    frame = framing.encode(b"here I am")
    found = framing.feed(frame * 8000)
    assert b"here I am" in found
    assert found[-1:] == [b"here I am"]
    assert len(found) > 1000


@pytest.mark.fault("D08")
def test_what_is_left_out_does_not_depend_on_the_pieces() -> None:
    """Nor is anything lost from the count."""
    good = LengthCrc().encode(b"good")
    stream = GARBAGE["random"][:40_000] + good * 3000
    results = []
    for size in (1, 7, 1000, len(stream)):
        framing = LengthCrc()
        got: list[bytes] = []
        for begin in range(0, len(stream), size):
            got += framing.feed(stream[begin : begin + size])
        results.append((got, framing.looks, framing.bad_frames))
    assert all(each == results[0] for each in results)


def test_a_long_number_is_refused_by_its_length() -> None:
    """Not by an expression that looks at it again and again."""
    with pytest.raises(LineError):
        decode_value(b"range=" + b"7" * 4000)
    with pytest.raises(LineError):
        decode_value(b"range=" + b"7" * 60 + b"x")
    assert decode_value(b"range=-1.5e-3") == ("range", -0.0015)
