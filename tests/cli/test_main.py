"""The command line as a whole."""

import importlib.metadata

import pytest

WITHOUT = """
import sys
sys.modules[{package!r}] = None
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
    _, told = process.communicate(timeout=20)

    assert process.returncode == 2
    (line,) = told.splitlines()
    assert package in line
    assert f'pip install "{extra}"' in line


@pytest.mark.real_clock
def test_a_reader_that_has_seen_enough_is_no_error(start, tmp_path) -> None:
    """``esair | head`` ends silently."""
    process = start(cwd=tmp_path)
    process.stdout.close()
    process.stdout = None
    _, told = process.communicate(timeout=20)

    assert told == ""
