"""What waits on a bus ends with it."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from esair.exceptions import DeviceLostError, DriverStuckError
from esair.testing import FakeSerial

pytestmark = pytest.mark.virtual_clock


@pytest.mark.parametrize("how", ["unplug", "close"])
async def test_a_wait_ends_with_the_bus(how: str) -> None:
    """At once, with its reason; a wait of one's own would last for ever."""
    bus = FakeSerial("front")
    await bus.open()
    waiting = asyncio.ensure_future(bus.wait_for(asyncio.Event().wait()))
    await asyncio.sleep(5.0)
    assert not waiting.done()
    bus.unplug() if how == "unplug" else await bus.close()
    async with asyncio.timeout(0.1):
        with pytest.raises(DeviceLostError, match="front"):
            await waiting
    await bus.close()


async def test_a_listener_that_fails_keeps_nobody_from_hearing_of_a_loss() -> None:
    """The others are told, what waits ends, and the line is opened again."""
    bus = FakeSerial("front")
    failed: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, it: failed.append(it))
    told: list[BaseException] = []
    bus.on_lost(_stumbles)
    bus.on_lost(told.append)
    bus.on_arrival(_stumbles)
    bus.on_arrival(lambda: told.append(ConnectionError("there")))
    await bus.open()
    waiting = asyncio.ensure_future(bus.wait_for(asyncio.Event().wait()))
    await asyncio.sleep(0)

    bus.unplug()
    with pytest.raises(DeviceLostError):
        await waiting
    bus.plug()

    assert [type(each) for each in told] == [DeviceLostError, ConnectionError]
    assert [type(each["exception"]) for each in failed] == [ZeroDivisionError] * 2
    await bus.open()
    await bus.close()


async def test_a_wait_has_its_result_its_time_and_needs_the_bus() -> None:
    """What comes is returned, what does not come is told, and nothing is begun."""
    bus = FakeSerial("front")
    with pytest.raises(DeviceLostError, match="not open"):
        await bus.wait_for(asyncio.sleep(0))
    await bus.open()
    assert await bus.wait_for(asyncio.sleep(0.1, "there"), 1.0) == "there"
    with pytest.raises(DriverStuckError, match="1 s"):
        await bus.wait_for(asyncio.sleep(2.0), 1.0)
    with pytest.raises(TimeoutError, match="its own"):
        await bus.wait_for(_fails(), 1.0)
    await bus.close()


async def _fails() -> None:
    raise TimeoutError("its own")


def _stumbles(*_: object) -> None:
    raise ZeroDivisionError
