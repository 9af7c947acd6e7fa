"""A rover that drives to one place after the other: odometry, a PID, a bumper.

`Odometry` makes a pose of what the wheels have turned. `Steer` turns the rover to its goal
with a PID controller; `Tour` performs it, goal after goal. `Bumped` guards the wheels:
nothing drives on ahead while the bumper touches something, or is not heard.
"""

import asyncio
import math

import attrs
from pid import Pid

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


@attrs.frozen
class Pose:
    """Where the rover is, as its wheels have it."""

    x: float  # m
    y: float  # m
    heading: float  # rad, counter-clockwise from the x axis

    def to(self, x: float, y: float) -> tuple[float, float]:
        """Return the way to a place, in metres, and the turn to it, in rad."""
        turn = math.atan2(y - self.y, x - self.x) - self.heading
        return math.hypot(x - self.x, y - self.y), math.remainder(turn, math.tau)


class Steer(esair.Reaction):
    """Drive to a place: turn to it, the less ahead the more there is to turn."""

    rate = 20.0
    odometry = esair.reads(Pose, max_age=0.2)
    wheels = esair.writes(Twist, priority=5)

    def __init__(self, x: float, y: float) -> None:
        super().__init__()
        self.goal = x, y
        self.pid = Pid(2.5, 0.2, 0.1, limit=1.5)

    def react(self, odometry: Pose) -> Twist:
        distance, turn = odometry.to(*self.goal)
        ahead = min(0.4, distance) * max(0.0, math.cos(turn))
        return Twist(ahead, self.pid.step(turn, 1 / 20.0))


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


class Odometry(esair.Sensor[Pose]):
    """Adds up what both wheels have turned."""

    rate = 50.0

    def __init__(self, wheels: Wheels) -> None:
        super().__init__()
        self.wheels = wheels
        self.turned = (0.0, 0.0)
        self.pose = Pose(0.0, 0.0, 0.0)

    async def read(self) -> Pose:
        left, right = self.wheels.turn()
        ahead = (left - self.turned[0] + right - self.turned[1]) / 2
        turn = (right - self.turned[1] - left + self.turned[0]) / 0.3
        self.turned = left, right
        x, y, heading = attrs.astuple(self.pose)
        x += ahead * math.cos(heading + turn / 2)
        y += ahead * math.sin(heading + turn / 2)
        self.pose = Pose(x, y, heading + turn)
        return self.pose


class Bumper(esair.Sensor[bool]):
    """Whether something touches the front."""

    rate = 20.0

    async def read(self) -> bool:
        return False


wheels = Wheels()
robot = esair.Robot(
    name="tourist",
    resources=[wheels, Odometry(wheels), Bumper()],
    behaviors=[Bumped(), Tour()],
)

if __name__ == "__main__":
    esair.run(robot)
