"""Error frames, and what the kernel says about an interface; as pure code."""

from __future__ import annotations

import errno
import struct

import hypothesis
import pytest
from hypothesis import strategies as st

from esair.buses import CanState
from esair.buses.can._frame import decode_error
from esair.buses.can._interfaces import decode_link, is_there, look_up

pytestmark = pytest.mark.fault("C02", "C03")


def controller(bits: int) -> bytes:
    return bytes((0, bits, 0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("classes", "data", "state", "words"),
    [
        (0x040, bytes(8), CanState.BUS_OFF, "bus-off"),
        (0x044, controller(0x20), CanState.BUS_OFF, "bus-off"),
        (0x100, bytes(8), CanState.ACTIVE, "started again"),
        (0x004, controller(0x04), CanState.WARNING, "many errors in receiving"),
        (0x004, controller(0x08), CanState.WARNING, "many errors in sending"),
        (0x004, controller(0x10), CanState.PASSIVE, "error-passive in receiving"),
        (0x004, controller(0x20), CanState.PASSIVE, "error-passive in sending"),
        (0x004, controller(0x28), CanState.PASSIVE, "error-passive in sending"),
        (0x004, controller(0x40), CanState.ACTIVE, "error-active again"),
        (0x004, controller(0x00), None, "controller: unspecified"),
        (0x004, controller(0x02), None, "send buffer overflow"),
        (0x020, bytes(8), None, "no other node acknowledges"),
        (0x008, bytes((0, 0, 0x84, 0x08)), None, "stuffing error and in sending in the CRC"),
        (0x008, bytes((0, 0, 0x01, 0xEE)), None, "single bit error"),
        (0x010, bytes((0, 0, 0, 0, 0x80)), None, "CANL shorted to CANH"),
        (0x010, bytes((0, 0, 0, 0, 0x99)), None, "status 0x99"),
        (0x002, bytes((17,)), None, "arbitration lost in bit 17"),
        (0x001, b"", None, "not sent in time"),
        (0x080, b"", None, "bus error"),
        (0x204, controller(0x08)[:6] + bytes((97, 3)), CanState.WARNING,
         "97 send and 3 receive errors"),
        (0x400, b"", None, "class 0x400"),
    ],
)  # fmt: skip
def test_an_error_frame_is_decoded(
    classes: int, data: bytes, state: CanState | None, words: str
) -> None:
    """As linux/can/error.h says."""
    decoded = decode_error(classes, data)
    assert decoded.state is state
    assert words in decoded.text


def test_what_is_acted_upon_is_told_apart() -> None:
    """No acknowledgement, a lost frame, a restart."""
    assert decode_error(0x20, b"").unacknowledged
    assert decode_error(0x04, controller(0x01)).overflow
    assert decode_error(0x100, b"").restarted
    harmless = decode_error(0x08, bytes((0, 1, 1)))
    assert not any((harmless.unacknowledged, harmless.overflow, harmless.restarted))


@hypothesis.given(classes=st.integers(0, 0x1FFF_FFFF), data=st.binary(max_size=64))
def test_any_error_frame_has_words(classes: int, data: bytes) -> None:
    """A controller may say anything; nothing of it ends the reading."""
    assert decode_error(classes, data).text


def attribute(kind: int, data: bytes) -> bytes:
    packed = struct.pack("=HH", 4 + len(data), kind) + data
    return packed + bytes(-len(packed) % 4)


def link(attributes: bytes, *, flags: int = 1, index: int = 7) -> bytes:
    body = struct.pack("=BxHiII", 0, 280, index, flags, 0) + attributes
    return struct.pack("=IHHII", 16 + len(body), 16, 0, 1, 0) + body


def can_info(state: int, kind: bytes = b"can", bitrate: int = 0) -> bytes:
    data = attribute(4, struct.pack("=I", state))
    if bitrate:  # the first of eight numbers
        data += attribute(1, struct.pack("=8I", bitrate, *range(7)))
    return attribute(18, attribute(1, kind + b"\0") + attribute(0x8002, data))


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        (attribute(4, struct.pack("=I", 16)) + can_info(0), (16, CanState.ACTIVE)),
        (attribute(4, struct.pack("=I", 72)) + can_info(2), (72, CanState.PASSIVE)),
        (can_info(3), (0, CanState.BUS_OFF)),
        (can_info(4), (0, CanState.ACTIVE)),  # stopped: it is down
        (can_info(3, b"veth"), (0, CanState.ACTIVE)),  # no CAN: another meaning
        (b"", (0, CanState.ACTIVE)),
    ],
)
def test_what_the_kernel_says_is_decoded(
    attributes: bytes, expected: tuple[int, CanState]
) -> None:
    """As rtnetlink(7) and linux/can/netlink.h say."""
    assert decode_link(link(attributes))[:4] == (7, True, *expected)
    assert not decode_link(link(attributes, flags=0)).is_up


def test_the_bit_rate_is_that_of_the_controller() -> None:
    """None where it was not set, or there is no controller."""
    told = decode_link(link(can_info(0, bitrate=250_000)))
    assert (told.bitrate, told.has_controller) == (250_000, True)
    assert decode_link(link(can_info(0))).bitrate is None
    virtual = decode_link(link(can_info(0, b"vcan", 250_000)))
    assert (virtual.bitrate, virtual.has_controller) == (None, False)


@pytest.mark.parametrize(
    ("answer", "number"),
    [
        (struct.pack("=IHHIIi", 20, 2, 0, 1, 0, -errno.ENODEV), errno.ENODEV),
        (struct.pack("=IHHII", 16, 3, 0, 1, 0), errno.EPROTO),
        (b"short", errno.EPROTO),
    ],
)
def test_no_interface_is_an_error_of_the_system(answer: bytes, number: int) -> None:
    """Also an answer that is none."""
    with pytest.raises(OSError) as caught:  # noqa: PT011 - its number is checked
        decode_link(answer)
    assert caught.value.errno == number


@hypothesis.given(answer=st.binary(max_size=200))
def test_no_answer_ends_in_anything_but_an_error_of_the_system(answer: bytes) -> None:
    """Whatever bytes come."""
    try:
        decode_link(answer)
    except OSError:
        return


def test_the_kernel_is_asked() -> None:
    """The loopback is there in every namespace; what has no name is not."""
    assert look_up("lo").number == 1
    assert is_there("nocan9") is None
