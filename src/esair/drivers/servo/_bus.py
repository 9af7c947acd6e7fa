"""The line of the servos: its packets, their tables, and the turns on one wire."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import contextvars
import enum
import errno
import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from esair.buses import Wire
from esair.buses.serial import SerialBus, SerialLink
from esair.exceptions import DeviceFaultError, NoTurnError
from esair.framing import Framing, LengthCrc
from esair.loading import of_extra
from esair.loop import COMMAND, InLine, now, spawn, urgency

with of_extra("servo"):
    from dynamixel_sdk import (  # type: ignore[import-untyped]
        PacketHandler,
        Protocol2PacketHandler,
    )

PING, READ, WRITE, STATUS = 0x01, 0x02, 0x03, 0x55
SYNC_READ, SYNC_WRITE = 0x82, 0x83

_HEADER: Final = b"\xff\xff\xfd"
_crc: Any = Protocol2PacketHandler().updateCRC


class Packets(LengthCrc):
    """Packets of Dynamixel's protocol 2.0: a payload is id, instruction, parameters.

    A header within them is stuffed; the checksum is that of the maker's package.
    """

    def __init__(self) -> None:
        super().__init__(
            sync=_HEADER + b"\0",
            header=1,
            length_size=2,
            byteorder="little",
            counted=2,
            max_length=1024,
        )

    def feed(self, data: bytes) -> list[bytes]:
        """Take the bytes that arrived; return the payloads that are complete now."""
        return [each.replace(_HEADER + b"\xfd", _HEADER) for each in super().feed(data)]

    def encode(self, payload: bytes) -> bytes:
        """Return the whole packet."""
        return super().encode(payload.replace(_HEADER, _HEADER + b"\xfd"))

    def _told(self, covered: bytes | bytearray) -> bytes:
        whole = self.sync + covered
        return int(_crc(0, whole, len(whole))).to_bytes(2, "little")


FEETECH: Final = LengthCrc(sync="FF FF", header=1, counted=1, crc="sum-8/inverted")
"""Packets of Feetech, which are those of Dynamixel's protocol 1."""


class Entry(NamedTuple):
    """A number in a servo's control table.

    Attributes:
        address: Its first byte.
        size: How many bytes it has.
        has_sign_bit: Whether its highest bit is its sign; else it is a two's complement.
    """

    address: int
    size: int
    has_sign_bit: bool = False

    def pack(self, number: int) -> int:
        """Return a number as the table has it."""
        bits = 8 * self.size
        if not self.has_sign_bit:
            return number & (1 << bits) - 1
        if abs(number) >> (bits - 1):
            raise OverflowError(f"{number} has more than {bits - 1} bits")
        return abs(number) | (number < 0) << (bits - 1)

    def unpack(self, raw: int) -> int:
        """Return the number that the table has."""
        sign = 1 << (8 * self.size - 1)
        if self.has_sign_bit:
            return -(raw & ~sign) if raw & sign else raw
        return raw - 2 * sign if raw & sign else raw


class Snapshot(NamedTuple):
    """What one answer of a servo tells: where it is, and whether it has restarted.

    Attributes:
        has_torque: Whether it holds its goal.
        is_lit: Whether its light is lit, which a restart puts out; True if it has none.
        position: Where it is, in steps.
        speed: How fast it goes to its goal, in units of its table.
    """

    has_torque: bool
    is_lit: bool
    position: int
    speed: int


class Table(NamedTuple):
    """The entries of a servo's control table that are used here.

    Attributes:
        torque: Whether it holds its goal.
        mode: Its mode of operation.
        modes: The values of that for a current, a velocity and a position; None if it
            has no such mode.
        goal: Where it goes.
        position: Where it is.
        velocity: How fast it turns in velocity mode.
        speed: How fast it goes to its goal.
        velocity_unit: The unit of both in rad/s.
        no_limit: The speed that is none.
        current: How hard it pushes in current mode; None if it has no such mode.
        current_unit: The unit of that in A.
        current_units: That of models which have another.
        errors: The bits of why it has shut down.
        look: What is read for a `Snapshot`: its entries, as they are in one block.
        limits: Its least and its greatest goal, in any order; both 0 for none.
        mapped: Where the addresses of the bytes of that block are put; None if they are
            there by themselves.
        light: Its light, which a restart puts out; None if it has none.
        lock: What keeps its mode from being changed; None if nothing does.
        fastest: The greatest velocity that it takes; None if it takes any.
        strongest: The greatest current that it takes; None if it takes any.
        drive: Its drive mode, a bit of which makes a time of the speed; None if it has
            none.
    """

    torque: int
    mode: int
    modes: tuple[int | None, int, int]
    goal: Entry
    position: Entry
    velocity: Entry
    speed: Entry
    velocity_unit: float
    errors: int
    look: Entry
    limits: Entry
    no_limit: int = 0
    current: Entry | None = None
    current_unit: float = 0.0
    current_units: Mapping[int, float] = {}
    mapped: int | None = None
    light: int | None = None
    lock: int | None = None
    fastest: Entry | None = None
    strongest: Entry | None = None
    drive: int | None = None

    @property
    def places(self) -> list[int]:
        """The addresses of the bytes of the block."""
        if self.mapped is None:
            return [*range(self.look.address, self.look.address + self.look.size)]
        assert self.light is not None
        entries = (
            Entry(self.torque, 1),
            Entry(self.light, 1),
            self.position,
            self.speed,
        )
        return [each.address + n for each in entries for n in range(each.size)]

    def snapshot(self, block: int) -> Snapshot:
        """Return what a block tells."""
        places = self.places
        data = block.to_bytes(self.look.size, "little")

        def number(entry: Entry) -> int:
            at = places.index(entry.address)
            raw = int.from_bytes(data[at : at + entry.size], "little")
            return entry.unpack(raw)

        return Snapshot(
            has_torque=bool(number(Entry(self.torque, 1))),
            is_lit=self.light is None or bool(number(Entry(self.light, 1))),
            position=number(self.position),
            speed=number(self.speed),
        )


X330: Final = dict.fromkeys((1190, 1200, 1210, 1220, 1230, 1240), Entry(208, 10))
"""What is read for a `Snapshot` of XL330 and XC330, whose table is shorter; by model."""

DYNAMIXEL_X: Final = Table(
    torque=64,
    mode=11,
    modes=(0, 1, 3),
    goal=Entry(116, 4),
    position=Entry(132, 4),
    velocity=Entry(104, 4),
    speed=Entry(112, 4),
    velocity_unit=0.229 * math.tau / 60,
    errors=70,
    look=Entry(224, 10),
    current=Entry(102, 2),
    current_unit=0.00269,
    current_units={**dict.fromkeys(X330, 0.001), 1040: 0.00134, 1050: 0.00134},
    limits=Entry(48, 8),
    mapped=168,
    light=65,
    fastest=Entry(44, 4),
    strongest=Entry(38, 2),
    drive=10,
)
"""The X series of ROBOTIS: the control table of the XL430-W250."""

FEETECH_STS: Final = Table(
    torque=40,
    mode=33,
    modes=(None, 1, 0),
    goal=Entry(42, 2, has_sign_bit=True),
    position=Entry(56, 2, has_sign_bit=True),
    velocity=Entry(46, 2, has_sign_bit=True),
    speed=Entry(46, 2, has_sign_bit=True),
    velocity_unit=math.tau / 4096,
    errors=65,
    look=Entry(40, 18),
    limits=Entry(9, 4),
    lock=55,
)
"""The STS and SMS series of Feetech: the memory table of the STS3215."""

FEETECH_HLS: Final = FEETECH_STS._replace(
    modes=(2, 1, 0),
    velocity_unit=0.732 * math.tau / 60,
    no_limit=0x7FFF,
    current=Entry(44, 2, has_sign_bit=True),
    current_unit=0.0065,
)
"""The HLS series of Feetech, which has a current mode; a speed of 0 stops it."""


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


Asked = tuple[int, int, InLine[int]]
Batch = list[Asked]
"""Which servo, what it is told, and who waits."""

HARDWARE_ERROR = 70

ANSWER_TIMEOUT: Final = 0.05
"""How long a servo may take for a whole answer, in seconds."""

PING_TIMEOUT: Final = 0.03
"""How long it may take for one that it is opened with: without power it is asked so again
and again, and the others wait for as long."""

LATE_LIMIT: Final = 0.1
"""How long after it was given up an answer may still come, in seconds."""

ALL: Final = 0xFE
"""The id of a request to several."""

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


_words = PacketHandler(2.0).getRxPacketError


class ServoBus(SerialBus):
    """The line that servos share.

    Requests of several servos for the same entry that are there at the same time are one
    on the wire (sync read, sync write): the wire is turned once for all of them, which
    takes most of the time. A sync write has no answer, so what servos are told goes
    before what they are asked.

    Args:
        name: The name of the bus.
        port: Where the port is, as of a `SerialBus`.
        baudrate: Bits per second; servos come set to 57600.
        timeout: How long one request may wait for its turn, in seconds.
        wire: What is opened instead of a port, such as a fake.
        **settings: Those of a `SerialBus`, such as ``echo``.
    """

    table = DYNAMIXEL_X
    _framing: Framing = Packets()
    _status = bytes([STATUS])
    """What stands between its id and its error in an answer."""
    _word = 2
    """How many bytes an address and a size have."""
    _in_turn = True
    """Whether one answers a request to several after the one before it has."""

    def __init__(
        self,
        *,
        name: str,
        port: str = "",
        baudrate: int = 57600,
        timeout: float = 0.5,
        wire: Wire | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(
            name=name,
            port=port,
            baudrate=baudrate,
            framing=self._framing,
            write_timeout=timeout,
            late_limit=LATE_LIMIT,
            wire=wire,
            **settings,
        )
        self._batches: dict[bool, dict[Key, Batch]] = {}
        """What is gathered, apart for what is urgent: that waits for no other."""
        self._snapshots: dict[int, tuple[float, Snapshot]] = {}
        self._looks: dict[int, Entry] = collections.defaultdict(lambda: self.table.look)
        """What is read of each servo for a `Snapshot`."""

    def packet(self, servo: int, address: int, value: int, size: int = 1) -> bytes:
        """Return the packet that writes one entry and wants no answer: a sync write."""
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        head = bytes([ALL, SYNC_WRITE]) + self._at(address, size)
        return self.framing.encode(head + bytes([servo]) + data)

    async def ping(self, servo: int) -> int:
        """Return the model number of a servo.

        Raises:
            DeviceFaultError: It does not answer, or its answer is damaged.
            DeviceLostError: The line is gone.
            DriverStuckError: It took too long.
        """
        told = await self._request(servo, "ping", bytes([PING]))
        model = int.from_bytes(told[:2], "little")
        self._looks[servo] = X330.get(model, self.table.look)
        return model

    async def read(self, servo: int, address: int, size: int) -> int:
        """Return an entry of a servo's control table of 1, 2 or 4 bytes.

        Errors are those of `ping`; a servo that has shut down is a fault, too.
        """
        return await self._ask(Kind.READ, servo, address, size)

    async def write(  # type: ignore[override]  # an entry, as `read`
        self, servo: int, address: int, size: int, value: int
    ) -> None:
        """Change an entry of a servo's control table; args and errors as for `read`."""
        await self._ask(Kind.WRITE, servo, address, size, value)

    async def tell(self, servo: int, address: int, size: int, value: int) -> None:
        """Change an entry without an answer, for which the wire would be turned.

        Raises:
            DeviceLostError: The line is gone.
            DriverStuckError: It took too long.
        """
        await self._ask(Kind.TELL, servo, address, size, value)

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
        look = self._looks[servo]
        return self.table.snapshot(await self.read(servo, look.address, look.size))

    def _at(self, *numbers: int) -> bytes:
        """Return an address, and a size, as a request says them."""
        return b"".join(each.to_bytes(self._word, "little") for each in numbers)

    async def _ask(
        self, kind: Kind, servo: int, address: int, size: int, value: int = 0
    ) -> int:
        """Make a request, with those for the entry that are there in the same moment.

        One that is cancelled before its turn is not sent.
        """
        loop = asyncio.get_running_loop()
        value &= (1 << 8 * size) - 1
        future: InLine[int] = InLine(loop=loop)
        urgent = urgency.get().level > COMMAND
        is_first = urgent not in self._batches
        batches = self._batches.setdefault(urgent, {})
        batches.setdefault((kind, address, size), []).append((servo, value, future))
        if is_first:
            context = contextvars.copy_context() if urgent else None
            gathering = self._gather(urgent)
            spawn(loop, gathering, name="servos together", context=context)
        return await future

    async def _gather(self, urgent: bool) -> None:
        try:
            while batches := self._batches[urgent]:
                asked, quiet = -1, 0
                while quiet < QUIET:
                    before, asked = asked, sum(map(len, batches.values()))
                    quiet = quiet + 1 if asked == before else 0
                    await asyncio.sleep(0)
                self._batches[urgent] = {}
                # What they are told first: only what they are asked waits for them.
                for key in sorted(batches, key=lambda key: key[0]):
                    if key[0] is not Kind.TELL and len(batches[key]) == 1:
                        self._make_alone(key, batches[key][0])
                    else:
                        await self._make_batch(key, batches[key])
        finally:
            del self._batches[urgent]

    def _owes(self, servo: int) -> bool:
        """Tell whether a servo has not answered: it may still do so."""
        request = self._exchanges.request(servo, timeout=0.0)
        return self._exchanges.is_owed_to(request)

    def _make_alone(self, key: Key, each: Asked) -> None:
        """Make a request of a servo that others do not wait for: it may not answer."""
        loop, context = asyncio.get_running_loop(), contextvars.copy_context()
        making = self._make_batch(key, [each])
        spawn(loop, making, name=f"servo {each[0]} alone", context=context)

    async def _make_batch(self, key: Key, batch: Batch) -> None:
        """Make requests of one or of several servos for one entry."""
        live = [each for each in batch if not each[2].done()]
        if not live:
            return
        asked = {servo: value for servo, value, _ in live}  # the newest wins
        if key[0] is Kind.WRITE:
            for servo in asked:
                self._snapshots.pop(servo, None)
        made: Made
        try:
            made = await self._made(key, asked, live)
        except Exception as error:
            if any(future.done() for *_, future in live):  # it is made without those
                await self._make_batch(key, live)
                return
            made = dict.fromkeys(asked, error)
        for servo, found in made.items():
            if key == (Kind.READ, *self._looks[servo][:2]) and isinstance(found, int):
                self._snapshots[servo] = now(), self.table.snapshot(found)
        for each in live:
            servo, _, future = each
            result = made.get(servo)
            if result is None:
                self._make_alone(key, each)  # then it tells why
            elif future.done():
                continue
            elif isinstance(result, BaseException):
                future.set_exception(result)
            else:
                future.set_result(result)

    async def _made(self, key: Key, asked: Mapping[int, int], live: Batch) -> Made:
        kind, address, size = key
        if kind is Kind.READ:
            if len(asked) > 1:
                return await self._read_all(key, tuple(asked), live)
            return {each: await self._read(each, *key[1:], *live) for each in asked}
        told = {servo: value.to_bytes(size, "little") for servo, value in asked.items()}
        if kind is Kind.WRITE and len(told) == 1:
            for servo, data in told.items():
                request = bytes([WRITE]) + self._at(address) + data
                await self._request(servo, f"write {address}", request, *live)
        else:
            request = bytes([SYNC_WRITE]) + self._at(address, size)
            request += b"".join(bytes([servo]) + data for servo, data in told.items())
            what = f"write {address} of {len(told)} servos"
            servos = tuple(told)
            await self._exchanged(servos, what, request, *live, to=ALL, answers=False)
        return dict.fromkeys(asked, 0)

    async def _read(self, servo: int, address: int, size: int, *live: Asked) -> int:
        request = bytes([READ]) + self._at(address, size)
        told = await self._request(servo, f"read {address}", request, *live)
        if len(told) != size:
            text = f"servo {servo}, read {address}: it has told {len(told)} bytes"
            raise self.failed(DeviceFaultError(self.name, f"{text} instead of {size}"))
        return int.from_bytes(told, "little")

    async def _read_all(self, key: Key, servos: tuple[int, ...], live: Batch) -> Made:
        _, address, size = key
        request = bytes([SYNC_READ]) + self._at(address, size)
        what = f"read {address} of {len(servos)} servos"
        told = await self._exchanged(servos, what, request, *live, to=ALL)
        return {
            servo: int.from_bytes(data, "little")
            for servo, (error, data) in told.items()
            if not error and len(data) == size
        }

    async def _request(
        self, servo: int, what: str, request: bytes, *live: Asked
    ) -> bytes:
        """Ask one servo, and return what it says unless that is an error."""
        bad = self.framing.bad_frames
        told = await self._exchanged((servo,), what, request, *live, to=servo)
        if servo not in told:
            is_damaged = self.framing.bad_frames > bad
            why = "Incorrect" if is_damaged else "There is no"
            text = f"servo {servo}, {what}: {why} status packet"
            fault = DeviceFaultError(self.name, text)
            if not is_damaged:
                fault.errno = errno.ETIMEDOUT  # it has no power, say
            raise self.failed(fault)
        error, data = told[servo]
        if error & ALERT and what != f"read {self.table.errors}":
            bits = await self._read(servo, self.table.errors, 1)
            raise DeviceFaultError(
                self.name,
                f"servo {servo} has shut down: {hardware_errors(bits)}; "
                "take its power away for a moment",
            )
        if faults := self._faults(error):
            raise DeviceFaultError(self.name, f"servo {servo}, {what}: {faults}")
        return data

    def _faults(self, error: int) -> str:
        """Return what an answer says about the servo, beside that it has shut down."""
        text = str(_words(error & ~ALERT)) if error & ~ALERT else ""
        return text.rpartition("] ")[2]

    async def _exchanged(
        self,
        servos: tuple[int, ...],
        what: str,
        request: bytes,
        *live: Asked,
        to: int,
        answers: bool = True,
    ) -> dict[int, tuple[int, bytes]]:
        """Make an exchange with servos in its turn; return the error and data of each."""
        self._connected()
        told: dict[int, tuple[int, bytes]] = {}
        begin = 1 + len(self._status)
        # Who has not answered is not asked before its answer cannot come any more.
        asked = (ALL,) if to == ALL else servos
        exchange = self._exchanges.request(*asked, timeout=self.write_timeout)
        exchange.name = what
        async with exchange:
            if any(future.done() for *_, future in live):  # given up in the line
                raise NoTurnError(self.name, what, 0.0)
            for *_, future in live:
                future.begun = now()
            if to == ALL and answers:  # some may owe one since they were gathered
                servos = tuple(each for each in servos if not self._owes(each))
                request += bytes(servos)
                answers = bool(servos)
            with self.frames() as inbox:
                self.framing.reset()  # what has come before is no answer
                size = self._put(self.framing.encode(bytes([to]) + request), exchange)
                if size:
                    await self._sent(size, ANSWER_TIMEOUT)
                seconds = PING_TIMEOUT if request[0] == PING else ANSWER_TIMEOUT
                until = now() + seconds + self.seconds_for(24 * len(servos))
                while answers and len(told) < len(servos) and now() < until:
                    try:
                        message = await inbox.take(timeout=until - now())
                    except TimeoutError:
                        break
                    servo, status = message[0], message[1:].startswith(self._status)
                    if servo in servos and status and len(message) > begin:
                        told[servo] = message[begin], message[begin + 1 :]
            if not answers or len(told) == len(servos):
                exchange.end()
            silent = [servo for servo in servos if servo not in told]
            exchange.owe(*(silent[:1] if self._in_turn else silent))
        return told

    async def _open(self) -> None:
        self._snapshots.clear()
        await super()._open()

    async def _open_port(self, protocol: asyncio.Protocol, path: str) -> SerialLink:
        link = await super()._open_port(protocol, path)
        # An adapter of FTDI keeps for 16 ms what came; others have nothing like that.
        with contextlib.suppress(OSError, ValueError, AttributeError):
            assert self._open_device is not None
            self._open_device.device.set_low_latency_mode(True)
        return link
