"""What fits, what pauses, what is begun beside: as a task does it, a process does it."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from tests.placement.pitfalls import (
    Answers,
    Asks,
    Begins,
    Complains,
    Count,
    Dies,
    Drive,
    Eyes,
    Falls,
    Limits,
    Looks,
    Murmurs,
    Notes,
    Plans,
    Receives,
    Sees,
    TakesApart,
    Talks,
    Tells,
    Threads,
    Twice,
    Wants,
)

import esair
from esair import BehaviorState
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock, pytest.mark.xdist_group("placement")]

IN_PROCESS = ["task", "process"]


def placed(behavior: Any, place: Any) -> Any:
    behavior.placement = place
    return behavior


async def until(done: Any, within: float = 20.0) -> None:
    async with asyncio.timeout(within):
        while not done():  # noqa: ASYNC110 - several things are looked at
            await asyncio.sleep(0.01)


def lives(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(") ")[2][0] != "Z"
    except OSError:
        return False


def state(robot: esair.Robot, name: str) -> BehaviorState:
    return robot.behaviors.query(name).state


@pytest.mark.promise("PLC-7")
@pytest.mark.parametrize("place", IN_PROCESS)
async def test_a_thread_that_computes_is_waited_for(place: str) -> None:
    """On the virtual clock: it takes no time of the robot's."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(
        resources=[wheels], behaviors=[placed(Threads(), place)]
    ) as robot:
        await asyncio.sleep(0.5)
        assert state(robot, "threads") is BehaviorState.FINISHED
        assert wheels.commands[1:5] == [1.0, 2.0, 3.0, 9.0]


@pytest.mark.promise("PLC-7")
async def test_a_second_loop_over_a_port_begins_as_it_does_in_a_task() -> None:
    """The device is asked no more often, so nothing is seen twice."""
    commands = []
    for place in IN_PROCESS:
        wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
        sonar = FakeSensor("sonar", 1.0, type=float, rate=20.0)
        async with esair.Robot(
            resources=[wheels, sonar], behaviors=[placed(Twice(), place)]
        ):
            await asyncio.sleep(0.013)
            for number in range(2, 12):
                sonar.feed(float(number))
                await asyncio.sleep(0.05)
        commands.append(wheels.commands)
    assert commands[0] == commands[1]


@pytest.mark.promise("PLC-1", "PRO-2")
@pytest.mark.parametrize("place", IN_PROCESS)
async def test_what_is_no_command_blinds_and_crashes_nobody(place: str) -> None:
    """Be it plain data or not: it is blind until its next good decision."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    sonar = FakeSensor("sonar", 0.5, type=float, rate=20.0)
    async with esair.Robot(
        resources=[wheels, sonar], behaviors=[placed(Wants(), place)]
    ) as robot:
        await wheels.until(0.5, timeout=1.0)
        sonar.feed(2.0)
        await until(lambda: state(robot, "wants") is BehaviorState.PARKED)
        assert "its command is bad" in robot.behaviors.query("wants").detail
        assert wheels.commands[-1] == 0.0
        sonar.feed(0.7)
        await wheels.until(0.7, timeout=1.0)
        assert robot.behaviors.query("wants").restarts == 0


@pytest.mark.real_clock
@pytest.mark.promise("PLC-1", "TURN-4")
async def test_work_with_pauses_keeps_nobody_of_its_process_waiting() -> None:
    """And is no hang, however long it takes."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    plans = Plans()
    plans.placement = esair.Placement(stall=0.6)
    async with esair.Robot(resources=[wheels], behaviors=[plans]) as robot:
        await until(lambda: state(robot, "plans") is BehaviorState.FINISHED)
        assert robot.behaviors.query("plans").restarts == 0
        assert wheels.commands.count(0.3) >= 10


@pytest.mark.promise("PLC-5", "BS-4")
@pytest.mark.parametrize("data", [Path("/x"), "x" * 1_200_000], ids=["path", "large"])
async def test_what_cannot_cross_is_an_error_of_who_sends_it(data: Any) -> None:
    """Not of its receiver, which hears nothing of it."""
    receives = placed(Receives(), "process")
    async with esair.Robot(behaviors=[receives]) as robot:
        await until(lambda: state(robot, "receives") is BehaviorState.RUNNING)
        with pytest.raises(esair.BadValueError, match="between processes"):
            await robot.behaviors.put(data, sender="user", receiver="receives")
        with pytest.raises(esair.BadValueError, match=r"what: |more than"):
            await robot.behaviors.ask(Count(data), sender="user", receiver="receives")
        assert (
            await robot.behaviors.ask(Count(1), sender="user", receiver="receives") == 1
        )
        assert robot.behaviors.query("receives").restarts == 0


@pytest.mark.promise("PLC-5")
async def test_a_reading_that_is_too_large_for_a_process_is_named() -> None:
    """Not the answer that it was read for; and what helps is said."""
    camera = FakeSensor("camera", "x" * 1_200_000)
    sees = placed(Sees(), "process")
    async with esair.Robot(resources=[camera], behaviors=[sees]) as robot:
        with pytest.raises(
            esair.BehaviorFailedError,
            match=r"sees: camera: between .* placement = 'task'",
        ):
            await robot.behaviors.ask(Count(1), sender="user", receiver="sees")


@pytest.mark.promise("PLC-5")
async def test_an_answer_that_cannot_cross_is_an_error_of_who_gives_it() -> None:
    """Its asker is told that it has failed, and why."""
    answers = Answers()
    async with esair.Robot(behaviors=[placed(Asks(), "process"), answers]) as robot:
        await until(lambda: answers.met != "")
        assert "no plain data" in await robot.behaviors.get(
            sender="asks", receiver="user"
        )
        await robot.behaviors.put("end", sender="user", receiver="asks")
        await until(lambda: state(robot, "asks") is BehaviorState.FINISHED)
    assert "Path is no plain data" in answers.met


@pytest.mark.promise("PLC-5", "PRO-1")
async def test_a_reading_that_cannot_cross_blinds_and_crashes_nobody() -> None:
    """The next one may be a good one."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    camera: FakeSensor[Any] = FakeSensor("camera", 1.0)
    async with esair.Robot(
        resources=[wheels, camera], behaviors=[placed(Looks(), "process")]
    ) as robot:
        await until(lambda: 0.5 in wheels.commands)
        camera.feed(Path("/x"))
        await asyncio.sleep(0.05)
        assert state(robot, "looks") is BehaviorState.PARKED
        assert "looks: camera: between" in robot.behaviors.query("looks").detail
        assert wheels.commands[-1] == 0.0
        camera.feed(2.0)
        await until(lambda: wheels.commands[-1] == 0.5)
        assert robot.behaviors.query("looks").restarts == 0


@pytest.mark.real_clock
@pytest.mark.promise("PLC-2", "PRO-1")
async def test_nobody_drives_between_the_end_of_a_hold_and_blindness() -> None:
    """A reaction hangs that was holding somebody off."""
    # Long enough for a busy computer: who sees nothing new gives way, and may.
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0, command_timeout=0.8)
    sonar = FakeSensor("sonar", 1.0, type=float)
    async with esair.Robot(
        resources=[wheels, sonar], behaviors=[placed(Eyes(), Eyes.placement), Drive()]
    ):
        await until(lambda: 0.2 in wheels.commands)
        begins = len(wheels.commands)
        for number in range(1, 9):
            sonar.feed(float(number))
            await asyncio.sleep(0.05)
        await asyncio.sleep(1.2)
        assert 9.0 not in wheels.commands[begins:]
        assert wheels.commands[-1] == 0.0


@pytest.mark.real_clock
@pytest.mark.promise("PLC-2", "PRO-1")
async def test_nobody_drives_before_a_loop_that_was_held_up_has_seen_blindness() -> (
    None
):
    """The hold ends meanwhile, and who waits to write is first when it goes on."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0, command_timeout=0.8)
    sonar = FakeSensor("sonar", 1.0, type=float)
    async with esair.Robot(
        resources=[wheels, sonar], behaviors=[placed(Eyes(), Eyes.placement), Drive()]
    ):
        await until(lambda: 0.2 in wheels.commands)
        sonar.feed(2.0)
        await asyncio.sleep(0.1)
        begins = len(wheels.commands)
        sonar.feed(9.0)
        await asyncio.sleep(0.1)
        time.sleep(1.0)  # noqa: ASYNC251 - all of the loop
        await asyncio.sleep(0.5)
        assert 9.0 not in wheels.commands[begins:]
        assert wheels.commands[-1] == 0.0


@pytest.mark.real_clock
@pytest.mark.promise("PLC-4")
async def test_programs_that_a_component_has_begun_end_with_it() -> None:
    """Else a helper keeps the device that the next process needs."""
    begins = placed(Begins(), "process")
    async with esair.Robot(behaviors=[begins]) as robot:
        await until(lambda: robot.behaviors.query("begins").can_send)
        pids = await robot.behaviors.get(sender="begins", receiver="user")
        assert all(map(lives, pids))

    await until(lambda: not any(map(lives, pids)), within=2.0)


@pytest.mark.promise("PLC-1")
async def test_another_python_is_not_told_where_modules_are() -> None:
    """That a component begins: it has modules of its own, of another version."""
    async with esair.Robot(behaviors=[placed(Tells(), "process")]) as robot:
        await until(lambda: robot.behaviors.query("tells").can_send)
        found = await robot.behaviors.get(sender="tells", receiver="user")
    assert found == os.environ.get("PYTHONPATH")


@pytest.mark.promise("PLC-1", "PLC-6")
async def test_a_constructor_may_take_apart_what_it_gets() -> None:
    """Each process makes it of what was given, whatever has become of that."""
    inner = [1]
    route, by = [1, 2], {"a": inner}
    behavior = placed(TakesApart(route, by=by), "process")
    async with esair.Robot(behaviors=[behavior]) as robot:
        for _ in range(2):
            await until(lambda: robot.behaviors.query("takes_apart").can_send)
            found = await robot.behaviors.get(sender="takes_apart", receiver="user")
            assert found == (2, ("a", [1]))
            route.clear()
            inner.append(2)
            await robot.behaviors.restart("takes_apart")


@pytest.mark.real_clock
@pytest.mark.promise("PLC-3")
@pytest.mark.parametrize("how", ["abort", pytest.param("hang", marks=pytest.mark.long)])
async def test_where_it_has_died_is_in_its_error(how: str) -> None:
    """However deep that was, and whoever else was at work; and what it has said before."""
    async with esair.Robot(behaviors=[Falls(how)]) as robot:
        await until(lambda: state(robot, "falls") is BehaviorState.FAILED)
        told = str(robot.behaviors.query("falls").error)
    assert "culprit" in told
    assert "no such part" in told


@pytest.mark.real_clock
@pytest.mark.promise("PLC-3")
async def test_its_last_words_are_words(caplog: pytest.LogCaptureFixture) -> None:
    """And no records, as which those come that were too many to be shown."""
    caplog.set_level(logging.INFO)
    async with esair.Robot(behaviors=[Talks()]) as robot:
        await until(lambda: state(robot, "talks") is BehaviorState.FAILED)
        told = str(robot.behaviors.query("talks").error)
    assert told.endswith("\nword 298\nword 299")
    assert "level" not in told


@pytest.mark.promise("PLC-4", "SUP-3")
async def test_a_dead_process_is_not_waited_for() -> None:
    """It died twice while it worked on a request; its place is free at once."""
    dies = placed(Dies(), "process")
    async with esair.Robot(behaviors=[dies], grace=3.0) as robot:
        for _ in range(2):
            await until(lambda: state(robot, "dies") is BehaviorState.RUNNING)
            with pytest.raises(esair.BehaviorFailedError):
                await robot.behaviors.ask(Count(1), sender="user", receiver="dies")
            await until(lambda: state(robot, "dies") is BehaviorState.RESTARTING)
        loop = asyncio.get_running_loop()
        began = loop.time()
        await robot.behaviors.remove("dies")
        assert loop.time() - began < 0.2


@pytest.mark.promise("PLC-3", "BS-10")
async def test_whose_process_dies_while_it_answers_is_told_of_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Its asker waited, and has heard of it in time; the log has the crash alone."""
    sees = placed(Sees(), "process")
    camera = FakeSensor("camera", "picture")
    async with esair.Robot(resources=[camera], behaviors=[sees]) as robot:
        await until(lambda: state(robot, "sees") is BehaviorState.RUNNING)
        camera.stall()
        asked = robot.behaviors.ask(Count(1), sender="user", receiver="sees")
        asking = asyncio.ensure_future(asked)
        await asyncio.sleep(0.05)
        pid = robot.behaviors.query("sees").pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(esair.BehaviorFailedError, match="SIGKILL"):
            await asking
        await asyncio.sleep(0.05)
    assert "nobody waited" not in caplog.text


@pytest.mark.real_clock
def test_a_class_of_a_package_of_tests_is_found(tmp_path: Path) -> None:
    """Pytest imports packages without their folder in the path; a process finds them too."""
    tests = tmp_path / "checks" / "of_eyes"
    tests.mkdir(parents=True)
    for folder in (tests, tests.parent):
        (folder / "__init__.py").touch()
    (tests / "parts.py").write_text(PARTS)
    (tests / "test_eyes.py").write_text(PARTS_TEST)
    pytest_of = Path(sys.executable).with_name("pytest")
    options = ["-q", "-p", "no:cacheprovider", "-o", "asyncio_mode=auto"]
    done = subprocess.run(
        [pytest_of, *options, "--import-mode=importlib", "."],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "1 passed" in done.stdout, done.stdout


PARTS = """
import asyncio
import esair

class Eyes(esair.Behavior):
    async def run(self):
        await asyncio.sleep(60.0)
"""

PARTS_TEST = """
import asyncio
import esair
from checks.of_eyes.parts import Eyes

async def test_it_runs():
    eyes = Eyes()
    eyes.placement = "process"
    async with esair.Robot(behaviors=[eyes]) as robot:
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("eyes").restarts == 0
        assert robot.behaviors.query("eyes").state is esair.BehaviorState.RUNNING
"""


@pytest.mark.promise("PLC-5", "ROB-3")
async def test_an_error_that_is_too_large_to_cross_is_a_crash_all_the_same() -> None:
    """What it says is cut; the behavior is not taken for one that runs on."""
    async with esair.Robot(behaviors=[placed(Complains(), "process")]) as robot:
        await until(lambda: state(robot, "complains") is BehaviorState.FAILED)
        error = robot.behaviors.query("complains").error
        assert str(error).startswith("ValueError: xxx")


@pytest.mark.promise("PLC-6")
async def test_a_record_of_the_log_is_one_behind_a_line_without_an_end(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Such as a prompt, or a bar of progress; and what has no end at all is heard."""
    caplog.set_level("INFO")
    async with esair.Robot(behaviors=[placed(Murmurs(), "process")]) as robot:
        await until(lambda: state(robot, "murmurs") is BehaviorState.FINISHED)
    said = [(each.levelname, each.getMessage()) for each in caplog.records]
    assert said[:3] == [
        ("INFO", "murmurs: loading"),
        ("ERROR", "murmurs: it is hot"),
        ("INFO", "murmurs: ready"),
    ]


@pytest.mark.promise("PLC-6")
async def test_an_error_in_the_log_has_its_traceback(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A line for each line, as all of a child's log."""
    async with esair.Robot(behaviors=[placed(Notes(), "process")]) as robot:
        await until(lambda: state(robot, "notes") is BehaviorState.FINISHED)
    said = [each.getMessage() for each in caplog.records if each.name == "rover"]
    assert said[:2] == ["notes: it turns:", "notes: to the left"]
    assert any("pitfalls.py" in each for each in said)
    assert said[-1] == "notes: ValueError: a stone"


@pytest.mark.promise("BEH-3", "PLC-1")
@pytest.mark.parametrize("place", IN_PROCESS)
async def test_a_step_whose_time_is_over_moves_nothing_by_steps_of_its_own(
    place: str,
) -> None:
    """Neither by those that it performs then, nor by those of theirs, old and new."""
    wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
    limits = placed(Limits(), place)
    robot = esair.Robot(resources=[wheels], behaviors=[limits], grace=0.2)
    async with robot:
        await asyncio.sleep(1.0)
        moved = wheels.commands.count(1.0)
        assert moved
        await asyncio.sleep(9.0)
        assert wheels.commands.count(1.0) == moved
        assert robot.behaviors.query("limits").restarts == 0
