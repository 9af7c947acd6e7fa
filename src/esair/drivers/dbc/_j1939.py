"""J1939: who sends a message is in its id, and so is how urgent it is.

Source: SAE J1939-21. An id is 3 bits of priority, 18 of the parameter group (in which a
format below 240 leaves 8 bits for who shall get it) and 8 of who sends it.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal

import attrs

from esair.buses import CanBus, Exchanges, Frame, Inbox
from esair.buses.can import Ids, Mask
from esair.drivers._on_bus import SharedTask, shared
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError, EsairError
from esair.loop import spawn

if TYPE_CHECKING:
    from cantools.database.can import Message

PRIORITY: Final = 7 << 26
SPECIFIC: Final = 0xFF << 8
SOURCE: Final = 0xFF
BROADCAST_FORMATS: Final = 240

Source = int | Literal["any"] | None


def is_j1939(message: Message) -> bool:
    """Whether the file says that a message is one of J1939."""
    return bool(message.protocol == "j1939")


def absences(message: Message) -> dict[str, Callable[[Mapping[str, Any]], bool]]:
    """Return what tells which signals of a message say "error" or "not available".

    Those are the two greatest numbers of a signal, by its highest byte if it has several
    (SAE J1939-71), if the file does not allow them, nor names them.
    """
    told: dict[str, Callable[[Mapping[str, Any]], bool]] = {}
    for signal in message.signals if is_j1939(message) else ():
        least = (1 << signal.length) - (2 << max(0, signal.length - 8))
        edge: Any = signal.conversion.raw_to_scaled(least, decode_choices=False)
        if (
            not (signal.is_signed or signal.is_float or signal.choices)
            and signal.scale > 0
            and signal.maximum is not None
            and signal.maximum < edge
        ):
            between = float(edge) - signal.scale / 2  # it and the number below
            told[signal.name] = partial(_is_beyond, signal.name, between)
    return told


def _is_beyond(name: str, edge: float, values: Mapping[str, Any]) -> bool:
    return name in values and values[name] > edge


def not_available(message: Message) -> dict[str, Any]:
    """Return the signals of a message in J1939 of which its sender says nothing.

    All their bits are ones (SAE J1939-71), unless the file has an initial value.
    """
    return {
        signal.name: signal.conversion.raw_to_scaled(
            -1 if signal.is_signed else (1 << signal.length) - 1, decode_choices=False
        )
        for signal in (message.signals if is_j1939(message) else ())
        if signal.raw_initial is None and not (signal.is_multiplexer or signal.is_float)
    }


def ids_from(component: str, message: Message, source: Source) -> Ids:
    """Return the ids that a message of J1939 comes with: from any node, or from one."""
    if source is None and not is_j1939(message):
        return int(message.frame_id)
    counts = 0x1FFF_FFFF & ~PRIORITY & ~SOURCE
    if is_to_one(message.frame_id):
        counts &= ~SPECIFIC  # whoever it is for
    if source is None or source == "any":
        _check_extended(component, "source", message)
        return Mask(message.frame_id & counts, counts)
    number = _with(component, "source", message, source, SOURCE)
    return Mask(number & (counts | SOURCE), counts | SOURCE)


def id_to(
    component: str, message: Message, source: int | None, destination: int | None
) -> int:
    """Return the id to send a message with; that of the file as far as not given."""
    number = int(message.frame_id)
    if source is not None:
        number = _with(component, "source", message, source, SOURCE)
    if destination is not None:
        if not is_to_one(message.frame_id):
            raise ConfigError(
                component, "destination", f"{message.name} is for all nodes"
            )
        with_it = _with(component, "destination", message, destination, SPECIFIC)
        number = number & ~SPECIFIC | with_it & SPECIFIC
    return number


def _with(component: str, field: str, message: Message, address: Any, bits: int) -> int:
    _check_extended(component, field, message)
    if type(address) is not int or not 0 <= address <= 0xFF:
        raise ConfigError(
            component, field, f"expected an address 0 to 255, not {address!r:.80}"
        )
    lowest = bits & -bits
    return int(message.frame_id) & ~bits | address * lowest


def _check_extended(component: str, field: str, message: Message) -> None:
    if not message.is_extended_frame:
        raise ConfigError(
            component, field, f"{message.name} has an id of 11 bits: it is not J1939"
        )


ANNOUNCE: Final = 0xEC
PACKETS: Final = 0xEB
"""The formats of the frames that announce a message, and that carry it."""

TRANSPORT: Final = Mask(0x00E8_0000, 0x03F8_0000)
"""The ids of both, and of some that are left alone."""

RTS, CTS, DONE, BAM, ABORT = 16, 17, 19, 32, 255

MOST: Final = 1785
"""The bytes of the longest message: 255 packets."""

GAP: Final = 0.75
"""After how many seconds without a packet a message is given up."""

MESSAGES: Final = 64
"""How many messages may be under way at once; then the oldest is given up."""


@attrs.define
class _Begun:
    group: int
    size: int
    heard: float
    data: bytearray = attrs.field(factory=bytearray)
    packets: int = 0


class Reassembly:
    """Puts the packets of one kind of message together. No I/O."""

    def __init__(self, frame_id: int) -> None:
        self._group = group_of(frame_id)
        self._begun: dict[tuple[int, int], _Begun] = {}

    def feed(self, frame: Frame) -> Frame | None:
        """Take a frame; return the message that it completes, as if it were one frame."""
        place, data = frame.id >> 16 & 0xFF, frame.data
        ends = frame.id & SOURCE, frame.id >> 8 & 0xFF
        if len(data) != 8:
            return None
        if place == ANNOUNCE:
            self._announced(ends, data, frame.time)
            return None
        begun = self._begun.get(ends)
        if place != PACKETS or begun is None:
            return None
        is_next = 0 < data[0] <= begun.packets + 1  # or once more
        if frame.time - begun.heard > GAP or not is_next:
            del self._begun[ends]  # a packet is missing, late, or none
            return None
        begun.heard = frame.time
        begun.packets = data[0]
        begun.data[7 * (data[0] - 1) :] = data[1:]  # or once more, asked for again
        if len(begun.data) < begun.size:
            return None
        del self._begun[ends]
        number = 6 << 26 | begun.group << 8 | ends[0]
        return frame._replace(id=number, data=bytes(begun.data[: begun.size]))

    def _announced(self, ends: tuple[int, int], data: bytes, time: float) -> None:
        kind, size = data[0], int.from_bytes(data[1:3], "little")
        if kind == CTS and (begun := self._begun.get(ends[::-1])):
            begun.heard = time  # the other end still wants it, if not at once
        if kind not in {RTS, BAM, ABORT}:
            return
        sender = ends if kind != ABORT else ends[::-1]  # either of both may end it
        for each in {ends, sender}:
            self._begun.pop(each, None)
        group = int.from_bytes(data[5:8], "little")
        if kind == ABORT or group != self._group or not 8 < size <= MOST:
            return
        if len(self._begun) >= MESSAGES:
            del self._begun[next(iter(self._begun))]
        self._begun[ends] = _Begun(group, size, time)


def group_of(frame_id: int) -> int:
    """Return the number of a parameter group, by an id of one of its messages."""
    group = frame_id >> 8 & 0x3FFFF
    return group if group >> 8 & 0xFF >= BROADCAST_FORMATS else group & ~0xFF


CLAIM: Final = 0x18EE_FF00
"""The id of a claim, beside the address that is claimed."""

CLAIMS: Final = Mask(0x00EE_FF00, 0x03FF_FF00)
REQUESTS: Final = Mask(0x00EA_0000, 0x03FF_0000)

CLAIM_GROUP: Final = 0xEE00
NULL, ALL = 254, 255

VETO: Final = 0.25
"""For how long others may object to a claim, in seconds."""

CANNOT_CLAIM_DELAY: Final = 0.153
"""Within which time "cannot claim" is said, in seconds; not by all at the same moment."""

SELF_CONFIGURING: Final = 1 << 63
"""The bit of a NAME whose node may take another address."""

FREE: Final = range(128, 248)
"""The addresses that such a node takes."""

Lost = Callable[[EsairError], None]


def checked_name(component: str, name: object) -> int:
    """Return a NAME, which may be written as 16 hexadecimal digits."""
    number: object = name
    if isinstance(name, str) and len(name) == 16:
        with contextlib.suppress(ValueError):
            number = int(name, 16)
    if type(number) is not int or not 0 <= number < 1 << 64:
        raise ConfigError(
            component,
            "j1939_name",
            f"expected 64 bits, as a number or 16 hexadecimal digits, not {name!r:.80}",
        )
    return number


class Claim(SharedTask):
    """An address on a bus, for all devices that use one NAME.

    It is claimed when the first of them opens and let go when the last one closes. In
    between it is defended against greater NAMEs; lost to a lesser one each device is
    told, and the next opening has another address, or fails.
    """

    def __init__(self, bus: CanBus, name: int, preferred: int) -> None:
        super().__init__(bus)
        self.name = name
        self.preferred = preferred
        self.address: int | None = None
        self._next = preferred
        self._owners: dict[int, int] = {}
        self._claimed: asyncio.Future[int] | None = None
        self._is_parting = False

    async def join(self, lost: Lost) -> int:
        """Have the address, and be told when it is lost; raises if it is another's."""
        if self.begin(lost, self._run):
            self._claimed = asyncio.get_running_loop().create_future()
        assert self._claimed is not None
        try:
            return await asyncio.shield(self._claimed)
        except BaseException:
            await self.leave(lost)
            raise

    async def leave(self, lost: Lost) -> None:
        """Use the address no more."""
        if self._users.keys() <= {lost}:
            self.address = None
            if self._is_parting and self._task is not None:  # it says a last word
                await asyncio.wait({self._task})
        await super().leave(lost)

    async def _run(self) -> None:
        try:
            frames = self._bus.frames
            with frames(CLAIMS, REQUESTS, extended=True, limit=256) as inbox:
                while True:
                    await self._hold(self._next, inbox)
        except EsairError as error:
            self._lose(error)
            if self._claimed is not None and not self._claimed.done():
                self._claimed.set_exception(error)
                self._claimed.exception()  # heard, also if nobody waits
        finally:
            self._is_parting = False

    async def _hold(self, address: int, inbox: Inbox[Frame]) -> None:
        """Claim an address and defend it, until a lesser NAME has it."""
        loop = asyncio.get_running_loop()
        await self._say(address)
        settled = loop.time() + VETO
        while True:
            left = settled - loop.time()
            if self.address is None and left <= 0:
                self.address = address
                if self._claimed is not None and not self._claimed.done():
                    self._claimed.set_result(address)
            try:
                frame = await inbox.take(timeout=left if self.address is None else None)
            except TimeoutError:
                continue
            if frame.id & REQUESTS.mask == REQUESTS.id:
                if asks_for_claims(frame, address):
                    await self._say(address)
                continue
            owner, name = frame.id & SOURCE, int.from_bytes(frame.data, "little")
            if len(frame.data) != 8 or owner > NULL:
                continue
            if owner != address:
                self._owners[owner] = name
            elif name > self.name:
                await self._say(address)
            else:
                self._owners[address] = name
                await self._yield(address, name)
                return

    async def _yield(self, address: int, name: int) -> None:
        """Choose another address to claim, or raise if there is none."""
        is_twin = name == self.name
        error = DeviceLostError(
            "J1939",
            f"address {address} belongs to the node with NAME {name:016X}, and this one "
            + (
                "has the same" if is_twin else f"has {self.name:016X}, which is greater"
            ),
        )
        free = [
            each
            for each in (*range(address + 1, FREE.stop), *FREE)
            if each in FREE and self._owners.get(each, self.name + 1) > self.name
        ]
        if not is_twin and self.name & SELF_CONFIGURING and free:
            self._next = free[0]
            self._lose(error)
            return
        self._is_parting = True
        self._lose(error)
        self._next = self.preferred
        self._owners.clear()  # they may have gone until it is tried again
        await asyncio.sleep(self.name % 1021 / 1021 * CANNOT_CLAIM_DELAY)
        await self._say(NULL)
        raise error

    def _lose(self, error: EsairError) -> None:
        """Tell everybody who has the address."""
        had, self.address = self.address, None
        if had is not None:
            self._claimed = asyncio.get_running_loop().create_future()
            for lost in tuple(self._users):
                lost(error)

    async def _say(self, address: int) -> None:
        name = self.name.to_bytes(8, "little")
        await self._bus.send(CLAIM | address, name, extended=True)


def asks_for_claims(frame: Frame, address: int) -> bool:
    """Whether a request asks a node with an address for its claim."""
    group = int.from_bytes(frame.data[:3], "little")
    return group == CLAIM_GROUP and frame.id >> 8 & 0xFF in {address, ALL}


def claim_of(component: str, bus: CanBus, name: int, preferred: int) -> Claim:
    """Return the claim that all devices on a bus with one NAME share, and an address."""
    claim = shared(bus, Claim).setdefault(name, Claim(bus, name, preferred))
    if claim.preferred != preferred:
        raise ConfigError(
            component,
            "source",
            f"the NAME {name:016X} has the address {claim.preferred} already, "
            f"not {preferred}",
        )
    return claim


SIZE: Final = 7
"""The bytes of a packet."""

PAUSE: Final = 0.05
"""The least time between two packets to all, in seconds."""

ANSWER: Final = 1.25
"""How long a node may take to say which packets it wants, in seconds."""

HOLD: Final = 1.05
"""How long a node that asked to wait may be silent, in seconds."""

ABSENCES: Final = {
    1: "it is busy with another message",
    2: "it has no room",
    3: "it waited for too long",
}
"""Why a node, or a gateway for it, ends a message that may come later."""

FAULTS: Final = {
    4: "packets were sent that it did not want yet",
    5: "packets had to be sent too often",
}


def seconds_for(size: int, frame_id: int) -> float:
    """Return how long a message takes that finds no trouble, in seconds, at most."""
    count = -(-size // SIZE)
    if destination_of(frame_id) == ALL:
        return (count + 1) * PAUSE
    return 2 * ANSWER + count * 0.01


def is_to_one(frame_id: int) -> bool:
    """Whether a message is for one node."""
    return bool(frame_id >> 16 & 0xFF < BROADCAST_FORMATS)


def destination_of(frame_id: int) -> int:
    """Return the address that a message is for."""
    return frame_id >> 8 & 0xFF if is_to_one(frame_id) else ALL


async def send_in_packets(bus: CanBus, frame_id: int, data: bytes) -> None:
    """Send a message of more than 8 bytes, by the id that it would have as one frame.

    Between two addresses one at a time.
    """
    assert SIZE < len(data) <= MOST
    destination = destination_of(frame_id)
    ends = frame_id & SOURCE, destination
    exchanges = shared(bus, Exchanges).setdefault(ends, Exchanges(bus))
    time = 2 * seconds_for(len(data), frame_id)
    async with exchanges.request(timeout=time) as exchange:
        exchange.name = f"answer to a message of {len(data)} bytes"
        sending = _Sending(bus, frame_id, data, destination)
        if destination == ALL:
            exchange.end()
            await sending.announce()
        else:
            exchange.begin()
            await sending.connect()
            exchange.end()


@attrs.frozen
class _Sending:
    """A message on its way in packets, from one address to another, or to all."""

    bus: CanBus
    frame_id: int
    data: bytes
    destination: int

    @property
    def count(self) -> int:
        """How many packets it has."""
        return -(-len(self.data) // SIZE)

    async def announce(self) -> None:
        """Send it to all, who say nothing to that."""
        await self._begin(BAM)
        for number in range(1, self.count + 1):
            await asyncio.sleep(PAUSE)
            await self._packet(number)

    async def connect(self) -> None:
        """Send a node the packets that it asks for, until it has all."""
        back = ANNOUNCE << 16 | (self.frame_id & SOURCE) << 8 | self.destination
        group = group_of(self.frame_id).to_bytes(3, "little")
        with self.bus.frames(
            Mask(back, 0x03FF_FFFF), extended=True, length=8, limit=64
        ) as answers:
            try:
                await self._begin(RTS)
                sent, patience = 0, ANSWER
                while True:
                    answer = await answers.take(timeout=patience)
                    if answer.data[5:] != group:
                        continue  # about another message
                    kind, patience = answer.data[0], ANSWER
                    if kind == ABORT:
                        raise self._refusal(answer.data[1])
                    if kind == DONE and sent >= self.count:
                        return
                    if kind == CTS and answer.data[1] == 0:
                        patience = HOLD
                    elif kind == CTS:
                        wanted = self._wanted(answer)
                        for number in wanted:
                            await self._packet(number)
                        sent = max(sent, wanted.stop - 1)
            except (TimeoutError, asyncio.CancelledError):
                # In a task: this one is ending.
                loop = asyncio.get_running_loop()
                spawn(loop, self._abort(), name="J1939 abort")
                raise

    def _refusal(self, reason: int) -> EsairError:
        why = (ABSENCES | FAULTS).get(reason, f"reason {reason}")
        error = DeviceLostError if reason in ABSENCES else DeviceFaultError
        return error("J1939", f"node {self.destination}: {why}")

    def _wanted(self, answer: Frame) -> range:
        count, first = answer.data[1:3]
        wanted = range(first, first + count)
        if first < 1 or wanted.stop - 1 > self.count:
            raise DeviceFaultError(
                "J1939",
                f"node {self.destination} asks for {count} packets from {first} on, "
                "which there are not",
            )
        return wanted

    async def _abort(self) -> None:
        """Tell the node that nothing more comes."""
        with contextlib.suppress(EsairError):
            await self._control(ABORT, b"\x03\xff\xff\xff")

    async def _begin(self, kind: int) -> None:
        size = len(self.data).to_bytes(2, "little")
        await self._control(kind, size + bytes([self.count, 0xFF]))

    async def _control(self, kind: int, rest: bytes) -> None:
        group = group_of(self.frame_id).to_bytes(3, "little")
        await self._say(ANNOUNCE, bytes([kind]) + rest + group)

    async def _packet(self, number: int) -> None:
        piece = self.data[SIZE * (number - 1) : SIZE * number].ljust(SIZE, b"\xff")
        await self._say(PACKETS, bytes([number]) + piece)

    async def _say(self, place: int, data: bytes) -> None:
        ends = self.destination << 8 | self.frame_id & SOURCE
        await self.bus.send(7 << 26 | place << 16 | ends, data, extended=True)
