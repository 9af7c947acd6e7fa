"""Many robots in one network, each a process of its own on this machine.

``python -m tests.net.fleet --robots 20`` links each with each, or with ``--near 2`` each with
two neighbors on either side: every robot shares its sonar with them, and drives the wheels of
the next one. It tells when all have seen them, what was lost since, how long a write and its
answer took, and the CPU of a robot. Each link costs both of its ends 20 beats a second.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import attrs
from tests.net.parts import free_port

import esair
from esair.loop import TurnLoop
from esair.testing import FakeActuator, FakeSensor


class Sonar(FakeSensor[float]):
    """Measures always the same."""

    def __init__(self) -> None:
        super().__init__("sonar", 1.0, type=float, rate=20.0)


class Wheels(FakeActuator[float]):
    """Remembers what it was told."""

    def __init__(self) -> None:
        super().__init__("wheels", 0.0)


class Driving(esair.Behavior):
    """Drives the wheels of the next robot by its sonar, twenty times a second."""

    sonar = esair.reads(float, name="next_sonar")
    wheels = esair.writes(float, name="next_wheels")

    async def run(self) -> None:
        self.took: list[float] = []
        self.refused = 0
        async for _ in esair.every(0.05):
            try:
                speed = await self.sonar.read()
                begin = time.perf_counter()
                written = await self.wheels.write(speed)
            except esair.EsairError:
                self.refused += 1
                continue
            if written:
                self.took.append(time.perf_counter() - begin)
            else:
                self.refused += 1


def name_of(number: int) -> str:
    return f"robot_{number}"


def neighbors(number: int, count: int, near: int) -> list[int]:
    """Return the others that are at most so many places away, in a circle."""
    steps = [*range(-near, 0), *range(1, near + 1)]
    return sorted({(number + each) % count for each in steps} - {number})


def description(number: int, ports: list[int], near: int) -> str:
    """Return the robot.toml of one of them; each connects to those before it."""
    count = len(ports)
    after = name_of((number + 1) % count)
    linked = neighbors(number, count, near)
    others = [name_of(each) for each in linked]
    before = [f"tcp/127.0.0.1:{ports[each]}" for each in linked if each < number]
    return f"""
[robot]
name = "{name_of(number)}"

[network]
listen = ["tcp/127.0.0.1:{ports[number]}"]
connect = {before}

[sensor.sonar]
driver = "tests.net.fleet:Sonar"

[actuator.wheels]
driver = "tests.net.fleet:Wheels"

[behavior.driving]
driver = "tests.net.fleet:Driving"

[share.sonar]
to = {others}

[share.wheels]
to = ["{name_of((number - 1) % count)}"]

[remote.{after}.sensor.next_sonar]
remote = "sonar"
type = "float"

[remote.{after}.actuator.next_wheels]
remote = "wheels"
type = "float"
"""


# One of them.


async def be(file: str, robots: int, near: int, seconds: float) -> None:
    """Run a robot: say when it sees all others, and what came of so many seconds."""
    begin = time.monotonic()
    robot = esair.Robot.from_config(file)
    linked = neighbors(int(Path(file).stem), robots, near)
    far = [*map(name_of, linked), "next_sonar", "next_wheels"]

    def there() -> bool:
        states = [robot.resources.query(each).state for each in far]
        return all(state is esair.ResourceState.READY for state in states)

    async with robot:
        async for _ in esair.every(0.05):
            if there():
                break
        say(time.monotonic() - begin)
        await asyncio.to_thread(sys.stdin.readline)
        driving: Any = robot.behaviors.action("driving")
        lost, cpu, since = losses(robot, far), time.process_time(), time.monotonic()
        driving.took.clear()
        driving.refused = 0
        await asyncio.sleep(seconds)
        used = (time.process_time() - cpu) / (time.monotonic() - since)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        lost = losses(robot, far) - lost
        say(
            attrs.astuple(One(lost, driving.refused, tuple(driving.took), used, memory))
        )
        await asyncio.to_thread(sys.stdin.readline)  # else the others lose this one


def losses(robot: esair.Robot, names: list[str]) -> int:
    return sum(robot.resources.query(each).losses for each in names)


def say(told: Any) -> None:
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()


# All of them.


@attrs.frozen
class One:
    """What came of one robot.

    Attributes:
        lost: How often it has lost a peer, or a part of one.
        refused: How many writes or readings it did not get.
        took: How long each write and its answer took, in seconds.
        cpu: Which share of a processor it used.
        memory: How much, in MiB.
    """

    lost: int
    refused: int
    took: tuple[float, ...]
    cpu: float
    memory: float


@attrs.frozen
class Fleet:
    """What came of all of them; seen: when the last one saw all others, in seconds."""

    seen: float
    robots: list[One]

    def __str__(self) -> str:
        took = sorted(each for one in self.robots for each in one.took)
        late = took[int(0.99 * len(took))] if took else 0.0
        cpu = [one.cpu for one in self.robots]
        return (
            f"{len(self.robots)} robots saw each other after {self.seen:.1f} s; "
            f"{sum(one.lost for one in self.robots)} lost, {len(took)} writes with "
            f"{1000 * statistics.median(took or [0.0]):.1f} ms (99 %: {1000 * late:.1f} ms), "
            f"{sum(one.refused for one in self.robots)} refused; each {statistics.mean(cpu):.1%} "
            f"of a processor (at most {max(cpu):.1%}), "
            f"{max(one.memory for one in self.robots):.0f} MiB"
        )


def fleet(robots: int, seconds: float, near: int = 0) -> Fleet:
    """Run so many robots, and watch them for so many seconds once all have met.

    Each is linked with so many near ones on either side, with all unless given.
    """
    near = near or robots // 2
    ports = [free_port() for _ in range(robots)]
    with tempfile.TemporaryDirectory() as folder:
        processes = []
        for number in range(robots):
            file = Path(folder) / f"{number}.toml"
            file.write_text(description(number, ports, near))
            processes.append(
                subprocess.Popen(
                    [
                        *(sys.executable, "-m", "tests.net.fleet", "--be", str(file)),
                        *("--robots", str(robots), "--seconds", str(seconds)),
                        *("--near", str(near)),
                    ],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=None if os.environ.get("LOUD") else subprocess.DEVNULL,
                    text=True,
                )
            )
        try:
            seen = [heard(each) for each in processes]
            tell_all(processes)
            found = [One(*heard(each)) for each in processes]
            tell_all(processes)
            for each in processes:
                each.wait()
        finally:
            for each in processes:
                each.kill()
                each.communicate()
    return Fleet(max(seen), found)


def heard(process: subprocess.Popen[str]) -> Any:
    assert process.stdout is not None
    return json.loads(process.stdout.readline())


def tell_all(processes: list[subprocess.Popen[str]]) -> None:
    for each in processes:
        assert each.stdin is not None
        each.stdin.write("\n")
        each.stdin.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--near", type=int, default=0)
    parser.add_argument("--be", default="")
    given = parser.parse_args()
    if given.be:
        with asyncio.Runner(loop_factory=TurnLoop) as runner:
            runner.run(be(given.be, given.robots, given.near, given.seconds))
    else:
        sys.stdout.write(f"{fleet(given.robots, given.seconds, given.near)}\n")


if __name__ == "__main__":
    main()
