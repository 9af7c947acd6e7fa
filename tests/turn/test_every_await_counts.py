"""Every await of a port and of a behavior counts: also one that is refused at once."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

import attrs
import pytest

import esair

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("TURN-4")]

AWAITS = 500


@attrs.frozen
class Dock(esair.Request[int]):
    """Something to be asked."""


class Wheels(esair.Actuator[float]):
    safe = 0.0
    blocking = False
    speed = esair.setting(1.0)

    def write(self, command: float) -> None:
        return None

    @esair.operation
    async def home(self) -> int:
        return 1


class Sonar(esair.Sensor[float]):
    rate = 50.0

    def read(self) -> float:
        return 1.0


class Peer(esair.Behavior):
    dock = esair.takes(Dock)

    async def run(self) -> None:
        async for order in self.dock:
            order.answer(1)

    async def provide(self) -> int:
        return 1


class Spinner(esair.Behavior):
    """Does the same again and again, and sees how often others get the loop."""

    wheels = esair.writes(float)
    sonar = esair.reads(float)
    do: Callable[[Any], Awaitable[object]]
    robot: esair.Robot
    turns = 0
    done: asyncio.Future[int]

    async def run(self) -> None:
        await self.sonar.read(fresh=True)
        self.gone: Any = await self.register("gone", esair.Access.READ)
        await self.robot.resources.remove("gone")
        self.turns = 0
        for _ in range(AWAITS):
            with contextlib.suppress(esair.EsairError):
                await type(self).do(self)
        self.done.set_result(self.turns)
        await asyncio.get_running_loop().create_future()


async def follow(port: Any) -> None:
    async for _ in port:
        return


VERBS: dict[str, Callable[[Any], Awaitable[object]]] = {
    "read": lambda me: me.sonar.read(),
    "write": lambda me: me.wheels.write(1.0),
    "release": lambda me: me.wheels.release(),
    "configure": lambda me: me.wheels.configure(speed=2.0),
    "configure nonsense": lambda me: me.wheels.configure(nonsense=2.0),
    "configure without the right": lambda me: me.sonar.configure(rate=2.0),
    "operate": lambda me: me.wheels.operate("home"),
    "operate nonsense": lambda me: me.wheels.operate("nonsense"),
    "ask": lambda me: me.ask("peer", Dock()),
    "ask nobody": lambda me: me.ask("nobody", Dock()),
    "get": lambda me: me.get("peer"),
    "get from nobody": lambda me: me.get("nobody"),
    "put to nobody": lambda me: me.put("nobody", 1),
    "receive with nonsense": lambda me: me.receive(timeout=-1.0),
    "register": lambda me: me.register("sonar", esair.Access.READ),
    "register for nothing": lambda me: me.register("nothing", esair.Access.READ),
    "perform nonsense": lambda me: me.perform(object()),
    "follow what is gone": lambda me: follow(me.gone),
    "read what is gone": lambda me: me.gone.read(),
    "add without the right": lambda me: me.supervisor.add(Peer(name="other")),
    "remove nobody": lambda me: me.robot.behaviors.remove("nobody"),
    "add nothing": lambda me: me.robot.resources.add(object()),
    "type nonsense": lambda me: me.robot.behaviors.command("nonsense"),
    "type it elsewhere": lambda me: me.robot.resources.command("nonsense"),
}


@pytest.mark.parametrize("verb", VERBS)
async def test_others_get_the_loop(verb: str) -> None:
    """However it ends, a loop over it leaves a turn to others every few awaits."""
    spinner = Spinner()
    spinner.done = asyncio.get_running_loop().create_future()
    Spinner.do = VERBS[verb]
    write = esair.Access.WRITE | esair.Access.CONFIGURE
    robot = esair.Robot(
        resources=[Wheels(), Sonar(), Sonar(name="gone")],
        behaviors=[spinner, Peer()],
        policies=[esair.Policy("wheels", allow={"spinner": write})],
    )
    spinner.robot = robot

    async def count() -> None:
        while True:
            await asyncio.sleep(0)
            spinner.turns += 1

    async with robot:
        counting = asyncio.ensure_future(count())
        turns = await spinner.done
        counting.cancel()
    assert turns >= AWAITS / 100


class Insists(esair.Behavior):
    """Takes no error for an answer."""

    sonar = esair.reads(float)
    robot: esair.Robot

    async def run(self) -> None:
        while True:
            with contextlib.suppress(esair.EsairError):
                await follow(self.sonar)
            with contextlib.suppress(esair.EsairError):
                await self.robot.behaviors.remove("nobody")


@pytest.mark.promise("SUP-3", "SUP-5")
async def test_who_goes_on_without_its_sensor_can_be_stopped() -> None:
    """What it asks for is refused at once, again and again: also when the robot stops."""
    stubborn = Insists()
    stubborn.robot = esair.Robot(resources=[Sonar()], behaviors=[stubborn])
    async with stubborn.robot as robot:
        await robot.resources.remove("sonar")
        await asyncio.sleep(0.05)
