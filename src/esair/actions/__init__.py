"""What the robot does: behaviors deliberate, reactions react.

An action declares what it reads, writes and guards (`_needs`); in a robot that runs each of
these is a port. A behavior has a task, or a thread whose calls wait (`_blocking`), and asks
its supervisor for the rest: `Host` and `Mail` are all that it knows of it. A reaction has a
runner::

    ReactionRunner | GuardRunner | Derivation
      Senses ──> Input     the newest readings, how old they may be, who waits for a step
      react                the user's own code; a step of it is one turn of the scheduler
      Outputs ──> Output   at most one wish for each actuator in a turn

What is computed of readings is a sensor that is declared like a reaction (`_derived`). A
request of one behavior to another is typed by what it is answered with (`_requests`).
"""

from esair.actions._behavior import (
    NOTHING,
    Behavior,
    Host,
    Mail,
    PortTerms,
    ThreadBehavior,
    give,
    run_as_step,
    take_back,
)
from esair.actions._blocking_ports import (
    BlockingActuatorPort,
    BlockingSensorPort,
    blocking,
    each_of,
    in_loop,
)
from esair.actions._derived import Derivation, Derived
from esair.actions._needs import (
    Blind,
    Guards,
    Need,
    ProfiledAction,
    Reads,
    Works,
    Writes,
    declared_works,
    guards,
    reads,
    works,
    writes,
)
from esair.actions._reaction import MinimalReaction, Reaction, StepClock, adapt_action
from esair.actions._reaction_runner import (
    GuardRunner,
    Hooks,
    ReactionRunner,
    by_name,
    ordered,
)
from esair.actions._requests import (
    BlockingRequestPort,
    Request,
    RequestPort,
    Takes,
    answer_type,
    answers,
    declared_requests,
    is_request,
    taken,
    takes,
)
from esair.connections import ActuatorPort, SensorPort

__all__ = [
    "NOTHING",
    "ActuatorPort",
    "Behavior",
    "Blind",
    "BlockingActuatorPort",
    "BlockingRequestPort",
    "BlockingSensorPort",
    "Derivation",
    "Derived",
    "GuardRunner",
    "Guards",
    "Hooks",
    "Host",
    "Mail",
    "MinimalReaction",
    "Need",
    "PortTerms",
    "ProfiledAction",
    "Reaction",
    "ReactionRunner",
    "Reads",
    "Request",
    "RequestPort",
    "SensorPort",
    "StepClock",
    "Takes",
    "ThreadBehavior",
    "Works",
    "Writes",
    "adapt_action",
    "answer_type",
    "answers",
    "blocking",
    "by_name",
    "declared_requests",
    "declared_works",
    "each_of",
    "give",
    "guards",
    "in_loop",
    "is_request",
    "ordered",
    "reads",
    "run_as_step",
    "take_back",
    "taken",
    "takes",
    "works",
    "writes",
]
