"""The names that stay fixed, and what importing them costs."""

from __future__ import annotations

import inspect
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

FIRST_SCRIPT = """
import attrs
import esair


@attrs.frozen
class Twist:
    linear: float  # m/s
    angular: float  # rad/s


class Avoid(esair.Reaction):
    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(Twist, priority=10)

    def react(self, sonar: float) -> Twist | None:
        return Twist(0.0, 1.2) if sonar < 0.4 else None


class Wander(esair.Behavior):
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(Twist(0.3, 0.0))
"""

TYPES = """
from collections.abc import AsyncIterator
from typing import assert_type


class Look(esair.Behavior):
    sonar = esair.reads(float)
    wheels = esair.writes(Twist)

    async def run(self) -> None:
        assert_type(await self.sonar.read(), float)
        assert_type(await self.sonar.read(fresh=True, max_age=0.1, timeout=0.5), float)
        assert_type(await self.sonar.reading(), esair.Reading[float])
        assert_type(self.sonar.history(3), list[esair.Reading[float]])
        async for value in self.sonar:
            assert_type(value, float)
        written = await self.wheels.write(Twist(0.0, 0.0), hold=0.5)
        assert_type(written, esair.Written[Twist] | esair.Refused)
        if isinstance(written, esair.Written):
            assert_type(written.command, Twist)
        await self.wheels.write(1.0)  # type: ignore[arg-type]


class Sonar(esair.Sensor[float]):
    rate = esair.setting(20.0, unit="Hz")
    gain = esair.setting(3, min=0)

    async def open(self) -> None: ...

    async def read(self) -> float:
        assert_type(self.gain, int)
        return 1.0


class Blocking(esair.Sensor[float]):
    def open(self) -> None: ...

    def read(self) -> float:
        return 1.0


class Radar(esair.Sensor[float]):
    async def stream(self) -> AsyncIterator[float]:
        yield 1.0


class Wheels(esair.Actuator[Twist]):
    safe = Twist(0.0, 0.0)
    command_timeout = 0.2

    async def write(self, command: Twist) -> Twist | None:
        return None


robot = esair.Robot(
    resources=[Sonar(rate=10.0), Blocking(name="b"), Radar(), Wheels()],
    behaviors=[Avoid(), Wander(), Look()],
    policies=[
        esair.Policy(
            "wheels",
            allow={"wander": esair.Access.WRITE, "*": esair.Access.WRITE},
            exclusive=False,
        )
    ],
)
"""


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
    (esair.reads, "type * name max_age every optional configure"),
    (esair.writes, "type * name priority hold blind configure"),
    (esair.guards, "type * name priority latch"),
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


@pytest.mark.parametrize(("function", "wanted"), FIXED, ids=lambda each: str(each)[:60])
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
    """`import esair` is cheap: heavy packages come with what needs them."""
    script = """
    import sys
    import esair
    heavy = {"serial", "serial_asyncio", "can", "smbus2", "cyclopts", "rich", "pymunk",
             "matplotlib", "pytest", "cantools", "numpy", "hypothesis"}
    print(*sorted(heavy & set(sys.modules)))
    """
    output = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True, text=True, check=True, timeout=30,
    )  # fmt: skip

    assert output.stdout.strip() == ""


@pytest.mark.real_clock
def test_the_first_script_is_fully_typed(tmp_path: Path) -> None:
    """mypy strict knows what every port reads and writes."""
    script = tmp_path / "script.py"
    script.write_text(FIRST_SCRIPT + TYPES)

    checked = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-incremental",
         "--follow-imports=silent", "--config-file=", str(script)],
        capture_output=True, text=True, check=False, timeout=120, cwd=tmp_path,
        env={"MYPYPATH": str(ROOT / "src"), "PATH": ""},
    )  # fmt: skip

    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_the_package_says_that_it_is_typed() -> None:
    """Type checkers look for py.typed."""
    assert (Path(esair.__file__).parent / "py.typed").exists()
