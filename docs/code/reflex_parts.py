"""A plain sensor and a plain actuator, for a computer and for a microcontroller."""

from esair.minimal import Actuator, Sensor


class Battery(Sensor):
    """The voltage of the battery, in volts."""

    def open(self) -> None:
        from machine import ADC, Pin  # where there is one: it is made on any computer

        self._adc = ADC(Pin(26))

    def read(self) -> float:
        return float(self._adc.read_u16() * 3.3 * 3 / 65535)  # behind a divider by 3


class Lamp(Actuator):
    """A lamp on a pin."""

    safe = False
    command_timeout = 0.5

    def open(self) -> None:
        from machine import Pin

        self._pin = Pin(25, Pin.OUT, value=0)

    def write(self, command: bool) -> None:
        self._pin(1 if command else 0)
