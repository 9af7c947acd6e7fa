"""What a robot does when everything goes wrong: faults on the virtual clock.

A story is a flat list of steps: a cable is pulled, a driver hangs, a behavior crashes,
the user removes something. It is told to a robot of the user's, whose devices are those
of its simulation, or stand-ins; a gate before each device injects the faults and takes
down what the device was told when it had it. What must always hold is judged there.
"""

from esair.torture._judge import Violation
from esair.torture._kinds import KINDS, Kind, Step, Story
from esair.torture._target import Target
from esair.torture._torture import Finding, Report, survive, torture, write_test
from esair.torture._world import Outcome, World, tell

__all__ = [
    "KINDS",
    "Finding",
    "Kind",
    "Outcome",
    "Report",
    "Step",
    "Story",
    "Target",
    "Violation",
    "World",
    "survive",
    "tell",
    "torture",
    "write_test",
]
