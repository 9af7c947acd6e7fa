"""Where children come from: a process that does nothing but fork.

`Nursery` is that process as the robot's sees it; `Server` is the program that runs in it. It
has loaded of esair what the robot's has; it has no thread and no device. Each request comes
with the descriptors of one child; what becomes of the child is told on the last of them. It
watches for the end of the process that has started it, and then ends its children and what
they have begun. The kernel ends children with it; it does not end it with the robot, as then
nobody would be left who knows what they have begun.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Final, NamedTuple, NoReturn

_PDEATHSIG: Final = 1  # PR_SET_PDEATHSIG
_PATIENCE: Final = 0.5
"""How long a child has to end that nobody speaks with any more, in seconds."""

_PROGRAM: Final = """import sys
sys.path[:] = {!a}
from esair.placement._nursery import main
main()
"""  # the path is no variable of the environment: what a component begins would have it

_libc = ctypes.CDLL(None, use_errno=True)
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
        try:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    *subprocess._args_from_interpreter_flags(),  # type: ignore[attr-defined]  # noqa: SLF001 - as multiprocessing does
                    *("-P", "-c", _PROGRAM.format(import_path())),
                    str(os.getpid()),
                    *(each for each in sys.modules if each.startswith("esair.")),
                ],
                stdin=its.fileno(),
                # Where the robot has none, what is opened first would take its number.
                stdout=None if sys.__stdout__ else subprocess.DEVNULL,
                stderr=None if sys.__stderr__ else subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is the robot's
            )
        except BaseException:
            mine.close()
            raise
        finally:
            its.close()
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
        """Be done with it; the last user ends it, and does not wait for that."""
        with _lock:
            self._users -= 1
            if self._users:
                return
            if Nursery._one is self:
                Nursery._one = None
        self._control.close()  # it ends what it has made, and itself
        try:
            threading.Thread(target=self._end, name="esair-nursery").start()
        except RuntimeError:  # there are no more threads
            self._end()

    def _end(self) -> None:
        self._process.send_signal(signal.SIGCONT)  # if it was stopped, too
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE)
        self._process.kill()  # its children die with it
        self._process.wait()

    def wait(self) -> None:
        """Wait until it can make children, in a thread."""
        ready = select.poll()  # a receive would wake one alone of those who wait
        with contextlib.suppress(ValueError):  # it is closed: nobody wants it any more
            ready.register(self._control, select.POLLIN)
            ready.poll()

    def told(self) -> str:
        """Say why a child did not start whose status has come to nothing."""
        how = told_end(self._process.poll())
        return f"did not start: what makes processes, {sys.executable}, {how}"

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
                with contextlib.suppress(BrokenPipeError):  # told by the status
                    socket.send_fds(self._control, [b"c"], given)
            failed.pop_all()
            return Ends(wire, words, status)


def import_path() -> list[str]:
    """Return where modules are found; Python passes over a `Path` that somebody added."""
    return [each for each in sys.path if isinstance(each, str)]


def told_end(code: int | None) -> str:
    """Say how a process has ended."""
    if code is None:
        return "is gone"
    if code < 0:
        return f"was killed by {signal.Signals(-code).name}"
    return f"has exited with {code}"


def _die_with_parent(parent: int) -> None:
    _libc.prctl(_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)


def main() -> None:
    """Serve until the process that has started this one is gone."""
    parent = int(sys.argv[1])
    # One that was stopped goes on when its robot dies: it has children to end.
    _libc.prctl(_PDEATHSIG, signal.SIGCONT)
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # The robot's: it stops in order, and ends this. Not ignored: what a component
        # begins would ignore them, too.
        signal.signal(each, lambda *_: None)
        signal.siginterrupt(each, False)
    # Each child has it from the start: what it is made of, and what its module asks for.
    # What the robot's process has loaded too, the module of a component is likely to want.
    gone = select.poll()
    gone.register(0, 0)  # the end of the other side alone
    for module in (*sys.argv[2:], "esair.placement._child"):
        if gone.poll(0):  # nobody wants it any more
            return
        if not module.endswith("__main__"):
            with contextlib.suppress(ImportError):
                importlib.import_module(module)
    gc.collect()
    gc.freeze()  # what is there is never written to: it is one for all
    control = socket.socket(fileno=0)
    try:
        parent_fd = os.pidfd_open(parent)
        control.send(b"r")  # read by nobody: it can be looked at for ever
    except OSError:  # as above
        return
    Server(control, parent_fd).serve()


class Child(NamedTuple):
    """One that lives."""

    pid: int
    status: int
    """Where its end is told; nobody speaks with it any more if it is closed."""


class Server:
    """Makes children, and tells how they have ended."""

    def __init__(self, control: socket.socket, parent_fd: int) -> None:
        self._control = control
        self._parent_fd = parent_fd
        self._pid = os.getpid()
        self._children: dict[int, Child] = {}  # by pidfd
        self._left: dict[int, float] = {}
        """When those are killed that nobody speaks with any more, by pidfd."""
        self._poll = select.poll()
        self._poll.register(control, select.POLLIN)
        self._poll.register(parent_fd, select.POLLIN)

    def serve(self) -> None:
        """Fork when asked, reap, and end with the robot's process."""
        clock = time.monotonic
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
                else:  # a status: its child has a little time to end
                    for pidfd, child in self._children.items():
                        if child.status == fd:
                            self._poll.unregister(fd)
                            self._left[pidfd] = clock() + _PATIENCE
            for pidfd, until in tuple(self._left.items()):
                if until <= clock():
                    del self._left[pidfd]
                    _kill(pidfd)

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
            with contextlib.suppress(OSError):
                os.write(status, f"failed {error}".encode())
            for fd in files:
                os.close(fd)
            return
        if pid == 0:
            self._become_child(wire, words)
        os.close(wire)
        os.close(words)
        pidfd = os.pidfd_open(pid)
        self._children[pidfd] = Child(pid, status)
        self._poll.register(pidfd, select.POLLIN)
        self._poll.register(status, 0)  # its end alone
        told = socket.socket(fileno=os.dup(status))
        with contextlib.suppress(OSError), told:  # nobody may want it any more
            socket.send_fds(told, [b"pid %d" % pid], [pidfd])

    def _become_child(self, wire: int, words: int) -> NoReturn:
        code = 70
        try:
            _die_with_parent(self._pid)
            os.setsid()  # what it starts ends with it
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(words, 1)
            os.dup2(words, 2)
            keep = {0, 1, 2, wire}
            for name in os.listdir("/proc/self/fd"):
                if int(name) not in keep:
                    with contextlib.suppress(OSError):
                        os.close(int(name))
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
        pid, status = self._children.pop(pidfd)
        end_group(pid)  # while it is there no other process has its number
        _, code = os.waitpid(pid, 0)
        self._left.pop(pidfd, None)
        with contextlib.suppress(OSError):
            os.write(status, b"over %d" % os.waitstatus_to_exitcode(code))
        with contextlib.suppress(KeyError):
            self._poll.unregister(status)
        os.close(status)
        os.close(pidfd)

    def _end(self) -> NoReturn:
        for pidfd, child in self._children.items():
            _kill(pidfd)
            end_group(child.pid)
        for child in self._children.values():
            os.waitpid(child.pid, 0)
        os._exit(0)


def end_group(pid: int) -> None:
    """End what a child has started, if that is still of its group."""
    with contextlib.suppress(OSError):
        os.killpg(pid, signal.SIGKILL)


def _kill(pidfd: int) -> None:
    with contextlib.suppress(OSError):
        signal.pidfd_send_signal(pidfd, signal.SIGKILL)
