"""Robots that use each other: what is shared with a peer, and its behaviors here.

`Sharing` is what a peer may do here, in the peer's name; a `PeerBehavior` stands for a
behavior of a peer and is asked like any other.
"""

from esair.peers._behavior import PeerBehavior, peer_behavior
from esair.peers._sharing import Share, Sharing

__all__ = ["PeerBehavior", "Share", "Sharing", "peer_behavior"]
