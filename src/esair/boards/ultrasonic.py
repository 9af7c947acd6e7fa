"""An ultrasonic range finder with a trigger and an echo pin, such as the HC-SR04."""

from esair.minimal import Sensor


class UltrasonicRange(Sensor):
    """The way to the next thing, in metres.

    Reading blocks until the echo is back: 6 ms for a metre, at most the time for
    ``reach``. No echo is no error: it gives ``reach``, as nothing is nearer. Then the
    part holds its echo pin for 40 ms and more, in which it cannot measure: read it
    20 times a second at most.

    Args:
        trigger: The pin that starts a measurement.
        echo: The pin that is high as long as the sound is under way. It gives 5 V: a
            board for 3.3 V needs a divider.
        reach: How far it looks, in metres: the most that it gives.
        name: The name of the sensor.
    """

    SPEED = 343.0
    """Of sound at 20 degrees Celsius, in m/s."""

    def __init__(
        self,
        trigger: "int | str",
        echo: "int | str",
        reach: float = 4.0,
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        self.trigger = trigger
        self.echo = echo
        self.reach: float = float(reach)
        self.timeout_us: int = int(2 * reach / self.SPEED * 1000000)
        self._silent = False

    def open(self) -> None:
        """Take the pins."""
        import time

        import machine

        self._trigger = machine.Pin(self.trigger, machine.Pin.OUT, value=0)
        self._echo = machine.Pin(self.echo, machine.Pin.IN)
        self._pulse = machine.time_pulse_us
        # A computer has none; beside a stand-in for the pins nobody has to wait.
        self._sleep_us = getattr(time, "sleep_us", None) or (lambda us: None)

    def read(self) -> float:
        """Measure once.

        Raises:
            OSError: The part does not answer, or its echo pin is stuck.
        """
        if self._echo():  # what is left of an old pulse would be taken for a short one
            if not self._silent:
                raise OSError("the echo pin is high: is it stuck, or read too often?")
            self._silent = False
            return self.reach
        self._trigger(1)
        self._sleep_us(10)
        self._trigger(0)
        us = self._pulse(self._echo, 1, self.timeout_us)
        if us == -2:
            raise OSError("no echo pulse began: is it connected?")
        self._silent = us < 0
        return self.reach if us < 0 else us * self.SPEED / 2000000
