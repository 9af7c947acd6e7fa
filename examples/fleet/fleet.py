"""Three simulated carriers and one charger: they ask each other before they go there.

Each robot is whole: it has its own battery and wheels, and works alone. What the others may
use of it is named. Here the network is one in memory; with `Network` in its place each robot
is a program of its own, on any computer.
"""

from __future__ import annotations

import asyncio

import attrs

import esair
from esair.buses.peer import FakeNetwork, PeerBus, PeerNetwork
from esair.drivers.peer import Peer, PeerSensor
from esair.peers import Share, Sharing, peer_behavior

NAMES = ("ada", "ben", "cy")
LOW, FULL = 0.3, 0.95


@attrs.frozen
class Yours:
    """The charger is yours."""


@attrs.frozen
class MayI(esair.Request[Yours]):
    """May I have the charger? I have so much left."""

    charge: float


class Battery(esair.Sensor[float]):
    """Its charge, from 0 to 1: it drains, or is charged."""

    rate = 10.0

    def __init__(self, charge: float) -> None:
        super().__init__()
        self.charge = charge
        self.is_charging = False

    async def read(self) -> float:
        step = 0.02 if self.is_charging else -0.005
        self.charge = max(0.0, min(1.0, self.charge + step))
        return self.charge


class Manners(esair.Behavior):
    """Answers the others: no, if it charges, or needs it more."""

    battery = esair.reads(float)

    def __init__(self, cell: Battery) -> None:
        super().__init__()
        self.cell = cell

    @esair.answers
    async def may_i(self, request: MayI) -> Yours:
        mine = await self.battery.read()
        if self.cell.is_charging:
            raise esair.RefusedError("I am charging")
        if mine < LOW and mine < request.charge:
            raise esair.RefusedError(f"I have {mine:.0%} only")
        return Yours()


class Carry(esair.Behavior):
    """Carries; charges when the battery is low and nobody minds."""

    battery = esair.reads(float)

    def __init__(self, cell: Battery, others: list[str]) -> None:
        super().__init__()
        self.cell = cell
        self.others = others
        self.charged = 0
        self.asked = 0

    async def run(self) -> None:
        async for charge in self.battery:
            if self.cell.is_charging and charge > FULL:
                self.cell.is_charging = False
                self.charged += 1
            elif not self.cell.is_charging and charge < LOW:
                self.cell.is_charging = await self.all_let_me(charge)

    async def all_let_me(self, charge: float) -> bool:
        self.asked += 1
        for other in self.others:
            try:
                await self.ask(f"{other}_manners", MayI(charge), timeout=1.0)
            except esair.EsairError:  # no; or it is not there, and may be charging
                return False
        return True


def carrier(name: str, charge: float, network: PeerNetwork) -> esair.Robot:
    """Return one of them, on the network."""
    cell = Battery(charge)
    resources: list[esair.Resource] = [cell]
    behaviors: list[esair.Behavior] = [Manners(cell)]
    others = [each for each in NAMES if each != name]
    for other in others:
        bus = PeerBus(name=other, network=network)
        bus.declare(MayI)
        bus.declare(Yours)
        far = PeerSensor(name=f"{other}_battery", remote="battery", bus=bus, type=float)
        resources += [Peer(name=other, bus=bus), far]
        behaviors.append(
            peer_behavior(f"{other}_manners", bus, [MayI], remote="manners")
        )
        shares = [Share("battery", "read", rate=2.0), Share("manners", "ask")]
        behaviors.append(Sharing(bus=bus, shares=shares))
    behaviors.append(Carry(cell, others))
    return esair.Robot(name=name, resources=resources, behaviors=behaviors)


def fleet() -> tuple[FakeNetwork, list[esair.Robot]]:
    """Return the three of them, and the network between them."""
    network = FakeNetwork(delay=0.01)
    charges = (0.5, 0.45, 0.4)
    pairs = zip(NAMES, charges, strict=True)
    return network, [carrier(name, each, network.of(name)) for name, each in pairs]


async def main(seconds: float = 60.0) -> None:
    """Run them, and say who has charged."""
    _, robots = fleet()
    ada, ben, cy = robots
    async with ada, ben, cy:
        await asyncio.sleep(seconds)
        for robot in robots:
            carry = robot.behaviors.action("carry")
            assert isinstance(carry, Carry)
            print(f"{robot.name}: {carry.charged} times charged, asked {carry.asked}")


if __name__ == "__main__":
    asyncio.run(main())
