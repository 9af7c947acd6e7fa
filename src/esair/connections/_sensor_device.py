"""One sensor's device: asked by one question at a time, whoever wants to know."""

from __future__ import annotations

import asyncio
import contextvars
from collections.abc import Callable
from typing import Any

from esair.connections._call import Call, End
from esair.connections._device import Device, OfRobot, Operating
from esair.connections._driver import Method
from esair.connections._waiting_readers import WaitingReaders
from esair.exceptions import StaleReadingError
from esair.messages import ResourceState
from esair.resources import Sensor

READY = ResourceState.READY  # hot


class SensorDevice(Device):
    """Asks one device, and hands on what it answers."""

    __slots__ = (
        "_asking",
        "_asks",
        "_awaiting",
        "_begun",
        "_deadline",
        "_old_before",
        "_read",
        "_waiting",
        "awaited_in",
        "latency",
        "sensor",
        "transactions",
    )

    # Of the channel, which knows who wants to know.
    _fail: Callable[[BaseException, float], None]
    _silent: Callable[[float], StaleReadingError]
    publish: Callable[[Any, float], None]

    def __init__(self, sensor: Sensor[Any], robot: OfRobot) -> None:
        loop = asyncio.get_running_loop()
        self.transactions = 0  # how many times the device was asked
        self.awaited_in = 0
        """The turn in which it was polled, while that poll is not answered; or 0."""
        self.latency = 0.0
        """How long the device took lately at most, in seconds; what is past fades."""
        self._begun = 0.0
        self._old_before = 0.0
        """A question from before this moment gives an answer from before it."""
        self._awaiting: list[Callable[[], None]] = []
        self._asking: Call | bool = False
        """The question that waits for its answer: there is one at a time."""
        self._asks: asyncio.Handle | None = None
        """Asks the device in the next turn, for all who have asked in this one."""
        self._waiting = WaitingReaders(sensor.name, loop, self._silent)
        super().__init__(sensor.name, robot)
        self.attach(sensor)

    def attach(self, sensor: Sensor[Any]) -> None:
        self.sensor = sensor
        self.take(sensor, self, self._late)  # type: ignore[arg-type]
        self.configured()

    def configured(self) -> None:
        """Take over a changed deadline."""
        self._deadline = self.sensor.deadline
        if self.sensor.can_be_asked:
            self._read = self.driver.method("read")

    def _ask(self) -> None:
        if (
            self.sensor.can_be_asked
            and not self._asking
            and self._asks is None
            and self.state is READY
        ):
            self._asks = self.loop.call_soon(
                self._ask_now, context=contextvars.Context()
            )

    def _ask_now(self) -> None:
        self._asks = None
        if self._waiting.readers and not self._asking:
            self._begin()

    def _begin(self) -> None:
        self._asking = True
        number = self.transactions = self.transactions + 1
        calls = self.calls
        opening = calls.opening
        try:
            value = calls.begin("read", self._read, (), self._deadline)
        except Exception as error:
            self._asking = False
            if opening == calls.opening:
                self._fail(error, number)
        else:
            if type(value) is Call:
                value.apply = self._read_ended
                self._asking = value
                return
            self._asking = False
            if opening == calls.opening:
                self.publish(value, number)
            else:  # its device was lost by this very call
                calls.late += 1
        if self.operations.current is not None or self._waiting.readers:
            self._free()

    def _read_ended(self, call: Call, end: End) -> None:
        """Apply the outcome of a question that has waited for the device."""
        if call.ended is not None:  # else its driver still has the device
            self._asking = False
        polled, self.awaited_in = self.awaited_in, 0
        if polled:
            self.latency = max(self.time() - self._begun, 0.75 * self.latency)
        if end.error is not None:
            self._fail(end.error, self.transactions)
        elif call.begun >= self._old_before:  # else who waits has it asked again
            self.publish(end.value, self.transactions)
        if polled:
            self._answered()
        self._free()

    def _free(self) -> None:
        """The device may have become free: an operation first, then those who ask."""
        self.operations.look()
        if self._waiting.readers:
            self._ask()

    def ready_for(self, operation: Operating) -> bool:
        return not self._asking

    def operating(self, operation: Operating, call: Call) -> None:
        self._asking = call

    def operated(self, call: Call | None) -> None:
        """An operation has its outcome; the device is free if it has ended."""
        if call is not None and call is self._asking and call.ended is not None:
            self._asking = False
        self._free()

    def when_answered(self, function: Callable[[], None]) -> None:
        """Call a function when the poll of this turn has ended, whatever came of it."""
        self._awaiting.append(function)

    def _answered(self) -> None:
        awaiting, self._awaiting = self._awaiting, []
        for function in awaiting:
            function()

    def between(self, method: Method, told: Callable[[End], None]) -> bool:
        """Call the driver between two questions; tells whether the device was free."""
        if self._asking:
            return False

        def ended(call: Call, end: End) -> None:
            if call.ended is not None:
                self._asking = False
            told(end)
            self._free()

        waits = self.calls.attempt(method, self.sensor.deadline, told, ended)
        if waits is not None:
            self._asking = waits
        return True

    def _late(self, call: Call) -> None:
        if call is self._asking:
            self._asking = False
            self._free()
