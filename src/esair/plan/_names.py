"""Who is in the robot: the right kinds, each with a name of its own, each once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from esair import minimal
from esair.abc import Component
from esair.actions import Behavior, Reaction
from esair.exceptions import ConfigError, EsairError, NameTakenError
from esair.messages import OPERATOR
from esair.plan._finding import Finding, because, mistake
from esair.plan._plan import name_of
from esair.resources import Actuator, Resource, Sensor


def wrong_kind(component: object, *, resource: bool) -> Finding | None:
    """Find what is no resource, or no action, or has no good name."""
    wanted: tuple[type, ...] = (Sensor, Actuator) if resource else (Behavior, Reaction)
    of_min = (minimal.Sensor, minimal.Actuator) if resource else (minimal.Reaction,)
    if not isinstance(component, wanted):
        names = " or ".join(f"esair.{each.__name__}" for each in wanted)
        told, of = f"expected an {names}", repr(component)
        if isinstance(component, type) and issubclass(component, (*wanted, *of_min)):
            of = component.__name__
            told = f"you gave the class: write {of}()"
        return mistake("declaration", component, "", told, of=of)
    assert isinstance(component, Component)
    try:
        if component.name == OPERATOR:
            told = "this is the name in which people act: choose another name="
            raise ConfigError(component.name, "name", told)
    except EsairError as error:
        return because("name", component, error)
    return None


def in_use(component: object) -> bool:
    """Tell whether a component is deployed, in this robot or in another one."""
    if isinstance(component, Resource):
        return component._listener is not None  # noqa: SLF001 - set by a supervisor
    return isinstance(component, Behavior) and "_host" in vars(component)


def used_already(component: Component) -> Finding:
    """Make the finding for a component that a running robot has."""
    told = "it is in a running robot already: make another one for this place"
    return because("name", component, ConfigError(component.name, "", told))


def taken(
    kind: str, about: Iterable[object], everybody: Sequence[object], missing: set[str]
) -> Iterator[Finding]:
    """Find the components whose name another one has."""
    owners: dict[str, object] = {}
    for each in everybody:
        if name := name_of(each):
            owners.setdefault(name, each)
    seen: set[int] = set()
    for component in about:
        name = name_of(component)
        if name is None:
            continue
        again = id(component) in seen
        seen.add(id(component))
        if again or name in missing or owners.get(name, component) is not component:
            yield because("name", component, NameTakenError(kind, name))


def taken_by_another(
    kind: str, component: object, there: Mapping[str, object]
) -> Iterator[Finding]:
    """Find out if the name of a component that comes is another one's."""
    name = name_of(component)
    if name is not None and there.get(name, component) is not component:
        yield because("name", component, NameTakenError(kind, name))
