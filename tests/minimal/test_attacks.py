"""Boards are attacked on CPython, on MicroPython and on a 32-bit board."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from tests.minimal import attacks
from tests.minimal.hw.board import Board, why_not

from esair.boards import link

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-4")]


@pytest.mark.parametrize("attack", attacks.attacks())
def test_on_cpython(attack) -> None:
    """The attack moves nothing here."""
    getattr(attacks, attack)()


def folder_of(board: Path) -> Path:
    shutil.copy(attacks.__file__, board / "attacks.py")
    (board / "esair" / "boards").mkdir()
    for name in ("line", "link", "start"):
        source = Path(link.__file__).with_name(f"{name}.py")
        shutil.copy(source, board / "esair" / "boards")
    return board


RUN = """
import attacks, sys
for name in attacks.attacks():
    try:
        getattr(attacks, name)()
        print(name)
    except Exception as error:
        print("FAILED", name)
        sys.print_exception(error, sys.stdout)
"""


@pytest.mark.long
def test_on_micropython(micropython, board) -> None:
    """Nor on MicroPython, by the same files."""
    printed = micropython.run(folder_of(board), RUN)

    assert printed.splitlines() == attacks.attacks()


TALK = """
from esair.boards.line import Line
line = Line()
for _ in range(5000):
    line.say("x" * 100)
    line.flush()
with open("done.txt", "w") as file:
    file.write("%d" % line.lost)
"""


def test_a_host_that_reads_no_more_holds_no_board_up(micropython, board) -> None:
    """Its end of the line is full: what is not said is counted, and the board goes on."""
    (folder_of(board) / "talk.py").write_text(TALK)
    ours, theirs = os.pipe()
    try:
        talking = subprocess.Popen(
            [micropython.program, "talk.py"], cwd=board, stdout=theirs
        )
        try:
            assert talking.wait(60.0) == 0
        finally:
            talking.kill()
            talking.wait()
    finally:
        os.close(ours)
        os.close(theirs)

    assert int((board / "done.txt").read_text()) > 4000


@pytest.mark.long
def test_on_a_small_board(board) -> None:
    """Nor on a 32-bit board with single floats and 192 KB."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    with Board(folder_of(board)) as small:
        small.run("import attacks")
        failed = {}
        for name in attacks.attacks():
            try:
                small.run(f"attacks.{name}()")
            except RuntimeError as error:
                failed[name] = str(error)

    assert failed == {}
