"""SDO requests whose answers are theirs: the package canopen takes any that comes."""

from __future__ import annotations

import asyncio
import concurrent.futures
import struct
import threading
from typing import Any, Final

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.constants import ABORT_TIMED_OUT, RESPONSE_ABORTED
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from esair.buses import CanBus, Exchanges
from esair.exceptions import DriverStuckError

ABSENT: Final = frozenset({ABORT_TIMED_OUT, 0x060A0023})
"""Aborts of a gateway that has not reached the node: timed out, no connection left."""

LATE_LIMIT: Final = 0.3
"""How long after its request was given up an answer may still come, in seconds."""

LOOP_TIMEOUT: Final = 1.0
"""How much longer the thread waits for the event loop to answer, in seconds."""


class RemoteNode(canopen.RemoteNode):
    """A node as the package sees it, with requests that go by `Exchanges`."""

    def __init__(
        self, number: int, dictionary: Any, bus: CanBus, exchanges: Exchanges
    ) -> None:
        self._bus = bus
        self._exchanges = exchanges
        super().__init__(number, dictionary)

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> SdoClient:
        """Make a client; the package has but the default one made."""
        make: Any = _Client  # the package is typed in part
        client: _Client = make(rx_cobid, tx_cobid, self.object_dictionary)
        client.take_over(self._bus, self._exchanges)
        self.sdo_channels.append(client)
        return client


class _Client(SdoClient):
    def take_over(self, bus: CanBus, exchanges: Exchanges) -> None:
        self._bus = bus
        self._exchanges = exchanges
        self._loop = asyncio.get_running_loop()

    def request_response(self, sdo_request: Any) -> bytes:
        """Send a request and return its answer, in the thread; never a late one."""
        sent = threading.Event()
        asking = asyncio.run_coroutine_threadsafe(
            self._ask(bytes(sdo_request), sent), self._loop
        )
        sent.wait(LATE_LIMIT + LOOP_TIMEOUT)
        try:
            response = asking.result(self.RESPONSE_TIMEOUT)
        except DriverStuckError:
            raise
        except (TimeoutError, concurrent.futures.CancelledError):
            asking.cancel()
            self.abort(ABORT_TIMED_OUT)  # type: ignore[no-untyped-call]
            raise SdoCommunicationError("No SDO response received") from None
        if response[0] == RESPONSE_ABORTED:
            abort = SdoAbortedError(struct.unpack_from("<L", response, 4)[0])
            if abort.code in ABSENT:
                raise SdoCommunicationError(f"a gateway says: {abort}")
            raise abort
        return response

    async def _ask(self, request: bytes, sent: threading.Event) -> bytes:
        async def send(_left: float) -> None:
            await self._bus.send(self.rx_cobid, request)
            sent.set()

        seconds = self.RESPONSE_TIMEOUT + LATE_LIMIT + LOOP_TIMEOUT
        try:
            return await self._exchanges.ask(
                send, timeout=seconds, patience=self.RESPONSE_TIMEOUT
            )
        finally:
            sent.set()
