"""The robot's side of its watchdog: it arms devices, and tells that it is alive."""

from __future__ import annotations

import asyncio
import json
import logging
import mmap
import os
import time
import weakref
from collections.abc import Callable
from typing import Literal

import attrs

from esair.watchdog._frames import Outlet, SafeFrames
from esair.watchdog._limit import LIMIT
from esair.watchdog._process import Process

ANSWER_WITHIN = 1.0  # How long an answer is waited for that changes nothing, in seconds
GONE_WITHIN = 0.1  # How long it may take to end after an orderly stop, in seconds

START_WITHIN = 10.0
"""How long it may take to look for the first time, or to arm a robot at rest, in s."""

SILENT_AFTER = 1.5
"""After how many limits without a look it is replaced while something moves."""

SILENT_AT_REST = 8.0
"""And after how many while nothing moves."""

LINGER = 1.0
"""How long a silent one is still there for the death of the robot, in seconds."""

AT_ONCE = 64
"""How much may be asked at the same time: more words, or answers, may not find room."""

_PAGE = mmap.PAGESIZE
_BEATS, _MOVING, _LATCH, _LOOKS, _OVER = range(5)
_NO_PROCESS = "there is no watchdog process"

_log = logging.getLogger("esair")


@attrs.define(eq=False)
class _Asked:
    """What was asked of the process and has no answer yet."""

    answer: asyncio.Future[str]
    name: str = ""  # of the device that it arms

    def settle(self, why: str) -> None:
        if not self.answer.done():
            self.answer.set_result(why)


class Watchdog:
    """Starts the watchdog's process and speaks with it; for one robot.

    Args:
        limit: How long the scheduler may stand still while something moves, in seconds.
        policy: What becomes of a process that was stopped: ``"kill"`` ends it,
            ``"freeze"`` leaves it stopped.
        on_death: Called when the watchdog's process has died by itself, or was ended
            because it did not look any more.
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
        self._places: dict[str, int] = {}  # what is watched
        self._asked: dict[int, _Asked] = {}
        self._last = 0
        self._beats = self._looks = self._vain = 0
        self._looked = 0.0
        self._room = asyncio.Semaphore(AT_ONCE)
        self._process: Process | None = None
        self._dying: dict[Process, None] = {}
        self._numbers = memoryview(bytearray(_PAGE)).cast("Q")
        _in_this_process.add(self)

    # Its process.

    async def start(self) -> None:
        """Start the process.

        Raises:
            OSError: It cannot be started.
        """
        if os.getpid() == 1:
            told = (
                "process 1 of a container takes its watchdog with it: give it an init"
            )
            raise OSError(f"{told} (docker run --init)")
        self._process = Process(self.limit, self.policy, self._hear, self._ended)
        self._share(self._process.page)

    def _share(self, page: mmap.mmap | None) -> None:
        """Count in a page that the process sees; in one's own if it is None."""
        numbers = memoryview(page or bytearray(_PAGE)).cast("Q")
        numbers[_MOVING], numbers[_LATCH] = len(self._moving), self._numbers[_LATCH]
        numbers[_BEATS] = self._beats
        self._looks, self._vain, self._looked = 0, 0, time.monotonic()
        self._numbers = numbers

    @property
    def runs(self) -> bool:
        return self._process is not None

    async def close(self) -> None:
        """Say good-bye, after every actuator is safe; nothing is left behind."""
        process = self._process
        if process is not None:
            self._numbers[_OVER] = os.getpid()  # a fork of the robot cannot say this
            process.let_go()
            self._forget()
            await process.gone(GONE_WITHIN)
        self._end_silent()
        for each in tuple(self._dying):
            await each.gone(GONE_WITHIN)

    def _forget(self) -> None:
        """Have no process any more: nothing is watched."""
        self._process = None
        self._places.clear()
        for asked in self._asked.values():
            asked.settle("the watchdog has ended")
        self._asked.clear()
        self._share(None)

    def _ended(self, process: Process) -> None:
        self._dying.pop(process, None)
        if process is self._process:
            self._die(f"its process died ({process.code})")

    def _replace(self, process: Process, why: str) -> None:
        """Give a silent one up; should the robot die now, it is still all there is.

        Nothing that moves is told to it any more, so that it acts on a death alone.
        """
        self._numbers[_MOVING] = 0
        self._dying[process] = None
        asyncio.get_running_loop().call_later(LINGER, self._end_silent)
        self._die(why)

    def _end_silent(self) -> None:
        for each in self._dying:
            each.kill()
            each.let_go()

    def _die(self, why: str) -> None:
        self._forget()
        self._on_death()  # what is safe comes before words
        _log.critical("watchdog: %s", why)

    # Devices.

    async def arm(self, name: str, frames: SafeFrames, outlet: Outlet) -> str:
        """Have a device watched; it may be told to move only after the answer.

        One that is watched already stays so until the new watch stands, and if that
        fails: then the answer is waited for no longer than `ANSWER_WITHIN`, and takes
        effect when it comes. Else it is waited for as long as the process lives.

        Returns:
            Why it is not watched like that, in words; empty if it is.
        """
        sent = list(frames.frames) * frames.repeat
        if sent and frames.resync:
            sent[0] = frames.resync + sent[0]
        told: dict[str, object] = {
            "op": "arm",
            "name": name,
            "wire": outlet.kind,
            "frames": [frame.hex() for frame in sent],
            "gap": frames.gap,
            "target": dict(outlet.target) | {"address": frames.address},
        }
        async with self._room:
            patience = ANSWER_WITHIN if name in self._places else None
            try:
                asked = self._ask(told, name, outlet.descriptor)
            except OSError as error:
                return f"the watchdog cannot be told: {error}"
            await asyncio.wait({asked.answer}, timeout=patience)
        if asked.answer.done():
            return asked.answer.result()
        return f"the watchdog has not answered for {ANSWER_WITHIN:g} s"

    async def drop(self, name: str, within: float = ANSWER_WITHIN) -> None:
        """Have a device watched no more, before its descriptor is closed.

        Args:
            name: The device; an answer to `arm` that is still to come is not wanted.
            within: How long the answer is waited for, in seconds.
        """
        self.moving(name, False)
        places = [place for place, each in self._asked.items() if each.name == name]
        for place in places:
            self._asked.pop(place).settle("it was closed")
        if name in self._places:
            places.append(self._places.pop(name))
        self._end_silent()  # it may still have that device open
        waits = [self._drop(place) for place in places]
        if waits:
            await asyncio.wait({each.answer for each in waits}, timeout=within)

    def _drop(self, place: int) -> _Asked:
        try:
            return self._ask({"op": "drop", "of": place})
        except OSError as error:  # it is over, and so is the watch
            asked = _Asked(asyncio.get_running_loop().create_future())
            asked.settle(str(error))
            return asked

    def watches(self, name: str) -> bool:
        return name in self._places

    def _ask(
        self, told: dict[str, object], name: str = "", descriptor: int | None = None
    ) -> _Asked:
        asked = _Asked(asyncio.get_running_loop().create_future(), name)
        if self._process is None:
            asked.settle(_NO_PROCESS)
            return asked
        self._last += 1
        self._process.send({"place": self._last, **told}, descriptor)
        self._asked[self._last] = asked
        return asked

    def _hear(self, data: bytes) -> None:
        what, place, why = json.loads(data)
        if what == "hung up":
            self._places = {n: p for n, p in self._places.items() if p != place}
            return
        asked = self._asked.pop(place, None)
        if asked is None:
            return
        if asked.name and what == "done":  # in no moment neither watch has stood
            before = self._places.get(asked.name)
            self._places[asked.name] = place
            if before is not None:
                self._drop(before)
        asked.settle(str(why) if what == "refused" else "")

    # Signs of life.

    def beat(self) -> None:
        """Tell that the scheduler turns; replace a watchdog that looks no more."""
        self._beats += 1
        self._numbers[_BEATS] = self._beats
        looks, process = self._numbers[_LOOKS], self._process
        if looks != self._looks or process is None:
            self._looks, self._vain, self._looked = looks, 0, time.monotonic()
            return
        self._vain += 1
        silent = time.monotonic() - self._looked
        # The first in vain says nothing: both may have been paused until now.
        if self._vain > 1 and silent >= self._patience():
            self._replace(process, f"it has not looked for {silent:.3f} s: it is ended")

    def _patience(self) -> float:
        """How long the process may be silent now, in seconds."""
        if not self._looks:
            return START_WITHIN
        if self._moving:
            return SILENT_AFTER * self.limit
        rest = SILENT_AT_REST * self.limit
        return max(rest, START_WITHIN) if self._asked else rest

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


_in_this_process: weakref.WeakSet[Watchdog] = weakref.WeakSet()


def _forked() -> None:
    """See to it that what a fork does is no sign of life, and moves nothing."""
    for each in tuple(_in_this_process):
        each._numbers = memoryview(bytearray(_PAGE)).cast("Q")  # noqa: SLF001


os.register_at_fork(after_in_child=_forked)
