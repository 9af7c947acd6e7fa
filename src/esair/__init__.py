"""esair: robot software that must not hurt anyone, lose data or stop by itself.

A robot is made of sensors and actuators (its *resources*) and of behaviors and
reactions (its *actions*). Subclass those, hand them to a `Robot`, and `run` it::

    class Avoid(esair.Reaction):
        sonar = esair.reads(float, max_age=0.5)
        wheels = esair.writes(Twist, priority=10)

        def react(self, sonar: float) -> Twist | None:
            return Twist(0.0, 1.2) if sonar < 0.4 else None

    esair.run(esair.Robot(resources=[Sonar(), Wheels()], behaviors=[Avoid()]))
"""

from esair.abc import Action, Connection, Supervisor
from esair.actions import (
    Behavior,
    Derived,
    Reaction,
    Request,
    ThreadBehavior,
    answers,
    guards,
    reads,
    takes,
    writes,
)
from esair.connections import ActuatorConnection, Registration, SensorConnection
from esair.exceptions import (
    AccessDeniedError,
    BadValueError,
    BehaviorFailedError,
    BehaviorRemovedError,
    BehaviorUnavailableError,
    BusyError,
    CircularRequestError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    HaltedError,
    NameTakenError,
    NotRegisteredError,
    RecordingBrokenError,
    RecordingError,
    RefusedError,
    ResourceRemovedError,
    StaleReadingError,
    StoppingError,
    UnknownNameError,
)
from esair.loop import ComponentRandom, every, now
from esair.messages import (
    Access,
    BehaviorState,
    BehaviorStatus,
    Operator,
    Page,
    Policy,
    Reading,
    Recording,
    Refused,
    ResourceState,
    ResourceStatus,
    Restart,
    Stamped,
    SupervisorPhase,
    Why,
    Written,
)
from esair.resources import HOLD, Actuator, Resource, Sensor, operation, setting
from esair.standard import Robot, run
from esair.supervisors import BehaviorSupervisor, ResourceSupervisor

random = ComponentRandom()
"""Random numbers from the stream of the component that asks; see `ComponentRandom`."""

__version__ = "0.2.0"

__all__ = [
    "HOLD",
    "Access",
    "AccessDeniedError",
    "Action",
    "Actuator",
    "ActuatorConnection",
    "BadValueError",
    "Behavior",
    "BehaviorFailedError",
    "BehaviorRemovedError",
    "BehaviorState",
    "BehaviorStatus",
    "BehaviorSupervisor",
    "BehaviorUnavailableError",
    "BusyError",
    "CircularRequestError",
    "ConfigError",
    "Connection",
    "Derived",
    "DeviceFaultError",
    "DeviceLostError",
    "DriverStuckError",
    "EsairError",
    "HaltedError",
    "NameTakenError",
    "NotRegisteredError",
    "Operator",
    "Page",
    "Policy",
    "Reaction",
    "Reading",
    "Recording",
    "RecordingBrokenError",
    "RecordingError",
    "Refused",
    "RefusedError",
    "Registration",
    "Request",
    "Resource",
    "ResourceRemovedError",
    "ResourceState",
    "ResourceStatus",
    "ResourceSupervisor",
    "Restart",
    "Robot",
    "Sensor",
    "SensorConnection",
    "StaleReadingError",
    "Stamped",
    "StoppingError",
    "Supervisor",
    "SupervisorPhase",
    "ThreadBehavior",
    "UnknownNameError",
    "Why",
    "Written",
    "answers",
    "every",
    "guards",
    "now",
    "operation",
    "random",
    "reads",
    "run",
    "setting",
    "takes",
    "writes",
]
