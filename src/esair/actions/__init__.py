"""What the robot does: behaviors deliberate, reactions react."""

from esair.actions._behavior import NOTHING, Behavior, Host
from esair.actions._blocking import (
    BlockingActuatorPort,
    BlockingSensorPort,
    ThreadBehavior,
    blocking,
)
from esair.actions._from_minimal import MinimalReaction, adapt_action
from esair.actions._guard_runner import GuardRunner
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
from esair.actions._ports import ActuatorPort, SensorPort
from esair.actions._reaction import Reaction
from esair.actions._reaction_runner import ReactionRunner
from esair.actions._request import Request, taken
from esair.actions._takes import (
    Answers,
    BlockingRequestPort,
    RequestPort,
    Takes,
    answers,
    mistakes_in_requests,
    takes,
)

__all__ = [
    "NOTHING",
    "ActuatorPort",
    "Answers",
    "Behavior",
    "Blind",
    "BlockingActuatorPort",
    "BlockingRequestPort",
    "BlockingSensorPort",
    "GuardRunner",
    "Guards",
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
    "Takes",
    "ThreadBehavior",
    "Writes",
    "adapt_action",
    "answers",
    "blocking",
    "guards",
    "mistakes_in_requests",
    "reads",
    "taken",
    "takes",
    "writes",
]
