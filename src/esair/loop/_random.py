"""Random numbers that repeat: each component has a stream of its own."""

from __future__ import annotations

import asyncio
import random
from typing import Any, Protocol

from esair.loop._of_loop import OfLoop
from esair.loop._ownership import Owner, current_owner

_outside = random.Random()  # for code that belongs to no component


class Stepper(Protocol):
    """What steps for somebody."""

    owner: Owner | None


class Stepping(OfLoop):
    """Whose reaction decides now, in one event loop."""

    __slots__ = ("stepper",)

    def __init__(self, _loop: asyncio.AbstractEventLoop | None = None) -> None:
        self.stepper: Stepper | None = None

    @property
    def owner(self) -> Owner | None:
        return None if self.stepper is None else self.stepper.owner


class Stream:
    """The random numbers of one component, made when they are first asked for.

    It knows a seed and no component: what still holds a task's context, such as a
    timer that was cancelled, must not keep a component alive that was removed.
    """

    __slots__ = ("_made", "_seed")

    def __init__(self, seed: str) -> None:
        self._seed = seed
        self._made: random.Random | None = None

    def __call__(self) -> random.Random:
        if self._made is None:
            self._made = random.Random(self._seed)
        return self._made


class ComponentRandom(random.Random):
    """The random numbers of the component that asks: `esair.random`.

    It has the methods of `random.Random`. Each behavior and reaction draws from its
    own stream, made from the seed of its robot and its name, so that what one draws
    changes nothing for another, and the same seed gives the same numbers. Code that
    belongs to no behavior or reaction, a driver say, draws from a stream without a
    seed.

    Example:
        >>> turn = esair.random.uniform(-1.2, 1.2)
    """

    _is_made = False

    def __init__(self) -> None:
        super().__init__(0)
        self._is_made = True

    @property
    def _own(self) -> random.Random:
        loop = asyncio._get_running_loop()  # noqa: SLF001 - None in a thread, no error
        owner = (loop and Stepping.of(loop).owner) or current_owner()
        if owner is None or owner.stream is None:
            return _outside
        return owner.stream()

    def random(self) -> float:
        """Return a number from 0 to 1, 1 not included."""
        return self._own.random()

    def getrandbits(self, k: int, /) -> int:
        """Return a whole number of *k* random bits."""
        return self._own.getrandbits(k)

    def gauss(self, mu: float = 0.0, sigma: float = 1.0) -> float:
        """Return a number of a normal distribution."""
        return self._own.gauss(mu, sigma)

    def seed(self, *args: Any, **options: Any) -> None:
        """Refuse: the seed is the robot's.

        Raises:
            TypeError: Always.
        """
        if self._is_made:
            raise TypeError("the seed is the robot's: esair.Robot(seed=...)")

    def getstate(self) -> tuple[Any, ...]:
        """Return the state of the component's stream."""
        return self._own.getstate()

    def setstate(self, state: tuple[Any, ...]) -> None:
        """Put the component's stream back."""
        self._own.setstate(state)
