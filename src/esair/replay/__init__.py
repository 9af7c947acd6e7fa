"""A run repeated from its recording, without its devices, and compared with it.

It needs ``esair[record]``.
"""

from esair.replay._replay import Comparison, Divergence, Outcome, Replay
from esair.replay._unrepeatable import Unrepeatable, unrepeatable

__all__ = [
    "Comparison",
    "Divergence",
    "Outcome",
    "Replay",
    "Unrepeatable",
    "unrepeatable",
]
