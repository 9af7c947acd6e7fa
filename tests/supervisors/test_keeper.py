"""What a robot does with its watchdog, which is a fake here."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from typing import Any

import pytest

import esair
import esair.watchdog
from esair.supervisors import _watching
from esair.supervisors._watching import STARTS
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("GRD-1", "GRD-3")]


READY = esair.ResourceState.READY


class FakeWatchdog:
    """Notes what it is told; it dies when the test says so."""

    made: list[FakeWatchdog]
    missing = False

    def __init__(
        self, *, limit: float, policy: str, on_death: Callable[[], None]
    ) -> None:
        self.made.append(self)
        self.die = on_death
        self.starts = self.beats = 0
        self.told: list[Any] = []
        self.latched = False
        self.armed = asyncio.Event()
        self.answers: Any = asyncio.Event()
        self.answers.set()
        self.refusal = ""
        self.watched: set[str] = set()
        self.patience: list[float] = []

    async def start(self) -> None:
        if self.missing:
            raise OSError(12, "no memory")
        self.starts += 1

    async def arm(self, name: str, _frames: object, _outlet: object) -> str:
        self.told.append(("arm", name))
        self.armed.set()
        await self.answers.wait()
        if self.missing:
            return "there is no watchdog process"
        if not self.refusal:
            self.watched.add(name)
        return self.refusal

    def watches(self, name: str) -> bool:
        return name in self.watched

    async def drop(self, name: str, within: float = -1.0) -> None:
        self.watched.discard(name)
        self.patience.append(within)
        self.told.append(("drop", name))

    def moving(self, name: str, moves: bool) -> None:
        self.told.append(("moves" if moves else "safe", name))

    def beat(self) -> None:
        self.beats += 1

    async def close(self) -> None:
        self.told.append("close")


class Motor(FakeActuator[float]):
    outlet: Any = object()
    frames: Any = ()
    rest = esair.setting(0.0)
    homed = 0

    def safe_frames(self) -> Any:
        if isinstance(self.frames, Exception):
            raise self.frames
        return self.frames

    async def apply(self, **_settings: object) -> None: ...

    @esair.operation
    async def home(self) -> None:
        self.homed += 1


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> type[FakeWatchdog]:
    """Put the fake in the place of the watchdog."""
    fresh = type("Fresh", (FakeWatchdog,), {"made": []})
    monkeypatch.setattr(esair.watchdog, "Watchdog", fresh, raising=False)
    return fresh


def robot_with(**options: Any) -> tuple[esair.Robot, Motor, Any]:
    motor = Motor("motor", safe=0.0, command_timeout=5.0)
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    options = {"watchdog": True, "watchdog_limit": 0.1, **options}
    allow = esair.Policy(
        "motor", allow={"*": esair.Access.CONFIGURE | esair.Access.WRITE}
    )
    robot = esair.Robot(
        resources=[motor], behaviors=[user], policies=[allow], **options
    )
    return robot, motor, user


async def test_it_is_started_first_and_closed_last(fake: type[FakeWatchdog]) -> None:
    """Between them it hears what is open, what moves, and that the scheduler turns."""
    robot, _, user = robot_with()
    async with robot:
        (dog,) = fake.made
        assert (dog.starts, dog.told) == (1, [("arm", "motor")])
        await user.motor.write(1.0)
        assert dog.told[1:] == [("moves", "motor")]
        before = dog.beats
        while dog.beats < before + 3:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0.01)
        assert robot.resources.query("motor").state is esair.ResourceState.READY
    assert dog.told[2] == ("safe", "motor")
    assert dog.told[-2:] == [("drop", "motor"), "close"]
    assert {*dog.told[2:-2]} == {("safe", "motor")}


async def test_nothing_moves_once_it_has_acted(fake: type[FakeWatchdog]) -> None:
    """Neither a write nor an operation: this process is about to end."""
    robot, motor, user = robot_with()
    async with robot:
        (dog,) = fake.made
        mine = await robot.resources.register(
            "user", "motor", esair.Access.CONFIGURE | esair.Access.WRITE
        )
        await robot.resources.operate(mine, "home")
        dog.latched = True
        with pytest.raises(esair.StoppingError, match="watchdog"):
            await user.motor.write(1.0)
        with pytest.raises(esair.StoppingError, match="watchdog"):
            await robot.resources.operate(mine, "home")
        assert motor.homed == 1
        assert not any(motor.commands)


class Shut(esair.Reaction):
    """Lets nothing pass."""

    motor = esair.guards(float)

    def react(self, motor: float) -> None: ...


class Blind(esair.Reaction):
    """Never sees anything, so that what is safe alone may pass."""

    eye = esair.reads(float)
    motor = esair.writes(float, priority=5, blind="safe")

    def react(self, eye: float) -> None: ...


@pytest.mark.parametrize(("reaction", "asked"), [(Shut, 1.0), (Blind, 0.0)])
async def test_what_does_not_move_is_no_motion(
    fake: type[FakeWatchdog], reaction: type[esair.Reaction], asked: float
) -> None:
    """A guard refuses it, or it is safe: a process that stands still is left alone."""
    motor = Motor("motor", safe=0.0)
    eye: FakeSensor[float] = FakeSensor("eye", type=float)
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    async with esair.Robot(
        resources=[motor, eye],
        behaviors=[user, reaction()],
        watchdog=True,
        start_patience=0.05,
    ):
        (dog,) = fake.made
        told = await user.motor.write(asked)
        assert isinstance(told, esair.Refused) == bool(asked)
        assert ("moves", "motor") not in dog.told
    assert set(motor.commands) == {0.0}


async def test_what_safe_is_may_change_with_the_settings(
    fake: type[FakeWatchdog],
) -> None:
    """Its frames are handed over anew."""
    robot, _, _ = robot_with()
    async with robot:
        (dog,) = fake.made
        mine = await robot.resources.register("u", "motor", esair.Access.CONFIGURE)
        await robot.resources.configure(mine, rest=1.0)
        assert dog.told == [("arm", "motor")] * 2


@pytest.mark.promise("GRD-4")
@pytest.mark.parametrize(
    ("field", "value"),
    [("frames", ValueError("no zero")), ("frames", None), ("outlet", None)],
)
async def test_what_is_watched_stays_so_whatever_is_said_later(
    field: str,
    value: Any,
    fake: type[FakeWatchdog],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Settings that take its safe frames away leave the old ones, and say that."""
    robot, motor, user = robot_with()
    async with robot:
        (dog,) = fake.made
        mine = await robot.resources.register("u", "motor", esair.Access.CONFIGURE)
        assert await user.motor.write(1.0)
        setattr(motor, field, value)
        await robot.resources.configure(mine, rest=1.0)
        assert dog.watched == {"motor"}
        assert await user.motor.write(2.0)
        assert "UNWATCHED" not in str(robot.resources.why("motor"))
    told = [each.getMessage() for each in caplog.records]
    assert any("has its safe frames of before" in each for each in told)
    assert not any("UNWATCHED" in each for each in told)


@pytest.mark.parametrize(
    ("field", "value", "why"),
    [
        ("frames", ValueError("no zero"), "its safe_frames raised ValueError: no zero"),
        ("frames", None, "cannot say its safe command as bytes"),
        ("outlet", None, "cannot reach its bus"),
    ],
)
async def test_what_cannot_be_watched_says_why_once(
    field: str,
    value: Any,
    why: str,
    fake: type[FakeWatchdog],
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It runs unwatched; that is said again when it is opened again, not before."""
    robot, motor, user = robot_with(watchdog_death="alarm")
    setattr(motor, field, value)
    async with robot:
        (dog,) = fake.made
        assert await user.motor.write(1.0)
        dog.die()  # and is told again what to watch
        while dog.starts == 1:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.01)
        assert ("arm", "motor") not in dog.told
    assert [why in each.getMessage() for each in caplog.records].count(True) == 1


@pytest.mark.parametrize("policy", ["stop", "alarm"])
async def test_one_that_dies_is_started_anew(
    fake: type[FakeWatchdog], policy: Any
) -> None:
    """And told again what to watch; the robot is halted unless the user wants less."""
    robot, _, user = robot_with(watchdog_death=policy)
    async with robot:
        (dog,) = fake.made
        dog.told.clear()
        dog.armed.clear()
        for number in range(1, STARTS + 2):
            dog.die()
            if number <= STARTS:
                await asyncio.wait_for(dog.armed.wait(), 10.0)
                dog.armed.clear()
            await asyncio.sleep(0.01)
            assert dog.told.count(("arm", "motor")) == min(number, STARTS)
            assert (await user.motor.write(1.0)).__class__ is (
                esair.Refused if policy == "stop" else esair.Written
            )
            robot.resume()
        assert dog.starts == STARTS + 1


@pytest.mark.parametrize("policy", ["stop", "alarm"])
async def test_without_it_a_robot_starts_halted(
    fake: type[FakeWatchdog], policy: Any
) -> None:
    """Or unwatched, if the user says so."""
    fake.missing = True
    robot, _, user = robot_with(watchdog_death=policy)
    async with robot:
        answer = await user.motor.write(1.0)
        assert bool(answer) is (policy == "alarm")
        robot.resume()
        answer = await user.motor.write(1.0)
        assert bool(answer) is (policy == "alarm")
        if policy == "stop":
            assert "motor is not watched" in answer.rule
            assert 'watchdog_death="alarm"' in answer.rule


def state_of(robot: esair.Robot) -> esair.ResourceState:
    return robot.resources.query("motor").state


@pytest.mark.promise("GRD-4")
@pytest.mark.parametrize("policy", ["stop", "alarm"])
async def test_what_is_not_armed_yet_is_not_ready(
    fake: type[FakeWatchdog], policy: Any
) -> None:
    """However late the answer is; then it is watched, and ready, and may be written."""
    robot, motor, user = robot_with(watchdog_death=policy)
    async with robot:
        (dog,) = fake.made
        for late in (0.0, 0.3):
            dog.answers.clear()
            motor.unplug()
            await asyncio.sleep(0.02)
            motor.plug()
            dog.armed.clear()
            robot.resources.query("motor")
            await asyncio.wait_for(dog.armed.wait(), 10.0)
            await asyncio.sleep(late)
            assert state_of(robot) is esair.ResourceState.OPENING
            with pytest.raises(esair.DeviceLostError):
                await user.motor.write(1.0)
            dog.answers.set()
            while state_of(robot) is not esair.ResourceState.READY:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            assert not robot.halted
            assert await user.motor.write(1.0)
        assert motor.commands.count(1.0) == 2


@pytest.mark.promise("GRD-4")
async def test_the_start_waits_for_a_slow_watchdog(fake: type[FakeWatchdog]) -> None:
    """No behavior runs before what it drives is watched; and it can be stopped then."""
    robot, motor, _ = robot_with()
    keeper: Any = robot._keeper
    keeper.watchdog.answers.clear()
    entering = asyncio.create_task(robot.__aenter__())
    await keeper.watchdog.armed.wait()
    await asyncio.sleep(0.05)
    assert not entering.done()
    assert motor.commands == [0.0]
    await robot.stop("the test is over")
    with pytest.raises(esair.StoppingError):
        await entering
    assert keeper.watchdog.told[-1] == "close"


@pytest.mark.promise("GRD-4")
@pytest.mark.parametrize("policy", ["stop", "alarm"])
async def test_what_cannot_be_armed_halts(
    fake: type[FakeWatchdog], policy: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """And keeps the robot halted until it can; with "alarm" it is said and moves."""
    robot, _, user = robot_with(watchdog_death=policy)
    keeper: Any = robot._keeper
    keeper.watchdog.refusal = "no such chip"
    async with robot:
        assert bool(robot.halted) == (policy == "stop")
        robot.resume()
        assert bool(robot.halted) == (policy == "stop")
        assert bool(await user.motor.write(1.0)) == (policy == "alarm")
        keeper.watchdog.refusal = ""
        await robot.resources.restart("motor")
        while state_of(robot) is not esair.ResourceState.READY:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        assert bool(robot.halted) == (policy == "stop")
        robot.resume()
        assert await user.motor.write(1.0)
    assert "motor: UNWATCHED: no such chip" in caplog.text


@pytest.mark.promise("GRD-4")
async def test_what_is_removed_keeps_nobody_still(fake: type[FakeWatchdog]) -> None:
    """Nor does what is not open."""
    robot, motor, _ = robot_with()
    keeper: Any = robot._keeper
    keeper.watchdog.refusal = "no such chip"
    async with robot:
        robot.resume()
        assert robot.halted
        motor.unplug()
        motor.report_lost()
        await asyncio.sleep(0.05)
        robot.resume()
        assert not robot.halted


@pytest.mark.promise("GRD-4")
async def test_what_was_told_to_one_that_died_is_told_to_the_next(
    fake: type[FakeWatchdog],
) -> None:
    """It died before it answered: the device is watched by the one that came meanwhile."""
    robot, motor, _ = robot_with(watchdog_death="alarm")
    async with robot:
        dog: Any = fake.made[0]
        arm = dog.arm

        async def dies(*_: object) -> str:
            dog.arm = arm
            dog.die()
            while dog.starts < 2:  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            return "it died"

        dog.arm = dies
        motor.unplug()
        await asyncio.sleep(0.02)
        motor.plug()
        while dog.starts < 2 or state_of(robot) is not READY:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        assert "sends its safe command" in robot.resources.why("motor").dies


@pytest.mark.promise("GRD-4")
async def test_a_rearming_that_fails_keeps_the_old_watch(
    fake: type[FakeWatchdog], caplog: pytest.LogCaptureFixture
) -> None:
    """A change of settings does not unwatch what drives; it is said."""
    robot, _, user = robot_with()
    async with robot:
        (dog,) = fake.made
        mine = await robot.resources.register("u", "motor", esair.Access.CONFIGURE)
        assert await user.motor.write(1.0)
        dog.refusal = "no answer"
        await robot.resources.configure(mine, rest=1.0)
        assert dog.watches("motor")
        assert not robot.halted
        assert "sends its safe command" in robot.resources.why("motor").dies
    told = "motor: its watchdog has its safe frames of before: no answer"
    assert told in caplog.text


@pytest.mark.promise("GRD-4")
async def test_one_that_dies_often_is_started_less_often(
    fake: type[FakeWatchdog], monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for ever: it halts the robot until it is there and has answered."""
    monkeypatch.setattr(_watching, "STARTS", 1)
    robot, _, user = robot_with()
    async with robot:
        (dog,) = fake.made
        for deaths in (1, 2):
            dog.watched.clear()
            dog.answers.clear()
            dog.armed.clear()
            began = asyncio.get_running_loop().time()
            dog.die()
            await asyncio.sleep(0.01)
            robot.resume()
            assert robot.halted
            await asyncio.wait_for(dog.armed.wait(), 10.0)
            robot.resume()
            assert "the watchdog process died" in (robot.halted or "")
            waited = asyncio.get_running_loop().time() - began
            assert (waited >= 1.0) == (deaths == 2)
            dog.answers.set()
            await asyncio.sleep(0.05)
            robot.resume()
            assert not robot.halted
            assert await user.motor.write(1.0)


@pytest.mark.promise("GRD-4")
async def test_the_answer_of_one_that_died_since_is_none_of_the_next(
    fake: type[FakeWatchdog],
) -> None:
    """It is armed there, too: it was not ready when all that were heard of the new one."""
    robot, _, _ = robot_with()
    async with robot:
        (dog,) = fake.made
        dog.answers.clear()
        dog.armed.clear()
        opened = asyncio.ensure_future(robot.resources.restart("motor"))
        await asyncio.wait_for(dog.armed.wait(), 10.0)
        dog.die()
        while dog.starts == 1:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.01)
        dog.told.clear()
        dog.answers.set()
        await asyncio.wait_for(opened, 10.0)
        assert ("arm", "motor") in dog.told


async def test_a_robot_that_ends_does_not_wait_for_a_new_watchdog(
    fake: type[FakeWatchdog],
) -> None:
    """Its start is given up."""
    robot, _, _ = robot_with(watchdog_death="alarm")
    given_up = asyncio.Event()

    async def hangs() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            given_up.set()

    async with robot:
        (dog,) = fake.made
        dog.start = hangs  # type: ignore[method-assign]
        dog.die()
        await asyncio.sleep(0.01)
    await asyncio.wait_for(given_up.wait(), 10.0)
    assert dog.told[-1] == "close"


async def test_only_what_can_move_by_itself_is_watched(
    fake: type[FakeWatchdog], fake_sensor: Any
) -> None:
    """Sensors and what is lost are not armed when the watchdog comes again."""
    robot, motor, _ = robot_with(watchdog_death="alarm")
    async with robot:
        (dog,) = fake.made
        await robot.resources.add(fake_sensor("eye", 1.0))
        motor.unplug()
        await asyncio.sleep(0.05)
        dog.told.clear()
        dog.die()
        while dog.starts == 1:  # noqa: ASYNC110 - it tells nobody
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.01)
        assert ("arm", "motor") not in dog.told


@pytest.mark.parametrize("field", ["watchdog_policy", "watchdog_death"])
def test_its_policies_are_words(fake: type[FakeWatchdog], field: str) -> None:
    """Another word is a mistake that names what there is."""
    with pytest.raises(esair.ConfigError, match=f"{field}.* or "):
        robot_with(**{field: "perhaps"})
    with pytest.raises(esair.ConfigError, match="watchdog_limit"):
        robot_with(watchdog_limit=0.0)
    assert fake.made == []


async def test_elsewhere_than_on_linux_it_is_refused(
    fake: type[FakeWatchdog], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody believes to be watched where there is no second process to do it."""
    monkeypatch.setattr(sys, "platform", "darwin")
    with pytest.raises(esair.ConfigError, match="expected Linux, not darwin"):
        robot_with()


async def test_where_it_cannot_be_started_the_pauses_grow(
    fake: type[FakeWatchdog], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From a second to a minute, and it is tried for ever."""
    pauses: list[float] = []
    enough = asyncio.Event()

    class Quick:
        """Like asyncio, but that nothing sleeps for long."""

        def __getattr__(self, name: str) -> Any:
            return getattr(asyncio, name)

        async def sleep(self, seconds: float) -> None:
            pauses.append(seconds)
            if len(pauses) == 8:
                enough.set()
                await asyncio.Event().wait()

    fake.missing = True
    monkeypatch.setattr(_watching, "asyncio", Quick())
    robot, _, _ = robot_with(watchdog_death="alarm")
    async with robot:
        await asyncio.wait_for(enough.wait(), 10.0)
    assert pauses == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]


async def test_a_removal_and_the_stop_say_how_long_they_wait(
    fake: type[FakeWatchdog],
) -> None:
    """The stop has a deadline; who restarts a device waits as long as usual."""
    robot, _, _ = robot_with()
    async with robot:
        (dog,) = fake.made
        await robot.resources.restart("motor")
        while state_of(robot) is not esair.ResourceState.READY:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        usual = list(dog.patience)
    assert usual == [-1.0]
    assert len(dog.patience) == 2
    assert 0.5 <= dog.patience[1] <= 3.0
