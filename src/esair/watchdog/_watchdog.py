"""The robot's side of its watchdog: it arms devices, and tells that it is alive."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import mmap
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from esair.watchdog._frames import Outlet, SafeFrames
from esair.watchdog._limit import LIMIT
from esair.watchdog._stack import stack_file

ANSWER_WITHIN = 1.0  # How long the watchdog may take to answer, in seconds
GONE_WITHIN = 0.1  # How long it may take to end after an orderly stop, in seconds

STUCK_AFTER = 40
"""After how many beats of the robot without a look a watchdog is killed."""

AT_ONCE = 64
"""How much may be asked at the same time: more words, or answers, may not find room."""

_PROGRAM = Path(__file__).with_name("_program.py")
_PAGE = mmap.PAGESIZE
_BEATS, _MOVING, _LATCH, _LOOKS, _OVER = range(5)

_log = logging.getLogger("esair")


class Watchdog:
    """Starts the watchdog's process and speaks with it; for one robot.

    Args:
        limit: How long the scheduler may stand still while something moves, in seconds.
        policy: What becomes of a process that was stopped: ``"kill"`` ends it,
            ``"freeze"`` leaves it stopped.
        on_death: Called when the watchdog's process has died by itself.
    """

    def __init__(
        self,
        *,
        limit: float = LIMIT,
        policy: Literal["kill", "freeze"] = "kill",
        on_death: Callable[[], None] = lambda: None,
    ) -> None:
        self.limit = limit
        self.policy = policy
        self._on_death = on_death
        self._moving: set[str] = set()
        self._places: dict[str, int] = {}
        self._answers: dict[int, asyncio.Future[str]] = {}
        self._last = 0
        self._beats = self._looks = self._looked = 0
        self._room = asyncio.Semaphore(AT_ONCE)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: socket.socket | None = None
        self._pidfd = -1
        self._page: mmap.mmap | None = None
        self._numbers = memoryview(bytearray(_PAGE)).cast("Q")

    # Its process.

    async def start(self) -> None:
        """Start the process.

        Raises:
            OSError: It cannot be started.
        """
        loop = self._loop = asyncio.get_running_loop()
        if os.getpid() == 1:
            told = (
                "process 1 of a container takes its watchdog with it: give it an init"
            )
            raise OSError(f"{told} (docker run --init)")
        self._spawn()
        assert self._channel is not None
        loop.add_reader(self._channel, self._hear)
        loop.add_reader(self._pidfd, self._died)

    def _spawn(self) -> None:
        """Start it without a turn in between: one that nobody knows would not end."""
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
            os.ftruncate(shared, _PAGE)
            self._share(mmap.mmap(shared, _PAGE))
            failed.callback(self._share, None)
            descriptors = (its.fileno(), me, shared, stack)
            arguments = [*descriptors, os.getpid(), self.limit, self.policy]
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(_PROGRAM), *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                pass_fds=descriptors,
                start_new_session=True,
            )
            failed.pop_all()
        self._channel = mine
        self._pidfd = os.pidfd_open(self._process.pid)

    def _share(self, page: mmap.mmap | None) -> None:
        """Count in a page that the process sees; in one's own if it is None."""
        numbers = memoryview(page or bytearray(_PAGE)).cast("Q")
        numbers[_MOVING], numbers[_LATCH] = len(self._moving), self._numbers[_LATCH]
        self._numbers.release()
        if self._page is not None:
            self._page.close()
        self._page, self._numbers = page, numbers

    @property
    def runs(self) -> bool:
        """Whether its process is there."""
        return self._channel is not None

    async def close(self) -> None:
        """Say good-bye, after every actuator is safe; nothing is left behind."""
        process = self._process
        if process is None:
            return
        self._numbers[_OVER] = os.getpid()  # a fork of the robot cannot say this
        self._forget()
        try:
            await asyncio.to_thread(process.wait, GONE_WITHIN)
        except subprocess.TimeoutExpired:
            process.kill()
            await asyncio.to_thread(process.wait)
        self._over()

    def _forget(self) -> None:
        loop = self._loop
        assert loop is not None
        if self._channel is not None:
            loop.remove_reader(self._channel)
            self._channel.close()
            self._channel = None
        if self._pidfd >= 0:
            loop.remove_reader(self._pidfd)
            os.close(self._pidfd)
            self._pidfd = -1
        self._places.clear()
        for answer in self._answers.values():
            if not answer.done():
                answer.set_result("the watchdog has ended")
        self._answers.clear()

    def _over(self) -> None:
        self._process = None
        self._share(None)
        stack_file.close()

    def _died(self) -> None:
        process = self._process
        assert process is not None
        self._forget()
        process.wait()  # it is over: the descriptor says so
        self._over()
        _log.critical("watchdog: its process died (%s)", process.returncode)
        self._on_death()

    # Devices.

    async def arm(self, name: str, frames: SafeFrames, outlet: Outlet) -> str:
        """Have a device watched; it may be told to move only after the answer.

        Returns:
            Why it is not watched, in words; empty if it is.
        """
        before = self._places.get(name)
        self._last += 1
        place = self._last
        sent = list(frames.frames) * frames.repeat
        if sent and frames.resync:
            sent[0] = frames.resync + sent[0]
        told = {
            "op": "arm",
            "place": place,
            "name": name,
            "wire": outlet.kind,
            "frames": [frame.hex() for frame in sent],
            "target": dict(outlet.target) | {"address": frames.address},
        }
        self._places[name] = place
        why = await self._ask(place, told, outlet.descriptor)
        if why:
            self._places.pop(name, None)  # yet it may still do what it was told
        for each in (before, place if why else None):
            if each is not None:  # there was no moment in which neither was watched
                with contextlib.suppress(OSError):
                    self._send({"op": "drop", "place": each})
        return why

    async def drop(self, name: str) -> None:
        """Have a device watched no more, before its descriptor is closed."""
        place = self._places.pop(name, None)
        self.moving(name, False)
        if place is not None:
            await self._ask(place, {"op": "drop", "place": place}, None)

    def watches(self, name: str) -> bool:
        """Tell whether a device is watched now."""
        return name in self._places

    async def _ask(
        self, place: int, told: dict[str, object], descriptor: int | None
    ) -> str:
        if self._channel is None or self._loop is None:
            return "there is no watchdog process"
        async with self._room:
            answer: asyncio.Future[str] = self._loop.create_future()
            self._answers[place] = answer
            try:
                self._send(told, descriptor)
                return await asyncio.wait_for(answer, ANSWER_WITHIN)
            except TimeoutError:
                return f"the watchdog has not answered for {ANSWER_WITHIN:g} s"
            except OSError as error:
                return f"the watchdog cannot be told: {error}"
            finally:
                self._answers.pop(place, None)

    def _send(self, told: dict[str, object], descriptor: int | None = None) -> None:
        data = json.dumps(told).encode()
        if self._channel is None:
            return
        if descriptor is None:
            self._channel.send(data)
        else:
            socket.send_fds(self._channel, [data], [descriptor])

    def _hear(self) -> None:
        assert self._channel is not None
        try:
            data = self._channel.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            return  # the pidfd tells
        what, place, why = json.loads(data)
        answer = self._answers.get(place)
        if what == "hung up":
            self._places = {n: p for n, p in self._places.items() if p != place}
        elif answer is not None and not answer.done():
            answer.set_result(str(why) if what == "refused" else "")

    # Signs of life.

    def beat(self) -> None:
        """Tell that the scheduler turns; end a watchdog that does not look any more."""
        self._beats += 1
        self._numbers[_BEATS] = self._beats
        looks = self._numbers[_LOOKS]
        if looks != self._looks or self._process is None:
            self._looks, self._looked = looks, self._beats
        elif self._beats - self._looked > STUCK_AFTER:
            _log.critical("watchdog: it has not looked for %d beats", STUCK_AFTER)
            self._looked = self._beats
            self._process.kill()

    def moving(self, name: str, moves: bool) -> None:
        """Tell whether an actuator was told a motion; before it leaves."""
        if moves:
            self._moving.add(name)
        else:
            self._moving.discard(name)
        self._numbers[_MOVING] = len(self._moving)

    @property
    def latched(self) -> bool:
        """Whether the watchdog has stopped this process: nothing may move any more."""
        return bool(self._numbers[_LATCH])
