"""A resource that is removed and added again, or replaced: its users have it again."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("RS-5")]


class Drive(esair.Behavior):
    """Reads and writes by the ports of its class, and notes what it meets."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def __init__(self) -> None:
        super().__init__()
        self.met: list[Any] = []

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            try:
                self.met.append(await self.sonar.read())
                await self.wheels.write(0.5)
            except esair.EsairError as error:
                self.met.append(type(error))


class Steer(esair.Reaction):
    """Writes what it reads."""

    sonar = esair.reads(float)
    rudder = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


@pytest.mark.parametrize("way", ["again", "replaced"])
async def test_declared_ports_live_again(
    fake_sensor: Any, fake_actuator: Any, way: str
) -> None:
    """Of a behavior and of a reaction, a sensor's and an actuator's; no restart is spent."""

    def devices(value: float) -> list[Any]:
        return [
            fake_sensor("sonar", value),
            fake_actuator("wheels", safe=0.0),
            fake_actuator("rudder", safe=0.0),
        ]

    drive, steer = Drive(), Steer()
    async with esair.Robot(resources=devices(1.0), behaviors=[drive, steer]) as robot:
        await asyncio.sleep(0.5)
        new = devices(2.0)
        for device in new:
            if way == "replaced":
                await robot.resources.replace(device.name, device)
            else:
                await robot.resources.remove(device.name)
                await asyncio.sleep(0.3)
                await robot.resources.add(device)
        await asyncio.sleep(0.5)
        drive.met.clear()
        await asyncio.sleep(0.5)
        assert set(drive.met) == {2.0}
        assert new[1].commands[-1] == 0.5
        assert new[2].commands[-1] == 2.0
        for name in ("drive", "steer"):
            assert robot.behaviors.query(name).restarts == 0


async def test_one_of_another_type_gets_no_registrations(fake_sensor: Any) -> None:
    """The port goes on to say that its sensor was removed."""
    sonar = fake_sensor("sonar", 1.0)

    class Reader(esair.Behavior):
        sonar = esair.reads(float)
        met: list[Any]

        async def run(self) -> None:
            self.met = []
            async for _ in esair.every(0.05):
                try:
                    self.met.append(await self.sonar.read())
                except esair.EsairError as error:
                    self.met.append(type(error))

    class Words(esair.Sensor[str]):
        async def read(self) -> str:
            return "far"

    reader = Reader()
    async with esair.Robot(resources=[sonar], behaviors=[reader]) as robot:
        await asyncio.sleep(0.5)
        await robot.resources.remove("sonar")
        await robot.resources.add(Words(name="sonar"))
        reader.met.clear()
        await asyncio.sleep(0.5)
        assert reader.met
        assert "far" not in reader.met


async def test_what_is_still_missing_is_not_told_again(
    fake_sensor: Any, fake_actuator: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Only the ports of what is back live again; nobody fails at those of the others."""
    devices = [fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)]
    drive = Drive()
    async with esair.Robot(resources=devices, behaviors=[drive]) as robot:
        for device in devices:
            await robot.resources.remove(device.name)
        caplog.clear()
        await robot.resources.add(fake_actuator("wheels", safe=0.0))
        assert await drive.wheels.write(1.0)
        with pytest.raises(esair.ResourceRemovedError):
            await drive.sonar.read()
    assert not [r for r in caplog.records if r.levelname == "WARNING"]


class Follow(esair.Behavior):
    """Lets what it meets end its run."""

    sonar = esair.reads(float)

    def __init__(self) -> None:
        super().__init__()
        self.met: list[Any] = []

    async def run(self) -> None:
        async for value in self.sonar:
            self.met.append(value)


@pytest.mark.parametrize("way", ["again", "replaced"])
async def test_another_type_between_two_that_fit(fake_sensor: Any, way: str) -> None:
    """Whoever begins anew is parked with it, no port gives it, and each has the next one."""
    follow, drive = Follow(), esair.Behavior(reads={"sonar": esair.reads(float)})
    first = fake_sensor("sonar", 1.0, type=float)
    async with esair.Robot(resources=[first], behaviors=[follow, drive]) as robot:

        async def put(device: Any) -> None:
            if way == "replaced":
                await robot.resources.replace("sonar", device)
            else:
                await robot.resources.remove("sonar")
                await robot.resources.add(device)
            await asyncio.sleep(0.5)

        await put(fake_sensor("sonar", "one", type=str))
        status = robot.behaviors.query("follow")
        assert status.detail == "it reads float, but 'sonar' gives str"
        assert status.state is esair.BehaviorState.PARKED
        with pytest.raises(esair.ResourceRemovedError):
            await drive.sonar.read()  # type: ignore[attr-defined]
        await put(fake_sensor("sonar", 2.0, type=float))
        assert await drive.sonar.read() == 2.0  # type: ignore[attr-defined]
        assert set(follow.met) == {1.0, 2.0}
        assert robot.behaviors.query("follow").restarts == 0


class Note(esair.Reaction):
    """Keeps what it decides on."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def __init__(self) -> None:
        super().__init__()
        self.met: list[Any] = []

    def react(self, sonar: float) -> None:
        self.met.append(sonar)


@pytest.mark.promise("RS-5")
@pytest.mark.parametrize("kind", [Follow, Note])
async def test_the_users_restart_gives_nobody_another_type(
    kind: Any, fake_sensor: Any, fake_actuator: Any
) -> None:
    """It is parked with it, as who begins anew by itself is, until one comes that fits."""
    it = kind()
    resources = [fake_sensor("sonar", 1.0, type=float), fake_actuator("wheels", 0.0)]
    async with esair.Robot(resources=resources, behaviors=[it]) as robot:
        await robot.resources.remove("sonar")
        await robot.resources.add(fake_sensor("sonar", "one", type=str))
        await robot.behaviors.restart(it.name)
        await asyncio.sleep(0.5)
        status = robot.behaviors.query(it.name)
        assert status.state is esair.BehaviorState.PARKED
        assert status.detail == "it reads float, but 'sonar' gives str"
        await robot.resources.replace("sonar", fake_sensor("sonar", 2.0, type=float))
        await asyncio.sleep(0.5)
        assert robot.behaviors.query(it.name).state is esair.BehaviorState.RUNNING
        assert set(it.met) == {1.0, 2.0}
