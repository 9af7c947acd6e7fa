"""Requests: what one behavior asks of another, and how the other takes them.

A request is typed by what it is answered with. It is taken in a loop over a port, or by a
method for each.
"""

from __future__ import annotations

import copy
import inspect
import typing
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from typing import Any, Generic, Protocol, Self, TypeVar, overload

import attrs

from esair.actions._blocking_ports import in_loop
from esair.actions._needs import Becomes, attributes_of
from esair.exceptions import BadValueError, ConfigError
from esair.loop import Portal
from esair.values import once_for_class, same_type, type_name, value_type

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
    def serve(self) -> None: ...
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


S = TypeVar("S")
T = TypeVar("T")

QUEUE = 16  # how many requests wait for a behavior unless it says otherwise

_MARK = "_esair_answers"


class RequestPort(Generic[R]):
    """The requests of one type that others ask of a behavior.

    Example:
        >>> async for request in self.orders:
        ...     async with request:
        ...         request.answer(Docked(1))
    """

    __slots__ = ("_loop",)

    def __init__(self, loop: Callable[[], AsyncIterator[R]]) -> None:
        self._loop = loop

    def __aiter__(self) -> AsyncIterator[R]:
        """Yield each request as it comes.

        An error that leaves its ``async with`` block, a block that is left without
        an answer, and going on to the next without one, all fail the request.
        """
        return aiter(self._loop())


class BlockingRequestPort(Generic[R]):
    """The requests that others ask of a behavior with a plain ``run``."""

    __slots__ = ("_loop", "_portal")

    def __init__(self, loop: Callable[[], AsyncIterator[R]], portal: Portal) -> None:
        self._loop = loop
        self._portal = portal

    def __iter__(self) -> Iterator[R]:
        """Yield each request as it comes, as `RequestPort` does; the thread waits."""
        loop = self._loop()
        while True:
            request: R = self._portal.call(in_loop, loop.__anext__)
            request._order.serve()  # noqa: SLF001 - in the thread that works on it
            yield request


@attrs.frozen
class Takes(Becomes[RequestPort[R], BlockingRequestPort[R]]):
    """A behavior takes requests; in the running behavior it is a `RequestPort`.

    Attributes:
        type: The class of the requests.
        queue: How many may wait.
        newest: Whether a new one ends those before it.
        method: The method that answers them; None if it takes them in a loop.
    """

    type: type[R]
    queue: int = QUEUE
    newest: bool = False
    method: str | None = None

    @property
    def resource(self) -> str:
        """The name of the requests."""
        return type_name(self.type)


def takes(
    type: type[R],  # noqa: A002 - as in `reads`
    *,
    queue: int = QUEUE,
    newest: bool = False,
) -> Takes[R]:
    """Declare, as a class attribute, that a behavior takes requests of a type.

    Args:
        type: A class derived from `Request`.
        queue: How many may wait; the next one is refused with `BusyError`.
        newest: A new request ends those before it, also the one that is being
            worked on: their askers get `RefusedError`.

    Example:
        >>> class Docking(esair.Behavior):
        ...     orders = esair.takes(Dock)
        ...
        ...     async def run(self) -> None:
        ...         async for request in self.orders:
        ...             async with request:
        ...                 request.answer(await self.dock(request.bay))
    """
    return Takes(type, queue, newest)


@overload
def answers(
    method: Callable[[S, R], Coroutine[Any, Any, T]],
) -> Callable[[S, R], Coroutine[Any, Any, T]]: ...
@overload
def answers(method: Callable[[S, R], T]) -> Callable[[S, R], T]: ...
def answers(method: Any) -> Any:
    """Let a method of a behavior answer requests of the type that it is annotated with.

    Each request gets a task of its own, or a thread if the method is a plain function;
    one at a time for each method. What it returns is the answer; `RefusedError` that it
    raises is a refusal; any other error fails the request, and the behavior goes on.

    Example:
        >>> @esair.answers
        ... async def dock(self, request: Dock) -> Docked:
        ...     return Docked(1)
    """
    setattr(method, _MARK, True)
    return method


@once_for_class
def declared_requests(cls: type) -> Mapping[str, Takes[Any] | str]:
    """Return what a class takes and answers, by attribute, or what is wrong with it."""
    # Not when the class is made: its annotations may name what comes later.
    found: dict[str, Takes[Any] | str] = {}
    for attribute, value in attributes_of(cls).items():
        if isinstance(value, Takes):
            found[attribute] = value
        elif getattr(value, _MARK, False) is True and callable(value):
            found[attribute] = _answers(attribute, value)
    return found


def _answers(attribute: str, method: Any) -> Takes[Any] | str:
    """Return what a method answers, or say what is wrong with it."""
    try:
        parameters = list(inspect.signature(method).parameters.values())
        hints = typing.get_type_hints(method)
    except Exception as error:
        return f"its annotations cannot be read: {error}"
    kinds = {p.kind for p in parameters} - {inspect.Parameter.POSITIONAL_OR_KEYWORD}
    wanted = hints.get(parameters[1].name) if len(parameters) == 2 else None
    if kinds or not is_request(wanted):
        return (
            "expected one parameter, annotated with a class derived from esair.Request"
        )
    if inspect.isasyncgenfunction(method) or inspect.isgeneratorfunction(method):
        return "expected a method that returns its answer, not one that yields"
    given, answer = hints.get("return", Any), answer_type(wanted)
    if not same_type(_or_none(given), _or_none(answer)):
        return (
            f"it returns {type_name(given)}, but {wanted.__name__} is answered with "
            f"{type_name(answer)}"
        )
    return Takes(wanted, method=attribute)


def _or_none(kind: Any) -> Any:
    return type(None) if kind is None else kind


def is_request(kind: Any) -> typing.TypeGuard[type[Request[Any]]]:
    return inspect.isclass(kind) and issubclass(kind, Request) and kind is not Request
