"""The kit for tests of robots: fakes, a virtual clock, leak checks, contracts.

The fakes of buses and parts are far ends with words for a test; each is beside what it
imitates, in `esair.buses` and `esair.drivers`, and is handed out here.
"""

from typing import TYPE_CHECKING, Any

from esair.buses import MEDIA
from esair.loading import late
from esair.testing._clock import BlockedError, DeadlockError, LivelockError, VirtualLoop
from esair.testing._fakes import FakeActuator, FakeSensor
from esair.testing._leaks import Leaks

if TYPE_CHECKING:
    from esair.buses.can import FakeCan
    from esair.buses.i2c import FakeI2c
    from esair.buses.mqtt import FakeMqtt
    from esair.buses.serial import FakeSerial
    from esair.buses.spi import FakeSpi
    from esair.testing._contracts import (
        ActuatorContract,
        BusContract,
        GatewayContract,
        SensorContract,
    )
    from esair.testing._recorded import RecordedRun, RecordedSensor, recording

__all__ = [
    "ActuatorContract",
    "BlockedError",
    "BusContract",
    "DeadlockError",
    "FakeActuator",
    "FakeCan",
    "FakeI2c",
    "FakeMqtt",
    "FakeSensor",
    "FakeSerial",
    "FakeSpi",
    "GatewayContract",
    "Leaks",
    "LivelockError",
    "RecordedRun",
    "RecordedSensor",
    "SensorContract",
    "VirtualLoop",
    "recording",
]

_get, _ = late(
    __name__,
    {
        # The suites need pytest.
        "_contracts": "ActuatorContract BusContract GatewayContract SensorContract",
        # Recordings need ``esair[record]``.
        "_recorded": "RecordedRun RecordedSensor recording",
    },
)


def __getattr__(name: str) -> Any:
    for medium in MEDIA.values():
        if medium.fake == name:
            return medium.get(name)
    return _get(name)


def __dir__() -> list[str]:
    return sorted(__all__)
