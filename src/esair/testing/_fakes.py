"""Fakes: devices that answer in tests as their test tells them to."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import copy
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any, Generic, TypeVar

import attrs

from esair.buses import Awaited, Failures
from esair.exceptions import DeviceLostError
from esair.resources import Actuator, Resource, Sensor

T = TypeVar("T")

_NOTHING: Any = object()


@attrs.define(eq=False)
class _Faults:
    """What a fake is told to do wrong."""

    name: str
    plugged: bool = True
    silent: bool = False
    go: asyncio.Event = attrs.field(factory=asyncio.Event)
    failures: Failures = attrs.field(factory=Failures)
    delay: float = 0.0
    ack: float = 0.0
    deaf: int = 0

    def __attrs_post_init__(self) -> None:
        self.go.set()

    async def call(self) -> None:
        """One call of the device: wait, be gone, or fail, as told."""
        while not self.go.is_set():
            with self._deaf():
                await self.go.wait()
        await self.wait(self.delay)
        self.check()
        self.failures.check()

    async def wait(self, seconds: float) -> None:
        """Take time, and swallow as many cancellations as told."""
        loop = asyncio.get_running_loop()
        until = loop.time() + seconds
        while (left := until - loop.time()) > 1e-9:
            with self._deaf():
                await asyncio.sleep(left)

    @contextlib.contextmanager
    def _deaf(self) -> Iterator[None]:
        try:
            yield
        except asyncio.CancelledError:
            if self.deaf <= 0:
                raise
            self.deaf -= 1

    async def there(self) -> None:
        """Be asked for nothing but to be there."""
        if self.silent:
            await self.call()
        self.check()

    def check(self) -> None:
        if not self.plugged:
            raise DeviceLostError(self.name, "it is unplugged")


class _Fake(Resource):
    """What every fake can be told."""

    _faults: _Faults

    opened: int = 0  # How often it was opened
    is_open: bool = False  # Whether it is open now

    has_power_cycled: bool = False
    """Whether its set-up is gone, because its power was, since it was opened."""

    async def open(self) -> None:
        """Be opened, unless it is unplugged; silent, it never answers that."""
        await self._faults.there()
        self.opened += 1
        self.is_open = True
        self.has_power_cycled = False

    async def close(self) -> None:
        """Be closed."""
        self.is_open = False

    def unplug(self) -> None:
        """Be gone, from this moment on."""
        self._faults.plugged = False
        self.report_lost(DeviceLostError(self.name, "it was unplugged"))

    def plug(self) -> None:
        """Be there again."""
        self._faults.plugged = True
        self.report_arrived()

    async def is_set_up(self) -> bool:
        """Tell whether its power has been on since it was opened."""
        await self._faults.there()
        return not self.has_power_cycled

    def power_cycle(self) -> None:
        """Lose the power for a moment: its set-up is gone, and nobody is told."""
        self.has_power_cycled = True

    def silence(self) -> None:
        """Have no power: answer nothing, no opening either, until `speak`."""
        self._faults.silent = True
        self.stall()

    def speak(self) -> None:
        """Have power again."""
        self._faults.silent = False
        self.resume()

    def slow(self, seconds: float, *, acknowledge: float = 0.0) -> None:
        """Take so long for each call from now on.

        Args:
            seconds: Until a command lands, or a value is taken.
            acknowledge: From then until the call returns; longer than the deadline,
                and it returns after it.
        """
        self._faults.delay, self._faults.ack = seconds, acknowledge

    def swallow(self, times: int) -> None:
        """Go on with so many calls, or waits, that are cancelled from now on."""
        self._faults.deaf = times

    def fail(
        self, error: BaseException, *, after: int = 0, times: int | None = 1
    ) -> None:
        """Raise an error from a call of the device.

        Args:
            error: What to raise.
            after: How many calls go well before.
            times: How many calls fail; None for all from then on.
        """
        self._faults.failures.clear()
        self._faults.failures.add(error, after, times)

    def stall(self) -> None:
        """Answer no call until `resume`."""
        self._faults.go.clear()

    def resume(self) -> None:
        """Answer again, also the calls that waited."""
        self._faults.go.set()


class FakeSensor(_Fake, Sensor[T], Generic[T]):
    """A sensor that gives what a test feeds it.

    Args:
        name: Its name.
        value: What it answers when it is asked. Without a value it cannot be asked:
            it only pushes what it is fed.
        type: The type of its values; any unless given.
        **options: Settings and options of `Sensor`, such as ``rate=20.0``.
    """

    reads: int = 0
    """How often it was asked."""

    def __init__(
        self,
        name: str,
        value: T = _NOTHING,
        *,
        type: Any = Any,  # noqa: A002 - the word of the contract
        **options: Any,
    ) -> None:
        super().__init__(name=name, **options)
        self._faults = _Faults(name)
        self._type = type
        self._value = value
        self._asked = value is not _NOTHING
        self._fed: collections.deque[T] = collections.deque(maxlen=1024)
        self._news = asyncio.Event()

    @property
    def value_type(self) -> Any:
        """The type of its values."""
        return self._type

    @property
    def can_be_asked(self) -> bool:
        """Whether it was made with a value."""
        return self._asked

    def feed(self, value: T) -> None:
        """Push a value now, and answer with it from now on."""
        self._value = value
        self._fed.append(value)
        self._news.set()

    async def read(self) -> T:
        """Answer with the newest value."""
        self.reads += 1
        await self._faults.call()
        value = self._value
        await self._faults.wait(self._faults.ack)
        return value

    async def stream(self) -> AsyncIterator[T]:
        """Push what is fed."""
        while True:
            await self._news.wait()
            self._news.clear()
            await self._faults.call()
            while self._fed:
                yield self._fed.popleft()


class FakeActuator(_Fake, Actuator[T], Generic[T]):
    """An actuator that remembers what it was told.

    Args:
        name: Its name.
        safe: Its safe command.
        command_timeout: After how long it gets its safe command, in seconds.
        **options: ``limits``, ``clamp``, ``slew``, and what `Resource` takes.

    Attributes:
        commands: Every command that reached the device, in the order in which they
            landed there.
        landed: When each of them did, in seconds of the event loop's clock.
    """

    def __init__(
        self,
        name: str,
        safe: T = _NOTHING,
        *,
        command_timeout: float = 0.2,
        limits: Any = None,
        clamp: bool = False,
        slew: Any = None,
        **options: Any,
    ) -> None:
        super().__init__(name=name, **options)
        self._faults = _Faults(name)
        if safe is not _NOTHING:
            self.safe = safe
        self.command_timeout = command_timeout
        self.limits = limits
        self.clamp = clamp
        self.slew = slew
        self.commands: list[T] = []
        self.landed: list[float] = []
        self._awaited = Awaited[T]()

    async def write(self, command: T) -> None:
        """Take a command."""
        await self._faults.call()
        self.commands.append(copy.deepcopy(command))
        self.landed.append(asyncio.get_running_loop().time())
        self._awaited.came(command)
        await self._faults.wait(self._faults.ack)

    async def until(
        self, wanted: T | Callable[[T], bool], *, timeout: float = 1.0
    ) -> T:
        """Wait until the newest command is the wanted one, and return it.

        Args:
            wanted: A command, or a condition on a command.
            timeout: How long to wait, in seconds.

        Raises:
            TimeoutError: It did not come; the last commands are in the message.
        """
        matches: Callable[[T], bool]
        matches = (
            wanted if callable(wanted) else lambda command: bool(command == wanted)
        )
        return await self._awaited.until(
            matches,
            self.commands[-1:],
            timeout,
            lambda: (
                f"{self.name}: {wanted!r} did not come in {timeout:g} s; "
                f"the last commands are {self.commands[-5:]!r}"
            ),
        )
