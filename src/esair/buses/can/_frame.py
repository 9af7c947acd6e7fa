"""Frames of a CAN bus, and what a node on it must be able to do."""

from __future__ import annotations

import abc
import enum
from collections.abc import Awaitable, Callable, Collection, Iterator
from typing import Final, NamedTuple, Protocol, TypeAlias

from esair.buses._bus import BusStats, Wire
from esair.buses._inbox import Inbox
from esair.exceptions import BadValueError
from esair.values import check_bytes


class CanState(enum.IntEnum):
    """How a controller stands on its bus, by its error counters; the worse the higher.

    A controller that made too many errors may only listen and wait (passive), then
    takes itself off the bus (bus-off). The numbers are the kernel's.
    """

    ACTIVE = 0
    """Fewer than 96 errors: it takes part as it should."""

    WARNING = 1
    """96 errors or more."""

    PASSIVE = 2
    """128 errors or more: it no longer disturbs the bus to report an error."""

    BUS_OFF = 3
    """256 errors in sending: it takes no part until somebody starts it again."""


class ErrorFrame(NamedTuple):
    """What an error frame says.

    Attributes:
        state: The state that the controller has entered; None if it tells none.
        unacknowledged: Whether a frame was sent and no other node acknowledged it.
        overflow: Whether the controller lost a frame that came.
        restarted: Whether the controller was bus-off and has started again.
        text: All of it in words.
    """

    state: CanState | None
    unacknowledged: bool
    overflow: bool
    restarted: bool
    text: str


TX_TIMEOUT: Final = 0x001
LOST_ARBITRATION: Final = 0x002
CONTROLLER: Final = 0x004
PROTOCOL: Final = 0x008
TRANSCEIVER: Final = 0x010
NO_ACKNOWLEDGE: Final = 0x020
BUS_OFF: Final = 0x040
BUS_ERROR: Final = 0x080
RESTARTED: Final = 0x100
COUNTERS: Final = 0x200

CONTROLLER_BITS: Final[dict[CanState, int]] = {
    CanState.WARNING: 0x08,
    CanState.PASSIVE: 0x20,
    CanState.ACTIVE: 0x40,
}
"""The bit in byte 1 by which a controller says that sending took it to a state."""

_STATES: Final = (
    (0x30, CanState.PASSIVE),
    (0x0C, CanState.WARNING),
    (0x40, CanState.ACTIVE),
)
_CONTROLLER: Final = {
    0x01: "receive buffer overflow",
    0x02: "send buffer overflow",
    0x04: "warning: many errors in receiving",
    0x08: "warning: many errors in sending",
    0x10: "error-passive in receiving",
    0x20: "error-passive in sending",
    0x40: "error-active again",
}
_PROTOCOL: Final = {
    0x01: "single bit error",
    0x02: "frame format error",
    0x04: "bit stuffing error",
    0x08: "unable to send a dominant bit",
    0x10: "unable to send a recessive bit",
    0x20: "overload",
    0x40: "active error announcement",
    0x80: "in sending",
}
_LOCATION: Final = {
    0x03: "start of frame", 0x02: "ID bits 28-21", 0x06: "ID bits 20-18",
    0x04: "substitute RTR", 0x05: "identifier extension", 0x07: "ID bits 17-13",
    0x0F: "ID bits 12-5", 0x0E: "ID bits 4-0", 0x0C: "RTR", 0x0D: "reserved bit 1",
    0x09: "reserved bit 0", 0x0B: "data length code", 0x0A: "data section",
    0x08: "CRC sequence", 0x18: "CRC delimiter", 0x19: "ACK slot",
    0x1B: "ACK delimiter", 0x1A: "end of frame", 0x12: "intermission",
}  # fmt: skip
_TRANSCEIVER: Final = {
    0x04: "CANH has no wire", 0x05: "CANH shorted to battery",
    0x06: "CANH shorted to VCC", 0x07: "CANH shorted to ground",
    0x40: "CANL has no wire", 0x50: "CANL shorted to battery",
    0x60: "CANL shorted to VCC", 0x70: "CANL shorted to ground",
    0x80: "CANL shorted to CANH",
}  # fmt: skip


def decode_error(classes: int, data: bytes) -> ErrorFrame:
    """Say what an error frame means."""
    lost_in, controller, protocol, location, transceiver, _, sent, received = (
        data.ljust(8, b"\0")[:8]
    )
    words: list[str] = []
    state: CanState | None = None
    if classes & RESTARTED:
        state = CanState.ACTIVE
        words.append("the controller was bus-off and has started again")
    if classes & CONTROLLER:
        words.append(f"controller: {_words(_CONTROLLER, controller)}")
        for bits, entered in _STATES:
            if controller & bits:
                state = entered
                break
    if classes & BUS_OFF:
        state = CanState.BUS_OFF
        words.append("the controller is bus-off")
    if classes & NO_ACKNOWLEDGE:
        words.append("no other node acknowledges")
    if classes & PROTOCOL:
        where = f" in the {_LOCATION[location]}" if location in _LOCATION else ""
        words.append(f"protocol: {_words(_PROTOCOL, protocol)}{where}")
    if classes & TRANSCEIVER:
        fault = _TRANSCEIVER.get(transceiver, f"status {transceiver:#04x}")
        words.append(f"transceiver: {fault}")
    if classes & LOST_ARBITRATION:
        words.append(f"arbitration lost in bit {lost_in}")
    if classes & TX_TIMEOUT:
        words.append("a frame was not sent in time")
    if classes & BUS_ERROR and not classes & (PROTOCOL | NO_ACKNOWLEDGE):
        words.append("bus error")
    if classes & COUNTERS or sent or received:
        words.append(f"{sent} send and {received} receive errors")
    return ErrorFrame(
        state,
        bool(classes & NO_ACKNOWLEDGE),
        bool(classes & CONTROLLER and controller & 0x01),
        bool(classes & RESTARTED),
        ", ".join(words) or f"error frame of class {classes:#x}",
    )


def _words(names: dict[int, str], bits: int) -> str:
    said = [name for bit, name in names.items() if bits & bit]
    return " and ".join(said) or "unspecified"


EXTENDED: Final = 0x8000_0000
"""The bit that tells an extended id from a standard one with the same number."""

_NUMBER: Final = 0x1FFF_FFFF
_STANDARD: Final = 0x7FF


class Mask(NamedTuple):
    """The ids that are the same as one in some bits.

    Attributes:
        id: The id.
        mask: The bits that count.
    """

    id: int
    mask: int


ALL: Final = Mask(0, 0)
"""Every id, standard and extended."""

Ids: TypeAlias = int | range | Mask
"""One id, the ids of a range, or those that a mask says."""


class Filter(NamedTuple):
    """Ids as the kernel chooses by them: those whose bits in a mask are the key's.

    Attributes:
        key: An id; an extended one has the bit `EXTENDED` set.
        mask: The bits that count.
    """

    key: int
    mask: int

    @property
    def is_exact(self) -> bool:
        """Whether it is one id."""
        return self.mask == _exact(self.key)


def key_of(owner: str, number: int, *, extended: bool) -> int:
    """Return the id as listeners are kept by."""
    if isinstance(number, int) and 0 <= number < (0x2000_0000 if extended else 0x800):
        return number | EXTENDED if extended else number
    kind = "an extended CAN id below 2**29" if extended else "a CAN id below 2**11"
    raise BadValueError(
        owner, "id", f"expected {kind}, not {number!r:.80} (or extended={not extended})"
    )


def filters_of(
    owner: str, ids: tuple[Ids, ...], *, extended: bool
) -> tuple[Filter, ...]:
    """Return what the kernel chooses ids by."""
    found: dict[Filter, None] = {}
    for each in ids:
        found.update(dict.fromkeys(_filters(owner, each, extended)))
    if not found:
        raise BadValueError(owner, "ids", "expected at least one id to listen to")
    return tuple(found)


def _filters(owner: str, ids: Ids, extended: bool) -> Iterator[Filter]:
    flag = EXTENDED if extended else 0
    if ids is ALL:
        yield Filter(0, 0)
    elif isinstance(ids, Mask):
        key = key_of(owner, ids.id, extended=extended)
        mask = key_of(owner, ids.mask, extended=extended) | EXTENDED
        yield Filter(key & mask, mask)
    elif isinstance(ids, range):
        if ids.step != 1 or not ids:
            raise BadValueError(
                owner, "ids", f"expected ids one after the other, not {ids!r:.80}"
            )
        first = key_of(owner, ids[0], extended=extended) & _NUMBER
        last = key_of(owner, ids[-1], extended=extended) & _NUMBER
        while first <= last:  # blocks of 2**n ids that begin at their multiples
            size = first & -first or EXTENDED
            while first + size - 1 > last:
                size >>= 1
            mask = _exact(flag) & ~(size - 1)
            yield Filter(first | flag, mask)
            first += size
    else:
        key = key_of(owner, ids, extended=extended)
        yield Filter(key, _exact(key))


def _exact(key: int) -> int:
    return EXTENDED | (_NUMBER if key & EXTENDED else _STANDARD)


FD_SIZES: Final = frozenset({*range(9), 12, 16, 20, 24, 32, 48, 64})
"""How many bytes a CAN FD frame can have."""


class FrameKind(enum.Enum):
    """What a frame is for."""

    DATA = "data"
    REMOTE = "remote"
    """It has no data and asks another node for them."""
    ERROR = "error"
    """It was never on the wire: the controller reports an error; see `decode_error`."""


class Frame(NamedTuple):
    """One CAN frame.

    Attributes:
        id: The arbitration id; the classes of the error in an error frame.
        data: 0 to 8 bytes; up to 64 with CAN FD.
        extended: Whether the id has 29 bits.
        time: When it was received, on the event loop's clock; 0.0 if it is sent.
        kind: Data, remote or error.
    """

    id: int
    data: bytes
    extended: bool = False
    time: float = 0.0
    kind: FrameKind = FrameKind.DATA


class FrameLink(Protocol):
    """One node on a CAN bus."""

    @property
    def state(self) -> CanState:
        """The state of its controller when the node was opened."""

    def listen(self, filters: Collection[Filter] | None) -> None:
        """Hear the frames with some ids; at first none, and error frames always.

        A link that cannot choose hears all.

        Args:
            filters: Keys and masks; extended ids have the bit `EXTENDED` set. All if
                None.
        """

    async def send(self, frame: Frame, timeout: float) -> bool:
        """Hand a frame to the bus; False if its queue is full just now.

        Args:
            frame: A frame with a valid id and length.
            timeout: How long that may take, in seconds; a link need not wait for room.

        Raises:
            DeviceFaultError: The frame is not taken, and the bus goes on.
            OSError: The bus is gone.
        """

    async def close(self) -> None:
        """Leave the bus, hear nothing more; takes a limited time."""


FrameOpener = Callable[
    [Callable[[Frame], None], Callable[[Exception], None]], Awaitable[FrameLink]
]
"""Opens a node; gets a function for each frame, of any kind, and one for the loss of
the bus. Both are called on the event loop."""


class CanWire(Wire, abc.ABC):
    """The far end of a CAN bus."""

    @abc.abstractmethod
    async def open(
        self,
        received: Callable[[Frame], None],
        gone: Callable[[Exception], None],
    ) -> FrameLink:
        """Open a node of the robot.

        Args:
            received: Called with each frame.
            gone: Called once when it is lost.

        Raises:
            ConnectionError: It is not there.
        """


def check_data(owner: str, data: bytes, *, fd: bool) -> bytes:
    """Return bytes as they are now, if they fit into one frame."""
    data = check_bytes(owner, "data", data)
    if len(data) > 8 and not fd:
        raise BadValueError(
            owner,
            "data",
            f"expected 8 bytes at most, not {len(data)}; more need a bus with fd=True",
        )
    if len(data) not in FD_SIZES:
        raise BadValueError(
            owner,
            "data",
            "expected 0 to 8, 12, 16, 20, 24, 32, 48 or 64 bytes (CAN FD), "
            f"not {len(data)}",
        )
    return data


class FrameInbox(Inbox[Frame]):
    """Frames in the order in which they came; the newest win.

    With *newest* a frame takes the place of an older one with its id in the line: so a
    fast id never pushes out a slow one, and what is taken is never old.
    """

    def __init__(
        self,
        limit: int,
        forget: Callable[[Inbox[Frame]], None],
        *,
        stats: BusStats,
        length: int | None,
        newest: bool,
    ) -> None:
        super().__init__(limit, forget)
        self.bad_frames = 0
        self._stats = stats
        self._length = length
        self._newest = newest

    def offer(self, item: Frame) -> None:
        """Add the newest frame if it has the right length."""
        if self._length is not None and len(item.data) != self._length:
            self.bad_frames += 1
            self._stats.bad_frames += 1
            return
        items = self._items
        if self._newest:
            for place, older in enumerate(items):
                if (older.id, older.extended) == (item.id, item.extended):
                    items[place] = item
                    self._drop()
                    return
        if len(items) == items.maxlen:
            self._drop()
        items.append(item)
        self._wake()

    def _drop(self) -> None:
        self.dropped += 1
        self._stats.dropped += 1
