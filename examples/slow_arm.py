"""An arm with a blocking driver, a behavior that runs in its own thread, and rules.

`Inspect` is a `ThreadBehavior`: it has a thread, and every call on its ports waits.
The driver's methods are plain too: they run on a worker thread of the arm. `Guard`
takes the arm away from `Inspect` for a moment; `Visitor` may look but not touch.
"""

import asyncio
import time

import esair


class Arm(esair.Actuator[float]):
    """One joint on an old controller whose driver blocks; angle in radians."""

    safe = 0.0
    command_timeout = 0.5
    limits = (-1.5, 1.5)
    speed = esair.setting(0.5, unit="rad/s", min=0.1, max=2.0, doc="how fast it moves")

    def write(self, command: float) -> None:
        time.sleep(0.01)  # the old controller is slow to answer

    def apply(self, **changes: object) -> None:
        time.sleep(0.01)  # here the controller would be told its new speed


class Inspect(esair.ThreadBehavior):
    """Points the arm here and there, more carefully when it is told to."""

    arm = esair.writes(float, configure=True)

    def run(self) -> None:
        self.arm.configure(speed=1.0)
        try:
            self.arm.configure(speed=99.0)
        except esair.BadValueError as error:
            print(f"refused: {error}", flush=True)
        print(f"speed: {self.arm.settings['speed']} rad/s", flush=True)
        refused = 0
        for seconds in esair.every(0.1):
            if seconds > 3.0:
                break
            answer = self.arm.write(0.5 if int(seconds) % 2 else -0.5)
            if not answer:
                refused += 1
                if refused == 1:
                    print(f"held by {answer.holder}: {answer.rule}", flush=True)
        print(f"{refused} of 31 writes were refused", flush=True)


class Guard(esair.Behavior):
    """Holds the arm up for half a second while somebody walks by."""

    arm = esair.writes(float, priority=10)

    async def run(self) -> None:
        await asyncio.sleep(1.0)
        await self.arm.write(1.2, hold=0.5)
        await asyncio.sleep(0.5)  # at its end a behavior loses what it holds


class Visitor(esair.Behavior):
    """Asks for what it may not have."""

    async def run(self) -> None:
        try:
            await self.register("arm", esair.Access.WRITE)
        except esair.AccessDeniedError as error:
            print(f"denied: {error}", flush=True)


def make_robot() -> esair.Robot:
    """Return the robot; only those who are named may use the arm."""
    write, configure = esair.Access.WRITE, esair.Access.CONFIGURE
    return esair.Robot(
        resources=[Arm()],
        behaviors=[Inspect(), Guard(), Visitor()],
        policies=[
            esair.Policy("arm", allow={"inspect": write | configure, "guard": write})
        ],
    )


robot = make_robot()

if __name__ == "__main__":
    esair.run(robot)
