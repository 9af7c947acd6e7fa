"""What the robot does: behaviors deliberate, reactions react."""

from esair.actions._behavior import NOTHING, Behavior
from esair.actions._blocking import BlockingCalls, ThreadBehavior
from esair.actions._blocking_ports import (
    BlockingActuatorPort,
    BlockingSensorPort,
    blocking,
    each_of,
    in_loop,
)
from esair.actions._derived import Derivation, Derived
from esair.actions._host import Host, Terms
from esair.actions._needs import (
    Blind,
    Guards,
    Need,
    ProfiledAction,
    Reads,
    Writes,
    guards,
    reads,
    writes,
)
from esair.actions._reaction import MinimalReaction, Reaction, StepClock, adapt_action
from esair.actions._reaction_runner import GuardRunner, Hooks, ReactionRunner, ordered
from esair.actions._request import Request, taken
from esair.actions._takes import (
    BlockingRequestPort,
    RequestPort,
    Takes,
    answers,
    declared_requests,
    is_request,
    takes,
)
from esair.actions._works import Works, declared_works, works
from esair.connections import ActuatorPort, SensorPort

__all__ = [
    "NOTHING",
    "ActuatorPort",
    "Behavior",
    "Blind",
    "BlockingActuatorPort",
    "BlockingCalls",
    "BlockingRequestPort",
    "BlockingSensorPort",
    "Derivation",
    "Derived",
    "GuardRunner",
    "Guards",
    "Hooks",
    "Host",
    "MinimalReaction",
    "Need",
    "ProfiledAction",
    "Reaction",
    "ReactionRunner",
    "Reads",
    "Request",
    "RequestPort",
    "SensorPort",
    "StepClock",
    "Takes",
    "Terms",
    "ThreadBehavior",
    "Works",
    "Writes",
    "adapt_action",
    "answers",
    "blocking",
    "declared_requests",
    "declared_works",
    "each_of",
    "guards",
    "in_loop",
    "is_request",
    "ordered",
    "reads",
    "taken",
    "takes",
    "works",
    "writes",
]
