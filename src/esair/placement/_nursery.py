"""Where children come from: the process that forks them, as the robot's process sees it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from typing import NamedTuple

_lock = threading.Lock()


class Ends(NamedTuple):
    """What the robot's process has of a child."""

    wire: socket.socket
    words: int
    status: socket.socket


class Nursery:
    """The one process of this process that makes children; counted, ends with the last.

    It starts in 0.2 to 0.4 s of its own time: hold it early.
    """

    _one: Nursery | None = None

    def __init__(self) -> None:
        self._users = 0
        self._pid = os.getpid()
        self._start()

    def _start(self) -> None:
        mine, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        me = os.pidfd_open(os.getpid())
        try:
            # The kernel ends it with the thread that has started it: that must last.
            lasts = threading.current_thread() is threading.main_thread()
            arguments = (its.fileno(), me, os.getpid(), int(lasts))
            self._process = subprocess.Popen(
                [sys.executable, "-m", "esair.placement._server", *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                pass_fds=(its.fileno(), me),
                start_new_session=True,  # Ctrl-C is the robot's
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
                },
            )
        except BaseException:
            mine.close()
            raise
        finally:
            its.close()
            os.close(me)
        self._control = mine

    @classmethod
    def hold(cls) -> Nursery:
        """Return the one there is, for one more user; see `let_go`."""
        with _lock:
            one = cls._one
            if one is None or one._pid != os.getpid():  # noqa: SLF001 - its own class
                one = cls._one = Nursery()
            one._users += 1
            return one

    def let_go(self) -> None:
        """Be done with it; the last user ends it."""
        with _lock:
            self._users -= 1
            if self._users:
                return
            if Nursery._one is self:
                Nursery._one = None
            self._control.close()
            self._process.kill()  # its children die with it
            self._process.wait()

    def wait(self) -> None:
        """Wait until it can make children, in a thread."""
        with contextlib.suppress(OSError):
            self._control.recv(1, socket.MSG_PEEK)

    def child(self) -> Ends:
        """Ask for a child; what is told to it waits until it is there.

        Raises:
            OSError: There are no descriptors left.
        """
        with contextlib.ExitStack() as failed, contextlib.ExitStack() as its:
            kind = socket.SOCK_SEQPACKET
            wire, its_wire = socket.socketpair(socket.AF_UNIX, kind)
            failed.callback(wire.close)
            its.callback(its_wire.close)
            words, its_words = os.pipe2(os.O_CLOEXEC)
            failed.callback(os.close, words)
            its.callback(os.close, its_words)
            status, its_status = socket.socketpair(socket.AF_UNIX, kind)
            failed.callback(status.close)
            its.callback(its_status.close)
            for each in (wire, status):
                each.setblocking(False)
            os.set_blocking(words, False)
            given = [its_wire.fileno(), its_words, its_status.fileno()]
            with _lock:
                if self._process.poll() is not None:  # somebody has killed it
                    self._control.close()
                    self._start()
                socket.send_fds(self._control, [b"c"], given)
            failed.pop_all()
            return Ends(wire, words, status)


def told_end(code: int | None) -> str:
    """Say how a process has ended."""
    if code is None:
        return "is gone"
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"has exited with {code}"
