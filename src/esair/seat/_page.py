"""The seat in a browser: one static page, a web socket, and metrics for machines."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import hmac
import ipaddress
import logging
import re
import secrets
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from esair.exceptions import ConfigError, describe
from esair.seat._place import secret_file
from esair.seat._visitor import PIECE, Budget, Entry, Piecewise, Visitor, Way, line_of
from esair.seat._wire import LIMIT

if TYPE_CHECKING:
    import ssl

    from starlette.requests import HTTPConnection, Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

    from esair.messages import Page
    from esair.seat._operator import Console


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
        # Who has not shown the token, the oldest first.
        self.there: dict[tuple[str, int], asyncio.Transport] = {}

    def enter(self, transport: asyncio.Transport) -> None:
        """Somebody has connected."""
        there = {k: t for k, t in self.there.items() if not t.is_closing()}
        peer = _peer(transport.get_extra_info("peername"))
        there[peer] = transport
        self.there = there
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
        self.there.pop(_peer(client), None)

    def dismiss(self, client: Any) -> None:
        """One has shown a wrong token, or none: it has a moment to read why it goes."""
        transport = self.there.get(_peer(client))
        if transport is not None:
            loop = asyncio.get_running_loop()
            loop.call_later(READ_WITHIN, transport.abort)

    def close(self) -> None:
        """Send everybody away."""
        for transport in self.there.values():
            transport.abort()


def _peer(name: Any) -> tuple[str, int]:
    return (str(name[0]), int(name[1])) if name else ("", 0)


def entrance(lobby: Lobby, context: ssl.SSLContext | None) -> type[asyncio.Protocol]:
    """Return what speaks HTTP with each that comes; by TLS if there is a context."""
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Entrance(H11Protocol):
        _tls: asyncio.Task[None] | None = None
        _early = b""

        def _begin(self, transport: asyncio.Transport) -> None:
            super().connection_made(transport)
            self.loop.call_later(HEADERS_WITHIN, self._end, transport, True)
            self.loop.call_later(ASKING, self._end, transport, False)

        def _end(self, transport: asyncio.Transport, unasked: bool) -> None:
            if unasked and self.cycle is not None:
                return
            if transport.get_protocol() is self:  # else it is a web socket by now
                transport.abort()

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            lobby.enter(transport)
            if context is None:
                self._begin(transport)
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
                if secured is None:
                    return  # it has gone meanwhile
                self._begin(secured)
                early, self._early = self._early, b""
                self.data_received(early)

        def data_received(self, data: bytes) -> None:
            if self.transport is None:  # the handshake is over, and nobody was told yet
                self._early += data
                return
            for begin in range(0, len(data), PIECE):
                # After its one question nothing is looked at: a body may be all chunks.
                is_over = self.cycle is not None or self.transport.is_closing()
                if not is_over and self.transport.get_protocol() is self:
                    super().data_received(data[begin : begin + PIECE])

        def connection_lost(self, exc: Exception | None) -> None:
            if self.transport is not None:  # else it never came so far
                super().connection_lost(exc)

    return Entrance


def guest(lobby: Lobby) -> type[asyncio.Protocol]:
    """Return what speaks by a web socket with each that has asked for one."""
    from uvicorn.protocols.websockets import websockets_sansio_impl as sansio

    class Guest(Piecewise, sansio.WebSocketsSansIOProtocol):  # type: ignore[misc]
        _bytes = 0

        def data_received(self, data: bytes) -> None:
            # Ten thousand pings of who has shown no token would hold the loop. What comes
            # with the token is a guest's: the next piece is read when that was looked at.
            if self._bytes > STRANGE and _peer(self.client) in lobby.there:
                self.transport.abort()
                return
            self._bytes += len(data) if self.handshake_initiated else 0
            sansio.WebSocketsSansIOProtocol.data_received(self, data)

    return Guest


_STRANGE = re.compile(r"[^a-zA-Z0-9_]")


def metrics(console: Console) -> str:
    """Return every counter, the states, and whether the robot is halted."""
    robot, status = console.robot, console.status.picture()
    families: dict[str, list[str]] = {
        "esair_up_seconds gauge": [f"esair_up_seconds {status['up']:.3f}"],
        "esair_halted gauge": [f"esair_halted {int(status['halted'] is not None)}"],
    }
    for row in (*status["resources"], *status["behaviors"]):
        labels = f'component="{_label(row["name"])}",kind="{row["kind"]}"'
        families.setdefault("esair_state gauge", []).append(
            f'esair_state{{{labels},state="{_label(row["state"])}"}} 1'
        )
        for key in ("rate", "age"):
            if row.get(key) is not None:
                families.setdefault(f"esair_{key} gauge", []).append(
                    f"esair_{key}{{{labels}}} {row[key]:.6g}"
                )
    for component, counters in robot.journal.counts().items():
        for name, number in counters.items():
            family = f"esair_{_STRANGE.sub('_', name)}"
            families.setdefault(f"{family} untyped", []).append(
                f'{family}{{component="{_label(component)}"}} {number}'
            )
    lines = []
    for family, samples in families.items():
        lines += [f"# TYPE {family}", *samples]
    return "\n".join(lines) + "\n"


def _label(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


VIEWERS = 16  # How many browsers may be there at a time; one lane more is kept for stop

WAITING = 256
"""How many lines may wait for a browser that does not read; one more and it goes."""

LINES = 500  # How many lines a browser may send in a second
STRANGE = 1024  # How many bytes of it are heard before that
LOGIN = 2.0  # How long a browser may take to show its token, in seconds
BACKLOG = 16  # How many newcomers may wait in the kernel

STRANGERS = 64
"""Of how many addresses a wrong token is told in the log, once each."""

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; "
    "style-src 'self'; connect-src 'self'; img-src 'self'; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Connection": "close",
}
"""What each answer says to the browser, whatever it is: nothing from elsewhere, nothing
inline, and one answer for each connection: a thousand would hold the robot's loop."""

_FILES = {
    "/": ("page.html", "text/html"),
    "/page.js": ("page.js", "text/javascript"),
    "/page.css": ("page.css", "text/css"),
}
_STATIC = Path(__file__).parent / "static"

_log = logging.getLogger("esair")

_PACKAGES = (
    "starlette.applications",
    "starlette.responses",
    "starlette.routing",
    "starlette.websockets",
    "uvicorn",
    "uvicorn.protocols.http.auto",
    "uvicorn.protocols.websockets.websockets_sansio_impl",
)


def import_packages() -> None:
    """Import what the page needs, which takes its time, before anything moves."""
    try:
        for package in _PACKAGES:
            __import__(package)
    except ImportError as error:
        told = f"it needs {error.name}: pip install 'esair[page]'"
        raise ConfigError("page", "", told) from error


class PageServer(Way["_Viewer"]):
    """Serves the page of a robot in its own event loop.

    What a person may do there is for the token alone, also on this computer: who else
    works on it reaches the same address.
    """

    def __init__(self, console: Console, page: Page) -> None:
        super().__init__(console, "page", VIEWERS)
        self.page = page
        self.token = page.token or secrets.token_urlsafe(16)
        self._lobby = Lobby()
        self._strangers: set[str] = set()
        self._server: Any = None
        self._serving: asyncio.Task[None] | None = None
        self._secret: Path | None = None
        self.port = page.port  # The port, also if any was asked for

    async def start(self) -> None:
        """Serve from now on."""
        import uvicorn

        app, page = self._app(), self.page
        settings = uvicorn.Config(
            app,
            log_config=None,
            access_log=False,
            lifespan="off",
            http=entrance(self._lobby, page.tls()),
            ws=guest(self._lobby),
            ws_max_size=LIMIT,
            ws_ping_interval=2.0,
            ws_ping_timeout=5.0,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=16 * 1024,
            server_header=False,
            proxy_headers=False,
            headers=[*HEADERS.items()],
        )
        for name in ("uvicorn.error", "uvicorn.access"):
            logging.getLogger(name).setLevel(logging.CRITICAL)

        class Server(uvicorn.Server):  # signals belong to the robot
            @contextlib.contextmanager
            def capture_signals(self) -> Iterator[None]:
                yield

        bound = _bind(page)
        self.port = bound.getsockname()[1]
        settings.load()
        self._server = server = Server(settings)
        self._serving = asyncio.create_task(server.serve(sockets=[]), name="esair page")
        speaks: Any = settings.http_protocol_class
        given = {"config": settings, "server_state": server.server_state}
        self.entry = Entry(bound, BACKLOG, lambda: speaks(**given, app_state={}))
        self._tell()

    def _tell(self) -> None:
        """Say where it is: to the person at the terminal with the token, to no log."""
        scheme = "http" if self.page.certificate is None else "https"
        host = f"[{self.page.host}]" if ":" in self.page.host else self.page.host
        if self.page.host in {"0.0.0.0", "::"}:
            host = socket.gethostname()
        address = f"{scheme}://{host}:{self.port}/"
        _log.warning("page: %s", address)
        if self.page.token is None:
            try:
                self._secret = secret_file(self.console.robot.name, self.token)
            except (OSError, ConfigError) as error:
                _log.warning("page: its token is in no file: %s", describe(error))
            else:
                told = "page: its token is in %s; add #TOKEN to the address"
                _log.warning(told, self._secret)
        with contextlib.suppress(Exception):  # there may be no stderr
            if sys.stderr.isatty():
                sys.stderr.write(f"page: {address}#{self.token}\n")
                sys.stderr.flush()

    async def close(self) -> None:
        """Serve no more."""
        for viewer in tuple(self.there):
            viewer.end()
        if self.entry is not None:
            self.entry.close()
        self._lobby.close()
        if self._serving is not None:
            self._server.should_exit = True
            await asyncio.wait({self._serving}, timeout=1.0)
            self._serving.cancel()
            await asyncio.wait({self._serving}, timeout=1.0)
        if self._secret is not None:
            with contextlib.suppress(OSError):
                self._secret.unlink()

    # Who may.

    def is_welcome(self, request: HTTPConnection) -> bool:
        """Tell whether a request comes to us, from a page of ours."""
        host = request.headers.get("host", "")
        origin = request.headers.get("origin")
        scheme = "http" if self.page.certificate is None else "https"
        good = self._is_our_name(host) and origin in {None, f"{scheme}://{host}"}
        if request.scope["type"] == "websocket":
            good = good and origin is not None
        if not good:
            self.turned_away += 1
        return good

    def _is_our_name(self, host: str) -> bool:
        """Tell whether a Host is one that no stranger's name server can lead here."""
        name, _, port = host.rpartition(":")
        if not port.isdecimal():  # a browser leaves the usual one out
            name, port = host, "80" if self.page.certificate is None else "443"
        if port != str(self.port):
            return False
        name = name.removeprefix("[").removesuffix("]").lower()
        if name in {"localhost", "127.0.0.1", "::1", self.page.host.lower()}:
            return True
        if self.page.is_local:
            return False
        own = socket.gethostname().lower()
        with contextlib.suppress(ValueError):
            return bool(ipaddress.ip_address(name))
        return name in {own, f"{own}.local"}

    def knows(self, token: object) -> bool:
        """Tell whether a token is the right one, in constant time."""
        given = token if isinstance(token, str) else ""
        return hmac.compare_digest(given.encode(), self.token.encode())

    def _turn_away(self, address: str) -> None:
        self.turned_away += 1
        if address not in self._strangers and len(self._strangers) < STRANGERS:
            self._strangers.add(address)
            _log.warning("page: %s showed a wrong token", address)

    # What is served.

    def _app(self) -> Any:
        from starlette.applications import Starlette
        from starlette.responses import PlainTextResponse, Response
        from starlette.routing import Route, WebSocketRoute

        async def file(request: Request) -> Response:
            if not self.is_welcome(request):
                return PlainTextResponse("not for you", 403)
            name, kind = _FILES[request.url.path]
            data = (_STATIC / name).read_bytes()
            return Response(data, media_type=kind)

        async def numbers(request: Request) -> Response:
            given = request.headers.get("authorization", "").removeprefix("Bearer ")
            if not self.is_welcome(request) or not self.knows(given):
                return PlainTextResponse("not for you", 403)
            return PlainTextResponse(metrics(self.console))

        async def operate(link: WebSocket) -> None:
            if not self.is_welcome(link):
                await link.close(4403)
                return
            await link.accept()
            await self._operate(link)

        return Starlette(
            routes=[
                *(Route(path, file, methods=["GET"]) for path in _FILES),
                Route("/metrics", numbers, methods=["GET"]),
                WebSocketRoute("/operate", operate),
            ]
        )

    async def _operate(self, link: WebSocket) -> None:
        from starlette.websockets import WebSocketDisconnect

        viewer = _Viewer(self, link)
        address = link.client.host if link.client is not None else "?"
        viewer.session.who = f"browser at {address}"
        knows = False
        with contextlib.suppress(
            WebSocketDisconnect, TimeoutError, RuntimeError, KeyError
        ):
            async with asyncio.timeout(LOGIN):
                knows = self.knows(await link.receive_text())
        if not knows:
            self._turn_away(address)
            self._lobby.dismiss(link.client)
            with contextlib.suppress(RuntimeError):  # it has gone
                await link.close(4401)
            return
        self._lobby.shown(link.client)
        if not self.has_room(viewer):
            await link.close(4429)
            return
        writes = asyncio.create_task(viewer.write(), name="esair page writes")
        try:
            budget = Budget(LINES)
            while not viewer.gone:
                line = await link.receive_text()
                viewer.do(line.encode("utf-8", "replace"))
                if pause := budget.spend(1):
                    await asyncio.sleep(pause)
        except (WebSocketDisconnect, TimeoutError, RuntimeError, KeyError):
            pass  # it has gone, or says nothing that is text
        finally:
            self.forget(viewer)
            viewer.gone = True
            viewer.leave()
            writes.cancel()


class _Viewer(Visitor):
    """One browser."""

    gone = False

    def __init__(self, way: PageServer, link: WebSocket) -> None:
        super().__init__(way.console)
        self._way = way
        self._link = link
        self._lines: collections.deque[bytes] = collections.deque()
        self._news = asyncio.Event()
        self._bytes = 0

    @property
    def unread(self) -> int:
        return self._bytes

    def send(self, found: dict[str, Any]) -> None:
        if self.gone:
            return
        line = line_of(found)
        if len(self._lines) >= WAITING:
            self._way.cut_off += 1
            self.close()
            return
        self._lines.append(line)
        self._bytes += len(line)
        self._news.set()

    def close(self) -> None:
        self.gone = True
        self._news.set()

    async def write(self) -> None:
        """Hand over what is to be sent, as fast as the browser takes it."""
        while True:
            await self._news.wait()
            self._news.clear()
            if self.gone:
                with contextlib.suppress(RuntimeError):
                    await self._link.close(4408)
                return
            while self._lines:
                line = self._lines.popleft()
                try:
                    await self._link.send_text(line.decode())
                except Exception:  # it has gone; its reader ends it
                    self.gone = True
                    return
                self._bytes -= len(line)


def _bind(page: Page) -> socket.socket:
    family = socket.AF_INET6 if ":" in page.host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((page.host, page.port))
        bound.setblocking(False)
    except OSError as error:
        bound.close()
        told = f"{page.host}:{page.port} cannot be had: {error.strerror}"
        raise ConfigError("page", "port", told) from None
    return bound
