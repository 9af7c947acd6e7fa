"""The only way of data between actions and resources."""

from esair.connections._actuator_channel import ActuatorChannel
from esair.connections._actuator_connection import ActuatorConnection
from esair.connections._applied_channel import Applied, AppliedChannel
from esair.connections._call import Call, End, GivenUpError
from esair.connections._checks import CommandCheck
from esair.connections._decision import Decision, Sight
from esair.connections._derived_channel import DerivedChannel, Source
from esair.connections._device import OfRobot
from esair.connections._driver import Driver, Method, is_loss, translate
from esair.connections._gate import BeingReplacedError
from esair.connections._halt import HALT, Halt, Halting, LastCommand, Stopped
from esair.connections._ports import ActuatorPort, Port, SensorPort
from esair.connections._protection import BLIND, UNDECIDED, Protection, Protections
from esair.connections._registrations import (
    Registration,
    Registrations,
    Terms,
    run_ended,
)
from esair.connections._sensor_channel import Follower, SensorChannel
from esair.connections._sensor_connection import SensorConnection
from esair.connections._values import changed, limits_by_field, part_of

__all__ = [
    "BLIND",
    "HALT",
    "UNDECIDED",
    "ActuatorChannel",
    "ActuatorConnection",
    "ActuatorPort",
    "Applied",
    "AppliedChannel",
    "BeingReplacedError",
    "Call",
    "CommandCheck",
    "Decision",
    "DerivedChannel",
    "Driver",
    "End",
    "Follower",
    "GivenUpError",
    "Halt",
    "Halting",
    "LastCommand",
    "Method",
    "OfRobot",
    "Port",
    "Protection",
    "Protections",
    "Registration",
    "Registrations",
    "SensorChannel",
    "SensorConnection",
    "SensorPort",
    "Sight",
    "Source",
    "Stopped",
    "Terms",
    "changed",
    "is_loss",
    "limits_by_field",
    "part_of",
    "run_ended",
    "translate",
]
