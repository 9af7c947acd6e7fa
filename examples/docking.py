"""A rover that docks: a behavior with a memory that performs reactions in sequence.

`Captain` sees the battery run low and asks `Docking` to dock. `Docking` gets from
`Memory` how near the rover may drive before it has to be careful, turns to the dock,
drives in, backs off and tries again when it got stuck, and answers `Captain`.
"""

import attrs
from yard import Battery, Beacon, Sight, Twist, Wheels, Yard

import esair


@attrs.frozen
class Docked:
    """The rover is in its dock."""

    attempt: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    """Bring the rover into its dock."""

    attempts: int = 3


class Turn(esair.Reaction):
    """Face the dock."""

    beacon = esair.reads(Sight, max_age=0.5)
    wheels = esair.writes(Twist, priority=5)

    def react(self, beacon: Sight) -> Twist:
        return Twist(0.0, max(-1.0, min(1.0, 2.0 * beacon.bearing)))


class Approach(esair.Reaction):
    """Drive in; slowly once the dock is near."""

    beacon = esair.reads(Sight, max_age=0.5)
    wheels = esair.writes(Twist, priority=5)

    def __init__(self, *, careful_from: float) -> None:
        super().__init__()
        self.careful_from = careful_from  # m

    def react(self, beacon: Sight) -> Twist:
        speed = 0.2 if beacon.distance < self.careful_from else 0.4
        return Twist(speed, beacon.bearing)


class BackOff(esair.Reaction):
    """Drive back, straight."""

    rate = 20.0
    wheels = esair.writes(Twist, priority=5)

    def react(self) -> Twist:
        return Twist(-0.3, 0.0)


class Memory(esair.Behavior):
    """Remembers where the rover got stuck; others ask for it when they need it."""

    def __init__(self) -> None:
        super().__init__()
        self.stuck_at: list[float] = []

    async def run(self) -> None:
        while True:
            self.stuck_at.append(await self.receive())

    async def provide(self) -> float:
        return max(self.stuck_at, default=0.2) + 0.1


class Docking(esair.Behavior):
    """Brings the rover to its dock when it is asked to."""

    beacon = esair.reads(Sight, max_age=0.5)

    @esair.answers
    async def dock(self, request: Dock) -> Docked:
        """Try as often as the request says."""
        for attempt in range(1, request.attempts + 1):
            request.progress(attempt)
            if await self.try_once():
                return Docked(attempt)
        raise esair.RefusedError("no way in")

    async def try_once(self) -> bool:
        """Try once; afterwards the rover stands in the dock, or away from it."""
        await self.perform(
            Turn(), until=lambda beacon: abs(beacon.bearing) < 0.05, timeout=5.0
        )
        near = await self.get("memory")
        if await self.perform(
            Approach(careful_from=near),
            until=lambda beacon: beacon.distance < 0.02,
            timeout=5.0,
        ):
            return True
        await self.put("memory", (await self.beacon.read()).distance)
        await self.perform(BackOff(), timeout=2.0)
        return False


class Captain(esair.Behavior):
    """Watches the battery, and ends when the rover is in its dock."""

    battery = esair.reads(float)

    async def run(self) -> None:
        async for volts in self.battery:
            if volts < 11.0:
                break
        print("battery low: dock", flush=True)
        try:
            docked = await self.ask("docking", Dock(), timeout=60.0)
        except esair.RefusedError as error:
            print(error.reason, flush=True)
        else:
            print(f"docked, attempt {docked.attempt}", flush=True)


def make_robot(yard: Yard) -> esair.Robot:
    """Return the rover in its yard."""
    return esair.Robot(
        resources=[Beacon(yard), Battery(), Wheels(yard)],
        behaviors=[Memory(), Docking(), Captain()],
    )


robot = make_robot(Yard())

if __name__ == "__main__":
    esair.run(robot, duration=15.0)
