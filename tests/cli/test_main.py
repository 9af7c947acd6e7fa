"""The command line as a whole."""

import importlib.metadata
import os
import pty
import termios
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from esair.cli import _main, _steer
from esair.cli._errors import show

WITHOUT = """
import sys
sys.modules[{package!r}] = None
from esair.cli import main
main(sys.argv[1:])
"""

CLOSED = """
import os, sys
os.close(0)
os.close(1)
sys.stdin = sys.stdout = None  # as Python has it then
from esair.cli import main
main(sys.argv[1:])
"""

UNHEARD = """
import os
reading, writing = os.pipe()
os.close(reading)
os.dup2(writing, 1)
from esair.cli import _steer, main

class Client:
    name = "rover"
    __enter__ = __exit__ = lambda *_: Client()
    def do(self, *_, **__):
        actuator = {"name": "wheels", "answered": False, "command": "", "why": ""}
        return {"reason": "a cat", "told": [actuator]}

_steer.connect = lambda robot: Client()
main(["stop", "--json"])
"""

UNREAD = """
import os, sys
reading, writing = os.pipe()
os.close(reading)
os.dup2(writing, 1)
from esair.cli import main
main(sys.argv[1:])
"""

FULL = """
import os, sys
os.dup2(os.open("/dev/full", os.O_WRONLY), 1)
from esair.cli import main
main(sys.argv[1:])
"""


INTERRUPTED = """
import sys
class Finder:
    def find_spec(self, name, *rest):
        if name == "esair.config":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Finder())
from esair.cli import main
main(sys.argv[1:])
"""


ASCII = """
import sys
sys.stdout.reconfigure(encoding="ascii", errors="strict")
from esair.cli import main
main(sys.argv[1:])
"""


def test_version_is_that_of_the_package(esair_command, capsys) -> None:
    """``esair --version``."""
    assert esair_command("--version") == 0
    assert capsys.readouterr().out.strip() == importlib.metadata.version("esair")


def test_without_a_verb_all_verbs_are_listed(esair_command, capsys) -> None:
    """``esair`` alone is a question, not a mistake."""
    assert esair_command() == 0
    listed = capsys.readouterr().out
    assert all(verb in listed for verb in ("demo", "run", "sim", "check", "new"))


@pytest.mark.parametrize(
    "words",
    [["chekc"], ["check"], ["check", "a.toml", "--jason"], ["demo", "--seed", "x"]],
)
def test_a_wrong_command_line_is_told(esair_command, capsys, words) -> None:
    """One box on the standard error, exit code 2, no traceback."""
    assert esair_command(*words) == 2
    told = capsys.readouterr()
    assert "Error" in told.err
    assert "Traceback" not in told.err


@pytest.mark.parametrize(
    "words",
    [["put", "planner", "{'goal': 3}"], ["ask", "docking", "Dock", "bays=[1, 2"]],
)
def test_what_begins_as_json_is_no_text_by_mistake(
    esair_command, capsys, words
) -> None:
    """It is refused here: a behavior would get the text."""
    assert esair_command(*words) == 2
    assert "it begins as JSON, and is none" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--record", "--page"])
@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("{} robot.toml", "{} takes the word after it: write it after the FILE"),
        ("robot.toml {0} ab {0} cd", "expected one at most, not 'ab cd'"),
    ],
)
def test_an_option_that_may_stand_alone_takes_one_word(
    esair_command, capsys, option, words, why
) -> None:
    """Two are no traceback; who has written the file's name after it is told why."""
    assert esair_command("sim", *words.format(option).split()) == 2
    told = capsys.readouterr().err.replace("│", " ").split()
    assert why.format(option) in " ".join(told)


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.parametrize(
    ("package", "words", "extra"),
    [
        ("cyclopts", ["check", "robot.toml"], "esair[cli]"),
        ("rich", ["--version"], "esair[cli]"),
        ("pymunk", ["demo", "--fast"], "esair[sim]"),
    ],
)
def test_a_missing_extra_is_one_line_with_the_command(
    start, tmp_path, package, words, extra
) -> None:
    """Never a traceback."""
    process = start(*words, cwd=tmp_path, code=WITHOUT.format(package=package))
    _, told = process.communicate(timeout=60)

    assert process.returncode == 2
    (line,) = told.splitlines()
    assert package in line
    assert f'pip install "{extra}"' in line


@pytest.mark.long
@pytest.mark.real_clock
def test_a_reader_that_has_seen_enough_is_no_error(start, tmp_path) -> None:
    """``esair | head`` ends silently."""
    process = start(cwd=tmp_path)
    process.stdout.close()
    process.stdout = None
    _, told = process.communicate(timeout=60)

    assert told == ""


def test_the_exit_code_counts_whatever_of_it_is_read(
    esair_command, monkeypatch
) -> None:
    """``esair peers | head`` tells of a peer that is lost all the same."""
    about = {"name": "base", "bus": "base", "medium": "PeerBus", "state": "lost"}
    lost = {**about, "error": "no beat of it was heard", "numbers": {}}
    client = SimpleNamespace(do=lambda _: {"resources": [lost]})
    monkeypatch.setattr("esair.cli._peers.connect", lambda _: nullcontext(client))
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as stdout:
        monkeypatch.setattr("sys.stdout", stdout)
        assert esair_command("peers") == 1


def test_ctrl_c_before_a_verb_has_begun_is_no_traceback(
    esair_command, monkeypatch, capsys
) -> None:
    """The file is still being read, or a package imported."""

    def interrupted(_arguments: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(_main, "_run", interrupted)

    assert esair_command("check", "robot.toml") == 130
    assert capsys.readouterr() == ("", "")


@pytest.mark.real_clock
def test_ctrl_c_while_esair_is_imported_is_no_traceback(start, tmp_path) -> None:
    """Nothing was begun yet."""
    process = start("check", "robot.toml", cwd=tmp_path, code=INTERRUPTED)

    assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == 130


@pytest.mark.long
@pytest.mark.real_clock
def test_closed_output_is_no_error(start, tmp_path) -> None:
    """Who closes it wants only the exit code."""
    process = start("devices", "--json", cwd=tmp_path, code=CLOSED)
    _, told = process.communicate(timeout=60)

    assert process.returncode == 0, told
    assert not told


@pytest.mark.real_clock
def test_a_closed_input_is_no_terminal(start, tmp_path) -> None:
    """It is told as any other that has no keys."""
    process = start("drive", "wheels", cwd=tmp_path, code=CLOSED)
    _, told = process.communicate(timeout=60)

    assert process.returncode == 2
    assert told == "esair: drive: expected a terminal with keys\n"


@pytest.mark.promise("OPS-3")
@pytest.mark.parametrize("reason", ["-a cat", "--al", "--robt rover now"])
def test_no_halt_fails_for_its_reason(esair_command, monkeypatch, reason) -> None:
    """One that begins as an option does, or an option that is typed wrongly, is one."""
    told = []

    def do(*act: object) -> int:
        told.append(act)
        return 0

    monkeypatch.setattr(_steer, "_do", do)

    assert esair_command("stop", *reason.split()) == 0
    assert told == [(None, "stop", {"reason": reason}, None)]


@pytest.mark.real_clock
def test_who_hears_nothing_still_gets_the_exit_code(start, tmp_path) -> None:
    """``esair stop | true``: an actuator that has not answered is none that is safe."""
    process = start(cwd=tmp_path, code=UNHEARD)
    _, told = process.communicate(timeout=60)

    assert (process.returncode, told) == (1, "")


@pytest.mark.real_clock
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["check", "robot.toml"], 0),
        (["check", "wrong.toml"], 1),
        pytest.param(["devices"], 0, marks=pytest.mark.long),
    ],
)
def test_what_nobody_reads_leaves_the_exit_code(start, tmp_path, words, code) -> None:
    """``esair check robot.toml | true`` says whether it has found a mistake."""
    (tmp_path / "robot.toml").write_text("", "utf-8")
    (tmp_path / "wrong.toml").write_text("[robot]\nnome = 'a'\n", "utf-8")
    process = start(*words, cwd=tmp_path, code=UNREAD)
    _, told = process.communicate(timeout=60)

    assert (process.returncode, told) == (code, "")


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        pytest.param(["devices"], marks=pytest.mark.long),
        pytest.param(["devices", "--json"], marks=pytest.mark.long),
    ],
)
def test_a_full_disk_is_told_in_one_line(start, tmp_path, words) -> None:
    """``esair devices > file`` where there is no room."""
    process = start(*words, cwd=tmp_path, code=FULL)
    _, told = process.communicate(timeout=60)

    assert process.returncode == 1
    (line,) = told.splitlines()
    assert "No space left on device" in line


@pytest.mark.real_clock
def test_a_terminal_of_few_letters_is_no_error(start, tmp_path) -> None:
    """What it has no letter for is told by its number."""
    file = tmp_path / "\N{CYRILLIC SMALL LETTER ER}.toml"
    file.write_text("", "utf-8")
    process = start("check", file.name, cwd=tmp_path, code=ASCII)
    out, told = process.communicate(timeout=60)

    assert process.returncode == 0, told
    assert "\\u0440.toml: 0 errors" in out


def test_no_word_is_cut_at_the_edge_of_a_terminal() -> None:
    """A line goes on below, deeper; in a pipe it stays one line."""
    line = "  bump keeps it safe while blind, up to priority 20"
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 30))
    with open(theirs, "w", encoding="utf-8") as terminal:
        show(line, terminal)
        terminal.flush()
        told = ""
        while told.count("\n") < 2:  # it may come in pieces
            told += os.read(ours, 1000).decode()
    os.close(ours)
    assert told == "  bump keeps it safe while\r\n    blind, up to priority 20\r\n"
    read, write = os.pipe()
    with open(write, "w", encoding="utf-8") as piped:
        show(line, piped)
    assert os.read(read, 1000).decode() == line + "\n"
    os.close(read)
