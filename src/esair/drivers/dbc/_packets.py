"""J1939: messages of more than 8 bytes, sent in packets.

Source: SAE J1939-21, transport protocol functions. A message to all is announced (BAM),
and its packets follow by the clock. One node is asked for leave (RTS), says which packets
it wants (CTS), and confirms the message.
"""

from __future__ import annotations

import asyncio
import contextlib
import weakref
from typing import Final

from esair.buses import CanBus, Exchanges, Frame
from esair.buses.can import Mask
from esair.drivers._on_bus import shared
from esair.drivers.dbc import _j1939 as j1939
from esair.exceptions import DeviceFaultError, DeviceLostError, EsairError
from esair.loop import spawn

ALL: Final = 0xFF
SIZE: Final = 7
"""The bytes of a packet."""

GAP: Final = 0.05
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
        return (count + 1) * GAP
    return 2 * ANSWER + count * 0.01


def destination_of(frame_id: int) -> int:
    """Return the address that a message is for."""
    is_to_one = frame_id >> 16 & 0xFF < j1939.BROADCAST_FORMATS
    return frame_id >> 8 & 0xFF if is_to_one else ALL


class Sender:
    """Sends messages from one address to one other, or to all; one after the other."""

    def __init__(self, bus: CanBus) -> None:
        self._bus = weakref.ref(bus)
        self._exchanges = Exchanges(bus)

    async def send(self, frame_id: int, data: bytes) -> None:
        """Send a message, by the id that it would have as one frame."""
        destination = destination_of(frame_id)
        time = 2 * seconds_for(len(data), frame_id)
        async with self._exchanges.request(timeout=time) as exchange:
            exchange.name = f"answer to a message of {len(data)} bytes"
            if destination == ALL:
                exchange.end()
                await self._announce(frame_id, data)
                return
            exchange.begin()
            await self._connect(frame_id, data, destination)
            exchange.end()

    async def _announce(self, frame_id: int, data: bytes) -> None:
        await self._control(frame_id, ALL, j1939.BAM, head(data) + b"\xff")
        for number in range(1, -(-len(data) // SIZE) + 1):
            await asyncio.sleep(GAP)
            await self._packet(frame_id, ALL, data, number)

    async def _connect(self, frame_id: int, data: bytes, destination: int) -> None:
        back = j1939.ANNOUNCE << 16 | (frame_id & j1939.SOURCE) << 8 | destination
        group = j1939.group_of(frame_id).to_bytes(3, "little")
        with self._there().frames(
            Mask(back, 0x03FF_FFFF), extended=True, length=8, limit=64
        ) as answers:
            try:
                await self._control(
                    frame_id, destination, j1939.RTS, head(data) + b"\xff"
                )
                sent, patience = 0, ANSWER
                while True:
                    answer = await answers.take(timeout=patience)
                    if answer.data[5:] != group:
                        continue  # about another message
                    kind, patience = answer.data[0], ANSWER
                    if kind == j1939.ABORT:
                        reason = answer.data[1]
                        why = (ABSENCES | FAULTS).get(reason, f"reason {reason}")
                        error = (
                            DeviceLostError if reason in ABSENCES else DeviceFaultError
                        )
                        raise error("J1939", f"node {destination}: {why}")
                    if kind == j1939.DONE and sent * SIZE >= len(data):
                        return
                    if kind == j1939.CTS and answer.data[1] == 0:
                        patience = HOLD
                    elif kind == j1939.CTS:
                        wanted = self._wanted(answer, len(data))
                        for number in wanted:
                            await self._packet(frame_id, destination, data, number)
                        sent = max(sent, wanted.stop - 1)
            except (TimeoutError, asyncio.CancelledError):
                self._abort(frame_id, destination)
                raise

    def _wanted(self, answer: Frame, size: int) -> range:
        count, first = answer.data[1:3]
        wanted = range(first, first + count)
        if first < 1 or (wanted.stop - 1) * SIZE >= size + SIZE:
            raise DeviceFaultError(
                "J1939",
                f"node {answer.id & j1939.SOURCE} asks for {count} packets from {first} on, "
                "which there are not",
            )
        return wanted

    def _abort(self, frame_id: int, destination: int) -> None:
        """Tell the node that nothing more comes; in a task, as this one is ending."""
        spawn(
            asyncio.get_running_loop(),
            self._say_abort(frame_id, destination),
            name="J1939 abort",
        )

    async def _say_abort(self, frame_id: int, destination: int) -> None:
        with contextlib.suppress(EsairError):
            await self._control(frame_id, destination, j1939.ABORT, b"\x03\xff\xff\xff")

    async def _control(
        self, frame_id: int, destination: int, kind: int, rest: bytes
    ) -> None:
        group = j1939.group_of(frame_id).to_bytes(3, "little")
        number = (
            7 << 26 | j1939.ANNOUNCE << 16 | destination << 8 | frame_id & j1939.SOURCE
        )
        await self._there().send(number, bytes([kind]) + rest + group, extended=True)

    async def _packet(
        self, frame_id: int, destination: int, data: bytes, number: int
    ) -> None:
        piece = data[SIZE * (number - 1) : SIZE * number].ljust(SIZE, b"\xff")
        target = (
            7 << 26 | j1939.PACKETS << 16 | destination << 8 | frame_id & j1939.SOURCE
        )
        await self._there().send(target, bytes([number]) + piece, extended=True)

    def _there(self) -> CanBus:
        bus = self._bus()
        assert bus is not None  # who sends holds it
        return bus


def head(data: bytes) -> bytes:
    """Return the length of a message, and how many packets it has."""
    assert SIZE < len(data) <= j1939.MOST
    return len(data).to_bytes(2, "little") + bytes([-(-len(data) // SIZE)])


async def send_in_packets(bus: CanBus, frame_id: int, data: bytes) -> None:
    """Send a message of more than 8 bytes; between two addresses one at a time."""
    ends = frame_id & j1939.SOURCE, destination_of(frame_id)
    sender = shared(bus, Sender).setdefault(ends, Sender(bus))
    await sender.send(frame_id, data)
