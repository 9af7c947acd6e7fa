"""J1939: an address that is claimed, and defended by a NAME.

Source: SAE J1939-81 (network management). Who claims an address says its NAME, a number
of 64 bits that no other node has. Where two claim one address the lesser NAME has it;
the other one takes a free address, if the highest bit of its NAME says that it may, or
says that it cannot claim one.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Final

from esair.buses import CanBus, Frame, Inbox
from esair.buses.can import Mask
from esair.drivers._on_bus import SharedTask, shared
from esair.drivers.dbc._j1939 import SOURCE
from esair.exceptions import ConfigError, DeviceLostError, EsairError

CLAIM: Final = 0x18EE_FF00
"""The id of a claim, beside the address that is claimed."""

CLAIMS: Final = Mask(0x00EE_FF00, 0x03FF_FF00)
REQUESTS: Final = Mask(0x00EA_0000, 0x03FF_0000)

CLAIM_GROUP: Final = 0xEE00
NULL, ALL = 254, 255

VETO: Final = 0.25
"""For how long others may object to a claim, in seconds."""

CANNOT_CLAIM_DELAY: Final = 0.153
"""Within which time "cannot claim" is said, in seconds; not by all at the same moment."""

SELF_CONFIGURING: Final = 1 << 63
"""The bit of a NAME whose node may take another address."""

FREE: Final = range(128, 248)
"""The addresses that such a node takes."""

Lost = Callable[[EsairError], None]


def checked_name(component: str, name: object) -> int:
    """Return a NAME, which may be written as 16 hexadecimal digits."""
    number: object = name
    if isinstance(name, str) and len(name) == 16:
        with contextlib.suppress(ValueError):
            number = int(name, 16)
    if type(number) is not int or not 0 <= number < 1 << 64:
        raise ConfigError(
            component,
            "j1939_name",
            f"expected 64 bits, as a number or 16 hexadecimal digits, not {name!r:.80}",
        )
    return number


class Claim(SharedTask):
    """An address on a bus, for all devices that use one NAME.

    It is claimed when the first of them opens and let go when the last one closes. In
    between it is defended against greater NAMEs; lost to a lesser one each device is
    told, and the next opening has another address, or fails.
    """

    def __init__(self, bus: CanBus, name: int, preferred: int) -> None:
        super().__init__(bus)
        self.name = name
        self.preferred = preferred
        self.address: int | None = None
        self._next = preferred
        self._owners: dict[int, int] = {}
        self._claimed: asyncio.Future[int] | None = None
        self._is_parting = False

    async def join(self, lost: Lost) -> int:
        """Have the address, and be told when it is lost; raises if it is another's."""
        if self.begin(lost, self._run):
            self._claimed = asyncio.get_running_loop().create_future()
        assert self._claimed is not None
        try:
            return await asyncio.shield(self._claimed)
        except BaseException:
            await self.leave(lost)
            raise

    async def leave(self, lost: Lost) -> None:
        """Use the address no more."""
        if self._users.keys() <= {lost}:
            self.address = None
            if self._is_parting and self._task is not None:  # it says a last word
                await asyncio.wait({self._task})
        await super().leave(lost)

    async def _run(self) -> None:
        try:
            with self._there().frames(
                CLAIMS, REQUESTS, extended=True, limit=256
            ) as inbox:
                while True:
                    await self._hold(self._next, inbox)
        except EsairError as error:
            self._lose(error)
            if self._claimed is not None and not self._claimed.done():
                self._claimed.set_exception(error)
                self._claimed.exception()  # heard, also if nobody waits
        finally:
            self._is_parting = False

    async def _hold(self, address: int, inbox: Inbox[Frame]) -> None:
        """Claim an address and defend it, until a lesser NAME has it."""
        loop = asyncio.get_running_loop()
        await self._say(address)
        settled = loop.time() + VETO
        while True:
            left = settled - loop.time()
            if self.address is None and left <= 0:
                self.address = address
                if self._claimed is not None and not self._claimed.done():
                    self._claimed.set_result(address)
            try:
                frame = await inbox.take(timeout=left if self.address is None else None)
            except TimeoutError:
                continue
            if frame.id & REQUESTS.mask == REQUESTS.id:
                if asks_for_claims(frame, address):
                    await self._say(address)
                continue
            owner, name = frame.id & SOURCE, int.from_bytes(frame.data, "little")
            if len(frame.data) != 8 or owner > NULL:
                continue
            if owner != address:
                self._owners[owner] = name
            elif name > self.name:
                await self._say(address)
            else:
                self._owners[address] = name
                await self._yield(address, name)
                return

    async def _yield(self, address: int, name: int) -> None:
        """Choose another address to claim, or raise if there is none."""
        is_twin = name == self.name
        error = DeviceLostError(
            "J1939",
            f"address {address} belongs to the node with NAME {name:016X}, and this one "
            + (
                "has the same" if is_twin else f"has {self.name:016X}, which is greater"
            ),
        )
        free = [
            each
            for each in (*range(address + 1, FREE.stop), *FREE)
            if each in FREE and self._owners.get(each, self.name + 1) > self.name
        ]
        if not is_twin and self.name & SELF_CONFIGURING and free:
            self._next = free[0]
            self._lose(error)
            return
        self._is_parting = True
        self._lose(error)
        self._next = self.preferred
        self._owners.clear()  # they may have gone until it is tried again
        await asyncio.sleep(self.name % 1021 / 1021 * CANNOT_CLAIM_DELAY)
        await self._say(NULL)
        raise error

    def _lose(self, error: EsairError) -> None:
        """Tell everybody who has the address."""
        had, self.address = self.address, None
        if had is not None:
            self._claimed = asyncio.get_running_loop().create_future()
            for lost in tuple(self._users):
                lost(error)

    async def _say(self, address: int) -> None:
        await self._there().send(
            CLAIM | address, self.name.to_bytes(8, "little"), extended=True
        )

    def _there(self) -> CanBus:
        bus = self._bus()
        if not isinstance(bus, CanBus):
            raise DeviceLostError("J1939", "the bus is no more")
        return bus


def asks_for_claims(frame: Frame, address: int) -> bool:
    """Whether a request asks a node with an address for its claim."""
    group = int.from_bytes(frame.data[:3], "little")
    return group == CLAIM_GROUP and frame.id >> 8 & 0xFF in {address, ALL}


def claim_of(component: str, bus: CanBus, name: int, preferred: int) -> Claim:
    """Return the claim that all devices on a bus with one NAME share, and an address."""
    claim = shared(bus, Claim).setdefault(name, Claim(bus, name, preferred))
    if claim.preferred != preferred:
        raise ConfigError(
            component,
            "source",
            f"the NAME {name:016X} has the address {claim.preferred} already, "
            f"not {preferred}",
        )
    return claim
