"""The one rulebook: a robot's description, and what is wrong with it.

What is a mistake of the developer is decided here and nowhere else, for a robot from a
file, from a script, and for each component that comes into a running one::

    plan = Plan(resources=[sonar, wheels], behaviors=[Avoid()])
    for finding in examine(plan):
        print(finding.severity.value, finding.component, finding.text)

A new rule goes into the file of its subject, and is asked in ``_examine.py``.
"""

from esair.codec import inner_of
from esair.plan._declarations import SCRIPT, plain_mistakes, recipe_of, unplaceable
from esair.plan._examine import (
    examine,
    examine_action,
    examine_resource,
    examine_step,
    failures,
    in_use,
    used_already,
)
from esair.plan._needs import denial, depths, not_alone, unmet
from esair.plan._plan import Finding, Plan, Severity, errors_in, refuse
from esair.plan._protection import (
    KEEPS_ON,
    UNWATCHED,
    Guard,
    Protection,
    Writer,
    protection,
    when_alone,
    when_dead,
)

__all__ = [
    "KEEPS_ON",
    "SCRIPT",
    "UNWATCHED",
    "Finding",
    "Guard",
    "Plan",
    "Protection",
    "Severity",
    "Writer",
    "denial",
    "depths",
    "errors_in",
    "examine",
    "examine_action",
    "examine_resource",
    "examine_step",
    "failures",
    "in_use",
    "inner_of",
    "not_alone",
    "plain_mistakes",
    "protection",
    "recipe_of",
    "refuse",
    "unmet",
    "unplaceable",
    "used_already",
    "when_alone",
    "when_dead",
]
