"""Tests on a second kernel, which has the devices; skipped where it is not."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
KERNEL = os.environ.get("WITH_LINUX_DEVICES", "")

if KERNEL:  # for usb_parts, the emulated devices
    sys.path.insert(0, str(HERE / "hw"))


def pytest_configure(config: pytest.Config) -> None:
    """Describe the marker."""
    config.addinivalue_line(
        "markers",
        "kernel(kind, udev=False): needs this kind of kernel ('built' has USB and GPIO), "
        "and udev running on it",
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what this kernel does not have, and say how to get it."""
    for item in items:
        if HERE in item.path.parents and (reason := _missing(item)):
            item.add_marker(pytest.mark.skip(reason=reason))


def _missing(item: pytest.Item) -> str:
    if not KERNEL:
        return "needs another kernel: tests/kernel/run"
    for marker in item.iter_markers("kernel"):
        if marker.args and KERNEL not in marker.args:
            return f"needs the {marker.args[0]} kernel: tests/kernel/run --kernel built"
        if marker.kwargs.get("udev") and not Path("/run/udev/control").exists():
            return "needs udev on the other kernel: apt-get install udev"
    return ""
