"""The pytest plugin: fixtures that hand out fakes, a virtual clock, leak checks.

Tests that use one of the fixtures, or the marker ``virtual_clock``, run on a virtual
clock unless they are marked ``real_clock``; a task, thread or descriptor that they
leave behind fails them. Without pytest-asyncio only the fixtures are there.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import pytest

from esair.buses import MEDIA, Medium
from esair.testing._fakes import FakeActuator, FakeSensor


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
    """Describe the markers; do more where pytest-asyncio is."""
    if importlib.util.find_spec("pytest_asyncio") is not None:
        config.pluginmanager.import_plugin("esair.testing._asyncio_plugin")
    for line in (
        "virtual_clock(seed=N): run on a virtual clock, with this order of tasks",
        "real_clock: run in real time, with real threads and descriptors",
    ):
        config.addinivalue_line("markers", line)


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
