"""Messages of up to 4095 bytes over CAN: ISO 15765-2, as can-isotp cuts them."""

from __future__ import annotations

import asyncio
import collections
from collections.abc import Callable
from typing import Any

from esair.buses import CanBus, Exchanges, Frame, Inbox
from esair.drivers._on_bus import SharedTask, shared
from esair.loading import of_extra

with of_extra("uds"):
    import isotp

CHECK_PERIOD = 0.1
"""How often a message that is not whole yet is looked at, in seconds."""


class IsoTp(SharedTask):
    """A pair of ids on a bus, over which a node is asked; `of` returns that of a bus.

    Between `join` and `leave` it hears the node. Requests of several devices never overlap.

    Args:
        bus: The bus.
        send: The id of the frames to the node.
        receive: The id of those from it.
        extended: Whether these are ids of 29 bits.

    Attributes:
        exchanges: Whose answer is what comes.
        is_pending: Tells whether a message says that the answer takes longer.
        patience: How long it may take then, in seconds.
    """

    def __init__(
        self, bus: CanBus, send: int, receive: int, *, extended: bool = False
    ) -> None:
        super().__init__(bus)
        self.exchanges: Exchanges = Exchanges(bus)
        self.is_pending: Callable[[bytes], bool] = lambda _message: False
        self.patience: float = 5.0
        self._ids = send, receive, extended
        self._lock = asyncio.Lock()
        self._heard: collections.deque[Any] = collections.deque()
        self._cut: collections.deque[Any] = collections.deque()
        self._layer: Any = None

    @classmethod
    def of(
        cls, bus: CanBus, send: int, receive: int, *, extended: bool = False
    ) -> IsoTp:
        """Return the one that all devices of a node share."""
        key = send, receive, extended
        return shared(bus, cls).setdefault(key, cls(bus, *key[:2], extended=extended))

    def join(self, bus: CanBus, user: object) -> None:
        """Hear the node as long as a device needs it."""
        send, receive, extended = self._ids
        mode = isotp.AddressingMode.Normal_11bits
        if extended:
            mode = isotp.AddressingMode.Normal_29bits
        inbox = bus.frames(receive, extended=extended, limit=1024)
        if not self.begin(user, lambda: self._hear(bus, inbox)):
            inbox.close()
            return
        self._heard.clear()
        self._cut.clear()
        self._layer = isotp.TransportLayerLogic(
            rxfn=lambda _timeout: self._heard.popleft() if self._heard else None,
            txfn=self._cut.append,
            address=isotp.Address(mode, txid=send, rxid=receive),
            params={"tx_padding": 0, "blocking_send": False},
        )

    async def ask(
        self, bus: CanBus, payload: bytes, *kinds: bytes, timeout: float
    ) -> bytes:
        """Send a message and return the one that answers it.

        Args:
            bus: The bus.
            payload: The message, of 1 to 4095 bytes.
            *kinds: What the answer begins with; anything if none is given.
            timeout: How long to wait, in seconds.

        Raises:
            DeviceLostError: The bus is gone.
            DriverStuckError: There was no answer in time.
        """

        async def send(_seconds: float) -> None:
            self._layer.stop_sending()  # what was given up
            self._layer.send(payload)
            await self._process(bus)

        return await self.exchanges.ask(send, *kinds, timeout=timeout)

    async def tell(self, bus: CanBus, payload: bytes) -> None:
        """Send a message that fits into a frame, and is not answered."""
        send, _, extended = self._ids
        data = bytes((len(payload), *payload)).ljust(8, b"\0")
        await bus.send(send, data, extended=extended)

    async def _hear(self, bus: CanBus, inbox: Inbox[Frame]) -> None:
        _, receive, extended = self._ids
        try:
            with inbox:
                while True:
                    try:
                        frame = await inbox.take(timeout=self._pause())
                    except TimeoutError:
                        pass
                    else:
                        self._heard.append(
                            isotp.CanMessage(
                                receive, data=frame.data, extended_id=extended
                            )
                        )
                    await self._process(bus)
        except BaseException as error:
            self.exchanges.fail(error)  # at once: it is not waited for any more
            raise

    def _pause(self) -> float | None:
        if self._layer.is_tx_transmitting_cf():
            return max(0.0005, self._layer.next_cf_delay() or 0.0)
        busy = self._layer.is_rx_active() or self._layer.transmitting()
        return CHECK_PERIOD if busy else None

    async def _process(self, bus: CanBus) -> None:
        """Let the package do what is due, and send what it has cut."""
        async with self._lock:  # frames of one message stay in order
            self._layer.process()
            while self._cut:
                frame = self._cut.popleft()
                await bus.send(
                    frame.arbitration_id,
                    bytes(frame.data),
                    extended=frame.is_extended_id,
                )
        while (message := self._layer.recv()) is not None:
            self._offer(bytes(message))

    def _offer(self, message: bytes) -> None:
        now = self.exchanges.now
        if now is not None and self.is_pending(message):
            now.until = asyncio.get_running_loop().time() + self.patience
            self.exchanges.limit_wait(now)
        else:
            self.exchanges.offer(message)
