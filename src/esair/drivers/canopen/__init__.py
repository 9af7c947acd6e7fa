"""Objects of a CANopen node: read, received in a PDO, or written.

The objects are those of the node's EDS or DCF file, by name or by index::

    [sensor.position]
    driver = "canopen"
    bus = "drive"
    node = 5
    eds = "motor.eds"
    object = "Position actual value"        # or [0x6064, 0]

    [actuator.velocity]
    driver = "canopen"
    bus = "drive"
    node = 5
    eds = "motor.eds"
    object = "Target velocity"
    safe = 0

All devices on one node share its opening: its identity is compared with the file, its
heartbeat is watched, and it is started. Objects go through the package canopen, which
waits for its answers, so it has a thread of its own for each bus; the frames go through
the `esair.buses.CanBus` like all others, each with a deadline.

Source: CiA 301 (object dictionary, SDO, PDO, NMT, heartbeat); CiA 306 (EDS and DCF).
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import logging
import weakref
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, TypeVar

import attrs
import canopen
from canopen.nmt import NmtError
from canopen.objectdictionary import (
    FLOAT_TYPES,
    INTEGER_TYPES,
    SIGNED_TYPES,
    ObjectDictionary,
    ODVariable,
    import_od,
)
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from esair.buses import CanBus
from esair.drivers._on_can import can_bus
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    describe,
    did_you_mean,
)
from esair.loop import CallRefused, Executor
from esair.resources import Actuator, Resource, Sensor
from esair.values import check_seconds

__all__ = ["CanopenActuator", "CanopenSensor"]

T = TypeVar("T")

SEND_TIMEOUT = 0.2
"""How long one frame may wait for room on the bus, in seconds."""

LOOP_TIMEOUT = 1.0
"""How much longer the thread waits for the event loop to answer, in seconds."""

HEARTBEATS_MISSED = 2.5
"""After how many heartbeat periods of silence a node is lost."""

DEVICE_TYPE = 0x1000
HEARTBEAT_TIME = 0x1017
IDENTITY = 0x1018

_BOOT_UP = 0
_BOOLEAN = 0x1
_TEXT = frozenset({0x9, 0xB})


# What it logs, it raises as well; a node that is not there would fill the log.
logging.getLogger("canopen.sdo.client").addFilter(lambda _record: False)


class CanopenNetwork(canopen.Network):
    """The network of the package canopen, on a `CanBus` of esair.

    Its own methods are for one thread, `executor`, which may wait; what comes in is told
    by the event loop.

    Args:
        bus: The bus, which is open.
    """

    def __init__(self, bus: CanBus) -> None:
        super().__init__()
        self.executor = Executor(f"{bus.name}_canopen")
        self._can = weakref.ref(bus)
        self._loop = asyncio.get_running_loop()

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame from the executor.

        Raises:
            DeviceLostError: The bus is gone.
            DriverStuckError: There was no room in time.
        """
        bus = self._can()
        if remote or bus is None:
            raise DeviceFaultError("canopen", "remote frames are not sent")
        sending = asyncio.run_coroutine_threadsafe(
            bus.send(
                can_id, bytes(data), extended=can_id > 0x7FF, timeout=SEND_TIMEOUT
            ),
            self._loop,
        )
        try:
            sending.result(SEND_TIMEOUT + LOOP_TIMEOUT)
        except TimeoutError as error:
            sending.cancel()
            if isinstance(error, DriverStuckError):
                raise
            raise DriverStuckError(
                bus.name, "send", SEND_TIMEOUT + LOOP_TIMEOUT
            ) from None

    def send_periodic(self, *_: Any, **__: Any) -> Any:
        """Refuse: what repeats by itself would go on when the robot hangs."""
        raise DeviceFaultError("canopen", "nothing is sent periodically")


class _Node:
    """One node on a bus, open while at least one device uses it."""

    def __init__(self, bus: CanBus, number: int) -> None:
        self.bus = bus
        self.number = number
        self.users: set[_OnNode] = set()
        self.usable = True
        """Whether devices may still join it; a new one is made otherwise."""
        self.opening = asyncio.Lock()
        self._is_open = False
        self.remote: Any = None
        self.network: CanopenNetwork | None = None
        self._pump: asyncio.Task[None] | None = None
        self._watch: asyncio.TimerHandle | None = None
        self._patience = 0.0

    async def open(self, device: _OnNode) -> None:
        """Find the node, compare its identity, start it and watch its heartbeat.

        Who moves it puts its safe command there before it is started.
        """
        async with self.opening:
            if self._is_open:
                return
            if not self.usable:
                raise DeviceLostError(device.name, f"node {self.number} is not there")
            self.network = CanopenNetwork(self.bus)
            self.remote = canopen.RemoteNode(self.number, device.dictionary)
            self.network.add_node(self.remote)
            # Emergencies are left alone: the package keeps all of them for ever.
            inbox = self.bus.frames(0x580 + self.number, 0x700 + self.number, limit=64)
            self._pump = asyncio.get_running_loop().create_task(
                self._take(inbox), name=f"{self.bus.name} node {self.number}"
            )
            try:
                period = await self.call(
                    device, self._begin, device.dictionary, device.heartbeat
                )
                await self.call(device, self._start, tuple(self.users))
            except BaseException:
                self.usable = False
                raise
            self.remote.nmt.add_heartbeat_callback(self._beat)
            self._patience = HEARTBEATS_MISSED * period
            self._is_open = True
            self._arm_watch()

    async def leave(self, device: _OnNode) -> None:
        """Forget a device; the last one ends the thread and all listening."""
        self.users.discard(device)
        if self.users:
            return
        self.usable = False
        nodes = _nodes.get(self.bus, {})
        if nodes.get(self.number) is self:
            del nodes[self.number]
        if self._watch is not None:
            self._watch.cancel()
        if self._pump is not None:
            self._pump.cancel()
            await asyncio.wait({self._pump})
        if self.network is not None:
            if self.remote is not None:
                self.remote.remove_network()
            await self.network.executor.join(timeout=1.0)

    async def call(
        self,
        device: _OnNode,
        function: Callable[..., T],
        *args: Any,
        guard: Callable[[], bool] | None = None,
    ) -> T:
        """Call a function that waits for the node, in the thread of its network."""
        assert self.network is not None
        self.remote.sdo.RESPONSE_TIMEOUT = device.sdo_timeout
        try:
            return await self.network.executor.call(
                function, *args, timeout=device.deadline, guard=guard
            )
        except SdoAbortedError as error:
            raise DeviceFaultError(device.name, f"SDO abort: {error}") from error
        except (SdoCommunicationError, NmtError) as error:
            detail = f"node {self.number} does not answer: {error}"
            raise DeviceLostError(device.name, detail) from error

    def _begin(self, dictionary: ObjectDictionary, heartbeat: float | None) -> float:
        """Meet the node, in the thread; returns its heartbeat period in seconds."""
        sdo = self.remote.sdo
        sdo.upload(DEVICE_TYPE, 0)
        told = dictionary.device_information
        for subindex, what, wanted in (
            (1, "vendor", told.vendor_number),
            (2, "product", told.product_number),
        ):
            if wanted:
                found = int.from_bytes(sdo.upload(IDENTITY, subindex), "little")
                if found != wanted:
                    raise DeviceFaultError(
                        f"node {self.number}",
                        f"its {what} is {found:#x} instead of {wanted:#x}: "
                        "another device, or another EDS file",
                    )
        if heartbeat is not None:
            milliseconds = round(heartbeat * 1000)
            sdo.download(HEARTBEAT_TIME, 0, milliseconds.to_bytes(2, "little"))
        try:
            period = int.from_bytes(sdo.upload(HEARTBEAT_TIME, 0), "little") / 1000
        except SdoAbortedError:
            period = 0.0  # a node without a heartbeat: its loss shows when it is asked
        return period

    def _start(self, users: tuple[_OnNode, ...]) -> None:
        """Have it obey what it was told: that is what is safe; in the thread."""
        for user in users:
            with contextlib.suppress(SdoAbortedError):  # it may take it once it runs
                user.make_ready(self.remote)
        self.remote.nmt.state = "OPERATIONAL"

    async def _take(self, inbox: Any) -> None:
        assert self.network is not None
        with contextlib.closing(inbox), contextlib.suppress(ConnectionError):
            async for frame in inbox:
                # Frames with wrong lengths must not end the listening.
                with contextlib.suppress(Exception):
                    if not frame.extended:
                        self.network.notify(frame.id, bytearray(frame.data), frame.time)

    def _beat(self, state: int) -> None:
        if state == _BOOT_UP:
            self._lost("it has started anew")
        else:
            self._arm_watch()

    def _arm_watch(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None
        if self._patience > 0.0 and self.usable:
            self._watch = asyncio.get_running_loop().call_later(
                self._patience, self._lost, f"no heartbeat for {self._patience:g} s"
            )

    def _lost(self, why: str) -> None:
        self.usable = False
        for device in tuple(self.users):
            assert isinstance(device, Resource)
            device.report_lost(
                DeviceLostError(device.name, f"node {self.number}: {why}")
            )


@attrs.frozen
class Mapped:
    """Where an object is in a PDO, and what its bits mean.

    Attributes:
        variable: The object.
        id: The CAN id of the PDO.
        size: How many bytes the PDO has.
        offset: The first bit of the object in it.
        length: How many bits the object has there.
    """

    variable: ODVariable
    id: int
    size: int
    offset: int
    length: int

    def decode(self, data: bytes) -> Any:
        """Unpack the object from the bytes of the PDO, which are not too few."""
        number = int.from_bytes(data, "little") >> self.offset & (1 << self.length) - 1
        kind = self.variable.data_type
        if kind == _BOOLEAN:
            return bool(number)
        if kind in INTEGER_TYPES:
            negative = kind in SIGNED_TYPES and number >> (self.length - 1)
            return number - (1 << self.length) if negative else number
        return self.variable.decode_raw(number.to_bytes(-(-self.length // 8), "little"))


_nodes: weakref.WeakKeyDictionary[CanBus, dict[int, _Node]] = (
    weakref.WeakKeyDictionary()
)


class _OnNode:
    """What the sensor and the actuator have in common: an object of a node."""

    name: str
    deadline: float
    bus: Any

    def _describe(
        self,
        node: int,
        eds: Path | str,
        object_: str | int | tuple[int, int],
        factor: float | None,
        heartbeat: float | None,
        sdo_timeout: float,
    ) -> None:
        if type(node) is not int or not 1 <= node <= 127:
            raise ConfigError(self.name, "node", f"expected 1 to 127, not {node!r:.80}")
        self.node = node
        self.dictionary = _read_eds(self.name, eds, node)
        self.variable = find_object(self.name, self.dictionary, object_)
        if factor is not None and (
            not factor or self.variable.data_type not in INTEGER_TYPES + FLOAT_TYPES
        ):
            raise ConfigError(
                self.name, "factor", "expected a factor that is not 0, for a number"
            )
        self.factor = factor
        self.heartbeat = heartbeat
        if heartbeat is not None and not 0.001 <= heartbeat <= 65.0:
            raise ConfigError(
                self.name, "heartbeat", f"expected 0.001 to 65 s, not {heartbeat!r}"
            )
        self.sdo_timeout = check_seconds(self.name, "sdo_timeout", sdo_timeout)
        self._link: _Node | None = None

    def make_ready(self, remote: Any) -> None:
        """Tell the node what must be there before it is started, in its thread."""

    async def _join(self) -> _Node:
        await self._part()
        bus = can_bus(self)  # type: ignore[arg-type]
        nodes = _nodes.setdefault(bus, {})
        link = nodes.get(self.node)
        if link is None or not link.usable:
            link = nodes[self.node] = _Node(bus, self.node)
        link.users.add(self)
        self._link = link
        await link.open(self)
        return link

    async def _part(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            await link.leave(self)

    async def _call(
        self,
        function: Callable[..., T],
        *args: Any,
        guard: Callable[[], bool] | None = None,
    ) -> T:
        link = self._link
        if link is None or link.remote is None:
            raise DeviceLostError(self.name, f"node {self.node} is not open")
        return await link.call(self, function, *args, guard=guard)

    def _object_of(self, remote: Any) -> Any:
        """The object as canopen reads and writes it, in its thread."""
        return remote.sdo.get_variable(self.variable.index, self.variable.subindex)

    def _to_value(self, raw: Any) -> Any:
        if self.factor is not None:
            return raw * self.factor
        return bytes(raw) if isinstance(raw, bytearray) else raw

    @property
    def _type(self) -> Any:
        kind = self.variable.data_type
        if self.factor is not None or kind in FLOAT_TYPES:
            return float
        if kind in INTEGER_TYPES:
            return int
        if kind == _BOOLEAN:
            return bool
        return str if kind in _TEXT else bytes


class CanopenSensor(_OnNode, Sensor[Any]):
    """An object of a CANopen node.

    It is asked by SDO at its rate; or, with ``pdo``, it comes in the PDO that the node
    is set up to send it in.

    Args:
        node: The id of the node, 1 to 127.
        eds: Its EDS or DCF file.
        object: The object: its name, ``"record.member"``, its index, or its index and
            subindex.
        factor: What the number is multiplied with, to come to its unit; the value is
            a float then, and else of the object's own type.
        pdo: Whether it is received in a PDO instead of being asked for.
        heartbeat: The heartbeat period that the node is told, in seconds; it keeps its
            own if None. Without any, the loss of the node shows when it is asked.
        sdo_timeout: How long the node may take to answer, in seconds.

    Attributes:
        bad_frames: How many PDOs were too short.
    """

    bus: CanBus
    deadline = 2.0

    def __init__(
        self,
        *,
        node: int,
        eds: Path | str,
        object: str | int | tuple[int, int],  # noqa: A002 - the word of the standard
        factor: float | None = None,
        pdo: bool = False,
        heartbeat: float | None = None,
        sdo_timeout: float = 0.3,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self._describe(node, eds, object, factor, heartbeat, sdo_timeout)
        self.pdo = pdo
        self.bad_frames = 0
        self._mapped: Mapped | None = None
        if not pdo and not self.variable.readable:
            raise ConfigError(
                self.name, "object", f"{self.variable.qualname!r} cannot be read"
            )

    @property
    def value_type(self) -> Any:
        """The type of the object; float if there is a factor."""
        return self._type

    @property
    def can_be_asked(self) -> bool:
        """Whether it is asked by SDO."""
        return not self.pdo

    @property
    def pushes(self) -> bool:
        """Whether it comes in a PDO."""
        return self.pdo

    async def open(self) -> None:
        """Open the node; find the PDO that has the object, if it is to come in one."""
        await self._join()
        if self.pdo:
            self._mapped = await self._call(self._find_mapped)

    async def close(self) -> None:
        """Leave the node."""
        await self._part()

    async def read(self) -> Any:
        """Ask the node for the object."""
        return self._to_value(await self._call(self._get))

    def _get(self) -> Any:
        assert self._link is not None
        return self._object_of(self._link.remote).raw

    async def stream(self) -> AsyncIterator[Any]:
        """Yield the object from each PDO."""
        mapped = self._mapped
        assert mapped is not None  # as it is open
        inbox = can_bus(self).frames(mapped.id, limit=64)
        with contextlib.closing(inbox):
            async for frame in inbox:
                if len(frame.data) < mapped.size:
                    self.bad_frames += 1
                    continue
                yield self._to_value(mapped.decode(frame.data))

    def _find_mapped(self) -> Mapped:
        """Find a PDO of the node with the object, in the thread."""
        assert self._link is not None
        for pdo in self._link.remote.tpdo.values():
            try:
                pdo.read()
            except SdoAbortedError:
                continue  # the file describes more of them than the node has
            if not pdo.enabled:
                continue
            for mapped in pdo.map:
                if (mapped.index, mapped.subindex) == (
                    self.variable.index,
                    self.variable.subindex,
                ):
                    bits = sum(each.length for each in pdo.map)
                    return Mapped(
                        self.variable,
                        pdo.cob_id,
                        (bits + 7) // 8,
                        mapped.offset,
                        mapped.length,
                    )
        raise DeviceFaultError(
            self.name, f"the node sends no PDO with {self.variable.qualname!r}"
        )


class CanopenActuator(_OnNode, Actuator[Any]):
    """An object of a CANopen node that is written by SDO.

    Its limits are those of the file, or else what its type can hold. A write that
    still waits when a newer one comes is not sent.

    Args:
        node: The id of the node, 1 to 127.
        eds: Its EDS or DCF file.
        object: The object: its name, ``"record.member"``, its index, or its index and
            subindex.
        safe: The safe command.
        factor: What the number on the wire is multiplied with, to come to its unit.
        heartbeat: The heartbeat period that the node is told, in seconds; it keeps its
            own if None.
        sdo_timeout: How long the node may take to answer, in seconds.
        limits: Narrower limits than those of the file.
    """

    bus: CanBus
    deadline = 2.0

    def __init__(
        self,
        *,
        node: int,
        eds: Path | str,
        object: str | int | tuple[int, int],  # noqa: A002 - the word of the standard
        safe: Any,
        factor: float | None = None,
        heartbeat: float | None = None,
        sdo_timeout: float = 0.3,
        limits: tuple[float, float] | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self._describe(node, eds, object, factor, heartbeat, sdo_timeout)
        if not self.variable.writable:
            raise ConfigError(
                self.name, "object", f"{self.variable.qualname!r} cannot be written"
            )
        kind = self._type
        if kind is float and type(safe) is int:
            safe = float(safe)
        if type(safe) is not kind:
            raise ConfigError(
                self.name, "safe", f"expected {kind.__name__}, not {safe!r:.80}"
            )
        self.safe = safe
        allowed = self._narrowed(limits)
        if allowed is not None and not allowed[0] <= safe <= allowed[1]:
            raise ConfigError(
                self.name,
                "safe",
                f"expected {allowed[0]:g} to {allowed[1]:g}, not {safe!r:.80}",
            )
        self.limits = allowed
        self.claim = f"{self.variable.qualname} of node {node}"
        self._newest = 0

    @property
    def value_type(self) -> Any:
        """The type of the object; float if there is a factor."""
        return self._type

    async def open(self) -> None:
        """Open the node."""
        await self._join()

    async def close(self) -> None:
        """Leave the node."""
        await self._part()

    async def write(self, command: Any) -> None:
        """Write the object."""
        self._newest += 1
        mine = self._newest
        try:
            await self._call(self._put, command, guard=lambda: mine == self._newest)
        except CallRefused:
            raise BusyError(self.name, "number of waiting writes", 1) from None

    def make_ready(self, remote: Any) -> None:
        """Put the safe command there."""
        self._object_of(remote).raw = self._to_raw(self.safe)

    def _put(self, command: Any) -> None:
        assert self._link is not None
        self._object_of(self._link.remote).raw = self._to_raw(command)

    def _to_raw(self, command: Any) -> Any:
        raw = command if self.factor is None else command / self.factor
        return round(raw) if self.variable.data_type in INTEGER_TYPES else raw

    def _narrowed(self, given: tuple[float, float] | None) -> Any:
        allowed = bounds(self.variable)
        if allowed is not None and self.factor is not None:
            low, high = sorted(end * self.factor for end in allowed)
            allowed = (low, high)
        if given is None:
            return allowed
        if allowed is not None and not (
            allowed[0] <= given[0] <= given[1] <= allowed[1]
        ):
            raise ConfigError(
                self.name,
                "limits",
                f"the file allows {allowed[0]:g} to {allowed[1]:g}, not {given!r:.80}",
            )
        return given


def bounds(variable: ODVariable) -> tuple[float, float] | None:
    """Return what an object can be, by its limits and its type; None for no number."""
    low, high = variable.min, variable.max
    if variable.data_type in INTEGER_TYPES:
        bits = len(variable)
        signed = variable.data_type in SIGNED_TYPES
        least = -(1 << (bits - 1)) if signed else 0
        most = (1 << (bits - 1 if signed else bits)) - 1
        return (
            least if low is None else max(low, least),
            most if high is None else min(high, most),
        )
    if variable.data_type not in FLOAT_TYPES or (low is None and high is None):
        return None
    inf = float("inf")
    return (-inf if low is None else low, inf if high is None else high)


def find_object(
    component: str, dictionary: ObjectDictionary, wanted: str | int | tuple[int, int]
) -> ODVariable:
    """Return an object of a dictionary.

    Raises:
        ConfigError: There is none, or it has members and none is named.
    """
    names = _names_of(dictionary)
    found: Any = None
    with contextlib.suppress(KeyError, TypeError, ValueError):
        if isinstance(wanted, str | int):
            found = dictionary[wanted]
        else:
            index, subindex = wanted
            found = dictionary[index]
            if not isinstance(found, ODVariable) or subindex:
                found = found[subindex]
    shown = repr(wanted)
    if isinstance(wanted, int):
        shown = f"{wanted:#06x}"
    elif not isinstance(wanted, str):
        shown = ", ".join(f"{number:#x}" for number in wanted)
    if found is None:
        hint = did_you_mean(wanted, names) if isinstance(wanted, str) else ""
        hint = hint or f"; there are {', '.join(sorted(names)[:12])}, ..."
        raise ConfigError(component, "object", f"there is no object {shown}{hint}")
    if not isinstance(found, ODVariable):
        members = [f"{found.name}.{each.name}" for each in found.values()]
        raise ConfigError(
            component,
            "object",
            f"{shown} has members; expected one of {', '.join(members)}",
        )
    return found


def _names_of(dictionary: ObjectDictionary) -> list[str]:
    names: list[str] = []
    for item in dictionary.values():
        if isinstance(item, ODVariable):
            names.append(item.name)
        else:
            names += [f"{item.name}.{member.name}" for member in item.values()]
    return names


def _read_eds(component: str, eds: Path | str, node: int) -> ObjectDictionary:
    path = Path(eds)
    try:
        state = path.stat()
        return _load(path, node, state.st_mtime_ns, state.st_size)
    except OSError as error:
        raise ConfigError(
            component, "eds", f"{path} cannot be read: {error.strerror}"
        ) from error
    except Exception as error:  # a parser of files that people write by hand
        raise ConfigError(
            component, "eds", f"{path} cannot be understood: {describe(error)}"
        ) from error


@functools.lru_cache(maxsize=16)
def _load(path: Path, node: int, _modified: int, _size: int) -> ObjectDictionary:
    return import_od(str(path), node)
