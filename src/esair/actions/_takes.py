"""How a behavior takes requests: in a loop over a port, or by a method for each."""

from __future__ import annotations

import inspect
import typing
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar, overload

import attrs

from esair.actions._needs import Becomes, attributes_of
from esair.actions._request import Request, answer_type
from esair.loop import Portal
from esair.values import once_for_class, same_type, type_name

if TYPE_CHECKING:
    pass

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R", bound=Request[Any])

QUEUE = 16  # how many requests wait for a behavior unless it says otherwise

_MARK = "_esair_answers"


class RequestLoop(Protocol):
    """One loop over a port for requests."""

    def __aiter__(self) -> AsyncIterator[Any]: ...
    async def next(self) -> Any: ...
    def serve(self) -> None: ...


class RequestSource(Protocol):
    """Where a port gets the requests that wait for its behavior."""

    def loop(self) -> RequestLoop: ...


class RequestPort(Generic[R]):
    """The requests of one type that others ask of a behavior.

    Example:
        >>> async for request in self.orders:
        ...     async with request:
        ...         request.answer(Docked(1))
    """

    __slots__ = ("_source",)

    def __init__(self, source: RequestSource) -> None:
        self._source = source

    def __aiter__(self) -> AsyncIterator[R]:
        """Yield each request as it comes.

        An error that leaves its ``async with`` block, a block that is left without
        an answer, and going on to the next without one, all fail the request.
        """
        return aiter(self._source.loop())


class BlockingRequestPort(Generic[R]):
    """The requests that others ask of a behavior with a plain ``run``."""

    __slots__ = ("_portal", "_source")

    def __init__(self, source: RequestSource, portal: Portal) -> None:
        self._source = source
        self._portal = portal

    def __iter__(self) -> Iterator[R]:
        """Yield each request as it comes, as `RequestPort` does; the thread waits."""
        loop = self._source.loop()
        while True:
            request: R = self._portal.call(loop.next)
            loop.serve()
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
