"""MQTT: the bus, its connections to a broker, the far end, the fake.

Only ``_client.py`` knows aiomqtt, and is imported when a bus is opened.
"""

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
