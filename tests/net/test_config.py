"""``[network]``, ``[remote.*]`` and ``[share.*]``: two files of a pair, and their mistakes."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.net.parts import free_port

import esair
from esair.cli._peers import of_status
from esair.config import check, check_together, load
from esair.seat import Status
from esair.seat._operator import Console

PARTS = """
import asyncio

import attrs

import esair


@attrs.frozen
class Twist:
    linear: float
    angular: float


@attrs.frozen
class Docked:
    bay: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    bay: int


class Sonar(esair.Sensor[float]):
    async def read(self) -> float:
        return 0.7


class Wheels(esair.Actuator[Twist]):
    safe = Twist(0.0, 0.0)
    told = []

    async def write(self, command: Twist) -> None:
        self.told.append(command)


class Docking(esair.Behavior):
    @esair.answers
    async def dock(self, request: Dock) -> Docked:
        return Docked(request.bay)


class Idle(esair.Behavior):
    async def run(self) -> None:
        pass


class Hasty(esair.Reaction):
    sonar = esair.reads(float, max_age=0.08)

    def react(self, sonar: float) -> None:
        pass


class Drive(esair.Behavior):
    sonar = esair.reads(float)
    wheels = esair.writes(Twist)
    docked = None

    async def run(self) -> None:
        async for _ in esair.every(0.02):
            try:
                await self.wheels.write(Twist(0.1 * await self.sonar.read(), 0.0))
                self.docked = self.docked or await self.ask("docking", Dock(3))
            except esair.EsairError:
                pass
"""

BASE = """
[robot]
name = "base"

[network]
listen = ["tcp/127.0.0.1:PORT"]

[sensor.sonar]
driver = "MODULE:Sonar"

[actuator.wheels]
driver = "MODULE:Wheels"

[behavior.docking]
driver = "MODULE:Docking"

[share.sonar]
to = ["rover"]

[share.wheels]
to = ["rover"]
priority = 5

[share.docking]
to = ["rover"]
"""

ROVER = """
[robot]
name = "rover"

[network]
connect = ["tcp/127.0.0.1:PORT"]

[behavior.drive]
driver = "MODULE:Drive"

[remote.base.sensor.sonar]
type = "float"
period = 0.5

[remote.base.actuator.wheels]
type = "MODULE:Twist"

[remote.base.behavior.docking]
requests = ["MODULE:Dock"]
"""


class Files:
    """The files of a pair."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.module = f"parts_{folder.name.replace('-', '_')}"
        (folder / f"{self.module}.py").write_text(PARTS)
        (folder / f"{self.module}_2.py").write_text(PARTS)
        self.port = free_port()
        self.base, self.rover = self.write("base", BASE), self.write("rover", ROVER)

    def write(self, name: str, text: str) -> Path:
        path = self.folder / f"{name}.toml"
        text = text.replace("MODULE", self.module).replace("PORT", str(self.port))
        path.write_text(text)
        return path

    def change(self, path: Path, old: str, new: str) -> None:
        text = path.read_text()
        old, new = (
            each.replace("MODULE", self.module).replace("PORT", str(self.port))
            for each in (old, new)
        )
        assert old in text
        path.write_text(text.replace(old, new, 1))

    def errors(self) -> list[tuple[str, str, str]]:
        """What is wrong between them: file, key, message."""
        reports = check_together([self.base, self.rover])
        return [
            (Path(report.file).name, found.key, found.message)
            for report in reports
            for found in report.findings
            if found.severity == "error"
        ]


@pytest.fixture
def files(tmp_path: Path) -> Files:
    return Files(tmp_path)


def test_a_pair_without_a_mistake(files: Files) -> None:
    """The rulebook reads both; what comes with a peer need not be used."""
    assert files.errors() == []
    reports = check_together([files.base, files.rover])
    warned = [each for report in reports for each in report.findings]
    assert [each for each in warned if each.rule in {"peer", "unused"}] == []
    (wheels,) = reports[0].actuators
    assert [(each.behavior, each.priority) for each in wheels.writers] == [("rover", 5)]


@pytest.mark.promise("NET-1")
def test_what_an_actuator_was_told_is_shared_as_a_sensor(files: Files) -> None:
    """Under its name in quotes; what is no actuator was told nothing."""
    told = '[remote.base.sensor.told]\nremote = "wheels.applied"\n\n[remote.base.sensor'
    files.change(files.base, "[share.sonar]", '[share."wheels.applied"]')
    files.change(files.rover, "[remote.base.sensor", told)
    assert {key for _, key, _ in files.errors()} == {"remote.base.sensor.sonar"}
    files.change(files.base, "wheels.applied", "sonar.applied")
    assert {key for _, key, _ in files.errors()} == {
        "share.'sonar.applied'",
        "remote.base.sensor.told",
        "remote.base.sensor.sonar",
    }


@pytest.mark.promise("NET-1")
@pytest.mark.parametrize(
    ("file", "old", "new", "key", "told"),
    [
        ("base", "[share.sonar]", "[share.sonnar]", "share.sonnar", "mean 'sonar'"),
        ("base", 'to = ["rover"]', 'to = ["rover", "X Y"]', "share.sonar.to", "a name"),
        (
            "base",
            "[share.sonar]",
            "[share.sonar]\npriority = 5",
            "share.sonar.priority",
            "it is for actuators, and 'sonar' is of the kind sensor",
        ),
        (
            "base",
            "[share.wheels]",
            "[share.wheels]\nrate = 5.0",
            "share.wheels.rate",
            "it is for sensors, and 'wheels' is of the kind actuator",
        ),
        ("base", "127.0.0.1", "0.0.0.0", "network.listen", "insecure = true"),
        ("base", 'name = "base"', 'name = "rover"', "network", "no peer of itself"),
        ("base", "listen", "connect", "network.connect", "listens nowhere"),
        ("base", "listen =", "listen = 3 #", "network.listen", "a string, not 3"),
        (
            "base",
            'to = ["rover"]',
            'to = ["other"]',
            "base.sensor.sonar",
            "to = ['rover']",
        ),
        ("rover", "[network]", "[networc]", "networc", "did you mean 'network'"),
        ("rover", ".sensor.", ".senser.", "remote.base.senser", "mean 'sensor'"),
        ("rover", "sensor.sonar", "sensor.base", "sensor.base", "already"),
        ("rover", ":Dock", ":Docked", "docking.requests", "not derived from"),
        ("base", "MODULE:Docking", "MODULE:Idle", "docking.requests", "takes no"),
        (
            "rover",
            "MODULE:Twist",
            "MODULE_2:Twist",
            "wheels.type",
            ":Twist in base.toml, not parts_",
        ),
        ("rover", '"float"', '"bool"', "base.sensor.sonar.type", "gives float"),
        ("rover", '"float"', '"MODULE:No"', "sonar.type", "no attribute 'No'"),
        ("rover", '"float"', '"rovr:No"', "sonar.type", "put it beside the robot.toml"),
        ("rover", '"float"', '"MODULE:Drive"', "sonar.type", "the class of a value"),
        ("rover", '"float"', '"os:system"', "sonar.type", "the class of a value"),
        ("rover", 'type = "float"', "link_rate = 0", "sonar.link_rate", "more than 0"),
    ],
)
def test_mistakes_are_named(
    files: Files, file: str, old: str, new: str, key: str, told: str
) -> None:
    """With the file, the key, what was expected and what to do."""
    files.change(getattr(files, file), old, new)
    found = files.errors()
    assert any(key in where and told in why for _, where, why in found), found


def test_a_wrong_certificate_is_not_called_none(files: Files) -> None:
    """One mistake is one line: the endpoints are what they were."""
    files.change(files.rover, '"tcp/', '"tls/')
    ((_, key, why),) = files.errors()
    assert (key, "needs certificates" in why) == ("network.tls", True)
    lines = "\n".join(f'{each} = "none.pem"' for each in ("ca", "certificate", "key"))
    files.change(
        files.rover, "[behavior.drive]", f"[network.tls]\n{lines}\n[behavior.drive]"
    )
    ((_, key, why),) = files.errors()
    assert (key, "there is no file" in why) == ("network.tls.ca", True)


def test_the_loud_word_is_a_warning(files: Files) -> None:
    """Each check says it."""
    files.change(files.base, "127.0.0.1", "0.0.0.0")
    files.change(files.base, "[network]", "[network]\ninsecure = true")
    (report, _) = check_together([files.base, files.rover])
    (found,) = (each for each in report.findings if each.rule == "peer")
    assert (found.severity, found.key, found.line) == ("warning", "network.insecure", 6)


def test_a_network_whose_package_is_missing_is_a_warning(
    files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot would start without its peers; elsewhere the package may be there."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (found,) = (each for each in check(files.base).findings if each.rule == "package")
    assert (found.severity, found.key, found.line) == ("warning", "network", 5)
    assert "pip install 'esair[net]'" in found.message


def test_two_that_do_not_meet_are_warned_of(files: Files) -> None:
    """Not more: something between them may forward a port."""
    files.change(files.rover, str(files.port), "9")
    (_, report) = check_together([files.base, files.rover])
    (found,) = (each for each in report.findings if each.rule == "peer")
    assert (found.severity, found.key, found.line) == ("warning", "network.connect", 6)
    assert f"base.toml listens at port {files.port}" in found.message
    assert files.errors() == []


@pytest.mark.promise("NET-1")
def test_a_simulation_joins_no_network_by_an_omission(files: Files) -> None:
    """It could move real peers: it needs ``sim``, whose keys replace those beside it."""
    assert files.errors() == []
    with pytest.raises(ExceptionGroup) as refused:
        load(files.rover, simulated=True)
    (mistake,) = refused.value.exceptions
    assert "sim = {} to join it as it is" in str(mistake)

    files.change(files.rover, "[network]", "[network]\nsim = {}")
    assert load(files.rover, simulated=True).buses.keys() == {"base"}

    end = "tcp/127.0.0.1:9"
    files.change(files.rover, "sim = {}", f"sim = {{ connect = ['{end}'] }}")
    bus: Any = load(files.rover, simulated=True).buses["base"]
    assert bus.network.connect == (end,)
    files.change(files.rover, end, "here")
    (found,) = check(files.rover).findings
    assert (found.key, found.only_simulated) == ("network.connect", True)


@pytest.mark.promise("NET-2")
@pytest.mark.parametrize(
    ("file", "old", "new", "key", "told"),
    [
        ("rover", "remote.base.", "remote.bse.", "remote.bse", "is 'base'"),
        ("base", 'to = ["rover"]', 'to = ["rovr"]', "share.sonar", "of 'rovr'"),
        (
            "rover",
            "period = 0.5",
            "link_rate = 50.0",
            "sonar.link_rate",
            "20 Hz at most",
        ),
        ("rover", "period = 0.5", "period = 0.05", "sonar.period", "every 0.1 s"),
        ("rover", ":Drive", ":Hasty", "behavior.drive", "0.08 s old at most"),
        (
            "rover",
            'type = "MODULE:Twist"',
            "command_timeout = 0.5",
            "wheels.command_timeout",
            "good for 0.2 s only",
        ),
    ],
)
def test_what_may_be_meant_otherwise_there_is_a_warning(
    files: Files, file: str, old: str, new: str, key: str, told: str
) -> None:
    """With the file and the line: names, rates and times that do not fit together."""
    path = getattr(files, file)
    for _ in range(path.read_text().count(old.replace("MODULE", files.module))):
        files.change(path, old, new)
    reports = check_together([files.base, files.rover])
    found = [
        (each.key, each.message)
        for report in reports
        if Path(report.file).name == f"{file}.toml"
        for each in report.findings
        if each.rule == "peer" and each.severity == "warning"
    ]
    assert any(key in where and told in why for where, why in found), found


def test_a_third_robot_needs_no_file(files: Files) -> None:
    """Of the two that are looked at each knows the other one."""
    files.change(files.base, 'to = ["rover"]', 'to = ["rover", "other"]')
    reports = check_together([files.base, files.rover])
    assert not [e for r in reports for e in r.findings if e.rule == "peer"]


async def docked(drive: Any) -> None:
    async with asyncio.timeout(5.0):
        async for _ in esair.every(0.02):
            if drive.docked is not None:
                return


@pytest.mark.promise("NET-2")
@pytest.mark.real_clock
async def test_two_files_are_two_robots(files: Files) -> None:
    """Over zenoh, in one process here; the peers are in the picture of both."""
    pytest.importorskip("zenoh")
    base: Any = esair.Robot.from_config(files.base)
    rover: Any = esair.Robot.from_config(files.rover)
    async with base, rover:
        drive: Any = rover.behaviors.action("drive")
        await docked(drive)
        parts = sys.modules[files.module]
        assert parts.Wheels.told[-1] == parts.Twist(0.1 * 0.7, 0.0)
        assert base.resources.why("wheels").holder == "rover"
        loop = asyncio.get_running_loop()
        for _ in range(100):  # what it holds lapses now and then on a busy computer
            await asyncio.sleep(0.1)
            (told,) = of_status(Status(base, loop).picture())
            if told["holds"]:
                break
        assert (told["name"], told["state"]) == ("rover", "ready")
        assert told["holds"] == ["wheels"]
        (told,) = of_status(Status(rover, loop).picture())
        assert told["used"] == ["sonar: ready", "wheels: ready"]
        assert 0.0 <= told["round_trip"] < 0.5


@pytest.mark.promise("OPS-2", "NET-2")
@pytest.mark.real_clock
async def test_what_the_file_has_of_a_peer_can_be_put_in_its_place(
    files: Files,
) -> None:
    """It is on the bus that there is: what was added or replaced works at once."""
    pytest.importorskip("zenoh")
    base: Any = esair.Robot.from_config(files.base)
    rover: Any = esair.Robot.from_config(files.rover)
    async with base, rover:
        drive: Any = rover.behaviors.action("drive")
        await docked(drive)
        for robot, name in ((base, "rover"), (rover, "docking"), (rover, "wheels")):
            console = Console(robot)
            part = await console.part(name)
            await console.owner_of(part).replace(name, part)
        drive.docked = None
        told = sys.modules[files.module].Wheels.told
        told.clear()
        await docked(drive)
        assert any(each.linear > 0.0 for each in told)
