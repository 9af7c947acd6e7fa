"""The kit for tests of robots: fakes, a virtual clock, leak checks, contracts."""

from typing import TYPE_CHECKING, Any

from esair.testing._clock import DeadlockError, LivelockError, VirtualLoop
from esair.testing._fakes import FakeActuator, FakeSensor
from esair.testing._leaks import Leaks

if TYPE_CHECKING:
    from esair.testing._contracts import ActuatorContract, SensorContract

__all__ = [
    "ActuatorContract",
    "DeadlockError",
    "FakeActuator",
    "FakeSensor",
    "Leaks",
    "LivelockError",
    "SensorContract",
    "VirtualLoop",
]


def __getattr__(name: str) -> Any:
    # The suites need pytest; the clock and the fakes serve without it.
    if name in {"ActuatorContract", "SensorContract"}:
        from esair.testing import _contracts

        return getattr(_contracts, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
