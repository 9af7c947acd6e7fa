"""Dynamixel servos of the X series, on their own half-duplex serial line.

Source: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, and the control table of the
XL430-W250 (the same for all of the X series as far as it is used here); checksums and what
a servo complains of are those of the maker's ``dynamixel-sdk``.

The bus is one of its own kind, because master and servos take turns on one wire::

    [bus.arm]
    type = "esair.drivers.servo:ServoBus"
    port = "usb:0403:6014"
    baudrate = 57600

    [actuator.elbow]
    driver = "servo"
    bus = "arm"
    id = 3
    safe = { mode = "release" }

A servo goes on to the goal that it has when this computer dies, and holds it.
"""

from esair.loading import of_extra

with of_extra("servo"):
    from esair.drivers.servo._bus import HARDWARE_ERROR, ServoBus, hardware_errors
    from esair.drivers.servo._servo import (
        CENTER,
        GOAL_CURRENT,
        GOAL_POSITION,
        GOAL_VELOCITY,
        OPERATING_MODE,
        PRESENT_POSITION,
        PROFILE_VELOCITY,
        TORQUE_ENABLE,
        Goal,
        Mode,
        Servo,
        ServoPosition,
        to_angle,
        to_steps,
    )

__all__ = [
    "CENTER",
    "GOAL_CURRENT",
    "GOAL_POSITION",
    "GOAL_VELOCITY",
    "HARDWARE_ERROR",
    "OPERATING_MODE",
    "PRESENT_POSITION",
    "PROFILE_VELOCITY",
    "TORQUE_ENABLE",
    "Goal",
    "Mode",
    "Servo",
    "ServoBus",
    "ServoPosition",
    "hardware_errors",
    "to_angle",
    "to_steps",
]
