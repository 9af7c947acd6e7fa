"""What the supervisors count, keep and tell, each to the last one."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import attrs
import pytest
from tests.supervisors.actors import Idle, turns

import esair
from esair.buses import Bus
from esair.journal import Event, Journal, Kind
from esair.messages import BehaviorState
from esair.supervisors._life import Life
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("BS-3")
async def test_every_delivery_is_counted_once() -> None:
    """A put at once, one that waited, a get of what lies there, one that waited."""

    class Small(Idle):
        inbox_size = 1

    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        puts = asyncio.create_task(a.put("b", 2))
        await turns()
        await b.receive()
        await puts
        a.offer(3)
        assert await b.get("a") == 3
        waits = asyncio.create_task(b.get("a"))
        await turns()
        a.offer(4)
        assert await waits == 4
        assert robot.journal.counts()["behaviors"]["delivered"] == 4


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M13")
async def test_what_a_cancelled_asker_did_not_take_is_the_next_ones() -> None:
    """It was cancelled in the instant of its delivery: the oldest stays the first."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        waits = asyncio.create_task(a.get("b"))
        await turns()
        b.offer(1)
        b.offer(2)
        waits.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waits
        assert [await a.get("b"), await a.get("b")] == [1, 2]


@pytest.mark.promise("BS-4")
async def test_what_the_new_one_offers_answers_who_waits_once() -> None:
    """It has offered it in its set-up, before it took the place of the old one."""

    class Offers(Idle):
        async def setup(self) -> None:
            self.offer("new")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Idle(name="b")]) as robot:
        waits = asyncio.create_task(a.get("b", interval=5.0))
        await turns()
        await robot.behaviors.replace("b", Offers())
        assert await waits == "new"
        with pytest.raises(esair.BehaviorUnavailableError):
            await a.get("b", interval=0.1)


@attrs.frozen
class Fetch(esair.Request[int]):
    number: int


@pytest.mark.promise("BS-9")
async def test_orders_that_wait_are_the_new_ones_work() -> None:
    """It is woken for them, though it began to wait before it had any."""

    class Busy(esair.Behavior):
        orders = esair.takes(Fetch)

        async def run(self) -> None:
            await asyncio.sleep(1000)

    class Works(Busy):
        async def run(self) -> None:
            async for order in self.orders:
                async with order:
                    order.answer(order.number + 1)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Busy(name="b")]) as robot:
        waits = asyncio.create_task(a.ask("b", Fetch(1), timeout=5.0))
        await turns()
        await robot.behaviors.replace("b", Works())
        assert await waits == 2


@pytest.mark.promise("BS-1")
async def test_one_that_is_removed_is_stopping_until_it_has_ended() -> None:
    """Who asks meanwhile sees it, and who wants something of it is told."""
    seen: list[BehaviorState] = []

    class Slow(Idle):
        async def teardown(self) -> None:
            seen.append(robot.behaviors.query("slow").state)
            await asyncio.sleep(0.1)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Slow()]) as robot:
        removal = asyncio.create_task(robot.behaviors.remove("slow"))
        await asyncio.sleep(0.05)
        with pytest.raises(esair.BehaviorRemovedError):
            await a.put("slow", 1)
        await removal
    assert seen == [BehaviorState.STOPPING]


@pytest.mark.promise("RS-6")
@pytest.mark.fault("B02")
async def test_a_restart_that_was_asked_for_begins_with_a_full_budget() -> None:
    """Number, pauses and count, all three."""
    policy = esair.Restart(max=2, within=10.0, delay=0.5)
    budget = Life("any", policy, Journal())
    assert [budget.spend(0.0), budget.spend(1.0), budget.spend(2.0)] == [0.5, 4.0, None]
    assert budget.restarts == 2
    budget.fill()
    assert budget.restarts == 0
    assert [budget.spend(3.0), budget.spend(4.0), budget.spend(5.0)] == [0.5, 4.0, None]
    assert budget.spend(13.5) == 0.8 * 10.0 / 2  # the one of 4.0 still counts


@pytest.mark.promise("RS-3")
async def test_an_operation_whose_device_was_replaced_while_it_waited_is_told() -> None:
    """It waited for the device's settings; it is not done by the one that went."""
    done: list[str] = []

    class Lamp(FakeActuator[float]):
        power = esair.setting(0.5, min=0.0, max=2.0)

        def __init__(self, number: str) -> None:
            super().__init__("lamp", safe=0.0)
            self.number = number

        async def apply(self, *, power: float) -> None:
            await asyncio.sleep(0.5)

        @esair.operation
        async def blink(self) -> None:
            done.append(self.number)

    user: Any = esair.Behavior(
        name="user", writes={"lamp": esair.writes(float, configure=True)}
    )
    async with esair.Robot(resources=[Lamp("old")], behaviors=[user]) as robot:
        changes = asyncio.create_task(user.lamp.configure(power=1.0))
        await turns()
        blinks = asyncio.create_task(user.lamp.operate("blink"))
        await turns()
        await robot.resources.replace("lamp", Lamp("new"))
        results = await asyncio.gather(changes, blinks, return_exceptions=True)
        assert isinstance(results[1], esair.DeviceLostError)
        assert "old" not in done


@pytest.mark.promise("SUP-5")
async def test_the_journal_has_who_parks_and_who_runs_again() -> None:
    """With why."""

    class Drive(esair.Reaction):
        wheels = esair.writes(float)
        rate = 10.0

        def react(self) -> float:
            return 1.0

    events: list[Event] = []
    kinds = [Kind.PARKED, Kind.RUNNING]
    wheels = FakeActuator("wheels", safe=0.0)
    robot = esair.Robot(resources=[wheels], behaviors=[Drive()])
    robot.journal.listen(events.append, kinds=kinds)
    async with robot:
        await robot.resources.remove("wheels")
        await asyncio.sleep(0.1)
        await robot.resources.add(FakeActuator("wheels", safe=0.0))
        await asyncio.sleep(0.1)
    assert [each.kind for each in events] == [Kind.RUNNING, Kind.PARKED, Kind.RUNNING]
    assert "wheels" in events[1].text


@pytest.mark.promise("BS-3")
async def test_what_waits_and_what_was_dropped_is_counted() -> None:
    """Of each behavior, and in its status too."""

    class Newest(Idle):
        outbox_size = 2
        outbox_policy = "latest"
        inbox_size = 1

    a, b = Newest(name="a"), Newest(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        for n in range(3):
            a.offer(n)
        assert robot.behaviors.query("a").dropped == 2
        await a.put("b", 1)
        puts = [asyncio.create_task(a.put("b", n)) for n in (2, 3)]
        await turns()
        assert robot.journal.counts()["b"]["waiting"] == 2
        assert robot.behaviors.query("b").waiting == 2
        for n in (1, 2, 3):
            assert await b.receive() == n
        await asyncio.gather(*puts)
        assert robot.journal.counts()["b"]["waiting"] == 0


@pytest.mark.promise("BS-5")
async def test_the_usual_interval_of_a_request_is_a_second() -> None:
    """Of the user's too."""

    class Full(Idle):
        inbox_size = 1

    a, b = Idle(name="a"), Full(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 0)
        for request in (
            robot.behaviors.put(1, sender="a", receiver="b"),
            robot.behaviors.get(sender="b", receiver="a"),
            a.put("b", 1),
            a.get("b"),
        ):
            began = loop.time()
            with pytest.raises(esair.BehaviorUnavailableError):
                await request
            assert loop.time() - began == pytest.approx(1.0)


@pytest.mark.promise("BS-5")
async def test_requests_that_are_over_make_room_for_as_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of one asker that has others waiting all the time, and of all together."""
    monkeypatch.setattr("esair.supervisors._mediator.REQUESTS_PER_SENDER", 2)
    monkeypatch.setattr("esair.supervisors._mediator.REQUESTS", 3)
    a, b, c = Idle(name="a"), Idle(name="b"), Idle(name="c")
    async with esair.Robot(behaviors=[a, b, c]):
        waits = asyncio.create_task(a.get("c", 3600.0))
        await turns()
        for _ in range(5):
            with pytest.raises(esair.BehaviorUnavailableError):
                await a.get("b", 0.1)
        more = [asyncio.create_task(each.get("c", 3600.0)) for each in (a, b)]
        await turns()
        with pytest.raises(esair.BusyError, match="number of its requests"):
            await a.get("b")
        with pytest.raises(esair.BusyError, match="number of requests"):
            await b.get("a")
        for n in range(3):
            c.offer(n)
        assert sorted(await asyncio.gather(waits, *more)) == [0, 1, 2]


@pytest.mark.promise("SUP-5")
async def test_what_protects_nothing_is_not_muted_nor_reset() -> None:
    """Nor is a latch reset that nobody has."""

    class Watch(esair.Reaction):
        wheels = esair.guards(float)
        rate = 10.0

        def react(self, wheels: float) -> float:
            return wheels

    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[wheels], behaviors=[Idle(name="idle"), Watch()]
    ) as robot:
        for act in (
            lambda: robot.behaviors.mute("idle", 1.0, "why"),
            lambda: robot.behaviors.reset("idle"),
        ):
            with pytest.raises(esair.BadValueError, match="protects no actuator"):
                act()
        with pytest.raises(esair.BadValueError, match="it has no latch"):
            robot.behaviors.reset("watch")


@pytest.mark.promise("SUP-2")
async def test_a_replacement_whose_place_is_gone_protects_nothing() -> None:
    """The user takes the guard away while the new one has not decided yet."""

    class Guard(esair.Reaction):
        eye = esair.reads(float)
        wheels = esair.guards(float)

        def react(self, eye: float, wheels: float) -> float:
            return wheels

    class Other(Guard):
        eye = esair.reads(float, name="other")

    wheels = FakeActuator("wheels", safe=0.0)
    eyes: Any = (
        FakeSensor("eye", 1.0, rate=20.0),
        FakeSensor("other", type=float, rate=20.0),
    )
    async with esair.Robot(
        resources=[wheels, *eyes], behaviors=[Guard(name="guard")]
    ) as robot:
        await asyncio.sleep(0.2)
        replacing = asyncio.create_task(
            robot.behaviors.replace("guard", Other(name="guard"))
        )
        await asyncio.sleep(0.05)
        await robot.behaviors.remove("guard")
        with pytest.raises((esair.BehaviorRemovedError, esair.UnknownNameError)):
            await replacing
        assert robot.behaviors.names() == []
        assert not robot.actuators.channels["wheels"].guards.all


@pytest.mark.promise("SUP-1")
async def test_a_bus_that_does_not_close_is_named_and_holds_up_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The others are closed."""
    closed: list[str] = []

    class Wire(Bus):
        async def _open(self) -> None: ...

        async def _close(self) -> None:
            if self.name == "bad":
                raise OSError("jammed")
            closed.append(self.name)

    parts = [
        FakeActuator(name, safe=0.0, bus=Wire(name=name)) for name in ("bad", "good")
    ]
    async with esair.Robot(resources=parts) as robot:
        assert {each.name for each in robot.resources.buses} == {"bad", "good"}
        assert {"bus bad", "bus good"} <= robot.journal.counts().keys()
    assert closed == ["good"]
    assert any(
        "bad" in r.getMessage() and "jammed" in r.getMessage() for r in caplog.records
    )


@pytest.mark.promise("BS-5")
async def test_nothing_is_kept_of_requests_that_are_over() -> None:
    """Neither at who asked nor in the table of who waits for whom."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        for n in range(3):
            b.offer(n)
            assert await a.get("b") == n
            with pytest.raises(esair.BehaviorUnavailableError):
                await a.get("b", 0.1)
        assert not robot._behaviors.mediator.of_asker


@pytest.mark.long
@pytest.mark.promise("CALL-2")
async def test_who_waits_for_a_device_leaves_nothing_at_its_call() -> None:
    """However often it looks again."""
    motor = FakeActuator("motor", safe=0.0, command_timeout=100.0)
    motor.deadline = 100.0
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        motor.slow(50.0)
        writing = asyncio.create_task(user.motor.write(1.0))
        await turns()
        calls = robot.actuators.channels["motor"].calls
        (call,) = calls.alive.values()
        before = len(call.waiters)
        for _ in range(3):
            await calls.quiet(asyncio.get_running_loop().time() + 1.0)
        assert len(call.waiters) == before
        assert await writing


@pytest.mark.promise("GRD-1")
async def test_on_a_virtual_clock_nothing_is_watched() -> None:
    """A process whose clock jumps would be stopped for it."""
    motor = FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[motor], watchdog=True) as robot:
        assert robot._resources.armory is None
        assert robot._resources.lives["motor"].device.watch is None
    assert motor.commands == [0.0, 0.0]


@pytest.mark.promise("SUP-3")
@pytest.mark.parametrize("then", ["remove", "restart", "replace"])
async def test_of_two_commands_in_one_instant_the_second_finds_it_gone(
    then: str,
) -> None:
    """It waits for the removal before it, and is told so."""
    motor = FakeActuator("motor", safe=0.0)
    async with esair.Robot(resources=[motor]) as robot:
        resources = robot.resources
        second = {
            "remove": lambda: resources.remove("motor"),
            "restart": lambda: resources.restart("motor"),
            "replace": lambda: resources.replace(
                "motor", FakeActuator("motor", safe=0.0)
            ),
        }[then]
        done, told = await asyncio.gather(
            resources.remove("motor"), second(), return_exceptions=True
        )
        assert done is None
        assert isinstance(told, esair.UnknownNameError)
        assert resources.names() == []
        assert not motor.is_open


@pytest.mark.promise("TURN-5")
async def test_the_journal_has_what_is_handed_over_without_a_wait() -> None:
    """By whom, to whom, and what."""
    events: list[Event] = []
    a, b = Idle(name="a"), Idle(name="b")
    robot = esair.Robot(behaviors=[a, b])
    robot.journal.listen(events.append, kinds=[Kind.PUT, Kind.GOT])
    async with robot:
        await a.put("b", 1)
        a.offer(2)
        assert await b.get("a") == 2
        await turns()
    assert [(e.kind, e.component, e.peer, e.value) for e in events] == [
        (Kind.PUT, "b", "a", 1),
        (Kind.GOT, "b", "a", 2),
    ]


@pytest.mark.promise("SUP-5")
async def test_the_user_sees_what_a_behavior_is_and_takes() -> None:
    """By its name."""

    class Job(esair.Request[int]):
        pass

    class Worker(esair.Behavior):
        jobs = esair.takes(Job)

        async def run(self) -> None:
            async for job in self.jobs:
                job.answer(1)

    worker = Worker()
    async with esair.Robot(behaviors=[worker]) as robot:
        assert robot.behaviors.action("worker") is worker
        assert robot.behaviors.takes("worker") == (Job,)
        for ask in (robot.behaviors.action, robot.behaviors.takes):
            with pytest.raises(esair.UnknownNameError):
                ask("nobody")


@pytest.mark.promise("ROB-2")
async def test_a_device_that_takes_a_command_has_answered_again() -> None:
    """Whatever went wrong with the one before."""
    motor = FakeActuator("motor", safe=0.0)
    user: Any = esair.Behavior(name="user", writes={"motor": esair.writes(float)})
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        motor.fail(ValueError("brown-out"), times=1)
        with pytest.raises(esair.DeviceFaultError):
            await user.motor.write(1.0)
        assert not robot.actuators.channels["motor"].told().answered
        await user.motor.write(0.5)
        assert robot.actuators.channels["motor"].told().answered


@pytest.mark.promise("SUP-5")
async def test_a_behavior_is_starting_until_it_is_set_up() -> None:
    """When it is added, and when it is restarted."""
    seen: list[BehaviorState] = []

    class Looks(Idle):
        async def setup(self) -> None:
            await asyncio.sleep(0.1)
            seen.append(robot.behaviors.query("looks").state)

    async with esair.Robot() as robot:
        await robot.behaviors.add(Looks())
        await robot.behaviors.restart("looks")
        seen.append(robot.behaviors.query("looks").state)
    assert seen == [BehaviorState.STARTING] * 2 + [BehaviorState.RUNNING]


@pytest.mark.promise("ROB-4")
async def test_a_robot_that_starts_halted_is_halted_since_then() -> None:
    """On its own clock; before, it had none."""
    robot = esair.Robot(resources=[FakeActuator("motor", safe=0.0)])
    await asyncio.sleep(5.0)
    robot.halt("not yet")
    await asyncio.sleep(2.0)
    async with robot:
        assert robot.resources.why("motor").since == pytest.approx(7.0)


@pytest.mark.promise("RS-3")
async def test_settings_of_a_device_that_was_replaced_meanwhile_are_not_changed() -> (
    None
):
    """Who waited for their turn is told; the one in its place has its own."""

    class Lamp(FakeActuator[float]):
        power = esair.setting(0.5, min=0.0, max=2.0)

        async def apply(self, *, power: float) -> None:
            await asyncio.sleep(0.5)

    user: Any = esair.Behavior(
        name="user", writes={"lamp": esair.writes(float, configure=True)}
    )
    old, new = Lamp("lamp", safe=0.0), Lamp("lamp", safe=0.0)
    async with esair.Robot(resources=[old], behaviors=[user]) as robot:
        changes = [
            asyncio.create_task(user.lamp.configure(power=power))
            for power in (1.0, 2.0)
        ]
        await turns()
        await robot.resources.replace("lamp", new)
        for each in changes:
            with pytest.raises(esair.EsairError):
                await each
        assert (old.power, new.power) == (0.5, 0.5)
        await user.lamp.configure(power=2.0)
        assert new.power == 2.0


@pytest.mark.promise("BS-6")
async def test_one_that_has_done_nothing_yet_has_nothing_to_tell() -> None:
    """A behavior has no steps, and nothing that waits, is late or was dropped."""
    async with esair.Robot(behaviors=[Idle(name="a")]) as robot:
        await turns()
        assert robot.behaviors.query("a") == esair.BehaviorStatus(
            "a", BehaviorState.RUNNING, can_receive=True, can_send=False
        )


async def test_only_one_that_was_parked_is_said_to_run(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The log is for what changes: that all run after the start goes without saying."""
    caplog.set_level(logging.INFO, "esair")
    async with esair.Robot(behaviors=[Idle()]):
        await turns()
    assert "idle: runs" not in caplog.text


@pytest.mark.promise("RES-2", "SUP-4")
async def test_the_log_has_a_line_for_each_change(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Of a device that goes and comes back, and of who uses it; and no line beside."""
    caplog.set_level(logging.INFO, "esair")

    class Stop(esair.Reaction):
        sonar = esair.reads(float)
        wheels = esair.writes(float)
        rate = 20.0

        def react(self, sonar: float) -> float:
            return 0.5

    class Patrol(esair.Behavior):
        sonar = esair.reads(float)
        restart = esair.Restart(max=1, within=30.0)

        async def run(self) -> None:
            while True:
                await self.sonar.read()  # type: ignore[attr-defined]
                await asyncio.sleep(0.05)
                if sonar.reads > 30:
                    raise ValueError("enough")

    sonar, wheels = (
        FakeSensor("sonar", 1.0, rate=20.0),
        FakeActuator("wheels", safe=0.0),
    )
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Stop(), Patrol()]):
        for _ in range(2):
            await asyncio.sleep(0.5)
            sonar.unplug()
            await asyncio.sleep(0.5)
            sonar.plug()
        await asyncio.sleep(2.0)
    told: dict[str, list[str]] = {}
    for each in caplog.records:
        name, _, line = each.getMessage().partition(": ")
        told.setdefault(name, []).append(line)
    lost, parked = "it was unplugged", "parked: sonar is not there"
    assert told["sonar"] == [f"lost: device of 'sonar' is lost: {lost}", "back"] * 2
    assert told["stop"][:5] == ["runs", f"parked: sonar lost: {lost}"] * 2 + ["runs"]
    assert told["patrol"] == [
        *[parked, "goes on: sonar is back"] * 2,
        "failed: ValueError: enough; restart 1 in 0.1 s",
        "failed for good, 1 restarts did not help: ValueError: enough",
    ]


@pytest.mark.promise("TURN-4")
@pytest.mark.parametrize("verb", ["put", "get", "ask"])
async def test_who_is_refused_at_once_gives_way_too(verb: str) -> None:
    """A script that tries again without a pause does not have the loop for itself."""

    @attrs.frozen
    class Fetch(esair.Request[int]):
        pass

    async with esair.Robot() as robot:
        there = robot.behaviors
        other = asyncio.ensure_future(asyncio.sleep(0))
        for _ in range(10_000):
            request: Any
            if verb == "put":
                request = there.put(1, sender="user", receiver="nobody")
            elif verb == "get":
                request = there.get(sender="nobody", receiver="user")
            else:
                request = there.ask(Fetch(), sender="user", receiver="nobody")
            with pytest.raises(esair.UnknownNameError):
                await request
        assert other.done()


@pytest.mark.promise("SUP-4", "PRO-1")
async def test_the_journal_has_the_crash_and_what_its_behavior_waits_for() -> None:
    """What is not there is not its own fault; who is kept away by it hears the same."""

    class Watch(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float, priority=5, blind="safe")

        async def run(self) -> None:
            async for _ in esair.every(0.05):
                await self.sonar.read()

    events: list[Event] = []
    sonar, wheels = FakeSensor("sonar", 1.0), FakeActuator("wheels", safe=0.0)
    user = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    robot = esair.Robot(resources=[sonar, wheels], behaviors=[Watch(), user])
    robot.journal.listen(events.append, kinds=[Kind.CRASHED, Kind.PARKED])
    async with robot:
        assert await user.wheels.write(1.0)
        sonar.unplug()
        await asyncio.sleep(0.1)
        refused = await user.wheels.write(1.0)
        assert refused.rule == "watch is blind: sonar is not there"
        assert robot.behaviors.query("watch").restarts == 0
    assert [each.kind for each in events] == [Kind.CRASHED, Kind.PARKED]
    assert "'sonar' is lost" in events[0].text
    assert events[1].text == "sonar is not there"


@pytest.mark.promise("MODE-3")
async def test_a_query_tells_in_which_mode_one_that_rests_runs() -> None:
    """Not what it did before."""
    robot = esair.Robot(
        behaviors=[Idle(name="a"), Idle(name="b")],
        modes={"one": esair.Mode(["a"]), "two": esair.Mode(["b"])},
        mode="one",
    )
    async with robot:
        await robot.behaviors.switch("two")
        assert "one" in robot.behaviors.query("a").detail
        assert robot.behaviors.query("b").detail == ""


@pytest.mark.promise("BEH-3")
async def test_who_has_performed_is_forgotten_as_such() -> None:
    """Whether its last step ended well or not; who performs still is known."""

    class Short(esair.Behavior):
        async def run(self) -> None:
            await asyncio.sleep(1.0)
            raise RuntimeError("told to")

    captain = Idle(name="captain")
    async with esair.Robot(behaviors=[captain]) as robot:
        performed = asyncio.create_task(captain.perform(Short()))
        await asyncio.sleep(0.5)
        assert [each.name for each in robot._behaviors.performing] == ["captain"]
        with pytest.raises(RuntimeError):
            await performed
        assert not robot._behaviors.performing


@pytest.mark.promise("ROB-2")
async def test_the_resources_know_whether_the_stop_has_made_all_safe() -> None:
    """Safe wheels of a robot that runs are not that; who ends a stuck loop asks."""
    asked: list[bool] = []

    class Last(FakeActuator[float]):
        async def close(self) -> None:
            asked.append(robot._resources.is_made_safe())

    robot = esair.Robot(resources=[Last("wheels", safe=0.0)])
    async with robot:
        assert robot._resources.actuators.channels["wheels"].is_safe
        assert not robot._resources.is_made_safe()
    assert asked == [True]
