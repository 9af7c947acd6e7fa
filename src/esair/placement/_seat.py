"""The place of one component in its robot, while its code runs in a child.

The component itself stays where it is, with its ports, its rights and its mail; its
methods go to the child while it sits there. What the child asks for is done here, by the
component's own ports, in tasks of its own: so every rule of the robot holds for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import logging
import sys
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, Final

from esair.actions import Behavior, Hooks, Reaction, ReactionRunner, StepClock, Takes
from esair.codec import kinds_of
from esair.exceptions import BadValueError, ProcessDiedError
from esair.loop import (
    Deadlines,
    Door,
    Job,
    Owner,
    Player,
    Step,
    outside,
    spawn,
    turn_of,
)
from esair.messages import Placement, placement_of
from esair.placement._nursery import Nursery, import_path
from esair.placement._process import Process
from esair.placement._verbs import Asked, BehaviorVerbs, StepSeat, Verbs, verbs_of
from esair.placement._wire import ALWAYS, CALLS, End, Item, packed
from esair.plan import recipe_of
from esair.resources import Resource

__all__ = ["PlacedRunner", "Seat", "Seats", "StepSeat"]

PATIENCE: Final = 0.2
"""How long an answer may take if no actuator says by its ``command_timeout``, in s."""

HELD_ON: Final = 60.0
"""For how long at most who owes an answer holds on to what it held, in seconds: its
blindness, or its next decision, ends that."""


class Seats:
    """The places of one robot's components that live in children.

    Args:
        components: Returns the components of the robot; their classes may cross.
        command_timeout: Returns that of an actuator, by its name.
    """

    def __init__(
        self,
        components: Callable[[], Iterable[Any]],
        command_timeout: Callable[[str], float | None],
    ) -> None:
        self.kinds = kinds_of(components, ALWAYS)
        self.command_timeout = command_timeout
        self.nursery: Nursery = Nursery.hold()
        self._taken: dict[Seat, None] = {}

    async def ready(self) -> None:
        """Wait until children can be made."""
        loop = asyncio.get_running_loop()
        if isinstance(Door.of(loop).tape, Player):
            self.nursery.wait()  # how long that takes is not on the tape
        await outside(
            ("placement", "ready"), lambda: asyncio.to_thread(self.nursery.wait)
        )

    def seat(self, component: Any) -> Seat:
        """Return the place of a component."""
        placement = placement_of(component.placement)
        assert placement is not None
        seat = Seat(component, placement, self)
        self._taken[seat] = None
        return seat

    def close(self) -> None:
        """End what is left of the children."""
        for seat in tuple(self._taken):
            seat.rise()
        self.nursery.let_go()

    def left(self, seat: Seat) -> None:
        self._taken.pop(seat, None)


class Seat:
    """The place of one component, and the process that it has now, if any."""

    def __init__(self, component: Any, placement: Placement, seats: Seats) -> None:
        self.component = component
        self.placement = placement
        self.name: str = component.name
        self.process: Process | None = None
        # Now, and of its own: later it knows its robot, and what it got may have changed.
        self._recipe = copy.deepcopy(recipe_of(component))
        self._seats = seats
        self._owner = Owner()
        self._before: dict[str, Any] = {}
        self._on_death: Callable[[ProcessDiedError], object] | None = None
        self._verbs: Verbs

    @property
    def pid(self) -> int | None:
        return None if self.process is None else self.process.pid

    def sit(self, owner: Owner | None = None) -> None:
        """Let the component's methods go to a child, which begins with the first."""
        self.end()
        self._owner = owner or Owner()
        component = self.component
        if isinstance(component, Behavior):
            methods = ["run", *(["provide"] if component.provides else [])]
            given = {"setup": self._setup, "teardown": self._last("teardown")}
            given |= {name: self._method(name) for name in methods}
            for attribute, each in component.takes.items():
                if isinstance(each, Takes) and each.method is not None:
                    given[attribute] = self._answers(attribute)
        elif isinstance(component, Reaction):
            given = {}
        else:
            given = self._methods_of_driver(component)
        fields = vars(component)
        for name, method in given.items():
            self._before.setdefault(name, fields.get(name))
            fields[name] = method

    def rise(self) -> None:
        """Have the component as it was, and its process ended."""
        self.end()
        for name, before in self._before.items():
            vars(self.component).pop(name, None)
            if before is not None:
                vars(self.component)[name] = before
        self._before.clear()
        self._seats.left(self)

    def end(self) -> None:
        """End its process, if there is one, without a wait."""
        process, self.process = self.process, None
        if process is not None:
            self._verbs.close()
            process.close()

    def begin(
        self, on_death: Callable[[ProcessDiedError], object] | None = None
    ) -> None:
        """Begin a process with the component as it was added."""
        self.end()
        self._on_death = on_death
        self._verbs = verbs_of(self.component, self)
        process = self.process = Process(
            self.name,
            self._seats.kinds,
            self.placement,
            self._seats.nursery,
            self._owner,
            repeats=isinstance(self.component, Behavior | Reaction),
            serve=self._serve,
            died=self._died,
        )
        settled = {
            "path": import_path(),
            "argv": list(sys.argv),
            "name": self.name,
            "stream": self._owner.stream,
            "is_virtual": turn_of(process.loop).virtual,
            "memory": self.placement.memory,
            "nice": self.placement.nice,
            "level": logging.getLogger().getEffectiveLevel(),
        }
        process.call("settle", (settled,), self._settled)
        is_device = isinstance(self.component, Resource)
        settings = dict(self.component.settings) if is_device else {}
        process.call("make", (self._recipe, settings), self._made)

    def _settled(self, _value: Any, error: BaseException | None) -> None:
        """What could not be made answers every call with why."""
        if error is not None and self.process is not None:
            self.process.refuse(error)

    def _made(self, value: Any, error: BaseException | None) -> None:
        self._settled(value, error)
        if self.process is not None:
            self.process.is_made = True

    async def make(self) -> None:
        """Begin a process, and wait until the component is there."""
        self.begin(self._on_death)
        await self.lives.run("made")

    def decide(self, step: tuple[Any, ...], end: End, number: int = 0) -> None:
        """Have a reaction decide in the child; its decision comes to a function."""
        self.lives.call("react", (number, *step), end)

    # What its verbs need.

    def reply(self, op: bytes, number: int, value: Any) -> None:
        """Tell the child something about a call or a request."""
        if self.process is not None:
            self.process.tell(Item(op, number, "", self.pack("news", value)))

    def spawn(self, coroutine: Coroutine[Any, Any, None], name: str) -> object:
        """Do something in the name of the component."""
        loop = asyncio.get_running_loop()
        return spawn(loop, coroutine, name=f"{self.name} {name}", owner=self._owner)

    def command_timeout(self, resource: str) -> float | None:
        return self._seats.command_timeout(resource)

    @property
    def lives(self) -> Process:
        """Its process.

        Raises:
            ProcessDiedError: There is none.
        """
        if self.process is None:
            raise ProcessDiedError(self.name, "is not there")
        return self.process

    def pack(self, verb: str, value: Any) -> bytes:
        """Return a value as it crosses, or raise what its sender gets."""
        return packed(self.name, self._seats.kinds, verb, value)

    def works(self) -> Iterable[asyncio.Task[Any]] | None:
        """Return what its process waits for; None if that may go on by itself."""
        process = self.process
        if process is None or process.queue or not process.is_still:
            return None  # what waits there for its turn to be told lets it go on
        return process.tasks.values()

    # Its methods.

    def _method(self, name: str) -> Callable[..., Any]:
        async def method(*args: Any, **options: Any) -> Any:
            return await self.lives.run(name, *args, **options)

        return method

    async def _setup(self) -> Any:
        self.begin(self._on_death)
        return await self.lives.run("setup")

    def _last(self, name: str) -> Callable[..., Any]:
        async def method() -> None:
            process = self.process
            try:
                if process is not None and process.is_well:
                    await process.run(name)
            finally:
                if process is self.process:
                    self.end()
                elif process is not None:
                    process.close()

        return method

    def _answers(self, attribute: str) -> Callable[..., Any]:
        async def method(request: Any) -> Any:
            process = self.lives
            assert isinstance(self._verbs, BehaviorVerbs)
            number = self._verbs.hand(request)
            try:
                return await process.run(
                    "order", attribute, number, request.data, request.sender
                )
            finally:
                self._verbs.orders.pop(number, None)

        return method

    def _methods_of_driver(self, sensor: Any) -> dict[str, Callable[..., Any]]:
        self._on_death = sensor.report_lost
        given = {name: self._method(name) for name in ("open", "apply")}
        given["close"] = self._last("close")
        for name in ("identify", "is_set_up"):
            if getattr(type(sensor), name) is not getattr(Resource, name):
                given[name] = self._method(name)
        if sensor.can_be_asked:
            given["read"] = self._method("read")
        if sensor.pushes:
            given["stream"] = self._stream
        for name in sensor.operations:
            given[name] = self._method(name)
        return given

    async def _stream(self) -> Any:
        process = self.lives
        number = await process.run("stream")
        with contextlib.suppress(StopAsyncIteration):
            while True:
                yield await process.run("next", number)

    # What the child asks for.

    def _serve(self, item: Item, given: Any) -> None:
        process = self.process
        assert process is not None
        _, number, verb, _, scope, worked, _ = item
        options, *args = given or (None,)
        verb, _, port = verb.partition(" ")
        verbs, scopes, tasks = self._verbs, process.scopes, process.tasks
        plain = verbs.plain.get(verb)
        waits: Any = verbs.waits.get(verb)
        context = scopes.get(scope, process.nobodys).copy()
        if verb == "loop":
            scopes[args[0]] = context
        elif verb == "next_order":  # what it asks for next it does for that
            context = scopes[args[0]]
        if (
            not worked >= 0.0
            or (options is not None and type(options) is not dict)
            or (plain is None and waits is None)
            or number in tasks
            or len(tasks) >= CALLS
        ):
            process.condemn("has asked for what it cannot have")
        elif plain is None:
            asked = Asked(number, process.sent + worked, port)
            process.begin(number, context, waits, (asked, *args), options or {})
        else:
            try:
                value = context.run(plain, *args, **options or {})
            except Exception as error:
                process.answer(number, None, error)
            else:
                process.answer(number, value, None)

    def _died(self, error: ProcessDiedError) -> None:
        self._verbs.close()
        if self._on_death is not None:
            self._on_death(error)


class PlacedRunner(ReactionRunner):
    """Runs one reaction in a child, until it is stopped.

    A step takes effect in the turn in which its answer comes, if what it needs is still
    there and fresh. One that owes an answer for longer than a command may stand is blind.
    """

    __slots__ = (
        "_again",
        "_answer",
        "_asks",
        "_began",
        "_late_at",
        "_owes",
        "_seat",
        "_taking",
    )

    def __init__(
        self,
        reaction: Reaction,
        seat: Seat | StepSeat,
        hooks: Hooks,
        *,
        began: float = 0.0,
        owner: Owner | None = None,
    ) -> None:
        self._seat = seat
        self._owes = self._again = False
        self._answer: Any = None
        self._began = 0.0
        self._asks = StepClock(began)
        super().__init__(reaction, hooks, began=began, owner=owner)
        self._react = self._take
        self._taking: Job = self.scheduler.on_demand(self._decide, name=reaction.name)
        deadlines = Deadlines.of(asyncio.get_running_loop())
        self._late_at = deadlines.idle(self._owes_for_too_long)

    def start(self, inputs: Any, outputs: Any) -> None:
        self._seat.sit(self.owner)
        self._seat.begin(self._died)
        super().start(inputs, outputs)

    def stop(self) -> None:
        super().stop()
        self._taking.stop()
        self._late_at.cancel()
        self._seat.end()

    @property
    def patience(self) -> float:
        """How long it may owe an answer, in seconds."""
        all_ = self.outputs.all.values()
        found = (each.channel.actuator.command_timeout for each in all_)
        return min((each for each in found if each is not None), default=PATIENCE)

    @property
    def _turn(self) -> Step:
        return self._ask

    def _ask(self, now: float) -> None:
        """Have it decide on the newest readings; one step at a time."""
        if self._owes:
            self._again = True
            return
        senses = self.senses
        if not senses.see(now):
            return
        if senses.waiting:
            place, value = senses.waiting.popleft()
            senses.values[place] = value
        self._again = False
        clock = self._asks
        clock.step(now)
        step = (list(senses.values), clock.now_ms, clock.elapsed_ms)
        try:
            self._seat.decide(step, self._answered)
        except BadValueError as error:  # a reading is no plain data: the next may be
            for name, value in senses.by_name().items():
                try:
                    self._seat.pack(name, value)
                except BadValueError as unfit:
                    self._is_blind(str(unfit))
                    return
            self._is_blind(str(error))
            return
        except Exception as error:
            self.crash(error)
            return
        self._owes, self._began = True, now
        self._late_at.start(self._may_owe_until(now))

    def _may_owe_until(self, now: float) -> float:
        """Return when it is blind: nobody else moves what it has held until it is."""
        until = now + self.patience
        for each in self.outputs.all.values():
            hold, right = each.channel.hold, each.registration
            if hold.present(now) is right:
                lasts = right.hold or each.channel.wire.command_timeout
                until = min(until, hold.begun + lasts)
                hold.seconds = lasts + HELD_ON  # the loop may come late to that moment
        return until

    def _answered(self, value: Any, error: BaseException | None) -> None:
        if self.stopped:
            return
        self._owes = False
        self._late_at.cancel()
        if isinstance(error, ProcessDiedError):
            return  # told by the death itself
        if isinstance(error, BadValueError) and error.field == "answer":
            self.outputs.rejected += 1  # it is no plain data, so it is no command
            self.flawed(error)
            if self._again:
                self.job.soon()
        elif error is not None:
            self.crash(error)
        elif self.time() - self._began > self.patience:
            self.outputs.rejected += 1
            self.job.soon()
        else:
            self._answer = value
            self._taking.soon()

    def _decide(self, now: float) -> None:
        self._step(now)
        self._answer = None
        if (self._again or self.senses.waiting) and not self.stopped:
            self.job.soon()

    def _take(self, *_: Any) -> Any:
        return self._answer

    def _owes_for_too_long(self) -> None:
        self._is_blind(f"it owes an answer for {self.time() - self._began:.3g} s")

    def _is_blind(self, told: str) -> None:
        self.park(told)
        self.flaw = BadValueError(self.reaction.name, "react", told)

    def _died(self, error: ProcessDiedError) -> None:
        if not self.stopped:
            self.crash(error)
