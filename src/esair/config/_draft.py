"""What could be made of a file so far: its parts, and where each is in the file."""

from __future__ import annotations

from typing import Any, Final

import attrs

from esair.actions import ProfiledAction
from esair.buses import Bus
from esair.config._mistakes import below
from esair.config._source import Source
from esair.messages import BehaviorsPolicy, Mode, Modes, Policy
from esair.plan import Finding, Plan
from esair.resources import Resource

BEHAVIORS: Final = "behaviors"
"""The table of those who may manage others; no resource's."""


@attrs.frozen(eq=False)
class Part:
    """One table of a file, and what was made of it."""

    kind: str  # ``bus``, ``sensor``, ``actuator`` or ``behavior``
    name: str
    made: Any  # The object; None if that failed, for a reason that was told
    bus: str | None = None  # The name of the bus that the table names

    @property
    def key(self) -> str:
        """Its key in the file."""
        return f"{self.kind}.{self.name}"


@attrs.frozen
class Variant:
    """One table, real or simulated."""

    table: dict[str, Any]
    keys: dict[str, str]  # The key in the file of each
    # What a simulated device has from the real one's table
    inherited: frozenset[str] = frozenset()
    is_simulated: bool = False  # Whether there was a table ``sim``


@attrs.define
class Draft:
    """What could be made of a file. Parts with mistakes are there, but not made."""

    source: Source
    simulated: bool  # Whether the ``sim`` tables were used
    robot: dict[str, Any] = attrs.field(factory=dict)
    # The buses, resources and actions, in this order
    parts: list[Part] = attrs.field(factory=list)
    # Who may do what with a resource, by the name of the resource; under ``behaviors``
    # who may manage others
    policies: dict[str, Policy | BehaviorsPolicy] = attrs.field(factory=dict)

    peers: Any = None  # What the file says of peers; None if nothing

    @property
    def buses(self) -> dict[str, Bus | None]:
        """The buses by name; None for one that could not be made."""
        return {each.name: each.made for each in self.parts if each.kind == "bus"}

    def made(self, kind: type) -> dict[str, Any]:
        """Return the parts of a kind that could be made, by name."""
        return {
            each.name: each.made for each in self.parts if isinstance(each.made, kind)
        }

    def plan(self) -> Plan:
        """Return the robot as the rulebook sees it."""
        made = [each.made for each in self.parts]
        return Plan(
            name=str(self.robot.get("name", "robot")),
            resources=[each for each in made if isinstance(each, Resource)],
            behaviors=[each for each in made if isinstance(each, ProfiledAction)],
            policies=list(self.policies.values()),
            modes=Modes(self.robot.get("modes", {}), self.robot.get("mode")),
            buses=self.made(Bus),
            implied=self.source.implied,
            watchdog=self.robot.get("watchdog") is True,
            missing={
                each.name: each.kind
                for each in self.parts
                if each.made is None and each.kind != "bus"
            },
        )

    def key_of(self, finding: Finding) -> str:
        """Return the key in the file that a finding is about."""
        key = "robot"
        for part in self.parts:
            if part.made is finding.subject and part.made is not None:
                key = part.key
        if isinstance(finding.subject, Mode):
            return ".".join(filter(None, (finding.component, finding.field)))
        if isinstance(finding.subject, Policy | BehaviorsPolicy):
            about = getattr(finding.subject, "resource", BEHAVIORS)
            key = below("access", about)
            field = finding.field.removeprefix("allow").removeprefix(".")
            return key if field in {"", "resource"} else f"{key}.{field}"
        if not finding.field:
            return key
        port, dot, rest = finding.field.partition(".")
        for flow in ("reads", "writes"):
            named = self.source.value(f"{key}.{flow}.{port}")
            if named is not None:
                return f"{key}.{flow}.{port}{dot}{rest}"
        return f"{key}.{finding.field}"
