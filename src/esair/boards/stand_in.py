"""A stand-in for ``machine``: pins, PWM, ADC, I2C and UART that a test drives.

It runs on CPython and on MicroPython builds without pins::

    sys.modules["machine"] = stand_in
    stand_in.inputs[17] = 0
    ...
    assert stand_in.outputs[3] == [1, 0]
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

inputs: "dict[Any, Any]" = {}
"""The level of each input pin; that of its pull unless set."""

outputs: "dict[Any, Any]" = {}
"""Every level, or pulse in nanoseconds, that was put on a pin, in order."""

analog: "dict[Any, Any]" = {}
"""The raw value, 0 to 65535, on each analog pin."""

echoes: "dict[Any, Any]" = {}
"""What `time_pulse_us` answers for each pin, in microseconds."""

chips: "dict[Any, Any]" = {}
"""The registers of each I2C part: address to register to byte."""

used: "dict[Any, Any]" = {}
"""The pins that were used, and whether they are driven."""

owners: "dict[Any, Any]" = {}
"""Whose each of them is: the `owner` at the time, each once; a bus has many."""

owner: "list[str]" = [""]
"""Who uses the pins that are made now."""

received: "dict[Any, Any]" = {}
"""The bytes that wait at each serial port."""

handlers: "dict[Any, Any]" = {}
"""Who is called back for each pin, and the pin."""


def turn(a: int, b: int, edges: int) -> None:
    """Turn a quadrature encoder on two pins by so many edges."""
    states = ((0, 0), (1, 0), (1, 1), (0, 1))
    at = states.index((inputs.setdefault(a, 0), inputs.setdefault(b, 0)))
    for _ in range(abs(edges)):
        at = (at + (1 if edges > 0 else -1)) % 4
        for number, level in ((a, states[at][0]), (b, states[at][1])):
            if inputs[number] != level:
                inputs[number] = level
                handler, pin = handlers.get(number, (None, None))
                if handler is not None:
                    handler(pin)


class Pin:
    """A pin; called, or by `value`, it gives or takes a level."""

    IN = 0
    OUT = 1
    PULL_UP = 1
    PULL_DOWN = 2
    IRQ_FALLING = 4
    IRQ_RISING = 8

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
        if owner[0] not in owners.setdefault(number, []):
            owners[number].append(owner[0])
        if value is not None:
            self.value(value)

    def value(self, level: "int | None" = None) -> "int | None":
        """Take a level, or give the one that the world puts on the pin."""
        if level is None:
            return int(inputs.get(self.number, self.idle))
        outputs.setdefault(self.number, []).append(level)
        return None

    __call__ = value

    def irq(self, handler: "Any" = None, trigger: int = 12) -> None:
        """Call back when `turn` moves the pin."""
        handlers[self.number] = (handler, self)


class HardwareEncoder:
    """The ``Encoder`` of a board that has one: ``stand_in.Encoder = HardwareEncoder``."""

    def __init__(self, unit: int, a: Pin, b: Pin, phases: int = 1) -> None:
        if phases != 4:
            raise ValueError("phases")
        self.count: int = 0
        self._pins = (a, b)
        self._last = (a.value(), b.value())
        for each in self._pins:
            each.irq(self._edge)

    def _edge(self, pin: Pin) -> None:
        """Count one, forwards if the first track now differs from the second before."""
        now = (self._pins[0].value(), self._pins[1].value())
        self.count += 1 if now[0] != self._last[1] else -1
        self._last = now

    def value(self) -> int:
        """Give the count."""
        return self.count

    def deinit(self) -> None:
        """Count no more, nor tell."""
        del self.count
        for each in self._pins:
            each.irq(None)


class PWM:
    """Pulses on a pin."""

    def __init__(
        self,
        pin: Pin,
        freq: int = 0,
        duty_ns: "int | None" = None,
        duty_u16: "int | None" = None,
    ) -> None:
        self.number: int | str = pin.number
        used[pin.number] = True
        if duty_ns is not None:
            self.duty_ns(duty_ns)
        if duty_u16 is not None:
            self.duty_u16(duty_u16)

    def freq(self, hertz: int) -> None:
        """Take any frequency."""

    def duty_ns(self, width: int) -> None:
        """Take note of the width of the pulses."""
        outputs.setdefault(self.number, []).append(width)

    def duty_u16(self, share: int) -> None:
        """Take note of the share of the time that the pin is high, of 65535."""
        outputs.setdefault(self.number, []).append(share)

    def deinit(self) -> None:
        """Stop the pulses."""
        self.duty_ns(0)


class ADC:
    """An analog input."""

    def __init__(self, pin: Pin) -> None:
        self.number: int | str = pin.number

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
        for each in (scl, sda):
            if each is not None:
                owners[each.number][:] = ["bus"]  # its parts share it

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        """Write to registers."""
        chip = self._chip(address)
        for i, byte in enumerate(data):
            chip[register + i] = byte

    def readfrom_mem(self, address: int, register: int, count: int) -> bytes:
        """Read registers."""
        found = bytearray(count)
        self.readfrom_mem_into(address, register, found)
        return bytes(found)

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


class UART:
    """A serial port: what `received` has for it is what has come."""

    def __init__(
        self, number: int, baudrate: int = 9600, timeout: int = 0, **pins: Pin
    ) -> None:
        self.number = number

    def any(self) -> int:
        """Give the number of bytes that wait."""
        return len(received.get(self.number, b""))

    def read(self, count: int) -> "bytes | None":
        """Give bytes, or None."""
        data = received.get(self.number, b"")
        received[self.number] = data[count:]
        return data[:count] or None

    def deinit(self) -> None:
        """Let the port go."""


PWRON_RESET = 1
HARD_RESET = 2
WDT_RESET = 3
DEEPSLEEP_RESET = 4
SOFT_RESET = 5

cause = PWRON_RESET
"""What `reset_cause` answers."""

fed: "list[Any]" = []
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


def streams() -> "tuple[Any, ...]":
    """Give what a `Line` works with where it is no board that it runs on."""
    import select
    import sys

    poll = select.poll()
    try:
        poll.register(sys.stdin, select.POLLIN)
        came: Any = poll.poll
    except (OSError, ValueError):  # it is none that can be waited for
        came = lambda _ms: ()  # noqa: E731

    def write(data: bytearray, at: int, count: int) -> None:
        sys.stdout.write(data[at : at + count].decode("utf-8", "replace"))

    def read(into: bytearray) -> int:
        found = sys.stdin.buffer.read(1)
        into[: len(found)] = found
        return len(found)

    return came, read, lambda _ms: (1,), write


def time_pulse_us(pin: Pin, level: int, timeout_us: int) -> int:
    """Give the length of a pulse; -1 if it does not end, -2 if it does not begin."""
    us = int(echoes.get(pin.number, -2))
    return -1 if us > timeout_us else us
