"""What the plugin does with pytest-asyncio: the virtual clock, and leak checks.

It is a module of its own, so that pytest without pytest-asyncio still works.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Literal, get_args

import pytest
import pytest_asyncio

from esair.loop import new_event_loop
from esair.testing._clock import VirtualLoop
from esair.testing._leaks import Leaks
from esair.testing.plugin import on_virtual_clock, uses_kit

LoopFactory = Callable[[], asyncio.AbstractEventLoop]
LoopScope = Literal["function", "class", "module", "package", "session"]


@pytest.hookimpl(trylast=True)
def pytest_asyncio_loop_factories(
    config: pytest.Config, item: pytest.Item
) -> Mapping[str, LoopFactory]:
    """Choose the event loop of a test."""
    if not on_virtual_clock(item):
        return {"real": new_event_loop}
    marker = item.get_closest_marker("virtual_clock")
    seed = marker.kwargs.get("seed") if marker is not None else None
    if seed is None:
        seed = config.getoption("--esair-seed")
    return {"virtual": functools.partial(VirtualLoop, seed=seed)}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Have each test that uses the kit checked for leaks."""
    for item in items:
        if uses_kit(item) and isinstance(
            item, pytest_asyncio.plugin.PytestAsyncioFunction
        ):
            check = f"esair_no_leaks_{_loop_scope(item)}"
            item.fixturenames.insert(_first_of_its_own(item), check)


def _first_of_its_own(item: pytest.Function) -> int:
    """Return where the fixtures of one test begin: what others share is no leak."""
    known = item._fixtureinfo.name2fixturedefs  # noqa: SLF001 - scopes are nowhere else
    shared = (
        place
        for place, name in enumerate(item.fixturenames, 1)
        if name in known and known[name][-1].scope != "function"
    )
    return max(shared, default=0)


def _loop_scope(item: pytest.Item) -> str:
    marker = item.get_closest_marker("asyncio")
    own = marker.kwargs.get("loop_scope") if marker is not None else None
    return str(own or item.config.getini("asyncio_default_test_loop_scope"))


def _no_leaks(loop_scope: LoopScope) -> Callable[[], AsyncIterator[None]]:
    """Make the leak check for the tests that share an event loop in a scope."""

    @pytest_asyncio.fixture(loop_scope=loop_scope, name=f"esair_no_leaks_{loop_scope}")
    async def check() -> AsyncIterator[None]:
        """Fail a test that leaves a task, thread or descriptor behind."""
        leaks = Leaks()
        yield
        found = await leaks.check()
        if found:
            pytest.fail(
                "left behind:\n" + "\n".join(f"  {each}" for each in found),
                pytrace=False,
            )

    return check


for _scope in get_args(LoopScope):
    globals()[f"esair_no_leaks_{_scope}"] = _no_leaks(_scope)
