"""A Modbus unit on a fake serial line: registers and bits by their numbers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from esair.buses.serial import FakeSerial
from esair.framing import ModbusTcp

NO_FUNCTION, NO_REGISTER, BAD_VALUE = 1, 2, 3


class FakeModbus:
    """One unit. It answers what is for it, by RTU or TCP as the line is framed.

    Args:
        line: The line, with ``framing="modbus-rtu"`` or ``"modbus-tcp"``.
        holding: Its holding registers.
        inputs: Its input registers.
        coils: Its coils.
        discretes: Its discrete inputs.
        unit: Its number.

    Attributes:
        holding: What its holding registers are now.
        inputs: What its input registers are now.
        coils: What its coils are now.
        discretes: What its discrete inputs are now.
        silent: Whether it says nothing, as without power.
        refuse: Called with each function and address; returns the code of an
            exception, or 0.
        heard: The requests that came for it, without the unit.
    """

    def __init__(
        self,
        line: FakeSerial,
        holding: dict[int, int] | None = None,
        *,
        inputs: dict[int, int] | None = None,
        coils: dict[int, bool] | None = None,
        discretes: dict[int, bool] | None = None,
        unit: int = 1,
    ) -> None:
        self.holding: dict[int, int] = holding or {}
        self.inputs: dict[int, int] = inputs or {}
        self.coils: dict[int, bool] = coils or {}
        self.discretes: dict[int, bool] = discretes or {}
        self.unit = unit
        self.silent = False
        self.refuse: Callable[[int, int], int] = lambda _function, _address: 0
        self.heard: list[bytes] = []
        self._head = 2 if isinstance(line.framing, ModbusTcp) else 0
        line.on_frame = self.hear

    def power_cycle(self) -> None:
        """Lose the power for a moment: what it was told is gone."""
        self.holding = dict.fromkeys(self.holding, 0)
        self.coils = dict.fromkeys(self.coils, False)

    def hear(self, message: bytes) -> bytes | None:
        """Take a message of the line; return the answer."""
        number, unit = message[: self._head], message[self._head]
        request = message[self._head + 1 :]
        if self.silent or unit != self.unit:
            return None
        self.heard.append(request)
        function, address, word = struct.unpack_from(">BHH", request)
        code = self.refuse(function, address)
        answer = b""
        if not code:
            try:
                answer = self._obey(function, address, word, request)
            except KeyError:
                code = NO_REGISTER
            except ValueError:
                code = NO_FUNCTION
        if code:
            return number + bytes([unit, function | 0x80, code])
        return number + bytes([unit, function]) + answer

    def _obey(self, function: int, address: int, word: int, request: bytes) -> bytes:
        places = range(address, address + word)
        if function in {1, 2}:
            bits = self.coils if function == 1 else self.discretes
            packed = sum(bits[place] << n for n, place in enumerate(places))
            data = packed.to_bytes(-(-word // 8), "little")
        elif function in {3, 4}:
            registers = self.holding if function == 3 else self.inputs
            data = b"".join(struct.pack(">H", registers[place]) for place in places)
        elif function == 5:
            self._put(self.coils, address, word == 0xFF00)
            return request[1:]
        elif function == 6:
            self._put(self.holding, address, word)
            return request[1:]
        elif function == 16:
            for n, place in enumerate(places):
                (value,) = struct.unpack_from(">H", request, 6 + 2 * n)
                self._put(self.holding, place, value)
            return request[1:5]
        else:
            raise ValueError
        return bytes([len(data)]) + data

    def _put(self, table: dict[int, Any], at: int, value: int) -> None:
        if at not in table:
            raise KeyError(at)
        table[at] = value
