"""What no bus can do is a mistake that is named, and nothing of it is sent."""

from __future__ import annotations

import math
from typing import Any

import pytest

from esair.buses.can import FakeCan
from esair.buses.i2c import FakeI2c
from esair.buses.serial import FakeSerial
from esair.buses.spi import FakeSpi
from esair.exceptions import BadValueError

pytestmark = pytest.mark.virtual_clock

MAKES: dict[str, Any] = {
    "can": FakeCan,
    "i2c": lambda: FakeI2c(chips={0x40: {0: 1}}),
    "serial": FakeSerial,
    "spi": lambda: FakeSpi(chips={0: {0x0F: 0x33}}),
}
NO_BYTES = (None, "text", 1.5, 3, True, [300], object())
NO_COUNT = (None, "1", 1.5, True, -1, 10**12, [1])
NO_TIME = ("1", 0, -1.0, math.nan, math.inf, True, [1])
CALLS: list[tuple[str, str, str, tuple[Any, ...], tuple[Any, ...]]] = [
    ("can", "send", "data", (1, ...), NO_BYTES),
    ("i2c", "transfer", "write", (0x40, ...), NO_BYTES),
    ("i2c", "write", "data", (0x40, 0, ...), NO_BYTES),
    ("i2c", "transfer", "address", (..., b"a"), NO_COUNT),
    ("i2c", "transfer", "read", (0x40, b"a", ...), NO_COUNT),
    ("i2c", "read", "register", (0x40, ...), NO_COUNT),
    ("i2c", "read", "length", (0x40, 0, ...), NO_COUNT),
    ("serial", "write", "data", (...,), NO_BYTES),
    ("spi", "exchange", "data", (0, ...), NO_BYTES),
    ("spi", "exchange", "chip", (..., b"a"), NO_COUNT),
    ("spi", "transfer", "write", (0, ...), NO_BYTES),
    ("spi", "transfer", "read", (0, b"a", ...), NO_COUNT),
]
TIMED: list[tuple[str, str, tuple[Any, ...]]] = [
    ("can", "send", (1, b"a")),
    ("i2c", "read", (0x40, 0)),
    ("serial", "write", (b"a",)),
    ("serial", "ask", (b"a",)),
    ("spi", "exchange", (0, b"a")),
]


@pytest.mark.parametrize(("kind", "verb", "field", "args", "values"), CALLS)
async def test_a_value_that_nothing_can_be_made_of(
    kind: str, verb: str, field: str, args: tuple[Any, ...], values: tuple[Any, ...]
) -> None:
    """The error names the bus and the part that is wrong."""
    bus = MAKES[kind]()
    await bus.open()
    for value in values:
        given = [value if each is ... else each for each in args]
        with pytest.raises(BadValueError, match="expected") as caught:
            await getattr(bus, verb)(*given)
        assert (caught.value.component, caught.value.field) == (bus.name, field)
    assert bus.stats.sent == 0
    await bus.close()


@pytest.mark.parametrize(("kind", "verb", "args"), TIMED)
async def test_a_time_that_is_none(kind: str, verb: str, args: tuple[Any, ...]) -> None:
    """Nobody waits for it, and nothing is sent."""
    bus = MAKES[kind]()
    await bus.open()
    for value in NO_TIME:
        with pytest.raises(BadValueError, match="expected seconds > 0") as caught:
            await getattr(bus, verb)(*args, timeout=value)
        assert (caught.value.component, caught.value.field) == (bus.name, "timeout")
    assert bus.stats.sent == 0
    await bus.close()
