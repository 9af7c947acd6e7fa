"""MQTT: the bus, its connections to a broker, the far end, the fake.

Only ``_client.py`` knows aiomqtt, and is imported when a bus is opened.
"""

from esair.buses.mqtt._bus import (
    Message,
    MqttBus,
    MqttLink,
    MqttWire,
    devices,
    matches,
    toml,
)
from esair.buses.mqtt._fake import FakeMqtt

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
