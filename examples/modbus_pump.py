"""A tank that is kept full: a level sensor and a pump, on one Modbus line.

The level is unit 3, in mm; the pump is unit 4, a frequency converter whose speed is a
register, in 0.1 %. Run it with the port of the RS-485 adapter, or `socket://HOST:502`::

    python examples/modbus_pump.py usb:0403:6001
"""

import sys

import esair
from esair.buses import SerialBus
from esair.drivers.modbus import ModbusActuator, ModbusSensor

FULL = 1.2  # m
FASTEST = 80.0  # %
GAIN = 200.0  # % of speed for a metre that is missing


class Fill(esair.Reaction):
    """Pump the faster the more is missing; without a level, not at all."""

    level = esair.reads(float, max_age=1.0)
    pump = esair.writes(float)
    rate = 10.0

    def react(self, level: float) -> float:
        return max(0.0, min(FASTEST, GAIN * (FULL - level)))


def make_robot(bus: SerialBus) -> esair.Robot:
    """Return the robot; both units share the line, one request at a time."""
    level = ModbusSensor(
        name="level", bus=bus, unit=3, register=0, table="input", factor=0.001, rate=5.0
    )
    pump = ModbusActuator(
        name="pump",
        bus=bus,
        unit=4,
        register=8192,
        type="uint16",
        factor=0.1,
        safe=0.0,
        limits=(0.0, FASTEST),
    )
    return esair.Robot(resources=[level, pump], behaviors=[Fill()])


def line(port: str) -> SerialBus:
    """Return the line behind a port."""
    framing = "modbus-tcp" if port.startswith("socket://") else "modbus-rtu"
    return SerialBus(name="line", port=port, baudrate=19200, framing=framing)


is_named = __name__ == "__main__" and len(sys.argv) == 2
robot = make_robot(line(sys.argv[1] if is_named else "usb:0403:6001"))

if __name__ == "__main__":
    esair.run(robot)
