"""A quadrature encoder: how far a wheel has turned, and in which direction."""

from esair.minimal import Sensor

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

# The step from one state of the two pins to the next; two at once were missed: 0.
_STEPS = (0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0)

_units: "set[int]" = set()  # that count for an encoder


class QuadratureEncoder(Sensor):
    """Counts the edges of two tracks that are a quarter of a period apart.

    What the board has, counts: its own counters where MicroPython has `machine.Encoder`
    (the PCNT of an ESP32, an i.MX RT), a PIO state machine on RP2040 and RP2350. On others,
    such as an ESP32-C3, each edge is an interrupt: what comes while one waits is lost.

    Args:
        a: The pin of the first track.
        b: The pin of the second; forwards, the first leads.
        per_count: What one of the four edges of a period stands for, such as metres.
        unit: Which counter or state machine is used; unless given, the first that no
            other encoder uses.
        name: The name of the sensor.
    """

    def __init__(
        self,
        a: "int | str",
        b: "int | str",
        per_count: float = 1,
        unit: "int | None" = None,
        name: "str | None" = None,
    ) -> None:
        Sensor.__init__(self, name)
        self.pins: tuple[int | str, int | str] = (a, b)
        self.per_count = per_count
        self.unit = unit
        self.counts: int = 0
        self._used = 0
        self._counter: Any = None

    def open(self) -> None:
        """Begin to count, at zero.

        Raises:
            ValueError: Another encoder has its unit.
        """
        from machine import Pin

        if self.unit in _units:
            raise ValueError(
                "unit: " + str(self.unit) + " counts for another encoder; leave it out"
            )
        self._used = self.unit or 0
        while self.unit is None and self._used in _units:
            self._used += 1
        a, b = [Pin(each, Pin.IN, Pin.PULL_UP) for each in self.pins]
        self._counter = _counter(self._used, a, b)
        _units.add(self._used)
        self.counts = 0

    def close(self) -> None:
        """Count no more."""
        if self._counter is not None:
            self.read()
            self._counter.deinit()
            self._counter = None
            _units.discard(self._used)

    def read(self) -> float:
        """Return how far it has turned since it was opened."""
        if self._counter is not None:
            self.counts = int(self._counter.value())
        return self.counts * self.per_count


def _counter(unit: int, a: "Any", b: "Any") -> "Any":
    """Return the best counter that the board has."""
    try:
        from machine import Encoder

        return Encoder(unit, a, b, phases=4)
    except ImportError:
        pass
    try:
        import rp2  # noqa: F401 - boards without it do not compile the program
    except ImportError:
        return _PinCounter(a, b)
    from esair.boards._encoder_pio import PioCounter

    return PioCounter(unit, a, b)


class _PinCounter:
    """Counts in interrupts."""

    def __init__(self, a: "Any", b: "Any") -> None:
        self._a, self._b = a, b
        self._counts = 0
        self._state = a.value() << 1 | b.value()
        for each in (a, b):
            each.irq(self._edge, each.IRQ_RISING | each.IRQ_FALLING)

    def value(self) -> int:
        return self._counts

    def deinit(self) -> None:
        for each in (self._a, self._b):
            each.irq(None)

    def _edge(self, pin: "Any") -> None:
        """Take one edge, in an interrupt: nothing is allocated."""
        state = self._a.value() << 1 | self._b.value()
        self._counts += _STEPS[self._state << 2 | state]
        self._state = state
