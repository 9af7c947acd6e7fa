"""Control units of vehicles and machines, asked by UDS over CAN.

Their data identifiers are read and controlled::

    [sensor.coolant]
    driver = "uds"
    bus = "drive"
    identifier = 0xF405
    layout = "B"
    offset = -40.0

    [actuator.fan]
    driver = "uds"
    bus = "drive"
    identifier = 0x0123
    layout = "B"
    scale = 0.01            # 0 to 100 on the wire
    safe = 0.0
    limits = [0.0, 1.0]

An actuator opens a session and keeps it alive. When the robot's process is gone the unit
leaves it by itself, after S3 (5 s), and takes back the control of its outputs.

Source: ISO 14229-1 (UDS), ISO 15765-2 (ISO-TP); by udsoncan and can-isotp.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
from typing import Any, Final, Literal, Required, TypedDict, Unpack

from esair.buses import CanBus
from esair.drivers._on_bus import SharedTask, check_bus, shared
from esair.drivers.uds._iso_tp import IsoTp
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError, EsairError
from esair.loading import of_extra
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)
from esair.values import check_choice, check_seconds, check_whole

with of_extra("uds"):
    from udsoncan import Request, Response, services

__all__ = ["IsoTp", "UdsActuator", "UdsSensor"]

PENDING: Final = 0x78
"""What a unit answers that needs longer."""

_ABSENCES: Final = {
    0x21: "it is busy",
    0x25: "a unit behind it does not answer",
    0x37: "it needs some time before",
    0x93: "its voltage is too low",
}
"""What is no answer of the part, though something was said: it may help to wait."""

S3: Final = 5.0
"""After how many seconds without a tester a unit leaves its session."""

PRESENT_PERIOD: Final = 2.0
"""Between two signs of life of the tester, in seconds."""

SESSION: Final = 0xF186
"""The identifier of the session that a unit is in."""


class _Present(SharedTask):
    """Tells a unit that its tester is there."""

    async def run(self, bus: CanBus, link: IsoTp) -> None:
        told = Request(
            services.TesterPresent, subfunction=0, suppress_positive_response=True
        )
        while True:
            await asyncio.sleep(PRESENT_PERIOD)
            await link.tell(bus, told.get_payload())


class _OnUnit(Resource):
    """What the sensor and the actuator have in common: an identifier of a unit."""

    bus: CanBus
    deadline: float = 6.0

    def __init__(
        self,
        *,
        identifier: int,
        layout: str = ">H",
        scale: float = 1.0,
        offset: float = 0.0,
        send: int = 0x7E0,
        receive: int = 0x7E8,
        extended: bool = False,
        timeout: float = 0.5,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        check_bus(self, CanBus)
        self.identifier: int = check_whole(
            self.name, "identifier", identifier, 0, 0xFFFF
        )
        self._did = identifier.to_bytes(2, "big")
        try:
            self._layout = struct.Struct(layout if layout[:1] in "<>" else f">{layout}")
            (sample,) = self._layout.unpack(bytes(self._layout.size))
        except (struct.error, ValueError) as error:
            told = f"expected one value as of struct, such as '>H', not {layout!r:.40}"
            raise ConfigError(self.name, "layout", told) from error
        self.is_text: bool = isinstance(sample, bytes)
        if not scale:
            raise ConfigError(self.name, "scale", "expected a scale that is not 0")
        self._scale, self._offset = scale, offset
        self.timeout: float = check_seconds(self.name, "timeout", timeout)
        self._node = send
        self._link = IsoTp.of(self.bus, send, receive, extended=extended)
        self._link.is_pending = _is_pending

    @property
    def value_type(self) -> Any:
        """A float, or a text."""
        return str if self.is_text else float

    async def close(self) -> None:
        """Hear the unit no more."""
        await self._link.leave(self)

    async def _ask(self, service: Any, data: bytes, **options: Any) -> bytes:
        """Make a request; return what the unit answers behind what it repeats.

        Raises:
            DeviceLostError: It is busy, or a unit behind it does not answer.
            DeviceFaultError: It refuses.
        """
        asked = Request(service, data=data or None, **options).get_payload()
        repeated = asked[1 : 2 if options else 3]
        number = asked[0]
        done, refused = bytes((number + 0x40,)) + repeated, bytes((0x7F, number))
        payload = await self._link.ask(
            self.bus, asked, done, refused, timeout=self.timeout
        )
        answer = Response.from_payload(payload)
        if payload[:2] == refused:
            what = f"{service.__name__} of {self.identifier:#06x}"
            if answer.code in _ABSENCES:
                raise DeviceLostError(self.name, f"{what}: {_ABSENCES[answer.code]}")
            raise DeviceFaultError(self.name, f"{what} is refused: {answer.code_name}")
        return payload[len(done) :]

    async def _get(self) -> Any:
        data = await self._ask(services.ReadDataByIdentifier, self._did)
        try:
            (value,) = self._layout.unpack(data)
        except struct.error as error:
            told = f"expected {self._layout.size} bytes, not {data.hex(' ')!r:.80}"
            raise DeviceFaultError(self.name, told) from error
        if isinstance(value, bytes):
            return value.rstrip(b"\0 ").decode("ascii", "replace")
        return value * self._scale + self._offset


class _UnitSettings(TypedDict, total=False):
    identifier: Required[int]
    layout: str
    scale: float
    offset: float
    send: int
    receive: int
    extended: bool
    timeout: float


class _SensorSettings(_UnitSettings, SensorSettings): ...


class _ActuatorSettings(_UnitSettings, ActuatorSettings): ...


class UdsSensor(_OnUnit, Sensor[Any]):
    """A data identifier that is read.

    Args:
        identifier: Its number.
        layout: The value on the wire, as of `struct`: ``">h"``, or ``"17s"`` for a text.
            Big-endian unless said otherwise.
        scale: What the number is multiplied with, to come to its unit.
        offset: What is added then.
        send: The id of the frames to the unit.
        receive: The id of those from it.
        extended: Whether these are ids of 29 bits.
        timeout: How long the unit may take to answer, in seconds; if it says that it needs
            longer, 5 s more.
    """

    def __init__(self, **settings: Unpack[_SensorSettings]) -> None:
        super().__init__(**settings)

    async def open(self) -> None:
        """Make sure that the unit answers."""
        self._link.join(self.bus, self)
        await self._get()

    async def read(self) -> Any:
        """Ask for the value.

        Raises:
            DeviceFaultError: The unit refuses, or answers something else.
            DeviceLostError: It is busy, or a unit behind it does not answer.
        """
        return await self._get()


class UdsActuator(_OnUnit, Actuator[float]):
    """A data identifier that is controlled, or written.

    Args:
        identifier: Its number.
        safe: The safe value.
        by: ``"control"`` takes an output from the unit, which gets it back at the close;
            ``"write"`` writes a value that it keeps.
        session: The session that it needs; 3 is the extended one.
        limits: Least and greatest command.
        **settings: ``layout``, ``scale`` and more, as of a `UdsSensor`.
    """

    own_timeout: float | None = S3

    def __init__(
        self,
        *,
        safe: float,
        by: Literal["control", "write"] = "control",
        session: int = 3,
        limits: tuple[float, float] | None = None,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        if self.is_text:
            raise ConfigError(self.name, "layout", "expected that of a number")
        self.safe = safe
        self.by = check_choice(self.name, "by", by, ("control", "write"))
        self.session: int = check_whole(self.name, "session", session, 1, 0x7F)
        self.limits: tuple[float, float] | None = limits
        self.claim: str = f"identifier {self.identifier:#06x} of unit {self._node:#x}"
        self._present = shared(self.bus, _Present).setdefault(
            self._link, _Present(self.bus)
        )

    async def open(self) -> None:
        """Open the session, and keep it alive."""
        self._link.join(self.bus, self)
        await self._ask(
            services.DiagnosticSessionControl, b"", subfunction=self.session
        )
        self._present.begin(self, lambda: self._present.run(self.bus, self._link))

    async def close(self) -> None:
        """Give the output back to the unit, if that still answers."""
        try:
            await self._present.leave(self)  # first: a close may be cut
            if self.by == "control" and self.bus.is_open:
                with contextlib.suppress(EsairError, AttributeError):
                    await self._control(b"\x00")
        finally:
            await super().close()

    async def is_set_up(self) -> bool:
        """Tell whether the unit is still in the session; some cannot say."""
        try:
            told = await self._ask(
                services.ReadDataByIdentifier, SESSION.to_bytes(2, "big")
            )
        except DeviceFaultError:
            return True
        return told == bytes((self.session,))

    async def write(self, command: float) -> None:
        """Control or write the value.

        Raises:
            DeviceFaultError: The unit refuses, or the value does not fit its layout.
            DeviceLostError: It is busy, or a unit behind it does not answer.
        """
        raw: Any = (command - self._offset) / self._scale
        try:
            if self._layout.format[-1:] not in "efd":
                raw = round(raw)
            data = self._layout.pack(raw)
        except (struct.error, OverflowError) as error:
            told = f"{command!r} does not fit {self._layout.format!r}"
            raise DeviceFaultError(self.name, told) from error
        if self.by == "control":
            await self._control(b"\x03" + data)
        else:
            await self._ask(services.WriteDataByIdentifier, self._did + data)

    async def _control(self, data: bytes) -> None:
        await self._ask(services.InputOutputControlByIdentifier, self._did + data)


def _is_pending(message: bytes) -> bool:
    return message[:1] == b"\x7f" and message[2:3] == bytes((PENDING,))
