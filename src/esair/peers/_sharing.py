"""What a peer may do here: read, write and ask what is shared with it, in its own name."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import itertools
import math
from collections.abc import Iterable
from typing import Any, Final, Literal, cast

import attrs

from esair.actions import Behavior, Request, reads, writes
from esair.buses.peer import QUIET, SILENCE, PeerBus
from esair.exceptions import (
    BadValueError,
    BehaviorFailedError,
    BehaviorRemovedError,
    BusyError,
    CircularRequestError,
    ConfigError,
    DeviceLostError,
    EsairError,
    NotRegisteredError,
    NoTurnError,
    OutcomeUnknownError,
    RefusedError,
    ResourceRemovedError,
    StoppingError,
    UnknownNameError,
    describe,
)
from esair.loop import News, now
from esair.messages import Refused, ResourceState
from esair.peers._behavior import NEAREST, made_for
from esair.resources import HOLD
from esair.values import is_positive

_WAITING: Final = 4
"""How many commands of a peer may wait for one actuator."""

_ASKS: Final = 16
"""How many requests of a peer may be worked on."""

_LOOK: Final = 0.2
"""How often it is looked what is there again, in seconds."""

_TOO_MUCH: Final = "too much of this peer waits"

_NOT_DONE = (
    RefusedError,
    UnknownNameError,
    BusyError,
    CircularRequestError,
    StoppingError,
)
"""What says of a request that nothing was done."""


_ABSENT = DeviceLostError, ResourceRemovedError, NotRegisteredError, StoppingError
"""What says of an actuator that nobody has it here."""


@attrs.frozen
class Share:
    """What a peer may use.

    Attributes:
        name: The sensor, actuator or behavior.
        access: Whether it is read, written or asked.
        priority: With which priority an actuator is written.
        rate: How often a reading is sent at most, in Hz.
    """

    name: str
    access: Literal["read", "write", "ask"]
    priority: int = 0
    rate: float = 20.0

    def __attrs_post_init__(self) -> None:
        if self.access not in (known := ("read", "write", "ask")):
            told = f"expected one of {known}, not {self.access!r:.80}"
            raise ConfigError(self.name, "access", told)
        if not is_positive(self.rate) or self.rate > 1000.0:
            told = f"expected more than 0 and at most 1000 Hz, not {self.rate!r:.80}"
            raise ConfigError(self.name, "rate", told)


class Sharing(Behavior):
    """What a peer may do here. It has the name of the peer: so ``why`` tells who writes.

    Nothing is shared that is not named. Its ports are registered like those of any
    behavior: policies, limits, guards and the time-out of commands hold for the peer.
    A command that echoes a beat older than the actuator's ``command_timeout``, or older
    than a second, by the clock of this robot, is refused: so long a gap is a loss of the
    peer. Without the peer nothing is written.

    Args:
        bus: The bus to the peer.
        shares: What it may use.
    """

    asked_alone: Final = "put and get do not cross to another robot"

    def __init__(self, *, bus: PeerBus, shares: Iterable[Share]) -> None:
        self.shares: dict[str, Share] = {each.name: each for each in shares}
        super().__init__(
            name=bus.name,
            reads={f"the_{name}": reads(Any, name=name) for name in self._all("read")},
            writes={
                f"the_{name}": writes(
                    Any, name=name, priority=self.shares[name].priority, blind="release"
                )
                for name in self._all("write")
            },
        )
        self.bus = bus

    def _all(self, *access: str) -> list[str]:
        return [each.name for each in self.shares.values() if each.access in access]

    async def setup(self) -> None:
        """Take what the peer says from now on."""
        self._feeds: dict[str, asyncio.Task[None]] = {}
        self._pauses: dict[str, float] = {}
        self._asks: dict[int, asyncio.Task[None]] = {}
        self._causes: collections.deque[tuple[int, Any]] = collections.deque(
            maxlen=_ASKS
        )
        self._missing: set[int] = set()
        self._orders: asyncio.Queue[tuple[Any, ...]] = asyncio.Queue(64)
        self._commands: dict[str, asyncio.Queue[tuple[Any, ...]]] = {
            name: asyncio.Queue(_WAITING) for name in self._all("write")
        }
        # It comes in by the door, and is kept: a recording repeats without a network.
        loop = asyncio.get_running_loop()
        self._news = News(loop, ("peer", self.name), self._sort)
        self.bus.serve(self._news.tell)

    async def teardown(self) -> None:
        """Take no more."""
        self.bus.serve_no_more(self._news.tell)

    def _sort(self, what: str, since: float, body: bytes) -> None:
        """Take what came in: it is sorted, and nothing of it has any effect yet."""
        parts = () if what == "lost" else self.bus.parts(what, body)
        if parts is None:
            self.bus.answer_unread(what, body)
            return
        queue = self._orders
        if what in {"write", "release"}:
            queue = self._commands.get(parts[1], queue)
        try:
            queue.put_nowait((what, since, *parts))
        except asyncio.QueueFull:
            self.bus.stats.dropped += 1
            if what == "ask":
                self._answer(parts[0], "declined", _TOO_MUCH)
            elif what in {"write", "release"}:
                self.bus.refuse(parts[0], _TOO_MUCH)

    async def run(self) -> None:
        """Do what the peer asks for."""
        async with asyncio.TaskGroup() as tasks:
            for name, queue in self._commands.items():
                tasks.create_task(self._write(getattr(self, f"the_{name}"), queue))
            tasks.create_task(self._look())
            while True:
                what, since, *parts = await self._orders.get()
                if what == "follow":
                    self._follow(tasks, parts[0])
                    await asyncio.sleep(0)  # however many there are: others go on
                elif what == "ask":
                    self._begin(tasks, since, *parts)
                elif what == "because":
                    self._causes.append((parts[0], parts[1]))
                elif what == "cancel":
                    if parts[0] in self._asks:
                        self._asks[parts[0]].cancel()
                elif what == "pending":
                    self._compare(parts[0])
                    await asyncio.sleep(0)
                elif what == "lost":
                    for task in (*self._feeds.values(), *self._asks.values()):
                        task.cancel()
                    self._feeds.clear()
                else:
                    self._answer(parts[0], "lost", self._not_shared(parts[1]))

    def _compare(self, pending: list[Any]) -> None:
        """End what nobody waits for any more, and tell what is not worked on here.

        Its cancellation may be lost in a gap. One request may overtake a list: it has
        to be missing twice.
        """
        for number in pending:
            if type(number) is int and number not in self._asks:
                self._answer(number, "lost", "it is not known there")
        missing = self._asks.keys() - {n for n in pending if type(n) is int}
        for number in missing & self._missing:
            self._asks[number].cancel()
        self._missing = missing

    # Answers.

    def _answer(self, number: int, how: str, value: Any) -> None:
        try:
            self.bus.say("answer", number, how, value)
        except BadValueError as error:
            self.bus.say("answer", number, "failed", describe(error))

    def _not_shared(self, name: Any) -> str:
        return f"{name!r:.80} is not shared with {self.name!r}"

    # Actuators.

    async def _write(self, port: Any, queue: asyncio.Queue[tuple[Any, ...]]) -> None:
        while True:
            what, since, number, name, *rest = await queue.get()
            if what == "release":
                took = await port._let_go()  # noqa: SLF001 - for nobody but a peer
                if not self._is_there(name):
                    self._answer(number, "lost", self._why_gone(name))
                elif took:
                    self._released(number, port._channel.wire.still)  # noqa: SLF001
                else:
                    told = "it did not take its safe command"
                    self._answer(number, "failed", told)
                continue
            # Judged when it leaves: it may wait behind a slow call of another writer.
            expires = since + min(port.command_timeout, SILENCE)
            try:
                written = await port.write(rest[0], expires=expires)
            except _ABSENT as error:
                self._answer(number, "lost", describe(error))
            except (BadValueError, NoTurnError) as error:  # the device was not asked
                self.bus.refuse(number, describe(error))
            except EsairError as error:
                self._answer(number, "failed", describe(error))
            else:
                self._tell(number, written, expires)

    def _released(self, number: int, safe: Any) -> None:
        try:
            self.bus.say("answer", number, "written", None if safe is HOLD else safe)
        except BadValueError:  # it is of a class that does not cross
            self.bus.say("answer", number, "written", None)

    def _tell(self, number: int, written: Any, expires: float) -> None:
        if not isinstance(written, Refused):
            self._answer(number, "written", written.command)
            return
        moment, until, rule = now(), written.until, written.rule
        if moment > expires:
            self.bus.stats.refused += 1
            rule = f"the newest beat that {self.name} had heard was too old: {rule}"
        left = None if until is None else float(until - moment)
        age = float(max(0.0, moment - written.since))
        told = (written.holder, written.priority, rule, age, left)
        self._answer(number, "refused", told)

    # Sensors.

    def _follow(self, tasks: asyncio.TaskGroup, wanted: dict[Any, Any]) -> None:
        """Send the readings that the peer wants, and no others."""
        for name, task in list(self._feeds.items()):
            if name not in wanted:
                task.cancel()
                del self._feeds[name]
        for name, rate in wanted.items():
            share = self.shares.get(name)
            if share is None or share.access != "read" or not is_positive(rate):
                self.bus.say("gone", f"{name!s:.80}", self._not_shared(name))
                continue
            self._pauses[name] = 1.0 / min(rate, share.rate)
            if name not in self._feeds:
                self._feeds[name] = tasks.create_task(self._feed(name))
            elif now() - self.bus.told_at.get(name, -math.inf) > QUIET:
                # What a sensor has pushed last may be lost in a gap.
                with contextlib.suppress(EsairError):
                    self._send(name, getattr(self, f"the_{name}").newest)

    async def _feed(self, name: str) -> None:
        port = getattr(self, f"the_{name}")
        try:
            if not self._is_there(name):
                raise DeviceLostError(name)
            self.bus.say("gone", name, "")  # it is there, if it has said nothing yet
            with contextlib.suppress(EsairError):
                self._send(name, port.newest)
            async for _ in port:
                self._send(name, port.newest)
                waited = 0.0
                while (left := self._pauses[name] - waited) > 0.0:
                    waited += (some := min(left, _LOOK))
                    await asyncio.sleep(some)  # meanwhile it may be wanted more often
        except EsairError as error:
            self.bus.say("gone", name, describe(error))
            self._feeds.pop(name, None)

    def _send(self, name: str, reading: Any) -> None:
        self.bus.tell(name, reading.time, reading.value)

    def _is_there(self, name: str) -> bool:
        return bool(getattr(self, f"the_{name}").state is ResourceState.READY)

    def _why_gone(self, name: str) -> str:
        error = getattr(self, f"the_{name}")._channel.error  # noqa: SLF001
        return describe(error or DeviceLostError(name))

    async def _look(self) -> None:
        """Tell the peer which actuators are gone, and when something is there again."""
        used = self._all("read", "write")
        lost: set[str] = set()
        while True:
            gone = {name for name in used if not self._is_there(name)}
            for name in self._commands:
                if name in gone:
                    self.bus.say("gone", name, self._why_gone(name))
            if lost - gone:
                self.bus.say("ready")
            lost = gone
            await asyncio.sleep(_LOOK)

    # Behaviors.

    def _begin(
        self,
        tasks: asyncio.TaskGroup,
        since: float,
        number: int,
        name: str,
        request: object,
    ) -> None:
        share = self.shares.get(name)
        if share is None or share.access != "ask":
            told = self._not_shared(name)
        elif not isinstance(request, Request):
            told = f"expected a request, not {type(request).__name__}"
        elif now() - since > SILENCE:
            self.bus.stats.refused += 1
            told = "it is from before a gap"
        elif len(self._asks) >= _ASKS:
            told = "too many requests of this peer are under way"
        elif number in self._asks:
            return
        else:
            task = tasks.create_task(self._work(number, name, request))
            self._asks[number] = task
            task.add_done_callback(lambda _: self._asks.pop(number, None))
            return
        self._answer(number, "declined", told)

    async def _work(self, number: int, name: str, request: Request[Any]) -> None:
        told = dict(self._causes).get(number, ())
        causes = told if type(told) is tuple else (told,)
        task, mail = cast("Any", (asyncio.current_task(), self._mail))
        made_for[task] = number, *[n for n in causes if type(n) is int][: NEAREST - 1]
        if causes:
            requests = itertools.chain.from_iterable(mail.mediator.of_asker.values())
            ours = {each.crossed: each for each in requests}
            if found := [ours[n] for n in made_for[task] if n in ours]:
                found[0].serve()  # it is done for one of this robot: a circle is seen

        def progress(value: Any) -> None:
            self.bus.say("progress", number, value)

        try:
            answer = await self.ask(name, request, timeout=None, progress=progress)
        except _NOT_DONE as error:
            told = error.reason if isinstance(error, RefusedError) else describe(error)
            self._answer(number, "declined", told)
        except BehaviorRemovedError as error:
            self._answer(number, "removed", describe(error))
        except BehaviorFailedError as error:
            self._answer(number, "failed", error.detail)
        except OutcomeUnknownError as error:  # a robot behind this one was lost
            self._answer(number, "lost", error.detail)
        except Exception as error:
            self._answer(number, "failed", describe(error))
        else:
            self._answer(number, "answered", answer)
