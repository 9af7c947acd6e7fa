"""The only way of data between actions and resources.

An action has a port in its hand; the port leads to the channel of one device; the channel
calls its driver. Nothing else reads a sensor or writes an actuator.

::

    SensorPort   ──>  SensorChannel    who reads: newest, history, followers
                        Asking, Listening   one question for all who ask; what is pushed
                          Calls ──> driver

    ActuatorPort ──>  ActuatorChannel  the commit block: verdict, value, guards, send
                        Gate, Hold          may a command leave now, and whose will is it
                        Stillness, Guards   who keeps it still: the blind, guards, time
                        SafeCommand         the last thing on the wire, whatever happens
                        Wire                what leaves, and what it was told last
                          Calls ──> driver

Whether a command may leave is one question with one answer, `_gate.verdict`. Each call of a
driver has a number, a deadline and one outcome (`_calls`); each right a number that only
grows (`_registrations`). What comes and what leaves is checked by one walk (`_values`).
"""

from esair.connections._actuator_channel import SENT, ActuatorChannel
from esair.connections._calls import (
    Call,
    Driver,
    End,
    GivenUpError,
    Method,
    is_loss,
    stamped,
    translate,
)
from esair.connections._device import OfRobot
from esair.connections._gate import (
    HALT,
    BeingReplacedError,
    Halt,
    Halting,
    LastCommand,
    Registration,
    Registrations,
    Stopped,
    Terms,
    run_ended,
)
from esair.connections._ports import (
    DONE,
    ActuatorConnection,
    ActuatorPort,
    Control,
    Port,
    SensorConnection,
    SensorPort,
)
from esair.connections._protection import BLIND, UNDECIDED, Protection, Protections
from esair.connections._sensor_channel import (
    ANSWERS_WITHIN,
    GRACE,
    Applied,
    AppliedChannel,
    Computation,
    DerivedChannel,
    Follower,
    SensorChannel,
    Source,
)
from esair.connections._turns import Decision, Sight
from esair.connections._values import (
    CommandCheck,
    ReadingCheck,
    changed,
    kind_of,
    limits_by_field,
    part_of,
)

__all__ = [
    "ANSWERS_WITHIN",
    "BLIND",
    "DONE",
    "GRACE",
    "HALT",
    "SENT",
    "UNDECIDED",
    "ActuatorChannel",
    "ActuatorConnection",
    "ActuatorPort",
    "Applied",
    "AppliedChannel",
    "BeingReplacedError",
    "Call",
    "CommandCheck",
    "Computation",
    "Control",
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
    "ReadingCheck",
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
    "kind_of",
    "limits_by_field",
    "part_of",
    "run_ended",
    "stamped",
    "translate",
]
