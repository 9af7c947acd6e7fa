"""Behaviors: the deliberative actions of a robot, and what they ask of their supervisor."""

# mypy: disable-error-code="override, no-any-return"

from __future__ import annotations

import asyncio
import inspect
import types
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import (
    TYPE_CHECKING,
    Any,
    Concatenate,
    Final,
    Literal,
    NamedTuple,
    ParamSpec,
    Protocol,
    TypeVar,
    cast,
    overload,
)

from esair import minimal
from esair.abc import Action
from esair.actions._blocking_ports import (
    BlockingActuatorPort,
    BlockingSensorPort,
    Waits,
    calls,
    in_loop,
    waits,
)
from esair.actions._needs import Need, ProfiledAction, Unbound, not_bound
from esair.actions._reaction import Reaction, adapt_action
from esair.actions._requests import (
    BlockingRequestPort,
    Request,
    RequestPort,
    Takes,
    declared_requests,
)
from esair.connections import ActuatorPort, Halting, SensorPort, Stopped
from esair.exceptions import BadValueError, BehaviorUnavailableError, ConfigError
from esair.loop import PUT_COST, VERB_COST, Budget, Owner, Portal, portal
from esair.messages import Access, BehaviorStatus, Restart
from esair.values import check_duration, passes_as, type_name


class PortTerms(NamedTuple):
    """For what a behavior registers at run time; see `Behavior.register`."""

    resource: str
    access: Access
    as_type: type[Any] | None
    priority: int
    hold: float | None
    max_age: float | None


class Mail(Protocol):
    """How a running behavior exchanges data with others."""

    budget: Budget

    def hand(self, receiver: str, data: Any, interval: float) -> bool: ...
    def put(
        self, receiver: str, data: Any, interval: float
    ) -> Coroutine[Any, Any, None]: ...
    def take(self, sender: str, interval: float) -> Any: ...
    def get(self, sender: str, interval: float) -> Coroutine[Any, Any, Any]: ...
    async def receive(self, timeout: float | None) -> tuple[str, Any]: ...
    def ask(
        self,
        receiver: str,
        request: Any,
        timeout: float | None,
        progress: Callable[[Any], object] | None,
    ) -> Coroutine[Any, Any, Any]: ...
    def offer(self, data: Any, latest: bool) -> None: ...


class Host(Protocol):
    """What a running behavior asks of its supervisor."""

    @property
    def portal(self) -> Portal | None: ...
    async def perform(
        self,
        reaction: Reaction,
        until: Callable[..., bool] | None,
        timeout: float | None,
        blind_timeout: float | None,
    ) -> bool: ...
    async def perform_behavior(self, behavior: Any, timeout: float | None) -> Any: ...
    async def register(
        self, terms: PortTerms
    ) -> SensorPort[Any] | ActuatorPort[Any]: ...
    def halt_robot(self, reason: str) -> Halting: ...
    def query(self, name: str) -> BehaviorStatus: ...
    async def manage(self, verb: str, *args: Any) -> Any: ...
    async def stop_robot(self, reason: str) -> Stopped: ...


class Behaviors:
    """The behaviors of the robot, for one of them.

    It may always `query`. The rest takes a right from the developer:
    ``Policy.behaviors(allow={"captain": "manage"})``; each raises `AccessDeniedError`
    without it, and else does and raises what the `BehaviorSupervisor` does.
    """

    def __init__(self, host: Host) -> None:
        self._host = host

    def query(self, name: str) -> BehaviorStatus:
        """Tell what a behavior is doing. Answers at any time, without a wait.

        Raises:
            UnknownNameError: No behavior has the name.
        """
        return self._host.query(name)

    async def add(self, behavior: Action) -> None:
        """Deploy a behavior or reaction; see `BehaviorSupervisor.add`."""
        await self._host.manage("add", behavior)

    async def remove(self, name: str) -> list[Any]:
        """Take a behavior away; see `BehaviorSupervisor.remove`."""
        return await self._host.manage("remove", name)

    async def replace(self, name: str, behavior: Action) -> list[Any]:
        """Put another in the place of one; see `BehaviorSupervisor.replace`."""
        return await self._host.manage("replace", name, behavior)

    async def restart(self, name: str) -> None:
        """End the run of a behavior and begin another; see `BehaviorSupervisor.restart`."""
        await self._host.manage("restart", name)

    async def switch(self, mode: str, reason: str = "") -> None:
        """Go to another mode; see `BehaviorSupervisor.switch`."""
        await self._host.manage("switch", mode, reason)


class BlockingBehaviors(Waits):
    """`Behaviors` for a behavior with a plain ``run``: the thread waits."""

    __slots__ = ()

    query: Final = calls(Behaviors.query)
    add: Final = waits(Behaviors.add)
    remove: Final = waits(Behaviors.remove)
    replace: Final = waits(Behaviors.replace)
    restart: Final = waits(Behaviors.restart)
    switch: Final = waits(Behaviors.switch)


A = TypeVar("A")
T = TypeVar("T")
R = TypeVar("R")
P = ParamSpec("P")

if TYPE_CHECKING:
    import typing_extensions

    D = typing_extensions.TypeVar("D", default=Any)
else:
    D = TypeVar("D")  # a default is for type checkers alone before Python 3.13

NOTHING: Any = object()
"""What `Host.take` returns when there is nothing to take at once."""

Overflow = Literal["reject", "drop_oldest", "latest"]
"""What a full box does: refuse, drop its oldest, or keep only the newest."""


class Behavior(ProfiledAction):
    """A deliberative action: it asks, remembers, plans, and uses reactions.

    Write ``async def run`` for a task in the event loop, or a plain ``def run`` for
    a thread of its own, where every port and method below waits instead of being
    awaited. Declare what it uses with `esair.reads` and `esair.writes`.

    Example:
        >>> class Wander(esair.Behavior):
        ...     wheels = esair.writes(Twist)
        ...
        ...     async def run(self) -> None:
        ...         async for _ in esair.every(0.05):
        ...             await self.wheels.write(Twist(0.3, 0.0))
    """

    inbox_size: int = 16
    """How much data may wait in `receive`; then senders wait."""

    inbox_policy: Overflow = "reject"
    """What a full inbox does: ``"reject"`` lets senders wait."""

    open_at_rest: bool = False
    """Whether its inbox takes data while it rests in a mode in which it does not run."""

    outbox_size: int = 16
    """How much offered data may wait for a `get` of others."""

    outbox_policy: Overflow = "reject"
    """What a full outbox does: ``"reject"`` raises `BusyError` from `offer`."""

    restart: Restart = Restart()
    """How often it is started again after a crash."""

    essential: bool = False
    """Whether the robot ends, with an exit code, when it is FAILED."""

    _host = cast("Host", Unbound())
    _mail = cast("Mail", Unbound())

    if TYPE_CHECKING:

        def setup(self) -> Awaitable[None] | None: ...
        def run(self) -> Awaitable[Any] | Any: ...
        def teardown(self) -> Awaitable[None] | None: ...
        def provide(self) -> Awaitable[Any] | Any: ...

    else:  # the types above allow behaviors to write either kind of method

        async def setup(self) -> None:
            """Prepare; its ports are ready. An error here refuses the behavior."""

        async def run(self) -> None:
            """Do the work. Unless overridden it waits, and answers `get` by `provide`."""
            await asyncio.get_running_loop().create_future()

        async def teardown(self) -> None:
            """Clean up, after a normal end, an error, or the removal."""

        async def provide(self) -> Any:
            """Make the data that another behavior's `get` asks for, on demand."""
            raise NotImplementedError

    async def put(self, receiver: str, data: Any, interval: float = 1.0) -> None:
        """Hand data to another behavior, through the behavior supervisor.

        Returns when it lies in the receiver's inbox. A receiver that cannot take
        it is asked again until it can, or until the interval has passed.

        Args:
            receiver: The name of the other behavior.
            data: What it gets, untouched.
            interval: How long to keep asking, in seconds.

        Raises:
            UnknownNameError: No behavior has the name.
            RefusedError: It is a reaction, or at another robot.
            BehaviorUnavailableError: It could not receive for the interval; it
                will never see the data.
            BehaviorRemovedError: It was removed meanwhile.
            BehaviorFailedError: It crashed meanwhile.
            BusyError: Too many requests wait.
        """
        mail = self._mail
        budget = mail.budget
        budget.late -= PUT_COST
        if budget.clock() > budget.late:
            await budget.give_way()
        if not mail.hand(receiver, data, interval):
            await mail.put(receiver, data, interval)

    async def get(
        self, sender: str, interval: float = 1.0, *, as_type: type[D] | None = None
    ) -> D:
        """Ask another behavior for data, through the behavior supervisor.

        The other answers with what it has offered, or by its ``provide``.

        Args:
            sender: The name of the other behavior.
            interval: How long to keep asking, in seconds.
            as_type: What is expected; for type checkers, and checked when it comes.

        Raises:
            BadValueError: The other has given something else.
            UnknownNameError: No behavior has the name.
            RefusedError: It is a reaction, or at another robot.
            BehaviorUnavailableError: It could not send for the interval.
            CircularRequestError: It waits for this behavior's answer.
            BehaviorRemovedError: It was removed meanwhile.
            BehaviorFailedError: It crashed meanwhile, or its ``provide`` did.
            BusyError: Too many requests wait.
        """
        mail = self._mail
        budget = mail.budget
        budget.late -= PUT_COST
        if budget.clock() > budget.late:
            await budget.give_way()
        data = mail.take(sender, interval)
        if data is NOTHING:
            data = await mail.get(sender, interval)
        return data if as_type is None else self._checked(data, as_type, "get", sender)

    async def ask(
        self,
        receiver: str,
        request: Request[A],
        *,
        timeout: float | None = 10.0,
        progress: Callable[[Any], object] | None = None,
    ) -> A:
        """Ask another behavior to do something, and wait for its answer.

        The request has one outcome, whatever becomes of the other. If this task is
        cancelled, or this behavior ends, the other never sees the request, or its work
        on it is cancelled.

        Args:
            receiver: The name of the other behavior.
            request: What it is asked; its class says what it is answered with.
            timeout: How long it may wait and work, in seconds; None for no limit.
            progress: Called with what the other tells of its progress; of several
                that wait the newest wins. It may be a coroutine function.

        Returns:
            The answer.

        Raises:
            UnknownNameError: No behavior has the name, or a reaction has.
            RefusedError: The other refused, or does not take such requests.
            BehaviorFailedError: It failed, or ended its work without an answer.
            BehaviorRemovedError: It was removed, or replaced while it worked.
            BehaviorUnavailableError: There was no answer in time.
            CircularRequestError: It waits, itself or through others, for this one.
            BusyError: Too many requests wait.
            StoppingError: The robot is stopping.
        """
        return await self._mail.ask(receiver, request, timeout, progress)

    async def receive(
        self, *, timeout: float | None = None, as_type: type[D] | None = None
    ) -> D:
        """Wait for data that another behavior has put, and take it.

        Args:
            timeout: How long to wait, in seconds; None for no limit.
            as_type: What is expected; for type checkers, and checked when it comes.

        Raises:
            TimeoutError: There was none in time; what comes later waits.
            BadValueError: It is something else; it is taken all the same.
        """
        # That of a plain behavior in its thread would wait in the loop.
        asked = Behavior.receive_from(self, timeout=timeout, as_type=as_type)
        return (await asked)[1]

    async def receive_from(
        self, *, timeout: float | None = None, as_type: type[D] | None = None
    ) -> tuple[str, D]:
        """Wait for data as `receive` does.

        Returns:
            Who has put it, and the data.
        """
        mail = self._mail
        budget = mail.budget
        budget.late -= PUT_COST
        if budget.clock() > budget.late:
            await budget.give_way()
        if timeout is not None:
            check_duration(self.name, "timeout", timeout)
        sender, data = await mail.receive(timeout)
        if as_type is not None:
            self._checked(data, as_type, "receive", sender)
        return sender, data

    def offer(self, data: Any, *, latest: bool = False) -> None:
        """Lay data out for a `get` of others; each piece goes to one of them.

        Args:
            data: What one of them gets, untouched.
            latest: Everybody may get it, again and again, until the next offer.

        Raises:
            BusyError: The outbox is full, and its policy is ``"reject"``.
        """
        self._mail.offer(data, latest)

    @overload
    async def perform(
        self,
        reaction: Reaction | minimal.Reaction,
        *,
        until: Callable[..., bool] | None = None,
        timeout: float | None = None,
        blind_timeout: float | None = None,
    ) -> bool: ...
    @overload
    async def perform(
        self, reaction: Behavior, *, timeout: float | None = None
    ) -> Any: ...
    async def perform(
        self,
        reaction: Reaction | minimal.Reaction | Behavior,
        *,
        until: Callable[..., bool] | None = None,
        timeout: float | None = None,
        blind_timeout: float | None = None,
    ) -> Any:
        """Run a reaction or another behavior as a step of this behavior.

        Either acts in this behavior's name, and ends with it; what it held is safe
        then. A behavior runs in the task that performs it, from its ``setup`` to its
        ``teardown``, with this one's priority or less: an `asyncio.TaskGroup` performs
        several at a time, `asyncio.timeout` limits many.

        Args:
            reaction: What to run, a behavior too. It is registered in this behavior's name.
            until: Of a reaction: asked after each of its steps; it ends the reaction. Its
                parameters, if any, are named like readings and get them.
            timeout: How long it may run, in seconds. A behavior that goes on all the
                same moves nothing any more when the grace period is over, too.
            blind_timeout: How long a reaction may be blind at a time, in seconds; no
                limit unless given. Meanwhile it keeps its actuators safe, as it does
                without a behavior, and ``query`` tells why.

        Returns:
            Of a reaction: True if the condition came true, False if the time was over.
            Of a behavior: what its ``run`` returns.

        Raises:
            AccessDeniedError: This behavior may not do what the step does.
            BehaviorUnavailableError: A behavior did not end within its timeout.
            DeviceLostError: It was blind for too long: a device is not there.
            StaleReadingError: It was blind for too long: a sensor is silent.
            Exception: What the step raised.
        """
        host = self._host
        await Budget.spend(VERB_COST)
        for field, time in (("timeout", timeout), ("blind_timeout", blind_timeout)):
            if time is not None:
                check_duration(self.name, field, time)
        if isinstance(reaction, Behavior):
            if until is not None or blind_timeout is not None:
                told = (
                    "expected a timeout alone: until and blind_timeout are of reactions"
                )
                raise BadValueError(self.name, "perform", told)
            return await host.perform_behavior(reaction, timeout)
        adapted: Reaction = adapt_action(reaction)
        if not isinstance(adapted, Reaction):
            told = f"expected a Reaction or a Behavior, not {reaction!r:.80}"
            raise ConfigError(self.name, "perform", told)
        return await host.perform(adapted, until, timeout, blind_timeout)

    @overload
    async def register(
        self,
        resource: str,
        access: Literal[Access.READ],
        *,
        as_type: type[D] | None = None,
        max_age: float | None = None,
    ) -> SensorPort[D]: ...
    @overload
    async def register(
        self,
        resource: str,
        access: Literal[Access.WRITE],
        *,
        as_type: type[D] | None = None,
        priority: int = 0,
        hold: float | None = None,
    ) -> ActuatorPort[D]: ...
    @overload
    async def register(
        self,
        resource: str,
        access: Access,
        *,
        as_type: type[Any] | None = None,
        priority: int = 0,
        hold: float | None = None,
        max_age: float | None = None,
    ) -> Any: ...
    async def register(
        self,
        resource: str,
        access: Access,
        *,
        as_type: type[Any] | None = None,
        priority: int = 0,
        hold: float | None = None,
        max_age: float | None = None,
    ) -> Any:
        """Register for a resource at run time.

        Args:
            resource: Its name.
            access: What this behavior wants to do with it.
            as_type: The type of its readings or commands, as in `esair.reads`.
            priority: With which priority it writes; higher wins.
            hold: For how long a write holds the actuator, in seconds.
            max_age: The greatest age of a reading, in seconds.

        Returns:
            A `SensorPort` or an `ActuatorPort`.

        Raises:
            UnknownNameError: No resource has the name.
            AccessDeniedError: A rule denies it.
            ConfigError: It gives or takes something else.
        """
        terms = PortTerms(resource, access, as_type, priority, hold, max_age)
        return await self._host.register(terms)

    @property
    def supervisor(self) -> Behaviors:
        """The behaviors of the robot: what they do, and, with a right, to manage them.

        In the thread of a plain ``run`` its verbs wait.
        """
        host = self._host
        behaviors = Behaviors(host)
        if host.portal is None:
            return behaviors
        return cast("Behaviors", BlockingBehaviors(behaviors, host.portal))

    def halt_robot(self, reason: str) -> Halting:
        """Make every actuator safe and keep it so; see `Robot.halt`.

        It has taken effect when this returns. A plain call, also in the thread of a
        plain ``run``.

        Args:
            reason: Why, for the log and for whoever writes meanwhile.

        Returns:
            What each actuator is told and answers: await it, or, in a thread, call
            its ``result``.
        """
        return self._host.halt_robot(reason)

    async def stop_robot(self, reason: str) -> Stopped:
        """Stop the robot in order, this behavior too; see `Robot.stop`.

        Args:
            reason: Why, for `Robot.stopped` and the log.
        """
        return await self._host.stop_robot(reason)

    @property
    def takes(self) -> Mapping[str, Takes[Any] | str]:
        """The requests that it takes, by the name of the port or method; or what is wrong."""
        return declared_requests(type(self))

    @property
    def provides(self) -> bool:
        """Whether the class has a ``provide``."""
        return type(self).provide is not Behavior.provide

    def _checked(self, data: Any, wanted: type[T], verb: str, sender: str) -> T:
        if isinstance(data, wanted) or passes_as(data, wanted):
            return data
        told = f"expected {type_name(wanted)} from {sender}, not {data!r:.80}"
        raise BadValueError(self.name, verb, told)


def portal_of(behavior: Behavior) -> Portal:
    """Return the portal through which a thread of a behavior calls."""
    host: Host | None = vars(behavior).get("_host")
    found = portal.get(None) if host is None else host.portal
    if found is None:
        raise not_bound(behavior, "robot")
    return found


def _in_thread(behavior: Behavior) -> tuple[Portal, Behavior]:
    return portal_of(behavior), behavior


def _waits(
    method: Callable[Concatenate[Behavior, P], Awaitable[R]],
) -> Callable[[object], Callable[Concatenate[Any, P], R]]:
    """Return what makes a method wait in the thread: pyright overrides one by a method only."""
    return lambda _declared: waits(method, _in_thread)


class BlockingCalls:
    """What the thread of a behavior calls; parameters and results are those of `Behavior`."""

    @_waits(Behavior.put)
    def put(self) -> None: ...

    @_waits(Behavior.get)
    def get(self) -> None: ...

    @_waits(Behavior.ask)
    def ask(self) -> None: ...

    @_waits(Behavior.receive)
    def receive(self) -> None: ...

    @_waits(Behavior.receive_from)
    def receive_from(self) -> None: ...

    offer: Final = calls(Behavior.offer, _in_thread)

    @_waits(Behavior.stop_robot)
    def stop_robot(self) -> None: ...

    @overload
    def perform(
        self,
        reaction: Reaction | minimal.Reaction,
        *,
        until: Callable[..., bool] | None = None,
        timeout: float | None = None,
        blind_timeout: float | None = None,
    ) -> bool: ...
    @overload
    def perform(self, reaction: Behavior, *, timeout: float | None = None) -> Any: ...

    def perform(self: Any, reaction: Any, **terms: Any) -> Any:
        """Run a reaction or another behavior as a step; see `Behavior.perform`."""
        return portal_of(self).call(in_loop, Behavior.perform, self, reaction, **terms)

    @overload
    def register(
        self,
        resource: str,
        access: Literal[Access.READ],
        *,
        as_type: type[D] | None = None,
        max_age: float | None = None,
    ) -> BlockingSensorPort[D]: ...
    @overload
    def register(
        self,
        resource: str,
        access: Literal[Access.WRITE],
        *,
        as_type: type[D] | None = None,
        priority: int = 0,
        hold: float | None = None,
    ) -> BlockingActuatorPort[D]: ...
    @overload
    def register(
        self,
        resource: str,
        access: Access,
        *,
        as_type: type[Any] | None = None,
        priority: int = 0,
        hold: float | None = None,
        max_age: float | None = None,
    ) -> Any: ...

    def register(self: Any, resource: str, access: Access, **terms: Any) -> Any:
        """Register for a resource at run time; see `Behavior.register`."""
        return portal_of(self).call(Behavior.register, self, resource, access, **terms)


class ThreadBehavior(BlockingCalls, Behavior):  # type: ignore[misc]  # as it says
    """A behavior with a thread of its own: its ports and methods wait.

    Write a plain ``def run``. Everything else is as in `Behavior`.

    Example:
        >>> class Inspect(esair.ThreadBehavior):
        ...     arm = esair.writes(float)
        ...
        ...     def run(self) -> None:
        ...         for _ in esair.every(0.1):
        ...             self.arm.write(0.5)
    """

    def run(self) -> Any:
        """Do the work, in the thread. Unless overridden it waits."""
        portal_of(self).call(asyncio.Event().wait)

    @property
    def supervisor(self) -> BlockingBehaviors:
        """The behaviors of the robot: what they do, and, with a right, to manage them."""
        return cast("BlockingBehaviors", super().supervisor)


_CALLS = {
    name: method
    for name, method in vars(BlockingCalls).items()
    if isinstance(method, types.FunctionType)
}
"""What a plain behavior calls in its thread, and others await."""


def give(
    behavior: Behavior,
    host: Host,
    mail: Mail,
    portal: Portal | None,
    port_of: Callable[[str, Need], Any],
    loop_of: Callable[[str, Takes[Any]], Callable[[], Any]] | None,
) -> None:
    """Give a behavior what it declares; with a portal all of it waits, in its thread.

    Args:
        behavior: Who gets it.
        host: What it asks of its supervisor.
        mail: How it exchanges data with others.
        portal: The way of its thread, if it has one.
        port_of: Makes the port of a need, by its attribute.
        loop_of: Where requests come from, by its attribute; None if it takes none.
    """
    fields = vars(behavior)
    fields["_host"], fields["_mail"] = host, mail
    if portal is not None and not isinstance(behavior, ThreadBehavior):
        for name, method in _CALLS.items():
            fields[name] = types.MethodType(method, behavior)
    for attribute, need in behavior.needs.items():
        fields[attribute] = port_of(attribute, need)
    for attribute, each in (behavior.takes if loop_of else {}).items():
        if loop_of and isinstance(each, Takes) and each.method is None:
            loop = loop_of(attribute, each)
            fields[attribute] = (
                BlockingRequestPort(loop, portal) if portal else RequestPort(loop)
            )


def take_back(action: ProfiledAction, host: Host, portal: Portal | None) -> None:
    """Take a behavior its supervisor, if it has not another one by now."""
    fields = vars(action)
    if fields.get("_host") is not host:
        return
    del fields["_host"], fields["_mail"]
    for name in _CALLS if portal is not None else ():
        fields.pop(name, None)


async def run_as_step(
    behavior: Behavior,
    performer: str,
    portal: Portal | None,
    owner: Owner,
    timeout: float | None,
    is_ready: Callable[[], object],
) -> Any:
    """Set up a behavior that another performs, run it and clean up, in this task.

    Returns:
        What its ``run`` returns.

    Raises:
        BehaviorUnavailableError: It did not end within the time.
        Exception: What it raised.
    """

    async def call(method: Callable[[], Any]) -> Any:
        if inspect.iscoroutinefunction(method):
            return await method()
        way = portal if portal and not portal.closed else Portal(performer, owner)
        return await way.run(method)

    try:
        async with asyncio.timeout(timeout) as limit:
            await call(behavior.setup)
            is_ready()
            return await call(behavior.run)
    except TimeoutError:
        if timeout is None or not limit.expired():
            raise
        told, state = "come to its end", f"a step of {performer}"
        raise BehaviorUnavailableError(behavior.name, told, timeout, state) from None
    finally:
        await call(behavior.teardown)
