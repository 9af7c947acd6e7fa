"""Real time on a computer that says what it was told: who goes first, what is put back."""

from __future__ import annotations

import errno
import os
import sys
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from esair.loop import _realtime, check_priority, refusal
from esair.loop._realtime import SWITCH, RealTime, priority_of_thread

pytestmark = pytest.mark.virtual_clock

FIFO, OTHER, RESET = os.SCHED_FIFO, os.SCHED_OTHER, os.SCHED_RESET_ON_FORK
OVERSEER = 77
CURRENT, FUTURE, ON_FAULT = 1, 2, 4
IPC_LOCK = 1 << 14


class Computer:
    """A Linux that obeys as far as it allows."""

    def __init__(self) -> None:
        self.home = threading.current_thread()
        self.most = 99  # the highest priority that it allows
        self.ranks: dict[int, tuple[int, int]] = {0: (OTHER, 0), OVERSEER: (OTHER, 0)}
        """Of this thread and the overseer's: the policy and the priority."""
        self.pages = 0  # which are locked
        self.unlockable = 0  # which of them cannot be
        self.soft, self.hard = 1_000, -1
        self.capabilities = 0
        self.user = 1_000
        self.switch = 0.005

    def set_scheduler(self, thread: int, policy: int, param: Any) -> None:
        if param.sched_priority > self.most:
            raise PermissionError
        if threading.current_thread() is not self.home:
            return  # it is only tried there
        self.ranks[thread] = (policy, param.sched_priority)

    def lock(self, pages: int) -> int:
        if pages & self.unlockable:
            return -1
        self.pages |= pages
        return 0

    def unlock(self) -> int:
        self.pages = 0
        return 0

    def limit(self, _which: int, limits: tuple[int, int]) -> None:
        self.soft, self.hard = limits

    def status(self) -> str:
        return f"Name:\tpython\nCapInh:\tffff\nCapEff:\t{self.capabilities:016x}\n"


@pytest.fixture
def computer(monkeypatch: pytest.MonkeyPatch) -> Computer:
    it = Computer()
    library = SimpleNamespace(mlockall=it.lock, munlockall=it.unlock)
    ctypes = SimpleNamespace(
        CDLL=lambda *_, **__: library, get_errno=lambda: errno.ENOMEM
    )
    resource = SimpleNamespace(
        RLIMIT_MEMLOCK=8,
        RLIM_INFINITY=-1,
        getrlimit=lambda _: (it.soft, it.hard),
        setrlimit=it.limit,
    )
    file = SimpleNamespace(read_text=lambda **_: it.status())
    monkeypatch.setattr(_realtime, "ctypes", ctypes)
    monkeypatch.setattr(_realtime, "resource", resource)
    monkeypatch.setattr(_realtime, "Path", lambda _path: file)
    monkeypatch.setattr(_realtime, "overseer", SimpleNamespace(thread_id=OVERSEER))
    monkeypatch.setattr(os, "sched_setscheduler", it.set_scheduler)
    monkeypatch.setattr(os, "sched_getscheduler", lambda thread: it.ranks[thread][0])
    monkeypatch.setattr(
        os, "sched_getparam", lambda thread: os.sched_param(it.ranks[thread][1])
    )
    monkeypatch.setattr(os, "geteuid", lambda: it.user)
    monkeypatch.setattr(sys, "getswitchinterval", lambda: it.switch)
    monkeypatch.setattr(sys, "setswitchinterval", lambda s: setattr(it, "switch", s))
    return it


def of_a_loop() -> RealTime:
    loop: Any = None
    return RealTime(loop)


def test_the_loop_goes_first_and_what_watches_it_before_that(
    computer: Computer,
) -> None:
    """What they start does not inherit it; all pages are locked."""
    first = of_a_loop()
    assert first.start(20) == ""
    assert computer.ranks[0] == (FIFO | RESET, 20)
    assert priority_of_thread() == 20
    assert computer.pages == CURRENT | FUTURE | ON_FAULT
    assert (computer.soft, computer.switch) == (-1, SWITCH)
    first.lead()
    assert computer.ranks == {0: (FIFO | RESET, 20), OVERSEER: (FIFO | RESET, 21)}
    first.stop(20)
    assert computer.ranks == {0: (OTHER, 0), OVERSEER: (OTHER, 0)}
    assert priority_of_thread() == 0
    assert (computer.pages, computer.switch) == (0, 0.005)
    first.lead()
    assert computer.ranks[0] == (OTHER, 0)


def test_the_highest_priority_of_a_loop_counts(computer: Computer) -> None:
    """Until its robot ends; the last one puts all back."""
    loop = of_a_loop()
    for priority in (20, 40, 30):
        assert loop.start(priority) == ""
    loop.lead()
    assert computer.ranks == {0: (FIFO | RESET, 40), OVERSEER: (FIFO | RESET, 41)}
    loop.stop(40)
    assert computer.ranks == {0: (FIFO | RESET, 30), OVERSEER: (FIFO | RESET, 31)}
    loop.stop(30)
    loop.stop(20)
    assert computer.ranks == {0: (OTHER, 0), OVERSEER: (OTHER, 0)}
    assert (computer.pages, computer.switch) == (0, 0.005)


def test_pages_stay_locked_while_another_loop_wants_them(computer: Computer) -> None:
    """They are those of the process."""
    loops = of_a_loop(), of_a_loop()
    for each in loops:
        each.start(20)
    loops[0].stop(20)
    assert computer.pages
    loops[1].stop(20)
    assert computer.pages == 0


def test_a_switch_that_is_shorter_stays(computer: Computer) -> None:
    """The program has said so."""
    computer.switch = SWITCH / 2
    loop = of_a_loop()
    loop.start(20)
    assert computer.switch == SWITCH / 2
    loop.stop(20)


def test_where_nobody_watches_the_loop_goes_first_alone(
    computer: Computer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then there is no such thread."""
    monkeypatch.setattr(_realtime, "overseer", SimpleNamespace(thread_id=None))
    loop = of_a_loop()
    loop.start(20)
    loop.lead()
    loop.stop(20)
    assert computer.ranks == {0: (OTHER, 0), OVERSEER: (OTHER, 0)}


def test_what_is_refused_changes_nothing(computer: Computer) -> None:
    """Neither the priority, for which the watchdog needs one more, nor memory."""
    computer.most = 20
    loop = of_a_loop()
    assert loop.start(20).startswith("no right to priority 20: in this shell")
    assert "--rtprio=21 --memlock=unlimited" in loop.start(20)
    assert computer.ranks[0] == (OTHER, 0)
    assert (computer.pages, computer.switch) == (0, 0.005)
    computer.most = 21
    assert refusal(20) == ""
    computer.most = 99
    computer.unlockable = ON_FAULT
    told = f"memory cannot be locked: {os.strerror(errno.ENOMEM)}"
    assert loop.start(20) == told
    assert computer.ranks[0] == (OTHER, 0)
    assert computer.switch == 0.005


def test_memory_may_be_locked_by_a_limit_or_by_a_capability(
    computer: Computer,
) -> None:
    """Without both it is refused; with the capability the limit stays as it is."""
    computer.hard = 2_000
    computer.capabilities = ~IPC_LOCK & 0xFFFFFF
    assert refusal(20).startswith("no right to locked memory: ")
    computer.most = 20
    assert refusal(20).startswith("no right to priority 20 and locked memory: ")
    computer.most, computer.capabilities = 99, IPC_LOCK
    assert refusal(20) == ""
    loop = of_a_loop()
    assert loop.start(20) == ""
    assert (computer.soft, computer.hard) == (1_000, 2_000)
    loop.stop(20)


def test_root_is_told_what_a_container_needs(computer: Computer) -> None:
    """It has all limits."""
    computer.user, computer.most = 0, 20
    assert refusal(20).startswith("the kernel refuses priority 20: start a container")


@pytest.mark.parametrize(
    ("asked", "priority"), [(True, 50), (False, None), (1, 1), (98, 98)]
)
def test_a_priority_that_is_asked_for(asked: object, priority: int | None) -> None:
    """True is that of the kernel's own threads; the watchdog needs one more than 98."""
    assert check_priority("robot", asked) == priority
