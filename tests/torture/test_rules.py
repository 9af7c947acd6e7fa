"""What torture judges: each rule is broken once, and seen."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.torture.generated import maker

import esair
from esair.actions import ReactionRunner
from esair.buses.peer import FakeNetwork, PeerBus
from esair.connections import ActuatorChannel
from esair.connections._protection import Stillness
from esair.drivers.peer import Peer, PeerSensor
from esair.testing import VirtualLoop
from esair.torture import Outcome, Step, Story, Target, World, torture
from esair.torture._kinds import KINDS, cast_of
from esair.torture._patience import HeldError, Patience, _held_in
from esair.torture._torture import random_story

HERE = Path(__file__).parent


class Sonar(esair.Sensor[float]):
    rate = 20.0

    async def read(self) -> float:
        return 1.0


class Wheels(esair.Actuator[float]):
    safe = 0.0

    async def write(self, command: float) -> None: ...


class Drive(esair.Behavior):
    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(0.5)


class Threaded(esair.ThreadBehavior):
    """Drives from a thread of its own."""

    wheels = esair.writes(float)

    def run(self) -> None:
        for _ in esair.every(0.05):
            self.wheels.write(0.5)


class Stop(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=5)

    def react(self, sonar: float) -> float | None:
        return None


def told_to(
    *behaviors: Any, steps: tuple[Step, ...] = (), lasts: float = 2.0
) -> Outcome:
    """Tell a story to a robot with these behaviors."""

    def make() -> esair.Robot:
        made = [each() for each in behaviors]
        return esair.Robot(resources=[Sonar(), Wheels()], behaviors=made)

    return World(Target("robot", make), Story(0, steps, lasts)).run()


def test_a_sound_robot_breaks_no_rule() -> None:
    """Each kind of step, once to each component."""
    cast = cast_of(
        esair.Robot(resources=[Sonar(), Wheels()], behaviors=[Drive(), Stop()])
    )
    at = itertools.count(1.0, 0.7)
    steps = [
        Step(next(at), kind.name, name, lasts=0.3, how=how, much=kind.much[0])
        for kind in KINDS.values()
        for name in cast[kind.on]
        for how in kind.hows
        if kind.name != "end"
    ]
    outcome = told_to(Drive, Stop, steps=tuple(steps), lasts=next(at))
    assert outcome.violations == ()
    assert outcome.done.total() > 0.9 * len(steps)


def threaded() -> esair.Robot:
    return esair.Robot(resources=[Wheels()], behaviors=[Threaded()])


@pytest.mark.parametrize("how", ["OSError", "SystemExit", "CancelledError"])
def test_a_crash_reaches_the_code_of_a_thread(how: str) -> None:
    """At its next call; it is restarted, and drives again."""
    target = Target("robot", threaded)
    world = World(target, Story(0, (Step(1.0, "crash", "threaded", how=how),), 2.0))
    assert world.run().violations == ()
    safe = [told.begun for told in world.gates[0].told if told.safe]
    assert safe == pytest.approx([0.0, 1.0, 2.0, 2.0], abs=0.06)


def test_a_thread_that_hangs_hears_no_end_and_is_no_finding() -> None:
    """Its actuator is safe by the dead man; it is removed while it hangs."""
    steps = (
        Step(1.0, "hang", "threaded", lasts=3.0),
        Step(1.5, "remove", "threaded", lasts=0.1),
    )
    target = Target("robot", threaded)
    world = World(target, Story(0, steps, 3.0))
    assert world.run().violations == ()
    assert [each.behavior for each in world.robot.behaviors.zombies] == ["threaded"]
    (dead, *_) = [t.begun for t in world.gates[0].told if t.safe and t.begun > 0.0]
    assert dead == pytest.approx(1.0 + Wheels.command_timeout, abs=0.06)


@pytest.mark.parametrize(
    ("lasts", "step"),
    [
        (6.607, Step(5.6, "late", "battery", lasts=1.0, how="before", much=0.3)),
        (1.3, Step(1.0, "silent", "air", lasts=4.0)),
    ],
)
def test_a_device_may_hold_up_the_thread_of_its_bus(lasts: float, step: Step) -> None:
    """What shares it waits behind, as on a real bus that hangs."""
    target = Target.of(str(HERE.parents[1] / "docs" / "code" / "ventilation.toml"))
    assert World(target, Story(0, (step,), lasts)).run().violations == ()


class Odometry(esair.Derived[float]):
    sonar = esair.reads(float)

    def compute(self, sonar: float) -> float:
        return sonar


def test_what_is_computed_has_no_stand_in() -> None:
    """It has no driver; what it is computed of has one."""

    def make() -> esair.Robot:
        return esair.Robot(resources=[Sonar(), Odometry()])

    target = Target("robot", make, alone=None)
    assert World(target, Story(0, (), 5.0)).run().violations == ()


class Valve(esair.Actuator[bool]):
    safe = False

    async def write(self, command: bool) -> None: ...


class Dry(esair.Reaction):
    """Moves nothing while the valve is closed."""

    is_open = esair.reads(bool, name="valve.applied")
    wheels = esair.guards(float)

    def react(self, is_open: bool, wheels: float) -> float | None:
        return wheels if is_open else None


class Pour(Drive):
    valve = esair.writes(bool)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.valve.write(True)
            await self.wheels.write(0.5)


@pytest.mark.promise("PRO-11")
def test_a_guard_sees_what_an_actuator_has_applied() -> None:
    """That has no device of its own, and is no finding for it."""

    def make() -> esair.Robot:
        return esair.Robot(resources=[Wheels(), Valve()], behaviors=[Pour(), Dry()])

    world = World(Target("robot", make), Story(0, (), 2.0))
    assert not world.run().violations
    assert any(told.command == 0.5 for told in world.gates[0].told)


@pytest.mark.promise("NET-2")
def test_a_peer_is_a_stand_in() -> None:
    """It lives on another computer, which the virtual clock does not reach."""

    def make() -> esair.Robot:
        base = PeerBus(name="base", network=FakeNetwork().of("laptop"))
        sonar = PeerSensor(name="sonar", bus=base, type=float)
        parts = [Peer(name="base", bus=base), sonar, Wheels()]
        return esair.Robot(name="laptop", resources=parts, behaviors=[Drive(), Stop()])

    assert not World(Target("robot", make), Story(0, (), 2.0)).run().violations


@pytest.mark.long
def test_a_robot_that_does_not_start_is_tried_once() -> None:
    """There is nothing that could be done to it."""
    target = Target.of(f"{HERE / 'planted.py'}:no_safe", own=True)
    report = torture(target, seed=0, faults=100)
    assert report.stories == 1
    assert [each.violation.rule for each in report.findings] == ["start"]


@pytest.mark.long
def test_an_interrupt_ends_the_search_after_its_story() -> None:
    """What was found until then is told; the next interrupt is Python's again."""
    target = Target("robot", threaded)
    report = torture(target, seed=0, told=lambda _: signal.raise_signal(signal.SIGINT))
    assert (report.stories, report.interrupted) == (1, True)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


class Look(Stop):
    """Sees to the wheels in one of two modes; what it reads says nothing."""

    sonar = esair.reads(float, max_age=0.2)


def two_modes() -> esair.Robot:
    modes = {"look": ["look"], "drive": ["drive"]}
    parts: list[Any] = [Sonar(), Wheels()]
    return esair.Robot(
        resources=parts, behaviors=[Look(), Drive()], modes=modes, mode="look"
    )


def test_who_rests_in_another_mode_sees_to_nothing() -> None:
    """A mode without whoever protects is one in which others drive."""
    steps = (Step(0.5, "silent", "sonar", lasts=5.0), Step(1.0, "switch", "drive"))
    outcome = World(Target("robot", two_modes), Story(0, steps, 3.0)).run()
    assert not outcome.violations


class Unknown:
    """What nobody can make without knowing more of it."""

    def __init__(self, shape: object) -> None: ...


class Camera(esair.Sensor[Unknown]):
    async def read(self) -> Unknown:
        return Unknown(())


def test_a_stand_in_that_has_nothing_to_say_is_told_and_no_finding() -> None:
    """Nobody says how a value of its type is made."""
    target = Target("robot", lambda: esair.Robot(resources=[Camera()]), alone=None)
    outcome = World(target, Story(0, (), 5.0)).run()
    assert outcome.violations == ()
    assert list(outcome.speechless) == ["camera"]


def test_the_same_story_is_told_twice() -> None:
    """What every device was told, and when, repeats."""

    def traces() -> list[Any]:
        target = Target.of(f"{HERE / 'planted.py'}:sound")
        cast = cast_of(target.make())
        world = World(target, random_story(cast, 11))
        world.run()
        return [
            [(told.begun, told.landed, repr(told.command)) for told in gate.told]
            for gate in world.gates
        ]

    assert traces() == traces()


class Direct(Drive):
    """Calls the driver itself."""

    async def run(self) -> None:
        wheels: Any = Wheels.latest
        await asyncio.sleep(1.0)
        await wheels.write(0.7)


class Hoarder(Drive):
    """Has a task that will not end."""

    async def run(self) -> None:
        while True:
            try:
                await asyncio.sleep(3600.0)
            except asyncio.CancelledError:
                continue


def test_who_calls_a_driver_himself_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is no command of esair's."""
    made: list[Wheels] = []
    monkeypatch.setattr(Wheels, "latest", property(lambda _: made[-1]), raising=False)
    create = Wheels.__init__

    def init(self: Wheels) -> None:
        create(self)
        Wheels.latest = self

    monkeypatch.setattr(Wheels, "__init__", init)
    outcome = told_to(Direct)
    assert ("unregistered", "wheels") in outcome.keys


def test_who_gives_back_what_its_thread_has_not_begun_with_is_no_finding() -> None:
    """The command was by right when it was sent on its way."""

    class Blocking(Wheels):
        def write(self, command: float) -> None: ...  # type: ignore[override]

    class Gives(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            async for _ in esair.every(0.3):
                writing = asyncio.ensure_future(self.wheels.write(0.5))
                await asyncio.sleep(0.0)
                self.wheels.release()
                await writing

    def make() -> esair.Robot:
        return esair.Robot(resources=[Blocking(name="wheels")], behaviors=[Gives()])

    assert World(Target("robot", make), Story(0, (), 1.0)).run().violations == ()


@pytest.mark.long
@pytest.mark.promise("REC-1")
def test_a_recording_changes_no_story(tmp_path: Path) -> None:
    """Every device is told the same at the same moments, by many who wish the same."""
    pytest.importorskip("foxglove", reason="needs esair[record]")
    numbers = itertools.count()

    def told(seed: int, *, recorded: bool) -> list[Any]:
        def make() -> esair.Robot:
            robot = maker(seed)()
            if recorded:
                path = tmp_path / f"{next(numbers)}.mcap"
                robot = esair.Robot(
                    resources=robot.plan.resources,
                    behaviors=robot.plan.behaviors,
                    grace=robot.grace,
                    record=esair.Recording(path),
                )
            return robot

        world = World(Target("robot", make), Story(seed, lasts=3.0))
        assert world.run().violations == ()
        return [(gate.name, each.begun, each.command, each.landed)
                for gate in world.gates for each in gate.told]  # fmt: skip

    for seed in range(60005, 60010):
        assert told(seed, recorded=True) == told(seed, recorded=False)


def test_what_will_not_end_is_left_behind() -> None:
    """A task that swallows every cancellation."""
    assert ("left", "hoarder") in told_to(Hoarder).keys


HELD = """
import esair.torture._patience
from esair.torture import Story, Target, World
esair.torture._patience.PATIENCE = 1.0
(violation,) = World(Target.of({robot!r}, own=True), Story(0)).run().violations
print(*violation.key, violation.text)
"""


@pytest.mark.long
def test_what_holds_the_loop_is_ended_and_named(tmp_path: Path) -> None:
    """Virtual time stands still for ever: real time does not; in any folder."""
    folder = tmp_path / "esair" / "lib" / "python"
    folder.mkdir(parents=True)
    robot = shutil.copy(HERE / "planted.py", folder)
    code = HELD.format(robot=f"{robot}:endless")
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("holds run Endless.run at "), done


@pytest.mark.parametrize(
    ("file", "own"),
    [
        ("/home/me/esair/rover.py", True),
        ("/home/me/esair/src/esair/rover.py", True),
        ("/srv/lib/python3/rover.py", True),
        (str(HERE / "rover.py"), True),
        (esair.__file__, False),
        (esair.loop.__file__, False),
        (signal.__file__, False),
        (pytest.__file__, False),
    ],
)
def test_whose_code_holds_the_loop_is_told_by_where_packages_lie(
    file: str, own: bool
) -> None:
    """A path that looks like one of a library is none."""
    names: dict[str, Any] = {"held": _held_in, "frame": sys._getframe}
    exec(compile("def run():\n    return held(frame(), 1.0)", file, "exec"), names)
    held = names["run"]()
    assert held.component.startswith("run" if own else "test_whose_code")


def test_a_story_that_goes_on_may_take_long() -> None:
    """On a busy computer; what counts is whether virtual time passes."""
    with contextlib.closing(VirtualLoop()) as loop, Patience(loop) as patience:
        for _ in range(3):
            loop.advance(0.001)
            signal.raise_signal(signal.SIGALRM)
        assert patience.lost is None
        with pytest.raises(HeldError, match="10 s of real time"):
            signal.raise_signal(signal.SIGALRM)


@pytest.mark.parametrize(
    ("core", "broken", "rule", "steps"),
    [
        (Stillness, "dead", "dead man", (Step(1.0, "hang", "drive", lasts=1.0),)),
        (ActuatorChannel, "halt", "halted", (Step(1.0, "halt", lasts=0.5),)),
        (
            ActuatorChannel,
            "protect",
            "blind",
            (Step(1.0, "unplugged", "sonar", lasts=0.5),),
        ),
    ],
)
def test_a_core_that_breaks_its_promise_is_seen(
    core: type,
    broken: str,
    rule: str,
    steps: tuple[Step, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Without the dead man, the halt, or the holds of those that cannot see."""
    monkeypatch.setattr(core, broken, lambda *_args, **_options: None)
    assert (rule, "wheels") in told_to(Drive, Stop, steps=steps).keys


def test_who_drives_on_a_bad_command_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reaction that goes mad is blind; without the hold the one below it drives."""

    class Turn(Stop):
        def react(self, sonar: float) -> float | None:
            return -0.1 if self.now_ms % 1000 < 400 else None

    steps = (Step(1.0, "mad", "turn", lasts=1.0, how="nan"),)
    monkeypatch.setattr(ReactionRunner, "flawed", lambda *_: None)
    assert ("blind", "wheels") in told_to(Drive, Turn, steps=steps).keys
    monkeypatch.undo()
    assert told_to(Drive, Turn, steps=steps).violations == ()


@pytest.mark.parametrize(
    ("number", "lasts", "steps"),
    [
        pytest.param(
            171,
            6.472,
            (
                Step(6.172, "flood", "driver_0"),
                Step(6.172, "remove", "reflex_1", lasts=0.02),
            ),
            id="who-is-taken-away-need-not-see",
        ),
        pytest.param(
            175,
            1.366,
            (Step(1.1, "slow", "reflex_2", lasts=1.0, much=0.2),),
            id="steps-that-hold-the-loop",
        ),
        pytest.param(
            50139,
            1.763,
            (
                Step(0.3, "held up", much=0.5),
                Step(1.429, "slow", "guard_1", lasts=0.1, much=0.2),
                Step(1.5, "slow", "guard_1", lasts=0.02, much=0.01),
            ),
            id="a-step-that-is-slow-and-then-quicker",
        ),
        pytest.param(
            217,
            3.054,
            (
                Step(1.5, "mute", "reflex_1", much=1.0),
                Step(1.7, "unplugged", "polled_1", lasts=1.0),
                Step(2.436, "held up", much=0.5),
                Step(2.8, "flood", "driver_0"),
            ),
            id="a-stall-makes-a-mute-longer",
        ),
        pytest.param(
            329,
            3.035,
            (
                Step(1.9, "wrong", "pushing_1", lasts=0.3, how="nan"),
                Step(2.0, "late", "pushing_1", lasts=1.0, how="after", much=0.3),
            ),
            id="a-first-value-is-there-when-the-opening-is-over",
        ),
        pytest.param(
            360,
            2.359,
            (
                Step(1.0, "hang", "driver_0", lasts=4.0, how="deaf"),
                Step(1.04, "held up", much=0.5),
                Step(1.4, "remove", "driver_0", lasts=0.02),
                Step(2.059, "hang", "driver_0", lasts=0.1),
            ),
            id="who-was-deaf-when-it-was-told-to-end",
        ),
        pytest.param(
            60183,
            4.724,
            (
                Step(1.17, "held up", much=0.05),
                Step(1.2, "silent", "servo_1", lasts=1.0),
                Step(1.7, "power cycled", "motor_0"),
                Step(2.0, "late", "servo_1", lasts=0.3, how="after deaf", much=0.01),
                Step(2.223, "held up", much=2.0),
            ),
            id="safe-is-sent-again-once-the-computer-lets-it",
        ),
    ],
)
def test_what_is_no_finding(number: int, lasts: float, steps: tuple[Step, ...]) -> None:
    """What looks like a broken promise, and is what the user or the clock has done."""
    world = World(Target("robot", maker(number)), Story(0, steps, lasts))
    assert world.run().violations == ()
    assert world.done.total() == len(steps)


class Eye(esair.Sensor[Any]):
    """It does not say what it gives."""

    rate = 20.0

    async def read(self) -> bool:
        return True


class Turn(esair.Reaction):
    eye = esair.reads(bool, max_age=0.3)
    wheels = esair.writes(float)

    def react(self, eye: bool) -> float:
        return 0.1 if eye else 0.4


@pytest.mark.parametrize("how", ["nothing", "type", "nan"])
def test_of_a_sensor_that_says_no_type_all_but_nan_is_believed(how: str) -> None:
    """So nobody was blind who decided on it; of what is no number, nobody decides."""

    def make() -> esair.Robot:
        return esair.Robot(resources=[Eye(), Wheels()], behaviors=[Turn()])

    story = Story(0, (Step(0.3, "wrong", "eye", lasts=1.0, how=how),), 2.0)
    world = World(Target("robot", make), story)
    assert world.run().violations == ()
    assert world.done.total() == 1


HOLDS = """
import math

import esair


class Sonar(esair.Sensor[float]):
    def __init__(self) -> None:
        super().__init__()
        self.codec = math

    async def read(self) -> float:
        raise AssertionError("a stand-in answers")


class Look(esair.Behavior):
    sonar = esair.reads(float)

    async def run(self) -> None:
        async for _ in self.sonar:
            pass


robot = esair.Robot(resources=[Sonar()], behaviors=[Look()])
"""


def test_what_a_driver_holds_that_cannot_be_copied_is_shared(tmp_path: Path) -> None:
    """Such as a module: nobody calls it; a driver that is called must be made anew."""
    file = tmp_path / "holds.py"
    file.write_text(HOLDS)
    target = Target.of(f"{file}:robot")

    assert World(target, Story(1, (), 1.0)).run().violations == ()
    one, other = (target.make().plan.resource_of["sonar"] for _ in range(2))
    assert one is not other
    with pytest.raises(esair.ConfigError, match="cannot be made a second time"):
        Target.of(f"{file}:robot", own=True)
