"""A quadrature encoder that PIO counts: the state machines of RP2040 and RP2350.

It is imported only where there is ``rp2``, which assembles the program on import.
"""

# mypy: ignore-errors
# ruff: noqa: F821 - rp2 lends the function the words of PIO while it assembles

from rp2 import PIO, StateMachine, asm_pio

_SPAN = 1 << 31  # the position in a word of the queue


# Only edges of the first track are counted, by the level of the second: with both levels
# that tells all four positions of a period, and a bounce takes back what it gave.
# y: the first track as it was counted, 0 or all ones. x: the edges, inverted while y is
# ones; so one code serves rising and falling, and counts up as well as down.
@asm_pio(out_shiftdir=PIO.SHIFT_RIGHT)
def _program():
    set(x, 0)
    set(y, 0)
    wrap_target()
    label("look")
    in_(x, 30)
    in_(y, 1)
    in_(pins, 1)
    push(noblock)
    jmp(pin, "high")
    jmp(not_y, "look")
    label("edge")
    mov(osr, pins)
    mov(isr, y)
    out(y, 1)
    jmp(not_y, "low")
    jmp(x_dec, "next")
    label("next")
    mov(x, invert(x))
    jmp("counted")
    label("low")
    mov(x, invert(x))
    jmp(x_dec, "counted")
    label("counted")
    mov(y, invert(isr))
    wrap()
    label("high")
    jmp(not_y, "edge")
    jmp("look")


class PioCounter:
    """Counts all four edges of a period, without interrupts.

    Edges may follow each other in 25 cycles: 5 million a second at 125 MHz.

    Args:
        unit: The state machine. Those of one block share the program of 20 instructions.
        a: The pin of the first track, an input.
        b: That of the second: any other.

    Raises:
        ValueError: There is no such state machine, or the board itself uses it.
        OSError: Its block has no room for the program.
    """

    def __init__(self, unit: int, a, b) -> None:
        self._machine = StateMachine(unit, _program, jmp_pin=a, in_base=b)
        self._machine.active(1)
        self._position()  # it may not yet know that the first track is high
        self._last = self._position()
        self._counts = 0

    def value(self) -> int:
        """Return the edges forwards less those backwards since it was made."""
        now = self._position()
        self._counts += (now - self._last + _SPAN // 2) % _SPAN - _SPAN // 2
        self._last = now
        return self._counts

    def deinit(self) -> None:
        """Count no more."""
        self._machine.active(0)

    def _position(self) -> int:
        """Return where it is now, not what has waited in the queue."""
        for _ in range(self._machine.rx_fifo() + 1):
            word = self._machine.get()
        at = (word >> 2) * 2 - (word & 1)
        return -at - 3 if word & 2 else at
