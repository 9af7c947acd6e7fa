"""What the kernel itself measures and drives: IIO, hwmon, 1-Wire, LEDs and PWM in sysfs.

A part is named by what the kernel calls it, not by a number that changes with the order in
which things were found; a value is in plain units (degrees Celsius, volts, amperes, watts,
percent of humidity, metres a second squared), but a pressure is in kPa, as the kernel has
it::

    [sensor.chip]
    driver = "sysfs"
    device = "hwmon:cpu_thermal"
    value = "temp1"

    [sensor.pressure]
    driver = "sysfs"
    device = "iio:bmp280"
    value = "in_pressure"

    [sensor.water]
    driver = "sysfs"
    device = "w1:28-0316a2795dff"
    value = "temperature"

    [actuator.fan]
    driver = "sysfs"
    device = "pwm:0.pwm/1"
    period = 0.00004
    safe = 0.0

    [actuator.lamp]
    driver = "sysfs"
    device = "led:green"
    safe = 0.0

Source: Documentation/ABI/testing of Linux: sysfs-bus-iio, sysfs-class-hwmon,
sysfs-driver-w1_therm, sysfs-class-led, sysfs-class-pwm.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Final, Unpack

from esair.drivers._on_bus import in_units
from esair.exceptions import ConfigError, DeviceFaultError, DeviceLostError
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
)

__all__ = ["SysfsActuator", "SysfsSensor"]

_FOLDERS: Final = {
    "hwmon": "class/hwmon",
    "iio": "bus/iio/devices",
    "led": "class/leds",
    "pwm": "class/pwm",
    "w1": "bus/w1/devices",
}
_SCALES: Final = {
    "hwmon": {
        **dict.fromkeys(("temp", "in", "curr", "humidity"), 1e-3),
        **dict.fromkeys(("power", "energy"), 1e-6),
    },
    "iio": dict.fromkeys(
        ("in_temp", "in_voltage", "in_current", "in_power", "in_humidityrelative"), 1e-3
    ),
    "w1": {"temperature": 1e-3},
}
"""What the kernel's numbers are multiplied with, by how their names begin."""

_WHAT: Final = {
    "hwmon": r"([a-z]+)\d*(?!.*_(?:alarm|beep|enable|fault|interval|type)$)",
    "iio": r"(in_[a-z]+)",
    "w1": r"([a-z]+)",
}
"""How a name begins that is of a value, or of a bound or an average of it."""


_UNMEASURED: Final = 85_000.0
"""What a thermometer on 1-Wire tells after power-up, until it has measured, in m°C."""

_STEP: Final = 5_000.0
"""How far a temperature may go from one reading to the next to be believed there, in m°C."""


class _OnSysfs(Resource):
    """A folder of sysfs, found by its name at each opening."""

    place: str

    kind: str

    root: ClassVar[Path] = Path("/sys")
    kinds: ClassVar[tuple[str, ...]]

    def __init__(self, *, device: str, **settings: Unpack[SensorSettings]) -> None:
        super().__init__(**settings)
        self.kind, colon, self.place = device.partition(":")
        if not (colon and self.place and self.kind in self.kinds):
            raise ConfigError(
                self.name,
                "device",
                f"expected one of {', '.join(self.kinds)}, a colon and a name, "
                f"such as {self.kinds[0]}:NAME, not {device!r:.80}",
            )
        self.device = device
        self.folder: Path | None = None

    def _find(self, name: str) -> Path:
        there = {folder: _text(folder / "name") for folder in self._folders()}
        found = [
            folder
            for folder, told in there.items()
            if name in {folder.name, told, _device_of(folder)}
        ]
        if len(found) == 1:
            return found[0].resolve()  # another part may have its number later
        if found:
            told = " or ".join(f"{self.kind}:{_device_of(each)}" for each in found)
            raise DeviceFaultError(
                self.name, f"the kernel has several {self.kind} {name!r}: say {told}"
            )
        known = sorted({told or folder.name for folder, told in there.items()})
        raise DeviceLostError(
            self.name,
            f"the kernel has no {self.kind} {name!r}; it has "
            + (", ".join(known) or "none at all"),
        )

    def _folders(self) -> Iterator[Path]:
        try:
            yield from sorted((self.root / _FOLDERS[self.kind]).iterdir())
        except FileNotFoundError:
            return

    def _read(self, path: Path) -> float:
        text = path.read_text(encoding="ascii").strip()
        try:
            return float(text)
        except ValueError:
            raise DeviceFaultError(
                self.name, f"{path.name} is {text!r:.40}, which is no number"
            ) from None

    def close(self) -> None:
        """Forget where it was."""
        self.folder = None


class SysfsSensor(_OnSysfs, Sensor[float]):
    """A value that the kernel measures.

    A thermometer on 1-Wire tells 85 °C after power-up, until it has measured: that is a
    temperature only if the one before was above 80 °C.

    Args:
        device: ``hwmon:NAME``, ``iio:NAME`` or ``w1:NAME``, by the name that the kernel
            gives the part, or by that of its folder; by that of its place, such as
            ``hwmon:1-0040``, if there are several of that name.
        value: What of it, without ``_input`` or ``_raw``: ``"temp1"``, ``"in_pressure"``.
        factor: What the value is multiplied with, beside the kernel's own scale.
        limits: Least and greatest value; what is outside is a fault of the device.
    """

    folder: Path

    kinds: ClassVar[tuple[str, ...]] = "hwmon", "iio", "w1"

    def __init__(
        self,
        *,
        device: str,
        value: str,
        factor: float = 1.0,
        limits: tuple[float, float] | None = None,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(device=device, **settings)
        if not re.fullmatch(r"[\w-]+", value):
            told = f"expected a name such as 'temp1', not {value!r:.40}"
            raise ConfigError(self.name, "value", told)
        self.value = value
        self.factor = factor
        if limits is not None:
            self.limits: tuple[float, float] = limits
        self._stem = stem = value.removesuffix("_input").removesuffix("_raw")
        what = re.match(_WHAT[self.kind], stem)
        self._what = what[1] if what else stem
        """What it is, whichever of several, along which axis: ``in_accel``."""
        self._scale = _SCALES[self.kind].get(self._what, 1.0)
        self._last = math.nan

    def open(self) -> None:
        """Find the part, and read it once."""
        self._last = math.nan
        self.folder = self._find(self.place)
        self.read()

    def read(self) -> float:
        """Return the value in its unit, as the kernel says it now."""
        folder = self.folder
        if folder is None:
            raise DeviceLostError(self.name, "it is not open")
        fault = folder / f"{self._stem}_fault"
        if fault.is_file() and self._read(fault):
            raise DeviceFaultError(self.name, f"{self.device} says {fault.name}")
        for name in (f"{self.value}_input", self.value):
            if (folder / name).is_file():
                number = self._read(folder / name)
                if self.kind == "w1":
                    self._check_measured(number)
                return number * self._scale * self.factor
        raw = folder / f"{self.value}_raw"
        if not raw.is_file():
            if not folder.is_dir():
                raise DeviceLostError(self.name, f"{self.device} is gone")
            raise DeviceFaultError(self.name, f"{self.device} has no {self.value!r}")
        number = self._read(raw) + self._beside("offset", 0.0)
        return number * self._beside("scale", 1.0) * self._scale * self.factor

    def _check_measured(self, number: float) -> None:
        """Refuse 85 °C of a thermometer, unless it was nearly as warm before."""
        if number == _UNMEASURED and not abs(number - self._last) < _STEP:
            told = "it tells 85 °C, as after power-up: it has not measured"
            raise DeviceLostError(self.name, told)
        self._last = number

    def _beside(self, what: str, default: float) -> float:
        """Return what is said of the value alone, else of all values of its kind."""
        assert self.folder is not None
        for stem in (self.value, re.sub(r"\d", "", self.value), self._what):
            path = self.folder / f"{stem}_{what}"
            if path.is_file():
                return self._read(path)
        return default


class SysfsActuator(_OnSysfs, Actuator[float]):
    """An LED or a PWM channel of the kernel: how bright, or how much, from 0 to 1.

    Args:
        device: ``led:NAME``, or ``pwm:CHIP/CHANNEL`` with the chip by the name of its
            device or of its folder (``pwm:pwmchip0/1``).
        safe: The safe command.
        period: The period of a PWM channel, in seconds.
        limits: Narrower limits than 0 to 1.
        inverted: Whether the pin of a PWM channel is low while it is on.
    """

    folder: Path

    kinds: ClassVar[tuple[str, ...]] = "led", "pwm"

    def __init__(
        self,
        *,
        device: str,
        safe: float = 0.0,
        period: float = 0.001,
        limits: tuple[float, float] = (0.0, 1.0),
        inverted: bool = False,
        **settings: Unpack[ActuatorSettings],
    ) -> None:
        super().__init__(device=device, **settings)
        self.safe: float = float(safe)
        self.limits: tuple[float, float] = limits
        numbers = isinstance(limits, tuple | list) and limits
        if not numbers or not all(0.0 <= each <= 1.0 for each in numbers):
            told = f"expected numbers from 0 to 1, not {limits!r:.80}"
            raise ConfigError(self.name, "limits", told)
        self._chip, _, channel = self.place.partition("/")
        if (self.kind == "pwm") != channel.isdecimal():
            told = f"expected pwm:CHIP/CHANNEL or led:NAME, not {device!r}"
            raise ConfigError(self.name, "device", told)
        self._channel = channel
        if inverted and self.kind == "led":
            raise ConfigError(self.name, "inverted", "an LED has no polarity")
        self.period_ns: int = round(period * 1e9)
        if not 0 < self.period_ns < 2**31:
            raise ConfigError(self.name, "period", f"expected seconds, not {period!r}")
        self.inverted = inverted
        self.claim: str = device
        self._file = Path()
        self._most = 0

    def open(self) -> None:
        """Find it; a PWM channel is asked for, set to nothing, and switched on."""
        folder = self.folder = self._find(self._chip)
        if self.kind == "led":
            trigger = folder / "trigger"
            if trigger.is_file():
                trigger.write_text("none", encoding="ascii")
            self._file = folder / "brightness"
            self._most = int(self._read(folder / "max_brightness"))
            if self._most <= 0:
                raise DeviceFaultError(self.name, f"{self.device} has no brightness")
            return
        channel = folder / f"pwm{self._channel}"
        if not channel.is_dir():
            (folder / "export").write_text(self._channel, encoding="ascii")
        is_inverted = _text(polarity := channel / "polarity") == "inversed"
        if is_inverted and not self.inverted:  # another program's
            told = f"{polarity} is inversed: say inverted = true, or write normal to it"
            raise DeviceFaultError(self.name, told)
        # A duty above the new period would be refused, and so would the period; before
        # there is any period, each duty is.
        if self._read(channel / "period"):
            (channel / "duty_cycle").write_text("0", encoding="ascii")
        (channel / "period").write_text(str(self.period_ns), encoding="ascii")
        if self.inverted and not is_inverted:  # refused of what has no period, or is on
            (channel / "enable").write_text("0", encoding="ascii")
            polarity.write_text("inversed", encoding="ascii")
        (channel / "enable").write_text("1", encoding="ascii")
        self._file, self._most = channel / "duty_cycle", self.period_ns

    def write(self, command: float) -> float:
        """Tell how much; returns it as it was rounded."""
        if self.folder is None:
            raise DeviceLostError(self.name, "it is not open")
        steps = in_units(command, 1 / self._most, self.limits)
        self._file.write_text(str(steps), encoding="ascii")
        return steps / self._most


def _device_of(folder: Path) -> str:
    """Return the name of the device whose folder it is, which is by its place."""
    link = folder / "device"
    return (link.resolve() if link.exists() else folder.resolve().parent).name


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
