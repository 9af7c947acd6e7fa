"""Threads that wait for the outside, and threads that are stuck, on the virtual clock."""

from __future__ import annotations

import asyncio
import queue
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.testing import BlockedError, FakeActuator, VirtualLoop

END: Any = object()


class Gamepad(esair.Sensor[float]):
    """A stick: its driver waits in a thread for what a person does."""

    def __init__(self) -> None:
        super().__init__()
        self.moves: queue.SimpleQueue[float] = queue.SimpleQueue()

    async def close(self) -> None:
        self.moves.put(END)

    def stream(self) -> Iterator[float]:
        yield 0.0
        while (move := self.moves.get()) is not END:
            yield move


class Steer(esair.Reaction):
    gamepad = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, gamepad: float) -> float:
        return gamepad


@pytest.mark.virtual_clock
@pytest.mark.fault("D21")
async def test_a_thread_that_waits_for_the_outside_lets_time_pass() -> None:
    """Ten minutes pass while nobody touches the stick; a move lands when it is made."""
    gamepad, wheels = Gamepad(), FakeActuator("wheels", safe=0.0)
    began = time.monotonic()
    async with esair.Robot(resources=[gamepad, wheels], behaviors=[Steer()]):
        await asyncio.sleep(600.0)
        for move in (0.5, 1.0, 0.25):
            at = esair.now()
            gamepad.moves.put(move)
            await wheels.until(move, timeout=0.5)
            assert esair.now() - at < 0.01
    assert time.monotonic() - began < 30.0
    assert [each for each in wheels.commands if each] == [0.5, 1.0, 0.25]


class Arm(esair.Sensor[float]):
    """A driver that is stuck in a call."""

    def __init__(self) -> None:
        super().__init__()
        self.go = threading.Event()

    def read(self) -> float:
        self.go.wait()
        return 0.0


def run(main: Any) -> None:
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main)


def test_what_really_blocks_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread and the line; the test ends, it does not hang."""
    monkeypatch.setattr("esair.testing._clock.BLOCKED", 0.15)
    arm = Arm()

    async def main() -> None:
        async with esair.Robot(resources=[arm]) as robot:
            right = await robot.resources.register("user", "arm", esair.Access.READ)
            await robot.sensors.read(right)

    with pytest.raises(
        BlockedError, match=r"esair-arm.*test_threads_block.py:\d+ in read"
    ):
        run(main())
    arm.go.set()
    # Its robot was stopped when its runner had ended already.
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_function_in_a_thread_of_asyncio_is_named_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As one of a plain behavior."""
    monkeypatch.setattr("esair.testing._clock.BLOCKED", 0.15)
    go = threading.Event()

    async def main() -> None:
        await asyncio.to_thread(go.wait)

    async def released() -> None:
        try:
            await main()
        finally:
            go.set()

    with pytest.raises(BlockedError, match=r"asyncio_0"):
        run(released())


@pytest.mark.parametrize("file", ["esair/loop/arm.py", "esair/loop/my_threading.py"])
def test_a_path_that_looks_like_a_library_is_named_too(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What counts is where the packages lie."""
    monkeypatch.setattr("esair.testing._clock.BLOCKED", 0.15)
    names: dict[str, Any] = {}
    code = compile("def read(go): go.wait()", str(tmp_path / file), "exec")
    exec(code, names)
    go = threading.Event()

    async def main() -> None:
        try:
            await asyncio.to_thread(names["read"], go)
        finally:
            go.set()

    with pytest.raises(BlockedError, match=rf"{file}:1 in read"):
        run(main())


def test_what_computes_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long it takes, time does not pass meanwhile."""
    monkeypatch.setattr("esair.testing._clock.BLOCKED", 0.15)

    def compute() -> int:
        end = time.thread_time() + 0.2
        rounds = 0
        while time.thread_time() < end:
            rounds += 1
        return rounds

    async def main() -> None:
        loop = asyncio.get_running_loop()
        loop.call_later(1.0, late.append, True)
        assert await asyncio.to_thread(compute) > 0
        assert loop.time() == 0.0

    late: list[bool] = []
    run(main())
    assert not late


def test_what_computes_without_end_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver that asks its part again and again hangs no test."""
    monkeypatch.setattr("esair.testing._clock.ENDLESS", 0.15)
    enough = threading.Event()

    def ask() -> None:
        while not enough.is_set():
            pass

    async def main() -> None:
        try:
            await asyncio.to_thread(ask)
        finally:
            enough.set()

    with pytest.raises(
        BlockedError,
        match=r"0\.15 s of.*\n.*asyncio_0.*test_threads_block.py:\d+ in ask",
    ):
        run(main())


def test_nothing_but_the_outside_can_wake_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is waited for in real time, not for ever."""
    monkeypatch.setattr("esair.testing._clock.BLOCKED", 0.3)
    gamepad = Gamepad()

    async def main() -> None:
        try:
            async with esair.Robot(resources=[gamepad]) as robot:
                right = await robot.resources.register(
                    "user", "gamepad", esair.Access.READ
                )
                async for value in robot.sensors.port(right):
                    last["value"] = value
        finally:
            gamepad.moves.put(END)

    last: dict[str, float] = {}
    timer = threading.Timer(0.1, gamepad.moves.put, (0.5,))
    timer.start()
    with pytest.raises(BlockedError, match="gamepad_stream"):
        run(main())
    timer.join()
    assert last == {"value": 0.5}
