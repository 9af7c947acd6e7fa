"""Robots in processes of their own: every exit ends with the safe command."""

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

pytestmark = pytest.mark.real_clock

ROBOT = """
import asyncio, os, signal, sys, threading, time
import esair

class Wheels(esair.Actuator[float]):
    safe = 0.0
    command_timeout = 5.0
    def note(self, text):
        with open(sys.argv[1], "a") as log:
            log.write(text + "\\n")
    {async_}def open(self):
        self.note("open")
    {async_}def close(self):
        self.note("close")
    {async_}def write(self, command):
        self.note(str(command))

class Drive(esair.Behavior):
    wheels = esair.writes(float)
    async def run(self):
        async for _ in esair.every(0.02):
            await self.wheels.write(1.0)
            {step}

robot = esair.Robot(resources=[Wheels()], behaviors=[Drive()])
{main}
"""


async def live(
    log: Path,
    *signals: signal.Signals,
    step: str = "pass",
    main: str = "esair.run(robot)",
    blocking: bool = False,
    between: str = "",
    timeout: float = 60.0,
) -> tuple[int, list[str], str, float]:
    """Run a robot, send it signals once it drives; return code, log, errors, seconds.

    Args:
        between: What it notes when it has heard the first signal.
    """
    code = ROBOT.format(
        async_="" if blocking else "async ", step=step, main=textwrap.dedent(main)
    )
    with contextlib.suppress(FileNotFoundError):
        os.remove(log)
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", code, str(log), stderr=asyncio.subprocess.PIPE
    )
    assert process.stderr is not None
    began = time.monotonic()
    try:
        async with asyncio.timeout(timeout):
            if signals:
                await noted(log, "1.0")
            began = time.monotonic()
            for number in signals:
                with contextlib.suppress(ProcessLookupError):  # it has ended already
                    process.send_signal(number)
                await asyncio.sleep(0.05)
                if between:
                    await noted(log, between)
            errors = await process.stderr.read()
            await process.wait()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        process._transport.close()  # type: ignore[attr-defined]
    return (
        process.returncode or 0,
        words(log),
        errors.decode(),
        time.monotonic() - began,
    )


def words(log: Path) -> list[str]:
    """What the device was told so far."""
    return log.read_text().split() if log.exists() else []


async def noted(log: Path, word: str) -> None:
    """Wait until a process has noted something: that its device was told to move, say."""
    while word not in words(log):  # noqa: ASYNC110 - another process writes it
        await asyncio.sleep(0.01)


def is_safe(lines: list[str]) -> bool:
    """The last command was the safe one, and the device was closed after it."""
    return lines[0] == "open" and "1.0" in lines and lines[-2:] == ["0.0", "close"]


@pytest.mark.promise("ROB-2", "ROB-1")
@pytest.mark.fault("O01", "O02")
@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)],
)
@pytest.mark.parametrize("blocking", [False, True], ids=["async", "blocking"])
@pytest.mark.longer
async def test_a_signal_stops_in_order(
    tmp_path: Path, number: signal.Signals, code: int, blocking: bool
) -> None:
    """Safe, closed, and the exit code of the signal, within two seconds."""
    returned, lines, errors, seconds = await in_time(
        2.0, lambda: live(tmp_path / "log", number, blocking=blocking)
    )

    assert returned == code, errors
    assert is_safe(lines)
    assert within(2.0, seconds)
    assert "Traceback" not in errors


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("O03")
async def test_a_second_signal_keeps_the_safe_command(tmp_path: Path) -> None:
    """Somebody is impatient: the stop is shorter, and safe all the same."""
    main = """
    async def teardown(self):
        Wheels.note(None, "ending")
        await asyncio.sleep(20.0)
    Drive.teardown = teardown
    esair.run(robot)
    """
    returned, lines, errors, _ = await live(
        *(tmp_path / "log", signal.SIGINT, signal.SIGTERM),
        main=main,
        between="ending",
    )

    assert returned == 130, errors
    assert is_safe(lines)


LATE = {
    "while the loop is closed": """
    class Loop(asyncio.SelectorEventLoop):
        def close(self):
            os.kill(os.getpid(), signal.SIGTERM)
            super().close()
    esair.run(robot, loop_factory=Loop)
    """,
    "while the program cleans up": """
    try: esair.run(robot)
    finally: os.kill(os.getpid(), signal.SIGTERM)
    """,
    "while the interpreter ends": """
    class Last:
        def __del__(self, kill=os.kill, pid=os.getpid()):
            kill(pid, signal.SIGTERM)
    last = Last()
    esair.run(robot)
    """,
}


@pytest.mark.long
@pytest.mark.promise("ROB-2")
@pytest.mark.fault("O03")
@pytest.mark.parametrize("main", LATE.values(), ids=LATE)
async def test_a_second_signal_that_is_late_changes_nothing(
    tmp_path: Path, main: str
) -> None:
    """All is safe by then: the exit code is still that of the first."""
    returned, lines, errors, _ = await live(tmp_path / "log", signal.SIGINT, main=main)

    assert returned == 130, errors
    assert is_safe(lines)


@pytest.mark.long
@pytest.mark.promise("ROB-2")
async def test_a_program_that_goes_on_after_a_signal_can_be_stopped(
    tmp_path: Path,
) -> None:
    """It has run a robot, which a signal has ended, and runs another one."""
    main = """
    try: esair.run(robot)
    except SystemExit: pass
    async def stop(self):
        await self.wheels.write(1.0)
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.sleep(60.0)
    Drive.run = stop
    esair.run(esair.Robot(resources=[Wheels()], behaviors=[Drive()]))
    """
    returned, lines, errors, _ = await live(tmp_path / "log", signal.SIGINT, main=main)

    assert returned == 143, errors
    assert lines.count("open") == 2
    assert lines[-2:] == ["0.0", "close"]


@pytest.mark.promise("ROB-2")
async def test_a_signal_after_a_normal_end_is_not_lost(tmp_path: Path) -> None:
    """It comes while the loop is closed, and ends the program as any other."""
    main = LATE["while the loop is closed"].replace("(robot,", "(robot, duration=0.2,")
    returned, lines, errors, _ = await live(
        tmp_path / "log", main=main + "print('went on', file=sys.stderr)"
    )

    assert returned == 143, errors
    assert is_safe(lines)
    assert "went on" not in errors


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("O03")
@pytest.mark.longer
async def test_a_third_signal_ends_a_stop_that_hangs(tmp_path: Path) -> None:
    """What was safe at once stays so; nobody waits for the rest."""
    main = """
    async def teardown(self):
        while True:
            try: await asyncio.sleep(100)
            except asyncio.CancelledError: pass
    Drive.teardown = teardown
    robot = esair.Robot(resources=[Wheels()], behaviors=[Drive()], grace=60.0)
    esair.run(robot)
    """
    returned, lines, errors, seconds = await in_time(
        2.0,
        lambda: live(
            tmp_path / "log", signal.SIGINT, signal.SIGINT, signal.SIGINT, main=main
        ),
    )

    assert returned == 130, errors
    assert within(2.0, seconds)
    assert [line for line in lines if line[0].isdigit()][-1] == "0.0"


@pytest.mark.promise("ROB-2")
async def test_an_exception_in_the_program_ends_safe(tmp_path: Path) -> None:
    """The traceback is shown, after the safe command."""
    main = """
    async def main():
        async with robot:
            await asyncio.sleep(0.2)
            raise ValueError("bug in the script")
    asyncio.run(main())
    """
    returned, lines, errors, _ = await live(tmp_path / "log", main=main)

    assert returned == 1
    assert "bug in the script" in errors
    assert is_safe(lines)


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("O02")
@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, -2), (signal.SIGTERM, 143), (signal.SIGHUP, 129)],
)
async def test_signals_are_heard_without_run_too(
    tmp_path: Path, number: signal.Signals, code: int
) -> None:
    """`async with` under plain `asyncio.run` ends safe on the same signals."""
    main = """
    async def main():
        async with robot:
            await asyncio.sleep(100)
    asyncio.run(main())
    """
    returned, lines, errors, _ = await live(tmp_path / "log", number, main=main)

    assert returned == code, errors
    assert is_safe(lines)


@pytest.mark.long  # the third ends the process in time, whatever it has done by then
@pytest.mark.promise("ROB-2")
@pytest.mark.fault("O01", "O03")
@pytest.mark.parametrize(
    "runs", ["asyncio.run", "asyncio.new_event_loop().run_until_complete"]
)
async def test_no_number_of_interrupts_breaks_off_the_stop(
    tmp_path: Path, runs: str
) -> None:
    """A runner leaves its loop at the second, a bare loop is left at the first."""
    main = f"""
    class Slow(Wheels):
        def write(self, command):
            time.sleep(0.2 * command)
            self.note(str(command))
    robot = esair.Robot(resources=[Slow(name="wheels")], behaviors=[Drive()])
    async def main():
        async with robot:
            await asyncio.sleep(100)
    {runs}(main())
    """
    returned, lines, errors, _ = await live(
        tmp_path / "log", *[signal.SIGINT] * 3, main=main, blocking=True
    )

    assert returned in {130, -signal.SIGINT}, errors
    assert [line for line in lines if line[0].isdigit()][-1] == "0.0", errors


@pytest.mark.long
@pytest.mark.promise("ROB-2", "ROB-3")
@pytest.mark.fault("B05")
async def test_sys_exit_in_a_behavior_is_its_own_failure(tmp_path: Path) -> None:
    """The robot is not torn down; the behavior fails for good, and that is the end."""
    returned, lines, errors, _ = await live(
        tmp_path / "log",
        step="sys.exit(7)",
        main="Drive.restart = esair.Restart(max=1)\nesair.run(robot)",
    )

    assert returned == 1
    assert "BehaviorFailedError" in errors
    assert is_safe(lines)
    assert lines.count("1.0") == 2


@pytest.mark.promise("ROB-2", "ROB-3")
@pytest.mark.fault("O12")
async def test_memory_that_is_not_there_is_a_failure_of_who_wants_it(
    tmp_path: Path,
) -> None:
    """The robot is not torn down; the behavior fails, and the end is safe."""
    main = """
    import resource
    pages = int(open("/proc/self/statm").read().split()[0])
    limit = pages * resource.getpagesize() + (256 << 20)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    Drive.restart = esair.Restart(max=1)
    esair.run(robot)
    """
    returned, lines, errors, _ = await live(
        tmp_path / "log", step="bytearray(1 << 30)", main=main
    )

    assert returned == 1
    assert "MemoryError" in errors
    assert is_safe(lines)
    assert lines.count("1.0") == 2


@pytest.mark.promise("ROB-2")
@pytest.mark.fault("O14")
async def test_a_fork_that_goes_on_as_the_robot_is_ended(tmp_path: Path) -> None:
    """It would hold the robot's devices, and nobody would stop it."""
    returned, lines, errors, _ = await live(
        tmp_path / "log",
        step="if self.child is None: self.child = os.fork()",
        main="Drive.child = None\nesair.run(robot, duration=0.3)",
    )

    assert returned == 0, errors
    assert "it is a fork of a robot's, and went on as that robot" in errors
    assert is_safe(lines)


@pytest.mark.promise("ROB-1")
async def test_run_ends_after_its_duration(tmp_path: Path) -> None:
    """A normal end: exit code 0, safe."""
    returned, lines, errors, _ = await live(
        tmp_path / "log", main="esair.run(robot, duration=0.2)"
    )

    assert returned == 0, errors
    assert is_safe(lines)


@pytest.mark.promise("ROB-2", "AC-4")
@pytest.mark.fault("O16", "D21")
@pytest.mark.long
async def test_a_stuck_driver_does_not_delay_the_exit(tmp_path: Path) -> None:
    """A blocking call that never returns is left behind; the program ends in two seconds."""
    main = """
    class Stuck(Wheels):
        def write(self, command):
            self.note(str(command))
            if command:
                time.sleep(100)
    robot = esair.Robot(resources=[Stuck(name="wheels")], behaviors=[Drive()])
    esair.run(robot)
    """
    returned, _, errors, seconds = await in_time(
        2.0, lambda: live(tmp_path / "log", signal.SIGTERM, main=main, blocking=True)
    )

    assert returned == 143, errors
    assert within(2.0, seconds)


@pytest.mark.fault("T02")
async def test_a_real_loop_can_tell_whether_the_computer_slept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The clock that counts sleep is compared with the one that does not."""
    from esair.loop import SuspendWatch, turn_of

    heard: list[float] = []
    watch = SuspendWatch(turn_of(asyncio.get_running_loop()))
    watch.listen(heard.append)
    watch.look()
    assert heard == []
    real = time.clock_gettime
    monkeypatch.setattr(time, "clock_gettime", lambda clock: real(clock) + 30.0)
    watch.look()
    assert heard == [pytest.approx(30.0, abs=0.05)]
    monkeypatch.setattr(time, "clock_gettime", real)
    watch.look()
    watch.look()
    watch.forget(heard.append)
    assert len(heard) == 1
    monkeypatch.delattr(time, "CLOCK_BOOTTIME")
    silent = SuspendWatch(turn_of(asyncio.get_running_loop()))
    silent.listen(heard.append)
    silent.look()
    assert len(heard) == 1


@pytest.mark.promise("ROB-2")
async def test_the_stop_imports_nothing(tmp_path: Path) -> None:
    """A module from a slow card would come before the safe command."""
    main = """
    async def main():
        async with robot:
            await asyncio.sleep(0.05)
            there = set(sys.modules)
        print("late:", *sorted(set(sys.modules) - there), file=sys.stderr)
    asyncio.run(main())
    """
    returned, told, errors, _ = await live(tmp_path / "log", main=main)

    assert returned == 0, errors
    assert told[-2:] == ["0.0", "close"]
    assert errors.splitlines()[-1].split() == ["late:"]
