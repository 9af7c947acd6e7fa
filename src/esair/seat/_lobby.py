"""Who has connected to the page and has not shown its token: few, and not for long."""

from __future__ import annotations

import asyncio
import collections
import ssl
from typing import Any

CONNECTIONS = 64  # How many of them there may be, of whomever
OF_ONE = 16  # How many of them from one address
HEADERS_WITHIN = 2.0  # How long one may take to say what it wants, in seconds
READ_WITHIN = 0.5  # How long one that is sent away may take to read why, in seconds
ASKING = 10.0  # How long one may be there that is no web socket, in seconds


class Lobby:
    """Lets each newcomer in; if there are too many, the one that waits longest goes.

    So nobody is locked out, however many connect and say nothing: what a browser asks
    for has its answer long before its turn to go.
    """

    def __init__(self) -> None:
        self.sent_away = 0
        self._there: dict[tuple[str, int], asyncio.Transport] = {}  # the oldest first

    def enter(self, transport: asyncio.Transport) -> None:
        """Somebody has connected."""
        there = {k: t for k, t in self._there.items() if not t.is_closing()}
        peer = _peer(transport.get_extra_info("peername"))
        there[peer] = transport
        self._there = there
        of_each = collections.Counter(address for address, _ in there)
        busiest, _ = of_each.most_common(1)[0]
        if of_each[peer[0]] > OF_ONE:
            busiest = peer[0]
        elif len(there) <= CONNECTIONS:
            return
        oldest = next(each for each in there if each[0] == busiest)
        there.pop(oldest).abort()
        self.sent_away += 1

    def shown(self, client: Any) -> None:
        """One has shown the token: it is a guest, and waits here no more."""
        self._there.pop(_peer(client), None)

    def dismiss(self, client: Any) -> None:
        """One has shown a wrong token, or none: it has a moment to read why it goes."""
        transport = self._there.get(_peer(client))
        if transport is not None:
            loop = asyncio.get_running_loop()
            loop.call_later(READ_WITHIN, transport.abort)

    def close(self) -> None:
        """Send everybody away."""
        for transport in self._there.values():
            transport.abort()


def _peer(name: Any) -> tuple[str, int]:
    return (str(name[0]), int(name[1])) if name else ("", 0)


def entrance(lobby: Lobby, context: ssl.SSLContext | None) -> type[asyncio.Protocol]:
    """Return what speaks HTTP with each that comes; by TLS if there is a context."""
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Http(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self.loop.call_later(HEADERS_WITHIN, self._end, transport, True)
            self.loop.call_later(ASKING, self._end, transport, False)

        def _end(self, transport: asyncio.Transport, unasked: bool) -> None:
            if unasked and self.cycle is not None:
                return
            if transport.get_protocol() is self:  # else it is a web socket by now
                transport.abort()

    class Entrance(Http):
        _tls: asyncio.Task[None] | None = None
        _early = b""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            lobby.enter(transport)
            if context is None:
                super().connection_made(transport)
            else:
                transport.pause_reading()
                self._tls = self.loop.create_task(self._secure(transport, context))

        async def _secure(
            self, transport: asyncio.Transport, context: ssl.SSLContext
        ) -> None:
            try:
                secured = await self.loop.start_tls(
                    transport,
                    self,
                    context,
                    server_side=True,
                    ssl_handshake_timeout=HEADERS_WITHIN,
                )
            except OSError:  # it speaks something else, or nothing
                transport.abort()
            else:
                assert secured is not None
                super().connection_made(secured)
                early, self._early = self._early, b""
                if early:
                    super().data_received(early)

        def data_received(self, data: bytes) -> None:
            if self.transport is not None:
                super().data_received(data)
            else:  # the handshake is over, and nobody was told yet
                self._early += data

        def connection_lost(self, exc: Exception | None) -> None:
            if self.transport is not None:  # else it never came so far
                super().connection_lost(exc)

    return Entrance
