"""An analog input: a battery through a divider, a potentiometer, a distance sensor."""

from esair.minimal import Sensor


class AnalogIn(Sensor):
    """The voltage on a pin, times a factor.

    Args:
        pin: Its number, or whatever the board calls it.
        reference: The voltage that reads as full scale, in volts.
        factor: What a volt on the pin stands for, such as 3.0 behind a divider by 3.
        name: The name of the sensor.
    """

    def __init__(
        self,
        pin: "int | str",
        reference: float = 3.3,
        factor: float = 1.0,
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        self.pin = pin
        self.scale: float = reference * factor / 65535

    def open(self) -> None:
        """Make the pin an analog input."""
        from machine import ADC, Pin

        self._read = ADC(Pin(self.pin)).read_u16

    def read(self) -> float:
        """Return the voltage times the factor."""
        return float(self._read() * self.scale)
