"""``esair torture``: what it prints, what it writes, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

PLANTED = Path(__file__).parents[1] / "torture" / "planted.py"
BRIEFLY = ("--for", 0.3, "--seed", 5)


def test_a_sound_robot_survives_all(esair_command, capsys) -> None:
    """Exit code 0; every fault by kind, and the seed."""
    robot = f"{PLANTED}:sound"
    assert esair_command("torture", robot, *BRIEFLY, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["ok"], told["seed"], told["findings"]) == (True, 5, [])
    assert told["faults"] == sum(each["faults"] for each in told["kinds"]) > 0
    assert all(each["faults"] == each["survived"] for each in told["kinds"])


def test_what_is_found_is_a_test_in_the_folder(esair_command, capsys, tmp_path) -> None:
    """Exit code 1; the table says which faults were not survived."""
    words = ("--own-devices", "--out", tmp_path / "tests")
    assert esair_command("torture", f"{PLANTED}:blind", *BRIEFLY, *words) == 1
    told = capsys.readouterr().out
    (file,) = (tmp_path / "tests").iterdir()
    assert file.name == "test_torture_wheels_blind.py"
    assert "seed 5: 1 found" in told
    assert "survive(" in file.read_text()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nothing.toml",), "nothing.toml"),
        ((f"{PLANTED}:nobody",), "expected an esair.Robot named 'nobody'"),
        ((f"{PLANTED}:sound", "--for", "-1"), "expected seconds > 0"),
    ],
)
def test_what_cannot_be_used_is_told(words, told, esair_command, capsys) -> None:
    """Exit code 2, and why."""
    assert esair_command("torture", *words) == 2
    assert told in " ".join(capsys.readouterr().err.split())
