"""Any object of a package as a part."""

from __future__ import annotations

import threading
from typing import Any

import pytest

import esair
from esair.drivers.object import ObjectActuator, ObjectSensor
from esair.exceptions import ConfigError, DeviceLostError
from esair.testing import ActuatorContract, SensorContract

pytestmark = pytest.mark.virtual_clock


class GoneError(Exception):
    """What the package raises when its part is gone."""


class Probe:
    """A package's object: a part that can be asked, told, closed, pulled out."""

    there = True
    made: list[Probe] = []  # noqa: RUF012 - emptied for each test

    def __init__(self, pin: int = 1, *, gain: float = 1.0) -> None:
        self.pin, self.gain, self.closed = pin, gain, False
        self.told: list[tuple[float, float]] = []
        self.channels = [self, self]
        self._speed = 0.0
        self.look()
        Probe.made.append(self)

    def look(self) -> None:
        if not Probe.there:
            raise GoneError("no answer")
        self.thread = threading.current_thread()

    @property
    def voltage(self) -> float:
        self.look()
        return 1.5 * self.gain

    def measure(self, channel: int = 0, *, fine: bool = False) -> float:
        self.look()
        return channel + (0.25 if fine else 0.0)

    @property
    def speed(self) -> float:
        return self._speed

    @speed.setter
    def speed(self, value: float) -> None:
        self.look()
        self._speed = value

    def move(self, value: float, *, ramp: float = 0.0) -> None:
        self.look()
        self.told.append((value, ramp))

    def close(self) -> None:
        self.closed = True


@pytest.fixture(autouse=True)
def _there() -> None:
    Probe.there = True
    Probe.made.clear()


class Turned:
    """As a BNO055 of Adafruit: it has restarted after five answers."""

    def __init__(self) -> None:
        self.answers = 0
        self.finger: tuple[int | None, int] = (None, 0)
        self.fingers: list[int] = []

    @property
    def euler(self) -> tuple[float | None, ...]:
        self.answers += 1
        return (None,) * 3 if self.answers > 5 else (1.0, 2.0, 3.0)


@pytest.mark.fault("D26")
async def test_values_that_are_all_none_are_a_fault() -> None:
    """So the part is opened again, which sets it up."""
    sensor = ObjectSensor(name="imu", library=Turned, value="euler")
    policy = esair.Policy("imu", allow={"*": esair.Access.READ})
    async with esair.Robot(resources=[sensor], policies=[policy]) as robot:
        right = await robot.resources.register("me", "imu", esair.Access.READ)
        for answer in range(20):
            try:
                reading = await robot.sensors.read(right, fresh=True, timeout=3.0)
            except (esair.DeviceFaultError, DeviceLostError):
                assert answer >= 5
            else:
                assert reading.value == (1.0, 2.0, 3.0)
        assert robot.resources.query("imu").losses > 0
    for value, wanted in (("finger", (None, 0)), ("fingers", [])):
        sensor = ObjectSensor(library=Turned, value=value)
        sensor.open()
        assert sensor.read() == wanted


class Pulled:
    """How the part of this file goes and comes."""

    keeps_nothing = "the object is made anew at each opening"

    async def unplug(self, _device: Any) -> None:
        Probe.there = False

    silence = unplug

    async def speak(self, _device: Any) -> None:
        Probe.there = True

    async def power_cycle(self, _device: Any) -> None:
        """Nothing is kept in it."""


class TestSensor(Pulled, SensorContract):
    def make(self) -> Any:
        return ObjectSensor(library=Probe, value="voltage", lost=[GoneError])


class TestActuator(Pulled, ActuatorContract):
    def make(self) -> Any:
        return ObjectActuator(
            library=Probe,
            attribute="speed",
            safe=0.0,
            limits=(-1.0, 1.0),
            lost=[GoneError],
        )

    def commands(self) -> list[Any]:
        return [0.5, -1.0]


@pytest.mark.parametrize(
    ("value", "reading"),
    [
        ("voltage", 3.0),
        ("channels[1].voltage", 3.0),
        ("channels[-1].measure(2, fine=True)", 2.25),
        ("measure()", 0.0),
        (["voltage", "measure(7)"], {"voltage": 3.0, "measure(7)": 7}),
    ],
)
def test_a_way_leads_to_what_is_read(value, reading) -> None:
    """Attributes, items, calls with plain arguments; several are a dictionary."""
    sensor = ObjectSensor(library=Probe, arguments={"gain": 2.0}, value=value)
    sensor.open()

    assert sensor.read() == reading


def test_a_command_is_assigned_or_called_with() -> None:
    """The command first, then the arguments of the way; HOLD tells nothing."""
    fan = ObjectActuator(library=Probe, attribute="move(ramp=0.5)", safe="hold")
    fan.open()
    fan.write(0.25)
    fan.write(esair.HOLD)

    assert fan.object.it.told == [(0.25, 0.5)]
    assert fan.safe is esair.HOLD


def test_it_is_set_up_and_closed_at_each_opening() -> None:
    """By the package's own close; arguments may be a list."""
    fan = ObjectActuator(
        library=Probe, arguments=[4], set_up={"gain": 3.0}, attribute="speed", safe=0.0
    )
    fan.open()
    fan.open()
    fan.close()

    assert [(each.pin, each.gain, each.closed) for each in Probe.made] == [
        (4, 3.0, True)
    ] * 2
    with pytest.raises(DeviceLostError, match="it is not open"):
        fan.write(0.0)


async def test_a_robot_uses_it_on_one_thread_and_closes_it() -> None:
    """A package that blocks holds nobody up; its errors are losses where it says so."""
    probe = ObjectSensor(name="probe", library=Probe, value="voltage", lost=[GoneError])
    policy = esair.Policy("probe", allow={"*": esair.Access.READ})
    async with esair.Robot(resources=[probe], policies=[policy]) as robot:
        right = await robot.resources.register("me", "probe", esair.Access.READ)
        assert (await robot.sensors.read(right, fresh=True)).value == 1.5
        (made,) = Probe.made
        assert made.thread is not threading.main_thread()
        Probe.there = False
        with pytest.raises(DeviceLostError, match="GoneError: no answer"):
            await robot.sensors.read(right, fresh=True)

    assert all(each.closed for each in Probe.made)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"library": "nothing"}, "library"),
        ({"library": "no_such_package:X"}, "library"),
        ({"library": "math:pi"}, "library"),
        ({"value": "a..b"}, "value"),
        ({"value": "read(open('x'))"}, "value"),
        ({"value": "__class__.__init__"}, "value"),
        ({"value": "a + b"}, "value"),
        ({"value": []}, "value"),
        ({"set_up": {"measure()": 1}}, "set_up.measure()"),
        ({"lost": ["math:pi"]}, "library"),
        ({"lost": ["math:sqrt"]}, "lost"),
    ],
)
def test_its_mistakes_are_named(options, field) -> None:
    """Before anything is made."""
    with pytest.raises(ConfigError) as caught:
        ObjectSensor(**{"library": Probe, "value": "voltage", **options})

    assert caught.value.args[0].startswith(f"object_sensor: {field}: ")
    assert Probe.made == []


def test_a_thermometer_of_a_package_from_the_registry(tmp_path, monkeypatch) -> None:
    """w1thermsensor, unchanged, on a folder such as the kernel makes."""
    monkeypatch.setenv("W1THERMSENSOR_NO_KERNEL_MODULE", "1")
    w1 = pytest.importorskip("w1thermsensor", reason="w1thermsensor is not installed")
    folder = tmp_path / "28-0316a2795dff"
    folder.mkdir()
    (folder / "w1_slave").write_text(
        "27 01 4b 46 7f ff 0c 10 2c : crc=2c YES\n27 01 4b 46 7f ff 0c 10 2c t=18437\n"
    )
    monkeypatch.setattr(w1.W1ThermSensor, "BASE_DIRECTORY", tmp_path)
    sensor = ObjectSensor(
        library="w1thermsensor:W1ThermSensor", value="get_temperature()"
    )

    sensor.open()

    assert sensor.read() == pytest.approx(18.4375)
