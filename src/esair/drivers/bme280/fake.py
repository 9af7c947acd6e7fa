"""A BME280, as its registers look from the bus."""

from __future__ import annotations

from collections.abc import Callable

from esair.buses.i2c import Registers
from esair.drivers import bme280
from esair.drivers.bme280 import Calibration, Climate

INDOORS = Climate(temperature=21.0, humidity=0.45, pressure=101325.0)
"""What the chip feels unless it is told otherwise."""

CALIBRATION = Calibration(
    (27504, 26435, -1000),
    (36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000),
    (75, 362, 0, 315, 50, 30),
)
"""Temperature and pressure from the data sheet of the BMP280, section 3.12."""

_RESET = 0xE0


class FakeBme280(Registers):
    """The register map: asleep after power-up, with nothing measured.

    Args:
        climate: What it feels.
        calibration: What its maker has measured of it.

    Attributes:
        climate: What it feels; measured when it is told to.
        raw: Pressure, temperature and humidity as raw numbers, if they are to be
            these; None for what the climate gives.
        busy: How often it says that it is still measuring.
        measurements: How often it has measured.
    """

    def __init__(
        self, climate: Climate = INDOORS, calibration: Calibration = CALIBRATION
    ) -> None:
        self.climate = climate
        self.calibration = calibration
        self.raw: tuple[int, int, int] | None = None
        self.busy = 1
        self.measurements: int = 0
        first, second = calibration.encode()
        super().__init__(
            {
                bme280.ID: bme280.IDENTITY,
                bme280.CALIBRATION_00: first,
                bme280.CALIBRATION_26: second,
            }
        )
        self.power_cycle()

    def power_cycle(self) -> None:
        """Lose the power for a moment: it is as after power-up."""
        super().power_cycle()
        self._samples_humidity = False
        self._busy = 0
        self._show(bme280.SKIPPED, bme280.SKIPPED, bme280.SKIPPED_HUMIDITY)

    def read(self, register: int, length: int) -> bytes:
        """Return registers that follow one another."""
        if register <= bme280.STATUS < register + length:
            self.content[bme280.STATUS] = bme280.MEASURING if self._busy > 0 else 0
            self._busy -= 1
        return super().read(register, length)

    def write(self, register: int, data: bytes) -> None:
        """Set one register; more come as pairs of register and value."""
        self.set(register, data[0])
        for number, value in zip(data[1::2], data[2::2], strict=True):
            self.set(number, value)

    def set(self, register: int, value: int) -> None:
        """Set one register, and do what it tells."""
        if register == _RESET and value == 0xB6:
            self.power_cycle()
        elif register in {bme280.CTRL_HUM, bme280.CONFIG}:
            self.content[register] = value
        elif register == bme280.CTRL_MEAS:
            # What was written to CTRL_HUM counts from here on.
            self._samples_humidity = bool(self.content[bme280.CTRL_HUM] & 7)
            self.content[register] = value
            if value & 3:
                self._measure(bool(value >> 5), bool(value >> 2 & 7))
                if value & 3 != 3:
                    self.content[register] = value & ~3

    def _measure(self, temperature: bool, pressure: bool) -> None:
        self.measurements += 1
        self._busy = self.busy
        p, t, h = self.raw or self._raw_of(self.climate)
        self._show(
            p if pressure else bme280.SKIPPED,
            t if temperature else bme280.SKIPPED,
            h if self._samples_humidity else bme280.SKIPPED_HUMIDITY,
        )

    def _show(self, pressure: int, temperature: int, humidity: int) -> None:
        raw = pressure << 4, temperature << 4
        words = b"".join(each.to_bytes(3, "big") for each in raw)
        self.fill({bme280.DATA: words + humidity.to_bytes(2, "big")})

    def _raw_of(self, climate: Climate) -> tuple[int, int, int]:
        known = self.calibration
        wanted, pressure, humidity = (
            climate.temperature,
            climate.pressure,
            climate.humidity,
        )
        t = _first(
            1 << 20, lambda raw: bme280.fine_temperature(raw, known) >= wanted * 5120
        )
        fine = bme280.fine_temperature(t, known)
        p = _first(
            1 << 20, lambda raw: bme280.pressure_of(raw, fine, known) <= pressure
        )
        h = _first(
            1 << 16, lambda raw: bme280.humidity_of(raw, fine, known) >= humidity
        )
        return p, t, h


def _first(end: int, reached: Callable[[int], bool]) -> int:
    """Return the first number for which something is reached, by halving."""
    low, high = 0, end - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if reached(middle) else (middle + 1, high)
    return low
