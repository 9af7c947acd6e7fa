"""A rover on two serial lines that turns back at a fence: a GPS, and a motor board.

Without arguments both lines are fakes, so it runs on any computer. With two arguments
they are real ports::

    python gps_fence.py usb:1546:01a7 usb:2341:0043

The GPS speaks NMEA sentences, the board lines of text: ``speed=0.5`` is a command.
`Fence` is a reaction with the higher priority: it takes the motor from `Explore` outside
the fence, and gives it back well inside.
"""

import sys

import attrs

import esair
from esair.buses import SerialBus
from esair.drivers.gps import Fix, Gps
from esair.drivers.line import LineActuator

METRES_PER_DEGREE = 111_195.0
"""Of latitude."""

FENCE = 20.0
"""How far from its home the rover may go, in metres."""


class Explore(esair.Behavior):
    """Drives north, as fast as it may, and never blind."""

    position = esair.reads(Fix, max_age=1.0)
    speed = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            try:
                await self.position.read()
            except (esair.DeviceLostError, esair.StaleReadingError):
                continue  # nobody writes: the motor gets its safe command
            await self.speed.write(2.0)


class Fence(esair.Reaction):
    """Drives back south from the fence until it is well inside."""

    position = esair.reads(Fix, max_age=1.0)
    speed = esair.writes(float, priority=10)

    home: float | None = None
    going_back = False

    def react(self, position: Fix) -> float | None:
        if self.home is None:
            self.home = position.latitude_deg
        distance = (position.latitude_deg - self.home) * METRES_PER_DEGREE
        if distance > FENCE:
            self.going_back = True
        elif distance < FENCE / 2:
            self.going_back = False
        return -1.0 if self.going_back else None


class Report(esair.Behavior):
    """Prints where the rover is."""

    position = esair.reads(Fix)

    async def run(self) -> None:
        async for seconds in esair.every(0.25):
            fix = await self.position.read(timeout=5.0)
            print(f"{seconds:4.2f} s: {fix.latitude_deg:.6f}°", flush=True)


def make_robot(gps: SerialBus, board: SerialBus) -> esair.Robot:
    """Return the robot on its two lines."""
    return esair.Robot(
        resources=[
            Gps(name="position", bus=gps),
            LineActuator(name="speed", safe=0.0, limits=(-2.0, 2.0), bus=board),
        ],
        behaviors=[Explore(), Fence(), Report()],
    )


def fake_lines(*, haste: float = 1.0) -> tuple[SerialBus, SerialBus]:
    """Return two lines with a rover that moves as the board is told.

    Args:
        haste: How much faster than a real rover it is.
    """
    from esair.drivers.gps.fake import FakeGps
    from esair.drivers.line.fake import FakeBoard
    from esair.testing import FakeSerial

    gps, board = FakeSerial("gps", framing="nmea"), FakeSerial("board")
    motor = FakeBoard(board, commands={"speed": 0.0})
    receiver = FakeGps(gps, Fix(48.1, 11.5, altitude=500.0, quality=1))

    def drive() -> bytes:
        north = motor.commands["speed"] * 0.1 * haste / METRES_PER_DEGREE
        fix = receiver.fix
        receiver.fix = attrs.evolve(fix, latitude_deg=fix.latitude_deg + north)
        return b""

    gps.repeat(drive, 0.1)
    return gps, board


robot = make_robot(
    SerialBus(name="gps", port="/dev/ttyUSB0", baudrate=9600, framing="nmea"),
    SerialBus(name="board", port="/dev/ttyACM0"),
)

if __name__ == "__main__":
    if len(sys.argv) == 3:
        position = SerialBus(
            name="gps", port=sys.argv[1], baudrate=9600, framing="nmea"
        )
        esair.run(make_robot(position, SerialBus(name="board", port=sys.argv[2])))
    else:
        esair.run(make_robot(*fake_lines(haste=20.0)), duration=3.0)
