"""What the hardware is: sensors, actuators, and what can be said of them.

A driver derives from `Sensor` or `Actuator` and writes the methods that talk to the device;
nothing here calls them. What it declares is data: settings with types, units and limits,
operations with parameters, a bus, a claim on it. So every layer above can ask a device what
it is before it is opened.
"""

from esair.resources._devices import (
    APPLIED,
    HOLD,
    REFUSE,
    Actuator,
    ActuatorSettings,
    MinimalActuator,
    MinimalSensor,
    Sensor,
    SensorSettings,
    adapt_resource,
)
from esair.resources._resource import (
    Resource,
    ResourceSettings,
    bus_kind,
    wrong_bus,
)
from esair.resources._setting import (
    HIDDEN,
    Operation,
    Parameter,
    Setting,
    check_settings,
    flaws_of,
    operation,
    operation_of,
    operations_of,
    setting,
    settings_of,
    shown,
    wrong_operations,
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
    "flaws_of",
    "operation",
    "operation_of",
    "operations_of",
    "setting",
    "settings_of",
    "shown",
    "wrong_bus",
    "wrong_operations",
]
