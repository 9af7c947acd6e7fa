"""CAN buses. The only module that knows python-can."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import threading
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple, Protocol

from esair.buses._bus import Bus
from esair.buses._inbox import Inbox
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.loop import Lane

OPEN_TIMEOUT = 5.0
"""How long opening an interface may take, in seconds."""

POLL_PERIOD = 0.1
"""How often a reading thread looks whether it should end, in seconds."""

RETRY_PERIOD = 0.001
"""The first pause before a frame is offered again to a full queue, in seconds."""

_BUS_OFF = 0x40  # the class of an error frame, linux/can/error.h


class Frame(NamedTuple):
    """One CAN frame.

    Attributes:
        id: The arbitration id.
        data: 0 to 8 bytes; up to 64 with CAN FD.
        extended: Whether the id has 29 bits.
        time: When it was received, on the event loop's clock; 0.0 if it is sent.
    """

    id: int
    data: bytes
    extended: bool = False
    time: float = 0.0


class FrameLink(Protocol):
    """One node on a CAN bus."""

    async def send(self, frame: Frame) -> bool:
        """Hand a frame to the bus; False if its queue is full just now."""

    async def close(self) -> None:
        """Leave the bus; takes a limited time."""


FrameOpener = Callable[
    [Callable[[Frame], None], Callable[[Exception], None]], Awaitable[FrameLink]
]
"""Opens a node; gets a function for each frame and one for the loss of the bus."""


class CanBus(Bus):
    """A CAN bus, and who listens to which frames on it.

    Reading never misses that the bus is gone: whatever ends it reaches everybody
    on the bus as one loss. Sending never blocks the event loop: a frame that the
    controller's queue has no room for is offered again until its deadline, or until
    a newer frame with the same id makes it obsolete.

    Args:
        name: The name of the bus.
        interface: What python-can calls it, such as ``socketcan`` or ``virtual``.
        channel: Which of them, such as ``can0``.
        send_timeout: How long a frame may wait for room unless it says otherwise,
            in seconds.
        opener: Opens something else than an interface, such as a wire in memory.
        **options: Further options of ``can.Bus``, such as ``bitrate=500_000``.

    Attributes:
        unheard: How many frames nobody listened to.
        errors: How many error frames came.
        overrun: How many frames were thrown away because they came too fast.
        obsolete: How many frames were not sent because a newer one was there.
    """

    def __init__(
        self,
        *,
        name: str,
        interface: str = "socketcan",
        channel: str = "",
        send_timeout: float = 0.1,
        opener: FrameOpener | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name=name)
        if not channel and opener is None:
            raise ConfigError(
                name, "channel", "expected the name of a channel, such as 'can0'"
            )
        self.interface = interface
        self.channel = channel
        self.send_timeout = send_timeout
        self.unheard = 0
        self.errors = 0
        self.overrun = 0
        self.obsolete = 0
        self._opener = opener or python_can(
            interface, channel, lane=self.lane, owner=self, **options
        )
        self._link: FrameLink | None = None
        self._epoch = 0
        self._by_id: dict[int, tuple[Inbox[Frame], ...]] = {}
        self._newest: dict[int, int] = {}
        self._sent = 0

    def frames(self, *ids: int, limit: int = 16) -> Inbox[Frame]:
        """Listen to the frames with some ids.

        Args:
            *ids: Arbitration ids.
            limit: How many are kept until they are taken; then the newest win.

        Raises:
            DeviceLostError: The bus is not open.
        """
        self._connected()
        if not ids:
            raise BadValueError(
                self.name, "ids", "expected at least one id to listen to"
            )
        inbox: Inbox[Frame] = Inbox(limit, self._forget)
        for number in ids:
            self._by_id[number] = (*self._by_id.get(number, ()), inbox)
        return inbox

    async def send(
        self,
        id: int,  # noqa: A002 - what everybody calls it
        data: bytes,
        *,
        extended: bool = False,
        timeout: float | None = None,
    ) -> None:
        """Send a frame.

        Args:
            id: The arbitration id.
            data: Its 0 to 8 bytes.
            extended: Whether the id has 29 bits.
            timeout: How long to wait for room, in seconds; ``send_timeout`` if None.

        Raises:
            BadValueError: The id or the data are not those of a frame.
            DeviceLostError: The bus is gone.
            BusyError: A newer frame with this id is waiting; this one was not sent.
            DriverStuckError: There was no room in time; it was not sent.
        """
        link = self._connected()
        if not 0 <= id < (1 << 29 if extended else 1 << 11):
            raise BadValueError(self.name, "id", f"expected a CAN id, not {id!r:.80}")
        if len(data) > 64:
            raise BadValueError(
                self.name, "data", f"expected 64 bytes at most, not {len(data)}"
            )
        self._sent += 1
        mine = self._newest[id] = self._sent
        frame = Frame(id, bytes(data), extended)
        try:
            if await link.send(frame):
                return
            await self._send_again(link, frame, mine, timeout)
        except OSError as error:
            if isinstance(error, DeviceLostError | DriverStuckError):
                raise
            loss = DeviceLostError(self.name, describe(error))
            self._gone(self._epoch, loss)
            raise loss from error
        finally:
            if self._newest.get(id) == mine:
                del self._newest[id]

    async def _send_again(
        self, link: FrameLink, frame: Frame, mine: int, timeout: float | None
    ) -> None:
        loop = asyncio.get_running_loop()
        seconds = self.send_timeout if timeout is None else timeout
        give_up = loop.time() + seconds
        pause = RETRY_PERIOD
        while loop.time() < give_up:
            await asyncio.sleep(min(pause, max(0.0, give_up - loop.time())))
            pause = min(2 * pause, 0.02)
            if self._newest.get(frame.id) != mine:
                self.obsolete += 1
                raise BusyError(
                    f"bus {self.name}", f"frames waiting with id {frame.id:#x}", 1
                )
            if self._link is not link:
                raise DeviceLostError(
                    self.name, "the bus was lost while a frame waited"
                )
            if await link.send(frame):
                return
        raise DriverStuckError(self.name, "send", seconds)

    def _connected(self) -> FrameLink:
        if not self.is_open or self._link is None:
            raise DeviceLostError(self.name, "the bus is not open")
        return self._link

    def _forget(self, inbox: Inbox[Frame]) -> None:
        for number, inboxes in tuple(self._by_id.items()):
            rest = tuple(other for other in inboxes if other is not inbox)
            if rest:
                self._by_id[number] = rest
            else:
                del self._by_id[number]

    async def _open(self) -> None:
        await self._close()  # what a loss has left behind
        self._epoch += 1
        epoch = self._epoch
        try:
            self._link = await self._opener(
                self._received, lambda error: self._gone(epoch, error)
            )
        except OSError as error:
            where = f"{self.interface} {self.channel}".strip()
            detail = f"{where} cannot be opened: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error

    async def _close(self) -> None:
        self._epoch += 1
        link, self._link = self._link, None
        self._fail_listeners(DeviceLostError(self.name, "the bus was closed"))
        if link is not None:
            await link.close()

    def _received(self, frame: Frame) -> None:
        inboxes = self._by_id.get(frame.id)
        if inboxes is None:
            self.unheard += 1
            return
        for inbox in inboxes:
            inbox.offer(frame)

    def _gone(self, epoch: int, error: Exception) -> None:
        if epoch != self._epoch:
            return
        self._epoch += 1
        loss = error
        if not isinstance(error, DeviceLostError):
            loss = DeviceLostError(self.name, describe(error))
            loss.__cause__ = error
        self._fail_listeners(loss)
        self.lost(loss)

    def _fail_listeners(self, error: Exception) -> None:
        by_id, self._by_id = self._by_id, {}
        for inboxes in by_id.values():
            for inbox in inboxes:
                inbox.fail(error)


def python_can(
    interface: str,
    channel: str,
    *,
    lane: Lane,
    owner: CanBus | None = None,
    **options: Any,
) -> FrameOpener:
    """Return what opens a node of one of python-can's interfaces.

    Args:
        interface: What python-can calls it.
        channel: Which of them.
        lane: The thread for the calls that may block.
        owner: The bus that counts error frames and frames thrown away.
        **options: Further options of ``can.Bus``.
    """

    async def opener(
        received: Callable[[Frame], None], gone: Callable[[Exception], None]
    ) -> FrameLink:
        node = _Node(lane, owner, received, gone)
        await node.open(interface, channel, options)
        return node

    return opener


class _Node:
    """A node of python-can.

    Where the interface has a descriptor, the event loop watches it and frames are
    sent from the loop, without waiting. Where it has none (``virtual``, ``pcan``) one
    thread reads, the bus's lane sends, and neither is python-can's own Notifier,
    which goes silent after an error (python-can#1865).
    """

    inbox_limit = 1024

    def __init__(
        self,
        lane: Lane,
        owner: CanBus | None,
        received: Callable[[Frame], None],
        gone: Callable[[Exception], None],
    ) -> None:
        self._lane = lane
        self._owner = owner
        self._received = received
        self._gone = gone
        self._loop = asyncio.get_running_loop()
        self._bus: Any = None
        self._fd = -1
        self._closed = False
        self._incoming: collections.deque[Frame] = collections.deque(
            maxlen=self.inbox_limit
        )
        self._announced = False
        self._reader: threading.Thread | None = None

    async def open(self, interface: str, channel: str, options: dict[str, Any]) -> None:
        try:
            self._bus = await self._lane.call(
                self._make, interface, channel, options, timeout=OPEN_TIMEOUT
            )
        except BaseException:
            self._closed = True  # a bus that opens later is shut again
            raise
        with contextlib.suppress(Exception):  # several interfaces have none
            self._fd = self._bus.fileno()
        if self._fd >= 0:
            self._loop.add_reader(self._fd, self._readable)
            return
        self._reader = threading.Thread(
            target=self._read, name=f"esair-{self._lane.name}-reader", daemon=True
        )
        self._reader.start()

    async def send(self, frame: Frame) -> bool:
        if self._closed:
            raise ConnectionError("the node is closed")
        if self._fd >= 0:
            return self._send(frame)
        return await self._lane.call(self._send, frame, timeout=1.0)

    async def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            self._fd = -1
        with contextlib.suppress(DriverStuckError, BusyError):
            await self._lane.call(self._shut, timeout=1.0)

    def _make(self, interface: str, channel: str, options: dict[str, Any]) -> Any:
        import can

        try:
            bus = can.Bus(channel=channel, interface=interface, **options)
        except (can.CanError, OSError, ImportError) as error:
            raise ConnectionError(describe(error)) from error
        if self._closed:
            bus.shutdown()
        return bus

    def _send(self, frame: Frame) -> bool:
        import can

        message = can.Message(
            arbitration_id=frame.id,
            data=frame.data,
            is_extended_id=frame.extended,
            is_fd=len(frame.data) > 8,
        )
        try:
            self._bus.send(message, timeout=0)
        except can.CanError as error:
            # ENOBUFS has a number; "Transmit buffer full" and a full queue have none.
            if error.error_code in {None, 11, 105}:
                return False
            raise ConnectionError(describe(error)) from error
        return True

    def _readable(self) -> None:
        for _ in range(64):  # a flood must not keep the loop
            try:
                message = self._bus.recv(timeout=0)
            except Exception as error:
                self._loop.remove_reader(self._fd)
                self._gone(error)
                return
            if message is None:
                return
            frame = self._checked(message)
            if frame is not None:
                self._received(frame)

    def _read(self) -> None:
        while not self._closed:
            try:
                message = self._bus.recv(timeout=POLL_PERIOD)
                frame = None if message is None else self._checked(message)
            except Exception as error:
                self._call(self._gone_in_loop, error)
                return
            if frame is None:
                continue
            if len(self._incoming) == self.inbox_limit and self._owner is not None:
                self._owner.overrun += 1
            self._incoming.append(frame)
            if not self._announced:
                self._announced = True
                self._call(self._take)

    def _take(self) -> None:
        self._announced = False
        while self._incoming and not self._closed:
            self._received(self._incoming.popleft())

    def _gone_in_loop(self, error: Exception) -> None:
        if not self._closed:
            self._gone(error)

    def _checked(self, message: Any) -> Frame | None:
        if message.is_error_frame:
            if self._owner is not None:
                self._owner.errors += 1
            if message.arbitration_id & _BUS_OFF:
                raise ConnectionError("the controller went bus-off")
            return None
        if message.is_remote_frame:
            return None
        return Frame(
            message.arbitration_id,
            bytes(message.data),
            message.is_extended_id,
            self._loop.time(),
        )

    def _call(self, function: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(function, *args)

    def _shut(self) -> None:
        if self._reader is not None:
            self._reader.join(2 * POLL_PERIOD)
        with contextlib.suppress(Exception):  # whatever it says, nobody can act on it
            self._bus.shutdown()
