"""A CANopen node without a device: its objects hold what a test puts there."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import canopen
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.exceptions import SdoAbortedError

from esair.buses import Frame
from esair.buses.can import FakeCan
from esair.drivers._on_bus import loop_of


class FakeCanopenNode:
    """One node, as the package canopen plays it. It has booted when it is made.

    Args:
        can: The bus that it is on.
        eds: Its EDS file, or its objects.
        node: Its id.

    Attributes:
        delay: How much later it answers requests, in seconds.
        local: The node of the package canopen.
        written: What was written: index, subindex, value; the oldest first.
    """

    def __init__(
        self, can: FakeCan, eds: Path | str | ObjectDictionary, *, node: int = 1
    ) -> None:
        loop_of(self)
        self.delay: float = 0.0
        self.written: list[tuple[int, int, Any]] = []
        self._network = _Network(can)
        can.on_send(self.receive)
        self._refused: dict[tuple[int, int], int] = {}
        known = eds if isinstance(eds, ObjectDictionary) else str(eds)
        make: Any = canopen.LocalNode  # the package is typed in part
        self.local: Any = make(node, known)
        self.local.add_read_callback(self._read)
        self.local.add_write_callback(self._write)
        self._network.add_node(self.local)
        self._on = True
        self.boot()

    @property
    def state(self) -> str:
        """Its NMT state, such as ``"OPERATIONAL"``."""
        return str(self.local.nmt.state)

    def boot(self) -> None:
        """Start anew, as after power-up, and wait to be started."""
        self._on = True
        self.local.nmt.state = "INITIALISING"
        self.local.nmt.state = "PRE-OPERATIONAL"

    def power_cycle(self) -> None:
        """Lose the power for a moment: its objects are what they are by default."""
        self.local.data_store.clear()
        self.boot()

    def emergency(self, code: int, register: int = 1, data: bytes = bytes(5)) -> None:
        """Tell of an error; code 0 says that it is over."""
        self.local.emcy.send(code, register, data)

    def stop(self) -> None:
        """Fall silent, as without power."""
        self._on = False
        self.local.nmt.stop_heartbeat()

    def __getitem__(self, index: int | str) -> Any:
        """Return the value of an object."""
        return self.local.sdo[index].raw

    def __setitem__(self, index: int | str, value: Any) -> None:
        """Set the value of an object."""
        self.local.sdo[index].raw = value

    def refuse(self, index: int, subindex: int, code: int) -> None:
        """Answer with an abort code when an object is read or written; 0: not any more."""
        self._refused[index, subindex] = code

    def send_pdo(self, number: int) -> None:
        """Send one of its PDOs with the values that its objects have now."""
        pdo = self.local.tpdo[number]
        pdo.read(from_od=False)
        for mapped in pdo.map:
            record = self.local.sdo[mapped.index]
            mapped.raw = (record[mapped.subindex] if mapped.subindex else record).raw
        self._network.send_message(pdo.cob_id, pdo.data)

    def receive(self, frame: Frame) -> None:
        """Take a frame from the bus."""
        if self._on and not frame.extended:
            self._network.delay = self.delay
            self._network.notify(frame.id, bytearray(frame.data), frame.time)
            self._network.delay = 0.0

    def _read(self, index: int, subindex: int, **_: Any) -> None:
        self._check(index, subindex)

    def _write(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        self._check(index, subindex)
        self.written.append((index, subindex, od.decode_raw(data)))

    def _check(self, index: int, subindex: int) -> None:
        if code := self._refused.get((index, subindex)):
            raise SdoAbortedError(code)


class _Network(canopen.Network):
    def __init__(self, can: FakeCan) -> None:
        super().__init__()
        self._can = can
        self.delay = 0.0

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        if not self.delay:
            self._can.feed(can_id, bytes(data))
            return
        loop = asyncio.get_running_loop()
        loop.call_later(self.delay, self._can.feed, can_id, bytes(data))

    def send_periodic(
        self, can_id: int, data: Any, period: float, remote: bool = False
    ) -> Any:
        return _Beat(self, can_id, bytes(data), period)


class _Beat:
    """A frame that is sent again and again, by the clock of the event loop."""

    def __init__(
        self, network: _Network, can_id: int, data: bytes, period: float
    ) -> None:
        self._network = network
        self._can_id = can_id
        self._data = data
        self._period = period
        self._loop = asyncio.get_running_loop()
        self._timer = self._loop.call_later(period, self._send)

    def update(self, data: Any) -> None:
        self._data = bytes(data)

    def stop(self) -> None:
        self._timer.cancel()

    def _send(self) -> None:
        self._network.send_message(self._can_id, self._data)
        self._timer = self._loop.call_later(self._period, self._send)
