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

from esair.loading import of_extra

with of_extra("modbus"):
    from esair.drivers.modbus._devices import ModbusActuator, ModbusSensor

__all__ = ["ModbusActuator", "ModbusSensor"]
