"""An arm that picks and places: a driver that blocks, and eyes that are slow and crash.

`Eyes` looks for the part in a thread of its own; it takes long, and its camera library
fails now and then. `Work` asks it, picks the part and places it. When the eyes fail, the
work waits until they are back: the arm stands, and nothing else notices. `Fence` guards
the arm: it stands while somebody is near.
"""

import asyncio
import time

import attrs

import esair


@attrs.frozen
class Seen:
    """Where the part lies."""

    x: float  # m
    y: float  # m


@attrs.frozen
class Look(esair.Request[Seen]):
    """Find the part."""


@attrs.frozen
class Pose:
    """Where the hand is to be, and whether it grips."""

    x: float  # m
    y: float  # m
    grips: bool


class Bench:
    """Pretends to be the world: the part, and a camera library that is not good."""

    looks = placed = 0

    def photograph(self) -> tuple[float, float]:
        """Take long; every third time fail."""
        time.sleep(0.3)
        self.looks += 1
        if self.looks % 3 == 2:
            raise OSError("the camera library has crashed")
        return 0.2, 0.3


class Eyes(esair.ThreadBehavior):
    """Looks when it is asked, one at a time; a crash costs this look only."""

    looks = esair.takes(Look, queue=2)
    restart = esair.Restart(max=5, within=60.0)

    def __init__(self, bench: Bench) -> None:
        super().__init__()
        self.bench = bench

    def run(self) -> None:
        for request in self.looks:
            with request:
                request.answer(Seen(*self.bench.photograph()))


class Fence(esair.Reaction):
    """The arm stands while somebody is nearer than a metre, or the scanner is away."""

    scanner = esair.reads(float, max_age=0.5)
    arm = esair.guards(Pose)

    def react(self, scanner: float, arm: Pose) -> Pose | None:
        return arm if scanner > 1.0 else None


class Work(esair.Behavior):
    """Looks, picks, places; again and again."""

    arm = esair.writes(Pose)

    def __init__(self, bench: Bench) -> None:
        super().__init__()
        self.bench = bench

    async def run(self) -> None:
        while True:
            try:
                seen = await self.ask("eyes", Look(), timeout=2.0)
            except (esair.BehaviorFailedError, esair.BehaviorUnavailableError) as error:
                print(f"no eyes: {error}", flush=True)
                await asyncio.sleep(0.5)
                continue
            await self.go(Pose(seen.x, seen.y, grips=False))
            await self.go(Pose(seen.x, seen.y, grips=True))
            await self.go(Pose(0.5, 0.0, grips=True))
            await self.go(Pose(0.5, 0.0, grips=False))
            self.bench.placed += 1
            print(f"placed {self.bench.placed}", flush=True)

    async def go(self, pose: Pose) -> None:
        """Write until it was let through; then give the arm its time."""
        async for _ in esair.every(0.1):
            if await self.arm.write(pose):
                break
        await asyncio.sleep(0.2)


class Scanner(esair.Sensor[float]):
    """How near the nearest person is, in metres."""

    rate = 20.0
    near = 3.0

    async def read(self) -> float:
        return self.near


class Arm(esair.Actuator[Pose]):
    """An old arm whose driver blocks; its safe command leaves it where it is."""

    safe = esair.HOLD
    command_timeout = 1.0

    def __init__(self) -> None:
        super().__init__()
        self.told: list[Pose] = []

    def write(self, command: Pose) -> None:
        time.sleep(0.02)  # a slow serial line
        if isinstance(command, Pose):
            self.told.append(command)


def make_robot(bench: Bench) -> esair.Robot:
    """Return the arm at its bench."""
    return esair.Robot(
        name="arm",
        resources=[Scanner(), Arm()],
        behaviors=[Fence(), Eyes(bench), Work(bench)],
    )


robot = make_robot(Bench())

if __name__ == "__main__":
    esair.run(robot, duration=10.0)
