"""What an I²C master can do, and any transfer by the means that it has."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from typing import Any, Protocol, cast

PLAIN_I2C = 0x00000001
"""In ``funcs``: the master makes any transfer, not only those of SMBus."""

QUICK = 0x00010000
"""In ``funcs``: the master can address a chip without a byte (SMBus quick)."""

SMBUS_LIMIT = 32
"""How many bytes a block transfer of SMBus carries."""

LIMIT = 8192
"""How many bytes the kernel moves in one message."""


class RegisterLink(Protocol):
    """An I²C master; ``smbus2.SMBus`` is one.

    This is what registers need. A master that also has the methods of `MessageLink`,
    as ``smbus2.SMBus`` has, makes plain transfers and scans too.
    """

    def read_byte_data(self, i2c_addr: int, register: int) -> int:
        """Read one register."""

    def write_byte_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write one register."""

    def read_i2c_block_data(
        self, i2c_addr: int, register: int, length: int
    ) -> list[int]:
        """Read several registers in one transfer."""

    def write_i2c_block_data(
        self, i2c_addr: int, register: int, data: Sequence[int]
    ) -> None:
        """Write several registers in one transfer."""

    def close(self) -> None:
        """Let the bus go."""


class MessageLink(RegisterLink, Protocol):
    """An I²C master that makes transfers without registers too."""

    funcs: int
    """What the adapter can do, as the bits of the kernel's ``I2C_FUNC_...``."""

    def i2c_rdwr(self, *messages: Any) -> None:
        """Make ``smbus2.i2c_msg`` transfers with repeated starts in between."""

    def read_byte(self, i2c_addr: int) -> int:
        """Read a byte from where the chip's pointer is."""

    def write_byte(self, i2c_addr: int, value: int) -> None:
        """Write one byte, which most chips take as their pointer."""

    def write_quick(self, i2c_addr: int) -> None:
        """Address a chip and nothing more."""


def message_link(link: RegisterLink) -> MessageLink:
    """Return a link as one with plain transfers."""
    if not hasattr(link, "i2c_rdwr"):
        raise unsupported("its link has the calls for registers only")
    return cast("MessageLink", link)


def unsupported(what: str) -> OSError:
    """Return the error for something that an adapter cannot do."""
    return OSError(errno.EOPNOTSUPP, f"{os.strerror(errno.EOPNOTSUPP)}: {what}")


def transfer(link: RegisterLink, address: int, write: bytes, read: int) -> bytes:
    """Write some bytes, then read some after a repeated start; either may be none.

    An adapter with plain I²C does exactly that. One that has only the calls of SMBus
    gets the call that puts the same bits on the wire, if there is one.

    Raises:
        OSError: The transfer failed, or the adapter has no call for it.
    """
    found = message_link(link)
    if int(found.funcs) & PLAIN_I2C:
        return _by_messages(found, address, write, read)
    return _by_smbus(found, address, write, read)


def _by_messages(link: MessageLink, address: int, write: bytes, read: int) -> bytes:
    if not write and not read:  # many adapters refuse a message without a byte
        link.write_quick(address)
        return b""
    from smbus2 import i2c_msg

    messages = []
    if write:
        messages.append(i2c_msg.write(address, write))
    if read:
        messages.append(i2c_msg.read(address, read))
    link.i2c_rdwr(*messages)
    return bytes(cast("Any", messages[-1])) if read else b""


def _by_smbus(link: MessageLink, address: int, write: bytes, read: int) -> bytes:
    match len(write), read:
        case 0, 0:
            link.write_quick(address)
        case 0, 1:
            return bytes([link.read_byte(address)])
        case 1, 0:
            link.write_byte(address, write[0])
        case 2, 0:
            link.write_byte_data(address, write[0], write[1])
        case count, 0 if count <= SMBUS_LIMIT + 1:
            link.write_i2c_block_data(address, write[0], list(write[1:]))
        case 1, 1:
            return bytes([link.read_byte_data(address, write[0])])
        case 1, count if count <= SMBUS_LIMIT:
            return bytes(link.read_i2c_block_data(address, write[0], count))
        case _:
            raise unsupported(
                f"the adapter has SMBus only, where no call writes {len(write)} "
                f"and reads {read} bytes"
            )
    return b""


def probe(link: RegisterLink, address: int) -> None:
    """Find out whether a chip answers, as ``i2cdetect`` does it.

    A quick write could set the write protection of memories (0x30 to 0x37) and
    destroy some (0x50 to 0x5f): those are read instead. An adapter without quick
    writes reads everywhere.

    Raises:
        OSError: It does not answer.
    """
    found = message_link(link)
    read = 0x30 <= address <= 0x37 or 0x50 <= address <= 0x5F
    if read or not int(found.funcs) & QUICK:
        found.read_byte(address)
    else:
        found.write_quick(address)
