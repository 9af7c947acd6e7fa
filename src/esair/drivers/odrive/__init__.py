"""An axis of an ODrive motor controller, over CAN.

The axis is set up with the maker's tools: calibrated, with its node id, its limits, and
the rates at which it tells its heartbeat and its encoder estimates. Set its watchdog
too (``axis.config.watchdog_timeout`` and ``enable_watchdog``) and say so with
``own_timeout``: nothing else stops the motor when this computer dies.

Source: ODrive documentation, "CAN Protocol" (CANSimple), firmware 0.6; the names of the
messages and of the error bits are those of that page. The controller counts in turns;
everything here is in rad.
"""

from esair.drivers.odrive._axis import AxisReading, OdriveAxis, OdriveState
from esair.drivers.odrive._codec import (
    AxisError,
    AxisState,
    ControlMode,
    FrameError,
    Heartbeat,
    Message,
    decode,
    decode_estimates,
    decode_heartbeat,
    decode_input,
    encode,
    encode_estimates,
    encode_heartbeat,
    encode_input,
    encode_mode,
    frame_id,
)

__all__ = [
    "AxisError",
    "AxisReading",
    "AxisState",
    "ControlMode",
    "FrameError",
    "Heartbeat",
    "Message",
    "OdriveAxis",
    "OdriveState",
    "decode",
    "decode_estimates",
    "decode_heartbeat",
    "decode_input",
    "encode",
    "encode_estimates",
    "encode_heartbeat",
    "encode_input",
    "encode_mode",
    "frame_id",
]
