"""What a robot did, kept in a file (MCAP), read back, and made whole after a crash.

Recording is a listener of the journal. It needs ``esair[record]``.
"""

from esair.messages import Recording
from esair.recording._messages import (
    Seen,
    fields_of,
    plain,
    schema_of,
    seen_as,
    size_of,
)
from esair.recording._reading import Gaps, Recorded, chunks_of, events_of, facts_of
from esair.recording._recorder import VALUE_LIMIT, Recorder, facts_about
from esair.recording._recover import Recovered, is_whole, recover, replaced
from esair.recording._turns import GIVEN, Kept

__all__ = [
    "GIVEN",
    "VALUE_LIMIT",
    "Gaps",
    "Kept",
    "Recorded",
    "Recorder",
    "Recording",
    "Recovered",
    "Seen",
    "chunks_of",
    "events_of",
    "facts_about",
    "facts_of",
    "fields_of",
    "is_whole",
    "plain",
    "recover",
    "replaced",
    "schema_of",
    "seen_as",
    "size_of",
]
