"""The far ends of wires, for simulations and tests: who sits there speaks real bytes.

Time that jumps and descriptors do not mix: bytes in flight in the kernel are not seen
by a virtual clock. So each wire comes in two forms, one of the kernel and one in memory;
bytes, frames and registers are the same.
"""

from esair.wires._can import CanWire, MemoryCan, VirtualCan
from esair.wires._i2c import Chip, ChipBus, Registers
from esair.wires._serial import MemoryLine, PtyLine

__all__ = [
    "CanWire",
    "Chip",
    "ChipBus",
    "MemoryCan",
    "MemoryLine",
    "PtyLine",
    "Registers",
    "VirtualCan",
]
