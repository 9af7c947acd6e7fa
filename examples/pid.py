"""Two plain things for reactions: a PID controller, and a low-pass filter."""

import math


class Pid:
    """A PID controller with a limit, whose integral does not wind up."""

    def __init__(self, p: float, i: float, d: float, *, limit: float) -> None:
        self.p, self.i, self.d, self.limit = p, i, d, limit
        self.integral = 0.0
        self.last: float | None = None

    def step(self, error: float, seconds: float) -> float:
        """Return what to do about an error, given the time since the last step."""
        rate = 0.0
        if self.last is not None and seconds > 0.0:
            rate = (error - self.last) / seconds
        self.last = error
        wanted = self.p * error + self.i * self.integral + self.d * rate
        if abs(wanted) < self.limit:
            self.integral += error * seconds
        return max(-self.limit, min(self.limit, wanted))


class LowPass:
    """A low-pass filter of first order, right also when steps come irregularly."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.value: float | None = None

    def step(self, value: float, seconds: float) -> float:
        """Return the smoothed value, given the time since the last step."""
        before = value if self.value is None else self.value
        self.value = before + (value - before) * -math.expm1(-seconds / self.seconds)
        return self.value
