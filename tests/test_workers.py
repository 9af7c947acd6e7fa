"""The workers that share the tests."""

from __future__ import annotations

import pytest


@pytest.mark.xdist_group("kept")
def test_what_belongs_together_goes_to_one_worker(
    request: pytest.FixtureRequest,
) -> None:
    """Who hands out the tests is told the group by its name behind the test's."""
    if not request.config.getoption("loadgroup", False):
        pytest.skip("it runs on no worker: -n 5 --dist loadgroup")

    assert request.node.nodeid.endswith("@kept")
