"""Objects of a CANopen node: read, received in a PDO, or written.

The objects are those of the node's EDS or DCF file, by name or by index::

    [sensor.position]
    driver = "canopen"
    bus = "drive"
    node = 5
    eds = "motor.eds"
    object = "Position actual value"        # or [0x6064, 0]

    [actuator.velocity]
    driver = "canopen"
    bus = "drive"
    node = 5
    eds = "motor.eds"
    object = "Target velocity"
    safe = 0

All devices on one node share its opening: its identity is compared with the file, its
heartbeat is watched, and it is started. Objects go through the package canopen, which
waits for its answers, so it has a thread of its own for each bus; the frames go through
the `esair.buses.CanBus` like all others, each with a deadline.

Source: CiA 301 (object dictionary, SDO, PDO, NMT, heartbeat); CiA 306 (EDS and DCF).
"""

from esair.loading import of_extra

with of_extra("canopen"):
    from esair.drivers.canopen._devices import CanopenActuator, CanopenSensor
    from esair.drivers.canopen._dictionary import Mapped
    from esair.drivers.canopen._node import CanopenNetwork, Emergency

__all__ = ["CanopenActuator", "CanopenNetwork", "CanopenSensor", "Emergency", "Mapped"]
