"""Serial servos of Feetech: STS and SMS series, such as the STS3215, and HLS.

They have a bus of their own kind; the devices on it are the same as for Dynamixel::

    [bus.arm]
    type = "esair.drivers.servo.feetech:FeetechBus"
    port = "usb:1a86:55d3"
    baudrate = 1000000

    [actuator.elbow]
    driver = "servo"
    bus = "arm"
    id = 3
    safe = { mode = "release" }

    pip install 'esair[feetech]'

They have no light: one that restarts is noticed when it had torque, or a speed. Those of the
HLS series have a current mode; their bus says ``series = "hls"``.

Source: Feetech's memory tables of the STS3215 and of the HLS series, and the maker's SDK.
"""

from __future__ import annotations

from typing import Any, Final, Literal

from esair.drivers.servo._bus import FEETECH, FEETECH_HLS, FEETECH_STS, ServoBus
from esair.values import check_choice

_FAULTS = {
    0x01: "input voltage",
    0x02: "angle sensor",
    0x04: "overheating",
    0x08: "too much current",
    0x20: "overload",
}


_TABLES: Final = {"sts": FEETECH_STS, "hls": FEETECH_HLS}


class FeetechBus(ServoBus):
    """The line that servos of Feetech share.

    Args:
        name: The name of the bus.
        series: ``"sts"``, which is that of SMS too, or ``"hls"``.
        baudrate: Bits per second; servos come set to 1 000 000.
        **settings: Those of a `ServoBus`, such as ``port``.
    """

    _framing = FEETECH
    _status = b""
    _word = 1
    _in_turn = False

    def __init__(
        self,
        *,
        name: str,
        series: Literal["sts", "hls"] = "sts",
        baudrate: int = 1_000_000,
        **settings: Any,
    ) -> None:
        super().__init__(name=name, baudrate=baudrate, **settings)
        self.table = _TABLES[check_choice(name, "series", series, _TABLES)]

    async def ping(self, servo: int) -> int:
        """Return the model number of a servo, which is in its table; errors as there."""
        await super().ping(servo)
        return await self.read(servo, 3, 2)

    def _faults(self, error: int) -> str:
        return ", ".join(text for bit, text in _FAULTS.items() if error & bit)
