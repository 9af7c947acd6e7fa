"""What a robot did, kept in a file (MCAP), read back, and made whole after a crash.

Recording is a listener of the journal. It needs ``esair[record]``.
"""

from esair.messages import Recording
from esair.recording._plain import plain
from esair.recording._reading import Recorded, events_of, facts_of
from esair.recording._recorder import Recorder, facts_about
from esair.recording._recover import Recovered, is_whole, recover

__all__ = [
    "Recorded",
    "Recorder",
    "Recording",
    "Recovered",
    "events_of",
    "facts_about",
    "facts_of",
    "is_whole",
    "plain",
    "recover",
]
