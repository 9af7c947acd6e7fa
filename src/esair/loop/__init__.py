"""What the one event loop needs: a wheel for time, threads for blocking code."""

from esair.loop._bridge import Bridge, bridge
from esair.loop._deadlines import Deadlines
from esair.loop._every import Every, every
from esair.loop._garbage import freeze_garbage, unfreeze_garbage
from esair.loop._lane import CallRefused, Lane
from esair.loop._ownership import (
    OwnedTasks,
    Owner,
    current_owner,
    spawn,
    speaks_for_nobody,
)
from esair.loop._signals import ProcessWatch, SignalWatch
from esair.loop._stepping import Suspended, finish, first_step
from esair.loop._suspend import GLANCE, SuspendWatch
from esair.loop._timer import clock_of
from esair.loop._wheel import Spoke, Step, Wheel

__all__ = [
    "GLANCE",
    "Bridge",
    "CallRefused",
    "Deadlines",
    "Every",
    "Lane",
    "OwnedTasks",
    "Owner",
    "ProcessWatch",
    "SignalWatch",
    "Spoke",
    "Step",
    "SuspendWatch",
    "Suspended",
    "Wheel",
    "bridge",
    "clock_of",
    "current_owner",
    "every",
    "finish",
    "first_step",
    "freeze_garbage",
    "spawn",
    "speaks_for_nobody",
    "unfreeze_garbage",
]
