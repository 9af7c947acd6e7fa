"""The two mediators of a robot: one for behaviors, one for resources."""

from esair.supervisors._behavior_deployment import BehaviorDeployment, Zombie
from esair.supervisors._behavior_supervisor import BehaviorSupervisor
from esair.supervisors._halts import Halts
from esair.supervisors._ledger import Outcome, Record
from esair.supervisors._resource_deployment import ResourceDeployment
from esair.supervisors._resource_supervisor import ResourceSupervisor, admit
from esair.supervisors._watching import Keeper

__all__ = [
    "BehaviorDeployment",
    "BehaviorSupervisor",
    "Halts",
    "Keeper",
    "Outcome",
    "Record",
    "ResourceDeployment",
    "ResourceSupervisor",
    "Zombie",
    "admit",
]
