"""Names of classes: ``module:Class``, or what an installed package offers."""

from typing import Any

import pytest

import esair
from esair import config
from esair.buses import SerialBus
from esair.drivers.line import LineActuator


@pytest.fixture
def installed(project, monkeypatch):
    """Install a package that offers the classes of the project's module."""
    package = project.folder / "parts-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: parts\nVersion: 1.0\n"
    )
    (package / "entry_points.txt").write_text(
        f"[esair.drivers]\nsonar-x = {project.module}:Sonar\n"
        f"broken = {project.module}:NotThere\nnone = {project.module}:MODULE\n"
        f"[esair.buses]\nwire = {project.module}:Wire\n"
    )
    monkeypatch.syspath_prepend(str(project.folder))
    return project


def test_an_installed_driver_is_found_by_its_name(installed) -> None:
    """Entry points of the groups esair.drivers and esair.buses."""
    described = config.load(
        installed.write(
            '[bus.w]\ntype = "wire"\nport = "p"\n'
            '[sensor.s]\ndriver = "sonar-x"\nbus = "w"\n'
        )
    )

    assert type(described.resources["s"]).__name__ == "Sonar"
    assert type(described.buses["w"]).__name__ == "Wire"


@pytest.mark.fault("G05")
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("sonra-x", "'sonra-x' is not installed; did you mean 'sonar-x'?"),
        ("broken", "'broken' cannot be imported: AttributeError"),
        ("zzz", "'zzz' is not installed; there are adafruit, "),
    ],
)
def test_an_installed_name_that_is_wrong_is_told(installed, name, told) -> None:
    """With the nearest that is installed, or all of them."""
    installed.write(f'[sensor.s]\ndriver = "{name}"\n')

    assert told in installed.mistakes()["sensor.s.driver"]


def test_what_is_no_class_is_told(project) -> None:
    """A module has functions and values too."""
    project.write('[sensor.s]\ndriver = "{m}:esair"\n')

    assert "is no class, but a module" in project.mistakes()["sensor.s.driver"]


def test_a_package_beside_the_file_serves_as_well(project) -> None:
    """Not only single modules."""
    package = project.folder / f"{project.module}_p"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "deep.py").write_text(f"from {project.module} import Sonar\n")
    described = config.load(project.write('[sensor.s]\ndriver = "{m}_p.deep:Sonar"\n'))

    assert type(described.resources["s"]).__name__ == "Sonar"


def test_from_config_makes_a_robot(project) -> None:
    """The way that scripts use; the sim tables count if asked to."""
    assert isinstance(esair.Robot.from_config(project.write()), esair.Robot)

    robot = esair.Robot.from_config(project.file, simulated=True)
    assert robot.name == "rover"


def test_a_robot_class_of_ones_own_has_keys_of_its_own(project) -> None:
    """Its keywords are the keys of [robot]."""

    class Rover(esair.Robot):
        def __init__(self, *, colour: str = "red", **keywords) -> None:
            super().__init__(**keywords)
            self.colour = colour

    project.changed('name = "rover"', 'colour = "blue"\ngrace = 2')
    assert Rover.from_config(project.file).colour == "blue"
    assert "no such key" in project.mistakes()["robot.colour"]


async def test_a_loaded_robot_runs(project, fake_sensor) -> None:
    """From the file to commands at the wheels; the virtual clock makes it quick."""
    import asyncio

    path = project.changed('driver = "{m}:Wheels"', 'driver = "{m}:Wheels"\nsim = {{}}')
    described = config.load(path, simulated=True)
    wheels = described.resources["wheels"]
    sent = []

    async def write(command) -> None:
        sent.append(command)

    wheels.write = write
    async with config.build(described):
        await asyncio.sleep(1.0)

    assert sent[-1] == wheels.safe
    assert any(command.linear == 0.5 for command in sent)


@pytest.fixture
def parts(project, monkeypatch):
    """Install a package whose drivers are modules."""
    names = {
        "both": "from {m} import Sonar, Wheels\n__all__ = ['Sonar', 'Wheels', 'COUNT']\nCOUNT = 1",
        "own": "from {m} import Sonar\n\nclass Ping(Sonar): ...\n\nclass _Hidden(Sonar): ...",
        "two": "from {m} import Sonar, FakeSonar\n__all__ = ['Sonar', 'FakeSonar']",
        "empty": "import math",
        "needy": "import package_that_is_nowhere",
    }
    module = f"{project.module}_parts"
    package = project.folder / module
    package.mkdir()
    (package / "__init__.py").write_text("")
    for name, text in names.items():
        (package / f"{name}.py").write_text(text.format(m=project.module) + "\n")
    info = project.folder / "parts-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: parts\nVersion: 1.0\nProvides-Extra: needy\n"
    )
    lines = "".join(f"{name} = {module}.{name}\n" for name in names)
    (info / "entry_points.txt").write_text(f"[esair.drivers]\n{lines}")
    monkeypatch.syspath_prepend(str(project.folder))
    return project


def test_an_installed_driver_may_be_a_module(parts) -> None:
    """Then its class is the only public one of the kind that the table asks for."""
    described = config.load(
        parts.write(
            '[sensor.s]\ndriver = "both"\n[sensor.t]\ndriver = "own"\n'
            '[actuator.a]\ndriver = "both"\nsafe = {{ linear = 0.0 }}\n'
        )
    )

    names = {name: type(each).__name__ for name, each in described.resources.items()}
    assert names == {"s": "Sonar", "t": "Ping", "a": "Wheels"}


@pytest.mark.fault("G05")
@pytest.mark.parametrize(
    ("kind", "name", "told"),
    [
        ("sensor", "two", "'two' has several; expected one of '{m}_parts.two:Sonar', "),
        (
            "actuator",
            "own",
            "expected an Actuator, 'own' ({m}_parts.own) has only Ping",
        ),
        (
            "behavior",
            "both",
            "expected a Behavior or Reaction, 'both' ({m}_parts.both) has",
        ),
        ("sensor", "empty", "expected a Sensor, 'empty' ({m}_parts.empty) has none"),
        (
            "sensor",
            "needy",
            "'needy' needs 'package_that_is_nowhere', which is not installed: "
            "pip install 'parts[needy]'",
        ),
    ],
)
def test_a_module_without_the_one_class_is_told(parts, kind, name, told) -> None:
    """With the classes that it has, or with what it needs."""
    parts.write(f'[{kind}.x]\ndriver = "{name}"\n')

    error = parts.mistakes()[f"{kind}.x.driver"]
    assert told.format(m=parts.module) in error


class Quiet(LineActuator):
    """A shipped driver of which the class says what is safe, and how far it goes."""

    def __init__(self, *, name: str, bus: SerialBus, **settings: Any) -> None:
        super().__init__(name=name, bus=bus, safe=0.0, ack=True, **settings)


QUIET = (
    '[bus.w]\ntype = "serial"\nport = "loop://"\n'
    '[actuator.q]\ndriver = "tests.config.test_classes:Quiet"\nbus = "w"\n'
)


def test_what_a_class_says_itself_need_not_be_said(project) -> None:
    """Neither a keyword that must be there, nor what is true of any actuator."""
    described = config.load(project.write(QUIET + "command_timeout = 0.3\n"))

    quiet: Any = described.resources["q"]
    assert (quiet.safe, quiet.ack, quiet.command_timeout) == (0.0, True, 0.3)


def test_what_a_class_says_itself_is_no_key(project) -> None:
    """Python would have it twice."""
    project.write(QUIET + "ack = false\n")

    assert "there is no such key" in project.mistakes()["actuator.q.ack"]
