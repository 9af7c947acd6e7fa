"""An MPU-6050: how the robot is accelerated, and how quickly it turns."""

from esair.boards.i2c_bus import shared_i2c
from esair.minimal import Sensor

_WHO_AM_I, _POWER, _ACCELERATION = 0x75, 0x6B, 0x3B
_GYRO_RANGE, _ACCELERATION_RANGE = 0x1B, 0x1C
_KNOWN = (0x68, 0x70, 0x71, 0x72, 0x98)  # MPU-6050 and what is built like it


class Imu(Sensor):
    """Six numbers: m/s² along x, y, z, then rad/s around x, y, z, as the chip is marked.

    Ranges are 4 g and 500 degrees per second. Its supply may fail: it is asked once a
    second whether its ranges are still there, and set up again.

    Args:
        address: Its address.
        i2c: The number of the bus, which it shares with other parts.
        scl: The pins of the bus; the board's own unless given.
        sda: The same.
        frequency: Bits per second.
        name: The name of the sensor.
    """

    def __init__(
        self,
        address: int = 0x68,
        i2c: int = 0,
        scl: "int | str | None" = None,
        sda: "int | str | None" = None,
        frequency: int = 400000,
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        self.address = address
        self.i2c = i2c
        self.scl = scl
        self.sda = sda
        self.frequency = frequency
        self.buffer: bytearray = bytearray(14)

    def open(self) -> None:
        """Wake it up and set its ranges.

        Raises:
            OSError: It does not answer, or is another part.
        """
        self._bus = shared_i2c(self.i2c, self.scl, self.sda, self.frequency)
        chip = self._register(_WHO_AM_I)
        if chip not in _KNOWN:
            raise OSError("it is no MPU-6050: it says " + str(chip))
        for register, value in (
            (_POWER, 0x01),  # awake, with the gyroscope's clock
            (_GYRO_RANGE, 0x08),
            (_ACCELERATION_RANGE, 0x08),
        ):
            self._bus.writeto_mem(self.address, register, bytes([value]))

    def is_set_up(self) -> bool:
        """Tell whether its ranges are as they were set."""
        return self._register(_GYRO_RANGE) == 0x08 and self._register(_POWER) == 0x01

    def read(self) -> "tuple[float, ...]":
        """Return the six numbers.

        Raises:
            OSError: It does not answer.
        """
        buffer = self.buffer
        self._bus.readfrom_mem_into(self.address, _ACCELERATION, buffer)
        found = []
        for i in (0, 2, 4, 8, 10, 12):  # 6 is its temperature
            number = buffer[i] << 8 | buffer[i + 1]
            if number > 32767:
                number -= 65536
            found.append(number * (9.80665 / 8192 if i < 6 else 0.0174532925 / 65.5))
        return tuple(found)

    def _register(self, register: int) -> int:
        return int(self._bus.readfrom_mem(self.address, register, 1)[0])
