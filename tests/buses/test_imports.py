"""What importing costs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import esair.buses

_SHOW = """
import sys
print(sorted({"serial", "serial_asyncio", "can", "smbus2", "spidev"} & set(sys.modules)))
"""


@pytest.mark.parametrize(
    "statement",
    [
        "import esair.buses",
        "import esair",
        "from esair.buses import SerialBus, CanBus, I2CBus; "
        "SerialBus(name='a', port='/dev/x'); CanBus(name='b', channel='can0'); "
        "I2CBus(name='c')",
    ],
)
def test_no_bus_package_is_imported_before_a_bus_is_opened(statement: str) -> None:
    """Neither the import nor the making of a bus needs its package."""
    run = subprocess.run(
        [sys.executable, "-c", f"{statement}\n{_SHOW}"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )

    assert run.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    """What is loaded late is found under its name, and nothing else is."""
    for name in esair.buses.__all__:
        assert getattr(esair.buses, name) is not None
    assert set(esair.buses.__all__) <= set(dir(esair.buses))
    with pytest.raises(AttributeError, match="ModemBus"):
        _ = esair.buses.ModemBus
