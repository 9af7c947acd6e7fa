"""A node of J1939 that claims an address and takes messages in packets."""

from __future__ import annotations

import asyncio
from typing import Final, NamedTuple

from esair.buses import Frame
from esair.buses.can import FakeCan
from esair.drivers.dbc import _j1939 as j1939
from esair.drivers.dbc._j1939 import SIZE

REQUEST: Final = 0x18EA_0000


class Message(NamedTuple):
    """A message that the node got in packets.

    Attributes:
        source: The address that sent it.
        group: The number of its parameter group.
        data: Its bytes.
        time: When it was whole, on the clock of the event loop.
    """

    source: int
    group: int
    data: bytes
    time: float


class Begun(NamedTuple):
    """A message that is under way.

    Attributes:
        size: How many bytes it has.
        group: The number of its parameter group.
        is_to_all: Whether nobody asks for its packets, nor confirms it.
        packets: What has come, by its number.
    """

    size: int
    group: int
    is_to_all: bool
    packets: dict[int, bytes]


class FakeJ1939Node:
    """One node, as SAE J1939-21 and -81 have it.

    Args:
        can: The bus that it is on.
        address: Its address.
        name: Its NAME; with it the address is its own, and defended.

    Attributes:
        messages: What it got in packets, the oldest first.
        claims: Who has claimed an address: the address and the NAME, the oldest first.
        window: How many packets it wants at once.
        waits: How often it asks to wait before it wants packets.
        reason: Why it wants no message, as a number of the standard; 0 if it does.
        is_silent: Whether it says nothing at all.
        lost: The numbers of packets that it does not hear, once each.
        late: How much later it answers, in seconds.
    """

    def __init__(self, can: FakeCan, address: int, *, name: int | None = None) -> None:
        self.address = address
        self.name = name
        self.messages: list[Message] = []
        self.claims: list[tuple[int, int]] = []
        self.window = 16
        self.waits = self.reason = 0
        self.is_silent = False
        self.lost: set[int] = set()
        self.late: float = 0.0
        self._can = can
        self._begun: dict[int, Begun] = {}
        self._last = 0  # which packet ends those that were asked for
        can.on_send(self.receive)

    def claim(self) -> None:
        """Claim its address, as after power-up."""
        assert self.name is not None
        self._say(j1939.CLAIM | self.address, self.name.to_bytes(8, "little"))

    def ask_for_claims(self) -> None:
        """Ask all nodes for their claims."""
        self._say(REQUEST | j1939.ALL << 8 | self.address, b"\x00\xee\x00")

    def power_cycle(self) -> None:
        """Lose the power for a moment, and what was under way with it."""
        self._begun.clear()

    def receive(self, frame: Frame) -> None:
        """Take a frame from the bus."""
        if self.is_silent or not frame.extended:
            return
        source, data = frame.id & j1939.SOURCE, frame.data
        if frame.id & j1939.CLAIMS.mask == j1939.CLAIMS.id:
            name = int.from_bytes(data, "little")
            self.claims.append((source, name))
            if source == self.address and self.name is not None and self.name < name:
                self.claim()
        elif frame.id & j1939.REQUESTS.mask == j1939.REQUESTS.id:
            if self.name is not None and j1939.asks_for_claims(frame, self.address):
                self.claim()
        elif frame.id >> 8 & 0xFF in {self.address, j1939.ALL}:
            if frame.id >> 16 & 0xFF == j1939.ANNOUNCE:
                self._announced(source, data)
            elif frame.id >> 16 & 0xFF == j1939.PACKETS and source in self._begun:
                self._packet(source, data)

    def _announced(self, source: int, data: bytes) -> None:
        self._begun.pop(source, None)
        if data[0] not in {j1939.RTS, j1939.BAM}:
            return
        if data[0] == j1939.RTS and self.reason:
            self._answer(source, j1939.ABORT, bytes([self.reason]), data[5:])
            return
        size = int.from_bytes(data[1:3], "little")
        group = int.from_bytes(data[5:], "little")
        self._begun[source] = Begun(size, group, data[0] == j1939.BAM, {})
        if data[0] == j1939.RTS:
            for _ in range(self.waits):
                self._answer(source, j1939.CTS, b"\0\xff", data[5:])
            self._want(source)

    def _packet(self, source: int, data: bytes) -> None:
        begun = self._begun[source]
        if data[0] in self.lost:
            self.lost.remove(data[0])
        else:
            begun.packets[data[0]] = data[1:]
        count = -(-begun.size // SIZE)
        if len(begun.packets) == count:
            del self._begun[source]
            whole = b"".join(begun.packets[n + 1] for n in range(count))[: begun.size]
            now = asyncio.get_running_loop().time()
            self.messages.append(Message(source, begun.group, whole, now))
            if begun.is_to_all:
                return
            done = begun.size.to_bytes(2, "little") + bytes([count])
            self._answer(source, j1939.DONE, done, begun.group.to_bytes(3, "little"))
        elif data[0] == self._last and not begun.is_to_all:
            self._want(source)

    def _want(self, source: int) -> None:
        """Ask for the first packets that are missing."""
        begun = self._begun[source]
        count = -(-begun.size // SIZE)
        first = min(set(range(1, count + 1)) - begun.packets.keys())
        wanted = min(self.window, count + 1 - first)
        self._last = first + wanted - 1
        group = begun.group.to_bytes(3, "little")
        self._answer(source, j1939.CTS, bytes([wanted, first]), group)

    def _answer(self, source: int, kind: int, rest: bytes, group: bytes) -> None:
        data = (bytes([kind]) + rest).ljust(5, b"\xff") + group
        number = 7 << 26 | j1939.ANNOUNCE << 16 | source << 8 | self.address
        self._say(number, data)

    def _say(self, number: int, data: bytes) -> None:
        def say() -> None:
            self._can.feed(number, data, extended=True)

        if self.late:
            asyncio.get_running_loop().call_later(self.late, say)
        else:
            say()
