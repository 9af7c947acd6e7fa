"""Frames of a CAN bus, and what a node on it must be able to do."""

from __future__ import annotations

import abc
import enum
from collections.abc import Awaitable, Callable, Collection
from typing import Final, NamedTuple, Protocol

from esair.buses._bus import Wire
from esair.buses.can._errors import CanState
from esair.buses.can._ids import Filter
from esair.exceptions import BadValueError
from esair.values import check_bytes

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
