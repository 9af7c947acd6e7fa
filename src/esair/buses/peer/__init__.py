"""Peers: other robots on the network, each of them one more bus.

Only ``_zenoh.py`` knows zenoh, and imports it when the network is opened.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from esair.loading import late

if TYPE_CHECKING:
    from esair.buses.peer._bus import BEAT, SILENCE, SILENT, PeerBus, PeerNetwork
    from esair.buses.peer._fake import FakeNetwork
    from esair.buses.peer._wire import Head, head_of, packed, parts_of
    from esair.buses.peer._zenoh import Network, Tls

__all__ = [
    "BEAT",
    "SILENCE",
    "SILENT",
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

__getattr__, __dir__ = late(
    __name__,
    {
        "_bus": "BEAT SILENCE SILENT PeerBus PeerNetwork",
        "_fake": "FakeNetwork",
        "_wire": "Head head_of packed parts_of",
        "_zenoh": "Network Tls",
    },
)
