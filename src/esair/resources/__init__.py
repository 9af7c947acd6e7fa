"""What the hardware is: sensors, actuators, and their settings."""

from esair.resources._actuator import (
    APPLIED,
    HOLD,
    REFUSE,
    Actuator,
    ActuatorSettings,
)
from esair.resources._from_minimal import MinimalActuator, MinimalSensor, adapt_resource
from esair.resources._operation import (
    Operation,
    Parameter,
    operation,
    operation_of,
    operations_of,
    wrong_operations,
)
from esair.resources._resource import (
    Resource,
    ResourceSettings,
    bus_kind,
    wrong_bus,
)
from esair.resources._sensor import Sensor, SensorSettings
from esair.resources._setting import (
    HIDDEN,
    Setting,
    check_settings,
    setting,
    settings_of,
    shown,
)

__all__ = [
    "APPLIED",
    "HIDDEN",
    "HOLD",
    "REFUSE",
    "Actuator",
    "ActuatorSettings",
    "MinimalActuator",
    "MinimalSensor",
    "Operation",
    "Parameter",
    "Resource",
    "ResourceSettings",
    "Sensor",
    "SensorSettings",
    "Setting",
    "adapt_resource",
    "bus_kind",
    "check_settings",
    "operation",
    "operation_of",
    "operations_of",
    "setting",
    "settings_of",
    "shown",
    "wrong_bus",
    "wrong_operations",
]
