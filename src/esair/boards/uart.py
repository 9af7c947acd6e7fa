"""A part on a serial port of the board that sends a line for each reading."""

from esair.minimal import Sensor

LONGEST = 256
"""Bytes of a line; what is longer is thrown away."""


class UartNumbers(Sensor):
    """The numbers of the newest whole line, such as ``1.25,0.5``.

    What comes up to the first line end is no line: its begin may be missing.

    Args:
        uart: The number of the port.
        baudrate: Bits per second.
        separator: What stands between two numbers.
        tx: The pin it sends on; the board's own unless given.
        rx: The pin it receives on.
        name: The name of the sensor.
    """

    def __init__(
        self,
        uart: int = 0,
        baudrate: int = 115200,
        separator: str = ",",
        tx: "int | str | None" = None,
        rx: "int | str | None" = None,
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        self.uart = uart
        self.baudrate = baudrate
        self.separator = separator
        self.tx = tx
        self.rx = rx
        self.waiting: bytes = b""
        self.begun = False  # whether that is the begin of a line

    def open(self) -> None:
        """Take the port."""
        from machine import UART, Pin

        pins = {}
        if self.tx is not None:
            pins["tx"] = Pin(self.tx)
        if self.rx is not None:
            pins["rx"] = Pin(self.rx)
        self._port = UART(self.uart, self.baudrate, timeout=0, **pins)
        self.waiting, self.begun = b"", False

    def close(self) -> None:
        """Let the port go."""
        self._port.deinit()

    def read(self) -> "tuple[float, ...]":
        """Return the numbers of the newest whole line since the last reading.

        Raises:
            OSError: No whole line has come.
            ValueError: It has something else than numbers.
        """
        count = self._port.any()
        if count:
            self.waiting += self._port.read(count) or b""
        lines = self.waiting.split(b"\n")
        self.waiting = lines.pop()
        if lines and not self.begun:
            lines[0], self.begun = b"", True
        if len(self.waiting) > LONGEST:
            self.waiting, self.begun = b"", False
        for line in reversed(lines):
            text = line.strip()
            if text:
                return tuple(
                    [float(each) for each in text.decode().split(self.separator)]
                )
        raise OSError("no line has come")
