"""A robot.toml becomes components, and nothing is opened."""

import hashlib

import pytest

from esair import config
from esair.exceptions import ConfigError
from esair.messages import Access, Policy, Restart


def test_every_table_becomes_its_component(project) -> None:
    """Buses, devices, behaviors and rules of the file are all there."""
    described = config.load(project.write())

    assert described.name == "rover"
    assert list(described.buses) == ["front"]
    assert list(described.resources) == ["sonar", "wheels"]
    assert list(described.behaviors) == ["wander", "avoid"]
    assert described.policies["wheels"].allow == {
        "wander": Access.WRITE,
        "avoid": Access.WRITE | Access.CONFIGURE,
    }


def test_a_mark_that_editors_put_before_the_text_is_none_of_it(project) -> None:
    """Some on Windows save UTF-8 with one; nobody sees it."""
    path = project.write()
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())

    assert config.load(path).name == "rover"


def test_components_have_the_names_of_their_tables(project) -> None:
    """[sensor.left] is named left, whatever its class is called."""
    text = '[sensor.left]\ndriver = "{m}:Sonar"\n[sensor.right]\ndriver = "{m}:Sonar"\n'
    described = config.load(project.write(text))

    assert [each.name for each in described.resources.values()] == ["left", "right"]


def test_devices_of_one_bus_share_it(project) -> None:
    """Two devices that name a bus have the same object."""
    described = config.load(project.write())

    bus = described.buses["front"]
    assert bus.baudrate == 115200
    assert all(device.bus is bus for device in described.resources.values())


def test_a_derived_sensor_reads_what_the_file_says(project) -> None:
    """Two of one class have sources of their own."""
    text = (
        '[sensor.left]\ndriver = "{m}:Sonar"\n'
        '[sensor.double]\ndriver = "{m}:Double"\n'
        '[sensor.double.reads]\nsonar = "left"\n'
        '[sensor.speed]\ndriver = "{m}:Double"\n'
        '[sensor.speed.reads.sonar]\nname = "left"\nmax_age = 0.5\n'
    )
    described = config.load(project.write(text))

    double, speed = described.resources["double"], described.resources["speed"]
    assert double.inputs["sonar"].resource == "left"
    assert speed.inputs["sonar"].max_age == 0.5
    with pytest.raises(ExceptionGroup) as caught:
        config.load(project.write(text.replace('"left"', '"LEFT"')))
    assert "sensor.double.reads.sonar" in str(caught.value.exceptions[0])
    applied = text.replace('name = "left"', 'name = "wheels.applied"')
    with pytest.raises(ExceptionGroup) as caught:
        config.load(project.write(applied))
    assert "no resource is named 'wheels.applied'" in str(caught.value.exceptions[0])


def test_nothing_is_opened(project) -> None:
    """Loading opens no bus."""
    assert not config.load(project.write()).buses["front"].is_open


def test_settings_keywords_and_attributes_are_set(project) -> None:
    """A key is a setting, a keyword or a public attribute, in its own type."""
    described = config.load(project.write())

    rate = described.resources["sonar"].rate
    assert (rate, type(rate)) == (20.0, float)
    assert described.resources["wheels"].command_timeout == 0.3
    assert described.resources["wheels"].limits == {"linear": (-1.0, 1.0)}
    assert described.behaviors["wander"].speed == 0.5
    assert described.behaviors["wander"].restart == Restart(max=5, within=10.0)


def test_the_safe_command_has_the_type_of_the_actuator(project) -> None:
    """A table becomes the class that the actuator takes."""
    safe = config.load(project.write()).resources["wheels"].safe

    assert type(safe).__name__ == "Twist"
    assert (safe.linear, safe.angular) == (0.0, 0.0)


def test_keywords_get_the_types_that_the_constructor_asks_for(project) -> None:
    """Paths begin in the folder of the file; tables, lists and literals fit."""
    described = config.load(
        project.write(
            '[sensor.x]\ndriver = "{m}:Picky"\npin = 3\ntable = "map.bin"\n'
            'mode = "fast"\noffsets = [1, 2.5]\nstart = {{ linear = 1 }}\n'
            "weights = {{ a = 1, b = 0.5 }}\n"
        )
    )

    sensor = described.resources["x"]
    assert sensor.name == "x"
    assert sensor.pin == 3
    assert sensor.table == project.folder.resolve() / "map.bin"
    assert sensor.mode == "fast"
    assert sensor.offsets == (1.0, 2.5)
    assert sensor.start.linear == 1.0
    assert sensor.weights == {"a": 1.0, "b": 0.5}


def test_a_default_without_a_type_tells_the_type(project) -> None:
    """``speed=1`` in a constructor is a number, and a fraction will do."""
    (project.folder / f"{project.module}_b.py").write_text(
        "import esair\n"
        "class Slow(esair.Behavior):\n"
        "    factor = 2\n"
        "    def __init__(self, speed=1, word='a', thing=None, **keywords):\n"
        "        super().__init__(**keywords)\n"
        "        self.speed, self.thing = speed, thing\n"
    )
    text = '[behavior.x]\ndriver = "{m}_b:Slow"\n'
    slow = config.load(
        project.write(text + "speed = 0.5\nfactor = 1.5\nthing = [1]\n")
    ).behaviors["x"]
    assert (slow.speed, slow.factor, slow.thing) == (0.5, 1.5, [1])

    project.write(text + 'speed = "fast"\nfactor = true\nword = 3\n')
    assert project.mistakes().keys() == {
        "behavior.x.speed",
        "behavior.x.factor",
        "behavior.x.word",
    }


@pytest.mark.promise("PRO-4")
def test_an_initial_value_has_the_type_of_the_readings(project) -> None:
    """A table becomes what the sensor says, as the safe command of an actuator does."""
    (project.folder / f"{project.module}_p.py").write_text(
        f"import esair\nfrom {project.module} import Twist\n"
        "class Pose(esair.Sensor[Twist]):\n"
        "    async def stream(self):\n"
        "        yield Twist(1.0)\n"
    )
    text = '[sensor.pose]\ndriver = "{m}_p:Pose"\ninitial = '

    pose = config.load(project.write(text + "{{ linear = 2 }}\n")).resources["pose"]

    assert pose.initial.linear == 2.0
    project.write(text + '"far"\n')
    assert "expected a table" in project.mistakes()["sensor.pose.initial"]


def test_a_profile_in_the_file_changes_that_of_the_class(project) -> None:
    """What the file does not say stays as the class says."""
    described = config.load(
        project.write(
            '[sensor.front]\ndriver = "{m}:Sonar"\n'
            '[actuator.wheels]\ndriver = "{m}:Wheels"\nsafe = {{ linear = 0 }}\n'
            '[behavior.avoid]\ndriver = "{m}:Avoid"\n'
            'reads = {{ sonar = {{ name = "front", max_age = 0.4 }} }}\n'
            "[behavior.avoid.writes]\nwheels = {{ priority = 7 }}\n"
        )
    )

    needs = described.behaviors["avoid"].needs
    assert (needs["sonar"].resource, needs["sonar"].max_age) == ("front", 0.4)
    assert needs["sonar"].type is float
    assert (needs["wheels"].resource, needs["wheels"].priority) == ("wheels", 7)


def test_a_policy_can_be_exclusive_and_limit_priorities(project) -> None:
    """The two reserved keys of an access table."""
    described = config.load(
        project.changed(
            'wander = "write"\navoid = "write, configure"',
            '"*" = "write"\nexclusive = false\n'
            'max_priority = {{ avoid = 20, "*" = 5 }}',
        )
    )

    policy = described.policies["wheels"]
    assert policy.allow == {"*": Access.WRITE}
    assert policy.exclusive is False
    assert policy.max_priority == {"avoid": 20, "*": 5}


@pytest.mark.virtual_clock
@pytest.mark.promise("BEH-6")
async def test_a_file_says_who_may_manage_behaviors(project) -> None:
    """The table of the word that no resource has."""
    described = config.load(
        project.changed(
            "[access.wheels]", '[access.behaviors]\nwander = "manage"\n[access.wheels]'
        )
    )

    assert described.policies["behaviors"] == Policy.behaviors(
        allow={"wander": "manage"}
    )
    config.build(described)


@pytest.mark.fault("G10")
def test_the_file_is_read_once_and_its_hash_kept(project) -> None:
    """What was loaded can be told from what is on the disk now."""
    path = project.write()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    described = config.load(path)
    path.write_text("[robot]")

    assert described.digest == digest


def test_a_description_serves_for_one_robot(project) -> None:
    """Two robots never share a device."""
    described = config.load(project.write())
    config.build(described)

    with pytest.raises(ConfigError, match="load the file again"):
        config.build(described)


def test_modules_are_searched_beside_the_file_only_while_loading(project) -> None:
    """The search path is as before afterwards."""
    import sys

    before = list(sys.path)
    config.load(project.write())

    assert sys.path == before


def test_paths_of_the_robot_begin_in_the_folder_of_the_file(project) -> None:
    """Also where the class imports `Path` for type checkers only."""
    path = project.write('[record]\npath = "runs/one.mcap"\n')

    assert config.load(path).robot["record"].path == path.parent / "runs/one.mcap"

    project.write("[page]\ncertificate = 3\n")
    assert "expected a path, not 3" in project.mistakes()["page.certificate"]


@pytest.mark.parametrize(
    ("file", "told"),
    [("none.pem", "there is no file"), ("rover.toml", "expected a certificate in PEM")],
)
def test_files_of_the_page_are_looked_at_without_opening_it(
    project, file, told
) -> None:
    """A certificate that is none is told like every other mistake, and at its key."""
    path = project.write()
    text = f'[page]\ncertificate = "{file}"\nkey = "{path.name}"\n'
    (path.parent / "rover.toml").write_text(text)

    (found,) = config.check(project.write(text)).findings

    assert (found.key, found.line) == ("page.certificate", 2)
    assert told in found.message
