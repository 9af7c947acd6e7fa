"""A driver whose package is missing says what to install."""

import importlib
import sys

import pytest


@pytest.mark.parametrize(
    ("driver", "package"),
    [
        ("canopen", "canopen"),
        ("dbc", "cantools"),
        ("gps", "pynmeagps"),
        ("mavlink", "pymavlink"),
        ("modbus", "pymodbus"),
        ("servo", "dynamixel_sdk"),
        ("uds", "isotp"),
    ],
)
def test_a_driver_without_its_package_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, driver: str, package: str
) -> None:
    """The name of the missing package stays in the error."""
    for name in tuple(sys.modules):
        if name.partition(".")[0] == package or name.startswith(
            f"esair.drivers.{driver}"
        ):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)

    with pytest.raises(ModuleNotFoundError, match=rf"'esair\[{driver}\]'") as caught:
        importlib.import_module(f"esair.drivers.{driver}")

    assert caught.value.name.partition(".")[0] == package
