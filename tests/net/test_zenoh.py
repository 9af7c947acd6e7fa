"""The same over zenoh itself, on this machine: TCP, TLS, and who is kept out."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Container
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.net.certificates import certify, tls
from tests.net.parts import Dock, Docking, Hand, Pair, Twist, free_port

import esair
from esair.buses.peer import Network, PeerBus, Tls, _line, _zenoh
from esair.buses.peer._wire import LIMIT
from esair.drivers.peer import PeerSensor

pytest.importorskip("zenoh")
pytestmark = [pytest.mark.real_clock, pytest.mark.xdist_group("zenoh")]


READY = esair.ResourceState.READY


def over(pair: Pair, base: Network, rover: Network) -> Pair:
    """Put a pair on a network of its own."""
    pair.to_rover = PeerBus(name="rover", network=base)
    for kind in (Twist, Docking):
        pair.to_rover.declare(kind)
    pair.to_base = PeerBus(name="base", network=rover)
    return pair


def on_tcp() -> Pair:
    end = f"tcp/127.0.0.1:{free_port()}"
    base = Network(me="base", peers=["rover"], listen=[end])
    return over(Pair(), base, Network(me="rover", peers=["base"], connect=[end]))


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates of one authority, one that is over, and those of another one."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not there to make certificates")
    folder = tmp_path_factory.mktemp("certificates")
    certify(folder)
    return folder


async def is_ready(
    robot: esair.Robot, name: str, within: float, *, wanted: bool = True
) -> bool:
    """Wait until something is ready, or is not; tell whether it came to that."""
    end = time.monotonic() + within
    while (robot.resources.query(name).state is READY) is not wanted:
        if time.monotonic() > end:
            return False
        await asyncio.sleep(0.01)
    return True


async def use(pair: Pair, hand: Hand, rover: Any, writes: int = 20) -> float:
    """Use everything of the peer; return how long a write and its answer take."""
    assert await is_ready(rover, "far_wheels", 3.0), rover.resources.query("base").error
    assert await is_ready(rover, "far_sonar", 3.0)
    pair.docking.go.set()
    for _ in range(5):  # this machine may be busy: then a connection is made anew
        with contextlib.suppress(esair.OutcomeUnknownError):
            assert (await hand.ask("far_docking", Dock(2))).bay == 2
            break
    took = []
    for number in range(writes):
        begun = time.perf_counter()
        if await hand.wheels.write(Twist(0.01 * number, 0.0)):
            took.append(time.perf_counter() - begun)
        await asyncio.sleep(0.002)
    assert len(took) > writes / 2
    return statistics.median(took)


@pytest.mark.promise("NET-2")
async def test_tcp() -> None:
    """Sensor, actuator and behavior of a peer on this machine."""
    pair, hand = on_tcp(), Hand()
    async with pair.base(), pair.rover(hand) as rover:
        await use(pair, hand, rover)


async def test_who_opens_the_network_has_it() -> None:
    """The first opening is one: it does not take a second one."""
    network = Network(me="base", listen=[f"tcp/127.0.0.1:{free_port()}"])
    bus = PeerBus(name="rover", network=network)
    send = await network.join(bus)
    send("beat", b"")
    await network.leave(bus)


@pytest.mark.promise("RS-8", "NET-2")
async def test_a_second_bus_to_a_peer_is_a_mistake_that_hurts_nobody() -> None:
    """It would take away what the first one hears, and lose all parts of the peer."""
    pair, hand = on_tcp(), Hand()
    async with pair.base(), pair.rover(hand) as rover:
        await use(pair, hand, rover)
        other = PeerBus(name="base", network=pair.to_base.network)
        again = PeerSensor(name="again", remote="sonar", bus=other, type=float)
        with pytest.raises(esair.ConfigError, match="give that to all its parts"):
            await other.open()
        with contextlib.suppress(esair.EsairError):
            await rover.resources.add(again)
        await asyncio.sleep(0.5)
        await use(pair, hand, rover)
        assert rover.resources.query("base").losses == 0


@pytest.mark.promise("NET-6")
async def test_a_huge_message_is_not_put_together() -> None:
    """It would be in memory as a whole before this robot could say no."""
    pair = on_tcp()
    async with pair.base(), pair.rover() as rover:
        assert await is_ready(rover, "far_wheels", 5.0)
        send: Any = pair.to_base._send
        send("write", bytes(LIMIT + 1))
        async with asyncio.timeout(5.0):
            while pair.to_rover.stats.dropped == 0:  # noqa: ASYNC110 - it has no event
                await asyncio.sleep(0.01)
        await asyncio.sleep(0.5)  # it may come by several ways
        dropped = pair.to_rover.stats.dropped
        send("write", bytes(16 * LIMIT))
        await asyncio.sleep(0.5)
        assert await is_ready(rover, "far_wheels", 5.0)
        assert pair.to_rover.stats.dropped == dropped


@pytest.mark.promise("NET-3")
async def test_the_owner_comes_later_and_again() -> None:
    """The network is there before the peer; a session that was closed is opened again."""
    pair, hand = on_tcp(), Hand()
    async with pair.rover(hand) as rover:
        for _ in range(2):
            async with pair.base():
                await use(pair, hand, rover, 3)
            # Else the next round could take the parts of the last one for its own.
            assert await is_ready(rover, "far_wheels", 3.0, wanted=False)
            again = Pair()
            again.network, pair.wheels, pair.sonar = (
                pair.network,
                again.wheels,
                again.sonar,
            )
            pair.docking = again.docking
            bus = PeerBus(name="rover", network=pair.to_rover.network)
            for kind in (Twist, Docking):
                bus.declare(kind)
            pair.to_rover = bus


KEEP_ALIVE = b"\x01\x00\x04"
"""What zenoh says when it has nothing to say."""


class Relay:
    """Carries connections to a port; those in `mute` are taken, and never answered.

    Of those in `half` who connects hears that it is connected, and that the other one lives.
    While it is held all are taken, and what they say is carried later.
    """

    def __init__(
        self, port: int, *, mute: Container[int] = (), half: Container[int] = ()
    ) -> None:
        self.port = port
        self.mute = mute
        self.half = half
        self.here = free_port()
        self.goes = asyncio.Event()
        self.goes.set()
        self.ends: list[list[asyncio.StreamWriter]] = []
        """Of each connection its two ends."""

    async def __aenter__(self) -> Relay:
        self._server = await asyncio.start_server(self._take, "127.0.0.1", self.here)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for _turn in range(3):  # what is being taken has its ends in a later turn
            for number in range(len(self.ends)):
                self.cut(number)
            await asyncio.sleep(0.05)

    def cut(self, number: int) -> None:
        for end in self.ends[number]:
            end.transport.abort()

    def open(self) -> list[int]:
        """Return which connections carry something."""
        return [
            number
            for number, ends in enumerate(self.ends)
            if len(ends) == 2 and not any(end.is_closing() for end in ends)
        ]

    async def _take(self, reader: Any, writer: Any) -> None:
        number, ends = len(self.ends), [writer]
        self.ends.append(ends)
        if number in self.mute:
            return
        await self.goes.wait()
        try:
            there, to = await asyncio.open_connection("127.0.0.1", self.port)
        except OSError:
            writer.close()
            return
        ends.append(to)
        back = self._carry_half if number in self.half else self._carry
        await asyncio.gather(self._carry(reader, to), back(there, writer))

    async def _carry(self, reader: Any, writer: Any) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(1 << 16):
                await self.goes.wait()
                writer.write(data)
        writer.close()

    async def _carry_half(self, reader: Any, writer: Any) -> None:
        with contextlib.suppress(OSError, EOFError):
            for count in itertools.count():
                size = await reader.readexactly(2)
                data = await reader.readexactly(int.from_bytes(size, "little"))
                writer.write(size + data if count < 2 else KEEP_ALIVE)
        writer.close()


def through(relay: Relay, certificates: Path | None = None) -> Pair:
    """Put a pair on a network whose connections a relay carries."""
    kind = "tcp" if certificates is None else "tls"
    base, rover = (
        Network(
            me=me,
            peers=[peer],
            listen=[f"{kind}/127.0.0.1:{relay.port}"] if me == "base" else (),
            connect=[f"{kind}/127.0.0.1:{relay.here}"] if me == "rover" else (),
            tls=None if certificates is None else tls(certificates, me),
        )
        for me, peer in (("base", "rover"), ("rover", "base"))
    )
    return over(Pair(), base, rover)


async def again(hand: Hand, within: float) -> float:
    """Wait until a command is taken; return how long that took."""
    begin = time.monotonic()
    while time.monotonic() - begin < within:
        with contextlib.suppress(esair.EsairError):
            if await hand.wheels.write(Twist(0.1, 0.0)):
                break
        await asyncio.sleep(0.01)
    return time.monotonic() - begin


@pytest.mark.promise("NET-3")
@pytest.mark.parametrize(
    "wrong", [{"mute": range(3)}, {"half": range(3)}], ids=["mute", "half"]
)
async def test_a_try_that_fails_holds_nobody_up(wrong: dict[str, Any]) -> None:
    """Half a connection stays: zenoh does not know. There are others beside it."""
    async with Relay(free_port(), **wrong) as relay:
        pair, hand = through(relay), Hand()
        async with pair.base(), pair.rover(hand) as robot:
            await use(pair, hand, robot)
            await asyncio.sleep(1.5)
            await use(pair, hand, robot)


@pytest.mark.promise("NET-3")
@pytest.mark.parametrize("cut", [0, 1])
async def test_a_connection_that_breaks_has_another_one_beside_it(
    cut: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two stay when all is well, and one is enough, also when no new one is to be had."""
    monkeypatch.setattr(_line, "_CLOSED", 1.2)
    async with Relay(free_port()) as relay:
        pair, hand = through(relay), Hand()
        async with pair.base(), pair.rover(hand) as robot:
            await use(pair, hand, robot)
            await asyncio.sleep(2.0)
            for _ in range(100):  # a busy computer may have opened more
                if len(two := relay.open()) == 2:
                    break
                await asyncio.sleep(0.1)
            assert len(two) == 2
            relay.mute = range(len(relay.ends), 1000)
            relay.cut(two[cut])
            await asyncio.sleep(0.05)
            assert await again(hand, 2.0) < 1.0
            await asyncio.sleep(1.5)  # longer than a peer may be silent
            await use(pair, hand, robot)


@pytest.mark.promise("NET-3")
@pytest.mark.parametrize("seconds", [0.6, 3.0])
async def test_a_peer_that_was_stopped_has_little_to_refuse(
    certificates: Path, seconds: float
) -> None:
    """It takes what was begun meanwhile, one after the other, before anything new."""
    async with Relay(free_port()) as relay:
        pair, hand = through(relay, certificates), Hand()
        async with pair.base(), pair.rover(hand) as robot:
            await use(pair, hand, robot)
            relay.goes.clear()
            await asyncio.sleep(seconds)
            relay.goes.set()
            assert await again(hand, 10.0) < 1.0


DEAD = """
import sys, time
from esair.buses.peer import Network
from esair.buses.peer._zenoh import _Session
network = Network(me="rover", peers=["base"], connect=sys.argv[1:])
ways = [_Session(network, None, connect=sys.argv[1:]) for _ in range(20)]
print("there", flush=True)
time.sleep(60.0)
"""
"""Twenty ways, as of ten robots that are all behind one access point."""


@pytest.mark.long
@pytest.mark.promise("NET-3")
async def test_who_is_back_is_heard_while_many_ways_are_closed() -> None:
    """Each holds a thread of zenoh up for seconds, until what was sent by it is lost."""
    pair, hand = on_tcp(), Hand()
    ends = pair.to_base.network.connect  # type: ignore[attr-defined]
    async with pair.base():
        dead = await asyncio.create_subprocess_exec(
            sys.executable, "-c", DEAD, *ends, stdout=subprocess.PIPE
        )
        try:
            assert dead.stdout is not None
            await dead.stdout.readline()
            await asyncio.sleep(0.5)
            dead.send_signal(signal.SIGSTOP)
            for _ in range(20):  # more than it takes while it stands still
                pair.to_rover.say("reading", "any", 0.0, "x" * 50_000)
                await asyncio.sleep(0.05)
            await asyncio.sleep(10.5)  # zenoh gives up after ten seconds
            async with pair.rover(hand) as rover:
                assert await is_ready(rover, "far_wheels", 4.0)
        finally:
            dead.kill()
            await dead.wait()


async def test_nothing_is_left_of_ways_that_nobody_answers() -> None:
    """Each is closed when its try is over, and the robot does not wait for that."""
    before = threading.active_count()
    async with Relay(free_port()) as relay:
        relay.goes.clear()
        pair = through(relay)
        async with pair.rover():
            await asyncio.sleep(0.5)
            assert len(relay.ends) > 2
            begin = time.monotonic()
        assert time.monotonic() - begin < 1.0
        await asyncio.sleep(1.5)
        assert threading.active_count() <= before
        relay.goes.set()


@pytest.mark.promise("NET-1", "NET-5")
async def test_tls(certificates: Path) -> None:
    """With certificates of one authority everything is as without."""
    end = f"tls/127.0.0.1:{free_port()}"
    base = Network(
        me="base", peers=["rover"], listen=[end], tls=tls(certificates, "base")
    )
    rover = Network(
        me="rover", peers=["base"], connect=[end], tls=tls(certificates, "rover")
    )
    pair, hand = over(Pair(), base, rover), Hand()
    async with pair.base(), pair.rover(hand) as robot:
        await use(pair, hand, robot)


@pytest.mark.promise("NET-1")
@pytest.mark.parametrize(
    ("ca", "certificate", "key", "told"),
    [
        ("ca.pem", "thief.pem", "thief.key", "that of 'rover', not of 'thief'"),
        ("ca.pem", "rover.pem", "thief.key", "tls.key: expected the private key"),
        ("ca.pem", "rover.key", "rover.pem", "tls.certificate: expected the cert"),
        ("ca.key", "rover.pem", "rover.key", "tls.ca: expected the certificate"),
        ("ca.pem", "rover.pem", "none.key", "tls.key: there is no file"),
    ],
)
def test_wrong_certificates_are_named(
    certificates: Path, ca: str, certificate: str, key: str, told: str
) -> None:
    """Before anything is opened: with them the network would be silent, and no more."""
    files = Tls(*(certificates / each for each in (ca, certificate, key)))
    with pytest.raises(esair.ConfigError, match=told):
        Network(me="rover", connect=["tls/127.0.0.1:9"], tls=files)


async def test_a_port_that_is_taken_is_named() -> None:
    """In words for who has it, not in those of who wrote zenoh."""
    port = free_port()
    network = Network(me="base", peers=["rover"], listen=f"tcp/127.0.0.1:{port}")
    bus = PeerBus(name="rover", network=network)
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        with pytest.raises(esair.DeviceLostError, match="another program") as lost:
            await bus.open()
    assert f"127.0.0.1:{port}" in str(lost.value)
    assert ".rs" not in str(lost.value)
    await bus.close()


@pytest.mark.promise("NET-5")
@pytest.mark.parametrize("who", ["thief", "other-rover", "expired", "nobody"])
@pytest.mark.parametrize("tries", [1, pytest.param(50, marks=pytest.mark.soak)])
async def test_who_has_not_the_certificate_is_not_heard(
    certificates: Path, who: str, tries: int
) -> None:
    """Another robot of the authority, another one, over, none: nothing gets in."""
    for _ in range(tries):
        await refused(certificates, who)


class Thief(Network):
    """Opens the network, whatever the time is."""

    def _check_days(self, tls: Tls, owner: str) -> None:
        pass


@pytest.mark.promise("NET-3")
async def test_a_certificate_of_other_days_is_named(certificates: Path) -> None:
    """Or a clock that is wrong: it is tried again, until one of them is right."""
    mine = tls(certificates, "rover")
    end = f"tls/127.0.0.1:{free_port()}"
    network = Network(me="rover", peers=["base"], listen=end, tls=mine)
    network.tls = tls(certificates, "expired")
    bus = PeerBus(name="base", network=network)
    with pytest.raises(esair.DeviceLostError, match="GMT; by this clock it is"):
        await bus.open()
    network.tls = mine
    with pytest.raises(esair.DeviceLostError, match="no beat of it was heard"):
        await bus.open()
    await bus.close()


@pytest.mark.promise("NET-3", "NET-5")
async def test_a_certificate_that_is_over_meanwhile_is_named(
    certificates: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose day has come hears nobody any more, until its clock is right."""
    later = 0.0
    clock = SimpleNamespace(**{**vars(time), "time": lambda: time.time() + later})
    monkeypatch.setattr(_zenoh, "time", clock)
    async with Relay(free_port()) as relay:
        pair, hand = through(relay, certificates), Hand()
        async with pair.base(), pair.rover(hand) as robot:
            await use(pair, hand, robot, 3)
            later = 10.0 * 86_400.0
            assert await is_ready(robot, "far_wheels", 3.0, wanted=False)
            assert "GMT; by this clock it is" in str(
                robot.resources.query("base").error
            )
            later = 0.0
            await use(pair, hand, robot, 3)


async def refused(certificates: Path, who: str) -> None:
    """Let somebody try to get in, with all that the robot has for it."""
    end = f"tls/127.0.0.1:{free_port()}"
    mine = tls(certificates, "base")
    base = Network(me="base", peers=["rover"], listen=[end], tls=mine)
    file = "rover" if who == "nobody" else who
    mine = tls(certificates, "rover")
    rover: Network = Thief(me="rover", peers=["base"], connect=[end], tls=mine)
    rover.tls = tls(certificates, file)
    if who == "nobody":
        rover = Network(me="rover", peers=["base"], connect=[end.replace("tls", "tcp")])
    pair, hand = over(Pair(), base, rover), Hand()
    async with pair.base(), pair.rover(hand) as robot:
        assert not await is_ready(robot, "far_wheels", 0.7)
        assert pair.to_rover.stats.received == 0
        assert pair.to_base.stats.received == 0
