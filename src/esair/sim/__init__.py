"""A rover in a two-dimensional world, with devices that speak real protocols.

The robot's side sees a serial line, a CAN bus and an I²C bus, and nothing else: what
is behind them is here. ``Simulation`` is all of it together; the classes of buses
(``SimSerialBus`` and its kin) say in a configuration file which wire a bus is on::

    [bus.front]
    type = "serial"
    port = "/dev/ttyUSB0"
    sim = { type = "esair.sim:SimSerialBus", line = "front" }

It ends where the wires begin: how bytes and frames move, and how a cable is pulled, is
the far end in the folder of each medium (`esair.buses.serial` and its kin).
"""

from esair.sim._parts import SimBumper, SimMotor, SimMpu6050, SimRangeFinder
from esair.sim._simulation import SimCanBus, SimI2CBus, SimSerialBus, Simulation
from esair.sim._world import Arena, Box, Pillar, Wall, World

__all__ = [
    "Arena",
    "Box",
    "Pillar",
    "SimBumper",
    "SimCanBus",
    "SimI2CBus",
    "SimMotor",
    "SimMpu6050",
    "SimRangeFinder",
    "SimSerialBus",
    "Simulation",
    "Wall",
    "World",
]
