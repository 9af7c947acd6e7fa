"""The catalogue: everything that can be done to a robot, and how it is undone.

A story is a flat list of steps, so that a shorter one is easily tried.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import random
import resource as limits
import signal
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import attrs

import esair
from esair.actions import Behavior, Guards, Reaction, Writes
from esair.messages import BehaviorState, is_placed
from esair.resources import Resource, Sensor, settings_of
from esair.torture._gate import ERRORS, SOON
from esair.torture._values import WRONG, CannotMakeError, make
from esair.values import printable

if TYPE_CHECKING:
    from esair.torture._gate import Gate
    from esair.torture._world import World


@attrs.frozen
class Step:
    """One thing that is done to a robot.

    Attributes:
        at: When, in seconds of the virtual clock since the robot began to start.
        kind: What is done; one of `esair.torture.KINDS`.
        target: The component that it is done to; empty if it is the robot's.
        lasts: For how long, in seconds; then it is undone. 0 for what has no end.
        how: Which variant of it.
        much: How much of it, in the unit of the kind.
    """

    at: float
    kind: str
    target: str = ""
    lasts: float = attrs.field(default=0.0, kw_only=True)
    how: str = attrs.field(default="", kw_only=True)
    much: float = attrs.field(default=0.0, kw_only=True)

    def __str__(self) -> str:
        words = [self.kind, self.target, self.how]
        if self.much:
            words.append(f"{self.much:g}")
        if self.lasts:
            words.append(f"for {self.lasts:g} s")
        return f"{self.at:7.3f} s  {' '.join(filter(None, words))}"

    def source(self) -> str:
        """Return it in Python's words."""
        words = [f"{self.at:g}", repr_of(self.kind)]
        if self.target:
            words.append(repr_of(self.target))
        for name, default in (("lasts", 0.0), ("how", ""), ("much", 0.0)):
            value = getattr(self, name)
            if value != default:
                told = repr_of(value) if isinstance(value, str) else f"{value:g}"
                words.append(f"{name}={told}")
        return f"Step({', '.join(words)})"


@attrs.frozen
class Story:
    """What happens to one robot from its start to its end.

    Attributes:
        seed: Decides the order of tasks, and what stand-ins of sensors say.
        steps: What is done, in order.
        lasts: When the robot is stopped, if no step does it before, in seconds.
    """

    seed: int
    steps: tuple[Step, ...] = ()
    lasts: float = 3.0

    @property
    def over_at(self) -> float:
        """When the last fault is undone, in seconds; its end is none."""
        faults = (each for each in self.steps if each.kind != "end")
        return max((each.at + each.lasts for each in faults), default=0.0)


def repr_of(text: str) -> str:
    """Return a text as a formatter writes it: in double quotes."""
    escaped = text.replace("\\", r"\\").replace('"', r"\"")
    return f'"{printable(escaped)}"'


DIES_WITHIN = 5.0  # How long a process that is killed may take to end, in real seconds
FLOOD = 100  # How many requests or commands are a flood


class NotNowError(Exception):
    """What is to be done has no place in this moment: its target is not there, say."""


Do = Callable[["World", "Step"], Callable[[], object] | None]


@attrs.frozen
class Kind:
    """One kind of thing that is done to a robot.

    Attributes:
        name: Its name.
        group: Whose fault it is: ``device``, ``behavior``, ``user`` or ``computer``.
        on: Which of the cast it can be done to.
        do: Does it; returns what undoes it, or None.
        lasts: For how long it may last, in seconds; (0,) if it has no end.
        hows: Its variants.
        much: How much of it, in a unit of its own.
        weight: How often it is chosen.
    """

    name: str
    group: str
    on: str
    do: Do
    lasts: tuple[float, ...] = (0.0,)
    hows: tuple[str, ...] = ("",)
    much: tuple[float, ...] = (0.0,)
    weight: float = 1.0


KINDS: dict[str, Kind] = {}
"""Every kind, by its name."""

SHORT = (0.02, 0.1, 0.3, 1.0)
LONG = (0.1, 0.3, 1.0, 4.0)


def _kind(group: str, on: str, **options: Any) -> Callable[[Do], Do]:
    def enter(do: Do) -> Do:
        name = do.__name__.strip("_").replace("_", " ")
        KINDS[name] = Kind(name, group, on, do, **options)
        return do

    return enter


Cast = Mapping[str, tuple[str, ...]]
"""Who is in a robot: what steps can be done to, the names in each group."""


def cast_of(robot: esair.Robot) -> Cast:
    """Look who is in a robot."""
    plan = robot.plan
    devices, actions = list(plan.resources), list(plan.behaviors)
    sensors = [each for each in devices if isinstance(each, Sensor)]
    behaviors = [each for each in actions if isinstance(each, Behavior)]
    groups: dict[str, list[Any]] = {
        "devices": devices,
        "sensors": sensors,
        "pushing": [each for each in sensors if each.pushes],
        "restartable": [each for each in devices if each.can_tell_set_up],
        "settings": [each for each in devices if _changeable(each)],
        "actions": actions,
        "reactions": [each for each in actions if isinstance(each, Reaction)],
        "protections": [each for each in actions if _protects(each)],
        "behaviors": behaviors,
        "movers": [each for each in behaviors if _writes(each)],
        "takers": [each for each in behaviors if each.takes],
        "placed": [each for each in actions if is_placed(each)],
        "components": [*devices, *actions],
    }
    names = {
        group: tuple(sorted(each.name for each in members))
        for group, members in groups.items()
    }
    return names | {"robot": ("",), "modes": tuple(plan.modes.table)}


def _changeable(resource: Resource) -> list[tuple[str, Any]]:
    settings = settings_of(type(resource)).items()
    return [each for each in settings if (each[1].min, each[1].max) != (None, None)]


def _protects(action: Any) -> bool:
    return isinstance(action, Reaction) and any(
        isinstance(need, Guards | Writes) for need in action.needs.values()
    )


def _writes(behavior: Behavior) -> bool:
    needs = behavior.needs.values() if inspect.iscoroutinefunction(behavior.run) else ()
    return any(isinstance(need, Writes) for need in needs)


# Devices.


def _fault(world: World, step: Step) -> Gate:
    """Have a device at fault; those behind it in the thread of its bus wait for it."""
    gate, until = world.gate(step.target), world.now + step.lasts
    gate.faults[step.kind] = until, step
    if step.kind in {"silent", "late"}:
        gate.deaf = step.how.endswith("deaf")
    bus, more = gate.resource.bus, 2 * step.much if step.kind == "late" else 0.0
    for each in world.gates:
        shares = gate.in_thread and each.in_thread and bus is not None
        if each is gate or (shares and each.resource.bus is bus):
            each.faulty = max(each.faulty, until + more)
    return gate


def _faulty(name: str, on: str, **options: Any) -> None:
    def do(world: World, step: Step) -> None:
        _fault(world, step)

    KINDS[name] = Kind(name, "device", on, do, **options)


@_kind("device", "devices", lasts=LONG, hows=("", "unheard"), weight=2.0)
def unplugged(world: World, step: Step) -> Callable[[], object] | None:
    """It is gone; ``unheard``: nobody reports it, its calls fail."""
    gate = _fault(world, step)
    if step.how == "unheard":
        return None
    gate.resource.report_lost(ConnectionResetError(104, "unplugged"))
    return gate.resource.report_arrived


# It answers nothing; deaf: its driver swallows every cancellation.
_faulty("silent", "devices", lasts=LONG, hows=("", "deaf"), weight=2.0)
# Each call takes so long, before the device has it, or after.
_LATE = ("before", "after", "before deaf", "after deaf")
_faulty(
    "late", "devices", lasts=LONG, hows=_LATE, much=(0.01, 0.05, 0.3, 1.5), weight=2.0
)
# Each call of its driver raises.
_faulty("failing", "devices", lasts=SHORT, hows=tuple(ERRORS))
# What it says is no good.
_faulty("wrong", "sensors", lasts=LONG, hows=WRONG)
# It says the same again and again.
_faulty("stuck", "sensors", lasts=LONG)


@_kind("device", "restartable", weight=0.5)
def power_cycled(world: World, step: Step) -> None:
    """Its power was away for a moment: its set-up is gone."""
    gate = world.gate(step.target)
    gate.unpowered = True
    cycle = getattr(gate.resource, "power_cycle", None)
    if cycle is not None:
        cycle()


# It pushes each value so often.
_faulty("flooding", "pushing", lasts=SHORT, much=(20.0, 200.0), weight=0.5)


# Behaviors and reactions.


@_kind("behavior", "actions", hows=tuple(ERRORS), weight=2.0)
def crash(world: World, step: Step) -> None:
    """Its code raises, unless that waits for a restart."""
    lever = world.lever(step.target)
    if world.robot.behaviors.query(step.target).state is BehaviorState.RESTARTING:
        raise NotNowError
    lever.crash(step.how)


@_kind("behavior", "behaviors", lasts=LONG, hows=("", "deaf"), weight=2.0)
def hang(world: World, step: Step) -> None:
    """Its code does not go on; ``deaf``: it swallows every cancellation."""
    world.lever(step.target).hang(step.lasts, deaf=step.how == "deaf")


@_kind("behavior", "reactions", lasts=SHORT, hows=WRONG)
def mad(world: World, step: Step) -> None:
    """Its commands are no good."""
    lever = world.lever(step.target)
    lever.mad = world.now + step.lasts
    lever.how = step.how


@_kind("behavior", "reactions", lasts=SHORT, much=(0.01, 0.2), weight=0.5)
def slow(world: World, step: Step) -> None:
    """Each of its steps holds the loop for so long."""
    world.lever(step.target).slow.append((world.now + step.lasts, step.much))


@_kind("behavior", "movers", weight=0.5)
def flood(world: World, step: Step) -> None:
    """It writes its actuators as often as it can."""
    behavior: Any = world.lever(step.target).action
    channels = world.robot.actuators.channels
    for attribute, need in behavior.needs.items():
        channel = channels.get(need.resource)
        if not isinstance(need, Writes) or channel is None:
            continue
        told = [each for each in world.gate(need.resource).told if not each.safe]
        port = vars(behavior).get(attribute)
        if not told or port is None or not hasattr(port, "release"):
            continue

        async def write_all(port: Any = port, command: Any = told[-1].command) -> None:
            for _ in range(FLOOD):
                await port.write(command)

        world.order(f"a flood of {step.target}", step.target, write_all())


def _process(world: World, step: Step) -> Any:
    """Return the process that an action has, idle: nobody else may touch it."""
    name = _action(world, step)
    seat = world.robot.behaviors._deployment.members[name].mail.seat  # noqa: SLF001
    process = None if seat is None else seat.process
    if process is None or process.pid is None or process.error is not None:
        raise NotNowError
    return process


@_kind("behavior", "placed", hows=("SIGKILL", "SIGSEGV", "SIGABRT"))
def killed(world: World, step: Step) -> None:
    """The process that it has dies, in this moment of the virtual clock."""
    process = _process(world, step)
    world.deeds.dying.add(step.target)
    process.kill(signal.Signals[step.how], DIES_WITHIN)


@_kind("behavior", "placed", lasts=(0.05, 0.5, 2.0, 8.0))
def stopped(world: World, step: Step) -> Callable[[], object]:
    """The process that it has gets no time; long enough, that is a hang."""
    process = _process(world, step)
    world.deeds.dying.add(step.target)
    process.stop()

    def go_on() -> None:
        if process.error is None:
            world.deeds.dying.discard(step.target)
            process.go_on()

    return go_on


FULL = {"memory": limits.RLIMIT_AS, "files": limits.RLIMIT_NOFILE}


@_kind("behavior", "placed", lasts=LONG, hows=tuple(FULL), weight=0.5)
def filled(world: World, step: Step) -> Callable[[], object]:
    """The process that it has gets no more memory, or opens no more files."""
    process, what = _process(world, step), FULL[step.how]
    try:
        before = limits.prlimit(process.pid, what)
        limits.prlimit(process.pid, what, (0, before[1]))
    except ProcessLookupError:  # it is dead, and nobody has heard of that
        raise NotNowError from None
    world.deeds.dying.add(step.target)

    def empty() -> None:
        with contextlib.suppress(ProcessLookupError):  # it has died by something else
            limits.prlimit(process.pid, what, before)
        if process.error is None:
            world.deeds.dying.discard(step.target)

    return empty


# The user.


def _supervisor(world: World, name: str) -> Any:
    _up(world)
    robot = world.robot
    for supervisor in (robot.behaviors, robot.resources):
        if name in supervisor.names():
            return supervisor
    raise NotNowError


def _up(world: World) -> None:
    if not world.is_up or world.ends is not None:
        raise NotNowError


def _action(world: World, step: Step) -> str:
    _up(world)
    if step.target not in world.robot.behaviors.names():
        raise NotNowError
    return step.target


async def _then_look(world: World, work: Any) -> None:
    """Take note which devices do not belong to the robot any more, afterwards."""
    try:
        await work
    finally:
        resources = world.robot.resources
        here = {id(resources.get(name)) for name in resources.names()}
        for gate in world.gates:
            if gate.left is None and gate.was_here and id(gate.resource) not in here:
                gate.left = world.now


@_kind("user", "components", lasts=SHORT, weight=2.0)
def remove(world: World, step: Step) -> Callable[[], object]:
    """It is taken away, and a new one is added later."""
    name = step.target
    supervisor = _supervisor(world, name)
    work = _then_look(world, supervisor.remove(name))
    removal = world.order(f"remove {name}", name, work)

    async def add() -> None:
        await asyncio.wait({removal})  # it may take longer than this step lasts
        if name in supervisor.names():
            return
        spare = world.spare(name)
        while True:
            try:
                await supervisor.add(spare)
                break
            except esair.UnknownNameError:  # what it uses is away, too
                await asyncio.sleep(SOON)

    return lambda: world.order(f"add {name}", name, add())


@_kind("user", "components", weight=2.0)
def replace(world: World, step: Step) -> None:
    """Another one takes its place."""
    name = step.target
    supervisor, spare = _supervisor(world, name), world.spare(name)
    work = _then_look(world, supervisor.replace(name, spare))
    world.order(f"replace {name}", name, work)


@_kind("user", "components")
def restart(world: World, step: Step) -> None:
    """It is restarted."""
    name = step.target
    world.order(f"restart {name}", name, _supervisor(world, name).restart(name))


@_kind("user", "modes", weight=2.0)
def switch(world: World, step: Step) -> None:
    """It goes to this mode."""
    _up(world)
    mode = step.target
    world.order(f"switch {mode}", mode, world.robot.behaviors.switch(mode))


@_kind("user", "robot", lasts=SHORT, weight=2.0)
def halt(world: World, _step: Step) -> Callable[[], object]:
    """The robot is halted, and resumed later."""
    if world.halted is not None:
        raise NotNowError
    halting = world.robot.halt("torture")
    world.halted = world.now
    if world.is_up:
        world.order("halt", world.robot.name, asyncio.wait_for(halting, None))

    def resume() -> None:
        world.halted = None
        world.robot.resume()

    return resume


@_kind("user", "takers", hows=("", "cancelled"), much=(0.05, 0.5, 5.0), weight=3.0)
def ask(world: World, step: Step) -> None:
    """It is asked for something; ``cancelled``: whoever asks does not wait."""
    name = _action(world, step)
    dice = random.Random(f"{world.story.seed}/{step.at}")
    types = world.robot.behaviors.takes(name)
    if not types:
        raise NotNowError
    try:
        request = make(dice.choice(types), dice)
    except CannotMakeError:
        raise NotNowError from None
    work = world.robot.behaviors.ask(
        request, sender="torture", receiver=name, timeout=step.much
    )
    task = world.order(f"ask {name}", name, work)
    if step.how == "cancelled":
        world.loop.call_later(step.much / 2, task.cancel)


@_kind("user", "takers", weight=0.5)
def crowd(world: World, step: Step) -> None:
    """It is asked by very many at once."""
    for number in range(FLOOD):
        each = attrs.evolve(step, how="cancelled" * (number % 5 == 0), much=0.5)
        ask(world, each)


@_kind("user", "settings")
def configure(world: World, step: Step) -> None:
    """One of its settings is changed."""
    _up(world)
    resource = world.gate(step.target).resource
    dice = random.Random(f"{world.story.seed}/{step.at}")
    name, setting = dice.choice(_changeable(resource))
    now = getattr(resource, name)
    least = now / 2 if setting.min is None else max(setting.min, now / 2)
    most = now * 2 + 1 if setting.max is None else min(setting.max, now * 2 + 1)
    value = make(setting.type, dice, (least, most))
    command = f"set {step.target}.{name} {value}"
    world.order(command, step.target, world.robot.behaviors.command(command))


@_kind("user", "protections", much=(0.2, 1.0), weight=0.5)
def mute(world: World, step: Step) -> None:
    """The user lets it pass everything for a while."""
    name = _action(world, step)
    try:
        world.robot.behaviors.mute(name, step.much, "torture")
    except esair.EsairError:
        raise NotNowError from None
    world.muted[name] = world.now + step.much + 0.001


# The computer, and the end.


@_kind("computer", "robot", much=(0.05, 0.5, 2.0), weight=0.5)
def held_up(world: World, step: Step) -> None:
    """The computer did something else for a while."""
    world.jump(step.much)


@_kind("computer", "robot", much=(1.0, 3600.0), weight=0.3)
def suspended(world: World, step: Step) -> None:
    """Its lid was closed."""
    world.loop.suspend(step.much)


@_kind("user", "robot", hows=("leave", "stop", "cancel", "error"), weight=0.0)
def end(world: World, step: Step) -> None:
    """The robot comes to its end."""
    if step.how != "stop":
        world.finish(step.how)
        return
    world.begin_to_end()
    world.order("stop", world.robot.name, world.robot.stop("torture"))
    world.finish("leave")
