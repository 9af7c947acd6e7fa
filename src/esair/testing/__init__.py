"""The kit for tests of robots: fakes, a virtual clock, leak checks, contracts."""

from typing import TYPE_CHECKING, Any

from esair.testing._clock import DeadlockError, LivelockError, VirtualLoop
from esair.testing._fakes import FakeActuator, FakeSensor
from esair.testing._leaks import Leaks

if TYPE_CHECKING:
    from esair.testing._bus_contract import BusContract
    from esair.testing._contracts import ActuatorContract, SensorContract
    from esair.testing._fake_can import FakeCan
    from esair.testing._fake_i2c import FakeI2c
    from esair.testing._fake_serial import FakeSerial

__all__ = [
    "ActuatorContract",
    "BusContract",
    "DeadlockError",
    "FakeActuator",
    "FakeCan",
    "FakeI2c",
    "FakeSensor",
    "FakeSerial",
    "Leaks",
    "LivelockError",
    "SensorContract",
    "VirtualLoop",
]

_LATER = {
    # The suites need pytest; the fake buses need the buses.
    "ActuatorContract": "_contracts",
    "BusContract": "_bus_contract",
    "FakeCan": "_fake_can",
    "FakeI2c": "_fake_i2c",
    "FakeSerial": "_fake_serial",
    "SensorContract": "_contracts",
}


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{_LATER[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
