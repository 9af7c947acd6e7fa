"""``esair torture``: what it prints, what it writes, and how it ends."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

PLANTED = Path(__file__).parents[1] / "torture" / "planted.py"
BRIEFLY = ("--faults", 60, "--seed", 5)


@pytest.mark.long
def test_a_sound_robot_survives_all(esair_command, capsys) -> None:
    """Exit code 0; every fault by kind, and the seed."""
    robot = f"{PLANTED}:sound"
    assert esair_command("torture", robot, *BRIEFLY, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["ok"], told["seed"], told["findings"]) == (True, 5, [])
    assert told["faults"] == sum(each["faults"] for each in told["kinds"]) > 0
    assert all(each["faults"] == each["survived"] for each in told["kinds"])


def test_it_ends_when_its_time_is_over(esair_command, capsys) -> None:
    """However many faults that was."""
    began = time.process_time()
    words = ("--for", 0.1, "--json")
    assert esair_command("torture", f"{PLANTED}:sound", *words) == 0

    assert json.loads(capsys.readouterr().out)["ok"]
    assert time.process_time() - began < 5.0


@pytest.mark.long
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
        ((f"{PLANTED}:sound", "--faults", "0"), "--faults: expected a number > 0"),
        ((f"{PLANTED}",), "take the robot in it"),
    ],
)
def test_what_cannot_be_used_is_told(words, told, esair_command, capsys) -> None:
    """Exit code 2, and why."""
    assert esair_command("torture", *words) == 2
    assert told in " ".join(capsys.readouterr().err.split())


@pytest.mark.long
def test_a_number_of_faults_is_the_same_each_time(
    esair_command, capsys, tmp_path
) -> None:
    """Kinds, findings and tests; only how long it took is another time."""
    told, files = [], []
    for out in (tmp_path / "one", tmp_path / "two"):
        words = ("--faults", 60, "--seed", 5, "--json", "--out", out)
        assert esair_command("torture", f"{PLANTED}:blind", *words) == 1
        told.append(json.loads(capsys.readouterr().out))
        files.append({each.name: each.read_bytes() for each in out.iterdir()})
    for each in told:
        del each["seconds"]
        for finding in each["findings"]:
            finding["test"] = Path(finding["test"]).name
    assert told[0] == told[1]
    assert told[0]["faults"] >= 60
    assert files[0] == files[1]


def test_a_file_without_sim_tables_has_its_own_mistakes(
    esair_command, capsys, tmp_path
) -> None:
    """Nobody is told of a simulation that was not asked for."""
    file = tmp_path / "robot.toml"
    file.write_text('[sensor.sonar]\ndriver = "json:Sonar"\n', "utf-8")
    assert esair_command("torture", file, *BRIEFLY) == 2
    told = capsys.readouterr().err
    assert "robot.toml:2: sensor.sonar.driver" in told
    assert "simulation" not in told
    assert list(tmp_path.iterdir()) == [file]
