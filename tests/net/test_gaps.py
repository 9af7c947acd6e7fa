"""Nothing from before a gap, a pause or a restart ever moves anything."""

from __future__ import annotations

import asyncio
import contextlib
import random
from typing import Any

import pytest
from tests.net.parts import STILL, Dock, Docking, Hand, Pair, Twist

import esair
from esair import ResourceState
from esair.buses.peer import PeerBus
from esair.buses.peer._wire import Head, packed
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock

TIMEOUT = 0.2


class Driving(esair.Behavior):
    """Writes when it decided, fifty times a second, whatever becomes of it."""

    wheels = esair.writes(Twist, name="far_wheels")

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        self.answers: list[Any] = []
        while True:
            try:
                command = Twist(loop.time(), 1.0)
                self.answers.append(await self.wheels.write(command))
            except esair.EsairError as error:
                self.answers.append(error)
            await asyncio.sleep(0.02)


def listen(robot: esair.Robot) -> list[tuple[float, Any]]:
    """Keep when the wheels were told what."""
    sent: list[tuple[float, Any]] = []

    def heard(event: Any) -> None:
        if event.kind.value in {"sent", "safe"} and event.component == "wheels":
            sent.append((event.time, event.value))

    robot.journal.listen(heard)
    return sent


@pytest.mark.promise("NET-4", "NET-3")
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 30))]
)
async def test_cuts(seed: int) -> None:
    """Whatever is cut, for however long: no old command, safe in time, back by itself."""
    chance = random.Random(seed)
    pair = Pair(
        delay=chance.choice([0.0, 0.003, 0.03]), loss=chance.choice([0.0, 0.02])
    )
    loop = asyncio.get_running_loop()
    async with pair.both(Driving()) as (base, _):
        sent = listen(base)
        for _ in range(4):
            await asyncio.sleep(0.5)
            begin = loop.time()
            pair.network.cut(*chance.choice([(), ("base",), ("rover",)]), keep=True)
            length = 0.1 * 100 ** chance.random()
            await asyncio.sleep(length)
            if length > TIMEOUT + 0.1:
                assert base.resources.query("wheels")
                assert sent[-1][1] == STILL
                # What is lost comes 0.2 s late, also into the cut; it may still be good.
                late = pair.network.delay + (0.2 if pair.network.loss else 0.0)
                assert sent[-1][0] <= begin + TIMEOUT + 0.05 + late
            healed = loop.time()
            pair.network.heal()
            # Where much is lost, and sent again, it takes as long as it takes.
            for _ in range(20 if pair.network.loss else 1):
                await asyncio.sleep(0.6)
                fresh = [at for at, told in sent if at > healed and told != STILL]
                if fresh:
                    break
            assert fresh
            assert fresh[0] - healed < 0.5 or pair.network.loss
        old = [at - told.linear for at, told in sent if told != STILL]
        assert len(old) > 20
        assert max(old) <= TIMEOUT + pair.network.delay + 0.001


@pytest.mark.promise("NET-3", "NET-6")
@pytest.mark.parametrize("largest", [1 << 60, (1 << 62) - 1])
@pytest.mark.parametrize("field", ["beat", "echo"])
async def test_a_number_that_was_never_sent_ends_no_conversation(
    field: str, largest: int
) -> None:
    """It is larger than any that comes: whose number it is begins another run."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (_base, rover):
        bus = pair.to_rover
        head = Head(bus._its_run, bus._its_beat, bus._run, bus._beats, 0.0)
        said = packed(head._replace(**{field: largest}), (), bus.kinds)
        pair.network.inject("rover", "base", "beat", said)
        await asyncio.sleep(3.0)
        for name in ("base", "far_wheels"):
            state = rover.resources.query(name).state
            assert state is esair.ResourceState.READY, name
        assert await hand.wheels.write(Twist(0.2, 0.0))
        assert pair.wheels.commands[-1] == Twist(0.2, 0.0)


@pytest.mark.promise("NET-3", "NET-6")
@pytest.mark.parametrize("what", ["beat", "bye"])
async def test_a_message_of_a_run_long_over_loses_nobody(what: str) -> None:
    """It comes late, and this run has never heard of that one: it echoes nothing of now."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (_base, rover):
        for echoed in (0, 99):
            old = packed(
                Head(77, 500, echoed, 3 * echoed, 0.0), (), pair.to_rover.kinds
            )
            pair.network.inject("base", "rover", what, old)
            await asyncio.sleep(0.0)
            assert await hand.wheels.write(Twist(0.2, 0.0))
        await asyncio.sleep(1.5)
        assert rover.resources.query("far_wheels").losses == 0


@pytest.mark.promise("NET-3", "NET-6")
async def test_who_takes_each_other_for_over_meet_again() -> None:
    """A second pair of the same two names was heard by both, and has gone."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        for to, sender, bus in (
            ("base", "rover", pair.to_rover),
            ("rover", "base", pair.to_base),
        ):
            head = Head(77, 1, bus._run, bus._beats, 0.0)
            pair.network.inject(sender, to, "beat", packed(head, (), bus.kinds))
        await asyncio.sleep(3.0)
        assert await hand.wheels.write(Twist(0.2, 0.0))
        assert pair.wheels.commands[-1] == Twist(0.2, 0.0)


@pytest.mark.promise("NET-4")
async def test_the_owner_refuses_by_its_own_clock() -> None:
    """A command whose beat is old, of another run, or none at all moves nothing."""
    pair = Pair()
    async with pair.both() as (_base, _):
        bus, loop = pair.to_rover, asyncio.get_running_loop()
        run, mine, newest = bus._its_run, bus._run, bus._beats

        async def told(echo_run: int, echo: int) -> int:
            head = Head(run, bus._its_beat, echo_run, echo, 0.0)
            data = packed(head, (1, "wheels", Twist(0.5, 0.0)), bus.kinds)
            before = len(pair.wheels.commands)
            pair.network.inject("rover", "base", "write", data)
            await asyncio.sleep(0.01)
            return len(pair.wheels.commands) - before

        assert await told(mine, newest) == 1
        await asyncio.sleep(TIMEOUT + 0.06)  # the dead man
        refused = bus.stats.refused
        assert await told(mine, newest) == 0  # it was good, and is too old now
        assert await told(mine + 1, bus._beats) == 0
        assert await told(mine, bus._beats + 5) == 0
        assert bus.stats.refused == refused + 3
        assert loop.time() > 0


@pytest.mark.promise("NET-4")
async def test_what_was_overtaken_moves_nothing() -> None:
    """A command that comes by another way, later than what was said after it."""
    pair = Pair()
    async with pair.both():
        bus = pair.to_rover
        for behind, moved in ((1, 0), (0, 1)):
            head = Head(bus._its_run, bus._its_beat - behind, bus._run, bus._beats, 0.0)
            data = packed(head, (1, "wheels", Twist(0.5, 0.0)), bus.kinds)
            pair.network.inject("rover", "base", "write", data)
            await asyncio.sleep(0.01)
            assert len(pair.wheels.commands) - 1 == moved


@pytest.mark.promise("NET-3", "NET-4")
async def test_what_comes_twice_is_taken_once() -> None:
    """While a peer was silent everything is said on all ways: the first copy counts."""
    pair = Pair()
    async with pair.both():
        bus, late = pair.to_rover, pair.to_rover.stats.late
        pair.docking.go.set()
        for what, part in (("ask", Dock(7)), ("write", Twist(0.5, 0.0))):
            name = "docking" if what == "ask" else "wheels"
            head = Head(bus._its_run, bus._its_beat, bus._run, bus._beats, 0.0)
            data = packed(head, (1, name, part), bus.kinds)
            for _ in range(3):
                pair.network.inject("rover", "base", what, data)
                await asyncio.sleep(0.01)
        assert pair.docking.begun == [7]
        assert pair.wheels.commands.count(Twist(0.5, 0.0)) == 1
        assert bus.stats.late == late + 4


@pytest.mark.promise("NET-2")
async def test_a_reading_that_was_overtaken_is_not_the_newest() -> None:
    """Within one beat, too: two connections carry it, and the later one comes first."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        bus = pair.to_rover
        head = Head(bus._run, bus._beats, bus._its_run, bus._its_beat, 0.0)
        late = pair.to_base.stats.late
        for held, value in ((0.9, 2.0), (0.8, 1.5)):
            parts = "sonar", 0.0, value
            said = packed(head._replace(held=held), parts, bus.kinds)
            pair.network.inject("base", "rover", "reading", said)
        await asyncio.sleep(0.001)
        assert await hand.sonar.read() == 2.0
        assert pair.to_base.stats.late == late + 1


@pytest.mark.promise("NET-4")
async def test_what_waits_behind_a_write_does_not_leave_after_a_gap() -> None:
    """A second command waits while the first has no answer; a gap ends both."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, _rover):
        sent = listen(base)
        pair.network.cut("base", keep=True)
        first = asyncio.ensure_future(hand.wheels.write(Twist(0.1, 0.0)))
        await asyncio.sleep(0.01)
        second = asyncio.ensure_future(hand.wheels.write(Twist(0.2, 0.0)))
        await asyncio.sleep(0.4)  # less than what makes the peer lost
        pair.network.heal()
        done = await asyncio.gather(first, second, return_exceptions=True)

        assert not any(isinstance(each, esair.Written) for each in done), done
        await asyncio.sleep(0.5)
        assert [told for _, told in sent if told != STILL] == []
        assert await hand.wheels.write(Twist(0.3, 0.0))


@pytest.mark.promise("NET-3", "NET-4")
async def test_a_gap_refuses_and_loses_nothing() -> None:
    """What is written into it is refused, at the latest by command_timeout; then it is over."""
    pair, hand, loop = Pair(), Hand(), asyncio.get_running_loop()
    async with pair.both(hand) as (_base, rover):
        await asyncio.sleep(0.1)
        pair.network.cut("base", keep=True)
        begin = loop.time()
        for _ in range(3):
            refused = await hand.wheels.write(Twist(0.1, 0.0))
            assert isinstance(refused, esair.Refused)
            assert (refused.holder, "no answer" in refused.rule) == ("base", True)
            assert loop.time() - begin <= TIMEOUT + 0.001
            begin = loop.time()
        await asyncio.sleep(0.2)
        pair.network.heal()
        await asyncio.sleep(0.15)  # two beats
        assert await hand.wheels.write(Twist(0.2, 0.0))
        assert rover.resources.query("far_wheels").losses == 0
    assert Twist(0.1, 0.0) not in pair.wheels.commands


@pytest.mark.promise("NET-4")
async def test_what_was_decided_before_the_gap_was_noticed_is_refused() -> None:
    """The program that uses a peer was stopped amid a turn: it goes on with old commands."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        pair.network.cut("base", keep=True)
        await asyncio.sleep(0.4)
        pair.network.heal()
        for _ in range(2):
            assert not await hand.wheels.write(Twist(0.1, 0.0))
            await asyncio.sleep(0.02)
        await asyncio.sleep(0.1)
        assert await hand.wheels.write(Twist(0.2, 0.0))
    assert Twist(0.1, 0.0) not in pair.wheels.commands


@pytest.mark.promise("NET-4")
async def test_what_was_sent_before_the_owner_slept_moves_nothing() -> None:
    """Its clock stood still meanwhile: what the network kept seems to be of just now."""
    pair, hand, loop = Pair(), Hand(), asyncio.get_running_loop()
    async with pair.both(hand):
        assert await hand.wheels.write(Twist(0.1, 0.0))
        pair.network.cut("base", keep=True)
        writing = asyncio.ensure_future(hand.wheels.write(Twist(0.2, 0.0)))
        await asyncio.sleep(0.02)
        loop.suspend(3600.0)  # type: ignore[attr-defined]
        await asyncio.sleep(0.01)
        pair.network.heal()
        await asyncio.sleep(0.2)
        assert Twist(0.2, 0.0) not in pair.wheels.commands
        assert not await writing
        await asyncio.sleep(0.5)
        assert await hand.wheels.write(Twist(0.3, 0.0))


@pytest.mark.promise("NET-4")
async def test_the_owner_was_stopped_amid_a_turn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A command that was fresh when the turn began is judged by the clock itself."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        monkeypatch.setattr(
            "esair.connections._gate.clock_beside",
            lambda loop: lambda: loop.time() + 0.3,
        )
        refused = await hand.wheels.write(Twist(0.1, 0.0))
        assert isinstance(refused, esair.Refused)
        assert "expired" in refused.rule
    assert Twist(0.1, 0.0) not in pair.wheels.commands


@pytest.mark.promise("NET-4")
async def test_the_owner_was_stopped_amid_a_check(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The clock is looked at last: a command that was fresh before its check is not now."""
    pair, hand, stopped = Pair(), Hand(), [0.0]
    async with pair.both(hand) as (base, _):
        monkeypatch.setattr(
            "esair.connections._gate.clock_beside",
            lambda loop: lambda: loop.time() + stopped[0],
        )
        channel = base.actuators.channels["wheels"]
        checked = channel.checked

        def slowly(command: Any) -> Any:
            stopped[0] = 0.3
            return checked(command)

        channel.checked = slowly
        refused = await hand.wheels.write(Twist(0.1, 0.0))
        assert isinstance(refused, esair.Refused)
        assert "expired" in refused.rule
    assert Twist(0.1, 0.0) not in pair.wheels.commands


@pytest.mark.promise("NET-3")
async def test_a_peer_that_is_back_is_not_waited_for_long_again() -> None:
    """What an opening meets right after a long cut does not make the next pause long."""
    pair, driving, loop = Pair(delay=0.01), Driving(), asyncio.get_running_loop()
    async with pair.both(driving) as (base, rover):
        sent = listen(base)
        pair.network.cut("base")
        await asyncio.sleep(20.0)
        pair.network.heal()
        await pair.to_base._alive.wait()
        pair.network.cut("base")  # before the wheels are let go there
        await asyncio.sleep(0.7)
        healed = loop.time()
        pair.network.heal()
        await asyncio.sleep(0.5)
        assert [at for at, told in sent if at > healed and told != STILL]
        state = rover.resources.query("far_sonar").state
        assert state is esair.ResourceState.READY


@pytest.mark.promise("NET-3")
async def test_the_first_beat_after_a_gap_is_answered_at_once() -> None:
    """Who hears the other one again says so: nobody waits for a beat that is due later."""
    pair, loop = Pair(delay=0.001), asyncio.get_running_loop()
    async with pair.base():
        await asyncio.sleep(0.021)
        async with pair.rover():
            await asyncio.sleep(0.3)
            pair.network.cut()
            await asyncio.sleep(2.0)
            pair.network.heal()
            said = len(pair.network.log)
            for _ in range(60):
                if len(pair.network.log) > said:
                    break
                await asyncio.sleep(0.001)
            begin = loop.time()
            await asyncio.gather(
                pair.to_base._alive.wait(), pair.to_rover._alive.wait()
            )
            assert loop.time() - begin < 0.01


@pytest.mark.promise("NET-3")
async def test_a_lost_peer_is_known_in_time_and_comes_back() -> None:
    """Its parts are LOST within 1.3 s of its silence, and READY again by themselves."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (_base, rover):
        pair.sonar.feed(0.7)
        await asyncio.sleep(0.1)
        pair.network.cut("base")
        await asyncio.sleep(1.3)
        for name in ("base", "far_sonar", "far_wheels"):
            state = rover.resources.query(name).state
            assert state is not esair.ResourceState.READY, name
        with pytest.raises(esair.DeviceLostError, match="no echo"):
            await hand.sonar.read()
        await asyncio.sleep(10.0)
        pair.network.heal()
        await asyncio.sleep(0.3)
        for name in ("base", "far_sonar", "far_wheels"):
            state = rover.resources.query(name).state
            assert state is esair.ResourceState.READY, name
        assert await hand.sonar.read() == 0.7


@pytest.mark.promise("NET-3")
async def test_a_way_in_one_direction_is_none() -> None:
    """A peer that is heard, and hears nothing, is not there; nor does it stay there."""
    pair = Pair()
    pair.network.deaf.add("base")
    async with pair.base(), pair.rover() as rover:
        for _ in range(2):
            await asyncio.sleep(1.3)
            for name in ("base", "far_wheels"):
                state = rover.resources.query(name).state
                assert state is not esair.ResourceState.READY
            pair.network.deaf.clear()
            await asyncio.sleep(0.3)
            state = rover.resources.query("far_wheels").state
            assert state is esair.ResourceState.READY
            pair.network.deaf.add("base")


@pytest.mark.promise("NET-4", "NET-3")
async def test_a_restarted_owner_moves_by_nothing_from_before() -> None:
    """The user stays; the owner is another run, and hears fresh commands alone."""
    pair, driving = Pair(), Driving()
    async with pair.rover(driving):
        async with pair.base():
            await asyncio.sleep(1.0)
        again = Pair()
        again.network = pair.network
        again.to_rover = PeerBus(name="rover", network=pair.network.of("base"))
        again.to_rover.declare(Twist)
        base = again.base()
        async with base:
            sent = listen(base)
            await asyncio.sleep(1.0)
            moved = [(at, told) for at, told in sent if told != STILL]
            assert moved
            assert max(at - told.linear for at, told in moved) < TIMEOUT


@pytest.mark.promise("NET-3", "NET-4")
async def test_a_second_robot_of_one_name_shuts_the_first_out_for_its_time(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Both sides say what is wrong; the one that stays is heard again, and drives."""
    pair, driving = Pair(), Driving()

    def say(what: str, beat: int) -> None:
        bus = pair.to_rover
        head = Head(77, beat, bus._run, bus._beats, 0.0)
        pair.network.inject("rover", "base", what, packed(head, (), bus.kinds))

    async with pair.both(driving) as (base, rover):
        sent = listen(base)
        for beat in range(1, 41):
            say("beat", beat)
            await asyncio.sleep(0.05)
        assert "another robot of the name 'rover'" in str(rover.resources.query("base"))
        told = [each for each in caplog.messages if "two robots have this name" in each]
        assert len(told) == 1
        say("bye", 41)
        ended = asyncio.get_running_loop().time()
        await asyncio.sleep(0.5)
        moved = [told for at, told in sent if at > ended and told != STILL]
        assert moved
        assert min(each.linear for each in moved) >= ended


@pytest.mark.promise("NET-4")
async def test_no_command_is_older_than_a_loss_of_its_peer() -> None:
    """However long the owner's time-out is: what waited through a gap moves nothing."""
    pair, driving = Pair(), Driving()
    pair.wheels = FakeActuator("wheels", safe=STILL, command_timeout=5.0)
    async with pair.both(driving) as (base, _):
        sent = listen(base)
        await asyncio.sleep(0.2)
        pair.network.cut(keep=True)
        beating = pair.to_rover._beating
        assert beating is not None
        beating.cancel()  # the owner is stopped: it has not noticed a loss when it goes on
        await asyncio.sleep(1.2)
        pair.network.heal()
        await asyncio.sleep(0.1)
        moved = [(at, told) for at, told in sent if told != STILL]
        assert moved
        assert max(at - told.linear for at, told in moved) < 1.0


class Measuring(esair.Sensor[float]):
    """Measures when it does so."""

    async def read(self) -> float:
        return asyncio.get_running_loop().time()


@pytest.mark.promise("NET-2")
@pytest.mark.parametrize("delay", [0.0, 0.05, 0.3])
async def test_no_reading_is_called_younger_than_it_is(delay: float) -> None:
    """Its time is never after its measurement; on a quick way it is hardly before it."""
    pair, hand = Pair(delay=delay), Hand()
    pair.sonar = Measuring(name="sonar", rate=27.0)
    async with pair.both(hand):
        await asyncio.sleep(2.0)
        for _ in range(20):
            await asyncio.sleep(0.0371 + delay)
            reading = await hand.sonar.reading(max_age=60.0)
            assert reading.time <= reading.value + 1e-9
            assert reading.value - reading.time <= delay + 1e-3


@pytest.mark.promise("NET-3")
async def test_a_request_whose_answer_is_lost_is_not_known() -> None:
    """It may have been done: it ends by a name of its own, and is not done twice."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        asked = asyncio.ensure_future(hand.ask("far_docking", Dock(2), timeout=None))
        await asyncio.sleep(0.1)
        pair.network.cut("base")
        with pytest.raises(esair.OutcomeUnknownError, match="far_docking"):
            await asked
        await asyncio.sleep(0.3)
        assert pair.docking.cancelled == 1  # who asked is gone
        with pytest.raises(esair.RefusedError, match="not there"):
            await hand.ask("far_docking", Dock(3))
        pair.network.heal()
        pair.docking.go.set()
        await asyncio.sleep(1.0)
        assert await hand.ask("far_docking", Dock(4))
        assert pair.docking.begun == [2, 4]


@pytest.mark.promise("NET-3")
@pytest.mark.parametrize("way", ["ask", "answer"])
async def test_a_message_that_is_lost_without_a_gap_ends_its_request(way: str) -> None:
    """A connection is made anew within a second: what was on it is not known."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        if way == "ask":
            pair.network.cut("base")
        asked = asyncio.ensure_future(hand.ask("far_docking", Dock(2), timeout=None))
        await asyncio.sleep(0.1)
        pair.network.cut("base")
        pair.docking.go.set()
        await asyncio.sleep(0.3)
        pair.network.heal()
        async with asyncio.timeout(1.5):
            with pytest.raises(esair.OutcomeUnknownError, match="not known there"):
                await asked
        assert pair.docking.begun == ([2] if way == "answer" else [])
        assert await hand.ask("far_docking", Dock(3))


async def test_each_request_has_its_one_outcome() -> None:
    """Answered, refused, failed; withdrawn ends the work there."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        with pytest.raises(esair.BehaviorUnavailableError):
            await hand.ask("far_docking", Dock(1), timeout=0.2)
        await asyncio.sleep(0.05)
        assert pair.docking.cancelled == 1
        pair.docking.go.set()
        with pytest.raises(esair.RefusedError, match="no such bay"):
            await hand.ask("far_docking", Dock(-1))
        told = r"^behavior 'far_docking' failed: ValueError: bay 0$"
        with pytest.raises(esair.BehaviorFailedError, match=told):
            await hand.ask("far_docking", Dock(0))
        assert pair.docking.begun == [1, -1, 0]


@pytest.mark.promise("BS-10", "NET-2")
@pytest.mark.parametrize("act", ["remove", "replace"])
async def test_a_worker_that_is_taken_away_there_is_told_as_removed(act: str) -> None:
    """By the name and the class that a worker of this robot would have."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, _):
        asking = asyncio.ensure_future(hand.ask("far_docking", Dock(2)))
        await asyncio.sleep(0.2)
        if act == "remove":
            await base.behaviors.remove("docking")
        else:
            await base.behaviors.replace("docking", Docking())
        with pytest.raises(esair.BehaviorRemovedError, match="behavior 'far_docking'"):
            await asking


class Mate(esair.Behavior):
    """Drives at home, when it is told to."""

    wheels = esair.writes(Twist)

    async def run(self) -> None:
        await asyncio.get_running_loop().create_future()


@pytest.mark.promise("NET-4")
@pytest.mark.parametrize("slow", [0.05, 0.4])
async def test_a_command_is_judged_when_it_leaves(slow: float) -> None:
    """One that was fresh, and has waited behind a slow call of another, is too old."""
    pair, hand, mate = Pair(), Hand(), Mate()
    pair.wheels.deadline = 1.0
    async with pair.base(mate) as base, pair.rover(hand):
        await asyncio.sleep(0.3)
        sent = listen(base)
        pair.wheels.slow(slow)
        first = asyncio.ensure_future(mate.wheels.write(Twist(0.1, 0.0)))
        await asyncio.sleep(0.01)
        second = asyncio.ensure_future(hand.wheels.write(Twist(0.2, 0.0)))
        await asyncio.gather(first, second, return_exceptions=True)
        await asyncio.sleep(0.6)

        told = [command for _, command in sent]
        assert (Twist(0.2, 0.0) in told) is (slow < TIMEOUT), told
        assert pair.to_rover.stats.refused == (slow > TIMEOUT)


@pytest.mark.promise("BS-11", "NET-2")
async def test_a_cancellation_that_is_lost_in_a_gap_is_made_good() -> None:
    """Nobody works on, at the other robot, for somebody who is gone."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        asking = asyncio.ensure_future(hand.ask("far_docking", Dock(2)))
        await asyncio.sleep(0.31)
        assert pair.docking.begun == [2]
        pair.network.cut()
        await asyncio.sleep(0.2)
        asking.cancel()
        await asyncio.sleep(0.4)
        pair.network.heal()
        await asyncio.sleep(2.5)
        assert pair.docking.cancelled == 1
        asking = asyncio.ensure_future(hand.ask("far_docking", Dock(3)))
        await asyncio.sleep(5.0)  # as long as somebody waits it is worked on
        assert pair.docking.cancelled == 1
        pair.docking.go.set()
        assert (await asking).bay == 3


@pytest.mark.promise("ROB-4", "PRO-7", "NET-2")
@pytest.mark.parametrize("way", ["halt", "remove", "end"])
async def test_what_a_peer_moved_is_safe_when_it_lets_go(way: str) -> None:
    """At once, as with a local one, however long its owner would let it move."""
    pair, hand = Pair(), Hand()
    pair.wheels = FakeActuator("wheels", safe=STILL, command_timeout=2.0)
    async with pair.base(), pair.rover(hand) as rover:
        await asyncio.sleep(0.3)
        assert await hand.wheels.write(Twist(0.3, 0.0))
        if way == "halt":
            told = await rover.halt("enough")
            assert [each.answered for each in told] == [True]
        elif way == "remove":
            await rover.behaviors.remove("hand")
        else:
            await rover.stop("enough")
        await asyncio.sleep(0.05)
        assert pair.wheels.commands[-1] == STILL


@pytest.mark.promise("ROB-2", "OPS-3", "NET-2")
@pytest.mark.parametrize("way", ["halt", "end"])
async def test_what_is_let_go_in_a_gap_is_not_told_as_answered(way: str) -> None:
    """Only its owner can say so; it is let go when the gap is over."""
    pair, hand = Pair(), Hand()
    pair.wheels = FakeActuator("wheels", safe=STILL, command_timeout=2.0)
    async with pair.base(), pair.rover(hand) as rover:
        await asyncio.sleep(0.3)
        assert await hand.wheels.write(Twist(0.3, 0.0))
        pair.network.cut("base")
        if way == "end":
            await rover.stop("enough")
            (told,) = rover.stopped
        else:
            (told,) = await rover.halt("enough")
            await asyncio.sleep(0.2)
            state = rover.resources.query("far_wheels").state
            assert state is esair.ResourceState.READY
            pair.network.heal()
            await asyncio.sleep(0.1)
            assert pair.wheels.commands[-1] == STILL
        assert (told.safe, told.answered) == (True, False)
        assert "no answer" in told.error


@pytest.mark.promise("NET-3", "BS-10")
async def test_who_waits_for_a_peer_that_is_taken_away_hears_of_it() -> None:
    """What came of the request nobody knows: it waits for nothing."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (_, rover):
        asking = asyncio.ensure_future(hand.ask("far_docking", Dock(2), timeout=None))
        await asyncio.sleep(0.3)
        assert pair.docking.begun == [2]
        for name in ("far_sonar", "far_wheels", "base"):
            with contextlib.suppress(esair.UnknownNameError):
                await rover.resources.remove(name)
        async with asyncio.timeout(1.0):
            with pytest.raises(esair.OutcomeUnknownError):
                await asking
        assert pair.docking.cancelled == 1


@pytest.mark.promise("NET-3")
@pytest.mark.parametrize("way", ["restart", "rest"])
async def test_a_request_whose_stand_in_ends_its_run_is_not_known(way: str) -> None:
    """It was sent, and nobody here hears what becomes of it: that is no failure."""
    pair, hand = Pair(), Hand()
    modes = {"far": ["hand", "far_docking"], "near": ["hand"]}
    rover = pair.rover(hand, modes=modes, mode="far")
    async with pair.base(), rover:
        await asyncio.sleep(0.3)
        asking = asyncio.ensure_future(hand.ask("far_docking", Dock(2), timeout=None))
        await asyncio.sleep(0.3)
        assert pair.docking.begun == [2]
        if way == "restart":
            await rover.behaviors.restart("far_docking")
        else:
            await rover.behaviors.switch("near", reason="enough")
        with pytest.raises(esair.OutcomeUnknownError):
            await asking


@pytest.mark.promise("PRO-9", "NET-2")
@pytest.mark.parametrize("gap", [0.13, 0.3, 0.6, 0.9])
async def test_a_change_that_falls_into_a_gap_is_heard_after_it(gap: float) -> None:
    """Of a sensor that tells changes alone; what has not changed is heard once."""
    pair, hand = Pair(), Hand()
    pair.sonar = FakeSensor("sonar")
    heard: list[float] = []

    class Hears(esair.Behavior):
        sonar = esair.reads(float, name="far_sonar")

        async def run(self) -> None:
            while True:
                with contextlib.suppress(esair.EsairError):
                    async for value in self.sonar:
                        heard.append(value)  # noqa: PERF401 - it never ends
                await asyncio.sleep(0.01)

    async with pair.both(hand, Hears()):
        pair.sonar.feed(0.9)
        await asyncio.sleep(2.3)
        assert heard[-1] == 0.9
        assert heard.count(0.9) == 1
        pair.network.cut()
        await asyncio.sleep(gap / 2)
        pair.sonar.feed(0.3)
        await asyncio.sleep(gap / 2)
        pair.network.heal()
        await asyncio.sleep(0.3)
        assert heard[-1] == 0.3
        await asyncio.sleep(3.0)
        assert heard.count(0.3) == 1


@pytest.mark.promise("RES-3", "NET-2")
@pytest.mark.parametrize("writes", [False, True])
@pytest.mark.parametrize("way", ["from the start", "unplugged", "removed"])
async def test_an_actuator_that_is_lost_there_is_lost_here(
    way: str, writes: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """With the reason that its owner has, as long as that has it, and told once."""
    caplog.set_level("INFO")
    pair, driving = Pair(), Driving()
    if way == "from the start":
        pair.wheels.unplug()
    drives = (driving,) if writes else ()
    async with pair.base() as base, pair.rover(*drives) as rover:
        await asyncio.sleep(1.0)
        if way == "unplugged":
            pair.wheels.unplug()
            await base.resources.restart("wheels")
        elif way == "removed":
            await base.resources.remove("wheels")
        await asyncio.sleep(0.5)
        for _ in range(100):
            status = rover.resources.query("far_wheels")
            assert status.state is not ResourceState.READY
            assert "'base' says: " in str(status.error)
            await asyncio.sleep(0.13)
        told = [each for each in caplog.messages if each.startswith("far_wheels:")]
        assert len(told) == 1
        if way == "removed":
            again = FakeActuator("wheels", safe=STILL)
            await base.resources.add(again)
        pair.wheels.plug()
        await asyncio.sleep(8.0)  # its owner looks for it after a pause
        assert rover.resources.query("far_wheels").state is ResourceState.READY


@pytest.mark.promise("RES-3", "NET-2")
async def test_a_peers_actuator_that_is_unplugged_is_lost_and_comes_back() -> None:
    """Its safe command has no answer there: that is a loss, and no fault of the peer."""
    pair, hand = Pair(), Hand()
    async with pair.base(), pair.rover(hand) as rover:
        await asyncio.sleep(0.3)
        assert await hand.wheels.write(Twist(0.3, 0.0))
        pair.wheels.unplug()
        await asyncio.sleep(30.0)
        state = rover.resources.query("far_wheels").state
        assert state is not esair.ResourceState.FAILED
        pair.wheels.plug()
        await asyncio.sleep(15.0)
        assert await hand.wheels.write(Twist(0.2, 0.0))
