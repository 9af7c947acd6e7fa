"""J1939: addresses that are claimed and lost, and commands that go in packets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.drivers.dbc import DbcActuator, DbcSensor
from esair.drivers.dbc.fake_j1939 import FakeJ1939Node
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.messages import Access, Policy, ResourceState
from esair.testing import ActuatorContract, GatewayContract

pytestmark = pytest.mark.virtual_clock

FILE = """VERSION ""
NS_ :
BS_:
BU_: Engine
BO_ 2348810494 Torque: 8 Engine
 SG_ limit : 8|16@1+ (0.125,0) [0|8031.875] "rpm" Engine
BO_ 2566842110 All: 20 Engine
 SG_ first : 0|8@1+ (1,0) [0|250] "" Engine
 SG_ last : 152|8@1+ (1,0) [0|250] "" Engine
BO_ 2565800190 One: 20 Engine
 SG_ first : 0|8@1+ (1,0) [0|250] "" Engine
 SG_ last : 152|8@1+ (1,0) [0|250] "" Engine
BO_ 5 Short: 8 Engine
 SG_ y : 0|8@1+ (1,0) [0|250] "" Engine
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "";
BA_ "VFrameFormat" BO_ 2348810494 3;
BA_ "VFrameFormat" BO_ 2566842110 3;
BA_ "VFrameFormat" BO_ 2565800190 3;
"""
TO_ALL, TO_ONE = 0xFEE6, 0xEF00
TORQUE, CLAIM = 0x0C00_0000, 0x18EE_FF00
OWN = 0x1000
TAKES_ANOTHER = 1 << 63 | OWN


@pytest.fixture
def wire(fake_can: Callable[..., Any]) -> Any:
    return fake_can("drive")


@pytest.fixture
def make(wire: Any, tmp_path: Path) -> Any:
    (database := tmp_path / "engine.dbc").write_text(FILE)
    return partial(DbcActuator, name="engine", bus=wire, database=database)


def torque(make: Any, **keywords: Any) -> DbcActuator:
    return make(  # type: ignore[no-any-return]
        message="Torque", signal="limit", safe=0.0, source=0x27, **keywords
    )


def packets(make: Any, message: str, **keywords: Any) -> DbcActuator:
    return make(  # type: ignore[no-any-return]
        message=message, safe={"first": 0, "last": 0}, source=0x27, **keywords
    )


async def test_what_the_file_does_not_describe_is_asked_nothing(
    make: Any, wire: Any
) -> None:
    """Bits of nothing are ones (SAE J1939-71); zeros would be commands of their own."""
    engine = torque(make)
    await wire.open()
    await engine.open()
    await engine.write(1000.0)
    await asyncio.sleep(0.01)
    assert wire.sent[-1].data == bytes.fromhex("ff401fffffffffff")
    await engine.close()
    await wire.close()


def claims(wire: Any) -> list[tuple[int, int]]:
    """The addresses and the NAMEs that the robot said it has."""
    return [
        (frame.id & 0xFF, int.from_bytes(frame.data, "little"))
        for frame in wire.sent
        if frame.id & ~0xFF == CLAIM
    ]


class OnNode:
    """A node on the bus of an actuator whose command goes to it in packets."""

    keeps_nothing = "each message says all that the node needs"

    @pytest.fixture(autouse=True)
    def _wire(self, wire: Any, make: Any) -> None:
        self.wire, self.maker = wire, make
        self.node = FakeJ1939Node(wire, 0x05, name=7)

    def make(self) -> Any:
        return packets(self.maker, "One", destination=0x05, j1939_name=OWN)

    def commands(self) -> list[Any]:
        return [{"first": 1, "last": 2}]

    async def silence(self, _device: Any) -> None:
        self.node.is_silent = True

    async def speak(self, _device: Any) -> None:
        self.node.is_silent = False

    async def power_cycle(self, _device: Any) -> None:
        self.node.power_cycle()


class TestInPackets(OnNode, GatewayContract, ActuatorContract):
    """Asked for leave, and confirmed."""

    async def silence_by_proxy(self, _device: Any) -> None:
        """A gateway to its network has waited for it in vain."""
        self.node.reason = 3

    async def speak(self, device: Any) -> None:
        await super().speak(device)
        self.node.reason = 0


class TestClaimed(OnNode, ActuatorContract):
    """One frame, by an address that is claimed; nobody answers it."""

    is_heard = False

    def make(self) -> Any:
        return torque(self.maker, j1939_name=OWN, destination=0x05)

    def commands(self) -> list[Any]:
        return [100.0]


async def until_ready(status: Callable[[], Any]) -> None:
    async with asyncio.timeout(10):
        while status().state is not ResourceState.READY:  # noqa: ASYNC110 - a test asks
            await asyncio.sleep(0.01)


async def opened(device: Any) -> Any:
    await device.bus.open()
    await device.open()
    return device


async def closed(device: Any) -> None:
    await device.close()
    await device.bus.close()


async def test_an_address_is_claimed_before_anything_is_said(
    wire: Any, make: Any
) -> None:
    """By the NAME; for a quarter of a second others may object. Several share it."""
    first, second = torque(make, j1939_name=OWN), packets(make, "All", j1939_name=OWN)
    await wire.open()
    begin = asyncio.get_running_loop().time()

    await asyncio.gather(first.open(), second.open())

    assert asyncio.get_running_loop().time() - begin == pytest.approx(0.25)
    assert claims(wire) == [(0x27, OWN)]
    await first.write(10.0)
    await asyncio.sleep(0)
    assert wire.sent[-1].id == TORQUE | 0x27
    await first.close()
    FakeJ1939Node(wire, 0x05).ask_for_claims()
    await asyncio.sleep(0.01)
    assert claims(wire) == [(0x27, OWN)] * 2  # the other one still has it
    await second.close()
    FakeJ1939Node(wire, 0x05).ask_for_claims()
    await asyncio.sleep(0.01)
    assert len(claims(wire)) == 2
    await wire.close()


async def test_an_address_is_defended_against_greater_names(
    wire: Any, make: Any
) -> None:
    """And it is told to who asks for it."""
    device = await opened(torque(make, j1939_name=f"{OWN:016X}"))
    rival = FakeJ1939Node(wire, 0x27, name=OWN + 1)

    rival.claim()
    await asyncio.sleep(0.01)
    rival.ask_for_claims()
    await asyncio.sleep(0.01)

    assert claims(wire) == [(0x27, OWN)] * 3
    await device.write(10.0)
    await closed(device)


@pytest.mark.parametrize("name", [OWN - 1, OWN])
async def test_a_lesser_name_has_the_address(wire: Any, make: Any, name: int) -> None:
    """Then nothing is sent from it, and it is said that none can be claimed."""
    FakeJ1939Node(wire, 0x27, name=name)
    rival = FakeJ1939Node(wire, 0x27, name=name)
    device = torque(make, j1939_name=OWN)
    await wire.open()
    rival.claim()
    opening = asyncio.ensure_future(device.open())
    await asyncio.sleep(0.1)
    rival.claim()

    with pytest.raises(DeviceLostError, match=r"address 39 belongs to the node with"):
        await opening

    assert claims(wire)[-1] == (254, OWN)
    with pytest.raises(DeviceLostError, match="another node has its address"):
        await device.write(1.0)
    assert not [frame for frame in wire.sent if frame.id & ~0xFF == TORQUE]
    await device.close()
    await wire.close()


async def test_a_name_that_may_takes_a_free_address(wire: Any, make: Any) -> None:
    """The first one from 128 on that no lesser NAME has."""
    for address, name in ((0x27, 5), (128, 6), (129, TAKES_ANOTHER + 1)):
        FakeJ1939Node(wire, address, name=name)
    device = torque(make, j1939_name=f"{TAKES_ANOTHER:016X}")
    await wire.open()
    await device.open()

    await device.write(10.0)
    await asyncio.sleep(0)

    assert [address for address, _ in claims(wire)] == [0x27, 128, 129]
    assert wire.sent[-1].id == TORQUE | 129
    await device.close()
    await wire.close()


@pytest.mark.fault("C10")
@pytest.mark.parametrize("own", [OWN, TAKES_ANOTHER])
async def test_an_address_that_is_lost_while_driving_stops_the_commands(
    wire: Any, make: Any, own: int
) -> None:
    """LOST at once; then safe again, from another address or when the rival is gone."""
    rival = FakeJ1939Node(wire, 0x27, name=5)
    rival.is_silent = True
    device = torque(make, j1939_name=f"{own:016X}")

    async with esair.Robot(
        resources=[device], policies=[Policy("engine", allow={"me": Access.WRITE})]
    ) as robot:
        status = partial(robot.resources.query, "engine")
        await until_ready(status)
        right = await robot.resources.register("me", "engine", Access.WRITE)
        await robot.actuators.write(right, 100.0)
        rival.is_silent = False
        rival.claim()
        await asyncio.sleep(0.01)
        assert status().state in {ResourceState.LOST, ResourceState.OPENING}
        sent = len(wire.sent)
        await asyncio.sleep(0.2)
        assert not [
            frame for frame in list(wire.sent)[sent:] if frame.id & ~0xFF == TORQUE
        ]
        rival.is_silent = own == OWN
        await until_ready(status)
        told = [frame for frame in wire.sent if frame.id & ~0xFF == TORQUE]
        assert told[-1].id & 0xFF == (0x27 if own == OWN else 128)
        assert int.from_bytes(told[-1].data[1:3], "little") == 0


async def test_a_message_to_all_is_announced_and_sent_by_the_clock(
    wire: Any, make: Any
) -> None:
    """Nobody is asked; packets are 50 ms apart; the watchdog cannot do that."""
    node = FakeJ1939Node(wire, 0x05)
    device = await opened(packets(make, "All"))
    begin = asyncio.get_running_loop().time()

    await device.write({"first": 1, "last": 2})
    await asyncio.sleep(0)

    (message,) = node.messages
    assert (message.source, message.group) == (0x27, TO_ALL)
    assert (message.data[0], message.data[19], len(message.data)) == (1, 2, 20)
    assert message.time - begin == pytest.approx(0.15, abs=0.01)
    assert device.safe_frames() is None
    await closed(device)


@pytest.mark.parametrize("window", [1, 2, 255])
async def test_one_node_gets_the_packets_that_it_asks_for(
    wire: Any, make: Any, window: int
) -> None:
    """As many as it wants, again what it did not hear, and it may ask to wait."""
    node = FakeJ1939Node(wire, 0x05)
    node.window, node.waits, node.lost = window, 2, {2}
    device = await opened(packets(make, "One", destination=0x05))

    await device.write({"first": 1, "last": 2})

    (message,) = node.messages
    assert (message.group, message.data[0], message.data[19]) == (TO_ONE, 1, 2)
    await closed(device)


@pytest.mark.parametrize(
    ("reason", "error", "told"),
    [
        (1, DeviceLostError, "node 5: it is busy"),
        (2, DeviceLostError, "node 5: it has no room"),
        (3, DeviceLostError, "node 5: it waited for too long"),
        (5, DeviceFaultError, "node 5: packets had to be"),
        (77, DeviceFaultError, "node 5: reason 77"),
    ],
)
async def test_a_node_may_refuse_a_message(
    wire: Any, make: Any, reason: int, error: type[Exception], told: str
) -> None:
    """And says why; busy and silence that a gateway tells of are silence."""
    node = FakeJ1939Node(wire, 0x05)
    node.reason = reason
    device = await opened(packets(make, "One", destination=0x05))

    with pytest.raises(error, match=told):
        await device.write({"first": 1, "last": 2})
    await closed(device)


@pytest.mark.fault("C10")
@pytest.mark.parametrize("wanted", [(1, 0), (4, 1), (2, 3), (1, 255)])
async def test_packets_that_there_are_not_are_refused(
    wire: Any, make: Any, wanted: tuple[int, int]
) -> None:
    """Whatever a broken node asks for."""
    device = await opened(packets(make, "One", destination=0x05))
    wire.on_send(
        lambda frame: (
            esair.buses.Frame(
                0x1CEC2705, bytes([17, *wanted, 255, 255]) + b"\x00\xef\x00", True
            )
            if frame.data[0] == 16
            else None
        )
    )

    with pytest.raises(DeviceFaultError, match="which there are not"):
        await device.write({"first": 1, "last": 2})
    await closed(device)


@pytest.mark.promise("BUS-3")
async def test_a_late_answer_is_not_that_to_the_next_message(
    wire: Any, make: Any
) -> None:
    """A message that is given up is ended, and the next one waits for what is owed."""
    node = FakeJ1939Node(wire, 0x05)
    node.late = 0.05
    device = await opened(packets(make, "One", destination=0x05))
    for given_up in (0.02, 0.07, 0.12):
        writing = asyncio.ensure_future(device.write({"first": 9, "last": 9}))
        await asyncio.sleep(given_up)
        writing.cancel()
        await asyncio.wait({writing})
        node.messages.clear()

        await device.write({"first": 1, "last": 2})

        assert [each.data[0] for each in node.messages] == [1]
    await closed(device)


async def test_a_node_that_does_not_answer_is_told_so(wire: Any, make: Any) -> None:
    """After 1.25 s; the node is told that nothing more comes."""
    device = await opened(packets(make, "One", destination=0x05))

    with pytest.raises(DriverStuckError, match="answer to a message of 20 bytes"):
        await device.write({"first": 1, "last": 2})
    await asyncio.sleep(0.01)

    assert wire.sent[-1].data[0] == 255
    await closed(device)


@pytest.mark.parametrize(
    ("keywords", "told"),
    [
        ({"message": "Torque", "j1939_name": "xyz"}, "expected 64 bits"),
        ({"message": "Torque", "j1939_name": 1 << 64}, "expected 64 bits"),
        ({"message": "Torque", "j1939_name": True}, "expected 64 bits"),
        ({"message": "Short", "j1939_name": 5}, "has an id of 11 bits"),
    ],
)
def test_a_name_that_is_none_is_told(
    make: Any, keywords: dict[str, Any], told: str
) -> None:
    """When the device is made."""
    signal = "y" if keywords["message"] == "Short" else "limit"
    with pytest.raises(ConfigError, match=told):
        make(signal=signal, safe=0.0, **keywords)


async def test_one_name_has_one_address(make: Any, wire: Any) -> None:
    """Two devices that want different ones are a mistake of the robot."""
    await wire.open()
    first = torque(make, j1939_name=OWN)
    await first.open()
    second = make(
        message="Torque", signal="limit", safe=0.0, source=0x28, j1939_name=OWN
    )
    with pytest.raises(ConfigError, match="has the address 39 already, not 40"):
        await second.open()
    await first.close()
    await wire.close()


@pytest.mark.promise("SC-3")
async def test_what_stays_unavailable_is_lost(wire: Any, tmp_path: Path) -> None:
    """The last value would be current for ever; it is back with the next one."""
    (database := tmp_path / "engine.dbc").write_text(FILE)
    limit = DbcSensor(
        name="limit", bus=wire, database=database, message="Torque", signal="limit"
    )

    async def feed(raw: int) -> None:
        data = b"\0" + raw.to_bytes(2, "little") + bytes(5)
        wire.feed(0x0C000027, data, extended=True)
        await asyncio.sleep(0.1)

    async with esair.Robot(resources=[limit]) as robot:
        states = []
        for raw in (0xFAFF, *[0xFF00] * 200):
            await feed(raw)
            states.append(robot.resources.query("limit").state)
        assert states[:3] == [ResourceState.READY] * 3
        assert set(states[50:]) == {ResourceState.LOST}
        for _ in range(60):
            await feed(0xFAFF)
        assert robot.resources.query("limit").state is ResourceState.READY


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize("raw", [0xFE00, 0xFEFF, 0xFF00, 0xFFFF])
async def test_what_is_not_available_is_no_value(
    wire: Any, tmp_path: Path, raw: int
) -> None:
    """Nor is an error: both are numbers beyond the greatest of a signal."""
    (database := tmp_path / "engine.dbc").write_text(FILE)
    limit = DbcSensor(
        name="limit", bus=wire, database=database, message="Torque", signal="limit"
    )
    whole = DbcSensor(name="whole", bus=wire, database=database, message="Torque")
    user = esair.Behavior(
        name="user",
        reads={"limit": esair.reads(float), "whole": esair.reads(dict)},
        writes={},
    )
    async with esair.Robot(resources=[limit, whole], behaviors=[user]):
        for told in (0xFAFF, raw):
            data = b"\0" + told.to_bytes(2, "little") + bytes(5)
            wire.feed(0x0C000027, data, extended=True)
            await asyncio.sleep(0.01)
        assert await user.limit.read() == 8031.875
        assert (await user.limit.reading()).sequence == 1
        assert await user.whole.read() == {}


@pytest.mark.parametrize(
    ("extra", "expected"), [("", "fe91ff"), ('BA_ "GenSigStartValue" SG_', "de9101")]
)
async def test_what_is_not_commanded_is_not_available(
    wire: Any, tmp_path: Path, extra: str, expected: str
) -> None:
    """Zeros would be commands too (SAE J1939-71), such as to brake with nothing."""
    lines = [
        "BO_ 2566834174 Demand: 3 Engine",
        ' SG_ mode : 0|2@1+ (1,0) [0|3] "" Engine',
        ' SG_ prio : 4|2@1+ (1,0) [0|2] "" Engine',
        ' SG_ torque : 8|8@1+ (1,-125) [-125|125] "%" Engine',
        ' SG_ speed : 16|8@1+ (0.5,10) [10|135] "rpm" Engine',
        'BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 255;',
        'BA_DEF_DEF_ "GenSigStartValue" 0;',
        'BA_ "VFrameFormat" BO_ 2566834174 3;',
        'VAL_ 2566834174 prio 1 "high" 2 "low" ;',
    ]
    if extra:
        lines += [f"{extra} 2566834174 prio 1;", f"{extra} 2566834174 speed 1;"]
    text = FILE.replace("BO_ 5 ", "\n".join(lines[:5]) + "\nBO_ 5 ")
    (database := tmp_path / "engine.dbc").write_text(text + "\n".join(lines[5:]))
    engine = DbcActuator(
        name="engine",
        bus=wire,
        database=database,
        message="Demand",
        signal="torque",
        fixed={"mode": 2},
        safe=0.0,
    )
    await wire.open()
    await engine.open()
    await engine.write(20.0)
    await asyncio.sleep(0.01)
    assert wire.sent[-1].data.hex() == expected
    await engine.close()
    await wire.close()


def test_what_is_fixed_is_within_the_limits_of_the_file(make: Any) -> None:
    """Of a message of J1939, too, where "not available" is beyond them."""
    with pytest.raises(ConfigError, match="first: expected 0 to 250, not 251"):
        make(message="All", signal="last", safe=0, fixed={"first": 251})


async def test_a_message_that_its_receiver_holds_is_heard_to_its_end(
    wire: Any, tmp_path: Path
) -> None:
    """It says so every half second, and the sender may wait for it (J1939-21)."""
    (database := tmp_path / "engine.dbc").write_text(FILE)
    one = DbcSensor(name="one", bus=wire, database=database, message="One")
    user = esair.Behavior(name="user", reads={"one": esair.reads(dict)}, writes={})

    def say(place: int, ends: int, data: str) -> None:
        wire.feed(7 << 26 | place << 16 | ends, bytes.fromhex(data), extended=True)

    async with esair.Robot(resources=[one], behaviors=[user]):
        say(0xEC, 0x0527, "10140003ff00ef00")
        for _ in range(3):
            await asyncio.sleep(0.5)
            say(0xEC, 0x2705, "1100ffffff00ef00")
        await asyncio.sleep(0.5)
        say(0xEC, 0x2705, "110301ffff00ef00")
        for number in (1, 2, 3):
            say(0xEB, 0x0527, bytes([number] * 8).hex())
        await asyncio.sleep(0.1)
        assert await user.one.read() == {"first": 1, "last": 3}
