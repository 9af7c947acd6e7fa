"""Whose work it is: the owner of a task, so that it ends with its component.

What an owner has of its own stands here too: random numbers that repeat.
"""

from __future__ import annotations

import asyncio
import contextvars
import itertools
import random
import threading
from collections.abc import Callable, Coroutine, Generator, Iterator, Sequence
from typing import Any, TypeVar

from esair.loop._of_loop import OfLoop

T = TypeVar("T")


class Owner:
    """Holds every task that a component has started and that still runs."""

    __slots__ = ("_first", "_others", "context", "over", "stream", "threads", "told")

    def __init__(self, context: contextvars.Context | None = None) -> None:
        self.context: contextvars.Context | None = context
        """The context variables that its tasks begin with; those of the loop if None."""
        # Most components have one task only; a table for it would be half their size.
        self._first: asyncio.Task[Any] | None = None
        self._others: dict[asyncio.Task[Any], None] | None = None
        self.threads: tuple[threading.Thread, ...] = ()
        """The threads that run its plain functions."""
        self.stream: str | random.Random | None = None
        """Its random numbers; their seed until the first is asked for."""
        self.over: bool = False
        """Its run has ended: what would not end with it speaks for nobody."""
        self.told: Sequence[asyncio.Task[Any]] = ()
        """Those of its tasks that were cancelled: each has its grace to clean up."""

    def adopt(self, task: Any, *, leaves: bool = False) -> None:
        """Remember a task until it is done, or until it leaves itself.

        The loop itself keeps only weak references.
        """
        if self._first is None or self._first.done():
            self._first = task
            return
        others = self._others
        if others is None:
            others = self._others = {}
        others[task] = None
        if not leaves:
            task.add_done_callback(lambda done: others.pop(done, None))

    def leave(self, task: Any) -> None:
        """Let go of a task that ends now: a callback would cost a turn of the loop."""
        if task is self._first:
            self._first = None
        elif self._others is not None:
            self._others.pop(task, None)

    def own(self, context: contextvars.Context) -> contextvars.Context:
        """Let what is started in a context belong to it; return the context."""
        context.run(_owner.set, self)
        return context

    def living(self) -> list[asyncio.Task[Any]]:
        """Return the tasks that are not done, as they were made; the first one last."""
        others = self._others
        tasks = [each for each in others if not each.done()] if others else []
        if self._first is not None and not self._first.done():
            tasks.append(self._first)
        return tasks


_owner: contextvars.ContextVar[Owner | None] = contextvars.ContextVar(
    "esair_owner", default=None
)

_OUTSIDE = Owner()  # of code in whose context nobody was ever the owner


def spawn(
    loop: asyncio.AbstractEventLoop,
    coroutine: Coroutine[Any, Any, T],
    *,
    name: str,
    owner: Owner | None = None,
    context: contextvars.Context | None = None,
    leaves: bool = False,
) -> asyncio.Task[T]:
    """Start a task that belongs to esair itself, or to an owner.

    It begins with the context variables of the script that has started the robot,
    unless a context is given, so that what it starts is not mistaken for work of the
    component that happened to call. It never begins before this returns, even if the
    loop's factory makes eager tasks: esair's own records are complete then. One that
    leaves tells its owner of its end itself, see `Owner.leave`.
    """
    tasks = OwnedTasks.of(loop)
    if context is None:
        begins = None if owner is None else owner.context
        context = (begins or tasks.script).copy()
    if owner is None:
        return asyncio.Task(coroutine, loop=loop, name=name, context=context)
    context.run(_owner.set, owner)  # hot: as `Owner.own`
    number = next(tasks.numbers)
    task = Task(number, coroutine, loop=loop, name=name, context=context)
    owner.adopt(task, leaves=leaves)
    return task


current_owner: Callable[[], Owner | None] = _owner.get
"""Return the owner of the code that runs now; None if it is nobody's."""


def is_outside() -> bool:
    """Tell whether the code that runs now is no part of a robot: a driver, a bus."""
    return _owner.get(_OUTSIDE) is _OUTSIDE


def speaks_for_nobody() -> bool:
    """Tell whether the code that runs now belongs to a run that has ended."""
    owner = _owner.get()
    return owner is not None and owner.over


def script_context() -> contextvars.Context:
    """Return a copy of the context variables of the code that runs now; nobody's."""
    context = contextvars.copy_context()
    context.run(_owner.set, None)
    return context


class Contained(Coroutine[Any, Any, Any]):
    """A coroutine whose ``sys.exit()`` ends its own task, and not the event loop."""

    __slots__ = ("_inner",)

    def __init__(self, inner: Coroutine[Any, Any, Any]) -> None:
        self._inner = inner

    def send(self, value: Any) -> Any:
        try:
            return self._inner.send(value)
        except (SystemExit, KeyboardInterrupt) as error:
            raise RuntimeError(f"a task raised {type(error).__name__}") from error

    def throw(self, *error: Any) -> Any:
        try:
            return self._inner.throw(*error)
        except (SystemExit, KeyboardInterrupt) as raised:
            raise RuntimeError(f"a task raised {type(raised).__name__}") from raised

    def close(self) -> None:
        self._inner.close()

    def __getattr__(self, name: str) -> Any:
        # What tools ask of a coroutine: its name, its frame, what it waits for.
        return getattr(self._inner, name)

    def __await__(self) -> Generator[Any, Any, Any]:
        try:
            return (yield from self._inner.__await__())
        except (SystemExit, KeyboardInterrupt) as error:
            raise RuntimeError(f"a task raised {type(error).__name__}") from error


class OwnedTasks(OfLoop):
    """The task factory of a loop while robots run on it; one for the loop, counted.

    It tells each owner of the tasks that are started in its context. The factory that
    was there before makes the tasks, and is put back by the last robot.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._users = 0
        self._factory: _Factory | None = None
        self._installed: Any = None
        self.numbers: Iterator[int] = itertools.count()
        """Of the tasks with an owner, as they are made."""
        self.script: contextvars.Context = contextvars.Context()
        """The context variables of whoever has started the first robot."""

    def install(self) -> None:
        self._users += 1
        if self._users == 1:
            self.script = script_context()
            self._factory = _Factory(self._loop.get_task_factory(), self.numbers)
            self._installed = self._factory.as_installed()
            self._loop.set_task_factory(self._installed)

    def uninstall(self) -> None:
        """Put the factory from before back, unless somebody set another since."""
        self._users -= 1
        if self._users == 0 and self._factory is not None:
            if self._loop.get_task_factory() is self._installed:
                self._loop.set_task_factory(self._factory.before)
            self._factory.over = True
            self._factory = self._installed = None


class Task(asyncio.Task[Any]):
    """A task with an owner.

    Sets hold such tasks by their numbers, not by their addresses: a task group cancels
    its tasks in the order of a set, and that has to repeat.
    """

    __slots__ = ("_number",)

    def __init__(self, number: int, coroutine: Any, **options: Any) -> None:
        self._number = number
        super().__init__(coroutine, **options)

    def __hash__(self) -> int:
        return self._number


class _Factory:
    """Makes tasks as the factory before it does, and tells their owners."""

    __slots__ = ("_construct", "_numbers", "before", "over")

    def __init__(self, before: Any, numbers: Iterator[int]) -> None:
        self.before = before
        self._construct = _eager_constructor(before)
        self._numbers = numbers
        self.over = False  # it was left in the factory of a stranger: it only hands on

    def as_installed(self) -> Any:
        """Return what the loop gets: where tasks were eager, a factory of asyncio.

        Libraries know it by its code, and take from it how a task is made that shall
        not begin before they have written it down.
        """
        if self._construct is None:
            return self
        make_factory = asyncio.create_eager_task_factory  # type: ignore[attr-defined]
        return make_factory(self._make_eager)

    def __call__(
        self,
        loop: asyncio.AbstractEventLoop,
        coroutine: Coroutine[Any, Any, Any],
        **options: Any,
    ) -> asyncio.Task[Any]:
        owner = self._owner_in(options)
        if owner is not None:
            coroutine = Contained(coroutine)
        task: asyncio.Task[Any]
        if self.before is not None:
            task = self.before(loop, coroutine, **options)
        elif owner is None:
            task = asyncio.Task(coroutine, loop=loop, **options)
        else:
            task = Task(next(self._numbers), coroutine, loop=loop, **options)
        return _adopted(task, owner)

    def _make_eager(
        self, coroutine: Coroutine[Any, Any, Any], **options: Any
    ) -> asyncio.Task[Any]:
        """Make a task that begins at once, or, for those who say so, later."""
        assert self._construct is not None
        owner = self._owner_in(options)
        if owner is not None:
            coroutine = Contained(coroutine)
        return _adopted(self._construct(coroutine, **options), owner)

    def _owner_in(self, options: dict[str, Any]) -> Owner | None:
        if self.over:
            return None
        context = options.get("context")
        return _owner.get() if context is None else context.get(_owner)


def _eager_constructor(factory: Any) -> Callable[..., asyncio.Task[Any]] | None:
    """Return what makes the tasks of asyncio's eager factory; None of any other."""
    known = getattr(asyncio, "eager_task_factory", None)  # since Python 3.12
    if known is None or getattr(factory, "__code__", None) is not known.__code__:
        return None
    made: Callable[..., asyncio.Task[Any]] = factory.__closure__[0].cell_contents
    return made


def _adopted(task: asyncio.Task[Any], owner: Owner | None) -> asyncio.Task[Any]:
    if owner is not None and not task.done():
        owner.adopt(task)
    return task


_outside = random.Random()  # for code that belongs to no component


class Stepping(OfLoop):
    """What runs the reaction that decides now, in one event loop; it has an owner."""

    __slots__ = ("runner",)

    def __init__(self, _loop: asyncio.AbstractEventLoop | None = None) -> None:
        self.runner: Any = None


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
        runner = loop and Stepping.of(loop).runner
        owner = (runner and runner.owner) or current_owner()
        if owner is None or owner.stream is None:
            return _outside
        if isinstance(owner.stream, str):
            owner.stream = random.Random(owner.stream)
        return owner.stream

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
