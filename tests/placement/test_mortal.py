"""Two hundred deaths and hangs: how soon it is safe, who was late, what is left behind."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from tests import patience
from tests.placement.mortal import Dies, HungSonar
from tests.placement.parts import Twist
from tests.placement.test_adversaries import LATE, Steps
from tests.placement.test_attacks import children_of, descriptors
from tests.placement.test_life import STOP, place, until

import esair
from esair.testing import FakeActuator

pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.soak,
    pytest.mark.xdist_group("placement"),
]

TIMES = 200
SIDE_BY_SIDE = 4
TIMEOUT = 0.2  # of a command
STALL = 2.0

_log = logging.getLogger("tests.placement")


def told(what: str, values: list[float]) -> float:
    """Log what was measured; return its p99, in seconds."""
    ordered = sorted(values)
    p50, p99 = ordered[len(ordered) // 2], ordered[int(0.99 * len(ordered))]
    _log.info(
        "%s: %d times, p50 %.1f ms, p99 %.1f ms, worst %.1f ms",
        what,
        len(ordered),
        1e3 * p50,
        1e3 * p99,
        1e3 * ordered[-1],
    )
    return p99


def lives(pid: int | None) -> bool:
    """Tell whether a process is there, and not only what its parent has not asked for."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in {"Z", "X"}


def noted(path: Path) -> float:
    return float(path.read_text(encoding="ascii"))


def wheels_of(number: int) -> FakeActuator[Twist]:
    wheels: FakeActuator[Twist] = FakeActuator(f"wheels_{number}", safe=STOP)
    wheels.command_timeout = TIMEOUT  # type: ignore[assignment]
    return wheels


class Told:
    """When each actuator was told what."""

    def __init__(self, robot: esair.Robot) -> None:
        self.commands: dict[str, list[tuple[float, Any]]] = {}
        robot.journal.listen(self._hear)

    def _hear(self, event: Any) -> None:
        if event.kind.value in {"sent", "safe"}:
            known = self.commands.setdefault(event.component, [])
            known.append((event.time, event.value))

    def first(self, wheels: str, since: float, *, moves: bool) -> float | None:
        """When it was told to move, or to stand, first since a moment."""
        for when, command in self.commands.get(wheels, ()):
            if when >= since and (command == Twist(0.3, 0.0)) == moves:
                return when
        return None


async def one_end(
    robot: esair.Robot, heard: Told, how: str, path: Path, number: int
) -> tuple[float, float]:
    """Let one die: return how long it took to be safe, and to move again."""
    name, wheels = f"dies_{number}", f"wheels_{number}"
    dies = Dies(how, str(path), name, wheels)
    place(dies, esair.Placement(stall=STALL))
    await robot.behaviors.add(dies)
    await until(lambda: path.exists() and path.read_text(encoding="ascii"))
    died = noted(path)
    await until(lambda: heard.first(wheels, died, moves=False))
    safe = heard.first(wheels, died, moves=False)
    assert safe is not None
    await until(lambda: heard.first(wheels, safe, moves=True))
    again = heard.first(wheels, safe, moves=True)
    assert again is not None
    assert robot.behaviors.query(name).restarts == 1
    await robot.behaviors.remove(name)
    heard.commands.pop(wheels)
    path.unlink()  # noqa: ASYNC240 - a file of the test
    return safe - died, again - died


@pytest.mark.promise("PLC-3", "PLC-4")
async def test_two_hundred_deaths(tmp_path: Path) -> None:
    """Safe within 25 ms (p99), nobody's step more than 20 ms later, nothing left behind."""
    steps = Steps()
    threads, shared = threading.active_count(), os.listdir("/dev/shm")
    soon: list[float] = []
    async with esair.Robot(resources=[wheels_of(0)], behaviors=[steps]) as robot:
        heard = Told(robot)
        await robot.behaviors.add(Dies("", str(tmp_path / "x"), "first", "wheels_0"))
        await robot.behaviors.remove("first")  # there is a process that makes others
        await asyncio.sleep(2.0)
        usual, steps.late = told("steps before", steps.late), []
        before = descriptors()
        for number in range(TIMES):
            how = ("kill", "segfault", "exit", "abort")[number % 4]
            safe, _ = await one_end(robot, heard, how, tmp_path / "died", 0)
            soon.append(safe)
        late = told("steps beside", steps.late)
        await asyncio.sleep(0.2)
        assert descriptors() == before
        assert len(children_of(os.getpid())) == 1
    await until(lambda: children_of(os.getpid()) == [])
    assert threading.active_count() == threads
    assert os.listdir("/dev/shm") == shared
    assert patience.within(0.025, told("death to safe", soon))
    assert patience.within(usual + LATE, late)


@pytest.mark.promise("PLC-3")
async def test_two_hundred_hangs(tmp_path: Path) -> None:
    """Safe by the command's time-out, killed after `stall`, and running again."""
    every = range(SIDE_BY_SIDE)
    wheels = [wheels_of(each) for each in every]
    safe, again = [], []
    async with esair.Robot(resources=wheels) as robot:
        heard = Told(robot)

        async def hang(number: int) -> None:
            for _ in range(TIMES // SIDE_BY_SIDE):
                path = tmp_path / f"hangs_{number}"
                found = await one_end(robot, heard, "hang", path, number)
                safe.append(found[0])
                again.append(found[1])

        async with asyncio.TaskGroup() as group:
            for each in every:
                group.create_task(hang(each))
    assert patience.within(TIMEOUT + 0.05, told("hang to safe", safe))
    assert patience.within(STALL + 0.3, told("hang to running", again))


class Reads(esair.Behavior):
    """Reads a sensor: one that is not read is not asked."""

    def __init__(self, name: str, sensor: str) -> None:
        super().__init__(
            name=name, reads={"sonar": esair.reads(float, name=sensor, max_age=60.0)}
        )

    async def run(self) -> None:
        async for _ in self.sonar:  # type: ignore[attr-defined]
            pass


@pytest.mark.promise("PLC-3")
async def test_two_hundred_hung_drivers(tmp_path: Path) -> None:
    """Each is killed at its deadline, and READY again in a new process."""
    lost = []
    (
        tmp_path / "first"
    ).touch()  # it does not hang: there is a process that makes others
    first = HungSonar(str(tmp_path / "first"), name="first")
    async with esair.Robot(resources=[first]) as robot:

        async def hang(number: int) -> None:
            name = f"sonar_{number}"
            for turn in range(TIMES // SIDE_BY_SIDE):
                path = tmp_path / f"{name}_{turn}"
                sonar = HungSonar(str(path), name=name)
                await robot.resources.add(sonar)
                await robot.behaviors.add(Reads(f"reads_{number}", name))
                pid = robot.resources.query(name).pid

                def back(pid: int | None = pid, name: str = name) -> bool:
                    status = robot.resources.query(name)
                    is_ready = status.state is esair.ResourceState.READY
                    return is_ready and status.pid not in {pid, None}

                await until(lambda: robot.resources.query(name).losses == 1)
                lost.append(time.monotonic() - noted(path))
                await until(back)
                assert not lives(pid)
                await robot.behaviors.remove(f"reads_{number}")
                await robot.resources.remove(name)

        async with asyncio.TaskGroup() as group:
            for each in range(SIDE_BY_SIDE):
                group.create_task(hang(each))
    assert len(lost) == TIMES
    # Whoever is cancelled at its deadline has 0.1 s to clean up, here as in the robot.
    assert patience.within(HungSonar.deadline + 0.15, told("hang to lost", lost))


ROBOT = """
import esair

class Busy(esair.ThreadBehavior):
    placement = esair.Placement(stall=60.0)

    def run(self) -> None:
        print("begun", flush=True)
        while self.name == "one":
            pass
        super().run()

if __name__ == "__main__":
    import logging
    logging.basicConfig(level=logging.INFO)
    esair.run(esair.Robot(behaviors=[Busy(name="one"), Busy(name="two")]))
"""


@pytest.mark.promise("PLC-4")
def test_two_hundred_killed_robots(tmp_path: Path) -> None:
    """However a robot is killed, its children end, also one that computes."""
    script = tmp_path / "robot_of_children.py"
    script.write_text(ROBOT, encoding="utf-8")
    shared = os.listdir("/dev/shm")
    gone = []
    for number in range(TIMES):
        with subprocess.Popen(
            [sys.executable, str(script)], stderr=subprocess.PIPE, text=True
        ) as robot:
            assert robot.stderr is not None
            begun = 0
            while begun < 2:
                begun += "begun" in robot.stderr.readline()
            children = children_of(robot.pid)
            assert len(children) == 3
            how = (signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT)[number % 3]
            begin = time.monotonic()
            os.kill(robot.pid, how)
            while any(lives(pid) for pid in children):
                assert time.monotonic() < begin + 10.0, "a child has outlived its robot"
                time.sleep(0.001)
            gone.append(time.monotonic() - begin)
    assert os.listdir("/dev/shm") == shared
    assert patience.within(0.1, told("end of the robot to that of its children", gone))
