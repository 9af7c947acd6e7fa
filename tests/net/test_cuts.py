"""Two processes over zenoh and TCP, in two network namespaces: cuts, loss and stops."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from tests.net.cuts import KINDS, LOST, TIMEOUT, cuts

pytest.importorskip("zenoh")
pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.soak,
    pytest.mark.promise("NET-3", "NET-4"),
]


@pytest.fixture
def namespaces() -> None:
    """Skip where no network namespace can be made."""
    if shutil.which("ip") is None or not os.access("/dev/net/tun", os.W_OK):
        pytest.skip("needs the program ip, and /dev/net/tun")
    name = f"try{os.getpid()}"
    made = subprocess.run(
        ["ip", "netns", "add", name], capture_output=True, check=False
    )
    if made.returncode != 0 or not Path(f"/run/netns/{name}").exists():
        pytest.skip(f"no network namespaces here: {made.stderr.decode().strip()}")
    subprocess.run(["ip", "netns", "del", name], check=True)


@pytest.mark.usefixtures("namespaces")
@pytest.mark.parametrize(
    ("count", "kinds", "delay", "loss"),
    [
        *((100, (kind,), 0.005, 0.0) for kind in KINDS),
        (50, ("cut",), 0.02, 0.02),
        (100, KINDS, 0.01, 0.05),
    ],
    ids=[*KINDS, "far", "bad"],
)
def test_cuts(count: int, kinds: tuple[str, ...], delay: float, loss: float) -> None:
    """No old command, safe in time, soon back by itself: also where packets are lost."""
    found = list(cuts(count, kinds=kinds, delay=delay, loss=loss))

    assert sum(each.old for each in found) == 0
    assert max(each.safe for each in found if each.safe is not None) < TIMEOUT + 0.05
    assert max(each.lost for each in found if each.lost is not None) < LOST
    late = [each for each in found if each.fresh is None or each.fresh > 0.5]
    assert late == []
