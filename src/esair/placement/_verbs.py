"""What a child may ask of its robot: by name, and nothing else."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import sys
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

from esair import minimal
from esair.actions import Behavior, Reaction, adapt_action
from esair.connections import run_ended
from esair.exceptions import AccessDeniedError, ConfigError, NotRegisteredError
from esair.loop import clock_of, current_task_of, ignore, settle, wake
from esair.messages import Access, Refused
from esair.placement._wire import ASKED, AWAITED, CALLED, End, Op, make
from esair.plan import SCRIPT
from esair.values import check_duration

Seat = Any  # that of its component: it makes these, and they know of it what they call

SCRIPT_OF_CHILD: Final = "__mp_main__"
"""What the script is in a child, as `multiprocessing` calls it."""

_ACTIONS = (Behavior, Reaction, minimal.Reaction)
_MANAGED = {"add", "remove", "replace", "restart", "switch"}
_ORDER = {"answer", "refuse", "progress", "cancelled"}


class Asked(NamedTuple):
    """What is known of a call beside its arguments.

    Attributes:
        number: Its number, for what is told of it before its end.
        made: When the child has made it.
        port: Which port is meant, if it is one.
    """

    number: int
    made: float
    port: str


def loaded(recipe: Any) -> Any:
    """Make an action that a child names, in the robot's process.

    Of a class that is loaded there, and is one of an action: nothing is imported for it,
    and nothing but its own constructor is called.

    Raises:
        ConfigError: No class of an action is loaded by this name.
    """
    match recipe:
        case {"module": str(module), "class": str(path), "args": tuple(), **rest}:
            found: Any = sys.modules.get(
                SCRIPT if module == SCRIPT_OF_CHILD else module
            )
            for part in path.split("."):
                found = getattr(found, "__dict__", {}).get(part)
            if isinstance(found, type) and issubclass(found, _ACTIONS):
                return adapt_action(make(recipe, found))
            told = f"the robot has no class of an action loaded as {module}:{path}"
            told += ": define it at the top of a module that the robot imports"
            raise ConfigError(str(rest.get("name")), "", told)
    raise ConfigError("behaviors", "", f"expected an action, not {recipe!r:.80}")


class StepSeat:
    """The seat of a reaction that a behavior performs: a part of the behavior's own.

    What the child answers is what the step has decided, and whether it is over.
    """

    def __init__(self, seat: Seat, number: int) -> None:
        self._seat = seat
        self._number = number
        self._over = False

    def sit(self, owner: object) -> None:
        """It begins, ends and dies with the behavior."""

    begin = sit

    def end(self) -> None:
        """As above."""

    def is_over(self) -> bool:
        return self._over

    def pack(self, verb: str, value: Any) -> bytes:
        """Return a value as it crosses."""
        found: bytes = self._seat.pack(verb, value)
        return found

    def decide(self, step: tuple[Any, ...], end: End) -> None:
        """Have the child decide."""

        def decided(value: Any, error: BaseException | None) -> None:
            if error is None:
                value, self._over = value
            end(value, error)

        self._seat.decide(step, decided, self._number)


class InHand(asyncio.Future[None]):
    """Waits until the child has fetched something; cancelled, it puts that back at once."""

    value: Any
    put_back: Callable[[], object]
    fetched: Callable[[], object]

    def cancel(self, msg: Any | None = None) -> bool:
        is_left = super().cancel(msg)
        if is_left:
            self.put_back()
        return is_left


class Verbs:
    """What a child may ask for, by name.

    Attributes:
        plain: What is done at once.
        waits: What is waited for; it gets what is known of the call first.
    """

    def __init__(self) -> None:
        self.plain: dict[str, Callable[..., Any]] = {}
        self.waits: dict[str, Callable[..., Any]] = {}

    def close(self) -> None:
        """The process is gone: nothing comes of it any more."""


def verbs_of(component: Any, seat: Seat) -> Verbs:
    """Return what the child of a component may ask for."""
    if isinstance(component, Behavior):
        return BehaviorVerbs(seat, component)
    if isinstance(component, Reaction):
        return PortVerbs(seat, component)
    verbs = Verbs()  # what a driver says beside its answers

    def lost(error: Any) -> None:  # behind the answer of a call that says so
        asyncio.get_running_loop().call_soon(component.report_lost, error)

    verbs.plain |= {"lost": lost, "arrived": component.report_arrived}
    return verbs


class PortVerbs(Verbs):
    """What a reaction may ask of its ports."""

    def __init__(self, seat: Seat, action: Behavior | Reaction) -> None:
        super().__init__()
        self._seat = seat
        self._action = action
        self._actions: dict[str, Behavior | Reaction] = {"": action}
        """It, and the steps that it performs now, by what their ports begin with."""
        self._registered: dict[str, Any] = {}
        self.plain["peek"] = self._peek

    def _find(self, key: str, name: str, allowed: set[str]) -> Any:
        port = self._registered.get(key)
        step, _, attribute = key.rpartition(":")
        action = self._actions.get(step)
        if port is None and action is not None and attribute in action.needs:
            port = vars(action).get(attribute)
        if port is None or name not in allowed:
            raise AccessDeniedError(self._action.name, key, name, "it is not declared")
        return port

    def _peek(self, key: str, name: str, *args: Any) -> Any:
        found = getattr(self._find(key, name, CALLED | ASKED), name)
        if name == "release":
            found()
            return None
        if name == "settings":
            return dict(found)
        return found(*args) if callable(found) else found


class BehaviorVerbs(PortVerbs):
    """What a behavior may ask: of its ports, of its supervisor, and of others."""

    def __init__(self, seat: Seat, behavior: Behavior) -> None:
        super().__init__(seat, behavior)
        self._behavior = behavior
        self._time = clock_of(asyncio.get_running_loop())
        self._streams: dict[int, Any] = {}
        self._loops: dict[int, tuple[Any, int]] = {}
        self._number = 0
        self._halting: Any = None
        self._stages: dict[int, Iterator[asyncio.Future[None]]] = {}
        """What each behavior that is performed waits for, by the number of its call."""
        self.orders: dict[int, Any] = {}
        """The requests that the child works on, by their number."""
        self._left: dict[int, asyncio.Future[BaseException | None]] = {}
        self._handed: dict[int, InHand] = {}
        """What the child may fetch, by the number of its call."""
        self._is_over = False
        self.plain |= {
            # Not its own: that of a thread's behavior waits for a thread, in the child.
            "offer": lambda *args, **options: Behavior.offer(
                behavior, *args, **options
            ),
            "query": lambda name: behavior.supervisor.query(name),
            "halt": self._halt,
            "stage": self._next_stage,
            "fetch": self._fetch,
            "order": self._order,
            "enter": self._enter,
            "leave": self._leave,
        }
        self.waits |= {
            "put": lambda _, *args: Behavior.put(behavior, *args),
            "get": self._get,
            "ask": self._ask,
            "receive": self._receive,
            "register": self._register,
            "perform": self._perform,
            "step": self._step,
            "manage": self._manage,
            "stop": self._stop,
            "halted": self._halted,
            "values": self._values,
            "next": lambda _, number: anext(self._streams[number]),
            "left": self._close_values,
            "loop": self._loop,
            "next_order": self._next_order,
        }
        for name in AWAITED:
            self.waits[name] = functools.partial(self._port, name)

    def _next(self) -> int:
        self._number += 1
        return self._number

    # Ports.

    async def _port(self, name: str, asked: Asked, *args: Any, **options: Any) -> Any:
        port = self._find(asked.port, name, AWAITED)
        if name == "write":
            limit = self._seat.command_timeout(port.resource)
            now = self._time()
            age = now - asked.made
            if limit is not None and age > limit:
                rule = f"the command is {age:.3g} s old: command_timeout is {limit:g} s"
                priority = port.registration.priority
                return Refused(self._behavior.name, priority, rule, now, None)
        return await getattr(port, name)(*args, **options)

    async def _register(
        self, _: Asked, step: str, resource: str, access: Access, **terms: Any
    ) -> str:
        behavior = self._performer(step)
        port = await Behavior.register(behavior, resource, access, **terms)
        # The same again is the same port: some register for each job.
        key = f"{step}:registered {resource} {access!r} {terms}"
        self._registered[key] = port
        return key

    # Steps: their code runs in the child, their rights and their blindness are here.

    def _performer(self, step: str) -> Any:
        """Return the behavior, or the step of it, that asks for something."""
        if step not in self._actions:
            raise NotRegisteredError(self._action.name, "robot", "this step is over")
        return self._actions[step]

    async def _perform(
        self,
        asked: Asked,
        recipe: object,
        ends: bool,
        timeout: float | None,
        blind_timeout: float | None,
        step: str = "",
    ) -> bool:
        limits = {"timeout": timeout, "blind_timeout": blind_timeout}
        for field, seconds in limits.items():
            if seconds is not None:
                check_duration(self._behavior.name, field, seconds)
        reaction = loaded(recipe)
        if not isinstance(reaction, Reaction) or reaction.guarded is not None:
            told = "a guard stays in the robot's process, and so does who performs it"
            raise ConfigError(reaction.name, "placement", told)
        seat = StepSeat(self._seat, asked.number)
        until = seat.is_over if ends else None
        with self._performed(asked, reaction):
            host = self._performer(step)._host  # noqa: SLF001 - what it speaks to
            return await host.perform(reaction, until, **limits, seat=seat)  # type: ignore[no-any-return]

    async def _step(
        self, asked: Asked, recipe: object, timeout: float | None = None, step: str = ""
    ) -> None:
        behavior, host = loaded(recipe), self._performer(step)._host  # noqa: SLF001
        if not isinstance(behavior, Behavior):
            raise ConfigError(behavior.name, "", "expected a Behavior")
        if timeout is not None:
            check_duration(self._behavior.name, "timeout", timeout)
            timeout += host.crew.grace  # the child has ended it before, and cleaned up
        loop = asyncio.get_running_loop()
        is_set_up, is_over = stages = loop.create_future(), loop.create_future()

        async def setup() -> None:
            self._seat.reply(Op.NEWS, asked.number, None)
            await is_set_up

        async def run() -> None:
            await is_over

        async def teardown() -> None:
            """The child has done it."""

        vars(behavior).update(setup=setup, run=run, teardown=teardown)
        self._stages[asked.number] = iter(stages)
        with self._performed(asked, behavior):
            await host.perform_behavior(behavior, timeout)

    @contextlib.contextmanager
    def _performed(self, asked: Asked, action: Behavior | Reaction) -> Iterator[None]:
        step = str(asked.number)
        self._actions[step] = action
        try:
            yield
        finally:
            del self._actions[step]
            self._stages.pop(asked.number, None)
            for key in [k for k in self._registered if k.startswith(f"{step}:")]:
                del self._registered[key]

    def _next_stage(self, number: int) -> None:
        wake(next(self._stages.get(number, iter(())), None))

    async def _values(self, _: Asked, key: str) -> tuple[int, Any]:
        """Begin a loop over a port, and wait for its first value as the port would."""
        values = aiter(self._find(key, "reading", AWAITED))
        first = await anext(values)
        number = self._next()
        self._streams[number] = values
        return number, first

    async def _close_values(self, _: Asked, number: int) -> None:
        await self._streams.pop(number).aclose()

    # Others.

    async def _ask(
        self, asked: Asked, receiver: str, request: Any, timeout: Any, progress: bool
    ) -> Any:
        def tell(news: Any) -> None:
            self._seat.reply(Op.NEWS, asked.number, news)

        return await Behavior.ask(
            self._behavior,
            receiver,
            request,
            timeout=timeout,
            progress=tell if progress else None,
        )

    async def _receive(self, asked: Asked, timeout: float | None) -> None:
        mail = vars(self._behavior)["_mail"]
        taken = await Behavior.receive_from(self._behavior, timeout=timeout)
        await self._hand_over(asked.number, taken, lambda: mail.untake(taken))

    async def _get(self, asked: Asked, sender: str, interval: float) -> None:
        mail = vars(self._behavior)["_mail"]
        data = await mail.get(sender, interval, is_taken=False)
        await self._hand_over(
            asked.number,
            data,
            lambda: mail.give_back(sender, data),
            lambda: mail.got(sender, data),
        )

    async def _hand_over(
        self,
        number: int,
        value: Any,
        put_back: Callable[[], object],
        fetched: Callable[[], object] = ignore,
    ) -> None:
        """Wait until the child has fetched something; what it does not is put back."""
        loop = asyncio.get_running_loop()
        context = current_task_of(loop).get_context()
        in_hand = self._handed[number] = InHand(loop=loop)
        in_hand.value = value
        in_hand.put_back = functools.partial(context.run, put_back)
        in_hand.fetched = fetched
        self._seat.reply(Op.NEWS, number, None)
        try:
            await in_hand
        finally:
            del self._handed[number]

    def _fetch(self, number: int) -> Any:
        in_hand = self._handed.get(number)
        if in_hand is None or in_hand.done():
            raise run_ended(self._behavior.name)
        in_hand.set_result(None)
        in_hand.fetched()
        return in_hand.value

    async def _manage(self, _: Asked, verb: str, *args: Any) -> Any:
        if verb not in _MANAGED:
            raise AccessDeniedError(self._behavior.name, "behaviors", verb, "no verb")
        made = [each if isinstance(each, str) else loaded(each) for each in args]
        return await getattr(self._behavior.supervisor, verb)(*made)

    def _halt(self, reason: str) -> None:
        self._halting = self._behavior.halt_robot(reason)

    async def _halted(self, _: Asked) -> Any:
        return tuple(await self._halting)

    async def _stop(self, _: Asked, reason: str) -> Any:
        stopped = await Behavior.stop_robot(self._behavior, reason)
        return tuple(stopped), stopped.reason

    # Requests.

    def hand(self, request: Any) -> int:
        """Let the child work on a request; return its number."""
        number = self._next()
        self.orders[number] = request
        return number

    def _order(self, number: int, what: str, *args: Any) -> Any:
        request = self.orders.get(number)
        if request is None or what not in _ORDER:
            return what == "cancelled"
        found = getattr(request, what)
        return found(*args) if callable(found) else found

    def _enter(self, number: int) -> None:
        loop = asyncio.get_running_loop()
        self._left[number] = loop.create_future()
        self._seat.spawn(self._attend(number, self.orders[number]), "request")

    async def _attend(self, number: int, request: Any) -> None:
        """Be the one who works on a request, for the child."""
        error: BaseException | None = None
        try:
            async with request:
                try:
                    error = await self._left[number]
                except asyncio.CancelledError:
                    if self._is_over:
                        raise
                    loop = asyncio.get_running_loop()
                    left = self._left[number] = loop.create_future()
                    self._seat.reply(Op.WITHDRAWN, number, None)
                    await left
                    raise
                if error is not None:
                    raise error
        except BaseException as raised:  # its asker and its worker are told it
            if raised is not error:
                raise

    def close(self) -> None:
        self._is_over = True
        for in_hand in reversed(tuple(self._handed.values())):
            in_hand.cancel()  # the last first: each goes before the others
        for left in self._left.values():
            settle(left, None, None)

    def _leave(self, number: int, error: bytes | None) -> None:
        left = self._left.pop(number, None)
        self.orders.pop(number, None)
        if left is not None and not left.done():
            left.set_result(
                None if error is None else self._seat.lives.unpack_error(error)
            )

    async def _loop(self, _: Asked, number: int, attribute: str) -> None:
        if attribute not in self._behavior.takes:
            raise AccessDeniedError(
                self._behavior.name, attribute, "take", "not declared"
            )
        self._loops[number] = aiter(vars(self._behavior)[attribute]), 0

    async def _next_order(self, asked: Asked, number: int) -> None:
        loop, before = self._loops[number]
        self.orders.pop(before, None)
        request = await anext(loop)
        order = self.hand(request)
        self._loops[number] = loop, order
        value = order, request.data, request.sender
        await self._hand_over(asked.number, value, loop.put_back)
