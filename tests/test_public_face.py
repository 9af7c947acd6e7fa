"""The names that stay fixed, and what importing them costs."""

from __future__ import annotations

import inspect
import runpy
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.actions import ActuatorPort, SensorPort
from esair.testing import FakeActuator, FakeSensor

ROOT = Path(__file__).parent.parent


def parameters(function: Any) -> list[str]:
    """Name the parameters, ``*`` before those that are by name only."""
    names: list[str] = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name == "self":
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in names:
            names.append("*")
        stars = {parameter.VAR_KEYWORD: "**", parameter.VAR_POSITIONAL: "*"}
        prefix = next(
            (star for kind, star in stars.items() if kind is parameter.kind), ""
        )
        names.append(prefix + parameter.name)
    return names


FIXED: list[tuple[Any, str]] = [
    (esair.Robot, "* name resources behaviors policies"),
    (esair.Robot.from_config, "path"),
    (esair.run, "robot"),
    (esair.every, "period"),
    (esair.new_event_loop, ""),
    (esair.reads, "type * name max_age every optional configure"),
    (esair.writes, "type * name priority hold blind configure"),
    (esair.guards, "type * name priority latch"),
    (esair.works, "*partners * within idle"),
    (esair.BehaviorSupervisor.remove, "name"),
    (esair.BehaviorSupervisor.put, "data * sender receiver interval"),
    (esair.BehaviorSupervisor.get, "* sender receiver interval"),
    (esair.BehaviorSupervisor.query, "name"),
    (esair.BehaviorSupervisor.command, "text"),
    (esair.ResourceSupervisor.remove, "name"),
    (esair.ResourceSupervisor.register, "behavior resource access"),
    (esair.ResourceSupervisor.configure, "registration **settings"),
    (esair.ResourceSupervisor.why, "name"),
    (esair.Behavior.put, "receiver data interval"),
    (esair.Behavior.get, "sender interval"),
    (esair.Behavior.receive, ""),
    (esair.Behavior.offer, "data"),
    (esair.Behavior.provide, ""),
    (esair.Behavior.perform, "reaction * until timeout"),
    (esair.Behavior.register, "resource access"),
    (SensorPort.read, "* fresh max_age timeout"),
    (SensorPort.reading, ""),
    (SensorPort.history, "count"),
    (SensorPort.configure, "**settings"),
    (ActuatorPort.write, "command * hold"),
    (ActuatorPort.release, ""),
    (ActuatorPort.configure, "**settings"),
    (esair.Policy, "resource allow * exclusive"),
    (esair.Written, "command asked by"),
    (esair.Refused, "holder priority rule since until"),
    (FakeSensor.feed, "value"),
    (FakeActuator.until, "wanted * timeout"),
    (FakeActuator.fail, "error * after"),
]


def _id(each: object) -> str:
    return str(getattr(each, "__qualname__", each))[:60]


@pytest.mark.parametrize(("function", "wanted"), FIXED, ids=_id)
def test_fixed_signatures_stay(function: Any, wanted: str) -> None:
    """Scripts depend on these names; more may come after them, none may go."""
    have = parameters(function)

    assert [name for name in have if name in wanted.split()] == wanted.split()


@pytest.mark.parametrize(
    "supervisor", [esair.BehaviorSupervisor, esair.ResourceSupervisor]
)
def test_both_supervisors_add_remove_and_replace(supervisor: Any) -> None:
    """The same three words for behaviors and for resources."""
    assert len(parameters(supervisor.add)) == 1
    assert parameters(supervisor.remove) == ["name"]
    assert len(parameters(supervisor.replace)) == 2
    assert parameters(supervisor.replace)[0] == "name"


def test_the_fixed_names_are_exported() -> None:
    """Bases, leaves, messages and functions of the contract."""
    wanted = [
        "Robot",
        "run",
        "every",
        "new_event_loop",
        "reads",
        "writes",
        "guards",
        "HOLD",
        "setting",
        "Supervisor",
        "Action",
        "Connection",
        "Resource",
        "BehaviorSupervisor",
        "ResourceSupervisor",
        "Behavior",
        "Reaction",
        "SensorConnection",
        "ActuatorConnection",
        "Sensor",
        "Actuator",
        "Reading",
        "Stamped",
        "Access",
        "Policy",
        "Restart",
        "BehaviorState",
        "ResourceState",
        "SupervisorPhase",
        "Written",
        "Refused",
    ]

    assert set(wanted) <= set(esair.__all__)
    assert all(hasattr(esair, name) for name in esair.__all__)
    constants_first = sorted(esair.__all__, key=lambda each: (not each.isupper(), each))
    assert constants_first == list(esair.__all__)


def test_the_four_bases_and_eight_leaves() -> None:
    """The tree of the architecture is the tree of the classes."""
    tree = {
        esair.Supervisor: (esair.BehaviorSupervisor, esair.ResourceSupervisor),
        esair.Action: (esair.Behavior, esair.Reaction),
        esair.Connection: (esair.SensorConnection, esair.ActuatorConnection),
        esair.Resource: (esair.Sensor, esair.Actuator),
    }
    for base, leaves in tree.items():
        for leaf in leaves:
            assert issubclass(leaf, base)


def test_the_values_of_the_contract() -> None:
    """States, rights and defaults that scripts compare with."""
    assert [s.name for s in esair.ResourceState] == [
        "CLOSED", "OPENING", "READY", "LOST", "FAILED", "REMOVED",
    ]  # fmt: skip
    assert [p.name for p in esair.SupervisorPhase] == [
        "INITIALIZING", "WAIT_REQUEST", "HANDLING_REQUEST", "STOPPED",
    ]  # fmt: skip
    assert [a.name for a in esair.Access] == ["READ", "WRITE", "CONFIGURE", "GUARD"]
    assert esair.Reading._fields == ("value", "time", "sequence")
    assert esair.Actuator.command_timeout == 0.2
    assert esair.Sensor.rate.default == 10.0  # type: ignore[attr-defined]
    assert esair.Behavior.inbox_size == 16
    assert (esair.Restart().max, esair.Restart().within) == (3, 30.0)
    assert not esair.Refused("a", 1, "b", 0.0, 1.0)
    assert esair.Written(None)


@pytest.mark.real_clock
def test_importing_esair_loads_no_bus_and_no_command_line() -> None:
    """Nor anything until a name is used, and then all that the others need, too."""
    script = """
    import sys
    import esair
    import esair.minimal
    print(*sorted(each for each in sys.modules if each.startswith("esair")))
    esair.Reaction
    heavy = {"serial", "serial_asyncio", "can", "smbus2", "cyclopts", "rich", "pymunk",
             "matplotlib", "pytest", "cantools", "numpy", "hypothesis"}
    print(*sorted(heavy & set(sys.modules)))
    loaded = set(sys.modules)
    for name in esair.__all__:
        getattr(esair, name)
    print(*sorted(set(sys.modules) - loaded))
    """
    output = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip

    assert output.stdout.splitlines() == ["esair esair.minimal", "", ""]


def test_a_name_that_is_none_is_told_as_of_any_module() -> None:
    """Those of the package's own modules are found, imported or not."""
    with pytest.raises(AttributeError, match="module 'esair' has no attribute 'Robt'"):
        assert esair.Robt  # type: ignore[attr-defined]
    assert esair.discovery.__name__ == "esair.discovery"  # type: ignore[attr-defined]
    assert set(esair.__all__) <= set(dir(esair))


def test_the_package_says_that_it_is_typed() -> None:
    """Type checkers look for py.typed."""
    assert (Path(esair.__file__).parent / "py.typed").exists()


def test_another_system_is_told_what_it_is_not_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whoever tries it on Windows, or a watchdog elsewhere, reads why it cannot be."""
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(ImportError, match="not on Windows: use it in WSL"):
        runpy.run_path(str(ROOT / "src/esair/loop/_signals.py"))
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(esair.ConfigError, match="watchdog: expected Linux"):
        esair.Robot(watchdog=True)
