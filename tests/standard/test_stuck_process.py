"""Robots in processes of their own whose event loop is stuck, and several in one."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import textwrap
import time
from pathlib import Path

import pytest
from tests.patience import in_time, within

import esair

pytestmark = pytest.mark.real_clock

ROBOT = """
import asyncio, os, re, signal, sys, threading, time
import anyio
import esair

class Wheels(esair.Actuator[float]):
    safe = 0.0
    command_timeout = 5.0
    async def write(self, command):
        with open(sys.argv[1], "a") as log:
            log.write(f"{{self.name}}={{command}}\\n")

class Drive(esair.Behavior):
    wheels = esair.writes(float)
    async def run(self):
        await self.wheels.write(1.0)
        await asyncio.sleep(0.1)
        await self.wheels.write(1.0)
        {stuck}

robot = esair.Robot(resources=[Wheels()], behaviors=[Drive()])
{main}
"""

STUCK = {
    "loop": "while True: pass",
    "sleep": "time.sleep(60)",
    "regex": "re.match('(a+)+$', 'a' * 60 + 'b')",
    "swallow": "\n        while True:\n            try: await asyncio.sleep(1)\n"
    "            except asyncio.CancelledError: pass",
    "deaf": "\n        while True:\n            try: await asyncio.sleep(1)\n"
    "            except BaseException: pass",
    "tight": "\n        while True: await self.wheels.write(1.0)",
    "thread": "await asyncio.to_thread(time.sleep, 60)",
}


async def live(
    log: Path,
    *signals: signal.Signals,
    stuck: str = "await asyncio.sleep(60)",
    main: str = "esair.run(robot, stall_warning=None)",
    options: tuple[str, ...] = (),
    timeout: float = 60.0,
) -> tuple[int, list[str], str, float]:
    """Run a robot, send it signals; return code, commands, errors, seconds since."""
    code = ROBOT.format(stuck=stuck, main=textwrap.dedent(main))
    with contextlib.suppress(FileNotFoundError):
        os.remove(log)
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, *options, "-c", code, str(log)),
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stderr is not None
    began = time.monotonic()
    try:
        async with asyncio.timeout(timeout):
            if signals:
                while commands(log).count("wheels=1.0") < 2:  # noqa: ASYNC110 - another process writes it
                    await asyncio.sleep(0.01)
                await asyncio.sleep(0.1)
            began = time.monotonic()
            for number in signals:
                with contextlib.suppress(ProcessLookupError):  # it was quick
                    process.send_signal(number)
                await asyncio.sleep(0.05)
            errors = await process.stderr.read()
            await process.wait()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        process._transport.close()  # type: ignore[attr-defined]
    seconds = time.monotonic() - began
    return process.returncode or 0, commands(log), errors.decode(), seconds


def commands(log: Path) -> list[str]:
    """What the devices were told so far."""
    return log.read_text().split() if log.exists() else []


def repeats(config: pytest.Config) -> int:
    return 200 if config.getoption("--esair-soak") else 1


@pytest.mark.promise("ROB-6", "ROB-2")
@pytest.mark.fault("O01", "O02", "O03", "B07")
@pytest.mark.parametrize(
    ("stuck", "count"),
    [
        ("loop", 1),
        *(pytest.param(s, 1, marks=pytest.mark.long) for s in STUCK if s != "loop"),
        # It ends the process in time, whatever that has done by then.
        *(pytest.param(s, 3, marks=pytest.mark.long) for s in STUCK),
    ],
)
@pytest.mark.long
async def test_the_ladder_of_exits_with_a_stuck_loop(
    tmp_path: Path, stuck: str, count: int, request: pytest.FixtureRequest
) -> None:
    """One signal: at most grace + 2 s; three: at most 1 s; safe is last, always."""
    limit = 1.0 + 2.0 + 0.5 if count == 1 else 1.0 + 0.5
    for _ in range(repeats(request.config)):
        returned, told, errors, seconds = await in_time(
            limit,
            lambda: live(
                tmp_path / "log", *[signal.SIGTERM] * count, stuck=STUCK[stuck]
            ),
        )

        assert returned == 143, errors
        assert told[-1] == "wheels=0.0", errors
        assert within(limit, seconds), errors


TIDY = """
        try:
            while True: time.time()
        finally:
            end = time.monotonic() + 0.06  # three kicks, far less than it is spared
            while time.monotonic() < end: pass
            with open(sys.argv[1], "a") as log: log.write("tidy\\n")
"""


@pytest.mark.long
@pytest.mark.promise("ROB-6")
async def test_what_is_interrupted_may_end_in_peace(tmp_path: Path) -> None:
    """It is interrupted once, not again and again in what it does to end."""
    for _ in range(3):  # a busy computer may hold it up for longer than it is spared
        log = tmp_path / "log"
        returned, told, errors, _ = await live(log, signal.SIGTERM, stuck=TIDY)
        assert returned == 143, errors
        if "tidy" in told:
            break

    assert told.count("tidy") == 1, errors
    assert told[-1] == "wheels=0.0"


@pytest.mark.promise("ROB-6", "ROB-2")
async def test_who_holds_the_loop_again_is_interrupted_again(tmp_path: Path) -> None:
    """A driver is asked again at once, in the midst of the stop: safe is last even so."""
    main = """
    class Sonar(esair.Sensor[float]):
        rate = esair.setting(50.0)
        asked = 0
        async def read(self):
            self.asked += 1
            if self.asked > 8:
                time.sleep(60)
            return 1.0

    class Follow(esair.Behavior):
        sonar = esair.reads(float)
        async def run(self):
            async for _ in self.sonar: pass

    robot = esair.Robot(resources=[Wheels(), Sonar()], behaviors=[Drive(), Follow()])
    esair.run(robot, stall_warning=None)
    """
    returned, told, errors, _ = await live(tmp_path / "log", signal.SIGTERM, main=main)

    assert returned == 143, errors
    assert told[-1] == "wheels=0.0", errors


@pytest.mark.promise("ROB-6", "ROB-1")
async def test_a_slow_import_is_nobodys_reason_to_interrupt(tmp_path: Path) -> None:
    """On a slow computer: what a robot imports is there before it may be stopped."""
    main = """
    class Slow:
        def find_spec(self, name, path=None, target=None):
            if name.startswith("anyio._backends."):
                time.sleep(0.5)
    sys.meta_path.insert(0, Slow())
    esair.run(robot, duration=0.2, stall_warning=None)
    """
    returned, told, errors, _ = await live(tmp_path / "log", main=main)

    assert returned == 0, errors
    assert told[-1] == "wheels=0.0"


@pytest.mark.promise("ROB-6")
@pytest.mark.parametrize(
    "stuck",
    [
        *("loop", "deaf"),
        *(
            pytest.param(each, marks=pytest.mark.long)
            for each in ("sleep", "swallow", "tight", "thread")
        ),
    ],
)
@pytest.mark.longer
async def test_run_ends_after_its_duration_whatever_is_stuck(
    tmp_path: Path, stuck: str
) -> None:
    """It returns, or ends the process; the device is safe either way."""
    _, told, errors, seconds = await in_time(
        5.3,
        lambda: live(
            tmp_path / "log",
            stuck=STUCK[stuck],
            main="esair.run(robot, duration=0.3, stall_warning=None)\nos._exit(7)",
        ),
    )

    assert told[-1] == "wheels=0.0", errors
    assert within(5.3, seconds)


@pytest.mark.promise("ROB-5")
@pytest.mark.parametrize("first", [0.15, 60.0])
async def test_each_of_two_robots_ends_safe_on_a_signal(
    tmp_path: Path, first: float
) -> None:
    """Also the one that is left when the other has ended long ago."""
    main = f"""
    class Drive2(esair.Behavior):
        arm = esair.writes(float)
        async def run(self):
            await self.arm.write(1.0)
            await asyncio.sleep(60)
        async def teardown(self):
            await asyncio.sleep(0.3)
    other = esair.Robot(name="other", resources=[Wheels(name="arm")], behaviors=[Drive2()])
    async def one(robot, seconds):
        async with robot:
            await asyncio.sleep(seconds)
    async def main():
        await asyncio.gather(one(robot, {first}), one(other, 60.0))
    asyncio.run(main())
    """
    returned, told, errors, _ = await live(tmp_path / "log", signal.SIGTERM, main=main)

    assert returned == 143, errors
    assert "arm=1.0" in told
    assert [line for line in told if line.startswith("arm")][-1] == "arm=0.0", errors
    assert [line for line in told if line.startswith("wheels")][-1] == "wheels=0.0"


@pytest.mark.promise("ROB-5", "SUP-3")
@pytest.mark.parametrize("runner", ["asyncio", "anyio"])
@pytest.mark.parametrize(
    "stuck", [pytest.param("swallow", marks=pytest.mark.long), "deaf"]
)
@pytest.mark.longer
async def test_no_runner_waits_for_what_would_not_end(
    tmp_path: Path, stuck: str, runner: str
) -> None:
    """`asyncio.run` cancels every task that it finds, and waits: not for these."""
    main = f"""
    async def main():
        async with robot:
            await asyncio.sleep(0.3)
    {runner}.run(main())
    """.replace("anyio.run(main())", "anyio.run(main)")
    returned, told, errors, seconds = await in_time(
        8.0, lambda: live(tmp_path / "log", stuck=STUCK[stuck], main=main)
    )

    assert returned == 0, errors
    assert told[-1] == "wheels=0.0"
    assert "left behind, they would not end: drive" in errors
    assert within(8.0, seconds)


@pytest.mark.promise("ROB-5")
@pytest.mark.fault("X10")
@pytest.mark.parametrize(
    "how", ["anyio", "uvloop", "debug", "optimized", "scope", "eager"]
)
@pytest.mark.long
async def test_a_robot_lives_in_every_kind_of_loop(tmp_path: Path, how: str) -> None:
    """It starts, drives, and ends safe on a signal, without a spin."""
    if how == "uvloop":
        pytest.importorskip("uvloop")
    if how == "eager" and sys.version_info < (3, 12):
        pytest.skip("eager tasks came with 3.12")
    bodies = {
        "anyio": "anyio.run(main)",
        "uvloop": "import uvloop; esair.run(robot, loop_factory=uvloop.new_event_loop)",
        "debug": "asyncio.run(main(), debug=True)",
        "optimized": "esair.run(robot)",
        "scope": "asyncio.run(scoped())",
        "eager": "asyncio.run(eager())",
    }
    main = f"""
    async def main():
        async with robot:
            await asyncio.sleep(60)
    async def scoped():
        with anyio.move_on_after(60):
            await main()
    async def eager():
        asyncio.get_running_loop().set_task_factory(asyncio.eager_task_factory)
        await main()
    {bodies[how]}
    """
    options = ("-O",) if how == "optimized" else ()
    returned, told, errors, seconds = await in_time(
        2.0, lambda: live(tmp_path / "log", signal.SIGTERM, main=main, options=options)
    )

    assert returned == 143, errors
    assert told[-1] == "wheels=0.0"
    assert within(2.0, seconds)
    assert "Traceback" not in errors


@pytest.mark.promise("ROB-6", "RES-2")
def test_a_driver_that_holds_the_loop_leaves_it_between_two_tries() -> None:
    """So that the robot can hear of a signal, and make safe what moves, in the pause."""
    times: list[float] = []

    class Blocks(esair.Sensor[float]):
        async def open(self) -> None:
            times.append(time.monotonic())
            time.sleep(0.15)  # noqa: ASYNC251 - the mistake in question
            times.append(time.monotonic())
            raise esair.DeviceLostError(self.name)

        async def read(self) -> float:
            return 0.0

    robot = esair.Robot(resources=[Blocks()])
    esair.run(robot, duration=0.5, stall_warning=None)
    pauses = [begin - end for end, begin in zip(times[1::2], times[2::2], strict=False)]
    assert min(pauses) > 0.05
