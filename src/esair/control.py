"""Parts of control: what a reaction needs between its readings and its command.

Each is a plain object that is told the time since its step before, in milliseconds, as
`Reaction.elapsed_ms` gives it. It asks no clock, so a test needs none, and it decides the
same in STD, in a replay and on a board with MicroPython. C knows no such objects.

Whatever comes in, and however long nothing came: what goes out is finite and within its
limits. A number that is not finite, or beyond ``1e30``, is left out, as if the step had not
been made. A gap counts as `LONGEST_MS` at the most, unless a part is told otherwise.
"""

import math

LONGEST_MS = 100
"""How much time one step may stand for: what happened in a longer gap is not known."""

_GREATEST = 1e30  # its square is beyond single floats, it is not


def _is_usable(value: float) -> bool:
    return -_GREATEST < value < _GREATEST  # false for NaN, too


def _between(low: float, value: float, high: float) -> float:
    if value > high:
        return high
    return value if value > low else low


def _turned(angle: float, wrap: float) -> float:
    """Return the same angle between minus half a turn and half a turn."""
    return (angle + wrap / 2.0) % wrap - wrap / 2.0 if wrap > 0.0 else angle


def _check(part: str, field: str, value: float, least: float) -> None:
    if not _is_usable(value) or value < least:
        raise ValueError(
            part
            + ": "
            + field
            + " is "
            + repr(value)
            + ": expected a finite number, "
            + repr(least)
            + " or more"
        )


class Pid:
    """A PID controller whose output has limits, and whose integral cannot wind up.

    The integral is kept as the share of the output that it is, within the limits, and
    grows only while the output is not at the limit that it pushes to. A lasting error
    has its sign in the output after ``(high - low) / (i * error)`` seconds at the
    latest. The derivative is that of the measurement: a new target makes no jump.

    Args:
        p: Output for each unit of error.
        i: Output for each unit of error and second.
        d: Output for each unit of error a second.
        low: The least output.
        high: The greatest output.
        wrap: A full turn, if target and measurement are angles (``2 * math.pi`` or
            ``360.0``): the way round is the shorter one. 0: they are not.
        longest_ms: What a gap counts as at the most, for the integral.

    Raises:
        ValueError: A number is not finite, gains have different signs, or *low* is
            not below *high*.
    """

    def __init__(
        self,
        p: float,
        i: float = 0.0,
        d: float = 0.0,
        *,
        low: float,
        high: float,
        wrap: float = 0.0,
        longest_ms: int = LONGEST_MS,
    ) -> None:
        for field, value in (("p", p), ("i", i), ("d", d), ("low", low)):
            _check("Pid", field, value, -_GREATEST)
        _check("Pid", "high", high, low)
        _check("Pid", "wrap", wrap, 0.0)
        _check("Pid", "longest_ms", longest_ms, 1)
        if low == high:
            raise ValueError("Pid: low and high are equal: nothing can be controlled")
        if min(p, i, d) < 0.0 < max(p, i, d):
            raise ValueError(
                "Pid: p, i and d have different signs: one works against another"
            )
        self.p: float = float(p)
        self.i: float = float(i)
        self.d: float = float(d)
        self.low: float = float(low)
        self.high: float = float(high)
        self.wrap: float = float(wrap)
        self.longest_ms = longest_ms
        self.reset()

    def reset(self) -> None:
        """Forget what was: as it was made."""
        self.integral: float = _between(self.low, 0.0, self.high)
        self.output: float = self.integral
        self.measured: float = 0.0
        self.started: bool = False

    def step(self, target: float, measured: float, elapsed_ms: int) -> float:
        """Return what to do now.

        Args:
            target: Where to be.
            measured: Where it is, in the same unit.
            elapsed_ms: Time since the step before, in milliseconds; 0 at the first.

        Returns:
            The output, from `low` to `high`; that of before if *target* or *measured*
            is no finite number. What it did meanwhile is not known, so the next step
            has no derivative.
        """
        if not (_is_usable(target) and _is_usable(measured)):
            self.started = False
            return self.output
        error = _turned(target - measured, self.wrap)
        change = 0.0
        if self.started and elapsed_ms > 0:
            change = _turned(measured - self.measured, self.wrap)
            change = _between(-_GREATEST, change * 1000.0 / elapsed_ms, _GREATEST)
        self.measured = measured
        self.started = True
        damping = _between(-_GREATEST, self.d * change, _GREATEST)
        direct = _between(-_GREATEST, self.p * error, _GREATEST) - damping
        share = self.i * error * min(max(elapsed_ms, 0), self.longest_ms) / 1000.0
        wanted = direct + self.integral
        if not (share > 0.0 and wanted >= self.high) and not (
            share < 0.0 and wanted <= self.low
        ):
            self.integral = _between(self.low, self.integral + share, self.high)
        self.output = _between(self.low, direct + self.integral, self.high)
        return self.output


class LowPass:
    """A low-pass filter of first order, the same however often it is stepped.

    Args:
        time_ms: After this time 63 % of a jump are through, in milliseconds.

    Raises:
        ValueError: The time is not above 0.
    """

    def __init__(self, time_ms: float) -> None:
        _check("LowPass", "time_ms", time_ms, 0.001)
        self.time_ms: float = float(time_ms)
        self.reset()

    def reset(self) -> None:
        """Forget what was: the next value is believed at once."""
        self.value: float = 0.0
        self.started: bool = False

    def step(self, value: float, elapsed_ms: int) -> float:
        """Return the smoothed value.

        Args:
            value: What was measured.
            elapsed_ms: Time since the step before, in milliseconds.
        """
        if not _is_usable(value):
            return self.value
        if not self.started:
            self.value = value
            self.started = True
        elif elapsed_ms > 0:
            self.value += (value - self.value) * (
                1.0 - math.exp(-elapsed_ms / self.time_ms)
            )
        return self.value


class Slew:
    """Follows a value no faster than it may change.

    Args:
        up_per_s: How fast it may grow, in units a second.
        down_per_s: How fast it may fall; as fast as it may grow unless given.
        start: Where it begins.
        longest_ms: What a gap counts as at the most.

    Raises:
        ValueError: A number is not finite, or a speed is not above 0.
    """

    def __init__(
        self,
        up_per_s: float,
        down_per_s: "float | None" = None,
        *,
        start: float = 0.0,
        longest_ms: int = LONGEST_MS,
    ) -> None:
        down_per_s = up_per_s if down_per_s is None else down_per_s
        _check("Slew", "up_per_s", up_per_s, 1e-9)
        _check("Slew", "down_per_s", down_per_s, 1e-9)
        _check("Slew", "start", start, -_GREATEST)
        _check("Slew", "longest_ms", longest_ms, 1)
        self.up_per_s: float = float(up_per_s)
        self.down_per_s: float = float(down_per_s)
        self.start: float = float(start)
        self.longest_ms = longest_ms
        self.reset()

    def reset(self) -> None:
        """Go back to the start at once."""
        self.value: float = self.start

    def step(self, value: float, elapsed_ms: int) -> float:
        """Return how far it has come towards *value*.

        Args:
            value: Where to go.
            elapsed_ms: Time since the step before, in milliseconds.
        """
        if _is_usable(value):
            seconds = min(max(elapsed_ms, 0), self.longest_ms) / 1000.0
            self.value = _between(
                self.value - self.down_per_s * seconds,
                value,
                self.value + self.up_per_s * seconds,
            )
        return self.value


class Debounce:
    """A switch that is believed when it has stayed for a while.

    Args:
        on_ms: How long it has to be on before it counts, in milliseconds.
        off_ms: How long it has to be off; as long as *on_ms* unless given. 0: at once.
        start: What it is until then.

    Raises:
        ValueError: A time is below 0.
    """

    def __init__(
        self, on_ms: int, off_ms: "int | None" = None, *, start: bool = False
    ) -> None:
        off_ms = on_ms if off_ms is None else off_ms
        _check("Debounce", "on_ms", on_ms, 0)
        _check("Debounce", "off_ms", off_ms, 0)
        self.on_ms = on_ms
        self.off_ms = off_ms
        self.start: bool = bool(start)
        self.reset()

    def reset(self) -> None:
        """Go back to the start."""
        self.value: bool = self.start
        self.other_ms: int = 0
        self.was_other: bool = False

    def step(self, value: bool, elapsed_ms: int) -> bool:
        """Return what is believed.

        Args:
            value: What the switch says.
            elapsed_ms: Time since the step before, in milliseconds. What the switch
                did meanwhile is not known: time counts from the first step that saw
                the change.
        """
        if value == self.value:
            self.other_ms = 0
            self.was_other = False
            return self.value
        wait_ms = self.on_ms if value else self.off_ms
        if self.was_other:
            self.other_ms = min(self.other_ms + max(elapsed_ms, 0), wait_ms)
        self.was_other = True
        if self.other_ms >= wait_ms:
            self.value = bool(value)
            self.other_ms = 0
            self.was_other = False
        return self.value


class Hysteresis:
    """On at and above one value, off at and below another; between them as it was.

    Args:
        off: At and below this it is off.
        on: At and above this it is on.
        start: What it is between the two at the first step.

    Raises:
        ValueError: A number is not finite, or *off* is not below *on*.
    """

    def __init__(self, off: float, on: float, *, start: bool = False) -> None:
        _check("Hysteresis", "off", off, -_GREATEST)
        _check("Hysteresis", "on", on, -_GREATEST)
        if off >= on:
            raise ValueError("Hysteresis: off has to be below on")
        self.off: float = float(off)
        self.on: float = float(on)
        self.start: bool = bool(start)
        self.reset()

    def reset(self) -> None:
        """Go back to the start."""
        self.value: bool = self.start

    def step(self, value: float) -> bool:
        """Return whether it is on; an infinite *value* is beyond one of the two."""
        if value >= self.on:
            self.value = True
        elif value <= self.off:
            self.value = False
        return self.value


class MovingMedian:
    """The middle one of the last values: a single wrong one never comes through.

    Args:
        count: Of how many values, from 1 to 63. Until there are as many, of those
            that there are; of an even number the lower one of the two in the middle.

    Raises:
        ValueError: The count is not from 1 to 63.
    """

    def __init__(self, count: int) -> None:
        if not 1 <= count <= 63:
            raise ValueError(
                "MovingMedian: count is " + repr(count) + ": expected 1 to 63"
            )
        self.count = count
        self.values: list[float] = [0.0] * count
        self.in_order: list[float] = [0.0] * count
        self.reset()

    def reset(self) -> None:
        """Forget all values."""
        self.known: int = 0
        self.next: int = 0
        self.value: float = 0.0

    def step(self, value: float) -> float:
        """Take a value; return the median of the last ones."""
        if not _is_usable(value):
            return self.value
        self.values[self.next] = value
        self.next = (self.next + 1) % self.count
        self.known = min(self.known + 1, self.count)
        for end in range(self.known):
            place = end
            while place > 0 and self.in_order[place - 1] > self.values[end]:
                self.in_order[place] = self.in_order[place - 1]
                place -= 1
            self.in_order[place] = self.values[end]
        self.value = self.in_order[(self.known - 1) // 2]
        return self.value


class Complementary:
    """An angle of two sensors: one is quick and drifts, the other is slow and does not.

    Args:
        time_ms: What lasts longer than this is believed of the slow one, what is
            shorter of the quick one, in milliseconds.
        wrap: A full turn in the unit of the angle, if it may go round; 0: it may not.

    Raises:
        ValueError: The time is not above 0, or *wrap* is below 0.
    """

    def __init__(self, time_ms: float, *, wrap: float = 0.0) -> None:
        _check("Complementary", "time_ms", time_ms, 0.001)
        _check("Complementary", "wrap", wrap, 0.0)
        self.time_ms: float = float(time_ms)
        self.wrap: float = float(wrap)
        self.reset()

    def reset(self) -> None:
        """Forget what was: the next angle of the slow one is believed at once."""
        self.value: float = 0.0
        self.started: bool = False

    def step(self, rate_per_s: float, angle: float, elapsed_ms: int) -> float:
        """Return the angle; from minus half a turn to half a turn if it wraps.

        Args:
            rate_per_s: How fast it turns, by the quick one (a gyroscope).
            angle: Where it is, by the slow one (an accelerometer, a compass).
            elapsed_ms: Time since the step before, in milliseconds. After a gap of
                many *time_ms* the slow one alone is believed.
        """
        if not (_is_usable(rate_per_s) and _is_usable(angle)):
            return self.value
        if not self.started:
            self.value = _turned(angle, self.wrap)
            self.started = True
        elif elapsed_ms > 0:
            turned = min(elapsed_ms, self.time_ms) / 1000.0
            turned = _between(-_GREATEST, rate_per_s * turned, _GREATEST)
            guess = self.value + turned
            trust = self.time_ms / (self.time_ms + elapsed_ms)
            off = _turned(guess - angle, self.wrap)
            self.value = _turned(angle + off * trust, self.wrap)
            self.value = _between(-_GREATEST, self.value, _GREATEST)
        return self.value


class TrapezoidProfile:
    """The way to a place with limited speed and acceleration.

    It speeds up, goes on, slows down and stands at its target. A target that moves is
    followed by the same limits; one that comes nearer than it can stop is overrun, and
    come back to.

    Args:
        speed_per_s: The greatest speed, in units a second.
        acceleration_per_s2: The greatest change of speed, in units a second squared.
        start: Where it begins, standing.
        longest_ms: What a gap counts as at the most.

    Raises:
        ValueError: A number is not finite, or speed or acceleration is not above 0.
    """

    def __init__(
        self,
        speed_per_s: float,
        acceleration_per_s2: float,
        *,
        start: float = 0.0,
        longest_ms: int = LONGEST_MS,
    ) -> None:
        _check("TrapezoidProfile", "speed_per_s", speed_per_s, 1e-9)
        _check("TrapezoidProfile", "acceleration_per_s2", acceleration_per_s2, 1e-9)
        _check("TrapezoidProfile", "start", start, -_GREATEST)
        _check("TrapezoidProfile", "longest_ms", longest_ms, 1)
        self.speed_per_s: float = float(speed_per_s)
        self.acceleration_per_s2: float = float(acceleration_per_s2)
        self.start: float = float(start)
        self.longest_ms = longest_ms
        self.reset()

    def reset(self) -> None:
        """Stand at the start."""
        self.position: float = self.start
        self.velocity: float = 0.0
        """Units a second, with its direction."""

    def step(self, target: float, elapsed_ms: int) -> float:
        """Return where to be now.

        Args:
            target: Where to go.
            elapsed_ms: Time since the step before, in milliseconds.
        """
        seconds = min(max(elapsed_ms, 0), self.longest_ms) / 1000.0
        if not _is_usable(target) or seconds <= 0.0:
            return self.position
        gain = self.acceleration_per_s2 * seconds
        way = target - self.position
        # The greatest speed from which it still stops there, in steps of this length.
        stops = math.sqrt(gain * gain / 4.0 + 2.0 * self.acceleration_per_s2 * abs(way))
        stops = min(stops - gain / 2.0, self.speed_per_s)
        wanted = min(stops, abs(way) / seconds)
        if way < 0.0:
            wanted = -wanted
        self.velocity = _between(self.velocity - gain, wanted, self.velocity + gain)
        step = self.velocity * seconds
        if abs(way - step) <= 1e-9 * self.speed_per_s and abs(self.velocity) <= gain:
            self.position = target  # and stands at the next step
        else:
            self.position += step
        return self.position
