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

Source: Feetech's memory tables of the STS3215 and of the HLS series; the packets are made
and checked by the maker's SDK, in the package ``feetech-servo-sdk``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Literal

from esair.drivers.servo._bus import ServoBus
from esair.drivers.servo._line import SdkPort, ServoLink
from esair.drivers.servo._tables import FEETECH_HLS, FEETECH_STS
from esair.exceptions import ConfigError, describe
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
        port: A device file, or ``usb:VID:PID[:SERIAL]``.
        baudrate: Bits per second; servos come set to 1 000 000.
        timeout: How long one request may take, its turn included, in seconds.
        opener: Opens something else than a port, such as a fake; may block.
    """

    _rx_timeout = -6
    _rx_corrupt = -7

    def __init__(
        self,
        *,
        name: str,
        series: Literal["sts", "hls"] = "sts",
        port: str = "",
        baudrate: int = 1_000_000,
        timeout: float = 0.5,
        opener: Callable[[], ServoLink] | None = None,
    ) -> None:
        super().__init__(
            name=name, port=port, baudrate=baudrate, timeout=timeout, opener=opener
        )
        self.table = _TABLES[check_choice(name, "series", series, _TABLES)]

    def _make_handler(self) -> Any:
        try:
            from scservo_sdk import PacketHandler
        except ImportError as error:
            raise ConfigError(
                self.name, "type", f"pip install 'esair[feetech]': {describe(error)}"
            ) from error
        return PacketHandler(0)  # low byte first, as the STS and SMS series

    def _sync_read(
        self, handler: Any, link: SdkPort, address: int, size: int, servos: list[int]
    ) -> int:
        code: int = handler.syncReadTx(link, address, size, servos, len(servos))
        return code

    def _faults(self, error: int) -> str:
        return ", ".join(text for bit, text in _FAULTS.items() if error & bit)
