"""A picture is searched in a process of its own, with a library that crashes now and then.

The search takes all of a core, and every so often it takes its process with it. The rover
stands still while nobody sees, and drives on when it is there again.

    python examples/placed_eyes.py
"""

import itertools
import os
import random

import attrs

import esair


@attrs.frozen
class Twist:
    """How a rover drives, in m/s and rad/s."""

    linear: float
    angular: float


class Camera(esair.Sensor[list[float]]):
    """A line of brightness; its C library has a process of its own."""

    placement = "process"
    rate = 10.0

    def read(self) -> list[float]:
        return [random.random() for _ in range(2000)]


class Eyes(esair.Reaction):
    """Turns towards what is brightest. It computes for 10 ms, where it holds up nobody."""

    placement = esair.Placement(stall=2.0, nice=5)
    camera = esair.reads(list[float], max_age=0.5)
    wheels = esair.writes(Twist, priority=5)
    crash_after: int | None = 40

    def react(self, camera: list[float]) -> Twist:
        smooth = camera
        for _ in range(30):
            smooth = [(a + b) / 2 for a, b in itertools.pairwise(smooth)]
        at = smooth.index(max(smooth)) / len(smooth)
        if self.crash_after is not None:
            self.crash_after -= 1
            if self.crash_after == 0:
                os.abort()  # as a library in C would
        return Twist(0.2, 0.5 - at)


class Wheels(esair.Actuator[Twist]):
    """Prints when real wheels would start or stop; it stays in the robot's process."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.3
    drives = False

    async def write(self, command: Twist) -> None:
        if (command != self.safe) != self.drives:
            self.drives = not self.drives
            print("drives" if self.drives else "stands still", flush=True)


robot = esair.Robot(name="eyes", resources=[Camera(), Wheels()], behaviors=[Eyes()])

if __name__ == "__main__":
    esair.run(robot)
