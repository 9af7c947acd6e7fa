"""Robots described by a file: ``robot.toml``.

Everything in the file is checked before anything is opened or moved, and every
mistake is told at once. A file has these tables::

    [robot]            name, and other keywords of esair.Robot
    [bus.NAME]         type = serial | can | i2c | an installed name | module:Class
    [sensor.NAME]      driver = module:Class | an installed name; bus, required, ...
    [actuator.NAME]    likewise; safe, command_timeout, limits, ...
    [behavior.NAME]    driver = module:Class; restart, reads, writes, ...
    [access.RESOURCE]  BEHAVIOR = "read, write, configure"; exclusive, max_priority

All other keys of a component are keywords of its constructor, its settings, or
public attributes of its class; paths begin in the folder of the file, and modules are
found there too. ``reads`` and ``writes`` change the profile of a behavior or reaction:
``writes = { wheels = { priority = 10 } }``, ``reads = { sonar = "front" }``.

Buses and devices may carry ``sim = { ... }``: keys that replace theirs when the robot
is simulated. Another ``driver`` there inherits the keys that it accepts, but not the
bus. A simulation opens nothing real by an omission: a device is refused that has no
``sim`` and is on no bus with one (``sim = {}`` says that it is harmless as it is).
"""

from esair.config._check import FoundInFile, Report, check
from esair.config._classes import searched_first
from esair.config._construct import keywords_of
from esair.config._description import Description
from esair.config._load import build, load, load_robot
from esair.config._mistakes import ConfigFileError
from esair.config._module import find_robot, is_of_module, robot_of
from esair.config._records import fields_of
from esair.config._values import INVALID, convert

__all__ = [
    "INVALID",
    "ConfigFileError",
    "Description",
    "FoundInFile",
    "Report",
    "build",
    "check",
    "convert",
    "fields_of",
    "find_robot",
    "is_of_module",
    "keywords_of",
    "load",
    "load_robot",
    "robot_of",
    "searched_first",
]
