"""Behaviors exchange data by request, and each request has one outcome."""

from __future__ import annotations

import asyncio
import gc
import itertools
import math
import weakref
from typing import Any

import attrs
import pytest
from tests.supervisors.actors import Idle, seeds, soon

import esair
from esair.supervisors import Outcome
from esair.supervisors._mediator import REQUESTS_PER_SENDER
from esair.supervisors._requests import REQUESTS_PER_TARGET

pytestmark = pytest.mark.virtual_clock


@attrs.frozen
class Number(esair.Request[int]):
    """Some number."""

    number: int


class Small(Idle):
    """Takes one piece of data."""

    inbox_size = 1


class Maker(Idle):
    """Makes data on demand, after a while."""

    pause = 0.1
    made = 0

    async def provide(self) -> Any:
        await asyncio.sleep(self.pause)
        self.made += 1
        return self.made


class Crasher(Idle):
    """Crashes when it is told to."""

    restart = esair.Restart(max=1)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.crash = asyncio.Event()

    async def run(self) -> None:
        await self.crash.wait()
        self.crash.clear()
        raise RuntimeError("told to")


def outcomes(robot: esair.Robot) -> list[Outcome]:
    return [record.outcome for record in robot.behaviors.outcomes()]


@pytest.mark.promise("BS-1")
async def test_put_reaches_a_receiver_that_has_room() -> None:
    """Data is in the receiver's inbox when put returns, and it is the same object."""
    a, b = Idle(name="a"), Idle(name="b")
    data = ["wall"]
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", data)

        assert await b.receive() is data
        assert outcomes(robot) == [Outcome.DELIVERED]


@pytest.mark.promise("BS-1")
async def test_the_user_may_put_in_the_name_of_anybody() -> None:
    """The supervisor's put takes whole seconds too."""
    b = Idle(name="b")
    async with esair.Robot(behaviors=[b]) as robot:
        await robot.behaviors.put("wall", sender="user", receiver="b", interval=1)

        assert await b.receive() == "wall"


@pytest.mark.promise("BS-2")
async def test_put_waits_until_the_receiver_has_room() -> None:
    """A busy receiver is asked again until its state changes."""
    a, b = Idle(name="a"), Small(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        waiting = await soon(a.put("b", 2, interval=10.0))
        assert robot.behaviors.query("b").waiting == 1
        await asyncio.sleep(4.0)

        assert await b.receive() == 1
        await waiting
        assert loop.time() == pytest.approx(4.0, abs=0.01)
        assert await b.receive() == 2


@pytest.mark.promise("BS-2")
@pytest.mark.fault("M01")
async def test_put_gives_up_after_the_interval() -> None:
    """A receiver that stays busy costs the sender the interval and never sees it."""
    a, b = Idle(name="a"), Small(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        before = loop.time()
        with pytest.raises(esair.BehaviorUnavailableError, match=r"'b'.*running"):
            await a.put("b", 2, interval=3.0)

        assert loop.time() - before == pytest.approx(3.0)
        assert await b.receive() == 1
        assert robot.behaviors.query("b").can_receive
        assert outcomes(robot) == [Outcome.DELIVERED, Outcome.TIMED_OUT]


@pytest.mark.promise("BS-3")
async def test_get_takes_what_was_offered_in_order() -> None:
    """Each piece of offered data goes to one asker, the oldest first."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        b.offer(1)
        b.offer(2)

        assert await a.get("b") == 1
        assert await robot.behaviors.get(sender="b", receiver="a", interval=1) == 2
        assert not robot.behaviors.query("b").can_send


@pytest.mark.promise("BS-3")
@pytest.mark.fault("M19")
async def test_data_of_the_wrong_type_names_who_gave_it() -> None:
    """To who has said what it expects, of a get and of what was put."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        b.offer("red")
        with pytest.raises(esair.BadValueError, match="int from b"):
            await a.get("b", as_type=int)
        b.offer(3)
        assert await a.get("b", as_type=int) == 3
        for take in (a.receive, a.receive_from):
            await b.put("a", "red")
            with pytest.raises(esair.BadValueError, match="int from b"):
                await take(as_type=int)
            await b.put("a", 4)
            assert await take(as_type=int) in {4, ("b", 4)}


@pytest.mark.promise("BS-3")
async def test_get_waits_for_an_offer() -> None:
    """An offer that comes within the interval answers the get."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        waiting = await soon(a.get("b"))
        b.offer(None)

        assert await waiting is None


@pytest.mark.promise("BS-3")
async def test_get_has_data_made_on_demand() -> None:
    """A behavior with provide answers each get with data made for it."""
    a, b = Idle(name="a"), Maker(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        assert robot.behaviors.query("b").can_send
        assert [await a.get("b"), await a.get("b")] == [1, 2]


@pytest.mark.promise("BS-3")
async def test_get_has_data_made_by_a_plain_function() -> None:
    """A plain provide runs on a thread."""

    class Plain(Idle):
        def provide(self) -> str:
            return "made"

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Plain(name="b")]):
        assert await a.get("b") == "made"


@pytest.mark.promise("BS-3", "BS-2")
async def test_get_gives_up_after_the_interval() -> None:
    """A sender that has nothing costs the asker exactly the interval."""
    a, b = Idle(name="a"), Idle(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]):
        with pytest.raises(esair.BehaviorUnavailableError, match="send"):
            await a.get("b", interval=2.0)

        assert loop.time() == pytest.approx(2.0, abs=0.01)


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M02", "X04")
@pytest.mark.parametrize("seed", seeds)
@pytest.mark.parametrize("first", ["receive", "put"])
async def test_room_at_the_deadline_gives_both_sides_the_same_outcome(
    seed: int, first: str
) -> None:
    """What is taken exactly at the deadline is delivered, or it is not; never half."""
    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)

        async def take() -> Any:
            await asyncio.sleep(1.0)
            return await b.receive()

        works = {"receive": take, "put": lambda: a.put("b", 2, interval=1.0)}
        tasks = {name: asyncio.ensure_future(works.pop(name)()) for name in [first]}
        (other,) = works
        tasks[other] = asyncio.ensure_future(works[other]())
        await asyncio.wait(tasks.values())

        delivered = tasks["put"].exception() is None
        assert outcomes(robot)[-1] is (
            Outcome.DELIVERED if delivered else Outcome.TIMED_OUT
        )
        assert len(robot.behaviors.outcomes()) == 2
        got = await robot.behaviors.remove("b")
        assert got == ([2] if delivered else [])


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M03")
async def test_a_late_answer_is_dropped_and_counted() -> None:
    """Data made after its asker gave up is not handed to the next asker."""
    a, b = Idle(name="a"), Maker(name="b")
    b.pause = 1.0

    async def stubborn() -> Any:
        try:
            await asyncio.sleep(0.3)
        except asyncio.CancelledError:
            await asyncio.sleep(0.3)
        return "late"

    async with esair.Robot(behaviors=[a, b]) as robot:
        b.provide = stubborn  # type: ignore[method-assign]
        with pytest.raises(esair.BehaviorUnavailableError):
            await a.get("b", interval=0.1)

        async def soon_made() -> str:
            return "next"

        b.provide = soon_made  # type: ignore[method-assign]
        assert await a.get("b") == "next"
        assert robot._behaviors.mediator.late_answers == 1


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M18", "M14", "M15")
@pytest.mark.parametrize("seed", seeds)
async def test_order_from_one_sender_is_kept(seed: int) -> None:
    """Whatever the schedule, data arrives once, and in its sender's order."""
    a, c, b = Idle(name="a"), Idle(name="c"), Small(name="b")
    got: list[tuple[str, int]] = []
    async with esair.Robot(behaviors=[a, b, c]):

        async def send(who: esair.Behavior) -> None:
            for number in range(8):
                await who.put("b", (who.name, number), interval=60.0)

        async def take() -> None:
            while len(got) < 16:
                got.append(await b.receive())
                await asyncio.sleep(0.01)

        await asyncio.gather(send(a), send(c), take())

    for name in ("a", "c"):
        assert [n for who, n in got if who == name] == list(range(8))


@pytest.mark.promise("BS-4")
async def test_waiting_puts_of_one_sender_keep_their_order() -> None:
    """Puts from many tasks of one sender are delivered as they were asked for."""
    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]):
        puts = [await soon(a.put("b", n)) for n in range(5)]

        assert [await b.receive() for _ in range(5)] == list(range(5))
        await asyncio.gather(*puts)


@pytest.mark.promise("BS-7")
@pytest.mark.fault("M12")
async def test_senders_take_turns() -> None:
    """One who floods does not keep the others waiting."""
    flood, calm, b = Idle(name="flood"), Idle(name="calm"), Small(name="b")
    async with esair.Robot(behaviors=[flood, calm, b]):
        puts = [await soon(flood.put("b", ("flood", n))) for n in range(10)]
        puts.append(await soon(calm.put("b", ("calm", 0))))

        order = [(await b.receive())[0] for _ in range(11)]
        assert order.index("calm") <= 2
        await asyncio.gather(*puts)


@pytest.mark.promise("BS-5")
@pytest.mark.fault("M04", "M05")
@pytest.mark.parametrize("length", range(1, 9))
async def test_a_circle_of_get_is_refused_at_once(length: int) -> None:
    """The error names the whole circle, and no time has passed."""
    names = [f"n{i}" for i in range(length)]
    robots = {name: Idle(name=name) for name in names}
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=robots.values()) as robot:
        before = loop.time()
        waits = [
            await soon(robots[one].get(other))
            for one, other in itertools.pairwise(names)
        ]
        with pytest.raises(esair.CircularRequestError) as caught:
            await robots[names[-1]].get(names[0])

        assert loop.time() == before
        assert caught.value.path == (names[-1], *names)
        assert outcomes(robot) == [Outcome.REFUSED]
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)


@pytest.mark.promise("BS-5")
@pytest.mark.fault("M04")
async def test_everybody_on_a_circle_is_told_of_it() -> None:
    """Also whoever began it; one that only waits for the circle learns who failed."""

    class Asks(Idle):
        async def provide(self) -> Any:
            return await self.get("b" if self.name == "a" else "a")

    a, b, waits = Asks(name="a"), Asks(name="b"), Idle(name="waits")
    async with esair.Robot(behaviors=[a, b, waits]):
        with pytest.raises(esair.CircularRequestError) as caught:
            await a.get("b")
        assert caught.value.path == ("b", "a", "b")
        with pytest.raises(esair.BehaviorFailedError, match="a circle of requests"):
            await waits.get("b")


@pytest.mark.promise("BS-5")
async def test_two_ways_to_the_same_giver_are_no_circle() -> None:
    """Only a path that leads back to the asker is refused."""
    a, b, c, d = (Idle(name=name) for name in "abcd")
    async with esair.Robot(behaviors=[a, b, c, d]):
        waits = [
            await soon(b.get("c")),
            await soon(b.get("d")),
            await soon(c.get("d")),
            await soon(a.get("b")),
        ]
        d.offer(1)
        d.offer(2)
        c.offer(3)
        b.offer(4)
        assert sorted(await asyncio.gather(*waits)) == [1, 2, 3, 4]


@pytest.mark.promise("BS-5")
@pytest.mark.parametrize("seed", seeds)
async def test_an_answered_get_closes_no_circle(seed: int) -> None:
    """Who has just answered may ask back in the same tick."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):

        async def ask() -> None:
            a.offer(await a.get("b") + 1)

        asking = await soon(ask())
        b.offer(1)

        assert await b.get("a") == 2
        await asking


@pytest.mark.promise("BS-6")
async def test_query_answers_while_the_behavior_computes() -> None:
    """Query is a plain call: it needs nothing from whom it asks about."""
    a = Maker(name="a")
    async with esair.Robot(behaviors=[a]) as robot:
        getting = await soon(
            robot.behaviors.get(sender="a", receiver="user", interval=1.0)
        )
        status = robot.behaviors.query("a")

        assert status.state is esair.BehaviorState.RUNNING
        assert (status.can_receive, status.can_send) == (True, True)
        assert await getting == 1


@pytest.mark.promise("BS-7")
@pytest.mark.fault("M11")
async def test_requests_of_one_sender_are_bounded() -> None:
    """One more than the bound is refused at once, and the others still end well."""
    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", -1)
        puts = [await soon(a.put("b", n)) for n in range(REQUESTS_PER_SENDER)]
        with pytest.raises(esair.BusyError, match=r"'?a'?.*16"):
            await a.put("b", 99)
        with pytest.raises(esair.BusyError):
            await a.get("b")

        assert [await b.receive() for _ in range(17)] == [-1, *range(16)]
        await asyncio.gather(*puts)
        await a.put("b", 100)
        assert outcomes(robot).count(Outcome.REFUSED) == 2


@pytest.mark.promise("BS-7")
@pytest.mark.fault("M11")
async def test_requests_to_one_target_are_bounded() -> None:
    """However many senders there are, only so many wait for one behavior."""
    b = Small(name="b")
    senders = [Small(name=f"s{number}") for number in range(7)]
    async with esair.Robot(behaviors=[b, *senders]) as robot:
        put = robot.behaviors.put
        await put(-1, sender="user", receiver="b")
        puts = [
            await soon(put(n, sender=f"s{n // 10}", receiver="b"))
            for n in range(REQUESTS_PER_TARGET)
        ]
        with pytest.raises(esair.BusyError, match=r"b.*64"):
            await put(99, sender="user", receiver="b")
        got = [await b.receive() for _ in range(REQUESTS_PER_TARGET + 1)]
        assert sorted(got) == list(range(-1, REQUESTS_PER_TARGET))
        await asyncio.gather(*puts)


@pytest.mark.promise("BS-7")
@pytest.mark.fault("M11")
async def test_the_ledger_is_bounded() -> None:
    """Ten thousand requests leave only the newest outcomes behind."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        for number in range(10_000):
            await a.put("b", number)
            await b.receive()

        assert len(robot.behaviors.outcomes()) == 256
        assert robot._behaviors.mediator.delivered == 10_000


@pytest.mark.promise("BS-7")
@pytest.mark.fault("M13")
@pytest.mark.parametrize(
    ("policy", "left", "dropped"),
    [("drop_oldest", [2, 3], 2), ("latest", [2, 3], 2)],
)
async def test_a_full_inbox_follows_its_policy(
    policy: Any, left: list[int], dropped: int
) -> None:
    """What the policy drops is counted; nobody waits."""

    class Box(Idle):
        inbox_size = 2
        inbox_policy = policy

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Box(name="b")]) as robot:
        for number in range(4):
            await a.put("b", number)
        member = robot._behaviors.members["b"].mail

        assert member.dropped == dropped
        assert await robot.behaviors.remove("b") == left


@pytest.mark.promise("BS-7")
@pytest.mark.fault("M13")
async def test_a_full_outbox_refuses_by_default() -> None:
    """An offer beyond the bound raises, and what is there stays."""

    class Box(Idle):
        outbox_size = 2

    a, b = Idle(name="a"), Box(name="b")
    async with esair.Robot(behaviors=[a, b]):
        b.offer(1)
        b.offer(2)
        with pytest.raises(esair.BusyError, match="outbox_size"):
            b.offer(3)
        assert [await a.get("b"), await a.get("b")] == [1, 2]


@pytest.mark.promise("BS-7")
@pytest.mark.fault("M13")
@pytest.mark.parametrize(("policy", "left"), [("drop_oldest", [2, 3]), ("latest", [3])])
async def test_a_full_outbox_follows_its_policy(policy: Any, left: list[int]) -> None:
    """drop_oldest keeps the newest few, latest only the newest."""

    class Box(Idle):
        outbox_size = 2
        outbox_policy = policy

    a, b = Idle(name="a"), Box(name="b")
    async with esair.Robot(behaviors=[a, b]):
        for number in (1, 2, 3):
            b.offer(number)
        assert [await a.get("b") for _ in left] == left


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M07")
async def test_removal_of_the_peer_ends_every_request_at_once() -> None:
    """A put gets its data back; a get learns why; no time passes."""
    a, b = Idle(name="a"), Small(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", "taken back")
        put = await soon(a.put("b", "undelivered", interval=60.0))
        get = await soon(a.get("b", interval=60.0))
        before = loop.time()

        assert await robot.behaviors.remove("b") == ["taken back"]
        with pytest.raises(esair.BehaviorRemovedError) as caught:
            await put
        assert caught.value.data == "undelivered"
        with pytest.raises(esair.BehaviorRemovedError):
            await get
        assert loop.time() == before


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M07", "L12")
async def test_requests_to_a_behavior_that_is_being_removed_are_refused() -> None:
    """A removal that takes its grace period keeps nobody waiting."""

    class Slow(Small):
        async def teardown(self) -> None:
            await asyncio.sleep(0.5)

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Slow(name="b")]) as robot:
        await a.put("b", 1)
        put = await soon(a.put("b", 2, interval=60.0))
        before = loop.time()
        removing = await soon(robot.behaviors.remove("b"))
        with pytest.raises(esair.BehaviorRemovedError):
            await put
        with pytest.raises(esair.BehaviorRemovedError) as caught:
            await a.put("b", 3)

        assert caught.value.data == 3
        assert loop.time() == before
        assert await removing == [1]


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M08")
async def test_a_failing_provide_is_the_peers_failure() -> None:
    """The asker gets the cause; the peer goes on."""
    a, b = Idle(name="a"), Maker(name="b")

    async def broken() -> None:
        raise LookupError("no map")

    async with esair.Robot(behaviors=[a, b]) as robot:
        b.provide = broken  # type: ignore[method-assign]
        with pytest.raises(esair.BehaviorFailedError, match="no map") as caught:
            await a.get("b")

        assert isinstance(caught.value.__cause__, LookupError)
        assert robot.behaviors.query("b").state is esair.BehaviorState.RUNNING
        assert outcomes(robot) == [Outcome.PEER_FAILED]


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M09", "B02")
async def test_a_crash_of_the_peer_ends_what_waits_and_keeps_what_was_delivered() -> (
    None
):
    """Nothing that waited reaches the next run; what lay in the inbox does."""

    class Full(Crasher):
        inbox_size = 1

    a, b = Idle(name="a"), Full(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", "kept")
        put = await soon(a.put("b", "refused", interval=60.0))
        get = await soon(a.get("b", interval=60.0))
        b.crash.set()
        with pytest.raises(esair.BehaviorFailedError, match="told to"):
            await put
        with pytest.raises(esair.BehaviorFailedError):
            await get
        await asyncio.sleep(1.0)

        assert robot.behaviors.query("b").restarts == 1
        assert await b.receive() == "kept"
        assert robot.behaviors.query("b").can_receive


@pytest.mark.promise("BS-4", "SUP-4")
async def test_a_request_to_a_failed_behavior_fails_at_once() -> None:
    """Nobody waits for what will not come back."""
    a, b = Idle(name="a"), Crasher(name="b")
    b.restart = esair.Restart(max=0)
    async with esair.Robot(behaviors=[a, b]):
        b.crash.set()
        await asyncio.sleep(1.0)
        with pytest.raises(esair.BehaviorFailedError, match="told to"):
            await a.put("b", 1)


@pytest.mark.fault("M08", "B12")
async def test_a_provide_cancelled_before_its_first_step_blocks_no_other() -> None:
    """The asker is told at once, and the next get is answered as usual."""

    class Both(Crasher):
        async def provide(self) -> str:
            return "made"

    a, b = Idle(name="a"), Both(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        member = robot._behaviors.members["b"].mail
        get = asyncio.ensure_future(a.get("b"))
        await asyncio.sleep(0)
        assert member.askers.current is not None
        assert member.askers.current.worker is not None
        member.askers.current.worker.cancel()
        with pytest.raises(esair.BehaviorFailedError):
            await get

        assert await a.get("b") == "made"


@pytest.mark.fault("M10")
async def test_an_unknown_receiver_is_named_with_the_nearest_one() -> None:
    """A misspelt name is not a timeout."""
    a, b = Idle(name="a"), Idle(name="wander")
    async with esair.Robot(behaviors=[a, b]):
        with pytest.raises(esair.UnknownNameError, match="did you mean 'wander'"):
            await a.put("wandr", 1)
        with pytest.raises(esair.UnknownNameError):
            await a.get("nobody")


@pytest.mark.fault("M17")
@pytest.mark.parametrize(
    "interval", [0, 0.0, -1.0, math.nan, math.inf, 10**400, "1", None, True]
)
async def test_an_interval_must_be_a_number_of_seconds(interval: Any) -> None:
    """Anything but a finite number above 0 is refused, and nothing is left behind."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        with pytest.raises(esair.BadValueError, match="interval"):
            await a.put("b", 1, interval=interval)
        with pytest.raises(esair.BadValueError, match="interval"):
            await a.get("b", interval=interval)
        assert robot._behaviors.mediator.pending == 0


@pytest.mark.promise("BS-4")
@pytest.mark.fault("M20")
async def test_stopping_ends_every_request() -> None:
    """What waits when the robot stops gets StoppingError, and so does what comes."""
    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        put = await soon(
            robot.behaviors.put(2, sender="user", receiver="b", interval=60.0)
        )
        get = await soon(
            robot.behaviors.get(sender="b", receiver="user", interval=60.0)
        )
    for request in (put, get):
        with pytest.raises(esair.StoppingError):
            await request
    with pytest.raises(esair.StoppingError):
        await robot.behaviors.put(3, sender="user", receiver="b")
    assert outcomes(robot)[-2:] == [Outcome.STOPPING] * 2


@pytest.mark.fault("M20")
async def test_nothing_is_delivered_while_the_robot_stops() -> None:
    """Even a receiver with room gets nothing once the mediator has closed."""
    said: list[str] = []

    class Last(Idle):
        async def teardown(self) -> None:
            try:
                await robot.behaviors.put(1, sender="user", receiver="b")
            except esair.StoppingError:
                said.append("stopping")

    robot = esair.Robot(behaviors=[Idle(name="b"), Last(name="last")])
    async with robot:
        pass
    assert said == ["stopping"]


@pytest.mark.fault("M06")
async def test_two_who_put_to_each_other_do_not_wait_for_each_other() -> None:
    """A put waits for room in an inbox only, never for the other's work."""
    a, b = Small(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]):
        await asyncio.gather(a.put("b", 1), b.put("a", 2))

        assert [await a.receive(), await b.receive()] == [2, 1]


@pytest.mark.promise("BS-4")
@pytest.mark.fault("X02")
@pytest.mark.parametrize("seed", seeds)
async def test_a_receiver_cancelled_as_data_comes_leaves_it_to_the_next(
    seed: int,
) -> None:
    """The wake-up that a cancelled receive had is passed on."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        first, second = await soon(b.receive()), await soon(b.receive())
        await a.put("b", 1)
        first.cancel()

        assert await second == 1
        assert first.cancelled()


@pytest.mark.promise("BS-4")
@pytest.mark.fault("X01")
async def test_a_cancelled_put_is_withdrawn() -> None:
    """The receiver never sees it, and the next put is delivered as usual."""
    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        put = await soon(a.put("b", 2))
        put.cancel()
        await asyncio.wait({put})
        await b.receive()
        await a.put("b", 3)

        assert await b.receive() == 3
        assert Outcome.WITHDRAWN in outcomes(robot)


@pytest.mark.fault("M16", "B20")
@pytest.mark.parametrize("data", [lambda: 0, object(), None, b"x" * 10**6])
async def test_data_is_handed_over_untouched(data: Any) -> None:
    """In one process data passes by reference, whatever it is."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        await a.put("b", data)
        assert await b.receive() is data


@pytest.mark.promise("BS-2", "BS-3")
async def test_a_reaction_refuses_data_at_once() -> None:
    """It never has an inbox: nobody waits for one."""

    class Reflex(esair.Reaction):
        rate = 1.0

        def react(self) -> None: ...

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Reflex()]):
        before = loop.time()
        with pytest.raises(esair.RefusedError, match=r"'reflex'.*a reaction takes"):
            await a.put("reflex", 1)
        with pytest.raises(esair.RefusedError, match=r"'reflex'.*a reaction takes"):
            await a.get("reflex")
        assert loop.time() == before


@pytest.mark.promise("BS-2")
async def test_a_put_waits_for_a_behavior_that_is_being_set_up() -> None:
    """A receiver that starts is not ready; it gets the data when it runs."""

    class Slow(Idle):
        async def setup(self) -> None:
            await asyncio.sleep(0.5)

    a, b = Idle(name="a"), Slow(name="b")
    async with esair.Robot(behaviors=[a]) as robot:
        adding = await soon(robot.behaviors.add(b))
        put = await soon(a.put("b", 1))
        get = await soon(a.get("b"))
        assert not put.done()
        await adding
        await put
        b.offer(2)

        assert (await b.receive(), await get) == (1, 2)


async def test_a_failed_add_tells_those_who_wait_for_it() -> None:
    """Requests to a behavior whose setup fails end at once."""

    class Bad(Idle):
        async def setup(self) -> None:
            await asyncio.sleep(0.5)
            raise RuntimeError("no")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a]) as robot:
        adding = await soon(robot.behaviors.add(Bad(name="b")))
        put = await soon(a.put("b", 1, interval=60.0))
        with pytest.raises(esair.BehaviorFailedError, match="no"):
            await adding
        with pytest.raises(esair.BehaviorRemovedError):
            await put


@pytest.mark.fault("M02", "X04")
@pytest.mark.parametrize("early", [True, False])
async def test_an_offer_at_the_deadline_has_one_outcome(early: bool) -> None:
    """Both timers are due at once: the data is handed over or stays on offer."""
    a, b = Idle(name="a"), Idle(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]) as robot:
        due = loop.time() + 1.0
        if early:
            loop.call_at(due, b.offer, "data")
        get = await soon(robot.behaviors.get(sender="b", receiver="a"))
        if not early:
            loop.call_at(due, b.offer, "data")
        await asyncio.wait({get})

        assert len(robot.behaviors.outcomes()) == 1
        if get.exception() is None:
            assert not robot.behaviors.query("b").can_send
        else:
            assert await robot.behaviors.get(sender="b", receiver="a") == "data"


@pytest.mark.fault("X05")
async def test_an_offer_passes_by_who_has_just_been_cancelled() -> None:
    """The data waits for the next one who asks."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        get = await soon(a.get("b"))
        get.cancel()
        b.offer("data")
        assert await robot.behaviors.get(sender="b", receiver="user") == "data"
        await asyncio.wait({get})
        assert get.cancelled()


@pytest.mark.fault("X05")
@pytest.mark.parametrize("seed", seeds)
async def test_a_cancelled_request_to_a_removed_peer_has_one_outcome(seed: int) -> None:
    """Cancelled and removed in one tick: withdrawn, and nothing else."""
    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        put = await soon(a.put("b", 2))
        put.cancel()
        assert await robot.behaviors.remove("b") == [1]
        assert put.cancelled()
        assert outcomes(robot) == [Outcome.DELIVERED, Outcome.WITHDRAWN]


async def test_those_who_wait_for_data_get_it_one_each() -> None:
    """Two receives that wait are served by two puts."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        takers = [await soon(b.receive()) for _ in range(2)]
        await a.put("b", 1)
        await a.put("b", 2)
        assert await asyncio.gather(*takers) == [1, 2]


async def test_a_taker_that_was_overtaken_waits_on() -> None:
    """Data taken before a woken receive goes on is not delivered twice."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        takers = [await soon(b.receive()) for _ in range(2)]
        await a.put("b", 1)
        assert await b.receive() == 1
        await a.put("b", 2)
        await a.put("b", 3)
        assert sorted(await asyncio.gather(*takers)) == [2, 3]


@pytest.mark.promise("BS-4")
async def test_a_put_cancelled_in_the_instant_of_its_delivery_has_one_outcome() -> None:
    """It was delivered: the ledger does not say, too, that it was withdrawn."""
    a, b = Idle(name="a"), Small(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        waiting = await soon(a.put("b", 2))
        before = len(robot.behaviors.outcomes())
        assert await b.receive() == 1
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting

        last = robot.behaviors.outcomes()[before:]
        assert [each.outcome for each in last] == [Outcome.DELIVERED]


@pytest.mark.promise("BS-4")
async def test_who_asks_much_lets_others_have_their_turn() -> None:
    """Orders wait as puts and gets do: each asker has a turn, in the order it asked."""

    class Takes(Idle):
        orders = esair.takes(Number)

    a, b, worker = Idle(name="a"), Idle(name="b"), Takes(name="worker")
    async with esair.Robot(behaviors=[a, b, worker]):
        asked = [await soon(a.ask("worker", Number(n))) for n in range(3)]
        asked.append(await soon(b.ask("worker", Number(3))))
        got = []
        async for request in worker.orders:
            async with request:
                got.append(request.data.number)
                request.answer(0)
            if len(got) == 4:
                break
        await asyncio.gather(*asked)

        assert got == [0, 3, 1, 2]


@pytest.mark.promise("BS-9")
async def test_receive_gives_up_after_its_timeout() -> None:
    """It raises TimeoutError, and what comes later is not lost."""
    a, b = Idle(name="a"), Idle(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]):
        with pytest.raises(
            TimeoutError, match="'b' could not receive anything for 2 s"
        ):
            await b.receive(timeout=2.0)
        assert loop.time() == pytest.approx(2.0, abs=0.01)
        await a.put("b", "later")
        assert await b.receive(timeout=1) == "later"
        with pytest.raises(esair.BadValueError, match="timeout"):
            await b.receive(timeout=0)


@pytest.mark.promise("BS-9")
@pytest.mark.parametrize("seed", seeds)
async def test_what_comes_at_the_timeout_is_taken_or_waits(seed: int) -> None:
    """Nothing is lost between the two."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:

        async def put() -> None:
            await asyncio.sleep(1.0)
            await a.put("b", "data")

        putting = asyncio.ensure_future(put())
        try:
            got = [await b.receive(timeout=1.0)]
        except TimeoutError:
            got = []
        await putting
        assert got + await robot.behaviors.remove("b") == ["data"]


@pytest.mark.promise("BS-9")
async def test_receive_from_tells_who_has_put_it() -> None:
    """Also for what had to wait, and what a policy has dropped does not shift it."""

    class Box(Idle):
        inbox_size = 2
        inbox_policy = "drop_oldest"

    a, c, b, s = Idle(name="a"), Idle(name="c"), Box(name="b"), Small(name="s")
    async with esair.Robot(behaviors=[a, b, c, s]) as robot:
        for who, data in ((a, 1), (a, 2), (c, 3)):
            await who.put("b", data)
        assert robot.behaviors.query("b").dropped == 1
        assert await b.receive_from() == ("a", 2)
        assert await b.receive_from(timeout=1.0) == ("c", 3)
        waits = [await soon(who.put("s", who.name)) for who in (a, c)]
        assert [await s.receive_from() for _ in waits] == [("a", "a"), ("c", "c")]
        await asyncio.gather(*waits)


@pytest.mark.promise("BS-9")
async def test_the_latest_offer_may_be_got_again_and_again() -> None:
    """Everybody who waits gets it, and everybody later, until the next one."""
    a, c, b = Idle(name="a"), Idle(name="c"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b, c]) as robot:
        waits = [await soon(who.get("b")) for who in (a, c, a)]
        b.offer(1, latest=True)
        assert await asyncio.gather(*waits) == [1, 1, 1]
        assert [await a.get("b"), await c.get("b")] == [1, 1]
        assert robot.behaviors.query("b").can_send
        b.offer(2, latest=True)
        assert await a.get("b") == 2
        b.offer(3)
        assert await a.get("b") == 3
        assert not robot.behaviors.query("b").can_send


@pytest.mark.promise("BS-9")
@pytest.mark.parametrize("other", [True, False])
async def test_a_get_cancelled_in_the_instant_of_its_delivery_loses_nothing(
    other: bool,
) -> None:
    """The data goes to the next who waits, or is there for the next who asks."""
    a, c, b = Idle(name="a"), Idle(name="c"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b, c]) as robot:
        first = await soon(a.get("b"))
        second = await soon(c.get("b")) if other else None
        b.offer(1)
        b.offer(2)
        first.cancel()
        with pytest.raises(asyncio.CancelledError):
            await first
        got = [] if second is None else [await second]
        got.append(await a.get("b"))
        if second is None:
            got.append(await a.get("b"))
        assert sorted(got) == [1, 2]
        assert outcomes(robot).count(Outcome.WITHDRAWN) == 1
        assert outcomes(robot).count(Outcome.DELIVERED) == 2


@pytest.mark.promise("BS-9")
async def test_query_tells_how_many_requests_wait() -> None:
    """Those that were not taken yet, and those that are worked on."""

    class Order(esair.Request[None]):
        """A request."""

    class Worker(Idle):
        orders = esair.takes(Order)

        async def run(self) -> None:
            async for _ in self.orders:
                await asyncio.sleep(10.0)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Worker(name="b")]) as robot:
        asks = [await soon(a.ask("b", Order())) for _ in range(3)]
        status = robot.behaviors.query("b")
        assert (status.requests, status.working) == (2, 1)
        for ask in asks:
            ask.cancel()
        await asyncio.wait(asks)
        assert robot.behaviors.query("b").requests == 0


@pytest.mark.promise("BS-9")
@pytest.mark.parametrize("verb", ["put", "get"])
async def test_a_removed_askers_requests_end_whatever_task_made_them(verb: str) -> None:
    """Also a task that is not the behavior's own."""
    a, b = Idle(name="a"), Small(name="b")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, b]) as robot:
        await a.put("b", 1)
        work = a.put("b", 2, 60.0) if verb == "put" else a.get("b", 60.0)
        request = await soon(work)
        await robot.behaviors.remove("a")
        with pytest.raises(esair.BehaviorRemovedError, match="'a'"):
            await request
        assert loop.time() == 0.0
        assert robot._behaviors.mediator.pending == 0


@pytest.mark.promise("BS-5")
async def test_one_who_can_still_answer_closes_no_circle() -> None:
    """It follows the requests that an answer waits for, not names."""

    class Busy(Idle):
        async def run(self) -> None:
            self.asking = asyncio.ensure_future(self.get("b", 60.0))
            await asyncio.sleep(1.0)
            self.offer("from a")
            await self.asking

    a, b = Busy(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        await asyncio.sleep(0.5)
        assert await b.get("a") == "from a"
        b.offer("from b")
        await asyncio.sleep(0.1)


@pytest.mark.promise("BS-5")
async def test_one_who_provides_while_it_asks_closes_no_circle() -> None:
    """Its provide is free, whatever its run waits for."""

    class Provides(Idle):
        async def run(self) -> None:
            self.got = await self.get("b", 60.0)

        async def provide(self) -> str:
            return "made"

    a, b = Provides(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        await asyncio.sleep(0.1)
        assert await b.get("a") == "made"
        b.offer("x")
        await asyncio.sleep(0.1)
        assert a.got == "x"


@pytest.mark.promise("BS-5")
@pytest.mark.fault("M08")
async def test_foreign_errors_are_contained_in_the_mediator() -> None:
    """An error whose path or text raises ends its own request only."""

    class StrangeError(esair.CircularRequestError):
        def __init__(self) -> None:
            Exception.__init__(self)

        @property
        def path(self) -> Any:  # type: ignore[override]
            raise RuntimeError("no path")

        def __str__(self) -> str:
            raise SystemExit("no text")

    class Strange(Maker):
        async def provide(self) -> Any:
            if self.made:
                return "fine"
            self.made = 1
            raise StrangeError

    a = Idle(name="a")
    problems: list[Any] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _loop, context: problems.append(context))
    async with esair.Robot(behaviors=[a, Strange(name="b")]):
        with pytest.raises(esair.BehaviorFailedError, match="cannot be shown"):
            await a.get("b")
        assert await a.get("b") == "fine"
    assert problems == []


@pytest.mark.promise("BS-5")
@pytest.mark.parametrize("through", ["g", "h"])
async def test_one_whose_provide_waits_for_who_waits_for_it_closes_a_circle(
    through: str,
) -> None:
    """It makes one piece of data at a time, for whomever: the next one never comes."""
    told: list[Any] = []

    class Makes(Idle):
        async def provide(self) -> str:
            await asyncio.sleep(0.1)
            try:
                return str(await self.get("g", 60.0))
            except esair.CircularRequestError as error:
                told.append(error.path)
                return "made"

    x, g, h = Makes(name="x"), Idle(name="g"), Idle(name="h")
    async with esair.Robot(behaviors=[x, g, h]):
        first = asyncio.ensure_future((g if through == "g" else h).get("x", 60.0))
        await asyncio.sleep(0.05)
        second = asyncio.ensure_future(g.get("x", 60.0))
        assert [await first, await second] == ["made", "made"]
        assert told == [("x", "g", "x")] * 2


@pytest.mark.promise("BS-5")
@pytest.mark.real_clock
async def test_a_circle_of_get_through_threads_is_refused_at_once() -> None:
    """A thread that waits answers nobody; one with another thread still may."""
    told: list[object] = []

    class Gets(esair.ThreadBehavior):
        other = ""

        def run(self) -> None:
            try:
                told.append(self.get(self.other, 60.0))
            except esair.EsairError as error:
                told.append(error)

    a, b = Gets(name="a"), Gets(name="b")
    a.other, b.other = "b", "a"
    async with esair.Robot(behaviors=[a, b]):
        for _ in range(1000):
            if told:
                break
            await asyncio.sleep(0.005)
    assert isinstance(told[0], esair.CircularRequestError)


async def test_a_request_that_is_over_is_nothing_for_the_collector() -> None:
    """What was put, and had to wait, goes when nobody has it any more."""
    one, other = Idle(name="one"), Small(name="other")
    async with esair.Robot(behaviors=[one, other]):
        await one.put("other", 0)
        data = Number(1)
        gone = weakref.ref(data)
        gc.disable()
        try:
            waits = asyncio.create_task(one.put("other", data))
            await asyncio.sleep(0)
            assert await other.receive() == 0
            await waits
            assert await other.receive() is data
            del data, waits
            await asyncio.sleep(0)
            assert gone() is None
        finally:
            gc.enable()


@pytest.mark.promise("BS-4")
async def test_who_waits_for_its_inbox_is_woken_for_its_own_alone() -> None:
    """However many wait, each at its own."""
    members = [Idle(name=name) for name in "abc"]
    async with esair.Robot(behaviors=members) as robot:
        waiting = [await soon(each.receive()) for each in members]
        for name, task in zip("cba", reversed(waiting), strict=True):
            await robot.behaviors.put(name, sender="user", receiver=name)
            assert await asyncio.wait_for(task, 0.1) == name


@pytest.mark.promise("BS-6")
async def test_what_everybody_may_have_is_not_given_back() -> None:
    """Who is cancelled as it comes takes nothing from others, and leaves nothing."""
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b]):
        asking = await soon(a.get("b", 5.0))
        b.offer(1, latest=True)
        asking.cancel()
        await asyncio.wait({asking})
        assert asking.cancelled()
        b.offer(2)
        assert await a.get("b") == 2
