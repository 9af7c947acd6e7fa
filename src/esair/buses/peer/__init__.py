"""Peers: other robots on the network, each of them one more bus.

Only ``_zenoh.py`` knows zenoh, and imports it when the network is opened.
"""

from esair.buses.peer._bus import QUIET, SILENCE, PeerBus, PeerNetwork
from esair.buses.peer._fake import FakeNetwork
from esair.buses.peer._pace import BEAT
from esair.buses.peer._wire import Head, head_of, packed, parts_of
from esair.buses.peer._zenoh import Network, Tls

__all__ = [
    "BEAT",
    "QUIET",
    "SILENCE",
    "FakeNetwork",
    "Head",
    "Network",
    "PeerBus",
    "PeerNetwork",
    "Tls",
    "head_of",
    "packed",
    "parts_of",
]
