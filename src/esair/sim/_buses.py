"""Buses that are on a wire of the simulation: what a configuration file names.

They are the buses of esair themselves, each with a wire that starts the simulation.
"""

from __future__ import annotations

from collections.abc import Callable

from esair.buses import Bus, CanBus, I2CBus, LateWire, SerialBus, Wire
from esair.sim._simulation import Simulation


def _wire(choose: Callable[[Simulation], Wire]) -> Wire:
    """Return a wire of the simulation, which ends with its last bus."""
    used: dict[Bus, Simulation] = {}

    async def find(bus: Bus) -> Wire:
        simulation = used[bus] = await Simulation.join(bus)
        return choose(simulation)

    async def left(bus: Bus) -> None:
        simulation = used.pop(bus, None)
        if simulation is not None:
            await simulation.leave(bus)

    return LateWire(find, left)


class SimSerialBus(SerialBus):
    """The serial bus, on a line of the simulation.

    Args:
        name: The name of the bus.
        line: ``front`` (range finder) or ``skirt`` (bumper).
        baudrate: Bits per second; a pseudo-terminal does not care.
        framing: Where a message ends: the parts on these lines talk in sentences.
    """

    def __init__(
        self,
        *,
        name: str,
        line: str = "front",
        baudrate: int = 115200,
        framing: str = "nmea",
    ) -> None:
        wire = _wire(lambda simulation: simulation.line(line))
        super().__init__(name=name, baudrate=baudrate, framing=framing, wire=wire)


class SimCanBus(CanBus):
    """The CAN bus, with the two motor controllers of the simulation on it."""

    def __init__(self, *, name: str) -> None:
        wire = _wire(lambda simulation: simulation.drive)
        super().__init__(name=name, wire=wire)


class SimI2CBus(I2CBus):
    """The I²C bus, with the inertial unit of the simulation on it."""

    def __init__(self, *, name: str) -> None:
        super().__init__(name=name, wire=_wire(lambda simulation: simulation.body))
