"""Registers and coils of Modbus units, on a serial line (RTU) or by TCP.

::

    [bus.plc]
    type = "serial"
    port = "usb:0403:6001"
    baudrate = 19200
    framing = "modbus-rtu"

    [bus.cabinet]
    type = "serial"
    port = "socket://192.168.0.10:502"
    framing = "modbus-tcp"

    [sensor.flow]
    driver = "modbus"
    bus = "plc"
    unit = 3
    register = 100
    table = "input"
    type = "float32"

    [actuator.pump]
    driver = "modbus"
    bus = "cabinet"
    register = 8
    factor = 0.1
    safe = 0.0

A unit goes on with what it was told last when this computer dies, unless it has a time-out
of its own. The data are made and read by the package pymodbus; whose an answer is, is known
to the bus, which is a `esair.buses.SerialBus`.

Source: MODBUS Application Protocol V1.1b3.
"""

from __future__ import annotations

from typing import Any, Final, Literal, Required, TypedDict, Unpack, get_args

from esair.buses import SerialBus
from esair.drivers._on_bus import applied, check_bus, in_units
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    describe,
)
from esair.framing import ModbusRtu, ModbusTcp
from esair.loading import of_extra
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)
from esair.values import check_choice, check_seconds, check_whole
from esair.watchdog import SafeFrames

with of_extra("modbus"):
    from pymodbus.client.mixin import ModbusClientMixin
    from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
    from pymodbus.pdu.bit_message import (
        ReadCoilsRequest,
        ReadDiscreteInputsRequest,
        WriteSingleCoilRequest,
    )
    from pymodbus.pdu.register_message import (
        ReadHoldingRegistersRequest,
        ReadInputRegistersRequest,
        WriteMultipleRegistersRequest,
        WriteSingleRegisterRequest,
    )

__all__ = ["ModbusActuator", "ModbusSensor"]

Table = Literal["holding", "input", "coil", "discrete"]
"""Registers that can be written and those that cannot; bits of both kinds."""

Kind = Literal[
    "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"
]
"""What one or several registers are."""

_READS: Final[dict[str, Any]] = {
    "holding": ReadHoldingRegistersRequest,
    "input": ReadInputRegistersRequest,
    "coil": ReadCoilsRequest,
    "discrete": ReadDiscreteInputsRequest,
}
_KINDS: Final = {kind.name.lower(): kind for kind in ModbusClientMixin.DATATYPE}
_FAULTS: Final = {
    1: "it does not know the function",
    2: "it has no such register",
    3: "it does not take the value",
    4: "it has failed",
}
_ABSENCES: Final = {
    5: "it needs longer",
    6: "it is busy",
    10: "the gateway has no way to it",
    11: "behind the gateway it does not answer",
}
"""What is no answer of the unit, though something was said: it may help to wait."""


class _OnUnit(Resource):
    """What the sensor and the actuator have in common: a value of a unit."""

    bus: SerialBus
    _tables: tuple[str, ...] = get_args(Table)

    def __init__(
        self,
        *,
        unit: int = 1,
        register: int,
        table: Table = "holding",
        type: Kind = "int16",  # noqa: A002 - what everybody calls it
        word_order: Literal["big", "little"] = "big",
        factor: float = 1.0,
        timeout: float = 0.5,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        check_bus(self, SerialBus, ModbusRtu, ModbusTcp)
        self.unit: int = check_whole(self.name, "unit", unit, 0, 255)
        is_rtu = isinstance(self.bus.framing, ModbusRtu)
        if is_rtu and not unit:
            told = "expected 1 to 255, not 0: all hear it, and nobody answers"
            raise ConfigError(self.name, "unit", told)
        self.register: int = check_whole(self.name, "register", register, 0, 0xFFFF)
        self.table: str = check_choice(self.name, "table", table, self._tables)
        self.kind: Any = check_choice(self.name, "type", type, get_args(Kind))
        self.word_order = check_choice(
            self.name, "word_order", word_order, ("big", "little")
        )
        if not factor:
            raise ConfigError(self.name, "factor", "expected a factor that is not 0")
        self.factor = factor
        self.timeout: float = check_seconds(self.name, "timeout", timeout)
        self.is_bit: bool = table in {"coil", "discrete"}
        self._type = _KINDS[type]
        self._decoder = DecodePDU(False)
        if is_rtu:
            self.traffic: int = 20 + 2 * self._size  # with the silence around it

    @property
    def value_type(self) -> Any:
        """A bool in a bit, else a float."""
        return bool if self.is_bit else float

    @property
    def _size(self) -> int:
        return 1 if self.is_bit else int(self._type.value[1])

    def _message(self, request: ModbusPDU) -> bytes:
        """Return a request as its payload; with a number if the wire has them."""
        framing = self.bus.framing
        number = framing.number() if isinstance(framing, ModbusTcp) else b""
        head: bytes = number + bytes([self.unit, request.function_code])
        return head + bytes(request.encode())

    async def _ask(self, request: ModbusPDU) -> ModbusPDU:
        """Make a request and return the answer of the unit, or raise why it refuses."""
        message = self._message(request)
        head = message[: len(message) - len(request.encode())]
        refused = head[:-1] + bytes([head[-1] | 0x80])
        answer = await self.bus.ask(
            message, prefix=(head, refused), timeout=self.timeout
        )
        try:
            decoded = self._decoder.decode(answer[len(head) - 1 :])
        except Exception as error:  # bytes of a stranger
            raise DeviceFaultError(
                self.name, f"its answer: {describe(error)}"
            ) from error
        if decoded is None:
            raise DeviceFaultError(self.name, f"its answer is none: {answer.hex()}")
        if isinstance(decoded, ExceptionResponse):
            code = decoded.exception_code
            where = f"unit {self.unit}, {self.table} {self.register}"
            if code in _ABSENCES:
                raise DeviceLostError(self.name, f"{where}: {_ABSENCES[code]}")
            why = _FAULTS.get(code, f"exception {code}")
            raise DeviceFaultError(self.name, f"{where}: {why}")
        return decoded

    async def _look(self) -> Any:
        request = _READS[self.table](address=self.register, count=self._size)
        return await self._ask(request)

    async def _get(self) -> Any:
        answer = await self._look()
        if self.is_bit:
            if not answer.bits:
                raise DeviceFaultError(self.name, "its answer has no bit")
            return bool(answer.bits[0])
        if len(answer.registers) != self._size:
            told = f"its answer has {len(answer.registers)} registers, not {self._size}"
            raise DeviceFaultError(self.name, told)
        number: Any = ModbusClientMixin.convert_from_registers(
            answer.registers, self._type, word_order=self.word_order
        )
        return number * self.factor


class _UnitSettings(TypedDict, total=False):
    unit: int
    register: Required[int]
    table: Table
    type: Kind
    word_order: Literal["big", "little"]
    factor: float
    timeout: float


class _ActuatorSettings(_UnitSettings, ActuatorSettings): ...


class ModbusSensor(_OnUnit, Sensor[Any]):
    """A value that a unit is asked for: a float, or a bool in a bit.

    Args:
        unit: The number of the unit; 1 to 247 on a serial line.
        register: The first register, as it is on the wire: from 0, without the digit
            that some manuals put before it for the table.
        table: ``"holding"``, ``"input"``, ``"coil"`` or ``"discrete"``.
        type: What the registers are, such as ``"int16"`` or ``"float32"``.
        word_order: Which register of several comes first: that of the high word with
            ``"big"``.
        factor: What the number is multiplied with, to come to its unit.
        timeout: How long the unit may take to answer, in seconds. One that is silent keeps
            all others on the bus for as long, from a stop too.
    """

    async def open(self) -> None:
        """Make sure that the unit answers."""
        await self.read()

    async def read(self) -> Any:
        """Ask for the value.

        Raises:
            DeviceFaultError: It refuses, or answers something else.
            DeviceLostError: It is busy, or a gateway says that it does not answer.
            DriverStuckError: Nobody answers.
        """
        return await self._get()


class ModbusActuator(_OnUnit, Actuator[Any]):
    """A value that a unit is told, and confirms: a float, or a bool in a coil.

    Args:
        safe: The value that makes it safe.
        limits: Narrower limits than those of its type.
        own_timeout: After how many seconds without a command the unit itself stops.
        reads_back: Whether what was told is read back each second. A unit that is silent
            is lost then at once, and one that has another value, as after a restart, is
            opened again and made safe: for what can be read and nobody else changes.
        **settings: ``unit``, ``register`` and more, as of a `ModbusSensor`; its ``table``
            is ``"holding"`` or ``"coil"``.
    """

    _tables = ("holding", "coil")

    def __init__(
        self,
        *,
        safe: float | bool,
        limits: tuple[float, float] | None = None,
        own_timeout: float | None = None,
        reads_back: bool = False,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        self.own_timeout = own_timeout
        self.reads_back: bool = check_choice(
            self.name, "reads_back", reads_back, (False, True)
        )
        self._told: Any = None
        """The request that was confirmed last; None while another one is under way."""
        self.claim: str = f"{self.table} {self.register} of unit {self.unit}"
        if self.is_bit:
            if not isinstance(safe, bool):
                raise ConfigError(self.name, "safe", f"expected a bool, not {safe!r}")
            self.safe = safe
            return
        self.safe: Any = float(safe)
        allowed = self._bounds()
        self.limits: tuple[float, float] = allowed if limits is None else limits
        low, high = self.limits
        if not allowed[0] <= low <= self.safe <= high <= allowed[1]:
            raise ConfigError(
                self.name,
                "limits",
                f"expected {self.safe:g} within, and {allowed[0]:g} to {allowed[1]:g} at "
                f"most, not {self.limits!r:.80}",
            )

    def safe_frames(self) -> SafeFrames:
        """The safe value, as bytes of a serial line."""
        message = self._message(self._request(self.safe))
        # A framing of its own: this may be asked for while an answer comes.
        frame = self.bus.framing.fresh().encode(message)
        if isinstance(self.bus.framing, ModbusTcp):
            return SafeFrames([frame])
        # Silence alone ends a message that was cut (by the standard 1.75 ms, or that of
        # 3.5 bytes), and one answer may come meanwhile.
        gap = 0.002 + self.bus.seconds_for(len(frame) + 4)
        return SafeFrames([frame], repeat=3, gap=gap)

    @property
    def can_tell_set_up(self) -> bool:
        """Whether what it was told is read back."""
        return self.reads_back

    async def is_set_up(self) -> bool:
        """Tell whether the unit still has what it was told last."""
        told, has = self._told, await self._look()
        if told is None or told is not self._told:  # a write came between
            return True
        if self.is_bit:
            return bool(has.bits[:1] == told.bits[:1])
        return bool(has.registers == told.registers)

    async def open(self) -> None:
        """Make sure that the unit answers; that it cannot be read is well."""
        self._told = None
        try:
            await self._get()
        except DeviceFaultError as fault:
            if fault.errno is not None or self.reads_back:
                raise

    async def write(self, command: Any) -> float | None:
        """Tell the value, and wait until the unit has confirmed it.

        Returns what it was told, if the registers cannot hold just that.

        Raises:
            DeviceFaultError: It refuses, or confirms another value or register.
            DeviceLostError: It is busy, or a gateway says that it does not answer.
            DriverStuckError: It does not answer.
        """
        self._told = None
        request = self._request(command)
        answer = await self._ask(request)
        if answer.encode() != request.encode()[:4]:  # where, and what or how many
            raise DeviceFaultError(
                self.name, f"it confirms what it was not told: {answer.encode().hex()}"
            )
        self._told = request
        return (
            None if self.is_bit else applied(command, self._raw(command) * self.factor)
        )

    def _request(self, command: Any) -> ModbusPDU:
        if self.is_bit:
            return WriteSingleCoilRequest(address=self.register, bits=[bool(command)])
        registers = ModbusClientMixin.convert_to_registers(
            self._raw(command),
            self._type,
            word_order=self.word_order,
        )
        make: Any = WriteMultipleRegistersRequest
        if len(registers) == 1:
            make = WriteSingleRegisterRequest
        request: ModbusPDU = make(address=self.register, registers=registers)
        return request

    def _raw(self, command: float) -> float:
        """Return the number in the registers."""
        if self.kind.startswith("float"):
            return command / self.factor
        least, most = self._range()  # of 64 bits no float is the greatest
        return min(max(least, in_units(command, self.factor, self.limits)), most)

    def _range(self) -> tuple[int, int]:
        """Return what the whole numbers of its type are."""
        bits = 16 * self._size
        signed = self.kind.startswith("int")
        return -(1 << bits - 1) if signed else 0, (1 << bits - signed) - 1

    def _bounds(self) -> tuple[float, float]:
        if self.kind.startswith("float"):
            most = 3.4e38 if self.kind == "float32" else 1.7e308
            least = -most
        else:
            least, most = map(float, self._range())
        low, high = sorted((least * self.factor, most * self.factor))
        return low, high
