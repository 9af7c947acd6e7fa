"""ESAIR STD: the robot, its four resident objects, and their order of start and stop."""

from esair.standard._recording import FORMAT, OWN, components_of, public_text
from esair.standard._robot import (
    LAST_WAIT,
    STALL_WARNING,
    Robot,
    RunWanted,
    only_looking,
)
from esair.standard._run import (
    prepare_replay,
    recorded_as,
    run,
    run_to_its_end,
)
from esair.standard._told import leaves, told

__all__ = [
    "FORMAT",
    "LAST_WAIT",
    "OWN",
    "STALL_WARNING",
    "Robot",
    "RunWanted",
    "components_of",
    "leaves",
    "only_looking",
    "prepare_replay",
    "public_text",
    "recorded_as",
    "run",
    "run_to_its_end",
    "told",
]
