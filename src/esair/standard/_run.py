"""The blocking form of a robot, for scripts: run it until it ends, or a signal comes."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import anyio

from esair.exceptions import ConfigError, EsairError
from esair.loop import (
    Ending,
    LateSignals,
    TurnLoop,
    run_and_end,
    threads_that_keep_the_process,
)
from esair.standard._robot import LAST_WAIT, STALL_WARNING, Robot, not_while_looking
from esair.standard._told import show_at_the_end
from esair.values import check_seconds

_log = logging.getLogger("esair")


def run(
    robot: Robot,
    *,
    duration: float | None = None,
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None,
    stall_warning: float | None = STALL_WARNING,
) -> None:
    """Run a robot until its behaviors have ended, or until a signal.

    SIGINT (Ctrl-C), SIGTERM and SIGHUP stop it in order, with every actuator safe;
    the program then exits with 128 plus the number of the signal. A second signal
    shortens the stop, a third one ends the program within a second, also while code
    holds the event loop. It returns, or ends the process, at most `grace` and two
    seconds after the reason to end, whatever behaviors and threads do.

    Args:
        robot: What to run.
        duration: Stop after this many seconds.
        loop_factory: Makes the event loop, such as ``uvloop.new_event_loop``;
            one whose runs can be repeated unless given (`esair replay`); its clock
            stands still while a piece of code runs.
        stall_warning: As for `Robot`; what was said there counts unless given.

    Raises:
        ConfigError: It is no robot, or an event loop is running already.
        ExceptionGroup: The robot cannot start; every mistake is named.
        BehaviorFailedError: A behavior has failed for good.
        SystemExit: A signal came.
    """
    if not isinstance(robot, Robot):
        raise ConfigError("run", "robot", f"expected an esair.Robot, not {robot!r:.80}")
    not_while_looking(robot)
    if asyncio._get_running_loop() is not None:  # noqa: SLF001 - it does not raise
        raise ConfigError(
            "run", "", "an event loop is running: write 'async with robot:' in it"
        )
    if duration is not None:
        check_seconds(f"robot {robot.name!r}", "duration", duration)
    gc.collect()

    if stall_warning != STALL_WARNING:
        robot._care.stall_warning = stall_warning  # noqa: SLF001 - run is the robot's own entry
    before = set(threading.enumerate())
    ending: Ending | None = None

    robot._keeping.duration = duration  # noqa: SLF001 - as above
    robot._keeping.script = "", {}  # noqa: SLF001 - as above

    async def main() -> None:
        nonlocal ending
        loop = asyncio.get_running_loop()
        ending = Ending(loop, patience=robot._grace + LAST_WAIT)  # noqa: SLF001 - as above
        ending.start()
        robot._stopping.watch.last = ending  # noqa: SLF001 - as above
        robot._stopping.interrupts = True  # noqa: SLF001 - as above
        await run_to_its_end(robot, duration, ending)

    signals = LateSignals()
    try:
        with signals:
            run_and_end(main(), loop_factory or TurnLoop)
            if signals.number is not None:  # when the robot had stopped by itself
                raise SystemExit(128 + signals.number)
    except (EsairError, ExceptionGroup) as error:
        show_at_the_end(error)
        raise
    except SystemExit:
        if signals.number is not None:
            _leave_threads(before, 128 + signals.number)
        raise
    finally:
        if ending is not None:
            ending.stop()


async def run_to_its_end(
    robot: Robot, duration: float | None, ending: Ending | None = None
) -> None:
    """Run a robot in the running loop; in a replay there is nothing that ends it."""
    async with robot:
        if duration is not None and ending is not None:
            ending.because(time.monotonic() + duration)
        with anyio.move_on_after(duration) as scope:
            await robot.ended()
        reason = "its behaviors have ended"
        if scope.cancelled_caught:
            reason = f"it has run for {duration} s"
        robot._stopping.because(reason)  # noqa: SLF001 - as above


def recorded_as(robot: Robot, script: str, **options: Any) -> None:
    """Say what repeats a robot's run, if it is not `run` that runs it."""
    robot._keeping.script = script, options  # noqa: SLF001 - the robot's own entry


def prepare_replay(robot: Robot, seed: int, *, has_seat: bool) -> None:
    """Make a robot as it was when it was recorded, for `run_to_its_end`."""
    robot.seed = seed
    robot._seat.socket, robot._seat.page = has_seat, None  # noqa: SLF001 - the robot's own entry
    robot._care.stall_warning = robot._care.realtime = None  # noqa: SLF001 - as above
    robot._keeping.recording = None  # noqa: SLF001 - as above


def _leave_threads(before: set[threading.Thread], code: int) -> None:
    """End the process here if threads of the robot would keep it from ending."""
    names = threads_that_keep_the_process(before)
    if names:
        _log.warning("threads are left behind: %s", ", ".join(names))
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
