"""Every mistake in a robot.toml is told: file, line, key, what was expected."""

import sys

import pytest

from esair import config
from esair.exceptions import ConfigError

CASES = [
    ("[robot]", "[robbot]", "robbot", "did you mean 'robot'?"),
    ('name = "rover"', 'name = "Rover 1"', "robot.name", "lower-case"),
    ('name = "rover"', "name = 3", "robot.name", "expected a string, not 3"),
    ('name = "rover"', 'nmae = "rover"', "robot.nmae", "did you mean 'name'?"),
    ("[bus.front]", "[bus.Front]", "bus.Front", "lower-case"),
    ('"{m}:Wire"', '"serail"', "bus.front.type", "did you mean 'serial'?"),
    ('"{m}:Wire"', '"{m}:Wander"', "bus.front.type", "expected a Bus"),
    ('port = "/dev/serial/by-id/front"', "", "bus.front", "'port' is missing"),
    ("baudrate = 115200", 'baudrate = "fast"', "bus.front.baudrate", "a whole number"),
    ("baudrate = 115200", "baudrate = true", "bus.front.baudrate", "not true"),
    ("baudrate = 115200", "baudrate = 9600.5", "bus.front.baudrate", "not 9600.5"),
    ('bus = "front"', 'bus = "fornt"', "sensor.sonar.bus", "did you mean 'front'?"),
    ('bus = "front"', "bus = 7", "sensor.sonar.bus", "the name of a bus"),
    ("rate = 20", "rate = nan", "sensor.sonar.rate", "a finite number, not nan"),
    ("rate = 20", "rate = inf", "sensor.sonar.rate", "a finite number, not inf"),
    ("rate = 20", "rate = true", "sensor.sonar.rate", "a number in Hz, not True"),
    ("[robot]", '[operator]\nallow = ["sett"]\n[robot]', "operator.allow", "'set'?"),
    ("rate = 20", "rate = 5000", "sensor.sonar.rate", "at most 100.0 Hz"),
    ("rate = 20", "gain = 2.5", "sensor.sonar.gain", "a whole number"),
    ("rate = 20", "raet = 20", "sensor.sonar.raet", "did you mean 'rate'?"),
    ("rate = 20", "name = 20", "sensor.sonar.name", "no such key"),
    ("rate = 20", "rate = 99999999999999999999", "sensor.sonar.rate", "64 bits"),
    ('"{m}:Sonar"', '"{m}:Wheels"', "sensor.sonar.driver", "its place is [actuator"),
    ('"{m}:Sonar"', '"{m}:Snar"', "sensor.sonar.driver", "did you mean 'Sonar'?"),
    ('"{m}:Sonar"', '"{m}:Path"', "sensor.sonar.driver", "expected a Sensor"),
    ('"{m}:Sonar"', '"{m}:MODULE.x"', "sensor.sonar.driver", "has no 'MODULE.x'"),
    ('"{m}:Sonar"', '"{m}x:Sonar"', "sensor.sonar.driver", "there is no module"),
    ('"{m}:Sonar"', '"os:system"', "sensor.sonar.driver", "a module of Python itself"),
    ('"{m}:Sonar"', '"../x:Sonar"', "sensor.sonar.driver", "expected 'module:Class'"),
    ('"{m}:Sonar"', '"sonra"', "sensor.sonar.driver", "is not installed"),
    ('"{m}:Sonar"', '"{m}.Sonar"', "sensor.sonar.driver", ":Sonar')"),
    (
        'type = "{m}:Wire"',
        "",
        "bus.front",
        "expected 'serial', 'can', 'i2c', 'spi', 'mqtt' or",
    ),
    ('"{m}:Sonar"', '"{m}:Broken"', "sensor.sonar", "the firmware is too old"),
    ('driver = "{m}:Sonar"', "", "sensor.sonar", "'driver' is missing"),
    ('driver = "{m}:Sonar"', "driver = 1", "sensor.sonar.driver", "expected a string"),
    ("[sensor.sonar]", "[sensor.wheels]", "actuator.wheels", "is already there"),
    (
        "linear = 0.0, angular",
        "linear = 5.0, angular",
        "actuator.wheels.safe",
        "limits",
    ),
    ("linear = 0.0, ", "", "actuator.wheels.safe", "'linear' is missing"),
    ("linear = 0.0, ", "lienar = 0.0, ", "actuator.wheels.safe.lienar", "'linear'?"),
    ("angular = 0.0", 'angular = "no"', "actuator.wheels.safe.angular", "a number"),
    (
        "command_timeout = 0.3",
        "command_timeout = 0",
        "actuator.wheels.command_timeout",
        "> 0",
    ),
    ("[-1.0, 1.0]", "[-1.0]", "actuator.wheels.limits.linear", "a list of 2"),
    ("[-1.0, 1.0]", "[1.0, -1.0]", "actuator.wheels.limits.linear", "(least, gr"),
    ("{ linear = [", "{ liner = [", "actuator.wheels.limits.liner", "no such field"),
    ("speed = 0.5", 'speed = "fast"', "behavior.wander.speed", "a number, not 'fast'"),
    ("speed = 0.5", "spede = 0.5", "behavior.wander.spede", "did you mean 'speed'?"),
    ("speed = 0.5", "run = 0.5", "behavior.wander.run", "no such key"),
    (
        "max = 5",
        "max = true",
        "behavior.wander.restart.max",
        "a whole number, not true",
    ),
    (
        "max = 5",
        "max = -5",
        "behavior.wander.restart.max",
        ": expected 0 or more, not -5",
    ),
    ("within = 10", "witihn = 10", "behavior.wander.restart.witihn", "'within'?"),
    ("[access.wheels]", "[access.weels]", "access.weels", "did you mean 'wheels'?"),
    ('wander = "write"', 'wandre = "write"', "access.wheels.wandre", "'wander'?"),
    ('wander = "write"', 'wander = "wirte"', "access.wheels.wander", "'write'?"),
    ('wander = "write"', 'wander = "all"', "access.wheels.wander", "configure, guard,"),
    ('wander = "write"', "wander = true", "access.wheels.wander", "not true"),
    (
        "[access.wheels]",
        '[access.behaviors]\nwander = "command"\n[access.wheels]',
        "access.behaviors.wander",
        "expected 'manage', not",
    ),
    (
        "[access.wheels]",
        '[access.behaviors]\nwandre = "manage"\n[access.wheels]',
        "access.behaviors.wandre",
        "did you mean 'wander'?",
    ),
    (
        'wander = "write"',
        'wander = "write"\nexclusive = 1',
        "access.wheels.exclusive",
        "true or",
    ),
    (
        'wander = "write"',
        'wander = "read"',
        "access.wheels",
        "allow 'wander' WRITE there",
    ),
    (
        'avoid = "',
        'max_priority.avoid = 3\navoid = "',
        "access.wheels.max_priority",
        "priority 3 at most",
    ),
    (
        'avoid = "',
        'max_priority.avoid = true\navoid = "',
        "access.wheels.max_priority.avoid",
        "whole",
    ),
    (
        "[sensor.sonar]",
        "[sensor.lidar]",
        "behavior.avoid.sonar",
        "no resource is named 'sonar'",
    ),
    ("[bus.front]", "bus.front = 3\n[bus.front2]", "robot.bus", "no such key"),
    ("[robot]", "sensor.x = 3\n[robot]", "sensor.x", "expected a table [sensor.NAME]"),
]


@pytest.mark.fault("G02")
@pytest.mark.fault("G03")
@pytest.mark.fault("G07")
@pytest.mark.parametrize(("old", "new", "key", "told"), CASES)
def test_a_mistake_names_its_key_and_what_was_expected(
    project, old, new, key, told
) -> None:
    """Each single change of a sound file is told, at its key."""
    project.changed(old, new)

    assert told in project.mistakes()[key]


@pytest.mark.parametrize("rate", ["-1.0", "nan", '"fast"'])
def test_the_rate_of_a_part_of_min_is_told_like_any(project, rate) -> None:
    """At its line, beside the other mistakes of the file."""
    pins = "trigger = 1\necho = 2"
    driver = "esair.boards.ultrasonic:UltrasonicRange"
    project.write(
        f'[sensor.sonar]\ndriver = "{driver}"\n{pins}\nrate = {rate}\n[robbot]\n'
    )

    told = project.mistakes()
    assert ":5: " in told["sensor.sonar.rate"]
    assert "robbot" in told


@pytest.mark.parametrize("value", ["nan", "{{ linear = nan, angular = 0.0 }}"])
def test_a_value_that_is_no_good_is_not_called_missing(project, value) -> None:
    """It is there: one mistake, one message."""
    project.changed("safe = {{ linear = 0.0, angular = 0.0 }}", f"safe = {value}")

    (told,) = project.mistakes().values()
    assert "expected a finite number, not nan" in told


@pytest.mark.parametrize(
    "name", ["robot", "bus", "sensor", "actuator", "behavior", "access"]
)
def test_each_part_must_be_a_table(project, name) -> None:
    """A value in the place of a table is told, not stumbled over."""
    project.write(f"{name} = 3\n")

    assert project.mistakes()[name].endswith("expected a table, not 3")


def test_a_mistake_names_file_and_line(project) -> None:
    """As editors and terminals understand it: file, colon, line."""
    path = project.changed("rate = 20", "rate = true")
    line = path.read_text().splitlines().index("rate = true") + 1

    assert project.mistakes()["sensor.sonar.rate"].startswith(
        f"{path}:{line}: sensor.sonar.rate: "
    )


def test_all_mistakes_are_told_at_once(project) -> None:
    """One in each part of the file: all are in one group, in the file's order."""
    project.write(
        '[robot]\nnmae = "x"\n[bus.front]\ntype = "serail"\n'
        '[sensor.sonar]\ndriver = "{m}:Sonar"\nrate = "x"\ngain = 9\nbus = "none"\n'
        '[actuator.wheels]\ndriver = "{m}:Wheels"\n'
        '[behavior.wander]\ndriver = "{m}:Wandre"\n[access.x]\n'
    )

    assert list(project.mistakes()) == [
        "robot.nmae",
        "bus.front.type",
        "sensor.sonar.rate",
        "sensor.sonar.gain",
        "sensor.sonar.bus",
        "actuator.wheels.safe",
        "behavior.wander.driver",
        "access.x",
    ]


def test_each_wrong_value_of_a_table_of_the_robot_is_told(project) -> None:
    """Also beside mistakes elsewhere: nobody mends a file one value at a time."""
    project.write(
        "[robot]\ngrace = -1\nstart_patience = -1\nwatchdog_limit = 0\n"
        '[behavior.x]\ndriver = "{m}:X"\n'
        '[record]\npath = "runs"\nmax_bytes = -1\nmin_free = -1\n'
        '[operator]\npriority = true\nallow = ["fly", "jump"]\n'
        '[page]\nport = 70000\ntoken = "short"\ninsecure = "no"\n'
    )

    found = project.mistakes()

    assert "no act 'fly', no act 'jump'" in found["operator.allow"]
    assert list(found) == [
        "robot.grace",
        "robot.start_patience",
        "robot.watchdog_limit",
        "behavior.x.driver",
        "record.max_bytes",
        "record.min_free",
        "operator.priority",
        "operator.allow",
        "page.port",
        "page.token",
        "page.insecure",
    ]


def test_a_robots_name_that_is_none_is_told_once(project) -> None:
    """One mistake is one line."""
    project.changed('name = "rover"', 'name = "my rover"')

    assert config.check(project.file).errors == 1


def test_one_mistake_is_a_group_too(project) -> None:
    """Whoever catches the group catches every mistake."""
    project.changed("rate = 20", "rate = true")

    assert len(project.mistakes()) == 1


@pytest.mark.fault("G01")
def test_no_toml_is_one_error_with_line_and_column(project) -> None:
    """The parser's place is kept."""
    project.file.write_text('[robot]\nname = = "rover"\n')

    with pytest.raises(
        ConfigError, match=r"robot\.toml: this is no TOML: .*line 2, column 8"
    ):
        config.load(project.file)


@pytest.mark.fault("G04")
def test_a_key_that_is_there_twice_is_refused(project) -> None:
    """The last one does not win silently."""
    project.changed("rate = 20", "rate = 20\nrate = 30")

    with pytest.raises(ConfigError, match="no TOML"):
        config.load(project.file)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"\xff\xfe", "UTF-8"),
        (b"x = " + b"[" * 5000, "inside each other|no TOML"),
        (b"x = " + b"1" * 5000, "no TOML"),
        (b"# " + b"x" * 1_100_000, "at most 1048576 bytes"),
    ],
)
def test_what_is_no_sane_text_is_one_clear_error(project, content, told) -> None:
    """Not text, too deep, too long a number, too large: never another exception."""
    project.file.write_bytes(content)

    with pytest.raises(ConfigError, match=told):
        config.load(project.file)


def test_tables_inside_each_other_are_bounded(project) -> None:
    """A dotted key of a thousand parts is a mistake, not a recursion error."""
    project.file.write_text("robot." + ".".join("a" * 1000) + " = 1\n")

    assert any("at most 16" in told for told in project.mistakes().values())


@pytest.mark.parametrize("path", ["no.toml", ".", "a\0b"])
def test_a_file_that_cannot_be_read_is_one_error(project, path) -> None:
    """It names the file."""
    with pytest.raises(ConfigError):
        config.load(project.folder / path)


def test_a_program_is_no_configuration_and_its_error_says_what_to_do(project) -> None:
    """How it runs, and who takes the robot in it; never a way that leads nowhere."""
    program = project.folder / f"{project.module}.py"

    with pytest.raises(ConfigError, match=r"'python .*\.py' runs it; .*\.py:robot"):
        config.load(program)
    with pytest.raises(ConfigError, match="run by its program"):
        config.load(f"{program}:robot")


@pytest.mark.fault("G05")
def test_a_driver_that_needs_what_is_not_installed_says_so(project) -> None:
    """The missing module is named, and the line that wants it."""
    (project.folder / f"{project.module}_b.py").write_text(
        "\nimport not_there_at_all\n"
    )
    project.changed('"{m}:Sonar"', '"{m}_b:Sonar"')

    told = project.mistakes()["sensor.sonar.driver"]
    assert "needs 'not_there_at_all', which is not installed" in told
    assert f"{project.module}_b.py, line 2" in told


@pytest.mark.fault("G05")
def test_a_module_that_needs_an_extra_of_esair_names_it(project, monkeypatch) -> None:
    """Here the robot's own module uses a part of the demo."""
    monkeypatch.setitem(sys.modules, "cantools.database", None)
    for name in [each for each in sys.modules if each.startswith("esair.d")]:
        if name.startswith(("esair.demo", "esair.drivers.wheel_motor")):
            monkeypatch.delitem(sys.modules, name)
    (project.folder / f"{project.module}_c.py").write_text("import esair.demo\n")
    project.changed('"{m}:Sonar"', '"{m}_c:Sonar"')

    told = project.mistakes()["sensor.sonar.driver"]
    assert "which is not installed: pip install 'esair[sim]'" in told


@pytest.mark.fault("L10")
@pytest.mark.parametrize(
    "code", ["1 / 0", "raise SystemExit", "def", "raise BaseException()"]
)
def test_a_module_that_fails_is_a_mistake_at_its_key(project, code) -> None:
    """Whatever the module does at its import, the file's key is named."""
    (project.folder / f"{project.module}_b.py").write_text(code)
    project.changed('"{m}:Sonar"', '"{m}_b:Sonar"')

    assert "cannot be imported" in project.mistakes()["sensor.sonar.driver"]


def test_a_module_that_another_robot_brought_is_not_taken(project, tmp_path) -> None:
    """A module beside the file is that one, or it is a mistake."""
    config.load(project.write())
    other = tmp_path / "other"
    other.mkdir()
    (other / f"{project.module}.py").write_text("class Sonar: ...")
    (other / "robot.toml").write_text(project.file.read_text())
    project.file = other / "robot.toml"

    assert "has imported another" in project.mistakes()["sensor.sonar.driver"]


def test_a_module_named_as_a_package_of_esair_is_a_mistake(
    project, monkeypatch
) -> None:
    """The bus would import it in place of its package, and find nothing there."""
    monkeypatch.delitem(sys.modules, "udsoncan", raising=False)
    code = (project.folder / f"{project.module}.py").read_text()
    (project.folder / "udsoncan.py").write_text(code)
    project.changed('"{m}:Sonar"', '"udsoncan:Sonar"')

    found = project.mistakes()["sensor.sonar.driver"]
    sys.modules.pop("udsoncan", None)
    assert "esair needs the package 'udsoncan'" in found


@pytest.mark.fault("G08")
def test_an_actuator_without_a_safe_command_is_refused(project) -> None:
    """There is no default."""
    project.changed("safe = {{ linear = 0.0, angular = 0.0 }}", "")

    assert "must declare its safe command" in project.mistakes()["actuator.wheels.safe"]


@pytest.mark.fault("G09")
def test_readings_fresher_than_the_period_are_refused_with_both_numbers(
    project,
) -> None:
    """A reaction that would be parked between any two readings."""
    project.changed("rate = 20", "rate = 1")

    told = project.mistakes()["behavior.avoid.sonar.max_age"]
    assert "0.5 s" in told
    assert "1 s" in told


def test_a_bus_of_another_class_is_refused(project) -> None:
    """A driver that says which bus it needs gets that or nothing."""
    project.changed('"{m}:Sonar"', '"{m}:OnWire"')

    assert (
        "expected an OtherWire, but 'front' is a Wire"
        in project.mistakes()["sensor.sonar.bus"]
    )


def test_values_of_another_type_than_the_resource_has_are_refused(project) -> None:
    """A behavior that would write a Twist to a lamp."""
    project.changed(
        "[behavior.wander]",
        '[actuator.lamp]\ndriver = "{m}:Lamp"\n'
        '[behavior.wander]\nwrites.wheels = "lamp"',
    )

    assert (
        "it writes Twist, but 'lamp' takes bool"
        in project.mistakes()["behavior.wander.writes.wheels"]
    )


def test_reading_an_actuator_is_refused(project) -> None:
    """The name is there, but of the other kind."""
    project.changed(
        'driver = "{m}:Avoid"', 'driver = "{m}:Avoid"\nreads.sonar = "wheels"'
    )

    assert "which is an actuator" in project.mistakes()["behavior.avoid.reads.sonar"]


@pytest.mark.parametrize(
    ("profile", "key", "told"),
    [
        ("reads = 3", "behavior.avoid.reads", "a key for each port"),
        ("reads.sonar = 3", "behavior.avoid.reads.sonar", "the name of a resource"),
        ('reads.sonar = "A b"', "behavior.avoid.reads.sonar.name", "lower-case"),
        ("reads.sonar.max_age = 0", "behavior.avoid.reads.sonar.max_age", "> 0"),
        ("reads.sonar.maxage = 1", "behavior.avoid.reads.sonar.maxage", "'max_age'?"),
        ("writes.sonar = {{}}", "behavior.avoid.writes.sonar", "the other way round"),
        ("reads.mute_limit = {{}}", "behavior.avoid.reads.mute_limit", "of its own"),
        (
            "writes.wheels.priority = 1.5",
            "behavior.avoid.writes.wheels.priority",
            "whole",
        ),
        (
            "reads.lidar = {{}}",
            "behavior.avoid.react",
            "its parameters must be its readings",
        ),
    ],
)
def test_mistakes_in_a_profile_name_their_key(project, profile, key, told) -> None:
    """Profiles of the file are checked like those of the class."""
    project.changed('driver = "{m}:Avoid"', 'driver = "{m}:Avoid"\n' + profile)

    assert told in project.mistakes()[key]


def test_control_characters_do_not_reach_the_terminal(project) -> None:
    """Names and values of the file are escaped in errors."""
    project.file.write_text('"\\u001b[31m" = 1\n[sensor."a\\u0007b"]\n')

    assert all(told.isprintable() for told in project.mistakes().values())


def test_a_driver_that_needs_a_bus_is_refused_without_one(project) -> None:
    """Else it would fail when it is opened."""
    project.changed('"{m}:Sonar"\nbus = "front"', '"{m}:OnWire"')

    assert "'bus' is missing" in project.mistakes()["sensor.sonar"]
