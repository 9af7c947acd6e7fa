"""A number in a register of an I2C part: temperature, light, one axis of a gyroscope."""

from esair.boards.i2c_bus import shared_i2c
from esair.minimal import Sensor


class I2CRegister(Sensor):
    """A register that is read as an integer, times a scale.

    Args:
        address: The address of the part, 7 bits.
        register: The number of the register.
        size: Bytes of the number.
        signed: Whether it is a two's complement.
        little: Whether its first byte is the lowest.
        scale: What one step stands for.
        offset: Added after the scale.
        i2c: The number of the bus.
        scl: The pin of its clock; those that the board has for the bus unless given.
        sda: The pin of its data; given if ``scl`` is.
        frequency: The clock of the bus, in Hz.
        setup: Pairs of register and byte that are written when it is opened.
        name: The name of the sensor.
    """

    def __init__(
        self,
        address: int,
        register: int,
        size: int = 2,
        signed: bool = True,
        little: bool = False,
        scale: float = 1.0,
        offset: float = 0.0,
        i2c: int = 0,
        scl: "int | str | None" = None,
        sda: "int | str | None" = None,
        frequency: int = 400000,
        setup: "tuple[tuple[int, int], ...]" = (),
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        if not 0 <= address < 128:
            raise ValueError("address: expected 7 bits")
        if size < 1:
            raise ValueError("size: expected bytes, 1 or more")
        self.address = address
        self.register = register
        self.buffer: bytearray = bytearray(size)
        self.signed = signed
        self.little = little
        self.scale = scale
        self.offset = offset
        self.i2c = i2c
        self.scl = scl
        self.sda = sda
        self.frequency = frequency
        self.setup = setup
        self.one: bytearray = bytearray(1)

    def open(self) -> None:
        """Take the bus, and set the part up.

        Raises:
            OSError: It does not answer.
        """
        bus = shared_i2c(self.i2c, self.scl, self.sda, self.frequency)
        for register, value in self.setup:
            bus.writeto_mem(self.address, register, bytes([value]))
        self._read = bus.readfrom_mem_into
        # A register that says something else at once tells nothing about its supply.
        self.kept: list[tuple[int, int]] = [
            each for each in self.setup if self._at(each[0]) == each[1]
        ]

    def is_set_up(self) -> bool:
        """Tell whether its set-up is still there: not after its supply has failed.

        Raises:
            OSError: The part does not answer.
        """
        return all(self._at(register) == value for register, value in self.kept)

    def _at(self, register: int) -> int:
        self._read(self.address, register, self.one)
        return self.one[0]

    def read(self) -> float:
        """Return the number in its unit.

        Raises:
            OSError: The part does not answer.
        """
        buffer = self.buffer
        self._read(self.address, self.register, buffer)
        number = 0
        for i in range(len(buffer)):
            number = number << 8 | buffer[-1 - i if self.little else i]
        if self.signed and number >> (8 * len(buffer) - 1):
            number -= 1 << (8 * len(buffer))
        return number * self.scale + self.offset
