"""What parts with registers on an I²C bus have in common: an address, and a question."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

from esair.buses import I2CBus
from esair.buses.i2c import SILENT
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.resources import Resource


class OnChip(Resource):
    """A chip that is asked at each opening whether it is the one that is meant.

    A subclass says which addresses it can have, and what it holds in which register; it
    sets the chip up in ``_set_up``, with its settings by name.
    """

    bus: I2CBus
    addresses: ClassVar[range]
    identity_register: ClassVar[tuple[str, int, int]]
    """The name of the register that tells what it is, its number, and what it holds."""

    others: ClassVar[Mapping[int, str]] = {}
    """What else may be at its addresses, by what that holds."""

    def __init__(self, *, address: int, **settings: Any) -> None:
        super().__init__(**settings)
        allowed = self.addresses
        if type(address) is not int or address not in allowed:
            shown = f"{address:#04x}" if type(address) is int else f"{address!r:.80}"
            told = f"expected {allowed[0]:#04x} to {allowed[-1]:#04x}, not {shown}"
            raise ConfigError(self.name, "address", told)
        self.address: int = address

    async def apply(self, **changes: Any) -> None:
        """Set the chip up."""
        await self._set_up(**{**self.settings, **changes})

    async def _set_up(self, *_: Any, **settings: Any) -> None:
        """Tell the chip its settings."""

    @contextlib.contextmanager
    def _expected(self) -> Iterator[None]:
        """Take silence as a loss: it is waited for; a wrong answer is not."""
        try:
            yield
        except DeviceFaultError as error:
            if error.errno not in SILENT:
                raise
            told = f"no chip answers at {self.address:#04x}"
            raise DeviceLostError(self.name, told) from error

    async def _identify(self) -> None:
        name, register, wanted = self.identity_register
        with self._expected():
            found = await self._get(register)
        if found != wanted:
            what = self.others.get(found, "another chip")
            told = f"{name} is {found:#04x} instead of {wanted:#04x}: {what}"
            raise DeviceFaultError(self.name, told)

    async def _get(self, register: int) -> int:
        return (await self.bus.read(self.address, register))[0]

    async def _put(self, register: int, *values: int) -> None:
        await self.bus.write(self.address, register, bytes(values), idempotent=True)
