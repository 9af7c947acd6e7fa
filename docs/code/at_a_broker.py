"""Drivers of one's own at a broker of MQTT: a thermometer, and a plug with a last will."""

import asyncio
from collections.abc import AsyncIterator
from typing import Unpack

import esair
from esair.buses.mqtt import MqttBus, MqttLink
from esair.resources import ActuatorSettings, SensorSettings


class Thermometer(esair.Sensor[float]):
    """The temperature in °C; the part publishes it every 10 s."""

    bus: MqttBus
    period = 25.0  # its greatest silence: one message may be missing
    deadline = 12.0  # open waits for a message, which takes up to 10 s

    def __init__(self, *, topic: str, **settings: Unpack[SensorSettings]) -> None:
        super().__init__(**settings)
        self.topic = topic

    async def open(self) -> None:
        with await self.bus.subscribe(self.topic) as messages:
            async for message in messages:
                if not message.retained:
                    return

    async def stream(self) -> AsyncIterator[float]:
        with await self.bus.subscribe(self.topic) as messages:
            async for message in messages:
                if not message.retained:  # else nobody knows how old it is
                    yield float(message.payload)


class Plug(esair.Actuator[bool]):
    """A socket that is switched; the broker switches it off when the robot is gone."""

    bus: MqttBus
    safe = False
    deadline = 3.0
    command_timeout = 2.0  # a broker far away takes its time

    def __init__(self, *, topic: str, **settings: Unpack[ActuatorSettings]) -> None:
        super().__init__(**settings)
        self.topic = topic
        self.claim = f"the topic {topic!r}"
        self.link: MqttLink | None = None

    async def open(self) -> None:
        with await self.bus.subscribe(f"{self.topic}/status") as messages:
            async with asyncio.timeout(2.0):  # kept, so it is there at once
                status = await anext(messages)
        if status.payload != b"online":
            raise esair.DeviceLostError(self.name, "its status is not 'online'")
        self.link = await self.bus.connect(self.topic, "OFF")  # its last will

    async def close(self) -> None:
        link, self.link = self.link, None
        await self.bus.disconnect(link)  # the broker publishes the last will

    async def write(self, command: bool) -> None:
        word = "ON" if command else "OFF"
        await self.bus.publish(self.topic, word, link=self.link)
