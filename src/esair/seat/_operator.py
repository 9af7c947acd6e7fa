"""The operator: a principal with rights of its own, and what it has done."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import contextvars
import inspect
import itertools
import logging
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import attrs

from esair import config
from esair.buses import Bus
from esair.connections import Registration
from esair.exceptions import (
    AccessDeniedError,
    BadValueError,
    BehaviorUnavailableError,
    BusyError,
    ConfigError,
    UnknownNameError,
    hint_for,
)
from esair.journal import Kind
from esair.loop import Door, News, TapeWriter, clock_of, current_owner, outside, spawn
from esair.messages import OPERATOR, Access
from esair.resources import HIDDEN, Resource, settings_of
from esair.seat._acts import ACTS, Act, Coming
from esair.seat._leases import Driver, Lease, Leases
from esair.seat._status import Status
from esair.seat._wire import Message
from esair.standard import public_text
from esair.supervisors import admit
from esair.values import printable

if TYPE_CHECKING:
    from esair.standard import Robot
    from esair.supervisors import BehaviorSupervisor, ResourceSupervisor

OUTCOMES = 1024  # How many outcomes are kept, so that the same id is done once
FILE = 1 << 20  # How long the file may be that a recording has, in characters
AT_A_TIME = 16  # How many acts of one session may be under way

_PEOPLE = frozenset({"resume", "mute", "reset", "lease", "drive"})
"""What no component may do by typing it."""

_log = logging.getLogger("esair")


@attrs.define(eq=False)
class Session:
    """Whoever gives acts: one client, or one who types."""

    who: str  # The user, and how it comes in, in words
    hand: Driver | None = None  # Hears beats; None if it cannot drive, and in a replay
    drives: bool = attrs.field(  # Whether it can drive
        default=attrs.Factory(lambda self: self.hand is not None, takes_self=True)
    )
    number: int = 0  # Of all sessions; 0 for who types
    given: int = 0  # How many acts it has given that may change something
    busy: int = 0  # How many of its acts are under way

    def beat(self, number: int) -> None:
        """Hear a beat."""
        if self.hand is not None:
            self.hand.beat(number)

    def lapsed(self, lease: Lease) -> None:
        """Hear that a lease is over."""
        if self.hand is not None:
            self.hand.lapsed(lease)


class Given(NamedTuple):
    """An act as it comes in by the door, and as it is kept for a replay."""

    session: int
    number: int  # Of the act, among those of the session
    who: str  # The user, and how it comes in, in words
    drives: bool  # Whether the session can drive
    act: str
    fields: dict[str, Any]  # What it is about; of a secret only that there is one
    until: float | None  # When it is too late for it, on the robot's clock; or None


class Waiting(NamedTuple):
    """An act that has been given and has not begun."""

    session: Session
    act: Act
    fields: dict[str, Any]
    outcome: asyncio.Future[Any]


class Console:
    """Does the acts of the operator, whichever way they come in."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.name = OPERATOR
        self.rights = robot.operator
        self._loop = asyncio.get_running_loop()
        self._time = clock_of(self._loop)
        # Whoever woke the loop lends its context; an act has that of nobody.
        self._context = contextvars.Context()
        self._given = News(self._loop, ("operator",), self._hear)
        self._left = News(self._loop, ("operator", "leaves"), self._hear_leave)
        self._waiting: dict[tuple[int, int], Waiting] = {}
        self._sessions: dict[int, Session] = {}
        self._numbers = itertools.count(1)
        self.status: Status = Status(robot, self._loop)
        self.leases: Leases = Leases(
            robot.resources, robot.actuators, self.name, self.rights.priority
        )
        self._outcomes: collections.OrderedDict[
            tuple[str, str], tuple[Act, asyncio.Future[Any]]
        ] = collections.OrderedDict()
        self._typed = itertools.count(1)
        self.done: int = 0  # How many acts were done; who looks does none
        self.refused: int = 0  # How many were not
        self.again: int = 0  # How many came again with the same id: done once
        robot.journal.count("operator", lambda: [(self.name, self.counts())])

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            "acts": self.done,
            "refused": self.refused,
            "again": self.again,
            "lapses": self.leases.lapses,
            "stale": self.leases.stale,
        }

    def take(self, message: Message, session: Session) -> asyncio.Future[Any]:
        """Take an act in; it takes effect in the next turn, by the one door.

        Returns:
            Its outcome. The same act with the same id of the same user has the same one;
            but who stops the robot is never told of an earlier stop.
        """
        key = (session.who, message.id)
        outcome = self._outcome()
        try:
            act = self._act(message)
            fields = act.checked(message.fields)
            known = self._outcomes.get(key)
            if known is not None and not act.open:
                if known[0] is not act:
                    raise BadValueError(
                        "message", "id", f"it was that of {known[0].name}"
                    )
                self.again += 1
                return known[1]
            self._check_right(act, str(fields.get(act.about) or ""))
            # Who waits for as many acts as may be can look at them.
            most = 2 * AT_A_TIME if act.looks else AT_A_TIME
            if session.busy >= most and not act.open:
                raise BusyError("operator", "number of acts at a time", most)
        except Exception as error:
            self.refused += 1
            outcome.set_exception(error)
            return outcome
        if not act.looks:
            self._outcomes.setdefault(key, (act, outcome))
            while len(self._outcomes) > OUTCOMES:
                self._outcomes.popitem(last=False)
        session.busy += 1
        waiting = Waiting(session, act, fields, outcome)
        if act.looks or current_owner() is not None:
            # Looking changes nothing, and what a component types repeats by itself.
            self._loop.call_soon(self._context.run, self._do, waiting, message.until)
        else:
            self._give(waiting, message.until)
        return outcome

    async def do(self, act: str, fields: dict[str, Any], session: Session) -> Any:
        """Do an act of somebody who waits for it.

        Raises:
            EsairError: As the act.
        """
        if current_owner() is not None and act in _PEOPLE:
            told = "only people may, no component"
            raise AccessDeniedError("a behavior", self.robot.name, act, told)
        message = Message(f"typed {next(self._typed)}", act, fields)
        return await asyncio.shield(self.take(message, session))

    async def bring(self, coming: Coming, session: Session) -> str:
        """Add an instance of a class that somebody has typed in the robot's program.

        It is no act: what comes in from outside never names a class.

        Raises:
            ConfigError: There is no such class, or a key is wrong.
            EsairError: As `add` and `replace` of the supervisors.
        """
        act, old, driver, values = coming
        self._check_right(act, old or driver)
        owner = None if old is None else self.supervisor_of(old)
        source = self.robot.source
        folder = Path.cwd() if source is None else source[0].resolve().parent

        if not config.is_imported(driver):  # what a module does may take long
            load = asyncio.to_thread(config.find_module, driver, folder)
            await outside(("operator", "module"), lambda: load)
        buses = self.robot.resources.buses
        values = {**values} if old is None else {**values, "name": old}
        part: Any = config.make_component(driver, values, buses, folder)
        told = {"act": act.name, "by": session.who, "class": driver}
        self.robot.journal.publish(Kind.OPERATOR, part.name, self.name, told)
        _log.info("%s: %s %s as %s", session.who, act.name, driver, part.name)
        if owner is None or old is None:
            await self.owner_of(part).add(part)
            return f"{part.name} was added"
        await owner.replace(old, part)
        return f"{old} was replaced"

    def leave(self, session: Session) -> None:
        """A session ends: what it drives is released."""
        if session.number:  # else it has done nothing
            self._left.tell(session.number)

    def close(self) -> None:
        """The robot stops: give back what is driven, and end what waits."""
        self.leases.close()

    # What the acts use.

    @contextlib.contextmanager
    def right_to_configure(self, resource: str) -> Iterator[Registration]:
        """Give the operator the right to change the settings of a resource."""
        registration = admit(
            self.robot.resources,
            self.name,
            resource,
            Access.CONFIGURE,
            priority=self.rights.priority,
        )
        try:
            yield registration
        finally:
            self.robot.resources.revoke(registration)

    def supervisor_of(self, name: str) -> BehaviorSupervisor | ResourceSupervisor:
        """Return whose component this is.

        Raises:
            UnknownNameError: Nobody has the name.
        """
        robot = self.robot
        if name in robot.behaviors.names():
            return robot.behaviors
        if name in robot.resources.names():
            return robot.resources
        known = [*robot.behaviors.names(), *robot.resources.names()]
        raise UnknownNameError("component", name, known)

    def owner_of(self, part: Any) -> BehaviorSupervisor | ResourceSupervisor:
        """Return who deploys a part that is not deployed yet."""
        robot = self.robot
        return robot.resources if isinstance(part, Resource) else robot.behaviors

    async def part(self, name: str) -> Any:
        """Make the part of a name that the robot's own file has now.

        No message names a class: what can come is what the file has.

        Raises:
            ConfigError: The robot was not made from a file, or has no such part there.
        """
        source = self.robot.source
        if source is None:
            told = "the robot was not made from a file: add it in its program"
            raise ConfigError(name, "", told)
        path, simulated = source
        made: list[config.Description] = []

        def load(text: str | None) -> str:
            try:
                made.append(
                    config.load(
                        path,
                        simulated=simulated,
                        robot_class=type(self.robot),
                        text=text,
                    )
                )
            except ExceptionGroup as group:
                told = "; ".join(str(each) for each in group.exceptions)
                raise ConfigError(name, "", told) from None
            return public_text(made[0].text, made[0].resources.values())

        text = await outside(
            ("operator", "file"), lambda: asyncio.to_thread(load, None)
        )
        if not made:  # in a replay: the file as it was then
            if not isinstance(text, str) or len(text) > FILE:
                raise ConfigError(str(path), "", "the recording has no such file")
            _check_words(str(path), tomllib.loads(text), config.tables_of(path))
            load(text)
        (described,) = made
        parts = {**described.resources, **described.behaviors}
        if name not in parts:
            hint = hint_for(name, sorted(parts), "it has")
            raise ConfigError(name, "", f"{path} has no such part{hint}")
        part = parts[name]
        for bus in self.robot.resources.buses:  # one owner for each
            if (
                isinstance(of := getattr(part, "bus", None), Bus)
                and bus.name == of.name
            ):
                bus.adopt(part)
        return part

    # Inside.

    def _act(self, message: Message) -> Act:
        act = ACTS.get(message.act)
        if act is None:
            told = f"{message.act!r:.40} is none{hint_for(message.act, ACTS)}"
            raise ConfigError("operator", "act", told)
        return act

    def _check_right(self, act: Act, about: str) -> None:
        if act.looks or act.open or self.rights.may(act.name):
            return
        allowed = ", ".join(self.rights.allow) or "nothing"
        raise AccessDeniedError(
            self.name,
            about or self.robot.name,
            act.name,
            f"[operator] allows {allowed}",
        )

    def _outcome(self) -> asyncio.Future[Any]:
        outcome: asyncio.Future[Any] = self._loop.create_future()
        outcome.add_done_callback(lambda done: done.cancelled() or done.exception())
        return outcome

    def _give(self, waiting: Waiting, until: float | None) -> None:
        """Bring an act in from outside, by the one door."""
        session, act, fields, _ = waiting
        if session.hand is not None and not session.number:
            session.number = next(self._numbers)
            self._sessions[session.number] = session
        session.given += 1
        shown = self._shown(act, fields)
        tape = Door.of(self._loop).tape
        is_hidden = shown is not fields and self._sets(fields) is not None
        if is_hidden and isinstance(tape, TapeWriter):
            tape.spoil("an operator has set a secret there, which is not kept")
        given = Given(
            session.number,
            session.given,
            session.who,
            session.drives,
            act.name,
            shown,
            until,
        )
        self._waiting[given[:2]] = waiting
        self._given.tell(*given)

    def _hear(self, *told: Any) -> None:
        """An act takes effect; in a replay there is nobody who has given it."""
        given = Given(*told)
        waiting = self._waiting.pop(given[:2], None)
        if waiting is None:
            session = self._sessions.setdefault(
                given.session,
                Session(given.who, drives=given.drives, number=given.session),
            )
            session.busy += 1
            act = ACTS[given.act]
            waiting = Waiting(session, act, given.fields, self._outcome())
        self._context.run(self._do, waiting, given.until)

    def _hear_leave(self, number: int) -> None:
        session = self._sessions.pop(number, None)
        if session is not None:
            self.leases.end_all(session)

    def _do(self, waiting: Waiting, until: float | None) -> None:
        """Do an act, in the turn that is its own."""
        session, act, fields, _ = waiting
        if until is not None and self._time() > until:
            late = self._time() - until
            error = BehaviorUnavailableError("operator", act.name, late, "too late")
            self._end(waiting, error=error)
            return
        if not act.looks:
            component = str(fields.get(act.about) or self.robot.name)
            shown = self._shown(act, fields)
            told = {"act": act.name, "by": session.who, **shown}
            self.robot.journal.publish(
                Kind.OPERATOR, component.partition(".")[0], self.name, told
            )
            if act.name not in {"drive", "lease", "release"}:
                _log.info("%s: %s %s", session.who, act.name, printable(str(shown)))
        try:
            result = act.run(self, session, **fields)
        except Exception as error:
            self._end(waiting, error=error)
            return
        if not inspect.isawaitable(result):
            self._end(waiting, result)
            return
        work = self._finish(result, waiting)
        spawn(self._loop, work, name=f"operator {act.name}")

    def _shown(self, act: Act, fields: dict[str, Any]) -> dict[str, Any]:
        """Return what an act is about as it may be recorded and shown."""
        if act.name != "set":
            return fields
        resource, setting = self._sets(fields), fields["setting"].partition(".")[2]
        if resource is not None:
            known = settings_of(type(resource)).get(setting)
            if known is None or not known.secret:
                return fields
        return {**fields, "value": HIDDEN}

    def _sets(self, fields: dict[str, Any]) -> Resource | None:
        """Return the resource that a setting is of; None if there is none of its name."""
        name, resources = fields["setting"].partition(".")[0], self.robot.resources
        return resources.get(name) if name in resources.names() else None

    async def _finish(self, work: Any, waiting: Waiting) -> None:
        try:
            self._end(waiting, await work)
        except asyncio.CancelledError as error:  # the robot has stopped
            self._end(waiting, error=error)
            raise
        except Exception as error:
            self._end(waiting, error=error)

    def _end(
        self,
        waiting: Waiting,
        result: Any = None,
        *,
        error: BaseException | None = None,
    ) -> None:
        waiting.session.busy -= 1
        outcome = waiting.outcome
        if outcome.done():
            return
        if error is None:
            self.done += not waiting.act.looks
            outcome.set_result(result)
            return
        self.refused += 1
        if isinstance(error, asyncio.CancelledError):
            outcome.cancel()
        else:
            outcome.set_exception(error)


def _check_words(path: str, then: Any, now: Any, key: str = "") -> None:
    """Refuse a file as a recording has it if it names what the file of today does not.

    Its numbers may be others; its words are modules, classes and paths, and a recording
    may be somebody else's.

    Raises:
        ConfigError: It does.
    """
    if isinstance(then, dict):
        for name, value in then.items():
            inner = now.get(name) if isinstance(now, dict) else None
            _check_words(path, value, inner, f"{key}.{name}" if key else name)
    elif isinstance(then, list):
        for place, value in enumerate(then):
            found = now[place] if isinstance(now, list) and place < len(now) else None
            _check_words(path, value, found, key)
    elif isinstance(then, str) and then != now:
        told = f"it was {then!r:.80} when the run was recorded: replay with that file"
        raise ConfigError(path, key, told)
