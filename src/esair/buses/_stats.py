"""What a bus counts."""

from __future__ import annotations

import attrs


@attrs.define
class BusStats:
    """What happened on a bus since it was made; counts never go back.

    Attributes:
        sent: Bytes (serial), frames (CAN) or transfers (I²C) that were sent.
        received: Bytes (serial), frames (CAN) or transfers (I²C) that came.
        errors: Operations that failed, and error frames.
        bad_frames: Messages that came damaged, too long, or not as expected.
        dropped: What came and was thrown away because nobody took it in time.
        unheard: Messages that nobody listened to.
        late: Answers that came after their request was given up.
        no_turn: Operations that were not made: the bus had no time for them.
        retries: Operations that were tried again.
        refused: Operations refused because too many waited, or obsolete when their
            turn came.
        discarded: What waited to be sent and was thrown away because it took too long.
        opened: How often the bus was opened.
        lost: How often it was lost.
        last_error: The newest error in words; empty if there was none.
    """

    sent: int = 0
    received: int = 0
    errors: int = 0
    bad_frames: int = 0
    dropped: int = 0
    unheard: int = 0
    late: int = 0
    no_turn: int = 0
    retries: int = 0
    refused: int = 0
    discarded: int = 0
    opened: int = 0
    lost: int = 0
    last_error: str = ""

    def counts(self) -> dict[str, int]:
        """Return the counters, by name."""
        return {
            name: value
            for name, value in attrs.asdict(self).items()
            if isinstance(value, int)
        }
