"""``esair view``: a robot, live, in Foxglove or Lichtblick; read only.

Its server speaks Foxglove's protocol
(https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md) and offers no capability:
a client can neither publish, nor set, nor call anything.
"""

from __future__ import annotations

import asyncio
import collections
import json
import struct
import time
from collections.abc import Sequence
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, Final

import attrs

from esair.cli._errors import CANNOT_USE, tell
from esair.cli._options import Which
from esair.exceptions import EsairError, describe
from esair.recording import schema_of
from esair.seat import Client, connect

if TYPE_CHECKING:
    from websockets.asyncio.server import Server, ServerConnection
    from websockets.http11 import Request, Response

PROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""What viewers call the protocol; the first that one offers counts."""

ORIGINS: Final = ("https://app.foxglove.dev", "file://")
"""Whose pages may look: Foxglove's, and viewers that are installed here."""

VIEWERS: Final = 4  # How many may look at a time
WAITING: Final = 256  # How many messages may wait for a viewer; then the oldest goes

_HEAD: Final = struct.Struct("<BIQ")


@attrs.define(eq=False)
class _Viewer:
    """One who looks."""

    link: ServerConnection
    wanted: dict[int, int] = attrs.field(factory=dict)
    told: collections.deque[str] = attrs.field(factory=collections.deque)
    waiting: collections.deque[bytes] = attrs.field(
        factory=lambda: collections.deque(maxlen=WAITING)
    )
    news: asyncio.Event = attrs.field(factory=asyncio.Event)

    def tell(self, op: str, **fields: Any) -> None:
        """Tell something that must not be lost."""
        self.told.append(json.dumps({"op": op, **fields}))
        self.news.set()

    def send(self, data: bytes) -> None:
        """Send a message; of too many the newest count."""
        self.waiting.append(data)
        self.news.set()


class Views:
    """Shows messages to viewers on this computer."""

    def __init__(self, name: str, origins: Sequence[str] = ()) -> None:
        self.name = name
        self.origins = frozenset((*ORIGINS, *origins))
        self.viewers: set[_Viewer] = set()
        self.port = 0
        self._channels: dict[str, dict[str, Any]] = {}
        self._server: Server | None = None
        self._session = str(time.time_ns())

    async def start(self, port: int) -> None:
        """Let viewers come."""
        from websockets.asyncio.server import serve

        self._server = await serve(
            self._meet,
            "127.0.0.1",
            port,
            subprotocols=PROTOCOLS,  # type: ignore[arg-type]
            process_request=self._check,
            max_size=1 << 16,
            server_header=None,
        )
        self.port = next(iter(self._server.sockets)).getsockname()[1]

    async def close(self) -> None:
        """Show nothing any more."""
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def show(self, topic: str, schema: str, fields: Any, when: float) -> None:
        """Show a message to whoever wants to see its topic."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = {
                "id": len(self._channels) + 1,
                "topic": topic,
                "encoding": "json",
                "schemaName": schema,
                "schema": json.dumps({"title": schema, **schema_of(fields)}),
                "schemaEncoding": "jsonschema",
            }
            for viewer in self.viewers:
                viewer.tell("advertise", channels=[channel])
        data = b""
        for viewer in self.viewers:
            subscription = viewer.wanted.get(channel["id"])
            if subscription is not None:
                data = data or json.dumps(fields).encode()
                viewer.send(_HEAD.pack(1, subscription, int(when * 1e9)) + data)

    # Who may, and what they may.

    def _check(self, link: ServerConnection, request: Request) -> Response | None:
        """Refuse a page of a stranger, and a stranger's name that leads here."""
        origin = request.headers.get("Origin")
        name, _, port = request.headers.get("Host", "").rpartition(":")
        ours = name in {"127.0.0.1", "localhost"} and port == str(self.port)
        if not ours or (origin is not None and origin not in self.origins):
            told = f"not for {origin or name}; esair view --origin {origin or 'PAGE'}\n"
            return link.respond(HTTPStatus.FORBIDDEN, told)
        if len(self.viewers) >= VIEWERS:
            return link.respond(HTTPStatus.TOO_MANY_REQUESTS, "too many viewers\n")
        return None

    async def _meet(self, link: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        viewer = _Viewer(link)
        viewer.tell(
            "serverInfo",
            name=f"esair: {self.name}",
            capabilities=[],
            supportedEncodings=[],
            metadata={},
            sessionId=self._session,
        )
        viewer.tell("advertise", channels=[*self._channels.values()])
        self.viewers.add(viewer)
        sends = asyncio.create_task(_send(viewer), name="esair view sends")
        try:
            async for line in link:
                self._do(viewer, line)
        except ConnectionClosed:
            pass
        finally:
            self.viewers.discard(viewer)
            sends.cancel()

    def _do(self, viewer: _Viewer, line: str | bytes) -> None:
        try:
            told = json.loads(line) if isinstance(line, str) else {}
            if told["op"] == "subscribe":
                for each in told["subscriptions"]:
                    viewer.wanted[int(each["channelId"])] = int(each["id"]) & 0xFFFFFFFF
                return
            if told["op"] == "unsubscribe":
                ended = set(told["subscriptionIds"])
                wanted = viewer.wanted.items()
                viewer.wanted = {
                    k: number for k, number in wanted if number not in ended
                }
                return
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            pass
        if len(viewer.told) < WAITING:
            text = "read only: there is nothing to do here but to subscribe"
            viewer.tell("status", level=2, message=text)


async def _send(viewer: _Viewer) -> None:
    from websockets.exceptions import ConnectionClosed

    while True:
        await viewer.news.wait()
        viewer.news.clear()
        while viewer.told or viewer.waiting:
            try:
                await viewer.link.send((viewer.told or viewer.waiting).popleft())
            except ConnectionClosed:
                return


def view(*, robot: Which = None, port: int = 8765, origin: Sequence[str] = ()) -> int:
    """Show a robot live to Foxglove or Lichtblick.

    Open a connection to ws://127.0.0.1:8765 there. It can be looked at, and nothing can
    be changed. A recording is opened by these programs as it is.

    Args:
        port: Where it is shown, on this computer alone.
        origin: A page that may look too, such as https://lichtblick.example.org.
    """
    try:
        with connect(robot) as client:
            return asyncio.run(show(client, Views(client.name, origin), port))
    except (EsairError, BrokenPipeError):
        raise
    except OSError as error:
        tell(f"--port: {describe(error)}")
        return CANNOT_USE
    except KeyboardInterrupt:
        return 0


async def show(client: Client, views: Views, port: int) -> int:
    """Show what a robot tells, as long as it tells."""
    await views.start(port)
    print(  # noqa: T201 - this is the output
        f"{client.name}: ws://127.0.0.1:{views.port}/ for Foxglove or Lichtblick; "
        "Ctrl-C ends it",
        flush=True,
    )
    loop = asyncio.get_running_loop()
    over: asyncio.Future[int] = loop.create_future()

    def hear() -> None:
        try:
            for found in client.lines(0.0):
                if "message" in found:
                    views.show(**found["message"])
        except EsairError as error:
            loop.remove_reader(client)
            if not over.done():
                over.set_exception(error)

    client.send("view")
    loop.add_reader(client, hear)
    try:
        return await over
    finally:
        loop.remove_reader(client)
        await views.close()
