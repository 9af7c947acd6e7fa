"""How a sensor is heard that pushes its values: by its stream, in the loop or a thread."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterator
from typing import TYPE_CHECKING, Any

from esair.connections._driver import Method
from esair.exceptions import DeviceLostError
from esair.loop import Door, TapeWriter

if TYPE_CHECKING:
    from esair.connections._calls import Calls
    from esair.connections._sensor_device import SensorDevice

LISTEN_AGAIN = 0.1
"""The pause before a stream that raised is asked for again, in seconds."""


class Listening:
    """Brings in what one sensor pushes, while the opening lasts that it belongs to."""

    def __init__(
        self,
        channel: SensorDevice,
        loop: asyncio.AbstractEventLoop,
        hear: Callable[[Any, BaseException | None], None],
    ) -> None:
        self._channel = channel
        self._hear = hear
        self._door = Door.of(loop)
        self._tag = (channel.name, "pushed")
        if self._door.player is not None:
            self._door.player.listen(self._tag, lambda it: self._pushed(*it))

    def begin(self) -> None:
        """Listen to the opening that there is now; the call ends with it."""
        self._channel.calls.begin("stream", Method(self._listen, None), (), None)

    async def _listen(self) -> None:
        channel = self._channel
        sensor, calls = channel.sensor, channel.calls
        opening = calls.opening
        while True:
            error: BaseException
            try:
                stream = sensor.stream()
                if isinstance(stream, AsyncIterator):
                    async for value in stream:
                        if not self._heard(value, calls, opening):
                            if isinstance(stream, AsyncGenerator):
                                # The collector would do it, at any moment.
                                await stream.aclose()
                            return
                elif not await self._listen_blocking(iter(stream), calls, opening):
                    return
                error = DeviceLostError(channel.name, "its stream has ended")
            except asyncio.CancelledError as cancelled:
                if opening != calls.opening:
                    raise
                error = cancelled  # the driver's own
            except BaseException as raised:  # a driver may raise anything
                error = raised
            if opening != calls.opening:
                return  # the device is gone; its next opening begins anew
            self._door.end(self._tag, self._pushed, None, error, opening, calls)
            if opening != calls.opening:
                return
            await asyncio.sleep(LISTEN_AGAIN)

    async def _listen_blocking(
        self, values: Iterator[Any], calls: Calls, opening: int
    ) -> bool:
        # A thread of its own: waiting for the next value must not block the bus.
        executor = await self._channel.driver.stream_executor()
        end = object()
        while (
            value := await executor.call(next, values, end, timeout=math.inf)
        ) is not end:
            if not self._heard(value, calls, opening):
                return False
        return True

    def _heard(self, value: Any, calls: Calls, opening: int) -> bool:
        """Bring in what the device has pushed, unless its opening is over."""
        if opening == calls.opening:
            self._door.end(self._tag, self._pushed, value, None, opening, calls)
            return opening == calls.opening
        self._channel.calls.late += 1
        return False

    def _pushed(
        self,
        value: Any,
        error: BaseException | None,
        opening: int,
        calls: Calls | None = None,
    ) -> None:
        """Let what the device has pushed, or the error of its stream, take effect."""
        if opening != (calls or self._channel.calls).opening:
            self._channel.calls.late += 1
            return
        if isinstance(self._door.tape, TapeWriter):
            self._door.tape.arrived(self._tag, (value, error, opening))
        self._hear(value, error)
