"""Digital pins: a switch or another two-level sensor, a lamp, relay or driver input."""

from esair.minimal import Actuator, Sensor


class DigitalIn(Sensor):
    """A pin that is read: True for high, or for low if it is inverted.

    Args:
        pin: Its number, or whatever the board calls it.
        pull: ``"up"``, ``"down"``, or nothing for a pin that is driven both ways.
        inverted: Give True for low, as of a switch to ground.
        name: The name of the sensor.
    """

    def __init__(
        self,
        pin: "int | str",
        pull: str = "",
        inverted: bool = False,
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        if pull not in ("", "up", "down"):
            raise ValueError("pull: expected 'up', 'down' or ''")
        self.pin = pin
        self.pull = pull
        self.inverted = inverted

    def open(self) -> None:
        """Make the pin an input."""
        from machine import Pin

        # By its name: some boards have no pull-down.
        pull = getattr(Pin, "PULL_" + self.pull.upper()) if self.pull else None
        self._value = Pin(self.pin, Pin.IN, pull).value

    def read(self) -> bool:
        """Return whether it is high (low if inverted)."""
        return (not self._value()) if self.inverted else bool(self._value())


class DigitalOut(Actuator):
    """A pin that is driven: True for high, or for low if it is inverted.

    Args:
        pin: Its number, or whatever the board calls it.
        inverted: Drive it low for True.
        safe: What the pin is told when nobody says anything else.
        name: The name of the actuator.
    """

    safe: bool = False

    def __init__(
        self,
        pin: "int | str",
        inverted: bool = False,
        safe: bool = False,
        name: "str | None" = None,
    ) -> None:
        Actuator.__init__(self, name)
        self.pin = pin
        self.inverted = inverted
        self.safe = safe

    def open(self) -> None:
        """Make the pin an output, with its safe level from the first moment."""
        from machine import Pin

        level = int(self.safe != self.inverted)
        self._value = Pin(self.pin, Pin.OUT, value=level).value

    def write(self, command: bool) -> None:
        """Drive the pin."""
        self._value(1 if command != self.inverted else 0)
