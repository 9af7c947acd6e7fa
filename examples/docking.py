"""A rover that docks: a behavior with a memory that performs reactions in sequence.

`Captain` sees the battery run low and asks `Docking` to dock. `Docking` gets from
`Memory` how near the rover may drive before it has to be careful, turns to the dock,
drives in, backs off and tries again when it got stuck, and answers `Captain`.
"""

import asyncio
import math

import attrs

import esair


@attrs.frozen
class Twist:
    """How the rover moves."""

    linear: float  # m/s
    angular: float  # rad/s


@attrs.frozen
class Sight:
    """Where the dock is, seen from the rover."""

    bearing: float  # rad, counter-clockwise
    distance: float  # m


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


class Yard:
    """Pretends to be the world: a dock, and a stone in the way of the first try."""

    def __init__(self) -> None:
        self.bearing = 0.8  # rad
        self.distance = 1.5  # m
        self.stone = True
        self.twist = Twist(0.0, 0.0)
        self._now: float | None = None

    def look(self) -> Sight:
        """Move on to now, and look at the dock."""
        now = asyncio.get_running_loop().time()
        seconds = now - (self._now if self._now is not None else now)
        self._now = now
        way = self.twist.linear * seconds * math.cos(self.bearing)
        if self.stone and way > 0.0:
            way = max(0.0, min(way, self.distance - 0.4))
        self.stone = (
            self.stone and self.twist.linear >= 0.0
        )  # backing off kicks it away
        self.bearing -= self.twist.angular * seconds
        self.distance = max(0.0, self.distance - way)
        return Sight(self.bearing, self.distance)


class Beacon(esair.Sensor[Sight]):
    """Sees the dock."""

    rate = 20.0

    def __init__(self, yard: Yard) -> None:
        super().__init__()
        self.yard = yard

    async def read(self) -> Sight:
        return self.yard.look()


class Battery(esair.Sensor[float]):
    """The voltage of the battery, in volts."""

    volts = 11.2

    async def read(self) -> float:
        self.volts -= 0.05
        return self.volts


class Wheels(esair.Actuator[Twist]):
    """Two driven wheels."""

    safe = Twist(0.0, 0.0)
    command_timeout = 0.2

    def __init__(self, yard: Yard) -> None:
        super().__init__()
        self.yard = yard

    async def write(self, command: Twist) -> None:
        self.yard.look()
        self.yard.twist = command


def make_robot(yard: Yard) -> esair.Robot:
    """Return the rover in its yard."""
    return esair.Robot(
        resources=[Beacon(yard), Battery(), Wheels(yard)],
        behaviors=[Memory(), Docking(), Captain()],
    )


if __name__ == "__main__":
    esair.run(make_robot(Yard()), duration=15.0)
