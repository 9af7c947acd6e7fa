"""Serial lines: framed messages that several devices share."""

from __future__ import annotations

import asyncio
import functools
import inspect
import logging
import os
from collections.abc import Callable, Mapping
from typing import Any

from esair.buses._bus import Bus, Wire
from esair.buses._exchanges import LATE_LIMIT, Exchange, Exchanges
from esair.buses._inbox import Inbox, within
from esair.buses.serial._line import Line, SerialLink
from esair.buses.serial._port import (
    Port,
    SerialPlace,
    close_port,
    link_of,
    reach_port,
)
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    did_you_mean,
    hint_for,
)
from esair.framing import FRAMINGS, Cobs, Framing, Lines, ModbusRtu
from esair.loop import SAFE, Arrivals, urgency
from esair.values import (
    check_bytes,
    check_choice,
    check_duration,
    check_seconds,
    check_whole,
)
from esair.watchdog import Outlet


def make_framing(owner: str, described: Framing | str | Mapping[str, Any]) -> Framing:
    """Return a new framing: from another one, a name, or a table with parameters."""
    if isinstance(described, Framing):
        return described.fresh()
    table = {"type": described} if isinstance(described, str) else described
    if not isinstance(table, Mapping):
        raise ConfigError(owner, "framing", f"expected {_names()}, not {table!r:.80}")
    if "type" not in table:
        raise ConfigError(owner, "framing", f"'type' is missing: expected {_names()}")
    name = table["type"]
    if not isinstance(name, str) or name not in FRAMINGS:
        hint = did_you_mean(str(name), FRAMINGS)
        raise ConfigError(
            owner, "framing", f"expected {_names()}, not {name!r:.80}{hint}"
        )
    framing: Any = FRAMINGS[name]
    parameters = {key: value for key, value in table.items() if key != "type"}
    known = list(inspect.signature(framing).parameters)
    for key in parameters:
        if key not in known:
            hint = hint_for(key, known, "it has")
            raise ConfigError(owner, "framing", f"{name} has no {key!r:.80}{hint}")
    try:
        made: Framing = framing(**parameters)
    except ConfigError as error:
        message = str(error).removeprefix(f"framing: {error.field}: ")
        raise ConfigError(owner, "framing", f"{error.field}: {message}") from error
    return made


def _names() -> str:
    return "one of " + ", ".join(repr(name) for name in FRAMINGS)


ECHO_LIMIT = 65536
"""How many bytes may be on their way back as an echo."""

_log = logging.getLogger("esair")


class SerialBus(Bus):
    """A serial line, and the messages on it.

    Several devices may share it: each listens with a prefix of its own and writes
    whole messages, which are never mixed. Nothing here ever blocks the event loop:
    the port is opened and closed on the bus's thread, exclusively, and a device that
    stops taking bytes costs the writer its deadline and nobody else anything. After a
    message that was cut, because time was up or the line was lost, the next one begins
    with a delimiter if the framing has one, so that it is not taken for the rest.

    In ``bus.stats`` what is sent and received is counted in bytes, ``bad_frames``,
    ``dropped`` and ``unheard`` in messages, ``refused`` in writes, ``discarded`` in
    bytes. How many bytes were noise between messages is ``bus.framing.discarded``.

    Args:
        name: The name of the bus.
        port: ``usb:VID:PID[:SERIAL]`` for the port of a USB device, wherever it is
            plugged in; the path of a device file, such as one of those in
            ``/dev/serial/by-id`` (``/dev/ttyUSB0`` may be another device tomorrow); or
            a URL of pyserial, such as ``socket://host:2217`` or ``loop://``.
        baudrate: Bits per second.
        framing: What a message is in the stream of bytes: a `Framing`, its name
            (``"lines"``, ``"nmea"``, ``"cobs"``, ``"length-crc"``, ``"raw"``), or a
            table with its ``type`` and its parameters.
        out_limit: How many bytes may wait to be sent; more is refused.
        write_timeout: How long a write may take unless it says otherwise, in s.
        late_limit: How long after it was due an answer may still come, in s; see `ask`.
            An answer that is later still is taken for that to another request: have
            ``timeout`` and this together be more than the slowest device ever takes.
            A line that was lost with an answer owed opens when it has come, or after this.
        bad_limit: After how many damaged messages in a row everybody who listens is
            told that the device is at fault.
        wire: What is opened instead of a port, such as a line in memory.
        echo: Whether what is sent comes back, as on one wire for both directions: that
            is thrown away before it is looked at.
        dtr: Whether DTR is raised while the port is open, as usual. Lowering it keeps
            some boards from starting anew, and starts the motor of some others.
        rts: The same for RTS.
        **options: Further settings of ``serial.Serial``, such as ``parity="E"``.

    Attributes:
        framing: What the bytes are cut into messages with.
        path: What was opened last: the device file, or the URL.
    """

    def __init__(
        self,
        *,
        name: str,
        port: str = "",
        baudrate: int = 115200,
        framing: Framing | str | Mapping[str, Any] = "lines",
        out_limit: int = 4096,
        write_timeout: float = 0.5,
        late_limit: float = LATE_LIMIT,
        bad_limit: int = 100,
        echo: bool = False,
        dtr: bool = True,
        rts: bool = True,
        wire: Wire | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name=name, wire=wire)
        self._levels = {"dtr": dtr, "rts": rts}
        for field, level in {**self._levels, "echo": echo}.items():
            if not isinstance(level, bool):
                raise ConfigError(
                    name, field, f"expected true or false, not {level!r:.80}"
                )
        check_seconds(name, "late_limit", late_limit)
        check_choice(name, "stopbits", options.get("stopbits", 1), (1, 1.5, 2))
        self.port: str = port
        self.baudrate: int = check_whole(name, "baudrate", baudrate, 1)
        self.framing: Framing = make_framing(name, framing)
        # What separates messages of RTU: 3.5 characters, but 1.75 ms at least.
        is_rtu = isinstance(self.framing, ModbusRtu)
        self._silence = max(0.00175, 38.5 / self.baudrate) if is_rtu else 0.0
        self.out_limit: int = check_whole(name, "out_limit", out_limit, 1)
        self.write_timeout: float = check_seconds(name, "write_timeout", write_timeout)
        self.bad_limit: int = check_whole(name, "bad_limit", bad_limit, 1)
        self.path: str = ""
        self._options = options
        if wire is None:
            place = SerialPlace(name, port)
            self._presence = None if place.is_url else place.look
        self._open_device: Port | None = None
        self._line: Line | None = None
        self._arrivals: Arrivals
        self._listen([])
        self._echoes = echo
        self._echo = b""
        """What was sent and has not come back."""
        self._newest_echo = 0
        """How much of that is the newest message."""
        self._bad_in_row = 0
        self._is_cut = False
        """Whether only the beginning of the message before was sent."""
        self._since_safe = 0
        """How many bytes were written since what makes an actuator safe: that is kept."""
        self._exchanges = Exchanges(self, late_limit=late_limit)

    @property
    def resync(self) -> bytes:
        """What ends a message that was cut in half, if the framing has such a thing.

        Without it the other end takes the next message for the rest of the one before.
        """
        framing = self.framing
        return framing.delimiter if isinstance(framing, Lines | Cobs) else b""

    @property
    def outlet(self) -> Outlet | None:
        """A duplicate of its descriptor, where it has one."""
        port = self._open_device
        if port is None or not port.has_descriptor:
            return None
        return Outlet("serial", descriptor=port.fileno())

    @property
    def waiting(self) -> int:
        """How many bytes wait to be sent."""
        return 0 if self._line is None else self._line.link.get_write_buffer_size()

    def alone_at(self) -> str | None:
        """Return its device file, however it is named; its name if it is not there."""
        place = SerialPlace(self.name, self.port) if self._wire is None else None
        if place is None or place.is_url:
            return None
        try:
            return os.path.realpath(place.find())
        except ConnectionError:
            return self.port

    def seconds_for(self, traffic: int) -> float:
        """Return how long so many bytes take, with a start and a stop bit each."""
        return 10 * traffic / self.baudrate

    def frames(self, prefix: bytes = b"", *, limit: int = 64) -> Inbox[bytes]:
        """Listen to the messages that begin with a prefix.

        Args:
            prefix: What they begin with; every message if empty.
            limit: How many are kept until they are taken; then the newest win.

        Raises:
            DeviceLostError: The bus is not open.
        """
        self._connected()
        inbox: Inbox[bytes] = Inbox(limit, self._forget)
        self._listen([*self._inboxes, (prefix, inbox)])
        return inbox

    async def write(self, data: bytes, *, timeout: float | None = None) -> None:
        """Send bytes in one piece and wait until the kernel has taken them.

        Args:
            data: One or several whole messages, as they go over the wire.
            timeout: How long to wait, in seconds; ``write_timeout`` if None.

        Raises:
            DeviceLostError: The line is gone. Nobody knows how much was sent.
            BusyError: Too many bytes wait already; or they gave way to what makes an
                actuator safe, which waits for none. Nothing was sent.
            DriverStuckError: The device took no bytes in time. All bytes that
                waited are thrown away, so that none of them comes late. The same
                happens if the writer is cancelled and nobody else waits.
        """
        seconds = self._seconds(timeout)
        size = self._put(check_bytes(self.name, "data", data))
        if size:
            await self._sent(size, seconds)

    def _seconds(self, timeout: float | None) -> float:
        if timeout is None:
            return self.write_timeout
        return check_duration(self.name, "timeout", timeout)

    def _put(self, data: bytes, request: Exchange | None = None) -> int:
        """Send bytes; returns how many, if the line has not taken all of them at once."""
        line = self._connected()
        link = line.link
        is_safe = urgency.get().level >= SAFE
        if is_safe:
            self._make_way(line)
        if self._is_cut:
            data = self.resync + data
        if link.get_write_buffer_size() + len(data) > self.out_limit:
            self.stats.refused += 1
            raise BusyError(
                f"bus {self.name}", "number of bytes to send", self.out_limit
            )
        self._is_cut = False
        if self._echoes:
            self._echo += data
            self._newest_echo = len(data)
            if len(self._echo) > ECHO_LIMIT:  # there is none
                self._echo = b""
                self.stats.bad_frames += 1
        self._since_safe = 0 if is_safe else self._since_safe + len(data)
        if request is not None:
            request.begin()
        if not line.write(data):
            return len(data)
        self.stats.sent += len(data)
        return 0

    async def send(self, payload: bytes, *, timeout: float | None = None) -> None:
        """Send a message, framed. Args and errors are those of `write`."""
        await self.write(self.framing.encode(payload), timeout=timeout)

    async def ask(
        self,
        payload: bytes,
        *,
        prefix: bytes | tuple[bytes, ...] = b"",
        timeout: float | None = None,
        answers: Callable[[bytes], bool] | None = None,
    ) -> bytes:
        """Send a message and return the next one that answers it.

        Exchanges of several devices on the line never overlap: each waits for its
        turn. What came before the request was sent is no answer to it. An answer that
        comes after its request was given up is nobody's: until it has come, or
        ``late_limit`` is over, a request whose answer has the same prefix waits.

        Args:
            payload: The request, not framed yet.
            prefix: What the answer begins with; one of several if it is a tuple.
            timeout: How long to wait, for the sending and the answer together, in
                seconds; ``write_timeout`` if None. For its turn it waits apart from that.
            answers: Tells whether a message with the prefix is the answer to this
                request and to no other, by a sequence number or an echo of the
                request; then no late one is waited for.

        Raises:
            DeviceLostError: The line is gone.
            DeviceFaultError: Only damaged messages come.
            BusyError: Too many wait for their turn; nothing was sent.
            NoTurnError: Others had the line all the time; nothing was sent.
            DriverStuckError: No answer in time, or the device took no bytes.
        """
        line = self._connected()
        if urgency.get().level >= SAFE:  # first: its turn comes with the end of that
            self._make_way(line)
        seconds = self._seconds(timeout)
        kinds = prefix if isinstance(prefix, tuple) else (prefix,)
        request = self._exchanges.request(*kinds, timeout=seconds, answers=answers)
        request.name = payload
        async with request as exchange:
            if self._silence:  # or it would be taken for the rest of the last answer
                await asyncio.sleep(self._silence)
            size = self._put(self.framing.encode(payload), exchange)
            if size:
                try:
                    await self._sent(size, exchange.left)
                except BusyError:  # it gave way
                    exchange.end()
                    raise
            return await exchange.answer()

    async def _sent(self, size: int, seconds: float) -> None:
        line = self._connected()
        writer = line.wait()
        try:
            await within(writer, seconds)
        except DriverStuckError:  # another writer's time was up: all is thrown away
            raise
        except TimeoutError:
            stuck = self.failed(DriverStuckError(self.name, "write", seconds))
            self._discard(line, stuck)
            port = self._open_device
            if port is not None and (held := port.throw_away(self._since_safe)):
                self.stats.discarded += held
                self._is_cut, self._echo = True, b""
            raise stuck from None
        except asyncio.CancelledError as cancelled:
            if line.waiting == 1:  # nobody's bytes wait behind these
                self._discard(line, cancelled)
            raise
        finally:
            line.forget(writer)
        self.stats.sent += size

    def _discard(self, line: Line, error: BaseException) -> None:
        link = line.link
        waiting = link.get_write_buffer_size()
        self._is_cut = self._is_cut or line.ends_in_a_message()
        line.settle(error)  # first: the link tells who waits then that all is sent
        link.flush()
        gone = waiting - link.get_write_buffer_size()
        self._since_safe -= gone
        self.stats.discarded += gone
        self._echo = self._echo[: max(0, len(self._echo) - gone)]

    def _make_way(self, line: Line) -> None:
        """Throw away what waits before what is safe, unless that is safe, too."""
        waiting = line.link.get_write_buffer_size()
        if not 0 < waiting <= self._since_safe:
            return
        is_cut = line.ends_in_a_message()
        # Without a delimiter what is safe would be taken for the rest of that.
        if self.resync or not is_cut:
            what = "number of bytes that wait before what is safe"
            gone = BusyError(f"bus {self.name}", what, 0)
            stuck = DriverStuckError(self.name, "write", self.write_timeout)
            self._discard(line, stuck if is_cut else gone)

    def _connected(self) -> Line:
        if not self.is_open or self._line is None:
            raise DeviceLostError(self.name, "the line is not open")
        return self._line

    def _forget(self, inbox: Inbox[bytes]) -> None:
        self._listen([entry for entry in self._inboxes if entry[1] is not inbox])

    def _listen(self, inboxes: list[tuple[bytes, Inbox[bytes]]]) -> None:
        self._inboxes = inboxes
        self._prefixes = tuple(prefix for prefix, _ in inboxes)
        self._hears_all = b"" in self._prefixes

    async def _open(self) -> None:
        self.framing.reset()
        self._bad_in_row = 0
        self._echo = b""
        self._arrivals = Arrivals.of(asyncio.get_running_loop())
        line = Line(self._received, self._gone)
        if self._wire is None:
            line.link = await self._open_port(line, self.port)
        else:
            far_end = await self._far_end(self._wire)
            port = functools.partial(self._open_port, line)
            line.link = await far_end.open(line, port)
        self._line = line
        await self._exchanges.silence()

    async def _close(self) -> None:
        line, self._line = self._line, None
        gone = DeviceLostError(self.name, "the line was closed")
        self._fail_all(gone)
        if line is not None:
            self._discard(line, gone)
            line.end()  # first, so that nobody watches the descriptor
        port, self._open_device = self._open_device, None
        if port is not None:
            await close_port(port, self.executor)

    async def _open_port(self, protocol: asyncio.Protocol, path: str) -> SerialLink:
        self.port = path
        place = SerialPlace(self.name, path)
        port = await reach_port(
            self.executor, place, self.baudrate, self._options, self._levels
        )
        self._open_device = port
        self.path = port.path
        if port.advice and self.stats.opened == 0:
            _log.warning("%s: %s", self.name, port.advice)
        return link_of(port, protocol, self.name)

    def _received(self, data: bytes) -> None:
        framing = self.framing
        self.stats.received += len(data)
        if self._echo:
            data = self._without_echo(data)
        bad_before = framing.bad_frames
        messages = framing.feed(data)
        if messages:
            with self._arrivals:
                self._deliver(messages)
        bad = framing.bad_frames - bad_before
        self.stats.bad_frames += bad
        self._bad_in_row = 0 if messages else self._bad_in_row + bad
        if self._bad_in_row >= self.bad_limit:
            fault = DeviceFaultError(
                self.name,
                f"{self._bad_in_row} damaged messages in a row: "
                "check the baud rate, the parity and the framing",
            )
            self._bad_in_row = 0
            self._fail_all(self.failed(fault))

    def _without_echo(self, data: bytes) -> bytes:
        """Return what is not an echo; of one that was damaged, no rest is looked for."""
        size = min(len(data), len(self._echo))
        if data[:size] != self._echo[:size]:
            older = len(self._echo) - self._newest_echo
            self._echo = newest = self._echo[older:] if older > 0 else b""
            self.stats.bad_frames += 1
            for at in range(len(data)) if newest else ():
                if newest.startswith(data[at : at + len(newest)]):
                    return data[:at] + self._without_echo(data[at:])
            return data
        self._echo = self._echo[size:]
        return data[size:]

    def _deliver(self, messages: list[bytes]) -> None:
        exchanges = self._exchanges
        if not self._inboxes:
            heard = sum(map(exchanges.offer, messages))
            self.stats.unheard += len(messages) - heard
            return
        prefixes = self._prefixes
        unheard = len(messages)
        if exchanges.now is not None or exchanges.unanswered:
            for message in messages:
                if exchanges.offer(message) and not message.startswith(prefixes):
                    unheard -= 1
        if not self._hears_all:  # an empty one is nobody's, and costs next to nothing
            messages = [
                each for each in filter(None, messages) if each.startswith(prefixes)
            ]
        for prefix, inbox in self._inboxes:
            dropped = inbox.dropped
            if len(prefixes) > 1:
                inbox.extend([each for each in messages if each.startswith(prefix)])
            else:
                inbox.extend(messages)
            self.stats.dropped += inbox.dropped - dropped
        self.stats.unheard += unheard - len(messages)

    def _fail_all(self, error: BaseException) -> None:
        self._exchanges.fail(error)
        inboxes, self._inboxes = self._inboxes, []
        for _, inbox in inboxes:
            inbox.fail(error)

    def _gone(self, line: Line, error: Exception | None) -> None:
        if line is not self._line:
            return
        loss = self.loss(error or ConnectionError("the other end hung up"))
        self._discard(line, loss)
        line.end()
        self._fail_all(loss)
        self.lost(loss)
