"""Requests that go on from robot to robot."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator
from typing import Any

import pytest
from tests.net.parts import Dock, Docked, Docking, Idle
from tests.net.test_parts import Asks

import esair
from esair.buses.peer import FakeNetwork, PeerBus
from esair.drivers.peer import Peer, PeerActuator
from esair.peers import Share, Sharing, peer_behavior

pytestmark = pytest.mark.virtual_clock


class Three:
    """Robots a, b and c; each asks the next one, and shares with the one before."""

    def __init__(self) -> None:
        self.network = FakeNetwork()
        self.buses: dict[tuple[str, str], PeerBus] = {}
        self.workers: dict[str, Any] = {}
        ring = "abca"
        for me, other in itertools.permutations("abc", 2):
            bus = PeerBus(name=other, network=self.network.of(me))
            for kind in (Dock, Docked):
                bus.declare(kind)
            self.buses[me, other] = bus
        self.next = dict(itertools.pairwise(ring))
        self.before = {other: me for me, other in self.next.items()}
        for me in "abc":
            worker = Asks(name=f"dock_{me}", other=f"dock_{self.next[me]}")
            self.workers[me] = worker

    def robot(self, me: str, *behaviors: Any) -> esair.Robot:
        """One of them."""
        to, of = self.next[me], self.before[me]
        theirs = peer_behavior(f"dock_{to}", self.buses[me, to], [Dock])
        share = Share(f"dock_{me}", "ask")
        return esair.Robot(
            name=me,
            resources=[Peer(name=o, bus=self.buses[me, o]) for o in (to, of)],
            behaviors=[
                *(*behaviors, self.workers[me], theirs),
                Sharing(bus=self.buses[me, of], shares=[share]),
            ],
        )

    @contextlib.asynccontextmanager
    async def all(self, *behaviors: Any) -> AsyncIterator[None]:
        """Run them."""
        async with self.robot("a", *behaviors), self.robot("b"), self.robot("c"):
            await asyncio.sleep(1.0)
            yield


@pytest.mark.promise("BS-5", "NET-2")
@pytest.mark.parametrize("bays", [1, 2, 3, 9])
async def test_a_circle_over_three_robots_is_refused_at_once(bays: int) -> None:
    """Where it closes: a chain that ends before is answered, and so is the next ask."""
    three, idle = Three(), Idle()
    async with three.all(idle):
        asked = idle.ask("dock_a", Dock(bays), timeout=None)
        async with asyncio.timeout(1.0):
            if bays < 3:
                assert await asked == Docked(0)
                return
            with pytest.raises(esair.EsairError, match="dock_a -> dock_b -> dock_a"):
                await asked
        assert await idle.ask("dock_a", Dock(2), timeout=1.0) == Docked(0)


class AsksTwice(Asks):
    """It has a second loop for the same requests."""

    orders = esair.takes(Dock)
    dock = None  # type: ignore[assignment]

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            for _ in range(2):
                tasks.create_task(self.work())

    async def work(self) -> None:
        """Answer as the other does."""
        async for request in self.orders:
            async with request:
                request.answer(await Asks.dock(self, request.data))


@pytest.mark.promise("BS-5", "NET-2")
async def test_over_three_robots_a_second_loop_may_be_asked_back() -> None:
    """Refused is what would wait for ever, not a name that comes twice."""
    three, idle = Three(), Idle()
    three.workers["a"] = AsksTwice(name="dock_a", other="dock_b")
    async with three.all(idle):
        assert await idle.ask("dock_a", Dock(3), timeout=1.0) == Docked(0)


@pytest.mark.promise("NET-3")
async def test_an_answer_that_is_lost_two_robots_away_is_not_known() -> None:
    """Whoever handed the request on does not know what became of it, either."""
    three, idle, docking = Three(), Idle(), Docking(name="dock_c")
    three.workers["c"] = docking
    async with three.all(idle):
        asking = asyncio.ensure_future(idle.ask("dock_a", Dock(9), timeout=None))
        await asyncio.sleep(0.2)
        three.network.cut("c")
        with pytest.raises(esair.OutcomeUnknownError):
            await asking


@pytest.mark.promise("NET-3")
async def test_why_an_actuator_is_gone_does_not_grow_in_a_circle() -> None:
    """Two robots whose actuators are each other's are lost for good, and no more."""
    network = FakeNetwork()
    robots = []
    for me, other in ("ab", "ba"):
        bus = PeerBus(name=other, network=network.of(me))
        wheels = PeerActuator(name="wheels", bus=bus)
        share = Share("wheels", "write")
        peer, sharing = Peer(name=other, bus=bus), Sharing(bus=bus, shares=[share])
        robots.append(
            esair.Robot(name=me, resources=[peer, wheels], behaviors=[sharing])
        )
    async with robots[0], robots[1]:
        await asyncio.sleep(200.0)
        for robot in robots:
            error = robot.resources.query("wheels").error
            assert "says: " in str(error)
            assert len(str(error)) < 600
