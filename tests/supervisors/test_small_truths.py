"""Small rules of supervisors that only show in a corner."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import weakref
from typing import Any

import attrs
import pytest
from tests.supervisors.actors import Idle, turns

import esair
from esair import Access
from esair.journal import Event, Kind
from esair.supervisors._command_queue import LIMIT, CommandQueue
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


@attrs.frozen(weakref_slot=True)
class Job(esair.Request[int]):
    number: int


class Worker(esair.Behavior):
    """Keeps what it takes for the test to answer."""

    jobs = esair.takes(Job, queue=4)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.has: list[Job] = []

    async def run(self) -> None:
        async for job in self.jobs:
            self.has.append(job)
            await asyncio.sleep(10.0)


# Requests.


@pytest.mark.promise("BS-8")
async def test_who_answers_is_told_whether_somebody_waits() -> None:
    """A second answer, and progress after it, are too late; that is counted."""
    asker, worker = Idle(name="asker"), Worker()
    async with esair.Robot(behaviors=[asker, worker]) as robot:
        asking = asyncio.create_task(asker.ask("worker", Job(1)))
        await turns()
        (job,) = worker.has
        assert job.progress(0.5)
        assert job.answer(7)
        assert not job.progress(0.9)
        assert not job.answer(8)
        assert not job.refuse("too late")
        assert await asking == 7
        assert robot.journal.counts()["behaviors"]["late_answers"] == 3


@pytest.mark.promise("BS-10")
async def test_a_time_that_is_none_is_told_by_what_it_may_be() -> None:
    """An answer may be waited for without a limit, a hand-over not."""
    asker, worker = Idle(name="asker"), Worker()
    async with esair.Robot(behaviors=[asker, worker]):
        with pytest.raises(esair.BadValueError, match=r"seconds > 0, or None, not -1"):
            await asker.ask("worker", Job(1), timeout=-1)
        with pytest.raises(esair.BadValueError, match=r"seconds > 0, not None"):
            await asker.put("worker", Job(1), interval=None)  # type: ignore[arg-type]


@pytest.mark.promise("BS-10")
async def test_who_answers_in_a_thread_of_its_own_hears_whether_it_counts() -> None:
    """As in the loop: true while somebody waits."""
    asker, worker = Idle(name="asker"), Worker()
    async with esair.Robot(behaviors=[asker, worker]):
        asking = asyncio.create_task(asker.ask("worker", Job(1)))
        await turns()
        (job,) = worker.has
        assert await asyncio.to_thread(job.progress, 0.5) is True
        assert await asyncio.to_thread(job.answer, 7) is True
        assert await asyncio.to_thread(job.answer, 8) is False
        assert await asking == 7


@pytest.mark.promise("BS-5", "BS-8")
@pytest.mark.parametrize(("verb", "seconds"), [("put", 1.0), ("get", 1.0), ("ask", 10)])
async def test_who_says_no_time_waits_for_so_many_seconds(
    verb: str, seconds: float
) -> None:
    """A second for data, ten for an answer; exactly so long."""

    class Deaf(esair.Behavior):
        inbox_size = 1
        jobs = esair.takes(Job)

        async def run(self) -> None:
            await asyncio.sleep(1e6)

    async with esair.Robot(behaviors=[Deaf(name="worker")]) as robot:
        there = robot.behaviors
        await there.put(0, sender="user", receiver="worker")
        request: Any = {
            "put": lambda: there.put(1, sender="user", receiver="worker"),
            "get": lambda: there.get(sender="worker", receiver="user"),
            "ask": lambda: there.ask(Job(1), sender="user", receiver="worker"),
        }[verb]
        began = asyncio.get_running_loop().time()
        with pytest.raises(esair.BehaviorUnavailableError, match=f"{seconds:g} s"):
            await request()
        assert asyncio.get_running_loop().time() == pytest.approx(began + seconds)


@pytest.mark.promise("BS-8")
async def test_an_answered_request_is_forgotten_long_before_its_timeout() -> None:
    """Neither its deadline nor its asker keeps it."""

    class Answers(esair.Behavior):
        @esair.answers
        async def job(self, request: Job) -> int:
            await asyncio.sleep(0.1)
            return request.number

    asker = Idle(name="asker")
    async with esair.Robot(behaviors=[asker, Answers()]):
        request = Job(7)
        known = weakref.ref(request)
        assert await asker.ask("answers", request, timeout=3600.0) == 7
        await turns()
        del request
        gc.collect()
        assert known() is None


@pytest.mark.promise("BS-8")
@pytest.mark.real_clock
def test_an_answer_after_the_end_of_the_loop_is_told_to_be_late() -> None:
    """Whoever kept the request, in a thread say: nobody waits any more."""
    worker = Worker()

    async def work() -> None:
        asker = Idle(name="asker")
        async with esair.Robot(behaviors=[asker, worker]):
            asking = asyncio.create_task(asker.ask("worker", Job(1)))
            await turns()
        with contextlib.suppress(esair.EsairError):
            await asking

    asyncio.run(work())
    (job,) = worker.has
    assert (job.answer(7), job.progress(0.5), job.refuse("no")) == (False, False, False)


@pytest.mark.promise("BS-8")
async def test_an_order_goes_to_the_next_if_its_taker_is_cancelled_in_that_instant() -> (
    None
):
    """Two loops take the same requests; what woke the first is left to the second."""
    taken: list[str] = []

    class Two(esair.Behavior):
        jobs = esair.takes(Job)

        async def run(self) -> None:
            self.first = asyncio.create_task(self.serve("first"))
            await asyncio.sleep(0)
            self.second = asyncio.create_task(self.serve("second"))
            await asyncio.wait({self.first, self.second})

        async def serve(self, name: str) -> None:
            async for job in self.jobs:
                taken.append(name)
                job.answer(1)

    asker, two = Idle(name="asker"), Two()
    async with esair.Robot(behaviors=[asker, two]):
        await asyncio.sleep(0.1)
        queue: Any = vars(two)["jobs"]._loop.__self__
        asking = asyncio.create_task(asker.ask("two", Job(1), timeout=1.0))
        while not queue.count:  # noqa: ASYNC110 - the very instant is wanted
            await asyncio.sleep(0)
        two.first.cancel()
        assert await asking == 1
        assert taken == ["second"]


@pytest.mark.promise("BS-5")
async def test_one_that_gives_up_ends_what_is_made_for_it() -> None:
    """And the next asker's data is made at once."""
    made: list[str] = []

    class Giver(esair.Behavior):
        async def provide(self) -> int:
            made.append("begun")
            try:
                await asyncio.sleep(100.0)
            except asyncio.CancelledError:
                made.append("cancelled")
                raise
            return 1

    asker = Idle(name="asker")
    async with esair.Robot(behaviors=[asker, Giver()]):
        with pytest.raises(esair.BehaviorUnavailableError):
            await asker.get("giver", interval=1.0)
        await turns()
        assert made == ["begun", "cancelled"]


@pytest.mark.promise("BS-5")
async def test_what_is_received_in_time_leaves_no_timer() -> None:
    """A timeout of an hour is over with the wait."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        taking = asyncio.create_task(b.receive(timeout=3600.0))
        await turns()
        await a.put("b", 1)
        assert await taking == 1


@pytest.mark.promise("BS-8")
async def test_a_worker_that_ends_its_own_request_is_not_hit_afterwards() -> None:
    """It removes its asker, leaves the block, and goes on undisturbed."""
    went_on: list[str] = []

    class Rude(esair.Behavior):
        jobs = esair.takes(Job)

        async def run(self) -> None:
            async for job in self.jobs:
                async with job:
                    asking.cancel()
                    while not job.cancelled:  # noqa: ASYNC110 - the very instant
                        await asyncio.sleep(0)
                await asyncio.sleep(0.1)
                went_on.append("rude")

    asker = Idle(name="asker")
    async with esair.Robot(behaviors=[asker, Rude()]) as robot:
        asking = asyncio.create_task(asker.ask("rude", Job(1)))
        await asyncio.wait({asking})
        await asyncio.sleep(0.5)
        assert went_on == ["rude"]
        assert robot.behaviors.query("rude").restarts == 0


# Commands of the user.


@pytest.mark.promise("SUP-1")
async def test_a_command_that_is_given_up_leaves_its_place() -> None:
    """As many as were cancelled may wait again."""
    queue = CommandQueue("queue")

    async def nothing() -> None: ...

    def begin() -> list[asyncio.Task[Any]]:
        return [
            asyncio.ensure_future(queue.run(nothing, name="work", undo=False))
            for _ in range(LIMIT)
        ]

    for _ in range(2):
        tasks = begin()
        await turns()
        for task in tasks:
            assert not task.done()
            task.cancel()
        await asyncio.wait(tasks)
    last = begin()
    await turns()
    queue.initialized()
    assert await asyncio.gather(*last) == [None] * LIMIT


@pytest.mark.promise("RS-2")
@pytest.mark.parametrize(
    ("terms", "field"),
    [
        ({"access": "write"}, "expected an esair.Access"),
        ({"priority": 1.0}, "priority"),
        ({"priority": True}, "priority"),
        ({"hold": 0.0}, "hold"),
        ({"hold": "1"}, "hold"),
    ],
)
async def test_the_terms_of_a_right_are_checked(
    terms: dict[str, Any], field: str
) -> None:
    """Before anything is registered."""
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels]) as robot:
        terms = {"access": Access.WRITE, **terms}
        access = terms.pop("access")
        with pytest.raises(esair.ConfigError, match=field):
            await robot.resources.register("user", "wheels", access, **terms)
        channel = robot.actuators.channels["wheels"]
        assert not list(channel.registrations.of_resource("wheels"))


@pytest.mark.promise("SUP-1")
async def test_a_command_whose_caller_has_gone_fails_quietly() -> None:
    """What it raised is nobody's any more."""
    queue = CommandQueue("queue")
    queue.initialized()

    async def fail() -> None:
        await asyncio.sleep(0.1)
        raise ValueError("no")

    calling = asyncio.ensure_future(queue.run(fail, name="work", undo=False))
    await turns()
    calling.cancel()
    await asyncio.wait({calling})
    await asyncio.sleep(0.2)
    gc.collect()


@pytest.mark.promise("SUP-3")
async def test_a_name_is_taken_until_the_replaced_device_has_gone() -> None:
    """Whoever removes it meanwhile waits, and removes the new one."""

    class Slow(FakeSensor[float]):
        async def close(self) -> None:
            await asyncio.sleep(0.5)
            await super().close()

    old, new = Slow("sonar", 1.0), FakeSensor("sonar", 2.0)
    async with esair.Robot(resources=[old]) as robot:
        replacing = asyncio.create_task(robot.resources.replace("sonar", new))
        await asyncio.sleep(0.1)
        await robot.resources.remove("sonar")
        await asyncio.wait({replacing})
        assert robot.resources.names() == []
        assert not old.is_open
        assert not new.is_open


@pytest.mark.promise("RS-7", "PRO-4")
async def test_a_halt_refuses_operations_and_no_settings() -> None:
    """What moves nothing may be changed."""

    class Lift(FakeActuator[float]):
        speed = esair.setting(1.0, min=0.0)
        homed = 0

        @esair.operation
        async def home(self) -> None:
            self.homed += 1

        async def apply(self, **changes: float) -> None: ...

    lift = Lift("lift", safe=0.0)
    allow = Access.WRITE | Access.CONFIGURE
    policy = esair.Policy("lift", allow={"*": allow})
    async with esair.Robot(resources=[lift], policies=[policy]) as robot:
        mine = await robot.resources.register("me", "lift", allow)
        robot.halt("a test")
        with pytest.raises(esair.HaltedError, match="a test"):
            await robot.resources.operate(mine, "home")
        await robot.resources.configure(mine, speed=2.0)
        assert (lift.homed, lift.speed) == (0, 2.0)
        robot.resume()
        await robot.resources.operate(mine, "home")
        robot.resources.revoke(mine)
        with pytest.raises(esair.NotRegisteredError):
            await robot.resources.operate(mine, "home")
        assert lift.homed == 1


@pytest.mark.promise("RS-7", "AC-4")
async def test_an_operation_that_ends_at_once_is_followed_by_safe() -> None:
    """Who knows what it has moved, whether it failed or not."""

    class Lift(FakeActuator[float]):
        @esair.operation
        async def home(self) -> None:
            raise RuntimeError("it is stuck")

        @esair.operation
        async def zero(self) -> None: ...

    lift = Lift("lift", safe=0.0)
    allow = Access.WRITE | Access.CONFIGURE
    policy = esair.Policy("lift", allow={"*": allow})
    async with esair.Robot(resources=[lift], policies=[policy]) as robot:
        mine = await robot.resources.register("me", "lift", allow)
        with pytest.raises(esair.DeviceFaultError, match="stuck"):
            await robot.resources.operate(mine, "home")
        await asyncio.sleep(0.01)
        assert lift.commands == [0.0, 0.0]
        await robot.resources.operate(mine, "zero")
        await asyncio.sleep(0.01)
        assert lift.commands == [0.0, 0.0, 0.0]


# Devices.


@pytest.mark.promise("ROB-2")
async def test_a_lost_actuator_says_that_it_is_lost() -> None:
    """What it was told before says nothing any more."""
    motor = FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[motor]) as robot:
        assert robot.actuators.channels["motor"].told().answered
        motor.unplug()
        await asyncio.sleep(0.01)
        told = robot.actuators.channels["motor"].told()
        assert not told.answered
        assert "lost" in told.error


@pytest.mark.promise("AC-2", "SUP-3")
async def test_a_refusal_during_a_replacement_tells_since_when() -> None:
    """The moment at which the user has begun it."""

    class Slow(FakeActuator[float]):
        async def close(self) -> None:
            await asyncio.sleep(0.5)
            await super().close()

    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    old, new = Slow("motor", safe=0.0), FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[old], behaviors=[user]) as robot:
        await asyncio.sleep(1.0)
        replacing = asyncio.create_task(robot.resources.replace("motor", new))
        await asyncio.sleep(0.1)
        refused = await user.motor.write(1.0)
        assert refused.since == pytest.approx(1.0)
        await replacing
        assert await user.motor.write(1.0)


@pytest.mark.promise("RS-2")
async def test_nobody_asks_a_device_after_its_removal_whether_it_is_set_up() -> None:
    """Its watch over the set-up ends with it."""
    asked: list[float] = []

    class Motor(FakeActuator[float]):
        set_up_period = 0.5

        async def is_set_up(self) -> bool:
            asked.append(asyncio.get_running_loop().time())
            return await super().is_set_up()

    async with esair.Robot(resources=[Motor("motor", safe=0.0)]) as robot:
        await asyncio.sleep(1.2)
        assert len(asked) == 2
        await robot.resources.remove("motor")
        await asyncio.sleep(2.0)
        assert len(asked) == 2


@pytest.mark.promise("SC-3")
async def test_a_behavior_is_told_why_nobody_may_read_too_old() -> None:
    """The greatest age that a port is made with is checked like that of a read."""
    async with esair.Robot(resources=[FakeSensor("sonar", 1.0)]) as robot:
        right = await robot.resources.register("user", "sonar", Access.READ)
        for wrong in (0.0, -1.0, "1", True):
            with pytest.raises(esair.BadValueError, match="max_age"):
                robot.sensors.port(right, max_age=wrong)  # type: ignore[arg-type]


@pytest.mark.promise("AC-2")
async def test_a_device_that_is_back_owes_nothing_to_its_loss() -> None:
    """Its error is gone, and a halt that ends has it accept commands again."""
    motor = FakeActuator("motor", safe=0.0)
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        motor.unplug()
        await asyncio.sleep(0.1)
        halting = robot.halt("while it is lost")
        assert not halting.done()
        (told,) = await halting
        assert halting.done()
        assert not told.answered
        motor.plug()
        await asyncio.sleep(1.0)
        assert robot.resources.query("motor").error is None
        assert motor.commands == [0.0, 0.0]
        assert not await user.motor.write(1.0)
        robot.resume()
        assert await user.motor.write(1.0)


@pytest.mark.promise("SC-1")
@pytest.mark.parametrize("turns", range(6))
async def test_who_asks_in_the_instant_of_a_loss_asks_again_afterwards(
    turns: int,
) -> None:
    """The question that was about to be asked holds up none after it."""
    sonar = FakeSensor("sonar", 1.0)
    user: Any = esair.Behavior(name="user", reads={"sonar": esair.reads(float)})
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        sonar.unplug()
        for _ in range(turns):
            await asyncio.sleep(0)
        with pytest.raises(esair.DeviceLostError):
            await user.sonar.read(fresh=True)
        sonar.plug()
        await asyncio.sleep(1.0)
        assert await user.sonar.read(fresh=True) == 1.0


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize("turns", range(6))
async def test_a_device_that_goes_as_it_takes_safe_has_not_answered(turns: int) -> None:
    """Whatever comes first: it is lost, and nobody says that it is safe."""

    class Motor(FakeActuator[float]):
        goes = False

        async def write(self, command: float) -> None:
            await super().write(command)
            if self.goes:
                await asyncio.sleep(0.01)
                self.unplug()
                for _ in range(turns):
                    await asyncio.sleep(0)

    motor = Motor("motor", safe=0.0)
    async with esair.Robot(resources=[motor]) as robot:
        motor.goes = True
        robot.halt("a test")
        await asyncio.sleep(0.1)
        told = robot.actuators.channels["motor"].told()
        assert (told.answered, "lost" in told.error) == (False, True)
        motor.goes = False
        motor.plug()
        await asyncio.sleep(1.0)
        assert robot.actuators.channels["motor"].told().answered


@pytest.mark.promise("AC-1")
async def test_who_gives_up_waiting_for_safe_disturbs_nobody() -> None:
    """Those who wait on hear of its end."""
    motor = FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[motor]) as robot:
        channel = robot.actuators.channels["motor"]
        motor.slow(0.1)
        channel.make_safe()
        waiting = [asyncio.create_task(channel.safe.settled()) for _ in range(3)]
        await asyncio.sleep(0.05)
        waiting[0].cancel()
        before = asyncio.get_running_loop().time()
        await asyncio.wait(waiting)
        assert waiting[0].cancelled()
        assert asyncio.get_running_loop().time() - before == pytest.approx(0.05)


@pytest.mark.promise("AC-3")
async def test_a_driver_may_say_in_a_message_what_was_applied(fake_sensor: Any) -> None:
    """As one does that hands commands on to another robot."""

    class Far(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 60.0

        async def write(self, command: float) -> Any:
            return esair.Written(command / 2, command, "governor")

    user: Any = esair.Behavior(
        name="user",
        writes={"far": esair.writes(float)},
        reads={"applied": esair.reads(float, name="far.applied")},
    )
    async with esair.Robot(resources=[Far()], behaviors=[user]):
        assert (await user.far.write(1.0)).command == 0.5
        assert await user.applied.read() == 0.5


@pytest.mark.promise("RS-2")
async def test_who_registers_as_declared_has_the_same_right() -> None:
    """With the priority and the hold of the declaration, or those that it leaves out."""

    class User(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=3)

    user: Any = User()
    devices = FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=devices, behaviors=[user]):
        assert await user.sonar.read() == 1.0
        again = await user.register("sonar", Access.READ)
        assert again.registration is user.sonar.registration
        again = await user.register("wheels", Access.WRITE, priority=3)
        assert again.registration is user.wheels.registration
        other = await user.register("wheels", Access.WRITE)
        assert other.registration is not user.wheels.registration


# What people do, and what a sleep of the computer does.


@pytest.mark.promise("PRO-9", "PRO-10")
async def test_a_mute_and_a_reset_are_told() -> None:
    """Who looks later what people did finds them, with the reason."""

    class Shut(esair.Reaction):
        rate = 10.0
        wheels = esair.guards(float, latch=True)

        def react(self, wheels: float) -> None:
            """Let nothing pass."""

    seen: list[Event] = []
    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Shut()]) as robot:
        robot.journal.listen(seen.append, kinds=[Kind.OPERATOR])
        robot.behaviors.mute("shut", 20.0, "a trial")
        robot.behaviors.reset("shut")
        await turns()
    assert [(e.component, e.value, e.text) for e in seen] == [
        ("shut", 20.0, "mute: a trial"),
        ("shut", None, "reset"),
    ]


async def test_what_moved_before_the_computer_slept_is_made_safe() -> None:
    """At once, not when its last command times out."""

    class Drive(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await self.wheels.write(0.8)
            await asyncio.sleep(1000.0)

    wheels = FakeActuator("wheels", safe=0.0)
    wheels.command_timeout = 100.0
    async with esair.Robot(resources=[wheels], behaviors=[Drive()]) as robot:
        await wheels.until(0.8)
        robot._resources.resumed(60.0)
        await turns()
        assert wheels.commands[-1] == 0.0


@pytest.mark.promise("RS-4", "RS-7")
async def test_a_device_that_is_lost_takes_no_setting_and_no_operation() -> None:
    """Its driver is not asked, and nothing is remembered."""
    told: list[Any] = []

    class Lift(FakeActuator[float]):
        speed = esair.setting(1.0, min=0.0)

        @esair.operation
        async def home(self) -> None:
            told.append("home")

        async def apply(self, **changes: float) -> None:
            told.append(changes)

    lift = Lift("lift", safe=0.0)
    allow = Access.WRITE | Access.CONFIGURE
    policy = esair.Policy("lift", allow={"*": allow})
    async with esair.Robot(resources=[lift], policies=[policy]) as robot:
        mine = await robot.resources.register("me", "lift", allow)
        told.clear()
        lift.unplug()
        await asyncio.sleep(0.01)
        with pytest.raises(esair.DeviceLostError):
            await robot.resources.configure(mine, speed=2.0)
        with pytest.raises(esair.DeviceLostError):
            await robot.resources.operate(mine, "home")
        assert (told, lift.speed) == ([], 1.0)


@pytest.mark.promise("RS-2")
async def test_nobody_asks_a_lost_device_whether_it_is_set_up() -> None:
    """It is set up when it is opened again."""
    asked: list[bool] = []

    class Sonar(FakeSensor[float]):
        set_up_period = 0.5

        async def is_set_up(self) -> bool:
            asked.append(robot.resources.query("sonar").error is None)
            return True

    sonar = Sonar("sonar", 1.0)
    async with esair.Robot(resources=[sonar]) as robot:
        await asyncio.sleep(1.2)
        sonar.unplug()
        await asyncio.sleep(2.0)
        assert asked == [True, True]
        sonar.plug()
        await asyncio.sleep(2.0)
        assert len(asked) > 2
        assert all(asked)


async def test_only_what_is_open_and_watched_is_armed_again() -> None:
    """Not a sensor, nor what is lost: that is armed when it is opened."""
    armed: list[str] = []

    class Eye:
        def __init__(self, name: str) -> None:
            self.name = name

        async def arm(self) -> None:
            armed.append(self.name)

    parts = [FakeActuator(name, safe=0.0) for name in ("arm", "gone", "wheels")]
    async with esair.Robot(resources=[*parts, FakeSensor("eye", 1.0)]) as robot:
        lives = robot._resources.lives
        parts[1].unplug()
        await asyncio.sleep(0.01)
        for each in parts:
            lives[each.name].device.watch = Eye(each.name)  # type: ignore[assignment]
        await robot._resources.rearm()
        for each in parts:
            lives[each.name].device.watch = None
    assert armed == ["arm", "wheels"]


@pytest.mark.promise("GRD-1")
async def test_nothing_is_kept_of_a_halt_that_was_answered() -> None:
    """However many there were."""
    async with esair.Robot(resources=[FakeActuator("wheels", safe=0.0)]) as robot:
        for _ in range(5):
            await robot.halt("a test")
            robot.resume()
        await turns()
        kept = {each.get_name() for each in asyncio.all_tasks()}
        assert not any(name.startswith("halt ") for name in kept)
        assert not robot._halts._answers
