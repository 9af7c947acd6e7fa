"""What the robot does: behaviors deliberate, reactions react."""

from esair.actions._behavior import NOTHING, Behavior, Host
from esair.actions._from_minimal import MinimalReaction, adapt_action
from esair.actions._needs import (
    Blind,
    Guards,
    Need,
    ProfiledAction,
    Reads,
    Writes,
    guards,
    mistakes_in_needs,
    reads,
    writes,
)
from esair.actions._ports import (
    ActuatorPort,
    BlockingActuatorPort,
    BlockingSensorPort,
    SensorPort,
)
from esair.actions._reaction import Reaction, mistakes_in_reaction
from esair.actions._reaction_runner import ReactionRunner

__all__ = [
    "NOTHING",
    "ActuatorPort",
    "Behavior",
    "Blind",
    "BlockingActuatorPort",
    "BlockingSensorPort",
    "Guards",
    "Host",
    "MinimalReaction",
    "Need",
    "ProfiledAction",
    "Reaction",
    "ReactionRunner",
    "Reads",
    "SensorPort",
    "Writes",
    "adapt_action",
    "guards",
    "mistakes_in_needs",
    "mistakes_in_reaction",
    "reads",
    "writes",
]
