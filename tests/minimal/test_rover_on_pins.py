"""The folder of ``esair min build`` for the demo's reflexes, on simulated pins."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from esair import firmware
from esair.boards import stand_in

ROVER = Path(__file__).parents[2] / "examples" / "minimal_rover" / "robot.toml"

DRIVE = """
import json, sys
from esair import minimal
from esair.boards import stand_in
sys.modules["machine"] = stand_in
with open({data!r}) as file:
    lines = json.load(file)
minimal.Loop.run = lambda self, feed=None: None
import main
main._loop.arm()
loop = main._loop
loop.open()
for left, right, distances in lines:
    stand_in.inputs[14], stand_in.inputs[15] = 1 - left, 1 - right
    for pin, distance in zip((3, 5, 7), distances):
        stand_in.echoes[pin] = int(distance * 2000000 / 343)
    loop.step()
loop.close()
print(json.dumps([stand_in.outputs[16], stand_in.outputs[17], loop.faults]))
"""

STOP = 1500000  # ns
FREE, WALL = [1.9, 1.9, 1.9], [1.9, 0.15, 1.9]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What is copied to the board, and the stand-in for its pins."""
    firmware.build(ROVER, tmp_path / "board")
    shutil.copy(stand_in.__file__, tmp_path / "board" / "esair" / "boards")
    return tmp_path / "board"


def on_cpython(folder: Path, lines: list[Any]) -> list[Any]:
    """Run the folder alone: no esair but what is in it."""
    (folder / "data.json").write_text(json.dumps(lines))
    drive = DRIVE.format(data=str(folder / "data.json"))
    code = f"import sys; sys.path.insert(0, {str(folder)!r})\n{drive}"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-B", "-c", code],
        capture_output=True,
        text=True,
        check=True,
    )
    found: list[Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.real_clock
@pytest.mark.promise("MIN-1", "MIN-2")
def test_it_moves_the_same_pins_on_micropython_and_cpython(micropython, folder) -> None:
    """Pulse by pulse, from the same files."""
    lines = [
        *[(0, 0, FREE)] * 3,
        *[(0, 0, WALL)] * 5,
        *[(0, 0, FREE)] * 30,
        *[(1, 0, FREE)] * 2,
        *[(0, 0, FREE)] * 25,
        *[(0, 1, WALL)],
        *[(0, 0, WALL)] * 30,
    ]
    here = on_cpython(folder, lines)
    there = json.loads(
        micropython.run(folder, DRIVE.format(data="data.json"), data=lines)
    )

    left, right, faults = here
    assert there == here
    assert faults == 0
    assert len(left) == len(right) > 60
    assert any(a + b == 2 * STOP != 2 * a for a, b in zip(left, right, strict=True))
    assert any(max(pair) < STOP for pair in zip(left[1:-1], right[1:-1], strict=True))
    assert left[-2:] == right[-2:] == [STOP, 0]


@pytest.mark.real_clock
@pytest.mark.promise("MIN-2")
@pytest.mark.parametrize("touched", [(1, 0), (0, 1)])
def test_it_backs_off_from_what_it_touches(folder, touched) -> None:
    """Both wheels go back, the one on the touched side less."""
    left, right, _ = on_cpython(folder, [(0, 0, FREE), (*touched, FREE), (0, 0, FREE)])
    # Stop at the opening of each part, and once more by the loop; then it reacts.
    assert left[:2] == right[:2] == [STOP, STOP]
    assert max(left[2], right[2]) < STOP
    assert (left[2] < right[2]) is (touched == (0, 1))
