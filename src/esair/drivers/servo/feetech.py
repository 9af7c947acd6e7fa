"""Serial servos of Feetech, STS and SMS series, such as the STS3215.

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

They have no current mode, and no light: one that restarts is noticed when it had torque.

Source: Feetech's memory table of the STS3215; the packets are made and checked by the
maker's SDK, in the package ``feetech-servo-sdk``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from esair.drivers.servo._bus import ServoBus
from esair.drivers.servo._line import SdkPort, ServoLink
from esair.drivers.servo._tables import FEETECH_STS
from esair.exceptions import ConfigError, describe

_FAULTS = {
    0x01: "input voltage",
    0x02: "angle sensor",
    0x04: "overheating",
    0x08: "too much current",
    0x20: "overload",
}


class FeetechBus(ServoBus):
    """The line that servos of Feetech share; args as those of `ServoBus`.

    They come set to 1 000 000 bits per second.
    """

    table = FEETECH_STS
    _rx_timeout = -6
    _rx_corrupt = -7

    def __init__(
        self,
        *,
        name: str,
        port: str = "",
        baudrate: int = 1_000_000,
        timeout: float = 0.5,
        opener: Callable[[], ServoLink] | None = None,
    ) -> None:
        super().__init__(
            name=name, port=port, baudrate=baudrate, timeout=timeout, opener=opener
        )

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
