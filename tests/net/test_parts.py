"""A remote sensor and a remote actuator are used like local ones."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import attrs
import pytest
from tests.net.parts import STILL, Dock, Docked, Hand, Pair, Twist

import esair
from esair.drivers.peer import Peer, PeerActuator, PeerSensor
from esair.peers import Share, Sharing, peer_behavior
from esair.testing import FakeActuator

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("NET-2")
async def test_a_remote_part_is_read_and_written_by_its_local_name() -> None:
    """Value, type and state of the owner's part; the holder has the peer's name."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, rover):
        pair.sonar.feed(0.7)
        await asyncio.sleep(0.2)
        assert await hand.sonar.read() == 0.7

        written = await hand.wheels.write(Twist(0.3, 0.0))

        assert written
        assert written.command == Twist(0.3, 0.0)
        assert pair.wheels.commands[-1] == Twist(0.3, 0.0)
        why = base.resources.why("wheels")
        assert (why.holder, why.priority) == ("rover", 5)
        assert rover.resources.query("far_wheels").state is esair.ResourceState.READY
    assert pair.wheels.commands[-1] == STILL


@pytest.mark.promise("ROB-4")
async def test_a_slew_begins_where_the_remote_part_was_let_go(monkeypatch) -> None:
    """Its owner says where that is: at the start, and after each pause."""
    monkeypatch.setattr(PeerActuator, "slew", {"linear": 0.1})
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        for _ in range(2):
            written = await hand.wheels.write(Twist(0.3, 0.0))
            assert 0.0 < written.command.linear <= 0.021
            assert pair.wheels.commands[-1] == written.command
            await asyncio.sleep(1.0)
            assert pair.wheels.commands[-1] == STILL


@pytest.mark.promise("PRO-11", "NET-2")
async def test_what_a_remote_actuator_that_was_let_go_applies_is_not_known() -> None:
    """Somebody else may move it there; its owner knows, and can share that."""
    pair = Pair()
    pair.shares.append(Share("wheels.applied", "read"))
    there = PeerSensor(name="there", remote="wheels.applied", bus=pair.to_base)

    class Looks(Hand):
        here = esair.reads(Twist, name="far_wheels.applied")
        there = esair.reads(Twist, name="there")

    class Mate(esair.Behavior):
        wheels = esair.writes(Twist)

        async def run(self) -> None:
            await asyncio.get_running_loop().create_future()

    looks, mate = Looks(name="looks"), Mate()
    async with pair.base(mate), pair.rover(looks, resources=[there]):
        await asyncio.sleep(0.4)
        for speed in (0.3, 0.4):
            assert await mate.wheels.write(Twist(0.8, 0.0))
            await asyncio.sleep(0.1)
            with pytest.raises(esair.StaleReadingError):
                looks.here.newest  # noqa: B018
            assert await looks.there.read() == Twist(0.8, 0.0)
            await asyncio.sleep(0.3)
            assert await looks.wheels.write(Twist(speed, 0.0))
            assert looks.here.newest.value == Twist(speed, 0.0)
            await asyncio.sleep(0.3)


@pytest.mark.promise("NET-2")
async def test_a_remote_sensor_with_two_names_is_live_under_both() -> None:
    """Each is opened, heard and lost by itself; it is sent as often as one wants it."""
    pair = Pair()
    second = PeerSensor(
        name="second", remote="sonar", bus=pair.to_base, type=float, link_rate=5.0
    )

    class Both(Hand):
        other = esair.reads(float, name="second")

    hand = Both(name="hand")
    async with pair.base(), pair.rover(hand, resources=[second]) as rover:
        await asyncio.sleep(0.3)
        for step in range(20):
            pair.sonar.feed(float(step))
            await asyncio.sleep(0.05)
            assert (await hand.sonar.read(), await hand.other.read()) == (step, step)
        await rover.resources.remove("second")
        pair.sonar.feed(50.0)
        await asyncio.sleep(0.05)
        assert await hand.sonar.read() == 50.0


@pytest.mark.promise("AC-2", "NET-2")
async def test_a_remote_actuator_has_one_name() -> None:
    """Two would not know of each other's holds, and the end of one stop what moves."""
    pair = Pair()
    second = PeerActuator(name="second", remote="wheels", bus=pair.to_base, type=Twist)
    with pytest.raises(ExceptionGroup) as told:
        async with pair.rover(resources=[second]):
            pass
    assert told.group_contains(esair.ConfigError, match="'wheels' there belongs to")


@pytest.mark.promise("NET-2")
async def test_a_second_name_need_not_wait_for_a_slow_first_one() -> None:
    """It is sent as often as the second wants it from then on, not after a long pause."""
    pair, hand = Pair(), Hand()
    slow, fast = (
        PeerSensor(
            name=name, remote="sonar", bus=pair.to_base, type=float, link_rate=rate
        )
        for name, rate in (("slow", 0.05), ("far_sonar", 100.0))
    )
    async with pair.base(), pair.rover(hand, resources=[slow]) as rover:
        await rover.resources.remove("far_sonar")
        await asyncio.sleep(2.0)
        await rover.resources.add(fast)
        await asyncio.sleep(0.3)
        for step in range(20):
            pair.sonar.feed(float(step))
            await asyncio.sleep(0.05)
            assert await hand.sonar.read() == step


@pytest.mark.promise("NET-2")
@pytest.mark.parametrize("rate", [20, 20.0])
async def test_a_rate_may_be_a_whole_number(rate: float) -> None:
    """In a script it is what a person writes; its owner takes it from others, too."""
    pair = Pair()
    for name in ("whole", "far_sonar"):
        sensor = PeerSensor(
            name=name, remote="sonar", bus=pair.to_base, type=float, link_rate=rate
        )
        assert type(sensor.link_rate) is float
    sensor.link_rate = rate
    async with pair.base(), pair.rover() as rover:
        await rover.resources.remove("far_sonar")
        await rover.resources.add(sensor)
        await asyncio.sleep(0.5)
        state = rover.resources.query("far_sonar").state
        assert state is esair.ResourceState.READY


@pytest.mark.parametrize(
    "wrong", [{"access": "reed"}, {"access": "read", "rate": "often"}, {"rate": True}]
)
def test_a_share_of_another_kind_is_no_share(wrong: dict[str, Any]) -> None:
    """It would share nothing, without a word."""
    with pytest.raises(esair.ConfigError, match="expected"):
        Share("sonar", **{"access": "read", **wrong})


@pytest.mark.promise("SUP-2", "NET-2")
async def test_what_a_peer_may_do_is_exchanged_while_it_does_it() -> None:
    """Who stands for the peer then serves it: it reads, writes and asks as before."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, _):
        pair.docking.go.set()
        again = Sharing(bus=pair.to_rover, shares=pair.shares)
        await base.behaviors.replace("rover", again)
        pair.sonar.feed(0.4)
        await asyncio.sleep(0.2)
        assert await hand.sonar.read() == 0.4
        assert await hand.wheels.write(Twist(0.3, 0.0))
        assert await hand.ask("far_docking", Dock(2)) == Docked(2)


class Slowly(esair.Reaction):
    """A guard that lets a quarter pass."""

    sonar = esair.reads(float, name="far_sonar")
    wheels = esair.guards(Twist, name="far_wheels")

    def react(self, sonar: float, wheels: Twist) -> Twist:
        return Twist(wheels.linear * min(1.0, sonar), wheels.angular)


@pytest.mark.promise("RS-8", "NET-1")
@pytest.mark.parametrize("what", ["shares", "asks"])
async def test_a_bus_to_a_peer_without_a_device_is_a_mistake(what: str) -> None:
    """Nobody would open it: it would share nothing, and refuse all, without a word."""
    pair = Pair()
    part: Any = Sharing(bus=pair.to_rover, shares=[Share("sonar", "read")])
    if what == "asks":
        part = peer_behavior("docking", pair.to_rover, [Dock])
    async with esair.Robot(name="base", resources=[pair.sonar]) as robot:
        with pytest.raises(esair.ConfigError, match=r"expected Peer\(name='rover'"):
            await robot.behaviors.add(part)
        await robot.resources.add(Peer(name="rover", bus=pair.to_rover))
        await robot.behaviors.add(part)


@pytest.mark.promise("PRO-6", "PRO-7", "NET-2")
async def test_a_guard_lets_less_pass_to_a_remote_actuator() -> None:
    """As to a local one: what is safe at its owner is the least; more is its crash."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand, Slowly()):
        pair.sonar.feed(0.25)
        await asyncio.sleep(0.2)
        written = await hand.wheels.write(Twist(0.8, 0.0))
        assert (written.command, written.by) == (Twist(0.2, 0.0), "slowly")
        assert pair.wheels.commands[-1] == Twist(0.2, 0.0)
        pair.sonar.feed(0.1)
        await asyncio.sleep(0.1)
        assert abs(pair.wheels.commands[-1].linear - 0.08) < 1e-9  # what stands, too
        pair.sonar.feed(-1.0)
        await asyncio.sleep(0.1)
        assert not await hand.wheels.write(Twist(0.8, 0.0))
        assert pair.wheels.commands[-1] == STILL


@pytest.mark.promise("BS-4", "NET-2")
async def test_data_is_neither_put_to_nor_got_from_another_robot() -> None:
    """It is refused at once, with what to do: nobody there would ever get it."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, rover):
        loop = asyncio.get_running_loop()
        began = loop.time()
        with pytest.raises(esair.RefusedError, match="ask it"):
            await hand.put("far_docking", {"bay": 2})
        with pytest.raises(esair.RefusedError, match="ask it"):
            await hand.get("far_docking")
        with pytest.raises(esair.RefusedError, match="ask it"):
            await rover.behaviors.put(1, sender="user", receiver="far_docking")
        with pytest.raises(esair.RefusedError, match="do not cross"):
            await base.behaviors.put(1, sender="user", receiver="rover")
        assert loop.time() == began
        assert not rover.behaviors.query("far_docking").can_receive


async def test_ask() -> None:
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (_base, _rover):
        pair.docking.go.set()
        news: list[object] = []
        answer = await hand.ask("far_docking", Dock(2), progress=news.append)
        assert answer == Docked(2)
        assert news == [0.5]


@pytest.mark.promise("BS-10", "NET-2")
async def test_a_time_out_says_that_the_behavior_is_at_another_robot() -> None:
    """What stands for it here runs: that says nothing of the one that rests there."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        with pytest.raises(esair.BehaviorUnavailableError) as late:
            await hand.ask("far_docking", Dock(2), timeout=1.0)
        assert "it is at base: busy, resting or restarting there" in str(late.value)


@attrs.frozen
class Undock(esair.Request[Docked]):
    """A request that nobody takes."""

    bay: int


@pytest.mark.promise("BS-10", "NET-2")
async def test_what_its_owner_cannot_read_is_answered_at_once() -> None:
    """Nothing was done: a request and a write are refused, each with the class."""
    pair, hand, loop = Pair(), Hand(), asyncio.get_running_loop()
    odd = PeerActuator(name="odd", remote="arm", bus=pair.to_base)
    pair.to_base.declare(Undock)

    class Writes(esair.Behavior):
        odd = esair.writes(Any)

        async def run(self) -> None:
            await loop.create_future()

    writes = Writes(name="writes")
    far = peer_behavior("undocking", pair.to_base, [Undock], remote="docking")
    arm = FakeActuator("arm", safe=STILL)
    pair.shares.append(Share("arm", "write"))
    base = pair.base(resources=[arm])
    async with base, pair.rover(hand, writes, far, resources=[odd]):
        await asyncio.sleep(0.4)
        began = loop.time()
        with pytest.raises(esair.RefusedError, match="Undock"):
            await hand.ask("undocking", Undock(1), timeout=None)
        refused = await writes.odd.write(Undock(1))  # type: ignore[arg-type]
        assert isinstance(refused, esair.Refused)
        assert "Undock" in refused.rule
        assert loop.time() - began < 0.1


@pytest.mark.promise("AC-1", "NET-2")
@pytest.mark.parametrize(
    "bad",
    [Twist(5.0, 0.0), Undock(1), object(), "x" * (1 << 20)],
    ids=["beyond limits", "unknown", "no data", "huge"],
)
async def test_a_bad_command_is_the_fault_of_its_writer_alone(bad: object) -> None:
    """However often: the actuator is there for the others, and moves for them."""
    pair, arm = Pair(), FakeActuator("arm", safe=STILL, limits={"linear": (-1.0, 1.0)})
    pair.shares.append(Share("arm", "write"))
    pair.to_base.declare(Undock)
    far = PeerActuator(name="arm", bus=pair.to_base)

    class Rash(esair.Behavior):
        arm = esair.writes(Any)

        async def run(self) -> None:
            await asyncio.get_running_loop().create_future()

    rash = Rash()
    async with pair.base(resources=[arm]), pair.rover(rash, resources=[far]) as rover:
        await asyncio.sleep(0.4)
        for _ in range(10):
            with contextlib.suppress(esair.BadValueError):
                assert not await rash.arm.write(bad)  # type: ignore[arg-type]
        status = rover.resources.query("arm")
        assert (status.state, status.faults) == (esair.ResourceState.READY, 0)
        assert await rash.arm.write(Twist(0.3, 0.0))  # type: ignore[arg-type]


class Asks(esair.Behavior):
    """Asks the other robot, before it answers."""

    def __init__(self, *, name: str, other: str) -> None:
        super().__init__(name=name)
        self.other = other

    @esair.answers
    async def dock(self, request: Dock) -> Docked:
        if request.bay:
            return await self.ask(self.other, Dock(request.bay - 1), timeout=None)
        return Docked(0)


@pytest.mark.promise("BS-5", "NET-2")
@pytest.mark.parametrize("bays", [1, 9])
async def test_a_circle_over_two_robots_is_refused_at_once(bays: int) -> None:
    """With the path, where it closes; who asks the other one and gets an answer does not."""
    pair, hand = Pair(), Hand()
    pair.to_base.declare(Dock)
    pair.to_base.declare(Docked)
    here = peer_behavior("theirs", pair.to_rover, [Dock], remote="ours")
    pair.docking = Asks(name="docking", other="theirs")  # type: ignore[assignment]
    there = Asks(name="ours", other="far_docking")
    share = Sharing(bus=pair.to_base, shares=[Share("ours", "ask")])
    async with pair.base(here), pair.rover(hand, there, share):
        await asyncio.sleep(1.0)
        asked = hand.ask("far_docking", Dock(bays), timeout=None)
        async with asyncio.timeout(1.0):
            if bays == 1:
                assert await asked == Docked(0)
                return
            with pytest.raises(
                esair.EsairError, match="far_docking -> ours -> far_docking"
            ):
                await asked
        assert await hand.ask("far_docking", Dock(1), timeout=1.0) == Docked(0)


@pytest.mark.promise("NET-6")
async def test_an_actuator_that_is_there_is_not_lost() -> None:
    """Of what has said nothing yet an owner may tell that it is there: without a reason."""
    pair = Pair()
    async with pair.both(Hand()) as (_, rover):
        pair.to_rover.say("gone", "wheels", "")
        await asyncio.sleep(0.1)
        assert rover.resources.query("far_wheels").losses == 0


@pytest.mark.promise("NET-3")
async def test_an_answer_of_a_class_that_is_not_known_says_which() -> None:
    """Whoever uses an actuator as another type hears what its owner says, at once."""
    pair = Pair()
    bus = pair.to_base
    wheels = PeerActuator(name="wheels", bus=bus, type=float)
    robot = esair.Robot(name="rover", resources=[Peer(name="base", bus=bus), wheels])
    async with pair.base(), robot:
        await asyncio.sleep(0.3)
        assert "parts.Twist" in str(robot.resources.query("wheels").error)


@pytest.mark.promise("NET-3")
@pytest.mark.parametrize("where", ["owner", "user"])
async def test_a_reading_of_a_class_that_is_not_declared_is_a_loss(where: str) -> None:
    """It says which class, also of the only one: never that nothing is said."""
    pair = Pair()
    pair.sonar = Once(name="sonar")
    (pair.to_rover if where == "user" else pair.to_base).declare(Odd)
    sonar = PeerSensor(name="sonar", bus=pair.to_base)
    parts = [Peer(name="base", bus=pair.to_base), sonar]
    robot = esair.Robot(name="rover", resources=parts)
    async with pair.base(), robot:
        for _ in range(5):
            await asyncio.sleep(1.0)
            told = robot.resources.query("sonar")
            assert told.state is not esair.ResourceState.READY
            assert "Odd" in str(told.error)


@pytest.mark.parametrize("kind", [3, True, ["float"], {"float": 1}])
@pytest.mark.parametrize("part", [PeerSensor, PeerActuator])
def test_a_type_that_is_none_is_refused(part: Any, kind: Any) -> None:
    """Any value would be of it, so nothing would be checked."""
    with pytest.raises(esair.ConfigError, match="type: expected a type such as float"):
        part(name="far", bus=Pair().to_base, type=kind)


@attrs.frozen
class Odd:
    """A reading of a class of one's own."""

    number: int


class Once(esair.Sensor[Odd]):
    """Pushes one."""

    async def stream(self) -> AsyncIterator[Odd]:
        yield Odd(1)
        await asyncio.get_running_loop().create_future()
