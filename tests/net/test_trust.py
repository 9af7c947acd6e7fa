"""Who may what: nothing is shared unless named, and whatever bytes arrive only counters move."""

from __future__ import annotations

import asyncio
import random
import subprocess
import sys
import threading
import time
import types
from pathlib import Path
from typing import Any

import pytest
from tests.net.parts import STILL, Dock, Hand, Pair, Twist

import esair
from esair.buses import BusStats
from esair.buses.peer import FakeNetwork, Network, PeerBus, Tls
from esair.buses.peer._wire import FORMS, ITEMS, Head, head_of, packed, parts_of
from esair.buses.peer._zenoh import _Peer
from esair.codec import CodecError, Kinds, encode
from esair.drivers.peer import PeerActuator, PeerSensor
from esair.peers import Share

pytestmark = pytest.mark.virtual_clock

HEAD = 1, 1, 1, 1, 0.0


class Captain(esair.Behavior):
    """Drives at home."""

    wheels = esair.writes(Twist, priority=9)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(Twist(0.9, 0.0))


@pytest.mark.promise("NET-1")
async def test_nothing_is_shared_unless_named() -> None:
    """What has no share is lost to the peer, or refused, whatever it asks for."""
    pair, hand = Pair(), Hand()
    pair.shares = []
    async with pair.both(hand) as (base, rover):
        pair.sonar.feed(0.7)
        await asyncio.sleep(2.0)
        for name in ("far_sonar", "far_wheels"):
            status = rover.resources.query(name)
            assert status.state is not esair.ResourceState.READY
            assert "not shared with 'rover'" in str(status.error)
        with pytest.raises(esair.RefusedError, match="not shared with 'rover'"):
            await hand.ask("far_docking", Dock(2))
        assert base.resources.why("wheels").holder is None
    assert set(pair.wheels.commands) == {STILL}


@pytest.mark.promise("NET-5")
async def test_a_peer_has_the_priority_of_its_share_and_no_more() -> None:
    """Who has more at home keeps the actuator, and is named to the peer."""
    pair, hand = Pair(priority=5), Hand()
    async with pair.base(Captain()) as base, pair.rover(hand) as rover:
        await asyncio.sleep(0.5)
        refused = await hand.wheels.write(Twist(0.1, 0.0))
        assert isinstance(refused, esair.Refused)
        assert (refused.holder, refused.priority) == ("base:captain", 9)
        why = rover.resources.why("far_wheels")
        assert (why.holder, why.priority, why.rule) == ("base:captain", 9, refused.rule)
        assert "the robot that has it" in str(why)
        assert Twist(0.1, 0.0) not in pair.wheels.commands
        await base.behaviors.remove("captain")
        await asyncio.sleep(0.3)
        assert await hand.wheels.write(Twist(0.1, 0.0))
        assert rover.resources.why("far_wheels").holder == "hand"


@pytest.mark.promise("NET-5")
async def test_a_share_that_is_revoked_is_void_at_once() -> None:
    """Without the peer's behavior nothing of the peer gets in, not even what was fresh."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, _rover):
        assert await hand.wheels.write(Twist(0.1, 0.0))
        await base.behaviors.remove("rover")
        count = len(pair.wheels.commands)
        with pytest.raises(esair.DeviceLostError, match="shares nothing now"):
            await hand.wheels.write(Twist(0.2, 0.0))
        await asyncio.sleep(0.5)
        assert set(pair.wheels.commands[count:]) <= {STILL}


@pytest.mark.promise("NET-5")
async def test_policies_hold_for_a_peer() -> None:
    """What a policy denies to the peer's name stops the owner from starting."""
    pair = Pair()
    policy = esair.Policy("wheels", allow={"*": esair.Access.READ})
    with pytest.raises(ExceptionGroup) as caught:
        async with pair.base(policies=[policy]):
            pass
    assert "rover" in str(caught.value.exceptions[0])


async def test_letting_go_is_no_command() -> None:
    """A peer that writes nothing stops nobody: connected, idle, lost or ended."""
    pair = Pair(priority=20)
    async with pair.base(Captain()):
        await asyncio.sleep(0.5)
        count = len(pair.wheels.commands)
        async with pair.rover():
            await asyncio.sleep(1.0)
        await asyncio.sleep(0.5)
        assert set(pair.wheels.commands[count:]) == {Twist(0.9, 0.0)}


@pytest.mark.promise("NET-4", "NET-6")
@pytest.mark.parametrize("between", [0, 300])
async def test_a_command_does_not_come_again_behind_a_newer_one(between: int) -> None:
    """A slow way may bring a copy of it, however much else has come with the beat."""
    pair = Pair()
    async with pair.both():
        bus = pair.to_rover
        head = Head(bus._its_run, bus._its_beat + 1, bus._run, bus._beats, 0.0)

        def come(what: str, *parts: Any) -> None:
            data = packed(head, tuple(parts), bus.kinds)
            pair.network.inject("rover", "base", what, data)

        come("write", 1, "wheels", Twist(0.5, 0.0))
        await asyncio.sleep(0.005)
        come("write", 2, "wheels", Twist(0.1, 0.0))
        for number in range(between):
            come("cancel", 1000 + number)
        await asyncio.sleep(0.005)
        come("write", 1, "wheels", Twist(0.5, 0.0))
        await asyncio.sleep(0.005)
        moved = [each for each in pair.wheels.commands if each != STILL]
        assert moved == [Twist(0.5, 0.0), Twist(0.1, 0.0)]


@pytest.mark.promise("NET-6")
async def test_of_messages_with_one_beat_so_many_are_taken() -> None:
    """Who stands still with its beats and floods fills no memory."""
    pair = Pair()
    async with pair.both():
        bus = pair.to_rover
        head = Head(bus._its_run, bus._its_beat + 1, bus._run, bus._beats, 0.0)
        for number in range(20_000):
            bus.came("cancel", packed(head, (number,), bus.kinds))
        assert bus.stats.dropped >= 20_000 - (1 << 14)
        assert len(bus._taken) == 1 << 14


@pytest.mark.promise("NET-6")
@pytest.mark.parametrize(
    "messages", [400, pytest.param(10_000, marks=pytest.mark.long)]
)
async def test_whatever_arrives_only_counters_move(messages: int) -> None:
    """Damaged, cut, made up: no command, no request, no crash; and it works on."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, _):
        await hand.wheels.write(Twist(0.1, 0.0))
        await asyncio.sleep(0.5)
        said = [each for each in pair.network.log if each[0] == "rover"]
        count, chance = len(pair.wheels.commands), random.Random(1)
        begun = list(pair.docking.begun)
        for number in range(messages):
            _, _, what, data = chance.choice(said)
            bad = bytearray(data)
            for _ in range(chance.randrange(1, 6)):
                bad[chance.randrange(len(bad))] = chance.randrange(256)
            cut = chance.choice([len(bad), chance.randrange(len(bad)), len(bad)])
            kind = chance.choice([what, what, *FORMS, "no such thing", ""])
            # Of another run: what is damaged there may not end this conversation.
            bad[0:8] = data[0:8]
            if kind == "bye":
                continue
            pair.network.inject("rover", "base", kind, bytes(bad[:cut]))
            if number % 100 == 0:
                await asyncio.sleep(0.01)
        await asyncio.sleep(0.5)
        assert set(pair.wheels.commands[count:]) <= {STILL, Twist(0.1, 0.0)}
        assert pair.docking.begun == begun
        stats = pair.to_rover.stats
        assert stats.bad_frames + stats.refused > messages // 10
        assert base.behaviors.query("rover").restarts == 0
        await asyncio.sleep(5.0)
        assert await hand.wheels.write(Twist(0.2, 0.0))


@pytest.mark.promise("NET-6")
@pytest.mark.parametrize("serves", [True, False])
async def test_what_is_asked_for_by_a_huge_name_crashes_nobody(serves: bool) -> None:
    """The answer has less of it than a message may hold; a list has an end, too."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand) as (base, _):
        bus = pair.to_rover
        if not serves:
            await base.behaviors.remove("rover")
        for what, *parts in (
            ("release", 7, "x" * 1_000_000),
            ("follow", {bytes(400_000): 1.0}),
            ("follow", {"x" * 600_000: 1.0}),
            ("pending", ["x" * 1_048_400]),
            ("follow", {str(number): 1.0 for number in range(9000)}),
            ("pending", list(range(19_000))),
        ):
            head = Head(bus._its_run, bus._its_beat, bus._run, bus._beats, 0.0)
            sent = bus.stats.sent
            pair.network.log.clear()
            data = packed(head, tuple(parts), bus.kinds)
            pair.network.inject("rover", "base", what, data)
            await asyncio.sleep(0.02)
            assert bus.stats.sent - sent < 10
            assert all(len(data) < 1000 for *_, data in pair.network.log)
        if serves:
            assert base.behaviors.query("rover").restarts == 0
            assert await hand.wheels.write(Twist(0.2, 0.0))


@pytest.mark.promise("NET-6")
def test_nothing_is_made_of_bytes_that_was_not_declared() -> None:
    """A class that no part of the robot declares is an error, never imported."""
    theirs, mine = Kinds([Twist]), Kinds()
    data = packed(Head(1, 1, 1, 1, 0.0), (1, "wheels", Twist(0.1, 0.2)), theirs)[40:]
    assert parts_of("write", data, theirs)[2] == Twist(0.1, 0.2)
    with pytest.raises(CodecError):
        parts_of("write", data, mine)
    with pytest.raises(CodecError, match="expected 3 parts"):
        parts_of("write", packed(Head(1, 1, 1, 1, 0.0), (1,), mine)[40:], mine)


@pytest.mark.promise("NET-6", "SEC-2")
def test_a_field_has_what_its_class_declares() -> None:
    """What is in a field is what its annotation names, on both sides of the way."""
    strict, head = PeerBus(name="base", network=FakeNetwork().of("rover")), Head(*HEAD)
    strict.declare(Dock)
    strict.declare(Twist)
    for value, told in (
        (Dock("x"), "Dock.bay: expected int, not str"),  # type: ignore[arg-type]
        (Dock(True), "Dock.bay: expected int, not bool"),
        (Twist(None, 0.0), "Twist.linear: expected float, not NoneType"),  # type: ignore[arg-type]
        (Twist(Dock(1), 0.0), "Twist.linear: expected float, not Dock"),  # type: ignore[arg-type]
    ):
        data = packed(head, (1, "docking", value), Kinds([Dock, Twist]))
        with pytest.raises(CodecError, match=told):
            parts_of("ask", data[40:], strict.kinds)
        with pytest.raises(CodecError, match=told):
            packed(head, (1, "docking", value), strict.kinds)
    data = packed(head, (1, "wheels", Twist(1, 0.5)), strict.kinds)
    assert parts_of("write", data[40:], strict.kinds)[2] == Twist(1, 0.5)


@pytest.mark.promise("NET-6", "BUS-1")
def test_a_message_has_so_many_items_and_no_more() -> None:
    """Its bytes say little of how long it takes to read: its items do."""
    kinds, head = Kinds(), Head(*HEAD)
    value = [1] * ITEMS
    with pytest.raises(CodecError, match="too many items"):
        packed(head, (1, "wheels", value), kinds)
    with pytest.raises(CodecError, match="too many items"):
        parts_of("write", encode((1, "wheels", value), kinds), kinds)
    scan = (1, "wheels", [0.5] * (3 * ITEMS))
    assert parts_of("write", packed(head, scan, kinds)[40:], kinds) == scan


class Liar:
    """The bus of a robot that answers all with one thing."""

    def __init__(self, pair: Pair, *answer: object) -> None:
        self.bus = pair.to_rover
        self.answer = answer

    def serve(self, what: str, _since: float, body: bytes) -> None:
        """Answer what comes."""
        parts = self.bus.parts(what, body)
        assert parts is not None
        if what == "follow":
            self.bus.say("gone", "sonar", "")
        elif what == "release":
            self.bus.say("answer", parts[0], "written", None)
        elif what in {"write", "ask"}:
            self.bus.say("answer", parts[0], *self.answer)


@pytest.mark.promise("AC-1", "NET-6")
@pytest.mark.parametrize(
    "answer",
    [
        ("written", "x"),
        ("written", Dock(1)),
        ("written", Twist(float("nan"), 0.0)),
        ("refused", ("wheels", 0, "no", float("nan"), None)),
        ("refused", ("wheels", 0, "no", 0.1, float("inf"))),
    ],
    ids=str,
)
async def test_a_peer_that_lies_of_a_write(answer: tuple[object, ...]) -> None:
    """What was applied there is a command, or the write ends as an error of the peer."""
    pair, hand = Pair(), Hand()
    pair.to_rover.serve(Liar(pair, *answer).serve)
    async with pair.rover(hand):
        await pair.to_rover.open()
        await asyncio.sleep(1.0)
        with pytest.raises(esair.DeviceFaultError, match="far_wheels"):
            await hand.wheels.write(Twist(0.1, 0.0))
        await pair.to_rover.close()


@pytest.mark.promise("NET-6", "ROB-3")
@pytest.mark.parametrize("how", ["refused", "lost", "failed"])
async def test_a_peer_that_says_too_much_of_a_write(how: str) -> None:
    """Its words can be shown: in one line, of which no more than is read is kept."""
    pair, hand, told = Pair(), Hand(), "\x1b[2J\n" + "x" * 500_000
    answer = (told, 0, told, 0.1, None) if how == "refused" else told
    pair.to_rover.serve(Liar(pair, how, answer).serve)
    async with pair.rover(hand):
        await pair.to_rover.open()
        await asyncio.sleep(1.0)
        try:
            refused = await hand.wheels.write(Twist(0.1, 0.0))
            said = f"{refused.holder} {refused.rule}"
        except esair.EsairError as error:
            said = str(error)
        assert "x" in said
        assert said.isprintable()
        assert len(said) < 1000
        await pair.to_rover.close()


@pytest.mark.promise("BS-8", "NET-6")
@pytest.mark.parametrize("answer", [5, None, Twist(1.0, 0.0), Dock(1)], ids=str)
async def test_a_peer_that_lies_in_an_answer(answer: object) -> None:
    """An answer is of the class that the request names, or the request has failed."""
    pair, hand = Pair(), Hand()
    pair.to_rover.serve(Liar(pair, "answered", answer).serve)
    async with pair.rover(hand):
        await pair.to_rover.open()
        await asyncio.sleep(1.0)
        with pytest.raises(esair.BehaviorFailedError, match="not Docked"):
            await hand.ask("far_docking", Dock(2), timeout=2.0)
        await pair.to_rover.close()


@pytest.mark.promise("NET-3")
async def test_a_request_that_finds_no_room_is_declined() -> None:
    """It was not begun, so it is never called unknown."""
    pair, hand = Pair(), Hand()
    async with pair.both(hand):
        asks = [asyncio.ensure_future(hand.ask("far_docking", Dock(2)))]
        await asyncio.sleep(0.5)
        told = next(each for each in pair.network.log if each[2] == "ask")[3]
        begun = len(pair.network.log)
        for number in range(100):
            data = packed(
                head_of(pair.network.log[-1][3])[0]._replace(run=head_of(told)[0].run),  # type: ignore[index]
                (number, "docking", Dock(number)),
                pair.to_base.kinds,
            )
            pair.network.inject("rover", "base", "ask", data)
        await asyncio.sleep(0.1)
        answers = [each for each in pair.network.log[begun:] if each[2] == "answer"]
        hows = {pair.to_base.parts("answer", each[3][40:])[1] for each in answers}  # type: ignore[index]
        assert hows == {"declined"}
        for each in asks:
            each.cancel()


@pytest.mark.promise("NET-1")
@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({}, "expected endpoints"),
        ({"listen": ["tcp/0.0.0.0:7447"]}, "insecure = true"),
        ({"connect": ["tcp/192.168.1.5:7447"]}, "insecure = true"),
        ({"connect": ["tls/192.168.1.5:7447"]}, "tls needs certificates"),
        ({"listen": ["udp/127.0.0.1:7447"]}, "expected 'tcp/HOST:PORT'"),
        ({"listen": ["tcp/127.0.0.1:0"]}, "expected 'tcp/HOST:PORT'"),
        ({"listen": ["tcp/127.0.0.1:1"], "connect_timeout": 0}, "expected 0.05 to 10"),
        (
            {
                "listen": ["tcp/127.0.0.1:1"],
                "tls": Tls(Path("a"), Path("b"), Path("c")),
            },
            "begins with tls/",
        ),
        (
            {
                "listen": ["tls/127.0.0.1:1"],
                "tls": Tls(Path(__file__), Path(__file__), Path(__file__)),
            },
            "tls.ca: expected the certificate of the authority",
        ),
    ],
)
def test_endpoints_are_explicit_and_safe(given: dict[str, object], told: str) -> None:
    """Beyond this machine there are certificates, or a loud word."""
    with pytest.raises(esair.ConfigError, match=told):
        Network(me="base", peers=["rover"], **given)  # type: ignore[arg-type]


def test_the_loud_word() -> None:
    """Somebody who wants it gets it."""
    network = Network(me="base", listen=["tcp/0.0.0.0:7447"], insecure=True)
    assert network.insecure
    with pytest.raises(esair.ConfigError, match="no peer of itself"):
        PeerBus(name="base", network=network)
    bus = PeerBus(name="rover", network=network)
    with pytest.raises(esair.ConfigError, match="link_rate"):
        PeerSensor(name="sonar", bus=bus, link_rate=0.0)
    assert PeerActuator(name="wheels", bus=bus, type="float").value_type is float
    assert Share("wheels", "write").priority == 0


@pytest.mark.promise("NET-1")
@pytest.mark.real_clock
def test_without_a_network_nothing_of_it_is_imported(tmp_path: Path) -> None:
    """Neither zenoh nor the rooms of peers, by a robot of a script or of a file."""
    (tmp_path / "robot.toml").write_text('[robot]\nname = "rover"\n')
    code = (
        "import sys, esair\n"
        "esair.run(esair.Robot.from_config('robot.toml'), duration=0.01)\n"
        "print([each for each in sys.modules if 'peer' in each or 'zenoh' in each])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "[]\n", done.stderr


class Payload(bytes):
    """What zenoh gives."""

    def to_bytes(self) -> bytes:
        return bytes(self)


class SlowBus:
    """A bus that needs its time for each message."""

    name = "tablet"

    def __init__(self) -> None:
        self.stats = BusStats()
        self.taken = 0

    def came(self, what: str, data: bytes) -> bool:
        self.taken += 1
        until = time.monotonic() + 0.001
        while time.monotonic() < until:
            pass
        return True


@pytest.mark.real_clock
@pytest.mark.promise("NET-6", "BUS-1")
async def test_a_peer_that_floods_has_a_small_part_of_the_loop() -> None:
    """However much it sends: what waits is bounded, in number and in bytes."""
    bus: Any = SlowBus()
    peer, way, ends = _Peer(bus), types.SimpleNamespace(line=None), threading.Event()

    def flood() -> None:
        while not ends.is_set():
            peer.come(way, "beat", Payload(b"x" * 1000))  # type: ignore[arg-type]

    thread = threading.Thread(target=flood)
    thread.start()
    loop = asyncio.get_running_loop()
    try:
        began, late = loop.time(), 0.0
        for _ in range(40):
            asked = loop.time() + 0.01
            await asyncio.sleep(0.01)
            late = max(late, loop.time() - asked)
        seconds = loop.time() - began
    finally:
        ends.set()
        thread.join()
    assert late < 0.15
    assert 10 < bus.taken < 600 * seconds
    assert bus.stats.dropped > 0
