"""CAN interfaces of the kernel, and what they are set to."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from esair.buses import finding
from esair.buses.can._frame import CanState
from esair.buses.finding import ROOT, Device

_HEADER: Final = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_LINK: Final = struct.Struct("=BxHiII")  # family, type, index, flags, change
_ATTRIBUTE: Final = struct.Struct("=HH")  # length, type

_ERROR, _NEW_LINK, _GET_LINK, _REQUEST = 2, 16, 18, 1
_NAME, _MTU, _LINK_INFO, _INFO_KIND, _INFO_DATA = 3, 4, 18, 1, 2
_CAN_TIMING, _CAN_STATE = 1, 4
_UP = 0x1
_TYPE_MASK = 0x3FFF  # the upper bits of an attribute's type say how it is made


class Interface(NamedTuple):
    """A network interface.

    Attributes:
        number: What the kernel counts it by; one that is made again gets another.
        is_up: Whether it was set up.
        mtu: How many bytes a frame of its socket has at most: 16, or 72 with CAN FD.
        state: The state of its controller; active where there is none, as with vcan.
        bitrate: Bits per second that the controller is set to; None if it is not set,
            or there is none.
        has_controller: Whether there is a controller that has a state.
    """

    number: int
    is_up: bool
    mtu: int
    state: CanState
    bitrate: int | None = None
    has_controller: bool = False


def look_up(name: str) -> Interface:
    """Ask the kernel for an interface. Blocks for some microseconds."""
    wanted = os.fsencode(name) + b"\0"
    attribute = _ATTRIBUTE.pack(_ATTRIBUTE.size + len(wanted), _NAME) + wanted
    body = _LINK.pack(0, 0, 0, 0, 0) + attribute.ljust(
        -(-len(attribute) // 4) * 4, b"\0"
    )
    request = _HEADER.pack(_HEADER.size + len(body), _GET_LINK, _REQUEST, 1, 0) + body
    with socket.socket(
        socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.NETLINK_ROUTE
    ) as kernel:
        kernel.settimeout(1.0)
        kernel.send(request)
        return decode_link(kernel.recv(65_536))


def is_there(name: str) -> tuple[int, bool] | None:
    """Return what tells one arrival of an interface from the next; None if it is not.

    An interface that is down, or whose controller is bus-off, is not there.
    """
    try:
        found = look_up(name)
    except OSError:
        return None
    if not found.is_up or found.state is CanState.BUS_OFF:
        return None
    return found.number, True


def decode_link(answer: bytes) -> Interface:
    """Decode the kernel's answer."""
    try:
        _, kind, _, _, _ = _HEADER.unpack_from(answer)
        if kind == _ERROR:
            (number,) = struct.unpack_from("=i", answer, _HEADER.size)
            raise OSError(-number, os.strerror(-number))
        if kind != _NEW_LINK:
            raise OSError(errno.EPROTO, f"the kernel answered with message {kind}")
        _, _, index, flags, _ = _LINK.unpack_from(answer, _HEADER.size)
    except struct.error as error:
        raise OSError(errno.EPROTO, "the kernel's answer is too short") from error
    attributes = dict(_attributes(answer[_HEADER.size + _LINK.size :]))
    info = dict(_attributes(attributes.get(_LINK_INFO, b"")))
    state, bitrate, has_controller = CanState.ACTIVE, 0, False
    if info.get(_INFO_KIND, b"").rstrip(b"\0") == b"can":
        data = dict(_attributes(info.get(_INFO_DATA, b"")))
        has_controller = _CAN_STATE in data
        # Above bus-off there are "stopped" and "sleeping": the interface is down.
        with contextlib.suppress(ValueError):
            state = CanState(int.from_bytes(data.get(_CAN_STATE, b""), sys.byteorder))
        bitrate = int.from_bytes(data.get(_CAN_TIMING, b"")[:4], sys.byteorder)
    mtu = int.from_bytes(attributes.get(_MTU, b""), sys.byteorder)
    is_up = bool(flags & _UP)
    return Interface(index, is_up, mtu, state, bitrate or None, has_controller)


def _attributes(data: bytes) -> Iterator[tuple[int, bytes]]:
    place = 0
    while place + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, place)
        if length < _ATTRIBUTE.size:
            return
        yield kind & _TYPE_MASK, data[place + _ATTRIBUTE.size : place + length]
        place += -(-length // 4) * 4


ARPHRD_CAN = "280"  # linux/if_arp.h
IFF_UP = 1

VIRTUAL = "virtual CAN"
"""What an interface is called that has no wire, and so no bit rate."""


def devices(root: Path = ROOT) -> list[Device]:
    """Return the CAN interfaces that are there, by their names."""
    places = [
        place
        for place in finding.entries(root / "sys/class/net")
        if finding.read(place / "type") == ARPHRD_CAN
    ]
    return [_interface(place, root) for place in places]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for an interface, and how to start it."""
    start = []
    if device.state.startswith("down"):
        is_set = device.bitrate is not None or device.description == VIRTUAL
        kind = "" if is_set else " type can bitrate 500000"
        start = [f"# it is down: sudo ip link set {device.path} up{kind}"]
    return [
        *start,
        f"[bus.{name}]",
        'type = "can"',
        'interface = "socketcan"',
        f"channel = {finding.quoted(device.address)}",
    ]


def _interface(place: Path, root: Path) -> Device:
    usb = finding.usb_device(place / "device", root)
    if usb is not None:
        words = finding.words_of(usb) or "USB CAN adapter"
    elif (place / "device").exists():
        driver = os.path.basename(os.path.realpath(place / "device/driver"))
        words = f"controller of the computer ({driver})"
    else:
        words = VIRTUAL
    found = None
    if root == ROOT:  # what only the kernel knows: its files do not tell
        with contextlib.suppress(OSError):
            found = look_up(place.name)
    return Device(
        kind="can",
        path=place.name,
        address=place.name,
        description=words,
        identity=finding.identity_of(usb),
        state=_state(place, found),
        bitrate=None if found is None else found.bitrate,
    )


def _state(place: Path, found: Interface | None) -> str:
    try:
        up = bool(int(finding.read(place / "flags"), 16) & IFF_UP)
    except ValueError:
        return ""
    words = ["up" if up else "down"]
    if found is not None and found.bitrate is not None:
        words.append(f"{found.bitrate / 1000:g} kbit/s")
    if up and found is not None and found.has_controller:
        name = found.state.name.lower().replace("_", "-")
        words.append(name if found.state is CanState.BUS_OFF else f"error-{name}")
    return ", ".join(words)
