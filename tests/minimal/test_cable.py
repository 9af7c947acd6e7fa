"""Both ends of a cable that behaves like one: deploy, starts, the watchdog, silence."""

import random
import shutil
from pathlib import Path

import pytest
from tests.minimal.cable import WAYS, Cable
from tests.minimal.conftest import program_or_skip
from tests.minimal.linked import built

from esair import firmware
from esair.exceptions import ConfigError
from esair.firmware import _prompt

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-5", "MIN-6")]

MODULES = ("main", "reflexes", "parts", "esair/minimal")

MIXED = """
import machine, time
import reflexes, parts, esair.minimal
{watchdog}
while True:
    print("esair: ready, runs", "{tag}", reflexes.tag, parts.tag, esair.minimal.tag)
    for _ in range(20):
        time.sleep(0.01)
        {feed}
"""


def tagged(folder: Path, tag: str, *, watchdog: int = 0) -> Path:
    """A program of several files, which says of each of them what it is of."""
    (folder / "esair").mkdir(parents=True)
    padding = "\n".join(f"# {tag} {i} " + "." * 60 for i in range(40))
    for name in MODULES[1:]:
        (folder / f"{name}.py").write_text(f"tag = {tag!r}\n{padding}\n")
    made = f"dog = machine.WDT({watchdog})" if watchdog else ""
    feed = "dog.feed()" if watchdog else "pass"
    (folder / "main.py").write_text(MIXED.format(tag=tag, watchdog=made, feed=feed))
    return folder


def runs(cable: Cable) -> str:
    """What a board does after its start: a program, by its tags, or the prompt."""
    del cable.heard[:]

    def known() -> bool:
        said = bytes(cable.heard)
        return b"runs" in said.rpartition(b"\n")[0] or said.endswith(b">>> ")

    cable.until(known)
    said = bytes(cable.heard).decode("utf-8", "replace")
    lines = [each for each in said.splitlines() if "runs" in each]
    return lines[0].split("runs ")[1].strip() if lines else "prompt"


def deploys(cable: Cable, folders: list[Path], count: int) -> None:
    for i in range(count):
        done = firmware.deploy(folders[i % len(folders)], port=cable.port)
        assert done.ready.startswith("esair: ready")


@pytest.mark.long
@pytest.mark.parametrize(
    "arm",
    [
        "host",
        pytest.param("always", marks=pytest.mark.long),
        pytest.param("pin:14", marks=pytest.mark.long),
    ],
)
def test_a_program_is_deployed_over_each_cable(machine, tmp_path, arm) -> None:
    """Whatever arms it, with its watchdog, and again over itself."""
    folder = built(tmp_path, arm=arm)
    (machine.folder / "bumper.txt").write_text("0")
    deploys(machine, [folder], 2)


@pytest.mark.long
@pytest.mark.parametrize("link", [False, True])
@pytest.mark.parametrize("arm", ["host", "always"])
def test_programs_are_deployed_again_and_again(tmp_path, way, arm, link, soak) -> None:
    """50 of 50 in each way, with a link and without."""
    folder = built(tmp_path, arm=arm, link=link)
    with Cable(
        program_or_skip(), tmp_path / "board", ctrl_c=not link, **WAYS[way]
    ) as cable:
        for name in ("bumper.txt", "light.txt"):
            (cable.folder / name).write_text("0")
        deploys(cable, [folder], 50 if soak else 2)


@pytest.mark.long
def test_a_deploy_that_is_cut_leaves_no_mixture(tmp_path, monkeypatch, soak) -> None:
    """At any byte: the old program runs then, the new one, or the prompt is there."""
    moments = 100 if soak else 4
    monkeypatch.setattr(_prompt, "PATIENCE", 1.0)
    chance, seen = random.Random(moments), set()
    folders = [tagged(tmp_path / each, each) for each in ("old", "new", "newer")]
    with Cable(program_or_skip(), tmp_path / "board") as cable:
        deploys(cable, folders[:1], 1)
        before, passed = cable.passed, 0
        deploys(cable, folders[1:2], 1)
        whole = cable.passed - before
        for i in range(moments):
            here, there = folders[(i + 1) % 3], folders[(i + 2) % 3]
            deploys(cable, [here], 1)
            cable.cut_after(chance.randrange(1, whole + 600))
            try:
                firmware.deploy(there, port=cable.port, seconds=3.0)
                passed += 1
            except ConfigError:
                pass
            cable.until(lambda: not cable.has_power)
            cable.power()
            found = runs(cable)
            assert found in {
                *(" ".join([each.name] * 4) for each in (here, there)),
                "prompt",
            }, found
            seen.add(found.split()[0])
    assert len(seen) > 1


def test_a_board_without_room_runs_what_it_ran_before(tmp_path) -> None:
    """The half of the new program is gone again, and nobody has to press its button."""
    old, new = (tagged(tmp_path / each, each) for each in ("old", "new"))
    with Cable(program_or_skip(), tmp_path / "board") as cable:
        deploys(cable, [old], 1)
        (cable.folder / "main.new").symlink_to("/dev/full")  # the last file
        with pytest.raises(ConfigError, match="there is no room on the board"):
            firmware.deploy(new, port=cable.port)
        assert runs(cable) == "old old old old"
        assert sorted(each.name for each in cable.folder.iterdir()) == [
            "esair-a",
            "esair.starts",
            "main.py",
        ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("away", "count"),
    [
        (0.0, 2),
        pytest.param(0.0, 4, marks=pytest.mark.long),
        pytest.param(1.0, 4, marks=pytest.mark.long),
    ],
)
def test_deploy_goes_over_a_program_with_a_watchdog(
    tmp_path, away, count, soak
) -> None:
    """It outlives the program, and bites nobody: the board starts without it first."""
    folders = [
        tagged(tmp_path / each, each, watchdog=1500) for each in ("one", "two")
    ] + [built(tmp_path, arm="always", watchdog=1.5)]
    with Cable(program_or_skip(), tmp_path / "board", away=away) as cable:
        (cable.folder / "bumper.txt").write_text("0")
        deploys(cable, folders, 20 if soak else count)
        assert cable.bites == 0


@pytest.mark.long
def test_a_linked_program_with_a_watchdog_makes_room(tmp_path, soak) -> None:
    """By the word of the link, as it takes no Ctrl-C."""
    folder = built(tmp_path, arm="always", watchdog=1.5, link=True)
    board = tmp_path / "board"
    with Cable(program_or_skip(), board, ctrl_c=False, away=0.5) as cable:
        for name in ("bumper.txt", "light.txt"):
            (cable.folder / name).write_text("0")
        deploys(cable, [folder], 20 if soak else 3)
        assert cable.bites == 0


def test_a_program_that_nothing_started_carefully_is_replaced(tmp_path) -> None:
    """One that was copied by hand, with a watchdog: it is taken out of the way first."""
    folder = tagged(tmp_path / "new", "new")
    board = tmp_path / "board"
    with Cable(program_or_skip(), board) as cable:
        shutil.copytree(
            tagged(tmp_path / "old", "old", watchdog=1000),
            cable.folder,
            dirs_exist_ok=True,
        )
        cable.reset()
        assert runs(cable) == "old old old old"
        deploys(cable, [folder], 1)
        assert runs(cable) == "new new new new"


@pytest.mark.long
def test_three_quick_starts_end_at_the_prompt(tmp_path) -> None:
    """A program that its watchdog bites again and again is left out."""
    folder = tagged(tmp_path / "good", "good", watchdog=300)
    with Cable(program_or_skip(), tmp_path / "board") as cable:
        deploys(cable, [folder], 1)
        stuck = cable.folder / cable.slot / "main.py"
        stuck.write_text(
            "import machine\nprint('stuck')\nmachine.WDT(300)\nwhile 1: pass"
        )
        cable.power()
        cable.until(lambda: b"esair: prompt, three quick starts" in cable.heard)
        assert cable.bites == 2  # after the first start, which was quick as well
        deploys(cable, [folder], 1)  # and from there a better one comes


@pytest.mark.long
def test_a_start_that_goes_well_is_no_quick_one(tmp_path) -> None:
    """Long after it, the next resets are counted from none."""
    folder = built(tmp_path, arm="always")
    with Cable(program_or_skip(), tmp_path / "board") as cable:
        (cable.folder / "bumper.txt").write_text("0")
        deploys(cable, [folder], 1)
        counted = cable.folder / "esair.starts"
        assert counted.read_text() == "x"
        for each in (cable.folder / cable.slot / "esair").glob("boards/start.mpy"):
            each.unlink()
        source = Path(firmware.__file__).parents[1] / "boards" / "start.py"
        (cable.folder / cable.slot / "esair" / "boards" / "start.py").write_text(
            source.read_text().replace("QUICK_MS = 10000", "QUICK_MS = 300")
        )
        cable.power()
        cable.until(lambda: not counted.exists())


SILENT = """
import sys
from esair import minimal
now = [0]
minimal._ticks = lambda: now[0] & 0x3FFFFFFF
def sleep(ms):
    now[0] += ms
minimal._sleep = sleep
run = minimal.Loop.run
def counted(loop, steps=None, feed=None):
    sensor = loop.inputs["light"]
    def fed():
        feed()
        if loop.steps % 3000 == 0:
            with open("steps.txt", "w") as file:
                file.write("%d %d %d" % (loop.steps, loop.late, loop.faults))
    run(loop, {steps}, fed)
minimal.Loop.run = counted
import main
"""


@pytest.mark.parametrize(
    ("link", "many"),
    [
        (False, 6000),
        pytest.param(False, 30000, marks=pytest.mark.long),
        pytest.param(True, 30000, marks=pytest.mark.long),
    ],
)
def test_nobody_who_reads_holds_up_no_step(tmp_path, link, many) -> None:
    """Ten minutes of faults, and an unread line: no late step, and the reflex is alive."""
    folder = built(tmp_path, arm="always", link=link)
    board = tmp_path / "board"
    with Cable(program_or_skip(), board, ctrl_c=not link) as cable:
        shutil.copytree(folder, cable.folder, dirs_exist_ok=True)
        (cable.folder / "main.py").rename(cable.folder / "wired.py")
        (cable.folder / "main.py").write_text(
            SILENT.replace("{steps}", str(many)).replace("import main", "import wired")
        )
        (cable.folder / "bumper.txt").write_text("1")
        cable.read = False
        cable.power()
        told = cable.folder / "steps.txt"
        cable.until(lambda: told.exists() and told.read_text().count(" ") == 2)
        cable.until(lambda: told.read_text().startswith(str(many)), 120.0)
        steps, late, faults = map(int, told.read_text().split())
        assert (steps, late) == (many, 0)
        assert faults > many / 6  # the light is not there
        wheels = (cable.folder / "told.txt").read_text().split("\n")
        assert wheels.count("-0.5 -0.5") >= many - 10


def test_a_port_that_another_program_has_is_left_alone(plugged) -> None:
    """Its owner is asked before the first byte: the board of a running robot goes on."""
    import fcntl
    import os

    end = os.open(plugged.port, os.O_RDWR | os.O_NOCTTY)
    try:
        fcntl.flock(end, fcntl.LOCK_EX | fcntl.LOCK_NB)
        passed: list[bytes] = []
        for act in (
            lambda: firmware.monitor(plugged.port, print, seconds=1.0),
            lambda: firmware.deploy(plugged.folder, port=plugged.port),
        ):
            with pytest.raises(
                ConfigError, match=r"belongs to .*: a port has one user"
            ):
                act()
        plugged.cable.until(lambda: plugged.told)
        assert plugged.cable.boots == 1
        assert passed == []
    finally:
        os.close(end)
