"""What must hold whatever is done to a robot; looked at where a device is told."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import itertools
import math
import queue
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any
from unittest import mock

import attrs

from esair.actions import Guards, Reaction, Reads, Writes
from esair.connections import ActuatorChannel, SensorPort
from esair.exceptions import BehaviorFailedError, EsairError, describe
from esair.messages import BehaviorState, ResourceState
from esair.torture._gate import Gate, Told
from esair.torture._life import WELL_AFTER, judge_life
from esair.torture._values import is_good, same

if TYPE_CHECKING:
    from esair.torture._world import World

GROWTH = 10  # By how much something must grow between two looks to be suspected
MOST = 20_000  # How much may be in one box at all
DEPTH = 3  # How deep in the objects of a component a box is looked for


class Boxes:
    """Counts, four times in a story, what lies in the boxes of the user's own code."""

    def __init__(self) -> None:
        # The sizes of each box so far, by component and name
        self.sizes: dict[tuple[str, str], list[int]] = {}

    def look(self, world: World) -> None:
        """Take the sizes once more, and say what only grows."""
        if world.ends is not None:
            return
        seen: set[int] = set()
        names = world.robot.resources.names()
        devices = [world.robot.resources.get(name) for name in names]
        for each in (*world.actions(), *filter(_is_own, devices)):
            for name, size in _boxes(vars(each).items(), seen, DEPTH):
                self.sizes.setdefault((each.name, name), []).append(size)
        tasks = [
            task
            for task in asyncio.all_tasks(world.loop)
            if not task.get_name().startswith("torture")
        ]
        whole = (world.robot.name, "the number of its tasks")
        self.sizes.setdefault(whole, []).append(len(tasks))
        for (component, name), sizes in self.sizes.items():
            if is_growing(sizes) or sizes[-1] > MOST:
                text = f"{name} only grows: {', '.join(map(str, sizes))}"
                world.judge.say("queue", component, text)


def is_growing(sizes: list[int]) -> bool:
    """Tell whether a box has only grown, about as much in each quarter of a story."""
    last = sizes[-4:]
    steps = [after - before for before, after in itertools.pairwise(last)]
    return len(last) == 4 and min(steps) >= max(GROWTH, max(steps) / 3)


def _is_own(component: object) -> bool:
    """Tell whether a class is the user's; a fake of esair keeps what it was told."""
    return not type(component).__module__.startswith("esair.")


def _boxes(
    items: Any, seen: set[int], depth: int, path: str = ""
) -> Iterator[tuple[str, int]]:
    for name, value in items:
        if id(value) in seen or value is None or isinstance(value, str | int | float):
            continue
        seen.add(id(value))
        where = f"{path}.{name}" if path else str(name)
        size = _size(value)
        if size is not None:
            yield where, size
        elif depth and not type(value).__module__.startswith(("esair.", "asyncio")):
            inner = getattr(value, "__dict__", None)
            if isinstance(inner, dict) and not isinstance(value, type):
                yield from _boxes(list(inner.items()), seen, depth - 1, where)


def _size(value: Any) -> int | None:
    if isinstance(value, collections.deque):
        return len(value) if value.maxlen is None else 0
    if isinstance(value, asyncio.Queue | queue.Queue):
        return value.qsize() if value.maxsize <= 0 else 0
    if isinstance(value, queue.SimpleQueue):
        return value.qsize()
    if isinstance(value, list | dict | set | bytearray):
        return len(value)
    return None


SLACK = 0.02  # By how much what is bounded by time may be late, in seconds

AGAIN_WITHIN = 0.6
"""How soon safe is sent again after a motion that came too late, in seconds."""

_SEES_NOTHING = {BehaviorState.STOPPING, BehaviorState.REMOVED, BehaviorState.RESTING}
"""In these states nobody counts on what it sees: it leaves, or its mode is another one."""

STOP_WITHIN = 2.0
"""How long a stop may take beside the grace period, in seconds: then `esair.run` ends."""


@attrs.frozen
class Violation:
    """Something that must never be, and was.

    Attributes:
        rule: What must hold, by a short name.
        component: Where it did not.
        text: What was seen, in one sentence.
        at: When, in seconds since the start of the robot.
    """

    rule: str
    component: str
    text: str
    at: float

    @property
    def key(self) -> tuple[str, str]:
        """What makes two of them the same finding."""
        return self.rule, self.component

    def __str__(self) -> str:
        return f"{self.at:7.3f} s  {self.component}: {self.text}"


class Judge:
    """Watches what every device is told."""

    def __init__(self, world: World) -> None:
        self.found: list[Violation] = []
        # For each kind of fault, how long after the last of that kind an actuator that
        # moved had its safe command, at most, in seconds
        self.slowest: dict[str, float] = {}
        self._world = world
        self._causes: dict[str, tuple[float, float, str]] = {}
        self._moving: dict[str, Told] = {}
        # Who held an actuator until when, as somebody was about to write there
        self._held: dict[str, tuple[Any, float]] = {}

    def say(self, rule: str, component: str, text: str) -> None:
        """Take note of a violation; the first of each rule and component counts."""
        new = Violation(rule, component, text, self._world.now)
        if all(each.key != new.key for each in self.found):
            self.found.append(new)

    @contextlib.contextmanager
    def looking(self) -> Iterator[None]:
        """Look at what is read, and at who holds an actuator before each write."""
        begin = ActuatorChannel.begin

        def giving(ask: Callable[..., Any]) -> Callable[..., Any]:
            async def given(port: Any, **options: Any) -> Any:
                value = await ask(port, **options)
                self._gives(port, options.get("max_age"))
                return value

            return given

        def begins(channel: ActuatorChannel, *args: Any, **options: Any) -> Any:
            self._held[channel.name] = channel.hold.holder, channel.hold.until
            return begin(channel, *args, **options)

        ways = giving(SensorPort.read), giving(SensorPort.reading)
        with (
            mock.patch.multiple(SensorPort, read=ways[0], reading=ways[1]),
            mock.patch.object(ActuatorChannel, "begin", begins),
        ):
            yield

    def _gives(self, port: SensorPort[Any], max_age: float | None) -> None:
        """Look how old the value is at least that a behavior was given."""
        limit = port.max_age if max_age is None else max_age
        age = self._silent_for(port.resource)
        if age > limit + SLACK:
            told = f"it was given a value of {port.resource}, which was silent for "
            told += f"{age:.3f} s, its limit is {limit:g} s"
            self.say("stale", port.registration.behavior, told)

    def _silent_for(self, sensor: str) -> float:
        """Return how long ago the robot was told a good value; 0 if nobody knows."""
        world = self._world
        times = (e.heard for e in world.gates if e.name == sensor and e.was_here)
        heard = max(times, default=world.now)
        return world.now - heard - world.jumped(heard)

    # Where an actuator is told something.

    def begins(self, gate: Gate, told: Told) -> None:
        if not told.safe:
            self._moves(gate, told)
        self._alive(gate, told)

    def lands(self, gate: Gate, told: Told) -> None:
        if not told.safe:
            self._moving[gate.name] = told
            self._undoes(gate, told)
            return
        gate.safe_landed = max(gate.safe_landed, told.number)
        if self._moving.pop(gate.name, None) is not None:
            now = self._world.now
            cause = self._causes.pop(gate.name, None)
            if cause is not None and now <= cause[1] + 2.0:
                took = now - cause[0]
                self.slowest[cause[2]] = max(self.slowest.get(cause[2], 0.0), took)

    def cause(self, kind: str, until: float) -> None:
        """Something happens that may make what moves safe."""
        for name in self._moving:
            self._causes[name] = self._world.now, until, kind

    def _moves(self, gate: Gate, told: Told) -> None:
        world, name, command = self._world, gate.name, told.command
        now, robot = world.now, world.robot
        what = f"it was told {command!r:.60}"
        if gate.left is not None and now > gate.left:
            self.say(
                "removed", name, f"{what} {now - gate.left:.3f} s after its removal"
            )
            return
        if world.halted is not None:
            self.say("halted", name, f"{what} while the robot was halted")
        if not is_good(command):
            self.say("value", name, f"{what}: not all of it is finite")
        channel = robot.actuators.channels.get(name)
        if channel is None or channel.actuator is not gate.resource:
            self.say("unregistered", name, f"{what} by somebody who calls its driver")
            return
        if channel.gate.latched:
            self.say("stopped", name, f"{what} after the stop of the robot had begun")
        if not same(channel.told().command, command):
            self.say("unregistered", name, f"{what} by somebody who calls its driver")
        holder = channel.hold.holder
        if holder is None and gate.in_thread:
            return  # given back while the command was on its way into the thread
        if holder is None or holder.reason is not None:
            self.say("unregistered", name, f"{what}, and nobody holds it by right")
            return
        told.mover, told.priority = holder.behavior, holder.priority
        told.watched = world.actions()
        before, until = self._held.get(name, (None, 0.0))
        if (
            before not in {None, holder}
            and before.behavior != holder.behavior
            and before.priority >= holder.priority
            and now < until - SLACK
        ):
            text = f"{what} by {holder.behavior} while {before.behavior} held it"
            self.say("priority", name, text)
        self._sees(gate, what, told)

    # Who moves blind.

    def _sees(self, gate: Gate, what: str, told: Told, *, stood: bool = False) -> None:
        """Look whether those who have to see for this actuator do, or did as it stood."""
        mover, priority = told.mover, told.priority
        for action in self._world.actions():
            if action not in told.watched:
                continue  # it has come since
            for need in action.needs.values():
                if need.resource != gate.name:
                    continue
                if isinstance(need, Guards):
                    if _guards_strictly(action):
                        self._check_sight(gate, action, what, stood)
                elif isinstance(need, Writes) and isinstance(action, Reaction):
                    if need.blind != "release":
                        if priority <= min(need.priority, 999):
                            self._check_sight(gate, action, what, stood)
                    elif (
                        gate.name not in self._world.protected
                        and action.name != mover
                        and priority < need.priority
                    ):
                        by = "" if stood else f" by {mover}"
                        self._check_sight(gate, action, what + by, stood)

    def _check_sight(self, gate: Gate, action: Any, what: str, stood: bool) -> None:
        world = self._world
        muted = world.muted.get(action.name, -1.0)
        if world.now - world.jumped(muted) < muted + 2 * SLACK * stood:
            return
        state = world.robot.behaviors.query(action.name).state
        if state not in _SEES_NOTHING and (why := self._why_blind(action, stood)):
            self.say("blind", gate.name, f"{what} while {action.name} {why}")

    def _why_blind(self, action: Any, stood: bool) -> str:
        """Say why nothing passes somebody, or did before now; empty if it can decide."""
        world = self._world
        lever = world.levers.get(id(action))
        if lever is not None and not stood and (lever.undecided or lever.latched):
            return "was latched" if lever.latched else "had not decided anew"
        for need in action.needs.values():
            if not isinstance(need, Reads) or need.optional:
                continue
            channel = world.robot.sensors.channels.get(need.resource)
            sensor = None if channel is None else world.gate_of(channel.sensor)
            if need.provider != need.resource and channel is not None:
                continue  # what an actuator has applied last is true until the next
            if channel is None or sensor is None:
                return "" if stood else f"had no {need.resource}: it was removed"
            if channel.sensor.is_computed:
                continue  # its age is that of what it is computed of
            limit = channel.max_age if need.max_age is None else need.max_age
            slack = SLACK * (1 + stood) + (1.0 / action.rate if action.rate else 0.0)
            age = world.now - sensor.heard - world.jumped(sensor.heard)
            if stood and sensor.applied >= sensor.heard:
                continue  # its limit may be another since
            if stood:  # it may have been replaced since
                age = self._silent_for(need.resource)
            if math.isfinite(limit) and age > limit + slack:
                return (
                    f"could not see: {need.resource} was silent for {age:.3f} s, its "
                    f"limit is {limit:g} s"
                )
        return ""

    # The dead man.

    def _alive(self, gate: Gate, told: Told) -> None:
        """Look, at each command, whether a motion before it stood for too long."""
        last = gate.told[-2] if len(gate.told) > 1 else None
        if last is None or last.safe or last.landed is None:
            return
        timeout = gate.resource.command_timeout  # type: ignore[attr-defined]
        stood = told.begun - last.landed - self._world.jumped(last.landed)
        world = self._world
        channel = world.robot.actuators.channels.get(gate.name)
        is_ready = channel is not None and channel.state is ResourceState.READY
        if not is_ready or gate.faulty >= last.begun:
            return
        what = f"{last.command!r:.60} stood"
        if stood > timeout + 2 * SLACK:
            self.say("dead man", gate.name, f"{what} for {stood:.3f} s, its "
                     f"command_timeout is {timeout:g} s")  # fmt: skip
        if world.halted is not None:
            since = max(world.halted, last.landed)
            if told.begun - since - world.jumped(since) > 2 * SLACK:
                self.say("halted", gate.name, f"{what} while the robot was halted")
        if last.mover and stood > 2 * SLACK:
            self._sees(gate, what, last, stood=True)

    def _undoes(self, gate: Gate, told: Told) -> None:
        """See to it that safe is sent again after a motion that has come too late."""
        world = self._world
        channel = world.robot.actuators.channels.get(gate.name)
        if (
            channel is not None
            and channel.actuator is gate.resource
            and channel.state is ResourceState.READY
            and gate.safe_landed > told.number
        ):
            calls, opening = channel.calls, channel.calls.opening
            landed = told.landed or 0.0
            known = landed + gate.late("after")  # when its call ends, at the latest

            def look() -> None:
                left = AGAIN_WITHIN + known + world.jumped(landed) - world.now
                if left > 1e-9:  # time has passed at once: nobody could send it
                    world.loop.call_later(left, look)
                    return
                if (
                    world.ends is None
                    and channel.calls is calls  # else another device has its place
                    and calls.opening == opening
                    and gate.safe_begun < landed
                ):
                    text = f"{told.command!r:.60} landed after the safe command that "
                    text += "it was begun before, and safe was not sent again"
                    self.say("undone", gate.name, text)

            world.loop.call_soon_threadsafe(look)

    # When all is well.

    def calm(self) -> None:
        """Look, before the end, whether the robot is itself again."""
        world, robot = self._world, self._world.robot
        story = world.story
        if story.steps and world.now - world.story.over_at < WELL_AFTER:
            return
        for name in robot.resources.names():
            gate = world.gate_of(robot.resources.get(name))
            if gate is not None and gate.speechless:
                continue
            status = robot.resources.query(name)
            if status.state is not ResourceState.READY and not (
                story.steps and status.state is ResourceState.FAILED
            ):
                why = "" if status.error is None else f": {describe(status.error)}"
                text = f"it is {status.state.value}, though nothing is wrong{why}"
                self.say("ready", name, text[:300])
        if not story.steps and world.target.alone is not None:
            for name in robot.behaviors.names():
                member = robot.behaviors.query(name)
                if member.state is BehaviorState.FAILED:
                    why = "" if member.error is None else f": {describe(member.error)}"
                    text = f"it has failed for good, though nothing is wrong{why}"
                    self.say("well", name, text[:300])
        judge_life(world)

    # The end.

    def ended(self, took: float) -> None:
        """The robot has stopped: look at its time and at each actuator."""
        world = self._world
        grace = world.grace + STOP_WITHIN
        if took > grace + SLACK:
            self.say(
                "stop",
                world.robot.name,
                f"its stop has taken {took:.2f} s; esair.run ends the process after "
                f"{grace:g} s, whatever is not safe by then",
            )
        for gate in world.gates:
            moves = _last(gate)
            if moves is None or gate.left is not None:
                continue
            if gate.faulty < (world.ends or 0.0) - SLACK:
                self.say("end", gate.name, f"{moves.command!r:.60} was the last thing "
                         "that it was told when the robot had stopped")  # fmt: skip

    def drained(self) -> None:
        """Nothing happens any more: what was said of each actuator must be true."""
        world = self._world
        answered = {each.resource for each in world.robot.stopped if each.answered}
        for gate in world.gates:
            moves = _last(gate)
            if moves is not None and gate.left is None and gate.name in answered:
                self.say("end", gate.name, f"{moves.command!r:.60} is the last thing that "
                         "it was told, but the stop says that it is safe")  # fmt: skip

    def outcome(self, title: str, component: str, task: asyncio.Task[Any]) -> None:
        """Look at the outcome of something that was asked for."""
        if not task.done():
            self.say("outcome", component, f"{title} has no outcome")
        elif not task.cancelled():
            error = task.exception()
            if error is not None and not _is_answer(error):
                text = f"{title} ended with {type(error).__name__}: {error}"
                self.say("outcome", component, text[:300])
            elif _is_lost(error):
                self.say("answer", component, f"{title}: {error}"[:300])


def _is_answer(error: BaseException) -> bool:
    if isinstance(error, BaseExceptionGroup):
        return all(map(_is_answer, error.exceptions))
    return isinstance(error, EsairError | TimeoutError)


def _is_lost(error: BaseException | None) -> bool:
    """Tell whether somebody took a request, and went on without an answer."""
    text = str(error) if isinstance(error, BehaviorFailedError) else ""
    return "without an answer" in text and "its run ended" not in text


def _last(gate: Gate) -> Told | None:
    """Return the motion that an actuator had last; None if it is safe."""
    landed = [each for each in gate.told if each.landed is not None]
    last = max(landed, key=lambda each: each.landed or 0.0, default=None)
    if last is not None:  # of several in one instant the last that was begun
        last = [each for each in landed if each.landed == last.landed][-1]
    return None if last is None or last.safe else last


def _guards_strictly(action: Any) -> bool:
    """Tell whether nothing passes a guard while it is blind."""
    return getattr(action.blind, "__func__", None) is Reaction.blind


def protected_in(actions: Sequence[Any]) -> frozenset[str]:
    """Return the actuators that somebody guards, or keeps safe while blind."""
    return frozenset(
        need.resource
        for action in actions
        for need in action.needs.values()
        if isinstance(need, Guards)
        or (
            isinstance(need, Writes)
            and isinstance(action, Reaction)
            and need.blind != "release"
        )
    )
