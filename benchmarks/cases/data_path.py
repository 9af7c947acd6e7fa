"""P3 and P4: a cached read and a write through the connections, in units of F."""

from __future__ import annotations

import time

import attrs

import esair
from benchmarks.cases.components import Meter, Motor, PlainMotor, User
from benchmarks.harness import Row, future_round_trip, neighbors, us

COUNT = 4000


@attrs.frozen
class Twist:
    """A command with two fields, as most robots have one."""

    linear: float
    angular: float


class Wheels(esair.Actuator[Twist]):
    """Wheels whose driver does nothing."""

    safe = Twist(0.0, 0.0)

    async def write(self, command: Twist) -> None:
        return None


class PlainUser(esair.Behavior):
    """Writes the motor whose driver is plain."""

    motor = esair.writes(float, name="plain_motor")


class Driver(esair.Behavior):
    """Writes the wheels."""

    wheels = esair.writes(Twist)


async def rows() -> list[Row]:
    user, driver, twist = User(), Driver(), Twist(0.3, 0.1)
    plain = PlainUser()
    robot = esair.Robot(
        resources=[Meter(rate=1.0), Motor(), Wheels(), PlainMotor()],
        behaviors=[user, driver, plain],
    )
    async with robot:

        async def read() -> float:
            await user.meter.read(fresh=True)
            begin = time.perf_counter()
            for _ in range(COUNT):
                await user.meter.read()
            return (time.perf_counter() - begin) / COUNT

        async def write() -> float:
            begin = time.perf_counter()
            for _ in range(COUNT):
                await user.motor.write(0.5)
            return (time.perf_counter() - begin) / COUNT

        async def write_plain() -> float:
            begin = time.perf_counter()
            for _ in range(COUNT):
                await plain.motor.write(0.5)
            return (time.perf_counter() - begin) / COUNT

        async def write_twist() -> float:
            begin = time.perf_counter()
            for _ in range(COUNT):
                await driver.wheels.write(twist)
            return (time.perf_counter() - begin) / COUNT

        found = []
        for case, operation, goal in (
            ("P3 read, the newest reading will do", read, 0.06),
            ("P4 write of a number", write, 0.3),
            ("P4 write of a number, plain driver", write_plain, 0.25),
            ("P4 write of a command with two fields", write_twist, None),
        ):
            mine, limit, ratio = await neighbors(operation, future_round_trip)
            found.append(Row(case, us(mine), f"F {us(limit)}", ratio, goal))
    return found
