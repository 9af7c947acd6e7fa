"""Parts by MQTT: their words, their last wills, and a broker that goes."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import aclosing
from typing import Any

import pytest
from tests.buses.mqtt.broker import Mosquitto, needs_mosquitto
from tests.drivers.parts import opened

import esair
from esair.buses.mqtt import FakeMqtt, MqttBus, matches
from esair.drivers.mqtt import MqttActuator, MqttSensor
from esair.drivers.mqtt.fake import FakeThing
from esair.exceptions import BadValueError, DeviceFaultError, DeviceLostError
from esair.plan import Plan, protection
from esair.testing import ActuatorContract, SensorContract

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("PRO-13")
@pytest.mark.parametrize(
    ("safe", "dead", "alone"),
    [
        (
            False,
            "its last will is published at once",
            "its last will is published after 30 s",
        ),
        (
            "hold",
            "UNWATCHED: the robot has no watchdog",
            "it keeps its last command",
        ),
    ],
)
async def test_a_last_will_is_told_by_check_and_why(
    safe: Any, dead: str, alone: str
) -> None:
    """Who stays where it is has none."""
    bus = FakeMqtt(keepalive=20)
    pump = MqttActuator(topic="pump", safe=safe, name="pump", bus=bus)
    (told,) = protection(Plan(resources=[pump]))
    assert (told.when_the_process_dies, told.when_the_host_dies) == (dead, alone)
    async with esair.Robot(resources=[pump]) as robot:
        end = f"{dead.replace(': ', ', ')}; when this computer dies: {alone}"
        assert robot.resources.why("pump").dies.endswith(end)


@pytest.mark.promise("AC-1")
def test_a_command_that_is_no_json_is_refused() -> None:
    """As the command that it is: the device, which was not asked, is not at fault."""
    lamp = MqttActuator(topic="lamp", safe={"on": False}, name="lamp", bus=FakeMqtt())
    lamp.check({"on": True})
    with pytest.raises(BadValueError, match="lamp: command: TypeError: Object of type"):
        lamp.check({"on": {1, 2}})


class Thing:
    """A thing with a status, on a broker in memory."""

    far: FakeThing

    def wire(self) -> FakeMqtt:
        bus = FakeMqtt()
        values = {"tank": '{"level": {"cm": 12.5}}', "door": "ON"}
        self.far = FakeThing(bus, values, ("pump",))
        return bus

    async def silence(self, _device: Any) -> None:
        self.far.stop()

    async def speak(self, _device: Any) -> None:
        self.far.start()

    async def power_cycle(self, _device: Any) -> None:
        self.far.power_cycle()


class TestSensor(Thing, SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> MqttSensor:
        return MqttSensor(
            topic="tank", value="level.cm", status="thing/status", bus=self.wire()
        )


class TestSensorWithoutStatus(Thing, SensorContract):
    keeps_nothing = "it is told nothing"

    def make(self) -> MqttSensor:
        return MqttSensor(
            topic="door", kind="switch", silent_after=0.5, bus=self.wire()
        )


class TestActuator(Thing, ActuatorContract):
    keeps_nothing = "what it was told is told again"

    def make(self) -> MqttActuator:
        return MqttActuator(
            topic="pump", safe=False, status="thing/status", bus=self.wire()
        )

    def commands(self) -> list[Any]:
        return [True, False]


class TestActuatorWithoutStatus(Thing, ActuatorContract):
    is_heard = False
    keeps_nothing = "what it was told is told again"

    def make(self) -> MqttActuator:
        return MqttActuator(topic="pump", safe=0.0, limits=(0.0, 1.0), bus=self.wire())

    def commands(self) -> list[Any]:
        return [0.25, 1.0]


@pytest.mark.parametrize(
    ("kind", "way", "payload", "value"),
    [
        ("number", None, b"1e3", 1000.0),
        ("number", "cells.1", b'{"cells": [1, 2.5]}', 2.5),
        ("number", None, b"nan", None),
        ("number", "cells.7", b'{"cells": []}', None),
        ("switch", None, b"OFF", False),
        ("switch", "on", b'{"on": true}', True),
        ("switch", None, b"off", None),
        ("text", None, "grün".encode(), "grün"),
        ("text", None, b"\xff", None),
        ("number", "x", b'{"x": 1%b}' % (400 * b"0"), None),
        ("json", None, 100_000 * b"[", None),
        ("number", "x", b"{}", None),
        ("number", "x", b'{"x": true}', None),
        ("number", "x", b"3", None),
        ("json", None, b"[1]", [1]),
    ],
)
async def test_a_payload_is_a_value_or_counted(kind, way, payload, value) -> None:
    """Nothing that a peer says is more than a bad payload."""
    bus = FakeMqtt()
    sensor = MqttSensor(topic="t", kind=kind, value=way, bus=bus)
    async with opened(sensor):
        coming = asyncio.ensure_future(anext(sensor.stream()))
        await asyncio.sleep(0)
        bus.feed("t", payload)
        await asyncio.sleep(0.01)
        if value is None:
            assert sensor.counts() == {"bad_payloads": 1}
            coming.cancel()
        else:
            assert await coming == value


@pytest.mark.fault("D26")
async def test_a_thing_that_tells_no_value_any_more_is_at_fault() -> None:
    """As a thermometer of ESPHome that has lost its probe, and may be silent for ever."""
    bus = FakeMqtt()
    sensor = MqttSensor(topic="t", bus=bus)
    async with opened(sensor):
        values = sensor.stream()
        coming = asyncio.ensure_future(anext(values))
        await asyncio.sleep(0)
        for payload in ("nan", "nan", "21.5"):
            bus.feed("t", payload)
        assert await coming == 21.5
        coming = asyncio.ensure_future(anext(values))
        await asyncio.sleep(0)
        for _ in range(3):
            bus.feed("t", "nan")
        with pytest.raises(DeviceFaultError, match="3 messages in a row have no such"):
            await coming


@pytest.mark.promise("SC-3")
async def test_what_was_kept_is_told_once() -> None:
    """Whoever subscribes later has it told on the same connection, to all."""
    bus = FakeMqtt()
    bus.feed("goal", "3", retain=True)
    sensor: Any = MqttSensor(topic="goal", retained=True, bus=bus)
    async with opened(sensor), aclosing(sensor.stream()) as stream:
        assert await anext(stream) == 3.0
        with await bus.subscribe("goal"):
            bus.feed("goal", "4")
        assert await anext(stream) == 4.0
        with await bus.subscribe("#"):
            bus.feed("goal", "5")
            assert await anext(stream) == 5.0


@pytest.mark.parametrize("retained", [False, True])
async def test_what_the_broker_kept_is_old(retained: bool) -> None:
    """It is a reading only where its age does not matter."""
    bus = FakeMqtt()
    bus.feed("goal", "3", retain=True)
    sensor = MqttSensor(topic="goal", retained=retained, bus=bus)
    async with opened(sensor):
        coming = asyncio.ensure_future(anext(sensor.stream()))
        await asyncio.sleep(0.01)
        assert coming.done() is retained
        bus.feed("goal", "4")
        assert await coming == (3.0 if retained else 4.0)


async def test_only_a_value_ends_the_silence() -> None:
    """A status that is told again, and a payload that is none, are no values."""
    bus = FakeMqtt()
    sensor = MqttSensor(topic="t", status="there", silent_after=0.5, bus=bus)
    await bus.open()
    bus.feed("there", "online", retain=True)
    values = sensor.stream()
    waiting = asyncio.ensure_future(anext(values))
    await asyncio.sleep(0.01)
    bus.feed("t", "1.5")
    assert await waiting == 1.5
    since = asyncio.get_running_loop().time()

    lost = asyncio.ensure_future(anext(values))
    for _ in range(20):
        await asyncio.sleep(0.1)
        bus.feed("there", "online")
        bus.feed("t", "nothing")
        if lost.done():
            break

    with pytest.raises(DeviceLostError, match=r"for 0\.5 s"):
        await lost
    assert asyncio.get_running_loop().time() - since < 0.7
    await bus.close()


async def test_the_last_will_is_the_safe_command() -> None:
    """Whatever ends its connection, the device is told to stop."""
    bus = FakeMqtt()
    thing = FakeThing(bus, commands=("pump",))
    pump = MqttActuator(topic="pump", safe=False, bus=bus)
    async with opened(pump):
        await pump.write(True)
        await bus.until("pump")
        assert thing.told == {"pump": "ON"}
        bus.lost(ConnectionError("the robot's process is gone"))
        await asyncio.sleep(0.01)
        assert thing.told == {"pump": "OFF"}


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize(
    ("command", "payload"),
    [(4294967295.0, b"4294967295"), (52.5200066001, b"52.5200066001")],
)
async def test_a_number_is_published_with_all_its_digits(command, payload) -> None:
    """What the device is told is what is told as written."""
    bus = FakeMqtt()
    thing = FakeThing(bus, commands=("goal",))
    async with opened(MqttActuator(topic="goal", safe="hold", bus=bus)) as goal:
        await goal.write(command)
        await bus.until("goal")
        assert thing.told == {"goal": payload.decode()}


@pytest.mark.fault("D14")
async def test_who_is_absent_for_long_leaves_nothing_behind() -> None:
    """Each try of an opening ends what it has begun."""
    bus = FakeMqtt()
    thing = FakeThing(bus, {"tank": "1"})
    thing.stop()
    parts: list[Any] = [
        MqttActuator(topic="pump", safe=False, status="thing/status", bus=bus),
        MqttSensor(topic="tank", status="thing/status", bus=bus),
    ]
    async with esair.Robot(resources=parts) as robot:
        await asyncio.sleep(300.0)
        assert len(bus._inboxes) <= 2
        assert len(bus._links) <= 2
        thing.start()
        await asyncio.sleep(8.0)
        states = {robot.resources.query(part.name).state.name for part in parts}
        assert states == {"READY"}


async def test_what_waits_ends_with_the_broker() -> None:
    """A command that is not acknowledged is no longer waited for."""
    bus = FakeMqtt(timeout=60.0)
    pump = MqttActuator(topic="pump", safe=False, bus=bus)
    async with opened(pump):
        bus.stall()
        writing = asyncio.ensure_future(pump.write(True))
        await asyncio.sleep(0.01)
        bus.unplug()
        async with asyncio.timeout(0.01):
            with pytest.raises(DeviceLostError, match="hung up"):
                await writing
        bus.resume()
        await asyncio.sleep(0.1)

    assert [message.payload for message in bus.sent] == []


async def test_home_assistant_is_told_where_it_is() -> None:
    """What is told is shown there; what is heard is set there; the broker keeps both."""
    bus = FakeMqtt("rover")
    volts = MqttActuator(
        topic="rover/battery",
        safe="hold",
        name="battery",
        announce={"component": "sensor", "unit_of_measurement": "V"},
        bus=bus,
    )
    goal = MqttSensor(
        topic="rover/goal", name="goal", announce={"component": "number"}, bus=bus
    )
    async with opened(volts, goal):
        await bus.until(lambda message: message.topic.endswith("rover/goal/config"))

    assert json.loads(
        bus.kept["homeassistant/sensor/rover/battery/config"].payload
    ) == {
        "name": "battery",
        "unique_id": "rover_battery",
        "state_topic": "rover/battery",
        "unit_of_measurement": "V",
    }
    told = json.loads(bus.kept["homeassistant/number/rover/goal/config"].payload)
    assert told["command_topic"] == "rover/goal"


@pytest.mark.parametrize(
    ("pattern", "topic", "fits"),
    [
        ("a/b", "a/b", True),
        ("a/+", "a/b", True),
        ("a/+", "a/b/c", False),
        ("a/#", "a", True),
        ("a/#", "a/b/c", True),
        ("#", "$SYS/x", False),
        ("+/x", "$SYS/x", False),
        ("a", "a/b", False),
    ],
)
def test_patterns_are_those_of_the_standard(pattern, topic, fits) -> None:
    """MQTT 3.1.1, 4.7."""
    assert matches(pattern, topic) is fits


async def test_a_topic_that_is_none_is_told() -> None:
    """A command to a pattern would reach nobody, or end the connection."""
    bus = FakeMqtt()
    async with opened(MqttSensor(topic="a", bus=bus)):
        with pytest.raises(BadValueError, match=r"expected a topic, not 'a/\+'"):
            await bus.publish("a/+", b"")
        with pytest.raises(BadValueError, match="expected a topic, or one with"):
            await bus.subscribe("a/#/b")
        with pytest.raises(BadValueError, match="not ''"):
            await bus.subscribe("")


@pytest.fixture
async def mosquitto() -> AsyncIterator[Mosquitto]:
    pytest.importorskip("aiomqtt", reason="pip install 'esair[mqtt]'")
    broker = Mosquitto()
    broker.start()
    yield broker
    broker.stop()


@needs_mosquitto
@pytest.mark.real_clock
async def test_a_real_broker_tells_the_last_will(mosquitto: Mosquitto) -> None:
    """Another client hears the safe command when the robot's connection ends."""
    bus = MqttBus(name="house", host="127.0.0.1", port=mosquitto.port)
    other = MqttBus(name="other", host="127.0.0.1", port=mosquitto.port)
    pump = MqttActuator(topic="pump", safe=False, bus=bus)
    await other.open()
    with await other.subscribe("pump") as heard:
        async with opened(pump):
            await pump.write(True)
            assert (await heard.take(timeout=5.0)).payload == b"ON"
            bus.lost(ConnectionError("the robot's process is gone"))
            assert (await heard.take(timeout=5.0)).payload == b"OFF"
    await other.close()


KILLED = """
import sys
import esair
from esair.buses.mqtt import MqttBus
from esair.drivers.mqtt import MqttActuator

class Go(esair.Behavior):
    pump = esair.writes(bool)

    async def run(self):
        async for _ in esair.every(0.05):
            await self.pump.write(True)

bus = MqttBus(name="house", host="127.0.0.1", port=int(sys.argv[1]))
pump = MqttActuator(name="pump", topic="pump", safe=False, bus=bus)
esair.run(esair.Robot(resources=[pump], behaviors=[Go()]))
"""


@needs_mosquitto
@pytest.mark.long
@pytest.mark.real_clock
async def test_a_process_that_is_killed_leaves_the_safe_command(
    mosquitto: Mosquitto,
) -> None:
    """No code of the robot runs any more: the broker tells it."""
    other = MqttBus(name="other", host="127.0.0.1", port=mosquitto.port)
    await other.open()
    with await other.subscribe("pump", limit=1000) as heard:
        robot = await asyncio.create_subprocess_exec(
            sys.executable, "-c", KILLED, str(mosquitto.port), stderr=subprocess.DEVNULL
        )
        while (await heard.take(timeout=60.0)).payload != b"ON":
            pass
        robot.kill()
        async with asyncio.timeout(10.0):
            while (await heard.take()).payload != b"OFF":
                pass
        await robot.wait()
    await other.close()


@needs_mosquitto
@pytest.mark.real_clock
async def test_a_broker_that_goes_and_comes(mosquitto: Mosquitto) -> None:
    """Its parts are lost, and ready by themselves when it is there again."""
    bus = MqttBus(name="house", host="127.0.0.1", port=mosquitto.port)
    pump = MqttActuator(topic="pump", safe=False, bus=bus, name="pump")
    async with esair.Robot(resources=[pump]) as robot:
        for state in ("READY", "LOST", "READY"):
            async with asyncio.timeout(10.0):
                while robot.resources.query("pump").state.name != state:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
            if state == "LOST":
                mosquitto.start()
            elif not robot.resources.query("pump").losses:
                mosquitto.stop()
