"""MQTT: the bus, its connections to a broker, the far end, the fake.

Only ``_client.py`` knows aiomqtt, and imports it when a bus is opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.loading import late

if TYPE_CHECKING:
    from esair.buses.mqtt._bus import MqttBus, devices, toml
    from esair.buses.mqtt._fake import FakeMqtt
    from esair.buses.mqtt._wire import Message, MqttLink, MqttWire, matches

__all__ = [
    "FakeMqtt",
    "Message",
    "MqttBus",
    "MqttLink",
    "MqttWire",
    "devices",
    "matches",
    "toml",
]

__getattr__, __dir__ = late(
    __name__,
    {
        "_bus": "MqttBus devices toml",
        "_wire": "Message MqttLink MqttWire matches",
        "_fake": "FakeMqtt",
    },
)
