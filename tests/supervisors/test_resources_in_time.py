"""Commands of the user return in time, whatever a device does."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair import ResourceState
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


def now() -> float:
    return asyncio.get_running_loop().time()


class Deaf(esair.Actuator[float]):
    """Hangs in the calls that its test names, and heeds no cancellation."""

    safe = 0.0
    deadline = 5.0

    def __init__(self, *hangs: str) -> None:
        super().__init__(name="deaf")
        self.hangs = set(hangs)
        self.go = asyncio.Event()

    async def call(self, name: str) -> None:
        while name in self.hangs and not self.go.is_set():
            try:
                await self.go.wait()
            except asyncio.CancelledError:
                continue

    async def open(self) -> None:
        await self.call("open")

    async def close(self) -> None:
        await self.call("close")

    async def write(self, command: float) -> None:
        await self.call("write" if command else "safe")


@pytest.mark.promise("SUP-3")
@pytest.mark.parametrize(
    "hangs",
    [("write",), ("safe",), ("close",), ("safe", "close"), ("write", "safe", "close")],
    ids="-".join,
)
async def test_remove_takes_its_grace_at_most(hangs: tuple[str, ...]) -> None:
    """One deadline is handed down, though the device's own is 5 s; deadlines do not add up."""
    deaf = Deaf()
    user: Any = esair.Behavior(name="user", writes={"deaf": esair.writes(float)})
    async with esair.Robot(resources=[deaf], behaviors=[user], grace=1.0) as robot:
        deaf.hangs = set(hangs)
        writing = asyncio.create_task(user.deaf.write(1.0))
        await asyncio.sleep(0.01)
        began = now()
        await robot.resources.remove("deaf")
        assert now() - began <= 1.1
        assert robot.resources.names() == []
        assert robot.resources.abandoned()
        deaf.go.set()
        await asyncio.wait({writing})
        error = writing.exception()
        assert isinstance(error, esair.DeviceLostError) is ("write" in hangs)
        await asyncio.sleep(0.1)
        assert robot.resources.abandoned() == ()


@pytest.mark.promise("SUP-3")
async def test_a_hung_opening_holds_no_other_command_up() -> None:
    """Other devices come and go meanwhile; `remove` ends the opening."""
    deaf = Deaf("open")
    async with esair.Robot(resources=[], grace=1.0) as robot:
        adding = asyncio.create_task(robot.resources.add(deaf))
        await asyncio.sleep(0.01)
        began = now()
        await robot.resources.add(FakeSensor("sonar", 1.0))
        await robot.resources.replace("sonar", FakeSensor("sonar", 2.0))
        await robot.resources.remove("sonar")
        assert now() - began < 0.2
        began = now()
        await robot.resources.remove("deaf")
        assert now() - began <= 1.1
        with pytest.raises(esair.ResourceRemovedError):
            await adding
        assert robot.resources.names() == []
        deaf.go.set()
        await asyncio.sleep(0.1)


@pytest.mark.promise("SUP-3")
async def test_commands_for_one_name_wait_for_what_goes() -> None:
    """A name is free again when its device has gone, at the end of its grace."""
    deaf = Deaf()
    async with esair.Robot(resources=[deaf], grace=1.0) as robot:
        deaf.hangs = {"safe", "close"}
        removing = asyncio.create_task(robot.resources.remove("deaf"))
        await asyncio.sleep(0.1)
        again = asyncio.create_task(robot.resources.remove("deaf"))
        began = now()
        await robot.resources.add(FakeActuator("deaf", safe=0.0))
        assert now() - began <= 1.1
        assert robot.resources.query("deaf").state is ResourceState.READY
        await removing
        await asyncio.wait({again})
        deaf.go.set()
        await asyncio.sleep(0.1)


@pytest.mark.promise("SUP-3", "CALL-1")
async def test_what_a_removed_actuator_does_late_says_nothing_of_its_successor() -> (
    None
):
    """Its call is listed until it ends; the new one is told safe once more then."""
    deaf, wheels = Deaf("write"), FakeActuator("deaf", safe=0.0, command_timeout=30.0)
    user: Any = esair.Behavior(name="user", writes={"deaf": esair.writes(float)})
    async with esair.Robot(resources=[deaf], behaviors=[user], grace=0.5) as robot:
        writing = asyncio.create_task(user.deaf.write(1.0))
        await asyncio.sleep(0.01)
        await robot.resources.replace("deaf", wheels)
        with pytest.raises(esair.DeviceLostError):
            await writing
        assert not robot.actuators.channels["deaf"].told().answered
        await user.deaf.write(2.0)
        deaf.go.set()
        await asyncio.sleep(0.1)
        assert wheels.commands == [0.0, 2.0, 0.0]
        assert robot.actuators.channels["deaf"].told().answered


@pytest.mark.promise("SUP-3")
async def test_a_caller_that_gives_up_leaves_no_gate_behind() -> None:
    """A replace that nobody waits for is finished, and the name goes on."""
    first, second = FakeActuator("wheels", safe=0.0), FakeActuator("wheels", safe=0.0)
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(float)})
    async with esair.Robot(resources=[first], behaviors=[user]) as robot:
        first.stall()
        replacing = asyncio.create_task(robot.resources.replace("wheels", second))
        await asyncio.sleep(0.1)
        replacing.cancel()
        await asyncio.wait({replacing})
        await asyncio.sleep(2.0)
        assert robot.resources.get("wheels") is second
        assert await user.wheels.write(1.0)
        first.resume()


class Blocks(esair.Actuator[float]):
    """Its driver blocks for a while."""

    safe = 0.0

    def __init__(self) -> None:
        super().__init__(name="arm")
        self.loop: Any = asyncio.get_running_loop()

    def write(self, command: float) -> None:
        self.loop.wait_in_thread(0.02)


@pytest.mark.promise("SUP-3")
async def test_a_removal_is_not_undone_by_the_addition_that_it_ends() -> None:
    """One of them takes the device away; who waits for that learns of it."""
    async with esair.Robot(resources=[], grace=1.0) as robot:
        adding = asyncio.create_task(robot.resources.add(Blocks()))
        await asyncio.sleep(0.01)
        removing = asyncio.create_task(robot.resources.remove("arm"))
        await asyncio.sleep(0.01)
        restarting = asyncio.create_task(robot.resources.restart("arm"))
        await asyncio.wait({adding, removing, restarting}, timeout=5.0)
        assert isinstance(adding.exception(), esair.ResourceRemovedError)
        assert removing.exception() is None
        assert isinstance(restarting.exception(), esair.UnknownNameError)
