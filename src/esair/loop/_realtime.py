"""Real time: the thread of a loop goes before what else the computer does."""

from __future__ import annotations

import asyncio
import ctypes
import math
import os
import resource
import sys
import threading
from pathlib import Path
from typing import ClassVar

from esair.exceptions import ConfigError
from esair.loop._of_loop import OfLoop
from esair.loop._overseer import overseer

PRIORITY = 50
"""The priority in `SCHED_FIFO` unless one is given: that of Linux' own interrupt threads."""

MOST = 98
"""The highest; the watchdog's is higher by one."""

SWITCH = 0.0005
"""How long another thread may keep the interpreter when the loop wants it, in seconds.

Python's own 5 ms are five steps of a robot at 1 kHz.
"""

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # of mlockall
_MAY_LOCK = 1 << 14  # CAP_IPC_LOCK


def check_priority(owner: str, realtime: object) -> int | None:
    """Return the priority that is asked for; None if none is.

    Raises:
        ConfigError: It is neither true, false nor a priority.
    """
    if isinstance(realtime, bool):
        return PRIORITY if realtime else None
    if isinstance(realtime, int) and 1 <= realtime <= MOST:
        return realtime
    told = f"expected true, false or a priority of 1 to {MOST}, not {realtime!r:.80}"
    raise ConfigError(owner, "realtime", told)


def go_first(process: int, priority: int) -> None:
    """Have a process, 0 is this thread, go before all of a lower priority.

    What it starts does not inherit that.

    Raises:
        OSError: It is not allowed.
    """
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(process, policy, os.sched_param(priority))


def priority_of_thread() -> int:
    """Return the priority of this thread in real time; 0 if it has none."""
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_FIFO:
        return 0
    return os.sched_getparam(0).sched_priority


def refusal(priority: int) -> str:
    """Return what this computer refuses and what to do about it; empty if nothing.

    It is tried, in a thread of its own; what was there stays as it is.
    """
    refused: list[str] = []

    def attempt() -> None:
        try:
            go_first(0, priority + 1)  # that of the watchdog
        except OSError:
            refused.append(f"priority {priority}")

    thread = threading.Thread(target=attempt, name="esair real time")
    thread.start()
    thread.join()
    if not _may_lock():
        refused.append("locked memory")
    if not refused:
        return ""
    what = " and ".join(refused)
    if os.geteuid() == 0:  # root has all limits: the kernel, or what contains it
        return (
            f"the kernel refuses {what}: start a container with --cap-add=SYS_NICE "
            "--cap-add=IPC_LOCK; a control group needs some cpu.rt_runtime_us"
        )
    return (
        f"no right to {what}: in this shell, then start it again: sudo prlimit --pid $$ "
        f"--rtprio={priority + 1} --memlock=unlimited; a service has LimitRTPRIO= and "
        "LimitMEMLOCK="
    )


def _may_lock() -> bool:
    if resource.getrlimit(resource.RLIMIT_MEMLOCK)[1] == resource.RLIM_INFINITY:
        return True
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    (effective,) = (x for x in status.splitlines() if x.startswith("CapEff:"))
    return bool(int(effective.split()[1], 16) & _MAY_LOCK)


def _lock_memory() -> None:
    """Keep all pages in memory: those that are there, and others once they are used."""
    hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    if hard == resource.RLIM_INFINITY:  # else it is a capability that gives the right
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    libc = ctypes.CDLL(None, use_errno=True)
    for flags in (_CURRENT, _FUTURE | _ON_FAULT):
        if libc.mlockall(flags):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))


class RealTime(OfLoop):
    """Has the thread of a loop go first while robots run there that want it.

    Threads and processes that are started in it do not inherit that: those of buses, the
    recorder and the page stay as they are; what watches it goes before it. The pages of
    the process are locked, and a thread that computes gives the interpreter back after
    `SWITCH`. Garbage is collected in gaps as always.
    """

    _locked: ClassVar[int] = 0  # how many loops of this process want their pages

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._asked: list[int] = []
        self._before = (os.SCHED_OTHER, os.sched_param(0))
        self._switch = math.nan

    def start(self, priority: int) -> str:
        """Go first from now on; returns what is refused: then nothing has changed.

        It is called in the thread of the loop.
        """
        if told := refusal(priority):
            return told
        if not self._asked:
            self._before = os.sched_getscheduler(0), os.sched_getparam(0)
            go_first(0, priority)  # else to lock the pages takes long
            try:
                _lock_memory()
            except OSError as error:
                os.sched_setscheduler(0, *self._before)
                return f"memory cannot be locked: {error.strerror}"
            RealTime._locked += 1
            self._switch = sys.getswitchinterval()
            sys.setswitchinterval(min(SWITCH, self._switch))
        self._asked.append(priority)
        return ""

    def lead(self) -> None:
        """Go first, and what watches this thread before it.

        That takes the interpreter often: a busy computer must not let it wait then.
        """
        if self._asked:
            go_first(0, max(self._asked))
            if overseer.thread_id is not None:
                go_first(overseer.thread_id, max(self._asked) + 1)

    def stop(self, priority: int) -> None:
        """One that wanted it is over; with the last one all is as it was."""
        self._asked.remove(priority)
        if self._asked:
            self.lead()
            return
        RealTime._locked -= 1
        if not RealTime._locked:
            ctypes.CDLL(None).munlockall()
        sys.setswitchinterval(self._switch)
        for thread in (overseer.thread_id, 0):
            if thread is not None:
                os.sched_setscheduler(thread, *self._before)
