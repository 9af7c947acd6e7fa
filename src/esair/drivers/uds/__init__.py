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
import collections
import contextlib
import struct
from collections.abc import Callable
from typing import Any, Final, Literal, Required, TypedDict, Unpack

from esair.buses import CanBus, Exchanges, Frame, Inbox
from esair.drivers._on_bus import (
    SharedTask,
    applied,
    check_bus,
    in_units,
    room_comes,
    shared,
)
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
)
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
    import isotp
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

    @property
    def users(self) -> tuple[UdsActuator, ...]:
        """Whose session it keeps alive."""
        return tuple(self._users)

    async def run(self, bus: CanBus, link: IsoTp) -> None:
        told = Request(
            services.TesterPresent, subfunction=0, suppress_positive_response=True
        )
        while True:
            await asyncio.sleep(PRESENT_PERIOD)
            with room_comes():
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
            ``"write"`` writes a value that it keeps, also when this computer dies.
        session: The session that it needs; 3 is the extended one.
        limits: Least and greatest command.
        **settings: ``layout``, ``scale`` and more, as of a `UdsSensor`.
    """

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
        leaves = by == "control" and session != 1  # else nothing ends with it
        self.own_timeout: float | None = S3 if leaves else None
        self.claim: str = f"identifier {self.identifier:#06x} of unit {self._node:#x}"
        self._present = shared(self.bus, _Present).setdefault(
            self._link, _Present(self.bus)
        )

    async def open(self) -> None:
        """Open the session, and keep it alive."""
        self._link.join(self.bus, self)
        self._check_session()
        if self._present.users:
            await self.is_set_up()  # afterwards nobody sees that it was gone
        await self._ask(
            services.DiagnosticSessionControl, b"", subfunction=self.session
        )
        self._present.begin(self, lambda: self._present.run(self.bus, self._link))
        self._check_session()  # another may have been opened at the same time

    def _check_session(self) -> None:
        for user in self._present.users:
            if user.session != self.session:
                told = f"expected {user.session} as for {user.name!r}: a unit has one"
                raise ConfigError(self.name, "session", told)

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
        is_in_it = told == bytes((self.session,))
        for user in () if is_in_it else self._present.users:
            if user is not self:
                user.report_lost(_session_is_over(user))
        return is_in_it

    def check(self, command: float) -> None:
        """Refuse a command that its layout cannot hold.

        Raises:
            BadValueError: It is one.
        """
        self._packed(command)

    def _packed(self, command: float) -> bytes:
        raw: Any = (command - self._offset) / self._scale
        try:
            if self._layout.format[-1:] not in "efd":
                raw = in_units(command, self._scale, self.limits, self._offset)
            return self._layout.pack(raw)
        except (struct.error, OverflowError) as error:
            told = f"{command!r} does not fit {self._layout.format!r}"
            raise BadValueError(self.name, "command", told) from error

    async def write(self, command: float) -> float | None:
        """Control or write the value; returns it if its layout cannot hold just that.

        Raises:
            DeviceFaultError: The unit refuses.
            DeviceLostError: It is busy, or a unit behind it does not answer, or it has
                restarted.
        """
        data = self._packed(command)
        try:
            if self.by == "control":
                await self._control(b"\x03" + data)
            else:
                await self._ask(services.WriteDataByIdentifier, self._did + data)
        except DeviceFaultError as refusal:
            if await self.is_set_up():
                raise
            raise _session_is_over(self) from refusal
        (raw,) = self._layout.unpack(data)
        return applied(command, raw * self._scale + self._offset)

    async def _control(self, data: bytes) -> None:
        await self._ask(services.InputOutputControlByIdentifier, self._did + data)


def _session_is_over(user: UdsActuator) -> DeviceLostError:
    return DeviceLostError(user.name, "its session is over: it has restarted")


def _is_pending(message: bytes) -> bool:
    return message[:1] == b"\x7f" and message[2:3] == bytes((PENDING,))


CHECK_PERIOD = 0.1
"""How often a message that is not whole yet is looked at, in seconds."""


class IsoTp(SharedTask):
    """A pair of ids on a bus, over which a node is asked; `of` returns that of a bus.

    Between `join` and `leave` it hears the node. Requests of several devices never overlap.

    Args:
        bus: The bus.
        send: The id of the frames to the node.
        receive: The id of those from it.
        extended: Whether these are ids of 29 bits.

    Attributes:
        exchanges: Whose answer is what comes.
        is_pending: Tells whether a message says that the answer takes longer.
        patience: How long it may take then, in seconds.
    """

    def __init__(
        self, bus: CanBus, send: int, receive: int, *, extended: bool = False
    ) -> None:
        super().__init__(bus)
        self.exchanges: Exchanges = Exchanges(bus)
        self.is_pending: Callable[[bytes], bool] = lambda _message: False
        self.patience: float = 5.0
        self._ids = send, receive, extended
        self._lock = asyncio.Lock()
        self._heard: collections.deque[Any] = collections.deque()
        self._cut: collections.deque[Any] = collections.deque()
        self._layer: Any = None

    @classmethod
    def of(
        cls, bus: CanBus, send: int, receive: int, *, extended: bool = False
    ) -> IsoTp:
        """Return the one that all devices of a node share."""
        key = send, receive, extended
        return shared(bus, cls).setdefault(key, cls(bus, *key[:2], extended=extended))

    def join(self, bus: CanBus, user: object) -> None:
        """Hear the node as long as a device needs it."""
        send, receive, extended = self._ids
        mode = isotp.AddressingMode.Normal_11bits
        if extended:
            mode = isotp.AddressingMode.Normal_29bits
        inbox = bus.frames(receive, extended=extended, limit=1024)
        if not self.begin(user, lambda: self._hear(bus, inbox)):
            inbox.close()
            return
        self._lock = asyncio.Lock()  # that from before may be of another loop
        self._heard.clear()
        self._cut.clear()
        self._layer = isotp.TransportLayerLogic(
            rxfn=lambda _timeout: self._heard.popleft() if self._heard else None,
            txfn=self._cut.append,
            address=isotp.Address(mode, txid=send, rxid=receive),
            params={"tx_padding": 0, "blocking_send": False},
        )

    async def ask(
        self, bus: CanBus, payload: bytes, *kinds: bytes, timeout: float
    ) -> bytes:
        """Send a message and return the one that answers it.

        Args:
            bus: The bus.
            payload: The message, of 1 to 4095 bytes.
            *kinds: What the answer begins with; anything if none is given.
            timeout: How long to wait, in seconds.

        Raises:
            DeviceLostError: The bus is gone.
            DriverStuckError: There was no answer in time.
        """

        async def send(_seconds: float) -> None:
            self._layer.stop_sending()  # what was given up
            self._layer.send(payload)
            await self._process(bus)

        return await self.exchanges.ask(send, *kinds, timeout=timeout)

    async def tell(self, bus: CanBus, payload: bytes) -> None:
        """Send a message that fits into a frame, and is not answered."""
        send, _, extended = self._ids
        data = bytes((len(payload), *payload)).ljust(8, b"\0")
        # In a turn of its own: amid a message that was cut it would end that.
        turn = self.exchanges.request(timeout=PRESENT_PERIOD, answers=lambda _: False)
        async with turn:
            await bus.send(send, data, extended=extended)

    async def _hear(self, bus: CanBus, inbox: Inbox[Frame]) -> None:
        _, receive, extended = self._ids
        try:
            with inbox:
                while True:
                    try:
                        frame = await inbox.take(timeout=self._pause())
                    except TimeoutError:
                        pass
                    else:
                        self._heard.append(
                            isotp.CanMessage(
                                receive, data=frame.data, extended_id=extended
                            )
                        )
                    try:
                        await self._process(bus)
                    except (BusyError, DeviceFaultError, DriverStuckError) as error:
                        self.exchanges.fail(error)  # of that request alone
        except Exception as error:
            self.exchanges.fail(error)  # at once: it is not waited for any more
            raise

    def _pause(self) -> float | None:
        if self._layer.is_tx_transmitting_cf():
            return max(0.0005, self._layer.next_cf_delay() or 0.0)
        busy = self._layer.is_rx_active() or self._layer.transmitting()
        return CHECK_PERIOD if busy else None

    async def _process(self, bus: CanBus) -> None:
        """Let the package do what is due, and send what it has cut."""
        async with self._lock:  # frames of one message stay in order
            self._layer.process()
            frames = list(self._cut)
            self._cut.clear()
            for frame in frames:
                await bus.send(
                    frame.arbitration_id,
                    bytes(frame.data),
                    extended=frame.is_extended_id,
                )
        while (message := self._layer.recv()) is not None:
            if self.is_pending(bytes(message)):
                self.exchanges.put_off(bytes(message), self.patience)
            else:
                self.exchanges.offer(bytes(message))
