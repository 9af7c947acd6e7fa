"""Every framing, on every split of the bytes and on garbage."""

from __future__ import annotations

import binascii
import itertools
import tracemalloc
import zlib
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from esair.exceptions import BadValueError, ConfigError
from esair.framing import (
    FRAMINGS,
    Cobs,
    Framing,
    LengthCrc,
    Lines,
    Raw,
    Sentences,
)

SYNC = LengthCrc(sync="AA 55", crc="crc-32", max_length=20)
FRAMED = [
    Lines(max_length=20),
    Lines(delimiter=b"\r\n", max_length=20),
    Lines(delimiter=b"aab", max_length=3),
    Sentences(max_length=20),
    Cobs(max_length=20),
    SYNC,
    LengthCrc(sync=b"\xaa\xaa", length_size=2, byteorder="little", max_length=20),
    LengthCrc(crc="crc-32", max_length=20),
]
SELF_SYNCHRONIZING = [
    framing for framing in FRAMED if isinstance(framing, LengthCrc | Sentences)
]
KINDS: dict[str, Any] = dict(FRAMINGS)
WORDS = st.text("0123456789,", min_size=1, max_size=3).map(str.encode)


def name(framing: Framing) -> str:
    return type(framing).__name__


def outcome(framing: Framing, chunks) -> tuple[list[bytes], int, int, bytes]:
    framing = framing.fresh()
    payloads = [payload for chunk in chunks for payload in framing.feed(chunk)]
    return payloads, framing.bad_frames, framing.discarded, bytes(framing._buffer)


def split(data: bytes, cuts) -> list[bytes]:
    edges = [0, *sorted(cuts), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(edges)]


@pytest.mark.fault("D08")
@pytest.mark.parametrize("framing", FRAMED, ids=name)
def test_all_splits_of_a_short_stream_give_the_same(framing: Framing) -> None:
    """All 2^(n-1) ways to cut bytes give equal frames, counters and rest."""
    wire = (framing.encode(b"12") + b"$" + framing.encode(b"3"))[:13]
    whole = outcome(framing, [wire])
    assert whole[0][:1] == [b"12"]
    for mask in range(1 << len(wire) - 1):
        cuts = [at for at in range(1, len(wire)) if mask >> at - 1 & 1]
        assert outcome(framing, split(wire, cuts)) == whole


@pytest.mark.fault("D08")
@pytest.mark.parametrize("framing", FRAMED, ids=name)
@given(st.data())
def test_any_split_of_a_long_stream_gives_the_same(framing: Framing, data) -> None:
    """Frames, noise and overlong frames: cuts change neither frames nor counters."""
    noise = st.one_of(
        st.binary(max_size=60),
        st.text("$*\r\nab0\0\x01", max_size=60).map(str.encode),
    )
    parts = data.draw(st.lists(st.one_of(WORDS.map(framing.encode), noise)))
    wire = b"".join(parts)
    cuts = data.draw(st.lists(st.integers(0, len(wire))))

    whole = outcome(framing, [wire])

    assert outcome(framing, split(wire, cuts)) == whole
    assert outcome(framing, (bytes([byte]) for byte in wire)) == whole


@pytest.mark.fault("D09")
@pytest.mark.parametrize("framing", SELF_SYNCHRONIZING, ids=name)
@given(st.binary(max_size=80), WORDS)
@example(b"\xaa", b"1")
@example(b"\xaa\x55\x14", b"1")
@example(b"$", b"1")
def test_the_frame_after_garbage_is_found(
    framing: Framing, garbage: bytes, payload: bytes
) -> None:
    """It comes out at the latest when one longest frame has followed."""
    assert (
        payload
        in outcome(
            framing,
            [garbage, framing.encode(payload), bytes(len(framing.encode(b"1" * 20)))],
        )[0]
    )


@pytest.mark.fault("D09")
@pytest.mark.parametrize("framing", FRAMED, ids=name)
@given(st.binary(max_size=80), WORDS)
def test_the_second_frame_after_garbage_is_found(
    framing: Framing, garbage: bytes, payload: bytes
) -> None:
    """A delimiter at the latest ends what garbage has begun."""
    wire = framing.encode(payload)
    filler = bytes(len(framing.encode(b"1" * framing.max_length)))

    assert payload in outcome(framing, [garbage, wire, wire, filler])[0]


@pytest.mark.fault("D10")
@pytest.mark.parametrize("framing", SELF_SYNCHRONIZING, ids=name)
def test_a_flipped_bit_never_gives_a_wrong_payload(framing: Framing) -> None:
    """The damaged frame is dropped and counted, and the next one comes out."""
    wire, following = framing.encode(b"17,-12"), framing.encode(b"next")
    filler = bytes(len(framing.encode(b"1" * 20)))
    dropped = 0
    for bit in range(8 * len(wire)):
        damaged = bytearray(wire)
        damaged[bit // 8] ^= 1 << bit % 8
        payloads, bad, discarded, _ = outcome(framing, [damaged + following + filler])

        assert payloads in ([b"next"], [b"17,-12", b"next"])
        if len(payloads) == 1:
            dropped += 1
            assert bad + discarded > 0
    # Only the end of a sentence and the case of its checksum do not matter.
    assert dropped >= 8 * (len(wire) - 4)


@pytest.mark.fault("D11")
@pytest.mark.parametrize("framing", FRAMED, ids=name)
@pytest.mark.parametrize("byte", [b"x", b"$", b"\xaa", b"\x01"])
def test_a_frame_that_never_ends_needs_no_memory(framing: Framing, byte: bytes) -> None:
    """What is kept stays below one longest frame, and the rest is counted."""
    framing = framing.fresh()
    chunk = (b"$" + byte * 1023) if isinstance(framing, Sentences) else byte * 1024
    framing.feed(chunk)
    tracemalloc.start()
    try:
        for _ in range(20):
            framing.feed(chunk)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert len(framing._buffer) <= len(framing.encode(b"1" * framing.max_length))
    assert framing.discarded + len(framing._buffer) == 21 * 1024
    assert peak < 10_000


@pytest.mark.fault("D12")
@pytest.mark.parametrize("length", [0, 21, 255])
def test_a_lying_length_is_one_bad_frame(length: int) -> None:
    """The frame behind it is not swallowed."""
    framing = SYNC.fresh()

    assert framing.feed(b"\xaa\x55%c" % length + SYNC.encode(b"next")) == [b"next"]
    assert (framing.bad_frames, framing.discarded) == (1, 3)


@pytest.mark.fault("D12")
def test_a_length_that_reaches_into_the_next_frame_does_not_swallow_it() -> None:
    """The search goes on inside of the frame that lied."""
    framing = SYNC.fresh()
    wire = bytearray(SYNC.encode(b"one"))
    wire[2] = 20

    assert framing.feed(bytes(wire)) == []
    assert framing.feed(SYNC.encode(b"two") + SYNC.encode(b"three")) == [
        b"two",
        b"three",
    ]
    assert framing.bad_frames == 1
    assert framing.discarded == len(wire)


@pytest.mark.parametrize("framing", [*FRAMED, Raw(max_length=20)], ids=name)
@pytest.mark.parametrize("kind", [bytearray, memoryview])
def test_bytes_of_any_kind_are_taken(framing: Framing, kind: Any) -> None:
    """What comes out is bytes, which nobody can change any more."""
    frame = framing.encode(b"12")
    taken = framing.fresh()
    found = [*taken.feed(kind(frame + frame)), *taken.feed(kind(frame))]
    assert b"".join(found) == b"121212"
    assert {type(payload) for payload in found} == {bytes}


@pytest.mark.parametrize("framing", [*FRAMED, Raw(max_length=20)], ids=name)
@given(st.data())
def test_what_was_encoded_comes_out(framing: Framing, data) -> None:
    """Whatever payloads a framing takes, they come out as they went in."""
    payloads = []
    for payload in data.draw(st.lists(st.binary(max_size=22))):
        try:
            wire = framing.encode(payload)
        except BadValueError:
            continue
        payloads.append((payload, wire))
    fresh = framing.fresh()

    assert [out for _, wire in payloads for out in fresh.feed(wire)] == [
        payload for payload, _ in payloads
    ]
    assert (fresh.bad_frames, fresh.discarded) == (0, 0)


@pytest.mark.long
@pytest.mark.parametrize("framing", [*FRAMED, Raw(max_length=20)], ids=name)
@given(st.lists(st.binary(max_size=50)))
def test_no_bytes_raise(framing: Framing, chunks: list[bytes]) -> None:
    """Whatever arrives is payloads within the bound, or is counted."""
    fresh = framing.fresh()
    payloads = [payload for chunk in chunks for payload in fresh.feed(chunk)]
    fresh.reset()

    assert all(type(p) is bytes and len(p) <= fresh.max_length for p in payloads)
    assert fresh.discarded <= sum(map(len, chunks))
    if not payloads:
        assert fresh.discarded == sum(map(len, chunks))


@given(st.lists(st.binary(max_size=50)))
def test_raw_loses_nothing(chunks: list[bytes]) -> None:
    """Pieces are bounded and never empty; together they are what arrived."""
    raw = Raw(max_length=7)
    pieces = [piece for chunk in chunks for piece in raw.feed(chunk)]

    assert b"".join(pieces) == b"".join(chunks)
    assert all(1 <= len(piece) <= 7 for piece in pieces)


@pytest.mark.parametrize("framing", FRAMED, ids=name)
def test_after_a_reset_nothing_of_the_old_frame_is_left(framing: Framing) -> None:
    """A frame that began before does not spoil the first one after an opening."""
    framing = framing.fresh()
    wire = framing.encode(b"12")
    framing.feed(wire[:-1])
    framing.reset()

    assert framing.feed(wire) == [b"12"]
    assert framing.discarded == len(wire) - 1
    assert (framing.fresh().bad_frames, framing.fresh().discarded) == (0, 0)


def test_the_crcs_are_those_of_the_catalog() -> None:
    """The frames carry the CRC that the names promise."""
    body = b"\x09123456789"
    for crc, told in [
        ("crc-16/xmodem", binascii.crc_hqx(body, 0).to_bytes(2, "big")),
        ("crc-16/ibm-3740", binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "big")),
        ("crc-32", zlib.crc32(body).to_bytes(4, "big")),
    ]:
        assert LengthCrc(crc=crc).encode(b"123456789") == body + told
    assert binascii.crc_hqx(b"123456789", 0) == 0x31C3
    assert binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    assert zlib.crc32(b"123456789") == 0xCBF43926


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        ("lines", b"a\nb"),
        ("lines", b"x" * 5000),
        ("nmea", b"a*b"),
        ("nmea", b"\xff"),
        ("cobs", b"x" * 1025),
        ("length-crc", b""),
        ("length-crc", b"x" * 256),
        ("raw", b""),
        ("raw", "text"),
    ],
)
def test_what_cannot_be_framed_is_refused(kind: str, payload: bytes) -> None:
    """It would be read as something else, or not at all."""
    with pytest.raises(BadValueError, match="framing: payload"):
        KINDS[kind]().encode(payload)


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        *((kind, "max_length", 0) for kind in FRAMINGS),
        *((kind, "max_length", True) for kind in FRAMINGS),
        ("lines", "delimiter", b""),
        ("lines", "delimiter", 10),
        ("length-crc", "sync", "xyz"),
        ("length-crc", "sync", 5),
        ("length-crc", "length_size", 4),
        ("length-crc", "byteorder", "middle"),
        ("length-crc", "crc", "md5"),
        ("length-crc", "crc", []),
        ("length-crc", "max_length", 256),
    ],
)
def test_a_wrong_parameter_is_named(kind: str, field: str, value: object) -> None:
    """The error says which one it is."""
    with pytest.raises(ConfigError, match=f"framing: {field}: expected"):
        KINDS[kind](**{field: value})
