"""A quadrature encoder: how far a wheel has turned, and in which direction."""

from esair.minimal import Sensor

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

# The step from one state of the two pins to the next; two at once were missed: 0.
_STEPS = (0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0)


class QuadratureEncoder(Sensor):
    """Counts the edges of two tracks that are a quarter of a period apart.

    An ESP32 counts in hardware (PCNT); elsewhere each edge is an interrupt, some 20,000
    of them a second at most on an RP2040.

    Args:
        a: The pin of the first track.
        b: The pin of the second; forwards, the first leads.
        per_count: What one of the four edges of a period stands for, such as metres.
        unit: Which of the ESP32's counters is used.
        name: The name of the sensor.
    """

    def __init__(
        self,
        a: "int | str",
        b: "int | str",
        per_count: float = 1,
        unit: int = 0,
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        self.pins = (a, b)
        self.per_count = per_count
        self.unit = unit
        self.counts = 0
        self._state = 0
        self._counter: Any = None

    def open(self) -> None:
        """Begin to count, at zero."""
        from machine import Pin

        self.counts = 0
        self._a, self._b = [Pin(each, Pin.IN, Pin.PULL_UP) for each in self.pins]
        try:
            from machine import Encoder
        except ImportError:
            self._state = self._a.value() << 1 | self._b.value()
            for each in (self._a, self._b):
                each.irq(self._edge, Pin.IRQ_RISING | Pin.IRQ_FALLING)
        else:
            self._counter = Encoder(self.unit, self._a, self._b, phases=4)

    def close(self) -> None:
        """Count no more."""
        if self._counter is not None:
            self._counter.deinit()
        else:
            for each in (self._a, self._b):
                each.irq(None)

    def read(self) -> float:
        """Return how far it has turned since it was opened."""
        if self._counter is not None:
            return int(self._counter.value()) * self.per_count
        return self.counts * self.per_count

    def _edge(self, pin: "Any") -> None:
        """Take one edge, in an interrupt: nothing is allocated."""
        state = self._a.value() << 1 | self._b.value()
        self.counts += _STEPS[self._state << 2 | state]
        self._state = state
