"""``esair check``: every mistake at once, and how each actuator is made safe."""

import importlib.util
import json
import sys

import pytest

MODULE = """
import esair

class Number(esair.Sensor[float]):
    async def read(self) -> float:
        return 1.0

class Motor(esair.Actuator[float]):
    limits = (-1.0, 1.0)
    async def write(self, command: float) -> None: ...

class Endless(Motor):
    command_timeout = None

class Guarded(Motor):
    safe = 0.0
    own_timeout = 0.5

class Drive(esair.Behavior):
    motor = esair.writes(float)
    async def run(self) -> None: ...

class Push(esair.Behavior):
    motor = esair.writes(float, priority=5)
    async def run(self) -> None: ...

class Stop(esair.Reaction):
    number = esair.reads(float)
    motor = esair.writes(float, priority=10)

    def react(self, number: float) -> float | None:
        return 0.0 if number < 1.0 else None

class Confused(esair.Behavior):
    number = esair.reads(str)
    motor = esair.writes(bytes)
    lamp = esair.writes(bool)
    async def run(self) -> None: ...

class Blink(esair.Reaction):
    rate = 2.0
    motor = esair.writes(float)

    def react(self) -> float:
        return 1.0
"""

SOUND = """
[sensor.number]
driver = "{m}:Number"
[actuator.motor]
driver = "{m}:Guarded"
command_timeout = 0.4
[behavior.drive]
driver = "{m}:Drive"
[behavior.stop]
driver = "{m}:Stop"
"""


@pytest.fixture
def robot_file(tmp_path, request):
    """Write a robot.toml and its module; the module is forgotten afterwards."""
    module = f"checked_{abs(hash(request.node.name))}"
    (tmp_path / f"{module}.py").write_text(MODULE)

    def write(text: str = SOUND):
        path = tmp_path / "robot.toml"
        path.write_text(text.replace("{m}", module))
        return path

    yield write
    sys.modules.pop(module, None)


@pytest.fixture
def findings(robot_file, esair_command, capsys):
    """Check a text; what was found, as {(key, rule): (severity, message)}."""

    def check(text: str):
        esair_command("check", robot_file(text), "--json")
        return {
            (each["key"], each["rule"]): (each["severity"], each["message"])
            for each in json.loads(capsys.readouterr().out)["findings"]
        }

    return check


def test_a_package_that_is_not_here_is_found(findings, monkeypatch) -> None:
    """What imports it late is found, too; a robot starts without a device, no more."""
    here = importlib.util.find_spec
    missing = {"evdev", "foxglove", "gpiod", "spidev", "uvicorn", "zenoh"}
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n: None if n in missing else here(n)
    )
    found = findings("""
[record]
path = "run.mcap"
[page]
[network]
listen = ["tcp/127.0.0.1:7447"]
insecure = true
sim = {}
[bus.chips]
type = "spi"
bus = 0
[sensor.pad]
driver = "gamepad"
sim = { driver = "{m}:Number" }
[sensor.button]
driver = "gpio"
chip = "gpiochip0"
line = 17
sim = { driver = "{m}:Number" }
""")
    told = {key: each for (key, rule), each in found.items() if rule == "package"}
    assert {key for key, each in told.items() if each[0] == "error"} == {
        "record",
        "page",
    }
    assert {key for key, each in told.items() if each[0] == "warning"} == {
        "network",
        "bus.chips",
        "sensor.button",
        "sensor.pad",
    }
    assert "pip install 'esair[net]'" in told["network"][1]


def test_a_sound_robot_has_no_errors(robot_file, esair_command, capsys) -> None:
    """Exit code 0, and the table of safe commands."""
    assert esair_command("check", robot_file()) == 0
    shown = capsys.readouterr().out
    assert "0 errors" in shown
    assert "How each actuator is made safe" in shown


def test_the_json_has_the_schema_that_is_promised(
    robot_file, esair_command, capsys
) -> None:
    """Programs depend on these keys."""
    path = robot_file()
    esair_command("check", path, "--json")
    report = json.loads(capsys.readouterr().out)

    assert list(report) == [
        "schema",
        "file",
        "digest",
        "ok",
        "errors",
        "warnings",
        "with_simulation",
        "findings",
        "actuators",
        "failures",
    ]
    assert (report["schema"], report["file"], report["ok"]) == (1, str(path), True)


def test_it_tells_who_makes_each_actuator_safe(
    robot_file, esair_command, capsys
) -> None:
    """Who writes it, its safe command, who sends that, and if this computer dies."""
    esair_command("check", robot_file(), "--json")
    (motor,) = json.loads(capsys.readouterr().out)["actuators"]

    assert motor["safe"] == "0.0"
    assert motor["writers"] == [
        {
            "behavior": "stop",
            "kind": "reaction",
            "priority": 10,
            "when_blind": "the actuator is kept safe",
        },
        {
            "behavior": "drive",
            "kind": "behavior",
            "priority": 0,
            "when_blind": "it has no say",
        },
    ]
    assert motor["guards"] == []
    assert motor["sent_by"] == "esair: 0.4 s after the last command, and at every exit"
    assert motor["own_timeout"] == 0.5
    assert motor["when_the_host_dies"] == "it stops itself after 0.5 s"


def test_needs_that_nobody_provides_are_found(findings) -> None:
    """A resource that is not there, and values of another type."""
    found = findings(SOUND + '[behavior.confused]\ndriver = "{m}:Confused"\n')

    assert found["behavior.confused.number", "need"][0] == "error"


def test_every_need_of_a_behavior_is_told(robot_file, esair_command, capsys) -> None:
    """Three needs, three errors, and exit code 1."""
    path = robot_file(SOUND + '[behavior.confused]\ndriver = "{m}:Confused"\n')
    assert esair_command("check", path, "--json") == 1

    told = [f["message"] for f in json.loads(capsys.readouterr().out)["findings"]]
    assert "it reads str, but 'number' gives float" in told
    assert "it writes bytes, but 'motor' takes float" in told
    assert any(each.startswith("no resource is named 'lamp'") for each in told)


def test_an_actuator_without_a_safe_command_is_found(
    robot_file, esair_command, capsys
) -> None:
    """It is in the table too, with none."""
    path = robot_file('[actuator.motor]\ndriver = "{m}:Motor"\n')
    assert esair_command("check", path, "--json") == 1

    report = json.loads(capsys.readouterr().out)
    assert report["findings"][0]["key"] == "actuator.motor.safe"
    assert report["actuators"][0]["safe"] is None
    assert report["actuators"][0]["when_the_host_dies"] == "it keeps its last command"


@pytest.mark.fault("G08")
def test_an_actuator_that_lacks_more_than_a_safe_command_is_found(
    robot_file, esair_command, capsys
) -> None:
    """Each mistake of its class, beside those of the reaction that writes it."""
    path = robot_file(
        '[actuator.motor]\ndriver = "{m}:Endless"\n'
        '[behavior.blink]\ndriver = "{m}:Blink"\n'
    )
    assert esair_command("check", path, "--json") == 1

    found = json.loads(capsys.readouterr().out)["findings"]
    keys = {each["key"] for each in found if each["severity"] == "error"}
    assert keys == {"actuator.motor.safe", "actuator.motor.command_timeout"}


def test_behaviors_of_one_priority_can_starve_each_other(findings) -> None:
    """Whoever comes first keeps the actuator."""
    found = findings(SOUND + '[behavior.again]\ndriver = "{m}:Drive"\n')

    severity, told = found["behavior.again.motor", "starve"]
    assert severity == "warning"
    assert "'drive' and 'again' write 'motor' with the same priority (0)" in told


def test_a_behavior_above_others_can_starve_them(findings) -> None:
    """It need not pause, as a reaction without an opinion does."""
    found = findings(SOUND + '[behavior.push]\ndriver = "{m}:Push"\n')

    assert found["behavior.push.motor", "starve"][0] == "warning"
    assert "above that of 'drive' (0)" in found["behavior.push.motor", "starve"][1]


def test_a_reaction_above_others_is_fine(findings) -> None:
    """That is what reactions are for."""
    assert findings(SOUND) == {}


def test_a_right_that_nobody_has_is_found(findings) -> None:
    """A rule for a behavior that is not there."""
    found = findings(SOUND + '[access.motor]\n"*" = "write"\ndrvie = "write"\n')

    assert found["access.motor.drvie", "rights"][0] == "error"
    assert "did you mean 'drive'?" in found["access.motor.drvie", "rights"][1]


def test_a_right_that_is_denied_is_found(findings) -> None:
    """The message says what to write into the file."""
    found = findings(SOUND + '[access.motor]\ndrive = "write"\n')

    assert found["access.motor", "denied"][0] == "error"
    assert "allow 'stop' WRITE there" in found["access.motor", "denied"][1]


def test_two_writers_of_an_exclusive_actuator_are_found(findings) -> None:
    """Only one of them could register."""
    found = findings(SOUND + '[access.motor]\n"*" = "write"\nexclusive = true\n')

    assert found["access.motor.exclusive", "denied"][0] == "error"


@pytest.mark.fault("G09")
def test_commands_that_end_before_the_next_are_found(findings) -> None:
    """A reaction that runs more rarely than its command is good for."""
    found = findings(SOUND + '[behavior.blink]\ndriver = "{m}:Blink"\n')

    _, told = found["behavior.blink.motor", "time"]
    assert "every 0.5 s" in told
    assert "0.4 s" in told


def test_what_nobody_uses_is_found(findings) -> None:
    """A device that no behavior needs."""
    found = findings(SOUND + '[sensor.idle]\ndriver = "{m}:Number"\n')

    assert found["sensor.idle", "unused"] == (
        "warning",
        "no behavior declares that it reads it",
    )


def test_warnings_fail_only_if_asked_to(robot_file, esair_command, capsys) -> None:
    """``--strict`` is for those who keep their files clean."""
    path = robot_file(SOUND + '[sensor.idle]\ndriver = "{m}:Number"\n')

    assert esair_command("check", path) == 0
    assert esair_command("check", path, "--strict") == 1
    assert "1 warning" in capsys.readouterr().out


def test_mistakes_in_the_simulation_are_found_too(
    robot_file, esair_command, capsys
) -> None:
    """The sim tables are checked in the same go."""
    path = robot_file(SOUND.replace('Guarded"', 'Guarded"\nsim = { saef = 0.0 }'))
    assert esair_command("check", path, "--json") == 1

    report = json.loads(capsys.readouterr().out)
    assert report["with_simulation"]
    told = {each["key"]: each["only_simulated"] for each in report["findings"]}
    assert told == {"actuator.motor.sim.saef": True, "sensor.number": True}


def test_many_mistakes_are_one_table(
    robot_file, esair_command, capsys, monkeypatch
) -> None:
    """Each with its line, none of them twice."""
    monkeypatch.setenv("COLUMNS", "200")
    path = robot_file(
        '[robot]\nnmae = "x"\n[sensor.number]\ndriver = "{m}:Numbr"\n'
        '[actuator.motor]\ndriver = "{m}:Motor"\ncommand_timeout = true\n'
        '[behavior.x]\ndriver = "{m}:Drive"\nrestart = 3\n'
    )
    assert esair_command("check", path) == 1

    shown = capsys.readouterr().out
    assert "4 errors" in shown
    for key in ("robot.nmae", "sensor.number.driver", "actuator.motor.command_timeout"):
        assert shown.count(key) == 1


@pytest.mark.parametrize("content", [None, b"[robot", b"\xff"])
def test_a_file_that_cannot_be_read_is_exit_code_2(
    tmp_path, esair_command, capsys, content
) -> None:
    """Not there, no TOML, no text: one line each, nothing on the standard output."""
    path = tmp_path / "robot.toml"
    if content is not None:
        path.write_bytes(content)

    assert esair_command("check", path, "--json") == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "robot.toml" in told.err
    assert "Traceback" not in told.err


def test_there_is_no_table_of_safety_of_a_robot_that_was_not_made(
    robot_file, esair_command, capsys
) -> None:
    """A guard that could not be made would be missing there, as if there were none."""
    path = robot_file(SOUND.replace("{m}:Stop", "{m}:Stpo"))

    assert esair_command("check", path) == 1
    assert "How each actuator is made safe" not in capsys.readouterr().out
