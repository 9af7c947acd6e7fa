"""A stand-in for ``machine``: pins, PWM, ADC and I2C that a test drives and reads.

It runs on CPython and on MicroPython builds without pins::

    sys.modules["machine"] = stand_in
    stand_in.inputs[17] = 0
    ...
    assert stand_in.outputs[3] == [1, 0]
"""

inputs = {}  # type: ignore[var-annotated]
"""The level of each input pin; that of its pull unless set."""

outputs = {}  # type: ignore[var-annotated]
"""Every level, or pulse in nanoseconds, that was put on a pin, in order."""

analog = {}  # type: ignore[var-annotated]
"""The raw value, 0 to 65535, on each analog pin."""

echoes = {}  # type: ignore[var-annotated]
"""What `time_pulse_us` answers for each pin, in microseconds."""

chips = {}  # type: ignore[var-annotated]
"""The registers of each I2C part: address to register to byte."""

used = {}  # type: ignore[var-annotated]
"""The pins that were used, and whether they are driven."""


class Pin:
    """A pin; called, or by `value`, it gives or takes a level."""

    IN = 0
    OUT = 1
    PULL_UP = 1
    PULL_DOWN = 2

    def __init__(
        self,
        number: "int | str",
        mode: int = 0,
        pull: "int | None" = None,
        value: "int | None" = None,
    ) -> None:
        self.number = number
        self.idle = 1 if pull == self.PULL_UP else 0
        used[number] = bool(used.get(number)) or mode == self.OUT
        if value is not None:
            self.value(value)

    def value(self, level: "int | None" = None) -> "int | None":
        """Take a level, or give the one that the world puts on the pin."""
        if level is None:
            return int(inputs.get(self.number, self.idle))
        outputs.setdefault(self.number, []).append(level)
        return None

    __call__ = value


class PWM:
    """Pulses on a pin."""

    def __init__(self, pin: Pin, freq: int = 0, duty_ns: "int | None" = None) -> None:
        self.number = pin.number
        used[pin.number] = True
        if duty_ns is not None:
            self.duty_ns(duty_ns)

    def freq(self, hertz: int) -> None:
        """Take any frequency."""

    def duty_ns(self, width: int) -> None:
        """Take note of the width of the pulses."""
        outputs.setdefault(self.number, []).append(width)

    def deinit(self) -> None:
        """Stop the pulses."""
        self.duty_ns(0)


class ADC:
    """An analog input."""

    def __init__(self, pin: Pin) -> None:
        self.number = pin.number

    def read_u16(self) -> int:
        """Give the raw value."""
        return int(analog.get(self.number, 0))


class I2C:
    """A bus with the parts of `chips`."""

    def __init__(
        self,
        number: int = 0,
        scl: "Pin | None" = None,
        sda: "Pin | None" = None,
        freq: int = 400000,
    ) -> None:
        self.number = number

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        """Write to registers."""
        chip = self._chip(address)
        for i, byte in enumerate(data):
            chip[register + i] = byte

    def readfrom_mem_into(self, address: int, register: int, buffer: bytearray) -> None:
        """Read registers."""
        chip = self._chip(address)
        for i in range(len(buffer)):
            buffer[i] = chip.get(register + i, 0)

    def _chip(self, address: int) -> "dict[int, int]":
        if address not in chips:
            raise OSError(19)  # ENODEV, as MicroPython says it
        found: dict[int, int] = chips[address]
        return found


PWRON_RESET = 1
HARD_RESET = 2
WDT_RESET = 3
DEEPSLEEP_RESET = 4
SOFT_RESET = 5

cause = PWRON_RESET
"""What `reset_cause` answers."""

fed = []  # type: ignore[var-annotated]
"""The time-out of each watchdog that was made, in milliseconds, then 0 for each feed."""


def reset_cause() -> int:
    """Give the reason why the board has started."""
    return cause


class WDT:
    """A watchdog that never bites."""

    def __init__(self, timeout: int = 5000) -> None:
        fed.append(timeout)

    def feed(self) -> None:
        """Take note that it was fed."""
        fed[1:] = [0]


def time_pulse_us(pin: Pin, level: int, timeout_us: int) -> int:
    """Give the length of a pulse; -1 if it does not end, -2 if it does not begin."""
    us = int(echoes.get(pin.number, -2))
    return -1 if us > timeout_us else us
