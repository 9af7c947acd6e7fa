"""The world, the parts and their wires together, on the event loop's clock.

The buses on these wires are what a configuration file names: those of esair itself, each
with a wire that starts the simulation.
"""

from __future__ import annotations

import asyncio
import collections
import shutil
import tempfile
import weakref
from collections.abc import Callable
from pathlib import Path

from esair.buses import Bus, CanBus, Frame, I2CBus, LateWire, SerialBus, Wire
from esair.buses.can import MemoryCan
from esair.buses.i2c import ChipBus
from esair.buses.serial import MemoryLine, PtyLine
from esair.exceptions import ConfigError, hint_for
from esair.loop import Door, Job, Scheduler, turn_of
from esair.sim._parts import SimBumper, SimMotor, SimMpu6050, SimRangeFinder
from esair.sim._world import Arena, World

STEP = 0.01  # How much time one step of the physics is, in seconds

CATCH_UP = 50
"""How many steps are made at once when the loop was held up; more are left out."""

FRAME_LIMIT = 100_000  # How many frames are kept; then the newest win


class Simulation:
    """A rover in its arena, and the ends of its wires.

    ========= =================  =============================================
    wire      what is on it      how the robot reaches it
    ========= =================  =============================================
    ``front`` range finder       `SimSerialBus`, a pseudo-terminal
    ``skirt`` bumper             `SimSerialBus`, a pseudo-terminal
    ``drive`` two motors         `SimCanBus`, in memory
    ``body``  MPU-6050 at 0x68   `SimI2CBus`, the methods of ``smbus2.SMBus``
    ========= =================  =============================================

    On a virtual clock all wires are in memory and carry the same bytes and frames.
    Use it as an async context manager, before the robot; a robot that is described
    by a file, and finds no simulation, starts one with its first bus.

    Args:
        arena: What there is in the world.
        seed: Decides all noise.

    Attributes:
        late: How many steps of the physics were left out.
        frames: The frames on the CAN bus with their times, the oldest first.
        on_frame: Called with the time and each frame; None if nobody cares.
    """

    def __init__(self, arena: Arena | None = None, *, seed: int = 0) -> None:
        loop = asyncio.get_running_loop()
        self.world: World = World(arena, seed=seed)
        self.in_memory: bool = turn_of(loop).virtual
        self.late: int = 0
        self.frames: collections.deque[tuple[float, Frame]] = collections.deque(
            maxlen=FRAME_LIMIT
        )
        self.on_frame: Callable[[float, Frame], None] | None = None
        self._loop = loop
        self._folder: Path | None = None
        if not self.in_memory:
            self._folder = Path(tempfile.mkdtemp(prefix="esair-sim-"))
        self.front: PtyLine | MemoryLine = self._make_line("front")
        self.skirt: PtyLine | MemoryLine = self._make_line("skirt")
        self.drive: MemoryCan = MemoryCan(self._heard)
        self._motors = [SimMotor(self.world, side, self._tell) for side in (0, 1)]
        self._imu = SimMpu6050(self.world, seed=seed)
        self.body: ChipBus = ChipBus({0x68: self._imu})
        self._range_finder = SimRangeFinder(self.world, self.front, seed=seed)
        self._bumper = SimBumper(self.world, self.skirt)
        self._began = 0.0
        self._steps = 0
        self._job: Job | None = None
        self._users: dict[object, None] = {}

    async def __aenter__(self) -> Simulation:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    @property
    def time(self) -> float:
        """How long it has been running, in seconds of the loop's clock."""
        return self._loop.time() - self._began

    async def start(self) -> None:
        """Plug everything in and let time pass; in a replay nothing of that is there."""
        if Door.of(self._loop).player is not None:
            return
        _of_loop[self._loop] = self
        self.front.plug()
        self.skirt.plug()
        self._began = self._loop.time()
        self._job = Scheduler.beside(self._loop).every(STEP, self._turn)

    async def stop(self) -> None:
        """Let time stand still and let all wires go."""
        if _of_loop.get(self._loop) is self:
            del _of_loop[self._loop]
        if self._job is not None:
            self._job.stop()
        self.front.unplug()
        self.skirt.unplug()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def line(self, name: str) -> PtyLine | MemoryLine:
        """Return a serial line by its name.

        Raises:
            ConfigError: There is no such line.
        """
        lines = {"front": self.front, "skirt": self.skirt}
        if name not in lines:
            told = f"no line is named {name!r:.80}{hint_for(name, lines)}"
            raise ConfigError("simulation", "line", told)
        return lines[name]

    def _make_line(self, name: str) -> PtyLine | MemoryLine:
        return (
            MemoryLine(name) if self._folder is None else PtyLine(self._folder / name)
        )

    def _turn(self, _now: float) -> None:
        due = int((self._loop.time() - self._began) / STEP + 1e-6)
        missed = due - self._steps - CATCH_UP
        if missed > 0:
            self.late += missed
            self._steps += missed
        while self._steps < due:
            self._steps += 1
            self.world.step(STEP)
            self._imu.step()
            for motor in self._motors:
                motor.step()
            self._bumper.step()
            self._range_finder.step()

    def _heard(self, frame: Frame) -> None:
        self._note(frame)
        for motor in self._motors:
            motor.receive(frame)

    def _tell(self, frame: Frame) -> None:
        self._note(frame)
        self.drive.send(frame)

    def _note(self, frame: Frame) -> None:
        now = self.time
        self.frames.append((now, frame))
        if self.on_frame is not None:
            self.on_frame(now, frame)

    @classmethod
    async def join(cls, user: object) -> Simulation:
        """Return the simulation of the running loop; the first user starts it.

        It ends with `leave` of the last user, unless somebody else had started it.
        """
        loop = asyncio.get_running_loop()
        found = _of_loop.get(loop)
        if found is None:
            found = cls()
            found._users[user] = None
            await found.start()  # in one step: two who join at once share it
        elif found._users:
            found._users[user] = None
        return found

    async def leave(self, user: object) -> None:
        """Need the simulation no more."""
        if user in self._users:
            del self._users[user]
            if not self._users:
                await self.stop()


_of_loop: weakref.WeakKeyDictionary[asyncio.AbstractEventLoop, Simulation] = (
    weakref.WeakKeyDictionary()
)


def _wire(choose: Callable[[Simulation], Wire]) -> Wire:
    """Return a wire of the simulation, which ends with its last bus."""
    used: dict[Bus, Simulation] = {}

    async def find(bus: Bus) -> Wire:
        simulation = used[bus] = await Simulation.join(bus)
        return choose(simulation)

    async def left(bus: Bus) -> None:
        simulation = used.pop(bus, None)
        if simulation is not None:
            await simulation.leave(bus)

    return LateWire(find, left)


class SimSerialBus(SerialBus):
    """The serial bus, on a line of the simulation.

    Args:
        name: The name of the bus.
        line: ``front`` (range finder) or ``skirt`` (bumper).
        baudrate: Bits per second; a pseudo-terminal does not care.
        framing: Where a message ends: the parts on these lines talk in sentences.
    """

    def __init__(
        self,
        *,
        name: str,
        line: str = "front",
        baudrate: int = 115200,
        framing: str = "nmea",
    ) -> None:
        wire = _wire(lambda simulation: simulation.line(line))
        super().__init__(name=name, baudrate=baudrate, framing=framing, wire=wire)


class SimCanBus(CanBus):
    """The CAN bus, with the two motor controllers of the simulation on it."""

    def __init__(self, *, name: str) -> None:
        wire = _wire(lambda simulation: simulation.drive)
        super().__init__(name=name, wire=wire)


class SimI2CBus(I2CBus):
    """The I²C bus, with the inertial unit of the simulation on it."""

    def __init__(self, *, name: str) -> None:
        super().__init__(name=name, wire=_wire(lambda simulation: simulation.body))
