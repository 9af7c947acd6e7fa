"""What is measured of MIN, by the same file on CPython and on MicroPython."""

import gc
import time

from esair.minimal import Actuator, Loop, Reaction, Sensor, reads, writes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

ROUNDS = 9
FIRST = 100
"""After so many steps nothing may be allocated any more."""


class Sonar(Sensor):
    """A sensor that has its value at hand."""

    value = 0.25

    def read(self) -> float:
        return self.value


class Wheels(Actuator):
    """An actuator whose driver does nothing."""

    safe = 0.0

    def write(self, command: float) -> None:
        pass


class Avoid(Reaction):
    """One comparison."""

    sonar = reads(float, max_age=0.5)
    wheels = writes(float, priority=10)

    def react(self, sonar: float) -> "float | None":
        return 0.5 if sonar < 0.4 else None


def clock() -> float:
    """Return seconds; MicroPython's float seconds have seven digits only."""
    return time.ticks_us() / 1e6 if hasattr(time, "ticks_us") else time.perf_counter()


def timed_steps(count: int) -> float:
    loop = Loop([Avoid()], [Sonar()], [Wheels()], rate=50)
    step = loop.step
    for _ in range(FIRST):
        step()
    n = count
    begin = clock()
    while n:
        step()
        n -= 1
    return (clock() - begin) / count


def timed_calls(count: int) -> float:
    """The limit: three bound methods, and nothing that anybody promised."""
    read, react, write = Sonar().read, Avoid().react, Wheels().write
    n = count
    begin = clock()
    while n:
        write(react(read()))  # type: ignore[arg-type]
        n -= 1
    return (clock() - begin) / count


def timed_by_hand(count: int) -> float:
    """The loop that people write."""
    sonar, avoid, wheels = Sonar(), Avoid(), Wheels()
    n = count
    begin = clock()
    while n:
        distance = sonar.read()
        command = avoid.react(distance)
        if command is not None:
            wheels.write(command)
        n -= 1
    return (clock() - begin) / count


def compared(limit: "Callable[[int], float]", count: int) -> "list[list[float]]":
    """Return the seconds of a step, of the limit, and their ratio, for each round."""
    timed_steps(count)
    limit(count)
    found = []
    for _ in range(ROUNDS):
        mine, other = timed_steps(count), limit(count)
        found.append([mine, other, mine / other])
    return found


def allocated(count: int) -> float:
    """Return how many bytes a step takes from MicroPython's heap, freed or not."""
    loop = Loop([Avoid()], [Sonar()], [Wheels()], rate=50)
    step = loop.step
    for _ in range(FIRST):
        step()
    gc.collect()
    before = gc.mem_alloc()  # type: ignore[attr-defined]
    n = count
    while n:
        step()
        n -= 1
    taken = gc.mem_alloc() - before  # type: ignore[attr-defined]
    return float(taken / count)
