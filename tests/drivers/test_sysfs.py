"""What the kernel measures and drives, in folders as it makes them."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path
from typing import Any

import pytest

from esair.drivers.sysfs import SysfsActuator, SysfsSensor
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.testing import ActuatorContract, SensorContract

FILES = {
    "class/hwmon/hwmon0/name": "cpu_thermal",
    "class/hwmon/hwmon0/temp1_input": "51234",
    "class/hwmon/hwmon1/name": "ina219",
    "class/hwmon/hwmon1/in1_input": "12050",
    "class/hwmon/hwmon1/curr1_input": "-250",
    "class/hwmon/hwmon1/power1_input": "3000000",
    "class/hwmon/hwmon1/power1_average": "2500000",
    "class/hwmon/hwmon1/in1_max": "26000",
    "class/hwmon/hwmon1/in1_max_alarm": "1",
    "class/hwmon/hwmon1/fan1_input": "1500",
    "class/hwmon/hwmon1/energy1_input": "2000000",
    "bus/iio/devices/iio:device0/name": "bmp280",
    "bus/iio/devices/iio:device0/in_pressure_input": "101.325",
    "bus/iio/devices/iio:device0/in_temp_input": "23500",
    "bus/iio/devices/iio:device0/in_humidityrelative_input": "45500",
    "bus/iio/devices/iio:device1/name": "mcp3008",
    "bus/iio/devices/iio:device1/in_voltage3_raw": "512",
    "bus/iio/devices/iio:device1/in_voltage_scale": "3.2227",
    "bus/iio/devices/iio:device2/name": "lsm6dsl",
    "bus/iio/devices/iio:device2/in_accel_x_raw": "100",
    "bus/iio/devices/iio:device2/in_accel_x_offset": "-2",
    "bus/iio/devices/iio:device2/in_accel_x_scale": "0.01",
    "bus/iio/devices/iio:device2/in_anglvel_z_raw": "-50",
    "bus/iio/devices/iio:device2/in_anglvel_scale": "0.02",
    "bus/iio/devices/iio:device3/name": "ads1115",
    "bus/iio/devices/iio:device3/in_voltage0-voltage1_raw": "-100",
    "bus/iio/devices/iio:device3/in_voltage-voltage_scale": "0.125",
    "bus/iio/devices/iio:device4/name": "mlx90614",
    "bus/iio/devices/iio:device4/in_temp_object_raw": "15000",
    "bus/iio/devices/iio:device4/in_temp_offset": "-13657.5",
    "bus/iio/devices/iio:device4/in_temp_scale": "20",
    "bus/w1/devices/28-0316a2795dff/name": "28-0316a2795dff",
    "bus/w1/devices/28-0316a2795dff/temperature": "18437",
    "class/leds/green/max_brightness": "255",
    "class/leds/green/brightness": "7",
    "class/leds/green/trigger": "[mmc0] none",
    "class/pwm/pwmchip0/export": "",
    "class/pwm/pwmchip0/pwm1/period": "0",
    "class/pwm/pwmchip0/pwm1/duty_cycle": "0",
    "class/pwm/pwmchip0/pwm1/enable": "0",
}


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch) -> Path:
    for name, text in FILES.items():
        path = tmp_path / "sys" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    for part in (SysfsSensor, SysfsActuator):
        monkeypatch.setattr(part, "root", tmp_path / "sys")
    made: Path = tmp_path / "sys"
    return made


@pytest.mark.fault("D06")
@pytest.mark.parametrize("kind", ["hwmon", "pwm"])
def test_a_part_that_has_the_number_of_another_now_is_not_taken_for_it(
    root, kind
) -> None:
    """The kernel gives a number anew: that is a link in its folder of the class."""
    link = root / f"class/{kind}" / {"hwmon": "hwmon0", "pwm": "pwmchip0"}[kind]
    link.rename(root / "mine")
    link.symlink_to(root / "mine")
    device: Any = SysfsSensor(device="hwmon:hwmon0", value="temp1")
    if kind == "pwm":
        device = SysfsActuator(device="pwm:pwmchip0/1")
    device.open()
    shutil.copytree(root / "mine", root / "another")
    shutil.rmtree(root / "mine")
    link.unlink()
    link.symlink_to(root / "another")

    with pytest.raises((DeviceLostError, FileNotFoundError)):
        device.read() if kind == "hwmon" else device.write(1.0)


@pytest.mark.parametrize(
    ("device", "value", "wanted"),
    [
        ("hwmon:cpu_thermal", "temp1", 51.234),
        ("hwmon:hwmon0", "temp1_input", 51.234),
        ("hwmon:ina219", "in1", 12.05),
        ("hwmon:ina219", "curr1", -0.25),
        ("hwmon:ina219", "power1", 3.0),
        ("hwmon:ina219", "power1_average", 2.5),
        ("hwmon:ina219", "in1_max", 26.0),
        ("hwmon:ina219", "in1_max_alarm", 1.0),
        ("hwmon:ina219", "fan1", 1500.0),
        ("hwmon:ina219", "energy1", 2.0),
        ("iio:bmp280", "in_humidityrelative", 45.5),
        ("iio:bmp280", "in_pressure", 101.325),
        ("iio:bmp280", "in_temp", 23.5),
        ("iio:mcp3008", "in_voltage3", 512 * 3.2227e-3),
        ("iio:lsm6dsl", "in_accel_x", 0.98),
        ("iio:lsm6dsl", "in_anglvel_z", -1.0),
        ("iio:ads1115", "in_voltage0-voltage1", -0.0125),
        ("iio:mlx90614", "in_temp_object", 26.85),
        ("w1:28-0316a2795dff", "temperature", 18.437),
    ],
)
def test_values_are_in_plain_units(device, value, wanted) -> None:
    """With the kernel's own scales and offsets, of the value or of its kind."""
    sensor = SysfsSensor(name="part", device=device, value=value)
    sensor.open()

    assert sensor.read() == pytest.approx(wanted)


def test_what_is_not_there_is_named(root) -> None:
    """With what is there; a folder that goes is a loss, a strange text a fault."""
    with pytest.raises(
        DeviceLostError, match="no hwmon 'gpu'; it has cpu_thermal, ina219"
    ):
        SysfsSensor(device="hwmon:gpu", value="temp1").open()
    sensor = SysfsSensor(device="iio:bmp280", value="in_light")
    with pytest.raises(DeviceFaultError, match="has no 'in_light'"):
        sensor.open()
    sensor = SysfsSensor(device="iio:bmp280", value="in_temp")
    sensor.open()
    (root / "bus/iio/devices/iio:device0/in_temp_input").write_text("hot\x1b[2J")
    with pytest.raises(DeviceFaultError, match="which is no number"):
        sensor.read()
    shutil.rmtree(root / "bus/iio/devices/iio:device0")
    with pytest.raises(DeviceLostError, match="is gone"):
        sensor.read()


def test_what_a_thermometer_tells_after_power_up_is_no_temperature(root) -> None:
    """It is one where it was nearly as warm before, as water that is heated."""
    told = root / "bus/w1/devices/28-0316a2795dff/temperature"
    sensor = SysfsSensor(device="w1:28-0316a2795dff", value="temperature")
    told.write_text("85000")
    with pytest.raises(DeviceLostError, match="it has not measured"):
        sensor.open()
    told.write_text("21062")
    sensor.open()
    told.write_text("85000")
    with pytest.raises(DeviceLostError, match="it has not measured"):
        sensor.read()
    for number in (70_000, 84_000, 85_000, 85_000):
        told.write_text(f"{number}")
        assert sensor.read() == pytest.approx(number / 1000)


@pytest.mark.fault("D05", "D06")
@pytest.mark.parametrize("kind", ["hwmon", "iio"])
def test_of_two_parts_with_one_name_the_place_is_said(root, kind) -> None:
    """Which of them comes first changes from one start to the next."""
    folders = {"hwmon": "class/hwmon", "iio": "bus/iio/devices"}
    for number, place in enumerate(("1-0040", "1-0041")):
        there = root / "devices" / place / f"{kind}{number + 7}"
        there.mkdir(parents=True)
        (there / "name").write_text("ina2xx")
        (there / "power1").write_text(f"{number}")
        if kind == "hwmon":
            (there / "device").symlink_to("..")
        (root / folders[kind] / there.name).symlink_to(there)

    sensor = SysfsSensor(device=f"{kind}:ina2xx", value="power1")
    with pytest.raises(DeviceFaultError, match=f"say {kind}:1-0040 or {kind}:1-0041"):
        sensor.open()
    for number, place in enumerate(("1-0040", "1-0041")):
        sensor = SysfsSensor(device=f"{kind}:{place}", value="power1")
        sensor.open()
        assert sensor.read() == pytest.approx(number * (1e-6 if kind == "hwmon" else 1))


@pytest.mark.parametrize("value", ["temp1", "temp1_input"])
def test_a_value_that_the_chip_calls_faulty_is_a_fault(root, value) -> None:
    """Its diode is off, say: the number beside that flag is none."""
    sensor = SysfsSensor(device="hwmon:cpu_thermal", value=value)
    flag = root / "class/hwmon/hwmon0/temp1_fault"
    flag.write_text("0")
    sensor.open()
    flag.write_text("1")

    with pytest.raises(DeviceFaultError, match="says temp1_fault"):
        sensor.read()


def test_an_led_is_set_and_its_trigger_ends(root) -> None:
    """The card reader would go on to blink with it."""
    led = SysfsActuator(device="led:green")
    led.open()

    assert led.write(0.5) == pytest.approx(128 / 255)
    assert (root / "class/leds/green/brightness").read_text() == "128"
    assert (root / "class/leds/green/trigger").read_text() == "none"


def test_rounding_goes_beyond_no_limit(root) -> None:
    """An LED that is on or off, and may be no brighter than 0.6, is off."""
    (root / "class/leds/green/max_brightness").write_text("1")
    led = SysfsActuator(device="led:green", limits=(0.0, 0.6))
    led.open()

    assert led.write(0.6) == 0.0
    assert (root / "class/leds/green/brightness").read_text() == "0"


def test_an_led_without_any_brightness_is_a_fault(root) -> None:
    """Nothing that it could be told is 0 to 1."""
    (root / "class/leds/green/max_brightness").write_text("0")
    with pytest.raises(DeviceFaultError, match="led:green has no brightness"):
        SysfsActuator(device="led:green").open()


def test_a_pwm_channel_begins_with_nothing(root) -> None:
    """Its duty is 0 before it is switched on."""
    fan = SysfsActuator(device="pwm:pwmchip0/1", period=0.00004)
    fan.open()
    channel = root / "class/pwm/pwmchip0/pwm1"
    assert [(channel / f).read_text() for f in ("period", "duty_cycle", "enable")] == [
        *("40000", "0", "1")
    ]

    fan.write(0.25)

    assert (channel / "duty_cycle").read_text() == "10000"


def test_a_pwm_channel_that_was_left_inverted_is_left_alone(root) -> None:
    """Nothing would be full speed: it is for whoever knows how it is wired to say so."""
    channel = root / "class/pwm/pwmchip0/pwm1"
    (channel / "polarity").write_text("inversed\n")
    with pytest.raises(DeviceFaultError, match="polarity is inversed: say inverted"):
        SysfsActuator(device="pwm:pwmchip0/1").open()
    assert (channel / "enable").read_text() == "0"
    fan = SysfsActuator(device="pwm:pwmchip0/1", inverted=True)
    fan.open()
    assert (channel / "enable").read_text() == "1"


def test_a_pwm_channel_is_inverted_while_it_is_off(root, monkeypatch) -> None:
    """The kernel refuses it of one that is on, as it was left."""
    channel, write = root / "class/pwm/pwmchip0/pwm1", Path.write_text
    (channel / "polarity").write_text("normal\n")
    (channel / "enable").write_text("1")

    def kernel(path: Path, text: str, **named: Any) -> int:
        if path.name == "polarity" and (channel / "enable").read_text() == "1":
            raise OSError(errno.EBUSY, "Device or resource busy")
        return write(path, text, **named)

    monkeypatch.setattr(Path, "write_text", kernel)
    SysfsActuator(device="pwm:pwmchip0/1", inverted=True).open()
    told = [(channel / name).read_text() for name in ("polarity", "enable")]
    assert told == ["inversed", "1"]


@pytest.mark.parametrize("inverted", [False, True])
def test_a_pwm_channel_without_a_period_gets_that_first(
    root, monkeypatch, inverted
) -> None:
    """As after a start of the computer: the kernel refuses all else of no period."""
    channel, write = root / "class/pwm/pwmchip0/pwm1", Path.write_text

    def refusing(path: Path, text: str, **options: Any) -> int:
        if path.name != "period" and (channel / "period").read_text() == "0":
            raise OSError(errno.EINVAL, "Invalid argument")
        return write(path, text, **options)

    monkeypatch.setattr(Path, "write_text", refusing)
    fan = SysfsActuator(device="pwm:pwmchip0/1", period=0.00004, inverted=inverted)
    fan.open()

    assert fan.write(0.25) == 0.25
    assert (channel / "polarity").exists() is inverted


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (
            lambda: SysfsSensor(device="temp1", value="x"),
            "expected one of hwmon, iio, w1",
        ),
        (lambda: SysfsSensor(device="led:green", value="x"), "expected one of hwmon"),
        (lambda: SysfsSensor(device="iio:x", value="../x"), "expected a name such as"),
        (lambda: SysfsActuator(device="pwm:pwmchip0"), "expected pwm:CHIP/CHANNEL"),
        (lambda: SysfsActuator(device="led:green/1"), "expected pwm:CHIP/CHANNEL"),
        (lambda: SysfsActuator(device="led:a", inverted=True), "has no polarity"),
        (lambda: SysfsActuator(device="pwm:a/1", period=0.0), "expected seconds"),
        (lambda: SysfsActuator(device="led:a", limits=(0.0, 1.5)), "from 0 to 1"),
        (lambda: SysfsActuator(device="led:a", limits=(-0.5, 1.0)), "from 0 to 1"),
    ],
)
def test_its_mistakes_are_named(made, says) -> None:
    """Before anything is opened."""
    with pytest.raises(ConfigError, match=says):
        made()


class OnFolder:
    """A part whose folder goes and comes."""

    folder: str
    keeps_nothing = "each value is written or read whole"

    def place(self) -> Path:
        return SysfsSensor.root / self.folder

    async def silence(self, _device: Any) -> None:
        self.place().rename(SysfsSensor.root / "away")

    unplug = silence

    async def speak(self, _device: Any) -> None:
        (SysfsSensor.root / "away").rename(self.place())

    async def power_cycle(self, _device: Any) -> None:
        """Nothing is kept in it."""


class TestThermometer(OnFolder, SensorContract):
    folder = "bus/w1/devices/28-0316a2795dff"

    def make(self) -> Any:
        return SysfsSensor(device="w1:28-0316a2795dff", value="temperature")


class TestLed(OnFolder, ActuatorContract):
    folder = "class/leds/green"

    def make(self) -> Any:
        return SysfsActuator(device="led:green")

    def commands(self) -> list[Any]:
        return [1.0, 0.2]
