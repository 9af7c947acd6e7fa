"""What happened: one numbered event for each effect, listeners, and all counters.

Recording, the operator's seat and the supervisors stand on it. It observes: nothing
that a listener does changes an order, a decision or a command.
"""

from esair.journal._journal import BACKLOG, SLICE, Event, Journal, Kind, Listener
from esair.journal._log_lines import Beside, LogLines, tell_where, text_of

__all__ = [
    "BACKLOG",
    "SLICE",
    "Beside",
    "Event",
    "Journal",
    "Kind",
    "Listener",
    "LogLines",
    "tell_where",
    "text_of",
]
