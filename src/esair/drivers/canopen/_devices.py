"""Objects of a CANopen node, as a sensor and as an actuator."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, ClassVar, Required, Unpack

from canopen.objectdictionary import FLOAT_TYPES, INTEGER_TYPES
from canopen.sdo.exceptions import SdoAbortedError

from esair.drivers._files import narrowed
from esair.drivers.canopen._dictionary import (
    BOOLEAN,
    TEXT,
    Mapped,
    bounds,
    find_object,
    read_eds,
)
from esair.drivers.canopen._node import sdo_frames
from esair.drivers.canopen._on_node import NodeSettings, OnNode
from esair.exceptions import BusyError, ConfigError, DeviceFaultError
from esair.loop import CallRefused
from esair.resources import Actuator, ActuatorSettings, Sensor, SensorSettings
from esair.watchdog import SafeFrames

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
        return remote.sdo.get_variable(self.variable.index, self.variable.subindex)

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
        """Find a PDO of the node with the object, in the thread."""
        wanted = self.variable
        for pdo in self._remote.tpdo.values():
            try:
                pdo.read()
            except SdoAbortedError:
                continue  # the file describes more of them than the node has
            if not pdo.enabled:
                continue
            for mapped in pdo.map:
                if (mapped.index, mapped.subindex) == (wanted.index, wanted.subindex):
                    size = (sum(each.length for each in pdo.map) + 7) // 8
                    place = size, mapped.offset, mapped.length
                    return Mapped(wanted, pdo.cob_id, *place)
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
            raise ConfigError(
                self.name,
                "safe",
                f"expected {allowed[0]:g} to {allowed[1]:g}, not {safe!r:.80}",
            )
        self.limits = allowed
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
        self._object_of(self._remote).raw = self._to_raw(command)

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
        return narrowed(self.name, "limits", given, allowed)
