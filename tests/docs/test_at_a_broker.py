"""The drivers at a broker of the how-to page: the contracts, and the last will."""

import asyncio
from typing import Any

import pytest
from at_a_broker import Plug, Thermometer

import esair
from esair.drivers.mqtt.fake import FakeThing
from esair.testing import ActuatorContract, FakeMqtt, SensorContract


class Thing:
    """The far end: it publishes, is told, and has a status."""

    far: FakeThing

    def wire(self) -> FakeMqtt:
        bus = FakeMqtt()
        values = {"cellar/temperature": "12.5"}
        status = "cellar/plug/status"
        self.far = FakeThing(bus, values, ("cellar/plug",), status=status)
        return bus

    async def silence(self, _device: Any) -> None:
        self.far.stop()

    async def speak(self, _device: Any) -> None:
        self.far.start()

    async def power_cycle(self, _device: Any) -> None:
        self.far.power_cycle()


class TestThermometer(Thing, SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> Thermometer:
        return Thermometer(topic="cellar/temperature", bus=self.wire())


class TestPlug(Thing, ActuatorContract):
    keeps_nothing = "it is off after a restart, and told again"

    def make(self) -> Plug:
        return Plug(topic="cellar/plug", bus=self.wire())

    def commands(self) -> list[bool]:
        return [True]


@pytest.mark.virtual_clock
async def test_the_broker_switches_it_off() -> None:
    """When the connection ends without a farewell, as that of a process that is killed."""
    bus = FakeMqtt()
    far = FakeThing(bus, commands=("plug",), status="plug/status")
    plug = Plug(topic="plug", bus=bus)
    await bus.open()
    await plug.open()
    await plug.write(True)
    await bus.until("plug")
    assert far.told == {"plug": "ON"}

    bus.lost(ConnectionError("the robot's process is gone"))
    await asyncio.sleep(0.01)

    assert far.told == {"plug": "OFF"}
    far.stop()


@pytest.mark.virtual_clock
async def test_without_a_broker_there_is_no_last_will() -> None:
    """It is gone with its connections: a plug stays on that nobody switches off."""
    bus = FakeMqtt()
    far = FakeThing(bus, commands=("plug",), status="plug/status")
    plug = Plug(topic="plug", bus=bus)
    await bus.open()
    await plug.open()
    await plug.write(True)
    await bus.until("plug")

    bus.unplug()
    await asyncio.sleep(0.01)

    assert far.told == {"plug": "ON"}
    with pytest.raises(esair.DeviceLostError):
        await plug.write(False)
    far.stop()


@pytest.mark.virtual_clock
async def test_what_the_broker_has_kept_is_no_reading() -> None:
    """Nobody knows how old it is."""
    bus = FakeMqtt()
    bus.feed("temperature", "3", retain=True)
    part = Thermometer(topic="temperature", bus=bus)
    await bus.open()
    coming = asyncio.ensure_future(anext(part.stream()))
    await asyncio.sleep(0.01)
    assert not coming.done()
    bus.feed("temperature", "4")
    assert await coming == 4.0
    await bus.close()
