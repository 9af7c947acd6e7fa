"""How a child makes its component: by the name of its class, and what that is given."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from esair.exceptions import ConfigError
from esair.plan import SCRIPT


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

    known = sys.modules.get("__mp_main__")
    if known is None:
        known = ModuleType("__mp_main__")  # as `multiprocessing` does
        sys.modules[SCRIPT] = sys.modules["__mp_main__"] = known
        try:
            vars(known).update(runpy.run_path(path, run_name="__mp_main__"))
        except (RuntimeError, ConfigError) as error:  # of the loop that runs here
            told = "a child imports it: put what runs under if __name__ == '__main__':"
            raise ConfigError(path, "", told) from error
    return known


def make(recipe: dict[str, Any]) -> Any:
    """Make the component, in the child."""
    kind = find(recipe)
    if recipe["options"] is None:  # of ESAIR MIN, whose classes keep what they get
        made = kind.__new__(kind)
        vars(made).update(recipe["fields"])
        return made
    return kind(*recipe["args"], **recipe["options"])
