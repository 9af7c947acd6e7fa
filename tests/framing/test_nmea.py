"""Sentences with a checksum."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from esair.framing import SentenceError, decode_sentence, encode_sentence

FIELDS = st.lists(
    st.text(
        st.characters(codec="ascii", min_codepoint=32, max_codepoint=126).filter(
            lambda character: character not in "$*,!\\^~"
        )
    ),
    min_size=1,
    max_size=8,
)


@pytest.mark.parametrize(
    "line",
    [
        b"$GPGLL,4916.45,N,12311.12,W,225444,A,*1D\r\n",
        b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n",
    ],
)
def test_the_checksum_is_that_of_nmea_0183(line: bytes) -> None:
    """Sentences that are printed in many manuals are read, and made the same way."""
    fields = decode_sentence(line)

    assert fields[0] in {"GPGLL", "GPGGA"}
    assert encode_sentence(*fields) == line


@given(FIELDS)
def test_what_was_encoded_is_decoded(fields: list[str]) -> None:
    """Whatever fields a sentence can carry, they come out as they went in."""
    assert decode_sentence(encode_sentence(*fields)) == fields


@pytest.mark.fault("D09")
@given(st.binary(max_size=20), FIELDS)
def test_garbage_before_a_sentence_does_not_matter(
    noise: bytes, fields: list[str]
) -> None:
    """The rest of something else at the start of a line is left out."""
    assert (
        decode_sentence(noise.replace(b"\n", b"") + encode_sentence(*fields)) == fields
    )


@pytest.mark.fault("D10")
def test_every_flipped_bit_is_found() -> None:
    """No single damaged bit between the dollar and the checksum gets through."""
    line = encode_sentence("RFSWP", 17, -12000, 600, 768, 0).rstrip()
    for place in range(1, len(line)):
        for bit in range(8):
            damaged = bytearray(line)
            damaged[place] ^= 1 << bit
            try:
                fields = decode_sentence(bytes(damaged))
            except SentenceError:
                continue
            # Upper and lower case of a hexadecimal digit are the same digit.
            assert fields == decode_sentence(line)
            assert bytes(damaged).lower() == line.lower()


@pytest.mark.fault("D12")
@given(st.binary(max_size=60))
def test_no_bytes_raise_anything_but_a_sentence_error(line: bytes) -> None:
    """Whatever arrives is fields or a clear refusal."""
    try:
        fields = decode_sentence(line)
    except SentenceError:
        return
    assert all(isinstance(field, str) for field in fields)


@pytest.mark.parametrize("field", ["a,b", "a*b", "$", "a\nb", "ä"])
def test_what_a_sentence_cannot_carry_is_refused(field: str) -> None:
    """It would be read as something else."""
    with pytest.raises(SentenceError, match="cannot carry"):
        encode_sentence("RFSWP", field)
