"""``esair check module:robot`` and ``file.py:robot``: a script is checked as a file is."""

import gc
import json
import os
import sys
import time

import pytest

SCRIPT = """
import esair

class Motor(esair.Actuator[float]):
    safe = 0.0
    async def write(self, command: float) -> None: ...

class Drive(esair.Behavior):
    motor = esair.writes(float)

class Wrong(esair.Behavior):
    motor = esair.writes(str)

robot = esair.Robot(resources=[Motor()], behaviors=[Drive()])
wrong = esair.Robot(resources=[Motor()], behaviors=[Wrong()])
number = 3
"""


@pytest.fixture
def script(tmp_path, monkeypatch, request):
    """Write a script into the present folder; its module is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    name = f"script_{abs(hash(request.node.name))}"

    def write(text: str = SCRIPT) -> str:
        (tmp_path / f"{name}.py").write_text(text)
        return name

    yield write
    sys.modules.pop(name, None)


@pytest.mark.promise("RS-8")
@pytest.mark.parametrize("end", ["", ".py"])
def test_a_robot_of_a_module_is_checked(script, esair_command, capsys, end) -> None:
    """By the name of the module, or by its file; the table of actuators too."""
    name = script()
    assert esair_command("check", f"{name}{end}:robot", "--json") == 0

    report = json.loads(capsys.readouterr().out)
    assert (report["file"], report["errors"]) == (f"{name}{end}:robot", 0)
    assert [each["name"] for each in report["actuators"]] == ["motor"]


@pytest.mark.promise("RS-8")
def test_a_mistake_of_a_script_is_found(script, esair_command, capsys) -> None:
    """In the words that the start would use."""
    name = script()
    assert esair_command("check", f"{name}:wrong", "--json") == 1

    found = json.loads(capsys.readouterr().out)["findings"]
    errors = {
        each["key"]: each["message"] for each in found if each["severity"] == "error"
    }
    assert errors == {"wrong.motor": "it writes str, but 'motor' takes float"}


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ("{name}:robt", "there is none; did you mean 'robot'?"),
        ("{name}:number", "it has a int"),
        ("{name}:Wrong", "expected it to return an esair.Robot, not "),
        ("not_there_at_all:robot", "No module named 'not_there_at_all'"),
        ("not_there.py:robot", "there is no file not_there.py"),
    ],
)
def test_what_is_no_robot_is_told(script, esair_command, capsys, target, told) -> None:
    """Exit code 2, one line, and the nearest name."""
    assert esair_command("check", target.format(name=script())) == 2
    assert told in capsys.readouterr().err


def test_a_check_starts_no_robot(script, esair_command, capsys) -> None:
    """A script that runs its robot at the import is told so; nothing moves."""
    name = script(SCRIPT + "esair.run(robot)\n")
    assert esair_command("check", f"{name}:robot") == 2
    assert "if __name__ == '__main__'" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.parametrize("kind", ["fifo", "device", "tables", "dotted"])
def test_a_strange_file_is_told_at_once(tmp_path, esair_command, capsys, kind) -> None:
    """A pipe that nobody writes, a device, 20,000 tables: an error within a second."""
    path = tmp_path / "robot.toml"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path = "/dev/zero"
    elif kind == "tables":
        path.write_text("".join(f"[sensor.s{i}]\n" for i in range(20_000)))
    else:
        path.write_text("".join(f"sensor.s{i}.x = 1\n" for i in range(20_000)))
    gc.freeze()  # what other tests have left is not looked through
    begin = time.process_time()

    assert esair_command("check", path) == 2

    took = time.process_time() - begin
    gc.unfreeze()
    assert took < 1.0
    expected = "a file, not a device" if kind in {"fifo", "device"} else "512 tables"
    assert expected in capsys.readouterr().err
