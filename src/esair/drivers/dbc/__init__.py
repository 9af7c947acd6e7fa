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

Source: the file itself, read by cantools (DBC; ARXML, KCD and SYM as well).
"""

from esair.drivers.dbc._actuator import DbcActuator
from esair.drivers.dbc._codec import FrameError, MessageCodec, bounds, choices_of
from esair.drivers.dbc._file import find_message, find_signal
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
