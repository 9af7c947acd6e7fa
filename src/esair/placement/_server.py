"""The program that makes children: a process that does nothing but fork.

It has esair imported, no thread and no device. Each request comes with the descriptors of
one child; what becomes of the child is told on the last of them. It ends with the process
that has started it, and its children end with it: it watches for that, and the kernel does.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import select
import signal
import socket
import sys
from typing import NoReturn

_PDEATHSIG = 1  # PR_SET_PDEATHSIG
_PATIENCE = 0.5  # how long a child has to end that nobody speaks with any more, in s

_libc = ctypes.CDLL(None, use_errno=True)


def _die_with_parent(parent: int) -> None:
    _libc.prctl(_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)


def main() -> None:
    """Serve until the process that has started this one is gone."""
    control_fd, parent_fd, parent, dies = map(int, sys.argv[1:])
    if dies:
        _die_with_parent(parent)
    # Each child has it from the start: what it is made of, and what its module asks for.
    import esair.placement._child  # noqa: F401

    gc.collect()
    gc.freeze()  # what is there is never written to: it is one for all
    control = socket.socket(fileno=control_fd)
    control.send(b"r")  # read by nobody: it can be looked at for ever
    Server(control, parent_fd).serve()


class Server:
    """Makes children, and tells how they have ended."""

    def __init__(self, control: socket.socket, parent_fd: int) -> None:
        self._control = control
        self._parent_fd = parent_fd
        self._children: dict[int, int] = {}  # those that live: their status, by pidfd
        self._pids: dict[int, int] = {}
        self._left: dict[int, float] = {}
        """When those are killed that nobody speaks with any more."""
        self._poll = select.poll()
        self._poll.register(control, select.POLLIN)
        self._poll.register(parent_fd, select.POLLIN)

    def serve(self) -> None:
        """Fork when asked, reap, and end with the robot's process."""
        clock = __import__("time").monotonic
        while True:
            wait = None
            if self._left:
                wait = max(0.0, min(self._left.values()) - clock()) * 1000 + 1
            for fd, _ in self._poll.poll(wait):
                if fd == self._parent_fd:
                    self._end()
                elif fd == self._control.fileno():
                    self._hear()
                elif fd in self._children:
                    self._reap(fd)
                else:
                    self._leave(fd, clock() + _PATIENCE)
            for pidfd, until in tuple(self._left.items()):
                if until <= clock():
                    del self._left[pidfd]
                    _kill(pidfd)

    def _leave(self, status: int, until: float) -> None:
        """Nobody reads this status any more: its child has a little time to end."""
        for pidfd, each in self._children.items():  # it may just have been reaped
            if each == status:
                self._poll.unregister(status)
                self._left[pidfd] = until

    def _hear(self) -> None:
        try:
            data, files, _, _ = socket.recv_fds(
                self._control, 1, 3, socket.MSG_CMSG_CLOEXEC
            )
        except OSError:
            data, files = b"", []
        if not data:
            self._end()
        wire, words, status = files
        try:
            pid = os.fork()
        except OSError as error:
            os.write(status, f"failed {error}".encode())
            for fd in files:
                os.close(fd)
            return
        if pid == 0:
            self._become_child(wire, words, status)
        os.close(wire)
        os.close(words)
        pidfd = os.pidfd_open(pid)
        self._children[pidfd], self._pids[pidfd] = status, pid
        self._poll.register(pidfd, select.POLLIN)
        self._poll.register(status, 0)  # its end alone
        told = socket.socket(fileno=os.dup(status))
        with contextlib.suppress(OSError), told:  # nobody may want it any more
            socket.send_fds(told, [b"pid %d" % pid], [pidfd])

    def _become_child(self, wire: int, words: int, status: int) -> NoReturn:
        code = 70
        try:
            server = os.getppid()
            _die_with_parent(server)
            keep = {0, 1, 2, wire, words}
            for name in os.listdir("/proc/self/fd"):
                if int(name) not in keep:
                    with contextlib.suppress(OSError):
                        os.close(int(name))
            os.dup2(words, 1)
            os.dup2(words, 2)
            os.close(words)
            self._control.detach()
            from esair.placement._child import live

            code = live(wire)
        except BaseException:  # told by its last words
            import traceback

            traceback.print_exc()
        finally:
            with contextlib.suppress(BaseException):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(code)

    def _reap(self, pidfd: int) -> None:
        self._poll.unregister(pidfd)
        _, code = os.waitpid(self._pids.pop(pidfd), 0)
        status = self._children.pop(pidfd)
        self._left.pop(pidfd, None)
        with contextlib.suppress(OSError):
            os.write(status, b"over %d" % os.waitstatus_to_exitcode(code))
        with contextlib.suppress(KeyError):
            self._poll.unregister(status)
        os.close(status)
        os.close(pidfd)

    def _end(self) -> NoReturn:
        for pidfd in self._children:
            _kill(pidfd)
        for pid in self._pids.values():
            os.waitpid(pid, 0)
        os._exit(0)


def _kill(pidfd: int) -> None:
    with contextlib.suppress(OSError):
        signal.pidfd_send_signal(pidfd, signal.SIGKILL)


if __name__ == "__main__":
    main()
