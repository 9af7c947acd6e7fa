"""The only way of data between actions and resources."""

from esair.connections._actuator_channel import ActuatorChannel
from esair.connections._actuator_connection import ActuatorConnection
from esair.connections._actuator_device import LastCommand
from esair.connections._call import Call, Calls, End
from esair.connections._command_check import CommandCheck, limits_by_field, part_of
from esair.connections._driver import Driver, Method, is_loss, translate
from esair.connections._halt import HALT, Halt, Halting, Stopped
from esair.connections._protection import BLIND, UNDECIDED, Protection, Protections
from esair.connections._registrations import Registration, Registrations
from esair.connections._sensor_channel import READ_TIMEOUT, Follower, SensorChannel
from esair.connections._sensor_connection import SensorConnection

__all__ = [
    "BLIND",
    "HALT",
    "READ_TIMEOUT",
    "UNDECIDED",
    "ActuatorChannel",
    "ActuatorConnection",
    "Call",
    "Calls",
    "CommandCheck",
    "Driver",
    "End",
    "Follower",
    "Halt",
    "Halting",
    "LastCommand",
    "Method",
    "Protection",
    "Protections",
    "Registration",
    "Registrations",
    "SensorChannel",
    "SensorConnection",
    "Stopped",
    "is_loss",
    "limits_by_field",
    "part_of",
    "translate",
]
