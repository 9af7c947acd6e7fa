"""The events: what kinds there are, and what each of them says."""

from __future__ import annotations

import enum
from typing import Any, NamedTuple


class Kind(enum.StrEnum):
    """What happened; beside each, what ``component``, ``peer`` and ``value`` are."""

    READING = "reading"
    """A sensor has given a value: the sensor, nobody, the `Reading`."""
    COMMAND = "command"
    """A command was asked for: the actuator, who asked, the command."""
    REFUSED = "refused"
    """It was refused: the actuator, who asked, the `Refused`."""
    SENT = "sent"
    """It left for the device: the actuator, who asked, the command as it left."""
    APPLIED = "applied"
    """The device took it: the actuator, who asked, what was applied."""
    SAFE = "safe"
    """The device was told its safe command: the actuator, nobody, the command."""
    UNANSWERED = "unanswered"
    """A command or a safe command met an error: the actuator, nobody, the command."""
    PUT = "put"
    """Data was delivered by a put: the receiver, the sender, the data."""
    GOT = "got"
    """Data was delivered by a get: the receiver, the giver, the data."""
    ASKED = "asked"
    """A request was made: who is asked, the asker, the request."""
    ANSWERED = "answered"
    """A request has its outcome: who was asked, the asker, the answer or error."""
    REGISTERED = "registered"
    """A right was given: the behavior, the resource, the `Access`."""
    REVOKED = "revoked"
    """A right was taken: the behavior, the resource, the `Access`."""
    CONFIGURED = "configured"
    """Settings were applied: the resource, who asked, the settings."""
    OPERATED = "operated"
    """An operation of a resource has ended: the resource, who asked, its result."""
    ADDED = "added"
    """A component became part of the robot: its name, "resource" or "behavior"."""
    REMOVED = "removed"
    """A component is no part of the robot any more: its name, as `ADDED`."""
    UP = "up"
    """A device is ready: its name."""
    DOWN = "down"
    """A device is not there: its name, nobody, the error."""
    RUNNING = "running"
    """A behavior or reaction runs: its name."""
    PARKED = "parked"
    """A component waits for what is not there: its name."""
    CRASHED = "crashed"
    """A component raised: its name, nobody, the error."""
    RESTARTED = "restarted"
    """A component begins anew after a crash: its name."""
    FAILED = "failed"
    """A component is given up: its name, nobody, the error."""
    FINISHED = "finished"
    """A behavior has come to its own end: its name."""
    MODE = "mode"
    """The robot goes to a mode: its name, nobody, the mode before; why is the text."""
    HALTED = "halted"
    """The robot was halted: who did it; the reason is the text."""
    RESUMED = "resumed"
    """The user has ended all halts."""
    OPERATOR = "operator"
    """An operator did something: what it was done to, who, the act."""
    LOG = "log"
    """A line of esair's log: the logger; the line is the text."""


class Event(NamedTuple):
    """One effect. It is never changed.

    Attributes:
        number: 1 for the first event of a robot, then one more each time; where one
            is missing, a listener was too slow for it.
        time: When, in seconds of the event loop's clock.
        kind: What happened.
        component: The name of the component it happened to.
        peer: The name of the other one, if there is one.
        value: What it is about, as `Kind` tells; as it was handed over, never copied.
        text: Why, in words for people, where there is more to say.
    """

    number: int
    time: float
    kind: Kind
    component: str
    peer: str = ""
    value: Any = None
    text: str = ""
