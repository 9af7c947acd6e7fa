"""How a child makes its component: by the name of its class, and what that is given."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from esair import minimal
from esair.actions import Behavior, Reaction, adapt_action
from esair.exceptions import ConfigError
from esair.plan import SCRIPT

_ACTIONS = (Behavior, Reaction, minimal.Reaction)

_SCRIPT = "__mp_main__"
"""What the script is in a child, as `multiprocessing` calls it."""


def find(recipe: dict[str, Any]) -> Any:
    """Return the class that a recipe names, in the child."""
    module = recipe["module"]
    if module == SCRIPT:
        found: Any = _script(recipe["script"])
    else:
        __import__(module)
        found = sys.modules[module]
    for part in recipe["class"].split("."):
        found = getattr(found, part)
    return found


def _script(path: str) -> ModuleType:
    """Import the script that the robot was started with, but not as the one that runs."""
    import runpy

    known = sys.modules.get(_SCRIPT)
    if known is None:
        known = ModuleType(_SCRIPT)
        sys.modules[SCRIPT] = sys.modules[_SCRIPT] = known
        try:
            vars(known).update(runpy.run_path(path, run_name=_SCRIPT))
        except (RuntimeError, ConfigError) as error:  # of the loop that runs here
            told = "a child imports it: put what runs under if __name__ == '__main__':"
            raise ConfigError(path, "", told) from error
    return known


def loaded(recipe: Any) -> Any:
    """Make an action that a child names, in the robot's process.

    Of a class that is loaded there, and is one of an action: nothing is imported for it,
    and nothing but its own constructor is called.

    Raises:
        ConfigError: No class of an action is loaded by this name.
    """
    match recipe:
        case {"module": str(module), "class": str(path), "args": tuple(), **rest}:
            found: Any = sys.modules.get(SCRIPT if module == _SCRIPT else module)
            for part in path.split("."):
                found = getattr(found, "__dict__", {}).get(part)
            if isinstance(found, type) and issubclass(found, _ACTIONS):
                return adapt_action(make(recipe, found))
            told = f"the robot has no class of an action loaded as {module}:{path}"
            told += ": define it at the top of a module that the robot imports"
            raise ConfigError(str(rest.get("name")), "", told)
    raise ConfigError("behaviors", "", f"expected an action, not {recipe!r:.80}")


def make(recipe: dict[str, Any], kind: Any) -> Any:
    """Make a component of its class, and what that is given."""
    if recipe["options"] is None:  # of ESAIR MIN, whose classes keep what they get
        made = kind.__new__(kind)
        vars(made).update(recipe["fields"])
        return made
    return kind(*recipe["args"], **recipe["options"])
