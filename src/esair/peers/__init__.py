"""Robots that use each other: what is shared with a peer, and its behaviors here.

`Sharing` is what a peer may do here, in the peer's name; a `PeerBehavior` stands for a
behavior of a peer and is asked like any other; a `Drive` moves an actuator by a topic of ROS.
"""

from esair.peers._behavior import PeerBehavior, peer_behavior
from esair.peers._drive import Drive
from esair.peers._sharing import Share, Sharing

__all__ = ["Drive", "PeerBehavior", "Share", "Sharing", "peer_behavior"]
