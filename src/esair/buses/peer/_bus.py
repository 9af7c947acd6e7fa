"""The bus to a peer: another robot on the network, whose parts are devices on this bus.

Both sides send beats. Each message tells the newest beat that its sender has heard of the
other side, and how long ago: so who gets it knows by its own clock how old it may be.
"""

from __future__ import annotations

import asyncio
import collections
import itertools
import logging
import math
import secrets
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple, Protocol

from esair.buses._bus import Bus
from esair.buses._inbox import Inbox, within
from esair.buses.peer._pace import BEAT, Pace
from esair.buses.peer._wire import (
    FOR_OWNER,
    FORMS,
    LISTED,
    Head,
    head_of,
    name_of,
    number_of,
    packed,
    parts_of,
)
from esair.codec import CodecError, Kinds, declared
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceLostError,
    describe,
    printable,
)
from esair.loop import arrive, fail, spawn, turn_of
from esair.messages import Stamped
from esair.values import fits

SILENCE = 1.0
"""A peer is lost whose newest echo is of a beat that was sent so many seconds ago."""

QUIET = 0.08
"""After so many seconds the newest reading of a sensor is said again, if it is asked for."""

FIRST = 0.4
"""How long an opening waits for the first beat, in seconds."""

_FOLLOW_AGAIN = 20  # beats after which the peer is told again what is wanted
_OVER = 8  # runs that are over of which it is known
_KEPT = 128  # beats of which it is known when they were sent
_IN_BEAT = 1 << 14  # messages of one beat: each is known if it comes twice
_WORDS = 400  # letters of what is said for people: in a circle they would be ever more
_PENDING = 64  # requests that wait for their answers
_READINGS = 16  # readings of a sensor that wait to be taken

NEVER = -math.inf

_log = logging.getLogger("esair")

Send = Callable[[str, bytes], None]
Serve = Callable[[str, float, bytes], object]


class _Request(NamedTuple):
    """What waits for its answer, as long as the peer is not silent for too long."""

    outcome: asyncio.Future[tuple[str, Any]]
    patience: float
    progress: Callable[[Any], object]
    is_ask: bool


class PeerNetwork(Protocol):
    """How a robot reaches its peers: a `Network`, or that of a `FakeNetwork`."""

    @property
    def me(self) -> str:
        """The name of this robot."""

    def join(self, bus: Any, /) -> Awaitable[Send]:
        """Hand what comes to ``bus.came`` from now on; return what sends, and never waits."""

    def leave(self, bus: Any, /) -> Awaitable[None]:
        """Hand on no more."""


class PeerBus(Bus):
    """The way to another robot, by its name on the network.

    It is open while the peer beats; when its beats stay away for a second, everything on
    it is lost, and it comes back by itself. In ``bus.stats`` messages are counted;
    ``refused`` are those that came with too old a beat.

    Args:
        name: The name of the bus, and of the peer.
        network: How it is reached, the same object for all peers.
    """

    def __init__(self, *, name: str, network: PeerNetwork) -> None:
        super().__init__(name=name)
        if network.me == name:
            raise ConfigError(name, "network", "a robot is no peer of itself")
        self.network: PeerNetwork = network
        self.round_trip: float = math.inf
        """How long a beat and its echo have taken last, in seconds."""
        self.why: Callable[[], str] = str
        """Tells why nobody is heard, as far as the network knows that itself."""
        self.told_at: dict[str, float] = {}
        """Of each sensor when a reading was said last."""
        self._pace = Pace(_KEPT)
        self._later: dict[str, tuple[float, Any]] = {}
        """Of each sensor what is said when the way is free: when that was measured, and what."""
        self._undeclared: list[Any] = []
        self.kinds: Kinds = Kinds(more=self._declare_late, fits=fits)
        """The classes that may come: what the robot's own parts declare."""
        self._serve: Serve | None = None
        self._send: Send | None = None
        self._run = secrets.randbits(63)
        self._sent: collections.deque[float] = collections.deque(maxlen=_KEPT)
        self._beats = 0
        self._its_run = self._its_beat = 0
        self._over: dict[int, int] = {}  # runs that are over, and since which own beat
        self._doubled = self._heard_there = 0
        self.heard_at: float = NEVER
        """When the newest beat was sent that it has echoed, by the clock of the loop."""
        self._beat_at = NEVER
        self._taken: set[int] = set()  # of what came with its newest beat
        self._gap, self._gap_at = 0.0, 0  # the last one, and the own beat at its end
        self._alive = asyncio.Event()
        self._beating: asyncio.Task[None] | None = None
        self._numbers = itertools.count(secrets.randbits(31) << 20)
        self._pending: dict[int, _Request] = {}
        self._releases: dict[str, int] = {}
        """Of each actuator the release that has no answer yet."""
        self._followed: dict[Inbox[Any], tuple[str, float]] = {}
        self.when_gone: dict[Callable[[str, str], object], None] = {}
        """Called with the name of what its owner has no more, and why."""
        self._heard: dict[str, tuple[float, float, Any, tuple[float, float]]] = {}
        """Of each sensor when it was heard last, when that was measured, what, and its order."""

    def declare(self, kind: Any) -> None:
        """Let the classes come that a component, or a port, declares."""
        self._undeclared.append(kind)

    def _declare_late(self, kinds: Kinds) -> None:
        while self._undeclared:
            kind = self._undeclared.pop()
            for each in (kind, *(declared(kind) if isinstance(kind, type) else ())):
                kinds.add(each)

    def adopt(self, part: Any) -> None:
        """Have a part that was made for another bus of this name, and its classes."""
        if isinstance(part.bus, PeerBus):
            self._undeclared += part.bus._undeclared  # noqa: SLF001 - of this class
        super().adopt(part)

    # Its life: it beats from the first opening to its end, whether the peer is there or not.

    async def _open(self) -> None:
        if self._send is None:
            self._send = await self.network.join(self)
            loop = asyncio.get_running_loop()
            turn_of(loop).suspends.listen(self._slept)
            self._beating = spawn(loop, self._beat(), name=f"{self.name} beats")
        try:
            async with asyncio.timeout(FIRST):
                await self._alive.wait()
        except TimeoutError:
            told = self._why("no beat of it was heard")
            raise DeviceLostError(self.name, told) from None

    async def _close(self) -> None:
        """It goes on to beat, so that the peer is heard when it is back."""

    async def close(self) -> None:
        """Say so, and beat no more."""
        if self.is_open:
            self.say("bye")
        for each in self._pending.values():
            fail(each.outcome, DeviceLostError(self.name, "it is used no more"))
        try:
            await super().close()
        finally:
            if self._send is not None:
                self._send = None
                turn_of(asyncio.get_running_loop()).suspends.forget(self._slept)
                await self.network.leave(self)
            self._alive.clear()
            self._run += 1  # for the peer it is one that has restarted
            if self._beating is not None:
                self._beating.cancel()
                self._beating = None

    async def _beat(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            self._beats += 1
            self._sent.append(loop.time())
            self._pace.beat()
            self.say("beat")
            silent = loop.time() - self.heard_at
            if self._alive.is_set() and silent > SILENCE:
                self._gone(self._why(f"no echo of a beat for {silent:.2g} s"))
            elif self.is_open and self._beats % _FOLLOW_AGAIN == 0:
                self._tell_followed()
                # A message may be lost with a connection, or in a gap.
                self.say("pending", [n for n, e in self._pending.items() if e.is_ask])
            await asyncio.sleep(BEAT)

    def _slept(self, _seconds: float) -> None:
        """The computer slept, whose clock stood still: what echoes older beats is old."""
        self._sent.clear()

    def _why(self, told: str) -> str:
        """Return why the peer is silent, if that is not what is thought."""
        if self._heard_there in {0, self._run}:
            return self.why() or told
        return f"it hears another robot of the name {self.network.me!r}"

    def _gone(self, told: str) -> None:
        was_there = self._alive.is_set()
        self._alive.clear()
        if was_there and self._serve is not None:
            self._serve("lost", NEVER, b"")
        self.lost(DeviceLostError(self.name, told))

    def lost(self, error: BaseException) -> None:
        """Tell everybody on the bus, and whoever waits for an answer."""
        super().lost(error)
        self._heard.clear()
        self._later.clear()
        self._releases.clear()
        for each in self._pending.values():
            fail(each.outcome, DeviceLostError(self.name, describe(error)))

    def silence(self) -> float:
        """Return for how long nothing was heard, in seconds.

        A gap counts for two beats more: then what is from before it has had its turn.
        """
        now = asyncio.get_running_loop().time() - self._beat_at
        return max(now, self._gap if self._beats < self._gap_at + 2 else 0.0)

    def _over_gap(self, seconds: float) -> None:
        """End what does not wait for its answer through such a gap."""
        if seconds > 2.0 * BEAT:
            self._gap, self._gap_at = seconds, self._beats
        for each in self._pending.values():
            if seconds > each.patience:
                arrive(each.outcome, ("silent", seconds))

    # What comes.

    def came(self, what: str, data: bytes) -> bool:
        """Take a message of the peer; in the loop. Tell whether it is a new one."""
        found = head_of(data) if what in FORMS else None
        if found is None:
            self.stats.bad_frames += 1
            return False
        head, body = found
        loop = asyncio.get_running_loop()
        turn_of(loop).suspends.look()  # it may be from before a sleep that ends now
        is_strange = head.run != self._its_run and self._since(head) == NEVER
        if self._is_over(head) or (is_strange and self._alive.is_set()):
            self.stats.late += 1  # who begins anew hears a beat of now, and echoes it
            return False
        self._heard_there = head.echo_run if head.held < SILENCE else 0
        now = loop.time()
        self.stats.received += 1
        if head.run != self._its_run:
            self._end_run(self._its_run)
            self._its_run, self._its_beat = head.run, -1
            if self._alive.is_set():
                self._gone("it has restarted")
        if head.beat < self._its_beat or (it := hash((what, data))) in self._taken:
            self.stats.late += 1  # it was overtaken, or has come, on another way
            self._pace.copied(now)
            return False
        if head.beat > self._its_beat:
            self._taken.clear()
            silent = now - self._beat_at
            if self._alive.is_set():
                self._over_gap(silent)
            self._its_beat, self._beat_at = head.beat, now
            if what != "bye" and (silent > 2.0 * BEAT or not self._alive.is_set()):
                self.say("beat")  # it waits for an echo of what it says now
                if self._alive.is_set():
                    self._say_again()
        if head.echo_run == self._run and head.echo > self._beats:
            # A number came there that was never sent: what this run says stays unheard.
            self.stats.bad_frames += 1
            self._run = secrets.randbits(63)
        if len(self._taken) >= _IN_BEAT:
            self.stats.dropped += 1
            return False
        self._taken.add(it)
        since = self._since(head)
        if since > NEVER:
            self.round_trip = max(0.0, now - since - head.held)
            self.heard_at = max(self.heard_at, since)
            self._pace.echoed(self._beats - head.echo, self.round_trip)
            self._tell_later()
        if what == "bye":
            self._end_run(head.run)
            self._its_run = 0
            self._gone("it has ended")
            return True
        if not self._alive.is_set():
            # Both ways are there only when the peer echoes what was sent just now.
            if now - since > SILENCE:
                return True
            self._alive.set()
            self.arrived()
        if what != "beat":
            self._take(what, since, since + head.held, body)
        return True

    def _end_run(self, run: int) -> None:
        self._over[run] = self._beats
        if len(self._over) > _OVER:
            del self._over[next(iter(self._over))]

    def _is_over(self, head: Head) -> bool:
        """Tell whether a message is of a run that is over.

        One that has heard what was said since is not: a second robot of this name has
        been heard meanwhile. It is heard again when that is not, at the latest after a
        second of silence: it may believe the same of this robot.
        """
        over, now = self._over.get(head.run), asyncio.get_running_loop().time()
        if over is None:
            return False
        is_now = head.echo_run == self._run and over < head.echo <= self._beats
        if not self._alive.is_set() and (is_now or now - self._beat_at > SILENCE):
            del self._over[head.run]
            return False
        if is_now and self._doubled != head.run:
            self._doubled = head.run
            told = (
                "%s: two robots have this name, and one of them is heard: end the other"
            )
            _log.warning(told, self.name)
        return True

    def _since(self, head: Head) -> float:
        """Return when the beat was sent that a message echoes; long ago if not known."""
        back = self._beats - head.echo
        if head.echo_run != self._run or not 0 <= back < len(self._sent):
            return NEVER
        return self._sent[-1 - back]

    def _take(self, what: str, since: float, sent: float, body: bytes) -> None:
        if what in FOR_OWNER:  # also while its own devices are not open again
            if self._serve is None:
                self._not_served(what, body)
            else:
                self._serve(what, since, body)
        elif not self.is_open:
            self.stats.unheard += 1
        elif what == "ready":
            self._say_again()
            for listener in tuple(self._on_arrival):
                listener()
        elif (parts := self.parts(what, body)) is not None:
            self._hand_on(what, (since, sent), parts)
        elif what == "answer" and (of := self._pending.get(number_of(body) or 0)):
            arrive(of.outcome, ("lost", str(self.stats.last_error)))
        elif what == "reading" and (name := name_of(body)):
            self._hand_on("gone", (since, sent), (name, str(self.stats.last_error)))

    def _not_served(self, what: str, body: bytes) -> None:
        """Answer what comes before this robot is ready to serve, or after."""
        self.stats.unheard += 1
        parts, told = self.parts(what, body), f"{self.network.me!r} shares nothing now"
        if parts is not None and what == "follow":
            for name in parts[0]:
                self.say("gone", f"{name!s:.80}", told)
        elif parts is not None and what == "pending":
            for number in (each for each in parts[0] if type(each) is int):
                self.say("answer", number, "lost", told)
        elif parts is not None and what not in {"because", "cancel"}:
            self.say("answer", parts[0], "declined" if what == "ask" else "lost", told)

    def parts(self, what: str, body: bytes) -> tuple[Any, ...] | None:
        """Return the parts of a message; one that is none is counted."""
        try:
            return parts_of(what, body, self.kinds)
        except CodecError as error:
            self.stats.bad_frames += 1
            self.stats.last_error = describe(error)
            return None

    def answer_unread(self, what: str, body: bytes) -> None:
        """Tell that nothing was done of what could not be read, and why."""
        number, told = number_of(body), str(self.stats.last_error)
        if number is not None and what == "ask":
            self.say("answer", number, "declined", told)
        elif number is not None and what == "write":
            self.refuse(number, told)

    def refuse(self, number: int, rule: str) -> None:
        """Answer a write, or a release, that is not tried: for whoever made it alone."""
        self.say("answer", number, "refused", (self.name, 0, rule, 0.0, None))

    def _hand_on(
        self, what: str, order: tuple[float, float], parts: tuple[Any, ...]
    ) -> None:
        if what in {"answer", "progress"}:
            if (request := self._pending.get(parts[0])) is None:
                self.stats.late += 1
            elif what == "answer":
                how, told = parts[1:]
                is_value = how in {"answered", "written"}
                arrive(request.outcome, (how, told if is_value else _in_words(told)))
            else:
                request.progress(parts[1])
        else:
            if what == "gone":
                parts = parts[0], _in_words(parts[1])
                for listener in tuple(self.when_gone):
                    listener(*parts)
            wanted = [
                inbox for inbox, (name, _) in self._followed.items() if name == parts[0]
            ]
            heard = self._heard.get(parts[0])
            if not wanted:
                self.stats.unheard += what != "gone"
            elif what == "gone":
                self._heard.pop(parts[0], None)
                for inbox in wanted:
                    told = DeviceLostError(self.name, parts[1]) if parts[1] else None
                    inbox.offer(told)
            elif heard is not None and order < heard[3]:
                self.stats.late += 1  # one of the same beat has overtaken it
            elif (sent := order[1]) > NEVER:
                # It was measured no earlier than that, however long each way was.
                now = asyncio.get_running_loop().time()
                at = min(now, sent - parts[1])
                if heard is not None:
                    at = max(at, heard[1])  # they come in the order of measurement
                said = now, at, parts[2], order
                if heard is None or not _is_again(heard, said):
                    self._heard[parts[0]] = said
                    for inbox in wanted:
                        inbox.offer(Stamped(parts[2], at))

    # What is said.

    def say(self, what: str, *parts: Any) -> int:
        """Send a message; it is lost if the peer is not there.

        Returns:
            How many bytes were sent.

        Raises:
            BadValueError: It is no plain data: which part of it, and why.
        """
        if self._send is None:
            return 0
        now = asyncio.get_running_loop().time()
        held = max(0.0, now - self._beat_at) if self._its_run else 0.0
        head = Head(self._run, self._beats, self._its_run, max(0, self._its_beat), held)
        try:
            data = packed(head, parts, self.kinds)
        except CodecError as error:
            raise BadValueError(self.name, what, str(error)) from None
        if what == "gone":
            self._later.pop(parts[0], None)
        self.stats.sent += 1
        self._send(what, data)
        return len(data)

    def tell(self, sensor: str, at: float, value: Any) -> None:
        """Say a reading that was measured at a moment of the clock of the loop.

        While what was said before waits on the way only the newest is said, later. One that
        is no plain data is said to be gone, and why.
        """
        if self._is_slow():
            self._later[sensor] = at, value
        else:
            self._later.pop(sensor, None)
            now = self.told_at[sensor] = asyncio.get_running_loop().time()
            try:
                age = max(0.0, float(now - at))
                self._pace.told(self.say("reading", sensor, age, value))
            except BadValueError as error:
                self.say("gone", sensor, describe(error))

    def _is_slow(self) -> bool:
        now = asyncio.get_running_loop().time()
        return self._pace.is_slow(now, self.heard_at)

    def _tell_later(self) -> None:
        if self._later and not self._is_slow():
            later, self._later = self._later, {}
            for sensor, (at, value) in later.items():
                self.tell(sensor, at, value)

    def _say_again(self) -> None:
        """Say what may have been lost in a gap."""
        if self._followed:
            self._tell_followed()
        for name, number in self._releases.items():
            self.say("release", number, name)

    async def request(
        self,
        what: str,
        *parts: Any,
        progress: Callable[[Any], object] = lambda _: None,
        patience: float = math.inf,
        numbered: Callable[[int], object] = lambda _: None,
    ) -> tuple[str, Any]:
        """Send what is answered, and wait for the answer: how it ended, and with what.

        With no answer for as long as the patience, in seconds, it ends as ``"silent"``,
        with how long; no command is sent into a gap that is longer. What is *numbered*
        gets its number before it is sent.

        Raises:
            DeviceLostError: The peer was lost before it has answered.
            BadValueError: It is no plain data; nothing was sent.
            BusyError: Too many wait.
        """
        if not self.is_open:
            raise DeviceLostError(self.name, "it is not there")
        if len(self._pending) >= _PENDING:
            raise BusyError(self.name, "number of requests to a peer", _PENDING)
        if what == "write" and (silent := self.silence()) > patience:
            return "silent", silent
        number = next(self._numbers)
        if what == "release":
            self._releases[parts[0]] = number
        elif what == "write":
            self._releases.pop(parts[0], None)
        outcome = asyncio.get_running_loop().create_future()
        self._pending[number] = _Request(outcome, patience, progress, what == "ask")
        try:
            numbered(number)
            self.say(what, number, *parts)
            limit = None if patience == math.inf else patience
            how, value = await within(outcome, limit)
            if what == "release" and how != "silent":
                self._releases.pop(parts[0], None)
            return how, value
        except TimeoutError:
            return "silent", patience
        except asyncio.CancelledError:
            self.say("cancel", number)
            raise
        finally:
            del self._pending[number]

    def follow(self, sensor: str, rate: float) -> Inbox[Any]:
        """Ask for the readings of a sensor, until the inbox is closed.

        Raises:
            BusyError: Too many are asked for.
        """
        if len({sensor, *self._wanted()}) > LISTED:
            raise BusyError(self.name, "number of sensors of a peer", LISTED)
        inbox: Inbox[Any] = Inbox(_READINGS, lambda it: self._followed.pop(it, None))
        if sensor not in self._wanted():
            self._heard.pop(sensor, None)
        elif (heard := self._heard.get(sensor)) is not None:
            inbox.offer(Stamped(heard[2], heard[1]))
        self._followed[inbox] = sensor, rate
        self._tell_followed()
        return inbox

    def _wanted(self) -> dict[str, float]:
        """Return how often each sensor is wanted by whoever wants it most often."""
        return dict(sorted(self._followed.values()))

    def _tell_followed(self) -> None:
        self.say("follow", self._wanted())

    def serve(self, serve: Serve) -> None:
        """Hand what the peer asks for here to a function."""
        self._serve = serve
        if self._alive.is_set():
            self.say("ready")

    def serve_no_more(self, serve: Serve) -> None:
        """Hand on nothing to a function any more, unless another one serves now."""
        if self._serve == serve:
            self._serve = None


def _in_words(told: Any) -> Any:
    """Return what a peer says for people so that a log can show it, and not too long."""
    if type(told) is tuple:
        return tuple(map(_in_words, told))
    if told is None or type(told) in {int, float}:
        return told
    return printable(str(told)[:_WORDS])


def _is_again(heard: tuple[Any, ...], now: tuple[Any, ...]) -> bool:
    """Tell whether a reading is the one from before, said once more after a while."""
    waited, later = now[0] - heard[0], now[1] - heard[1]
    if waited < QUIET or later > waited / 2:
        return False
    try:
        return bool(now[2] == heard[2])
    except Exception:  # such as of an array
        return False
