"""What every bus promises, kept by MQTT: in memory, and with a real broker."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from tests.buses.mqtt.broker import Mosquitto, needs_mosquitto

from esair.buses.mqtt import FakeMqtt, MqttBus
from esair.testing import BusContract


class TestFakeMqtt(BusContract):
    """In memory."""

    def make(self) -> MqttBus:
        return FakeMqtt(timeout=0.5)

    async def use(self, bus: Any) -> None:
        with await bus.subscribe("a/+") as inbox:
            await bus.publish("a/b", b"1")
            assert (await inbox.take(timeout=2.0))[:2] == ("a/b", b"1")


@needs_mosquitto
@pytest.mark.real_clock
class TestMosquitto(TestFakeMqtt):
    """A broker that is killed, started again, and stopped in its tracks."""

    @pytest.fixture(autouse=True)
    def _broker(self) -> Iterator[None]:
        pytest.importorskip("aiomqtt", reason="pip install 'esair[mqtt]'")
        self.broker = Mosquitto()
        self.broker.start()
        yield
        self.broker.stop()

    def make(self) -> MqttBus:
        return MqttBus(
            name="house", host="127.0.0.1", port=self.broker.port, timeout=1.5
        )

    async def unplug(self, bus: Any) -> None:
        self.broker.stop()

    async def plug(self, bus: Any) -> None:
        self.broker.start()

    async def stall(self, bus: Any) -> None:
        self.broker.stall()

    async def resume(self, bus: Any) -> None:
        self.broker.resume()
