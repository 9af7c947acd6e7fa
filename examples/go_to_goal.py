"""A rover that drives to one place after the other: odometry, a PID, a bumper.

`Odometry` (odometry.py) is derived of two encoders. `Steer` turns the rover to its goal
with a PID controller; `Tour` performs it, goal after goal. `Bumped` guards the wheels:
nothing drives on ahead while the bumper touches something, or is not heard.
"""

import asyncio
import math

import attrs
from odometry import Odometry, Pose

import esair
from esair.control import Pid


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


class Steer(esair.Reaction):
    """Drive to a place: turn to it, the less ahead the more there is to turn."""

    rate = 20.0
    odometry = esair.reads(Pose, max_age=0.2)
    wheels = esair.writes(Twist, priority=5)

    def __init__(self, x: float, y: float) -> None:
        super().__init__()
        self.goal = x, y
        self.pid = Pid(2.5, 0.2, 0.1, low=-1.5, high=1.5, wrap=2 * math.pi)

    def react(self, odometry: Pose) -> Twist:
        distance, turn = odometry.to(*self.goal)
        ahead = min(0.4, distance) * max(0.0, math.cos(turn))
        return Twist(ahead, self.pid.step(0.0, -turn, self.elapsed_ms))


class Bumped(esair.Reaction):
    """Whoever drives, what touches the bumper is not pushed."""

    bumper = esair.reads(bool, max_age=0.3)
    wheels = esair.guards(Twist)

    def react(self, bumper: bool, wheels: Twist) -> Twist:
        return (
            attrs.evolve(wheels, linear=min(wheels.linear, 0.0)) if bumper else wheels
        )


class Tour(esair.Behavior):
    """Goes around a square, then ends."""

    goals = ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0))

    async def run(self) -> None:
        for x, y in self.goals:
            came = await self.perform(
                Steer(x, y),
                until=lambda odometry, x=x, y=y: odometry.to(x, y)[0] < 0.05,
                timeout=15.0,
            )
            print("at" if came else "stuck on the way to", (x, y), flush=True)


class Wheels(esair.Actuator[Twist]):
    """Two wheels 0.3 m apart; pretends to turn them at once as it is told."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2
    twist = safe
    left = right = 0.0  # m, how far each has turned
    now: float | None = None

    async def write(self, command: Twist) -> None:
        self.turn()
        self.twist = command

    def turn(self) -> tuple[float, float]:
        """Move on to now; return how far each wheel has turned, in metres."""
        now = asyncio.get_running_loop().time()
        seconds = now - (now if self.now is None else self.now)
        self.now = now
        self.left += seconds * (self.twist.linear - 0.15 * self.twist.angular)
        self.right += seconds * (self.twist.linear + 0.15 * self.twist.angular)
        return self.left, self.right


class Encoder(esair.Sensor[float]):
    """How far one wheel has turned, in metres."""

    rate = 50.0

    def __init__(self, wheels: Wheels, side: int, *, name: str) -> None:
        super().__init__(name=name)
        self.wheels = wheels
        self.side = side

    async def read(self) -> float:
        return self.wheels.turn()[self.side]


class Bumper(esair.Sensor[bool]):
    """Whether something touches the front."""

    rate = 20.0

    async def read(self) -> bool:
        return False


wheels = Wheels()
robot = esair.Robot(
    name="tourist",
    resources=[
        wheels,
        Encoder(wheels, 0, name="left"),
        Encoder(wheels, 1, name="right"),
        Odometry(),
        Bumper(),
    ],
    behaviors=[Bumped(), Tour()],
)

if __name__ == "__main__":
    esair.run(robot)
