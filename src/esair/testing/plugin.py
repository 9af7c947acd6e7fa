"""The pytest plugin: fixtures that hand out fakes, a virtual clock, leak checks.

Tests that use one of the fixtures, or the marker ``virtual_clock``, run on a virtual
clock unless they are marked ``real_clock``; a task, thread or descriptor that they
leave behind fails them. An asynchronous test that something else than pytest-asyncio
would run (anyio's plugin, nothing at all) fails and says so, unless it is marked
``real_clock``.
"""

from __future__ import annotations

import inspect
import unittest
from collections.abc import Callable
from typing import Any, TypeVar

import pytest

from esair.buses import MEDIA, Medium
from esair.testing._fakes import FakeActuator, FakeSensor

C = TypeVar("C")

FIXTURES = frozenset(
    {"fake_sensor", "fake_actuator", *(f"fake_{kind}" for kind in MEDIA)}
)
"""Who uses one of these runs on the virtual clock, unless marked ``real_clock``."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the order of tasks."""
    parser.getgroup("esair").addoption(
        "--esair-seed",
        type=int,
        default=0,
        metavar="N",
        help="order of tasks on the virtual clock; 0 keeps the order they are ready in",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Describe the markers; do more where pytest-asyncio is at work."""
    if has_clock(config):
        config.pluginmanager.import_plugin("esair.testing._asyncio_plugin")
    for line in (
        "virtual_clock(seed=N): run on a virtual clock, with this order of tasks",
        "real_clock: run in real time, with real threads and descriptors",
        "placements: run once for each kind of placement; see the fixture place",
    ):
        config.addinivalue_line("markers", line)


def has_clock(config: pytest.Config) -> bool:
    """Tell whether a pytest-asyncio is at work that can be given an event loop."""
    return hasattr(config.hook, "pytest_asyncio_loop_factories")


def uses_kit(item: pytest.Item) -> bool:
    """Tell whether a test uses a fixture or marker of the kit."""
    names = getattr(item, "fixturenames", ())
    return bool(FIXTURES.intersection(names)) or any(
        item.get_closest_marker(marker) for marker in ("virtual_clock", "real_clock")
    )


def on_virtual_clock(item: pytest.Item) -> bool:
    """Tell whether a test is to run on the virtual clock."""
    return uses_kit(item) and item.get_closest_marker("real_clock") is None


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test once for each kind of placement that it is marked with."""
    if metafunc.definition.get_closest_marker("placements") is not None:
        if "place" not in metafunc.fixturenames:
            metafunc.fixturenames.append("place")  # its suite asks for it
        metafunc.parametrize("place", ["task", "process"], indirect=True)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Fail a test that would not run on the clock which it is promised."""
    asynchronous = inspect.iscoroutinefunction(getattr(item, "function", None))
    by_anyio = "anyio_backend" in getattr(item, "fixturenames", ())
    by_asyncio = has_clock(item.config) and item.get_closest_marker("asyncio")
    told = ""
    if on_virtual_clock(item) and asynchronous and (by_anyio or not by_asyncio):
        told = (
            "only pytest-asyncio runs a test: pip install 'esair[test]', set"
            ' asyncio_mode = "auto" (or mark the test asyncio), and take the marker'
            " anyio away; or mark it real_clock"
        )
        if issubclass(getattr(item, "cls", None) or object, unittest.TestCase):
            told = (
                "no unittest.TestCase is run: write a plain class; or mark an"
                " IsolatedAsyncioTestCase real_clock"
            )
    marked = any(mark.name == "virtual_clock" for mark in item.own_markers)
    if marked and on_virtual_clock(item) and not asynchronous and not by_asyncio:
        told = "only async def runs: write it, or take the marker virtual_clock away"
    if told:
        pytest.fail(f"on the virtual clock of esair {told}", pytrace=False)


@pytest.fixture
def place(request: pytest.FixtureRequest) -> Callable[[C], C]:
    """Hand out what puts a component where this run of the test has it.

    In a test that is marked ``placements``: in the robot's process, then in one of its
    own. What the rulebook refuses to place is a reason to skip the second run.
    """
    from esair.actions import adapt_action
    from esair.plan import unplaceable
    from esair.resources import adapt_resource

    def put(component: C) -> C:
        if getattr(request, "param", "task") == "process":
            component.placement = "process"  # type: ignore[attr-defined]
            for finding in unplaceable(adapt_action(adapt_resource(component))):
                pytest.skip(f"the rulebook refuses it: {finding.text}")
        return component

    return put


@pytest.fixture
def fake_sensor() -> Callable[..., FakeSensor[Any]]:
    """Hand out the class `FakeSensor`, to be called like a function."""
    return FakeSensor


@pytest.fixture
def fake_actuator() -> Callable[..., FakeActuator[Any]]:
    """Hand out the class `FakeActuator`, to be called like a function."""
    return FakeActuator


def _fake_bus(kind: str, medium: Medium) -> Callable[..., Any]:
    """Make the fixture of the fake of a medium."""

    @pytest.fixture(name=f"fake_{kind}")
    def hand_out() -> Callable[..., Any]:
        """Hand out the class of fake buses, to be called like a function."""
        found: Callable[..., Any] = medium.get(medium.fake)
        return found

    return hand_out


for _kind, _medium in MEDIA.items():
    globals()[f"fake_{_kind}"] = _fake_bus(_kind, _medium)
