"""The line of the servos: master and servos take turns on one wire."""

from __future__ import annotations

import asyncio
import enum
import errno
import functools
import math
import os
from collections.abc import Awaitable, Callable, Hashable, Mapping
from typing import Any, Final

from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, PacketHandler  # type: ignore[import-untyped]

from esair.buses import Exchanges, LinkBus
from esair.buses.serial import SerialPlace, open_port
from esair.drivers.servo._line import ANSWER_TIMEOUT, PortLink, SdkPort, ServoLink
from esair.drivers.servo._tables import DYNAMIXEL_X, Snapshot
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    describe,
)
from esair.loop import now, spawn
from esair.values import check_whole
from esair.watchdog import Outlet

QUIET = 3
"""For how many turns of the loop nothing is asked before what was asked leaves."""

Made = Mapping[int, "int | BaseException"]


class Kind(enum.IntEnum):
    """What a request does with an entry, in the order in which they leave."""

    TELL = 0
    """Change it; nobody answers, so nobody waits."""
    WRITE = 1
    READ = 2


Key = tuple[Kind, int, int]
"""What requests have in common that are made together: its kind, address and size."""


class Together:
    """Gathers requests for the same entry of several servos until their turn.

    What servos are told goes before what they are asked: only that has to wait for them.
    """

    def __init__(
        self, make: Callable[[Key, Mapping[int, int]], Awaitable[Made]]
    ) -> None:
        self._make = make
        self._batches: dict[Key, list[tuple[int, int, asyncio.Future[int]]]] = {}
        self._is_running = False

    async def ask(
        self, kind: Kind, servo: int, address: int, size: int, value: int = 0
    ) -> int:
        """Make a request; one that is cancelled before its turn is not sent."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[int] = loop.create_future()
        batch = self._batches.setdefault((kind, address, size), [])
        batch.append((servo, value, future))
        if not self._is_running:
            self._is_running = True
            spawn(loop, self._run(), name="servos together")
        return await future

    async def _run(self) -> None:
        try:
            while self._batches:
                await self._settled()
                batches, self._batches = self._batches, {}
                for key in sorted(batches, key=lambda key: key[0]):
                    await self._run_batch(key, batches[key])
        finally:
            self._is_running = False

    async def _settled(self) -> None:
        """Wait for what is asked in the same moment, which takes some turns of the loop."""
        asked, quiet = -1, 0
        while quiet < QUIET:
            now = sum(map(len, self._batches.values()))
            quiet = quiet + 1 if now == asked else 0
            asked = now
            await asyncio.sleep(0)

    async def _run_batch(
        self, key: Key, batch: list[tuple[int, int, asyncio.Future[int]]]
    ) -> None:
        live = [each for each in batch if not each[2].done()]
        if not live:
            return
        made: Made
        asked = {servo: value for servo, value, _ in live}  # the newest wins
        try:
            made = await self._make(key, asked)
        except Exception as error:
            made = dict.fromkeys(asked, error)
        for servo, _, future in live:
            result = made[servo]
            if future.done():
                continue
            if isinstance(result, BaseException):
                future.set_exception(result)
            else:
                future.set_result(result)


Told = tuple[int, int, int]
"""What an exchange brings: a value, how it went, and what the servo says is wrong."""

HARDWARE_ERROR = 70

LATE_LIMIT: Final = 0.1
"""How long after it was given up an answer may still come, in seconds."""

ALERT: Final = 0x80
"""The bit of an answer that says: look at ``HARDWARE_ERROR``."""

_HARDWARE_ERRORS = {
    0x01: "input voltage",
    0x04: "overheating",
    0x08: "motor encoder",
    0x10: "electrical shock",
    0x20: "overload",
}


def hardware_errors(bits: int) -> str:
    """Name the bits of ``HARDWARE_ERROR``."""
    named = [text for bit, text in _HARDWARE_ERRORS.items() if bits & bit]
    return ", ".join(named) or f"code {bits:#04x}"


class ServoBus(LinkBus[SdkPort]):
    """The line that servos share.

    Requests of several servos for the same entry that are there at the same time are one
    on the wire (sync read, sync write): the wire is turned once for all of them, which
    takes most of the time. A sync write has no answer, so what servos are told goes
    before what they are asked.

    In ``bus.stats`` what is sent and received is counted in packets.

    Args:
        name: The name of the bus.
        port: A device file, or ``usb:VID:PID[:SERIAL]``.
        baudrate: Bits per second; servos come set to 57600.
        timeout: How long one request may take, its turn included, in seconds.
        opener: Opens something else than a port, such as a fake; may block.
    """

    path: str

    table = DYNAMIXEL_X
    _rx_timeout = COMM_RX_TIMEOUT
    _rx_corrupt = COMM_RX_CORRUPT

    def __init__(
        self,
        *,
        name: str,
        port: str = "",
        baudrate: int = 57600,
        timeout: float = 0.5,
        opener: Callable[[], ServoLink] | None = None,
    ) -> None:
        super().__init__(name=name, timeout=timeout)
        self.port = port
        self.baudrate: int = check_whole(name, "baudrate", baudrate, 1)
        self._opener = opener
        self._exchanges = Exchanges(self, late_limit=LATE_LIMIT)
        self._together = Together(self._make_requests)
        self._snapshots: dict[int, tuple[float, Snapshot]] = {}
        self._handler: Any = self._make_handler()
        self._under_way = ""
        """What the exchange is that has its turn."""
        if opener is not None:
            self._presence = self._still_there = None
            return
        self._place = SerialPlace(name, port)
        if self._place.is_url:
            raise ConfigError(
                name, "port", f"expected a device file or usb:..., not {port!r:.80}"
            )

    def _make_handler(self) -> Any:
        """Return what makes and reads packets."""
        return PacketHandler(2.0)

    def _sync_read(
        self, handler: Any, link: SdkPort, address: int, size: int, servos: list[int]
    ) -> int:
        """Ask servos for an entry; returns the code of how that went."""
        code: int = handler.syncReadTx(link, address, size, servos, len(servos), False)
        return code

    def _faults(self, error: int) -> str:
        """Return what an answer says about the servo, beside that it has shut down."""
        text = str(self._handler.getRxPacketError(error & ~ALERT))
        return text.rpartition("] ")[2] if error & ~ALERT else ""

    @property
    def outlet(self) -> Outlet | None:
        """A duplicate of the descriptor of its port."""
        line = None if self._link is None else self._link.line
        if not isinstance(line, PortLink):
            return None
        return Outlet("serial", descriptor=line.fileno())

    def packet(self, servo: int, address: int, value: int, size: int = 1) -> bytes:
        """Return the packet that writes one entry and wants no answer."""
        written: list[bytes] = []

        class Captured:
            is_using = False

            def writePort(self, packet: list[int]) -> int:  # noqa: N802 - the SDK's
                written.append(bytes(packet))
                return len(packet)

            def clearPort(self) -> None:  # noqa: N802
                """There is nothing in it."""

        data = list((value & (1 << 8 * size) - 1).to_bytes(size, "little"))
        self._handler.writeTxOnly(Captured(), servo, address, size, data)
        return b"".join(written)

    async def ping(self, servo: int) -> int:
        """Return the model number of a servo.

        Raises:
            DeviceFaultError: It does not answer, or its answer is damaged.
            DeviceLostError: The line is gone.
            DriverStuckError: It took too long.
        """

        def call(handler: Any, link: SdkPort) -> Told:
            return handler.ping(link, servo)  # type: ignore[no-any-return]

        return await self._request(servo, "ping", call)

    async def read(self, servo: int, address: int, size: int) -> int:
        """Return an entry of a servo's control table of 1, 2 or 4 bytes.

        Errors are those of `ping`; a servo that has shut down is a fault, too.
        """
        return await self._together.ask(Kind.READ, servo, address, size)

    async def write(self, servo: int, address: int, size: int, value: int) -> None:
        """Change an entry of a servo's control table; args and errors as for `read`."""
        raw = value & (1 << 8 * size) - 1
        await self._together.ask(Kind.WRITE, servo, address, size, raw)

    async def tell(self, servo: int, address: int, size: int, value: int) -> None:
        """Change an entry without an answer, for which the wire would be turned.

        Raises:
            DeviceLostError: The line is gone.
            DriverStuckError: It took too long.
        """
        raw = value & (1 << 8 * size) - 1
        await self._together.ask(Kind.TELL, servo, address, size, raw)

    async def set_up(self, servo: int) -> None:
        """Have a servo tell its `Snapshot` in one block; errors as for `read`."""
        table = self.table
        if table.mapped is not None:
            addresses = b"".join(each.to_bytes(2, "little") for each in table.places)
            value = int.from_bytes(addresses, "little")
            await self.write(servo, table.mapped, len(addresses), value)
        if table.light is not None:
            await self.write(servo, table.light, 1, 1)

    async def snapshot(self, servo: int, *, max_age: float = 0.0) -> Snapshot:
        """Return where a servo is, and what shows whether it has restarted.

        Args:
            servo: Which one; it was set up by `set_up`.
            max_age: How old an answer may be that was there already, in seconds.
        """
        time, known = self._snapshots.get(servo, (-math.inf, None))
        if known is not None and now() - time < max_age:
            return known
        look = self.table.look
        return self.table.snapshot(await self.read(servo, look.address, look.size))

    async def _make_requests(self, key: Key, asked: Mapping[int, int]) -> Made:
        """Make requests of one or of several servos for one entry."""
        if key[0] is Kind.WRITE:
            for servo in asked:
                self._snapshots.pop(servo, None)
        made = await self._made(key, asked)
        if key == (Kind.READ, *self.table.look[:2]):
            for servo, block in made.items():
                if isinstance(block, int):
                    self._snapshots[servo] = now(), self.table.snapshot(block)
        return made

    async def _made(self, key: Key, asked: Mapping[int, int]) -> Made:
        kind, address, size = key
        if kind is Kind.TELL or (kind is Kind.WRITE and len(asked) > 1):
            return await self._write_all(address, size, asked)
        if len(asked) > 1:
            return await self._read_all(address, size, tuple(asked))
        ((servo, value),) = asked.items()
        told = value if kind is Kind.WRITE else None
        try:
            return {servo: await self._make_one(servo, address, size, told)}
        except EsairError as error:
            return {servo: error}

    async def _make_one(
        self, servo: int, address: int, size: int, value: int | None
    ) -> int:
        def call(handler: Any, link: SdkPort) -> Told:
            if value is None:
                data, result, error = handler.readTxRx(link, servo, address, size)
            else:
                data = list(value.to_bytes(size, "little"))
                result, error = handler.writeTxRx(link, servo, address, size, data)
            return int.from_bytes(bytes(data), "little"), result, error

        verb = "read" if value is None else "write"
        return await self._request(servo, f"{verb} {address}", call)

    async def _read_all(self, address: int, size: int, servos: tuple[int, ...]) -> Made:
        def call(handler: Any, link: SdkPort) -> list[Told]:
            result = self._sync_read(handler, link, address, size, list(servos))
            told = []
            for servo in servos:
                data, error = [], 0
                if not result:
                    data, result, error = handler.readRx(link, servo, size)
                told.append((int.from_bytes(bytes(data), "little"), result, error))
            link.is_using = False
            return told

        what = f"read {address} of {len(servos)} servos"
        told = await self._exchanged(servos, what, call)
        found: dict[int, int | BaseException] = {}
        for servo, (value, result, error) in zip(servos, told, strict=True):
            if result or error:  # asked again alone: it tells why, and for the others
                try:
                    found[servo] = await self._make_one(servo, address, size, None)
                except EsairError as alone:
                    found[servo] = alone
            else:
                self.stats.received += 1
                found[servo] = value
        return found

    async def _write_all(
        self, address: int, size: int, asked: Mapping[int, int]
    ) -> Made:
        data: list[int] = []
        for servo, value in asked.items():
            data += [servo, *value.to_bytes(size, "little")]

        def call(handler: Any, link: SdkPort) -> list[Told]:
            sent = handler.syncWriteTxOnly(link, address, size, data, len(data))
            return [(0, sent, 0)]

        what = f"write {address} of {len(asked)} servos"
        await self._exchanged(tuple(asked), what, call)
        return dict.fromkeys(asked, 0)

    async def _exchanged(
        self,
        servos: tuple[int, ...],
        what: str,
        call: Callable[[Any, SdkPort], list[Told]],
    ) -> list[Told]:
        """Make an exchange with servos in its turn, and return what each has told."""
        self._connected()
        # The package tells answers apart by the servo, and throws away what came before.
        exchange = self._exchanges.request(*servos, timeout=self.timeout)
        exchange.name = what
        async with exchange:
            exchange.begin()
            self._under_way = what
            self.stats.sent += 1
            transfer = functools.partial(self._run, call)
            told = await self._turn(transfer, None, exchange.left)
            if all(result != self._rx_timeout for _, result, _ in told):
                exchange.end()
        return told

    async def _request(
        self,
        servo: int,
        what: str,
        call: Callable[[Any, SdkPort], Told],
    ) -> int:
        ((value, result, error),) = await self._exchanged(
            (servo,), what, lambda handler, link: [call(handler, link)]
        )
        if result:
            self.stats.bad_frames += result == self._rx_corrupt
            fault = DeviceFaultError(
                self.name, f"servo {servo}, {what}: {_plain(self._handler, result)}"
            )
            if result == self._rx_timeout:
                fault.errno = errno.ETIMEDOUT  # it has no power, say
            raise self.failed(fault)
        self.stats.received += 1
        if error & ALERT and what != f"read {self.table.errors}":
            bits = await self._make_one(servo, self.table.errors, 1, None)
            raise DeviceFaultError(
                self.name,
                f"servo {servo} has shut down: {hardware_errors(bits)}; "
                "take its power away for a moment",
            )
        if faults := self._faults(error):
            raise DeviceFaultError(self.name, f"servo {servo}, {what}: {faults}")
        return value

    def _run(
        self, call: Callable[[Any, SdkPort], list[Told]], link: SdkPort
    ) -> list[Told]:
        link.is_using = False  # what a call that has failed half-way has left
        return call(self._handler, link)

    def _explained(
        self, error: OSError, address: int | None, seconds: float
    ) -> EsairError:
        if isinstance(error, TimeoutError):  # the line takes no bytes
            return self._stuck_with(address, ANSWER_TIMEOUT)
        return DeviceLostError(self.name, describe(error))

    def _stuck_with(self, address: int | None, seconds: float) -> DriverStuckError:
        return DriverStuckError(self.name, self._under_way, seconds)

    def lost(self, error: BaseException) -> None:
        """Tell everybody on the bus, once, that it is gone."""
        self._exchanges.fail(error)
        super().lost(error)

    async def _open(self) -> None:
        self._snapshots.clear()
        await super()._open()
        await self._exchanges.silence()

    async def _close(self) -> None:
        self._exchanges.fail(DeviceLostError(self.name, "the line was closed"))
        await super()._close()

    def _open_link(self) -> SdkPort:
        line: ServoLink
        if self._opener is not None:
            line = self._opener()
        else:
            port = open_port(self._place, self.baudrate, {}, {})
            self.path, line = port.path, PortLink(port)
        return SdkPort(line, self.baudrate)

    def _look(self) -> Hashable | None:
        return self._place.look()

    def _identity(self) -> Hashable | None:
        if self._opener is not None:
            return None
        try:
            found = os.stat(self._place.find())
        except OSError:
            return None
        return found.st_rdev, found.st_ino


def _plain(handler: Any, result: int) -> str:
    return str(handler.getTxRxResult(result)).rpartition("] ")[2] or f"error {result}"
