"""Fresh live recordings, each repeated in another process with another hash seed.

``python -m tests.replay.soak demo 100 60 --at-once 8`` records the demo 100 times, of a
minute each; ``robot`` the robot with threads and random timing. It says how many were
equal, and keeps those that were not. ``placed`` is that robot with two of its behaviors in
processes of their own.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

import attrs
from tests.replay import robots

FILE = """
[robot]
name = "waver"
[sensor.sonar]
driver = "robots:Sonar"
[sensor.compass]
driver = "robots:Compass"
[sensor.bumper]
driver = "robots:Bumper"
[actuator.wheel]
driver = "robots:Wheel"
[actuator.arm]
driver = "robots:Arm"
[behavior.follow]
driver = "robots:Follow"
[behavior.wander]
driver = "robots:Wander"
[behavior.wave]
driver = "robots:Wave"
"""

DEMO = """
from pathlib import Path
from esair.demo import demo
code = demo(seed={seed}, record=Path("run.mcap"), out=Path("run.png"), duration={last})
assert code in (0, 1)  # on a busy machine what should happen may come late
"""

OF_THE_SHOW = 0.65
"""Which part of its longest duration the show of the demo takes."""


@attrs.frozen
class Told:
    """What a process has said at its end.

    Attributes:
        code: Its exit code.
        text: Its output.
    """

    code: int | None
    text: str


PLACED = ("follow", "wander")
"""Which behaviors of the robot ``placed`` live in processes of their own."""


def folder_of_robot(folder: Path, placed: Iterable[str] = ()) -> Path:
    """Make a folder with the robot and its file."""
    file = FILE
    for name in placed:
        table = f"[behavior.{name}]\n"
        file = file.replace(table, f'{table}placement = "process"\n')
    (folder / "robot.toml").write_text(file)
    (folder / "robots.py").write_text(Path(robots.__file__).read_text())
    return folder


async def told_by(folder: Path, *words: str, hash_seed: int, patience: float) -> Told:
    """Run Python in a folder, with a place of its own for sockets."""
    environment = {
        **os.environ,
        "PYTHONHASHSEED": str(hash_seed),
        "COLUMNS": "200",
        "XDG_RUNTIME_DIR": str(folder),
    }
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        *words,
        cwd=folder,
        env=environment,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    try:
        async with asyncio.timeout(patience):
            out, _ = await process.communicate()
    except TimeoutError:
        process.kill()
        await process.wait()
        return Told(None, f"it has not ended within {patience:g} s")
    return Told(process.returncode, out.decode())


async def recorded(what: str, seed: int, seconds: float, folder: Path) -> Told:
    """Record one run in a folder, as ``run.mcap``."""
    if what == "demo":
        last = seconds / OF_THE_SHOW
        words = ["-c", DEMO.format(seed=seed, last=last)]
    else:
        folder_of_robot(folder, PLACED if what == "placed" else ())
        words = ["-m", "esair", "run", "robot.toml", "--for", str(seconds)]
        words += ["--record", "run.mcap"]
    return await told_by(folder, *words, hash_seed=seed + 1, patience=5 * seconds + 60)


async def unequal(
    what: str, count: int, seconds: float, *, at_once: int, keep: Path
) -> list[str]:
    """Record runs and repeat each; return what was not equal, a text for each.

    Args:
        what: ``demo``, ``robot`` or ``placed``.
        count: How many runs.
        seconds: About how long each is.
        at_once: How many at a time.
        keep: Where the folders of those are moved that were not equal.
    """
    places = asyncio.Semaphore(at_once)
    found: list[str] = []
    begun = random.randrange(1 << 20)
    done = 0

    async def one(seed: int) -> None:
        nonlocal done
        folder = Path(tempfile.mkdtemp(prefix=f"esair-{what}-"))
        async with places:
            told = await recorded(what, seed, seconds, folder)
            if told.code == 0:
                words = ["-m", "esair", "replay", "run.mcap"]
                words += ["--with", "demo"] * (what == "demo")
                told = await told_by(folder, *words, hash_seed=4711, patience=300)
        done += 1
        if (
            told.code == 0
            and told.text.startswith("equal")
            and "\n" not in told.text[:-1]
        ):
            shutil.rmtree(folder)
        else:
            place = keep / folder.name
            shutil.move(folder, place)
            found.append(f"{place}: {told.code}: {told.text}")
        print(f"{what} {done}: {len(found)} not equal: {told.text[-200:]}", flush=True)  # noqa: T201 - it takes hours

    await asyncio.gather(*(one(begun + number) for number in range(count)))
    return found


def main() -> int:
    """Do what the command line says; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["demo", "robot", "placed"])
    parser.add_argument("count", type=int)
    parser.add_argument("seconds", type=float)
    parser.add_argument("--at-once", type=int, default=4)
    parser.add_argument("--keep", type=Path, default=Path.cwd())
    given = parser.parse_args()
    wrong = asyncio.run(unequal(**vars(given)))
    print(*wrong, f"{len(wrong)} were not equal", sep="\n")  # noqa: T201 - its purpose
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
