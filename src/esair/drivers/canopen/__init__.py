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

import contextlib
import itertools
import logging
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, ClassVar, Required, Unpack

import attrs

from esair.drivers._files import described, narrowed
from esair.drivers._on_bus import applied, in_units
from esair.drivers.canopen._node import (
    CanopenNetwork,
    Emergency,
    NodeSettings,
    OnNode,
    sdo_frames,
)
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    hint_for,
)
from esair.loading import of_extra
from esair.loop import CallRefused
from esair.resources import Actuator, ActuatorSettings, Sensor, SensorSettings
from esair.watchdog import SafeFrames

with of_extra("canopen"):
    from canopen.objectdictionary import (
        FLOAT_TYPES,
        INTEGER_TYPES,
        SIGNED_TYPES,
        ObjectDictionary,
        ODVariable,
        import_od,
    )
    from canopen.sdo.base import SdoVariable
    from canopen.sdo.exceptions import SdoAbortedError

__all__ = ["CanopenActuator", "CanopenNetwork", "CanopenSensor", "Emergency", "Mapped"]

BOOLEAN = 0x1
TEXT = frozenset({0x9, 0xB})


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
        if kind == BOOLEAN:
            return bool(number)
        if kind in INTEGER_TYPES:
            negative = kind in SIGNED_TYPES and number >> (self.length - 1)
            return number - (1 << self.length) if negative else number
        return self.variable.decode_raw(number.to_bytes(-(-self.length // 8), "little"))


def bounds(variable: ODVariable) -> tuple[float, float] | None:
    """Return what an object can be, by its limits and its type; None for no number."""
    bits = len(variable)
    if variable.data_type in INTEGER_TYPES:
        signed = variable.data_type in SIGNED_TYPES
        least: float = -(1 << (bits - 1)) if signed else 0
        most: float = (1 << (bits - 1 if signed else bits)) - 1
    elif variable.data_type in FLOAT_TYPES:
        most = 3.4e38 if bits == 32 else 1.7e308
        least = -most
    else:
        return None
    low, high = variable.min, variable.max
    return (
        least if low is None else max(low, least),
        most if high is None else min(high, most),
    )


def find_object(
    component: str, dictionary: ObjectDictionary, wanted: str | int | tuple[int, int]
) -> ODVariable:
    """Return an object of a dictionary; a `ConfigError` if it is none, or has members."""
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
        hint = hint_for(wanted if isinstance(wanted, str) else "", sorted(names))
        raise ConfigError(component, "object", f"there is no object {shown}{hint}")
    if not isinstance(found, ODVariable):
        members = [f"{found.name}.{each.name}" for each in found.values()]
        told = f"{shown} has members; expected one of {', '.join(members)}"
        raise ConfigError(component, "object", told)
    return found


def _names_of(dictionary: ObjectDictionary) -> list[str]:
    names: list[str] = []
    for item in dictionary.values():
        if isinstance(item, ODVariable):
            names.append(item.name)
        else:
            names += [f"{item.name}.{member.name}" for member in item.values()]
    return names


def read_eds(component: str, eds: Path | str, node: int) -> ObjectDictionary:
    return described(component, "eds", eds, import_od, node)


# What it logs, it raises as well; a node that is not there would fill the log.
logging.getLogger("canopen.sdo.client").addFilter(lambda _record: False)


class _Object(OnNode):
    """What the sensor and the actuator have in common: an object of a node."""

    def __init__(
        self,
        *,
        eds: Path | str,
        object: str | int | tuple[int, int],  # noqa: A002 - the word of the standard
        factor: float | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.dictionary: Any = read_eds(self.name, eds, self.node)
        self.variable: Any = find_object(self.name, self.dictionary, object)
        if factor is not None and (
            not factor or self.variable.data_type not in INTEGER_TYPES + FLOAT_TYPES
        ):
            raise ConfigError(
                self.name, "factor", "expected a factor that is not 0, for a number"
            )
        self.factor = factor

    @property
    def value_type(self) -> Any:
        """The type of the object; float if there is a factor."""
        kind = self.variable.data_type
        if self.factor is not None or kind in FLOAT_TYPES:
            return float
        if kind in INTEGER_TYPES:
            return int
        if kind == BOOLEAN:
            return bool
        return str if kind in TEXT else bytes

    def _object_of(self, remote: Any) -> Any:
        """The object as canopen reads and writes it, in its thread."""
        return SdoVariable(remote.sdo, self.variable)

    def _to_value(self, raw: Any) -> Any:
        if self.factor is not None:
            return raw * self.factor
        return bytes(raw) if isinstance(raw, bytearray) else raw


class _ObjectSettings(NodeSettings, total=False):
    eds: Required[Path | str]
    object: Required[str | int | tuple[int, int]]
    factor: float | None


class _SensorSettings(_ObjectSettings, SensorSettings): ...


class _ActuatorSettings(_ObjectSettings, ActuatorSettings): ...


class CanopenSensor(_Object, Sensor[Any]):
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

    counted: ClassVar[tuple[str, ...]] = ("bad_frames",)

    def __init__(
        self, *, pdo: bool = False, **settings: Unpack[_SensorSettings]
    ) -> None:
        super().__init__(**settings)
        self.pdo = pdo
        self.bad_frames: int = 0
        self._mapped: Mapped | None = None
        if not pdo and not self.variable.readable:
            raise ConfigError(
                self.name, "object", f"{self.variable.qualname!r} cannot be read"
            )

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
        await super().open()
        if self.pdo:
            self._mapped = await self._call(self._find_mapped)

    def heed_mapping(self) -> None:
        """Look anew where the object is, if it is received in a PDO."""
        if self._mapped is not None:
            told = "a drive on its node sets the PDOs up"
            self.report_lost(DeviceLostError(self.name, told))

    async def read(self) -> Any:
        """Ask the node for the object."""
        return self._to_value(await self._call(self._get))

    def _get(self) -> Any:
        return self._object_of(self._remote).raw

    async def stream(self) -> AsyncIterator[Any]:
        """Yield the object from each PDO."""
        mapped = self._mapped
        assert mapped is not None  # as it is open
        inbox = self.bus.frames(mapped.id, limit=64)
        with inbox:
            async for frame in inbox:
                if len(frame.data) < mapped.size:
                    self.bad_frames += 1
                    continue
                yield self._to_value(mapped.decode(frame.data))

    def _find_mapped(self) -> Mapped:
        """Find a PDO of the node with the object, in the thread.

        What else is in it need not be in the file.
        """
        sdo, wanted = self._remote.sdo, self.variable

        def told(index: int, subindex: int) -> int:
            return int.from_bytes(sdo.upload(index, subindex), "little")

        for index in filter(self.dictionary.__contains__, range(0x1800, 0x1A00)):
            try:
                cob_id, count = told(index, 1), told(index + 0x200, 0)
                entries = [told(index + 0x200, n + 1) for n in range(count)]
            except SdoAbortedError:
                continue  # the file describes more of them than the node has
            ends = list(itertools.accumulate(entry & 0xFF for entry in entries))
            for entry, end in zip(entries, ends, strict=True):
                place = wanted.index << 8 | wanted.subindex
                if entry >> 8 == place and not cob_id >> 31:
                    size, length = (ends[-1] + 7) // 8, entry & 0xFF
                    number = cob_id & 0x1FFF_FFFF
                    return Mapped(wanted, number, size, end - length, length)
        raise DeviceFaultError(
            self.name, f"the node sends no PDO with {wanted.qualname!r}"
        )


class CanopenActuator(_Object, Actuator[Any]):
    """An object of a CANopen node that is written by SDO.

    Its limits are those of the file, or else what its type can hold. A write that
    still waits when a newer one comes is not sent.

    Args:
        safe: The safe command.
        limits: Narrower limits than those of the file.
        **settings: ``node``, ``eds``, ``object`` and more, as of a `CanopenSensor`.
    """

    def __init__(
        self,
        *,
        safe: Any,
        limits: tuple[float, float] | None = None,
        **settings: Unpack[_ActuatorSettings],
    ) -> None:
        super().__init__(**settings)
        if not self.variable.writable:
            raise ConfigError(
                self.name, "object", f"{self.variable.qualname!r} cannot be written"
            )
        kind = self.value_type
        if kind is float and type(safe) is int:
            safe = float(safe)
        if type(safe) is not kind:
            raise ConfigError(
                self.name, "safe", f"expected {kind.__name__}, not {safe!r:.80}"
            )
        self.safe = safe
        allowed = self._narrowed(limits)
        if allowed is not None and not allowed[0] <= safe <= allowed[1]:
            told = f"expected {allowed[0]:g} to {allowed[1]:g}, not {safe!r:.80}"
            raise ConfigError(self.name, "safe", told)
        self.limits: tuple[float, float] | None = allowed
        self.claim: str = f"{self.variable.qualname} of node {self.node}"
        self._newest = 0

    def safe_frames(self) -> SafeFrames | None:
        """An abort of a transfer that was cut, then the safe command by SDO.

        None for an object of more than four bytes: that needs answers of the node.
        """
        variable = self.variable
        data = bytes(variable.encode_raw(self._to_raw(self.safe)))
        if not 0 < len(data) <= 4:
            return None
        return SafeFrames(
            sdo_frames(self.node, variable.index, variable.subindex, data)
        )

    async def write(self, command: Any) -> float | None:
        """Write the object; returns what it is if it cannot be just the command."""
        self._newest += 1
        mine = self._newest
        try:
            await self._call(self._put, command, guard=lambda: mine == self._newest)
        except CallRefused:
            raise BusyError(self.name, "number of waiting writes", 1) from None
        if self.factor is None:
            return None
        return applied(command, self._to_raw(command) * self.factor)

    def make_ready(self, remote: Any) -> None:
        """Put the safe command there."""
        self._object_of(remote).raw = self._to_raw(self.safe)

    def _put(self, command: Any) -> None:
        self._object_of(self._remote).raw = self._to_raw(command)

    def _to_raw(self, command: Any) -> Any:
        if self.factor is None:
            return command
        if self.variable.data_type in INTEGER_TYPES:
            return in_units(command, self.factor, self.limits)
        return command / self.factor

    def _narrowed(self, given: tuple[float, float] | None) -> Any:
        allowed = bounds(self.variable)
        if allowed is not None and self.factor is not None:
            low, high = sorted(end * self.factor for end in allowed)
            allowed = (low, high)
        if given is None:
            return allowed
        return narrowed(self.name, "limits", given, allowed)
