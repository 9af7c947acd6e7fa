"""The two mediators of a robot: one for behaviors, one for resources."""

from esair.supervisors._behavior_supervisor import BehaviorSupervisor, Zombie
from esair.supervisors._halts import Halts
from esair.supervisors._keeper import Keeper
from esair.supervisors._requests import Outcome, Record
from esair.supervisors._resource_supervisor import ResourceSupervisor

__all__ = [
    "BehaviorSupervisor",
    "Halts",
    "Keeper",
    "Outcome",
    "Record",
    "ResourceSupervisor",
    "Zombie",
]
