"""One event loop: its turns, and what everything in it stands on.

A turn is one pass of the loop. It begins at a border (`_turn`): what came in by the one
door (`_door`) takes effect, in the order of its numbers; polls go out and steps that are due
decide, on one grid (`_scheduler`); what has not come until then is over (`_deadlines`).
Between two borders nothing takes effect but what coroutines do themselves. So a run follows
from the times of its turns and from what came in, which a tape keeps (`_tape`); and it means
the same on the loop of `esair.run`, the virtual clock, plain asyncio and uvloop.

The rest is what components run on: the first steps of driver calls (`_light_task`), threads
for blocking code (`_threads`), who owns a task, with seeded randomness (`_ownership`), what a
turn may take (`_budget`), garbage collected in gaps, signals, and the end of a loop
(`_overseer`).
"""

from esair.loop._budget import (
    LASTS,
    PUT_COST,
    READ_COST,
    VERB_COST,
    WRITE_COST,
    Budget,
)
from esair.loop._deadlines import Deadline, Deadlines, DeadMan
from esair.loop._door import Arrivals, Door, News, arrive, ask_outside, outside
from esair.loop._every import every
from esair.loop._garbage import Gaps, collector
from esair.loop._light_task import (
    COMMAND,
    ENDED,
    OPENING,
    SAFE,
    WAITS,
    Caller,
    FirstSteps,
    LightTask,
    Turns,
    Urgency,
    current_task_of,
    current_tasks,
    fail,
    has_come,
    ignore,
    look_at,
    raisable,
    settle,
    urgency,
    wake,
    wake_one,
)
from esair.loop._of_loop import clock_beside, clock_of, turn_of
from esair.loop._overseer import (
    Ending,
    StallWatch,
    leave_behind,
    run_and_end,
    threads_that_keep_the_process,
)
from esair.loop._ownership import (
    ComponentRandom,
    OwnedTasks,
    Owner,
    Stepping,
    current_owner,
    script_context,
    spawn,
    speaks_for_nobody,
)
from esair.loop._realtime import (
    PRIORITY,
    RealTime,
    check_priority,
    go_first,
    priority_of_thread,
    refusal,
)
from esair.loop._scheduler import (
    NEVER,
    REACHED,
    SECOND,
    Job,
    OneShot,
    Order,
    Scheduler,
    Step,
)
from esair.loop._signals import LateSignals, ProcessWatch, SignalWatch
from esair.loop._tape import SPOILED, First, Player, Tag, TapeWriter
from esair.loop._threads import (
    CallRefused,
    Executor,
    InLine,
    Portal,
    had_turn,
    leave_line,
    now,
    portal,
    run_in_thread,
    waits_in_line,
)
from esair.loop._turn import GLANCE, SuspendWatch, TurnLoop, new_event_loop

__all__ = [
    "COMMAND",
    "ENDED",
    "GLANCE",
    "LASTS",
    "NEVER",
    "OPENING",
    "PRIORITY",
    "PUT_COST",
    "REACHED",
    "READ_COST",
    "SAFE",
    "SECOND",
    "SPOILED",
    "VERB_COST",
    "WAITS",
    "WRITE_COST",
    "Arrivals",
    "Budget",
    "CallRefused",
    "Caller",
    "ComponentRandom",
    "DeadMan",
    "Deadline",
    "Deadlines",
    "Door",
    "Ending",
    "Executor",
    "First",
    "FirstSteps",
    "Gaps",
    "InLine",
    "Job",
    "LateSignals",
    "LightTask",
    "News",
    "OneShot",
    "Order",
    "OwnedTasks",
    "Owner",
    "Player",
    "Portal",
    "ProcessWatch",
    "RealTime",
    "Scheduler",
    "SignalWatch",
    "StallWatch",
    "Step",
    "Stepping",
    "SuspendWatch",
    "Tag",
    "TapeWriter",
    "TurnLoop",
    "Turns",
    "Urgency",
    "arrive",
    "ask_outside",
    "check_priority",
    "clock_beside",
    "clock_of",
    "collector",
    "current_owner",
    "current_task_of",
    "current_tasks",
    "every",
    "fail",
    "go_first",
    "had_turn",
    "has_come",
    "ignore",
    "leave_behind",
    "leave_line",
    "look_at",
    "new_event_loop",
    "now",
    "outside",
    "portal",
    "priority_of_thread",
    "raisable",
    "refusal",
    "run_and_end",
    "run_in_thread",
    "script_context",
    "settle",
    "spawn",
    "speaks_for_nobody",
    "threads_that_keep_the_process",
    "turn_of",
    "urgency",
    "waits_in_line",
    "wake",
    "wake_one",
]
