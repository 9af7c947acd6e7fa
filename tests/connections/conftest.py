"""Behaviors that hold ports for a test to use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import esair


@pytest.fixture
def user_of() -> Callable[..., Any]:
    """Make a behavior that does nothing but hold the ports that it declares."""

    def make(name: str, **needs: Any) -> Any:
        reads = {
            key: need for key, need in needs.items() if type(need).__name__ == "Reads"
        }
        writes = {key: need for key, need in needs.items() if key not in reads}
        return esair.Behavior(name=name, reads=reads, writes=writes)

    return make
