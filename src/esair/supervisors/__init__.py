"""The two mediators of a robot: one for behaviors, one for resources.

A supervisor has the verbs of the architecture; its deployment has the components, and is what
the robot starts and stops. Each component has an owner that takes its error as a value, makes
safe what it held, and begins it anew within a budget.

::

    BehaviorSupervisor ──> BehaviorDeployment ──> Member ──> Behavior | Reaction
                             Mediator ──> Mailbox    what others see of it: put, get, ask
                                          Grants     its rights, the ports made of them
                                          Sight      what it protects, and whether it sees
                                          Steps      the reactions that it performs
                                          Life       restarts, a budget, reports
    ResourceSupervisor ──> ResourceDeployment ──> ResourceLife ──> Sensor | Actuator
                             ControlPath             who may do what: rules, registrations
                                          Opener     opens a device, sets it up, closes it
                                          Watch      what the watchdog is told of it

Commands of the user run one at a time (`_command_queue`). `Halts` and `Keeper` keep a whole
robot still: the latch, and the second process.
"""

from esair.supervisors._behavior_deployment import BehaviorDeployment, Zombie
from esair.supervisors._behavior_supervisor import BehaviorSupervisor
from esair.supervisors._halts import Halts
from esair.supervisors._requests import Outcome, Record
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
