"""What the hardware is: sensors, actuators, and their settings."""

from esair.resources._actuator import Actuator
from esair.resources._resource import Resource
from esair.resources._sensor import Sensor
from esair.resources._setting import Setting, setting

__all__ = ["Actuator", "Resource", "Sensor", "Setting", "setting"]
