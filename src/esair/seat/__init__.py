"""The operator's seat: a running robot is watched and steered from outside.

One table of acts serves the control socket, ``robot.behaviors.command`` and the page.
The operator is a principal with rights of its own; what it does is in the journal.
"""

from esair.seat._acts import ACTS, Act, Field, act_of, table_of
from esair.seat._client import Client, NoRobotError, RefusedActError, connect
from esair.seat._operator import Console, Session
from esair.seat._place import robots
from esair.seat._seat import Seat
from esair.seat._socket import CLIENTS, Socket
from esair.seat._status import Status
from esair.seat._wire import LIMIT, VERSION

__all__ = [
    "ACTS",
    "CLIENTS",
    "LIMIT",
    "VERSION",
    "Act",
    "Client",
    "Console",
    "Field",
    "NoRobotError",
    "RefusedActError",
    "Seat",
    "Session",
    "Socket",
    "Status",
    "act_of",
    "connect",
    "robots",
    "table_of",
]
