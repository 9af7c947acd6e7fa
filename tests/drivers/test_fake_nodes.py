"""Fake nodes of a CAN bus that speak by themselves."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from esair.buses.can import FakeCan
from esair.drivers.canopen.fake_drive import FakeDrive
from esair.drivers.odrive.fake import FakeOdrive


@pytest.mark.parametrize("make", [FakeDrive, FakeOdrive])
def test_a_node_that_is_made_too_early_says_where_to_make_it(
    make: Callable[..., object],
) -> None:
    """In a plain fixture, or at the top of a file, there is no clock to beat by."""
    with pytest.raises(RuntimeError, match=r"Fake\w+: .* an `async def` fixture"):
        make(FakeCan("drive"), node=5)
