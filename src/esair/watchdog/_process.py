"""One watchdog process, from its start to its end, as the robot sees it."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import faulthandler
import json
import mmap
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from esair.loop import go_first, priority_of_thread

TELL_STACK = signal.SIGRTMAX  # The signal by which a watchdog asks


class StackFile:
    """A file in memory that gets the stack at each signal; one for the process.

    It is written by a signal handler in C, so also by code that never gives the
    interpreter back.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._users = 0
        self._file = -1

    def open(self) -> int:
        """Return its descriptor; it is there until as many have closed it."""
        with self._lock:
            if not self._users:
                self._file = os.memfd_create("esair-stack")
                faulthandler.register(TELL_STACK, self._file)
            self._users += 1
            return self._file

    def close(self) -> None:
        """Need it no more: the watchdog that was to read it has ended."""
        with self._lock:
            self._users -= 1
            if not self._users:
                faulthandler.unregister(TELL_STACK)
                os.close(self._file)


stack_file = StackFile()


_PROGRAM = Path(__file__).with_name("_program.py")


class Process:
    """Starts it without a turn in between: one that nobody knows would not end.

    Args:
        limit: How long the scheduler may stand still while something moves, in seconds.
        policy: What becomes of a process that was stopped.
        hear: Given each answer.
        ended: Called once it is over and was reaped.

    Raises:
        OSError: It cannot be started.
    """

    def __init__(
        self,
        limit: float,
        policy: str,
        hear: Callable[[bytes], None],
        ended: Callable[[Process], None],
    ) -> None:
        self._hear, self._ended = hear, ended
        self._waiting: collections.deque[tuple[bytes, int | None]] = collections.deque()
        with contextlib.ExitStack() as here, contextlib.ExitStack() as failed:
            mine, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            here.callback(its.close)
            failed.callback(mine.close)
            mine.setblocking(False)
            shared = os.memfd_create("esair-watchdog")
            here.callback(os.close, shared)
            me = os.pidfd_open(os.getpid())
            here.callback(os.close, me)
            stack = stack_file.open()
            failed.callback(stack_file.close)
            os.ftruncate(shared, mmap.PAGESIZE)
            self.page = mmap.mmap(shared, mmap.PAGESIZE)
            failed.callback(self.page.close)
            descriptors = (its.fileno(), me, shared, stack)
            arguments = [*descriptors, os.getpid(), limit, policy]
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(_PROGRAM), *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                pass_fds=descriptors,
                start_new_session=True,
            )
            failed.pop_all()
        self.pid = self._process.pid
        # Where the robot is in real time, it goes before.
        if priority := priority_of_thread():
            with contextlib.suppress(OSError):
                go_first(self.pid, priority + 1)
        self._channel: socket.socket | None = mine
        self._pidfd = os.pidfd_open(self.pid)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(mine, self._heard)
        self._loop.add_reader(self._pidfd, self.reap)

    # Its channel.

    def send(self, told: dict[str, object], descriptor: int | None = None) -> None:
        """Tell it something; what its channel does not take now waits in order.

        Raises:
            OSError: It cannot be told that.
        """
        if self._channel is None:
            return
        data = json.dumps(told).encode()
        if not self._waiting:
            with contextlib.suppress(BlockingIOError):
                self._send(data, descriptor)
                return
            self._loop.add_writer(self._channel, self._send_waiting)
        # A duplicate: the device may be closed before it is read.
        kept = None if descriptor is None else os.dup(descriptor)
        self._waiting.append((data, kept))

    def _send(self, data: bytes, descriptor: int | None) -> None:
        assert self._channel is not None
        if descriptor is None:
            self._channel.send(data)
        else:
            socket.send_fds(self._channel, [data], [descriptor])

    def _send_waiting(self) -> None:
        assert self._channel is not None
        while self._waiting:
            data, descriptor = self._waiting[0]
            try:
                self._send(data, descriptor)
            except BlockingIOError:
                return
            except OSError as error:
                place = json.loads(data)["place"]
                self._hear(json.dumps(["refused", place, str(error)]).encode())
            self._waiting.popleft()
            if descriptor is not None:
                os.close(descriptor)
        self._loop.remove_writer(self._channel)

    def _heard(self) -> None:
        assert self._channel is not None
        try:
            data = self._channel.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._hear(data)
        else:  # it is about to end: that tells more
            self._loop.remove_reader(self._channel)

    # Its end.

    def let_go(self) -> None:
        """Speak with it no more."""
        if self._channel is not None:
            self._loop.remove_reader(self._channel)
            self._loop.remove_writer(self._channel)
            self._channel.close()
            self._channel = None
        while self._waiting:
            _, descriptor = self._waiting.popleft()
            if descriptor is not None:
                os.close(descriptor)

    def kill(self) -> None:
        self._process.kill()

    def reap(self) -> None:
        """It is over: its descriptor says so."""
        if self._pidfd < 0:
            return
        self._loop.remove_reader(self._pidfd)
        os.close(self._pidfd)
        self._pidfd = -1
        self.code: int = self._process.wait()  # how it has ended
        self.let_go()
        stack_file.close()
        self._ended(self)

    async def gone(self, within: float) -> None:
        """Wait until it has ended by itself; then end it."""
        try:
            await asyncio.to_thread(self._process.wait, within)
        except subprocess.TimeoutExpired:
            self.kill()
            await asyncio.to_thread(self._process.wait)
        self.reap()
