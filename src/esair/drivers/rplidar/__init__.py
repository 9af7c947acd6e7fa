"""SLAMTEC RPLIDAR A1: a turning laser range finder, on a serial line.

Source: SLAMTEC, RPLIDAR Interface Protocol and Application Notes, revision 2.x, for the
A series: request and response packets, SCAN, STOP, GET_INFO, GET_HEALTH. The names are
those of that document. Only the plain SCAN is used, which every model answers.

The line runs at 115200 bits per second and has no frames of one kind: ``framing="raw"``.
The adapter board of an A1 stops the motor while DTR is raised, which an opened port
does unless it is told not to::

    [bus.lidar]
    type = "serial"
    port = "usb:10c4:ea60"
    framing = "raw"
    dtr = false

    [sensor.scan]
    driver = "rplidar"
    bus = "lidar"
"""

from __future__ import annotations

import asyncio
import errno
import math
import re
import struct
from collections.abc import AsyncIterator
from typing import Unpack

import attrs

from esair.buses import Inbox, SerialBus
from esair.drivers._on_bus import check_bus, heard
from esair.exceptions import DeviceFaultError
from esair.framing import Looks, Raw
from esair.resources import Sensor, SensorSettings

__all__ = ["Health", "Info", "RpLidar", "Scan", "ScanDecoder"]

START = 0xA5
"""The first byte of each request and of each response."""

STOP = 0x25
SCAN = 0x20
GET_INFO = 0x50
GET_HEALTH = 0x52

SCAN_DESCRIPTOR = bytes.fromhex("a55a0500004081")
INFO_DESCRIPTOR = bytes.fromhex("a55a1400000004")
HEALTH_DESCRIPTOR = bytes.fromhex("a55a0300000006")

NODE_SIZE = 5
MAX_NODES = 8192
"""How many measurements one turn may have; with more no turn is ever found."""

NOISE_LIMIT = 65536
"""How many bytes are looked through for an answer."""

_INFO = struct.Struct("<BBBB16s")
_HEALTH = struct.Struct("<BH")
_NODE = struct.Struct("<BHH")


def _firsts(*bits: int) -> bytes:
    return b"".join(re.escape(bytes([n])) for n in range(256) if n & 3 in bits)


# S and its inverse, the check bit, no angle beyond a turn, and a distance.
_ODD = b"".join(re.escape(bytes([n])) for n in range(1, 256, 2))
_REST = rb"(?:[%b][\x00-\xb3]|\x01\xb4).." % _ODD
_PIECE = re.compile(
    rb"(?s)([%b]%b)?+(?:[%b]%b)*+" % (_firsts(1), _REST, _firsts(2), _REST)
)
"""Measurements one after the other; the first one may begin a turn."""
_BEGINNING = re.compile(rb"(?s)[%b]%b" % (_firsts(1, 2), _REST))
"""What looks like a measurement."""

_QUALITY = bytes(n >> 2 for n in range(256))
_UNIT = math.radians(1 / 128)

LOOKS = 4.0
"""What a turn or a gap costs beside its bytes, in looks at a place of a stream."""

_STATUS = ("good", "warning", "error")


@attrs.frozen
class Scan:
    """One turn of the laser, in its own axes: x forward, y left.

    Attributes:
        angles: Directions from the x axis in rad, counter-clockwise, shape (n,), in the
            order in which they were measured (the laser turns clockwise).
        ranges: Distances in m, shape (n,); infinite where nothing came back: so it is
            from what is far, and from what is nearer than it can measure (0.15 m).
        qualities: How much light came back, 0 to 63, shape (n,).
    """

    angles: tuple[float, ...]
    ranges: tuple[float, ...]
    qualities: tuple[int, ...]

    def nearest(self, begin: float, end: float) -> float:
        """Return the least distance between two directions in rad, in m."""
        return min(
            (
                distance
                for angle, distance in zip(self.angles, self.ranges, strict=True)
                if begin <= angle <= end
            ),
            default=math.inf,
        )


@attrs.frozen
class Info:
    """Who it is: 0x18 is an A1, the serial number has 32 hexadecimal digits."""

    model: int
    firmware: tuple[int, int]
    hardware: int
    serial: str


@attrs.frozen
class Health:
    """How it is: ``good``, ``warning`` or ``error``, and the maker's code."""

    status: str
    code: int


def request(command: int) -> bytes:
    """Return the bytes of a request without parameters."""
    return bytes([START, command])


def decode_info(data: bytes) -> Info:
    """Decode the 20 bytes that answer ``GET_INFO``."""
    model, minor, major, hardware, serial = _INFO.unpack(data)
    return Info(model, (major, minor), hardware, serial.hex().upper())


def encode_info(info: Info) -> bytes:
    """Encode the answer to ``GET_INFO``, as the device does."""
    major, minor = info.firmware
    serial = bytes.fromhex(info.serial)
    return _INFO.pack(info.model, minor, major, info.hardware, serial)


def decode_health(data: bytes) -> Health:
    """Decode the 3 bytes that answer ``GET_HEALTH``.

    Raises:
        ValueError: The status is none.
    """
    status, code = _HEALTH.unpack(data)
    if status >= len(_STATUS):
        raise ValueError(f"expected a status of 0 to 2, not {status}")
    return Health(_STATUS[status], code)


def encode_health(health: Health) -> bytes:
    """Encode the answer to ``GET_HEALTH``, as the device does."""
    return _HEALTH.pack(_STATUS.index(health.status), health.code)


def encode_scan(scan: Scan) -> bytes:
    """Encode one turn, as the device does: the first measurement begins it."""
    nodes = zip(scan.angles, scan.ranges, scan.qualities, strict=True)
    return b"".join(
        _NODE.pack(
            quality << 2 | (2 if place else 1),
            round(math.degrees(-angle % math.tau) * 64) % (360 * 64) << 1 | 1,
            0 if math.isinf(distance) else max(1, min(65535, round(distance * 4000))),
        )
        for place, (angle, distance, quality) in enumerate(nodes)
    )


class ScanDecoder:
    """Turns the bytes of a running scan into whole turns. No I/O.

    What does not look like a measurement is left out byte by byte until it does again;
    a turn with such a gap is not given. The work for garbage is bounded: after 512
    gaps and turns of next to no bytes, most of what comes is left out unseen until
    longer turns have come again.

    Attributes:
        discarded: How many bytes were left out.
        bad_turns: How many turns had a gap.
        looks: Pays for gaps and turns.
    """

    def __init__(self) -> None:
        self.discarded: int = 0
        self.bad_turns: int = 0
        self._rest = b""
        self._turn = bytearray()
        self._whole = self._is_lost = False
        self.looks: Looks = Looks()
        self._paid = self._leave = 0  # places, from the beginning of what is kept

    def feed(self, data: bytes) -> list[Scan]:
        """Take bytes; return the turns that they complete."""
        data = self._rest + data
        end = len(data) - NODE_SIZE + 1
        begin = self._leave
        scans: list[Scan] = []
        while begin < end:
            if self._is_lost:
                found = _BEGINNING.search(data, begin)
                self._is_lost = found is None
                after = found.start() if found else end
                self.discarded += after - begin
                begin = after
                continue
            piece = _PIECE.match(data, begin)
            assert piece is not None  # it may be empty
            if piece.start(1) == begin:
                if self._whole:
                    scans.append(_decode(self._turn))
                self._turn.clear()
                self._whole = True
                leave = self._pay(begin)
            elif piece.end() == begin:
                leave = self._pay(begin) + 1
            else:
                leave = 0
            if leave:
                self._lose_turn()
                self._is_lost = True
                self.discarded += leave
                begin += leave
                continue
            if self._whole:
                self._turn += data[begin : piece.end()]
                if len(self._turn) > MAX_NODES * NODE_SIZE:
                    self._lose_turn()
            begin = piece.end()
        kept = min(begin, len(data))
        self._rest = data[kept:]
        self._leave, self._paid = begin - kept, self._paid - kept
        return scans

    def _pay(self, place: int) -> int:
        self.looks.earn(place - self._paid)
        self._paid = place
        return self.looks.pay(LOOKS)

    def _lose_turn(self) -> None:
        self.bad_turns += self._whole
        self._whole = False
        self._turn.clear()


def _decode(nodes: bytearray) -> Scan:
    count = len(nodes) // NODE_SIZE
    words = bytearray(4 * count)
    for place in range(4):
        words[place::4] = nodes[place + 1 :: NODE_SIZE]
    numbers = struct.unpack(f"<{2 * count}H", words)
    return Scan(
        # Measured clockwise in 1/64 degree, the lowest bit is for checking.
        tuple([((46081 - n if n > 23040 else 1 - n) * _UNIT) for n in numbers[::2]]),
        tuple([far / 4000 if far else math.inf for far in numbers[1::2]]),
        tuple(nodes[::NODE_SIZE].translate(_QUALITY)),
    )


class RpLidar(Sensor[Scan]):
    """An RPLIDAR, alone on its line, that pushes every turn.

    At each opening it is stopped and asked how it is. By its serial number it is told
    from another one that is plugged in in its place.

    Attributes:
        decoder: Counts what was damaged on the way.
        info: Who it is; None before it was opened.
    """

    bus: SerialBus
    deadline: float = 1.0
    period: float | None = 1.0  # it may speak, and its laser not turn

    def __init__(self, **settings: Unpack[SensorSettings]) -> None:
        super().__init__(**settings)
        check_bus(self, SerialBus, Raw)
        self.decoder: ScanDecoder = ScanDecoder()
        self.info: Info | None = None

    def counts(self) -> dict[str, int]:
        """Return the turns that had a gap."""
        return {"bad_turns": self.decoder.bad_turns}

    async def open(self) -> None:
        """Stop it, and ask who and how it is.

        Raises:
            DeviceFaultError: It does not answer, or says that it is out of order.
        """
        await self.bus.write(request(STOP))
        await asyncio.sleep(0.002)  # the document asks for 1 ms at least
        with self.bus.frames(limit=1024) as chunks:
            info = await self._ask(GET_INFO, INFO_DESCRIPTOR, _INFO.size, chunks)
            answer = await self._ask(
                GET_HEALTH, HEALTH_DESCRIPTOR, _HEALTH.size, chunks
            )
        self.info = decode_info(info[: _INFO.size])
        try:
            health = decode_health(answer[: _HEALTH.size])
        except ValueError as error:
            raise DeviceFaultError(self.name, str(error)) from error
        if health.status == "error":
            raise DeviceFaultError(
                self.name,
                f"it says that it is out of order, code {health.code:#06x}: "
                "take its power away for a moment",
            )

    async def identify(self) -> str | None:
        """Return its serial number."""
        return None if self.info is None else self.info.serial

    async def stream(self) -> AsyncIterator[Scan]:
        """Start it and yield each turn that comes whole.

        Raises:
            DeviceLostError: It falls silent: it has restarted, say, and scans no more.
        """
        past, self.decoder = self.decoder, ScanDecoder()
        decoder = self.decoder
        decoder.bad_turns = past.bad_turns
        with self.bus.frames(limit=1024) as chunks:
            rest = await self._ask(SCAN, SCAN_DESCRIPTOR, 0, chunks)
            for scan in decoder.feed(rest):
                yield scan
            async for chunk in heard(self, chunks, self.deadline):
                for scan in decoder.feed(chunk):
                    yield scan

    async def close(self) -> None:
        """Stop it, if it is still there."""
        if self.bus.is_open:
            await self.bus.write(request(STOP))

    async def _ask(
        self, command: int, descriptor: bytes, size: int, chunks: Inbox[bytes]
    ) -> bytes:
        """Return what follows the descriptor of an answer, at least *size* bytes."""
        await self.bus.write(request(command))
        data = b""
        try:
            async with asyncio.timeout(self.deadline / 3):
                while len(data) < NOISE_LIMIT:
                    data += await chunks.take()
                    begin = data.find(descriptor) + len(descriptor)
                    if begin >= len(descriptor) and len(data) >= begin + size:
                        return data[begin:]
        except TimeoutError:
            pass
        fault = DeviceFaultError(
            self.name,
            f"no answer to request {command:#04x}, but {len(data)} other bytes",
        )
        if not data:  # it has no power yet, say, and is waited for
            fault.errno = errno.ETIMEDOUT
        raise fault
