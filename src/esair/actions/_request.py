"""Requests: what one behavior asks of another, typed by what it is answered with."""

from __future__ import annotations

import copy
from typing import Any, Generic, Protocol, Self, TypeVar

from esair.exceptions import BadValueError, ConfigError
from esair.values import value_type

A = TypeVar("A")

_OWN = frozenset({"data", "sender", "cancelled", "progress", "answer", "refuse"})


class Order(Protocol):
    """One request on its way from its asker to its one outcome."""

    data: Any
    cancelled: bool

    @property
    def sender(self) -> str: ...
    def answer(self, value: Any) -> bool: ...
    def refuse(self, reason: str) -> bool: ...
    def progress(self, value: Any) -> bool: ...
    def enter(self) -> None: ...
    def leave(self, error: BaseException | None) -> bool: ...


class Request(Generic[A]):
    """What one behavior asks of another; ``A`` is what it is answered with.

    Derive a frozen class from it. Whoever takes it gets a copy that also knows who
    asked, and that takes the answer.

    Example:
        >>> @attrs.frozen
        ... class Dock(esair.Request[Docked]):
        ...     bay: int
        ...
        >>> answer = await self.ask("docking", Dock(2))
    """

    __slots__ = ("_order",)

    _order: Order

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        taken = _OWN.intersection((*vars(cls), *vars(cls).get("__annotations__", {})))
        if taken:
            raise ConfigError(
                cls.__name__,
                ", ".join(sorted(taken)),
                "a request has this already, for whoever takes it: choose another name",
            )

    @property
    def data(self) -> Self:
        """What was asked: the very object that the asker handed over."""
        return self._taken("data").data  # type: ignore[no-any-return]

    @property
    def sender(self) -> str:
        """Who asks."""
        return self._taken("sender").sender

    @property
    def cancelled(self) -> bool:
        """Whether nobody waits for the answer any more, though there was none."""
        return self._taken("cancelled").cancelled

    def answer(self, value: A) -> bool:
        """Answer it, from any thread.

        Returns:
            Whether the asker gets it; false if nobody waits any more.
        """
        return self._taken("answer").answer(value)

    def refuse(self, reason: str) -> bool:
        """Refuse it: the asker gets `RefusedError` with the reason.

        Returns:
            Whether the asker gets it; false if nobody waits any more.
        """
        return self._taken("refuse").refuse(reason)

    def progress(self, value: object) -> bool:
        """Tell the asker how far it is; of several that wait the newest wins.

        Returns:
            False if nobody waits any more.
        """
        return self._taken("progress").progress(value)

    async def __aenter__(self) -> Self:
        self._taken("async with").enter()
        return self

    async def __aexit__(
        self, _: object, error: BaseException | None, *__: object
    ) -> bool:
        return self._order.leave(error)

    def __enter__(self) -> Self:
        self._taken("with").enter()
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> bool:
        return self._order.leave(error)

    def _taken(self, use: str) -> Order:
        try:
            return self._order
        except AttributeError:
            raise BadValueError(
                type(self).__name__,
                use,
                "nobody has asked this: it is for a request that was taken from a port",
            ) from None


R = TypeVar("R", bound=Request[Any])


def taken(request: R, order: Order) -> R:
    """Return a copy of a request for whoever takes it."""
    copied = copy.copy(request)
    object.__setattr__(copied, "_order", order)  # it is frozen
    return copied


def answer_type(request: type[Request[Any]]) -> Any:
    """Return the type that a class of requests is answered with."""
    return value_type(request, Request)
