"""A control unit with data identifiers, on a fake CAN bus."""

from __future__ import annotations

import asyncio
import collections
import math
from collections.abc import Mapping
from typing import Any

import isotp

from esair.buses import Frame
from esair.buses.can import FakeCan
from esair.drivers.uds import PENDING, S3, SESSION


class FakeUnit:
    """Answers by UDS: sessions, reading, writing and control of identifiers.

    Args:
        can: The bus that it is on.
        values: What its identifiers are.
        send: The id of the frames to it.
        receive: The id of those from it.

    Attributes:
        values: What its identifiers are now, without what is controlled.
        controlled: What it was told to control, by identifier; in its session only.
        session: The session that it is in; 1 is the default.
        refuse: The code that it refuses everything with; 0 for none.
        pending: How often it says, before each answer, that it needs longer.
        silent: Whether it hears and says nothing, as without power.
    """

    def __init__(
        self,
        can: FakeCan,
        values: Mapping[int, bytes] | None = None,
        *,
        send: int = 0x7E0,
        receive: int = 0x7E8,
    ) -> None:
        self.values: dict[int, bytes] = dict(values or {})
        self.controlled: dict[int, bytes] = {}
        self.session: int = 1
        self.refuse: int = 0
        self.pending: int = 0
        self.silent = False
        self._seen = -math.inf
        self._can = can
        self._send = send
        self._heard: collections.deque[Any] = collections.deque()
        self._layer = isotp.TransportLayerLogic(
            rxfn=lambda _timeout: self._heard.popleft() if self._heard else None,
            txfn=lambda frame: can.feed(frame.arbitration_id, bytes(frame.data)),
            address=isotp.Address(txid=receive, rxid=send),
        )
        can.on_send(self._take)

    def power_cycle(self) -> None:
        """Lose the power for a moment: it is in its default session then."""
        self._leave()

    def _leave(self) -> None:
        self.session = 1
        self.controlled.clear()

    def _take(self, frame: Frame) -> None:
        if self.silent or frame.id != self._send:
            return
        self._heard.append(isotp.CanMessage(frame.id, data=frame.data))
        self._layer.process()
        while (asked := self._layer.recv()) is not None:
            for answer in self._answers(bytes(asked)):
                self._layer.send(answer)
        self._layer.process()

    def _answers(self, asked: bytes) -> list[bytes]:
        now = asyncio.get_running_loop().time()
        if now - self._seen > S3:
            self._leave()
        self._seen = now
        code, answer = self._obey(asked[0], asked[1:])
        if answer is None and not code:
            return []
        wait = [bytes((0x7F, asked[0], PENDING))] * self.pending
        if code or answer is None:
            return [*wait, bytes((0x7F, asked[0], code))]
        return [*wait, bytes((asked[0] + 0x40,)) + answer]

    def _obey(self, service: int, data: bytes) -> tuple[int, bytes | None]:
        if service == 0x3E:
            return 0, None if data[0] & 0x80 else b"\0"
        if self.refuse:
            return self.refuse, None
        if service == 0x10:
            self.session = data[0]
            return 0, bytes((data[0], 0, 50, 1, 244))
        number = int.from_bytes(data[:2], "big")
        if service == 0x22 and number == SESSION:
            return 0, data + bytes((self.session,))
        if number not in self.values:
            return 0x31, None
        if service == 0x22:
            return 0, data + self.controlled.get(number, self.values[number])
        if self.session == 1:
            return 0x7F, None
        if service == 0x2E:
            self.values[number] = data[2:]
            return 0, data[:2]
        if service != 0x2F:
            return 0x11, None
        self.controlled.pop(number, None)
        if data[2] == 3:
            self.controlled[number] = data[3:]
        return 0, data
