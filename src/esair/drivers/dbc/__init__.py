"""Any message that a DBC file describes, as a sensor or as an actuator.

The value is a dictionary of the message's signals in their units, or one signal alone::

    [sensor.speed]
    driver = "dbc"
    bus = "drive"
    database = "rover.dbc"
    message = "WheelFeedback"
    signal = "speed"

    [actuator.wheels]
    driver = "dbc"
    bus = "drive"
    database = "rover.dbc"
    message = "WheelCommand"
    safe = { left = 0.0, right = 0.0 }

Of a multiplexed message a value has the signals that its multiplexer selects.

On a bus of J1939 (``VFrameFormat`` of the file) a message is heard from every source
address; one of more than 8 bytes is heard and sent in packets. An address that is not this
robot's alone by design is claimed::

    [actuator.limit]
    driver = "dbc"
    bus = "engine"
    database = "engine.dbc"
    message = "Torque"
    signal = "limit"
    safe = 0.0
    source = 0x80
    j1939_name = "8000000000001234"   # its highest bit: another address will do
    own_timeout = 0.25                # the node stops by itself

Source: the file itself, read by cantools (DBC; ARXML, KCD and SYM as well).
"""

from esair.loading import of_extra

with of_extra("dbc"):
    from esair.drivers.dbc._actuator import DbcActuator
    from esair.drivers.dbc._codec import (
        FrameError,
        MessageCodec,
        bounds,
        choices_of,
        find_message,
        find_signal,
    )
    from esair.drivers.dbc._sensor import DbcSensor

__all__ = [
    "DbcActuator",
    "DbcSensor",
    "FrameError",
    "MessageCodec",
    "bounds",
    "choices_of",
    "find_message",
    "find_signal",
]
