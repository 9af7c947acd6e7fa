"""What happens to the rover, and when: the events of the show."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterator

import attrs

from esair.actions import Behavior, writes
from esair.demo._journeys import Explore, Home
from esair.demo._plan import Point
from esair.demo._samples import Witness
from esair.demo._values import Twist
from esair.drivers.wheel_motor import LEFT, RIGHT, command_id, decode_command
from esair.journal import Kind
from esair.loop import ask_outside
from esair.messages import BehaviorState, Refused, ResourceState
from esair.sim import Pillar, Simulation
from esair.standard import Robot

LOOK_PERIOD = 0.005  # How often it is looked whether something has happened, in seconds
OUTAGE = 2.5  # For how long the range finder is unplugged, in seconds
PATIENCE = 6.0  # How long to wait for what must happen, in seconds


@attrs.frozen
class Event:
    """Something that happened."""

    time: float  # In seconds since the show began
    # ``person``, ``unplug``, ``plug``, ``refuse``, ``swap``, ``bump`` or ``end``
    kind: str
    text: str  # What it was, in one line
    detail: str  # What came of it, in one line
    place: tuple[float, float]  # Where the rover was, in metres


@attrs.frozen
class Fault:
    """A fault and what it cost."""

    text: str
    noticed: float  # Until the robot knew, in seconds
    safe: float  # Until the last wheel had its stop frame, in seconds
    back: float  # From the return of the device to the first reading, in seconds
    moved: float  # From the return of the device to the first motion, in seconds
    cost: str  # What did not happen meanwhile

    def __str__(self) -> str:
        return (
            f"{self.text}: noticed after {_ms(self.noticed)}, wheels safe after "
            f"{_ms(self.safe)}, back after {_ms(self.back)}, fresh motion after "
            f"{_ms(self.moved)}; {self.cost}"
        )


class Passenger(Behavior):
    """Wants to drive too, but comes last."""

    wheels = writes(Twist, priority=-10)

    def __init__(self, *, name: str | None = None) -> None:
        super().__init__(name=name)
        self.answer: Refused | None = None

    async def run(self) -> None:
        """Ask for the wheels while somebody has them."""
        while self.answer is None:
            if self.wheels.why().holder is not None:
                outcome = await self.wheels.write(Twist(0.6, 0.0))
                if isinstance(outcome, Refused):
                    self.answer = outcome
                    return
            await asyncio.sleep(0.05)


class Story:
    """Lets the events happen, and tells what came of them."""

    def __init__(
        self,
        robot: Robot,
        simulation: Simulation,
        witness: Witness,
        tell: Callable[[Event], None],
        *,
        explore: Explore,
        duration: float,
    ) -> None:
        self.faults: list[Fault] = []  # What went wrong, and what it cost
        self.unmet: list[str] = []  # What should have happened and did not, in words
        self.explore = explore
        # The behavior that has taken its place; None before
        self.home: Home | None = None
        self._robot = robot
        self._simulation = simulation
        self._witness = witness
        self._tell = tell
        self._duration = duration
        self._loop = asyncio.get_running_loop()
        self._begin = self._loop.time()

    async def play(self) -> None:
        """Let everything happen, in its order."""
        await self._until(0.14 * self._duration)
        await self._step_in_the_way()
        await self._until(0.28 * self._duration)
        await self._lose_range_finder()
        await self._until(0.48 * self._duration)
        await self._refuse_passenger()
        await self._until(0.58 * self._duration)
        await self._send_home()

    # The events.

    async def _step_in_the_way(self) -> None:
        world, witness = self._simulation.world, self._witness
        await self._happens(
            "the rover drives on freely",
            lambda: (
                witness.told.linear > 0.4
                and not witness.is_braked
                and world.distance_ahead(0.0, 1.2) is None
            ),
        )
        at, place = self._loop.time(), self._place()
        goes = world.put(self._person(0.42))
        slowed = await self._happens("the brake slows", lambda: witness.is_braked)
        asked, told = witness.asked.linear, witness.told.linear
        goes()
        goes = world.put(self._person(0.34))
        await self._happens(
            "avoid takes the wheels",
            lambda: self._robot.resources.why("wheels").holder == "avoid",
        )
        self._happened(
            "person",
            at,
            place,
            "somebody steps in the way",
            f"the guard brake lets {told:.2f} of {asked:.2f} m/s pass after "
            f"{_ms(slowed)}; nearer still, avoid takes the wheels and turns away",
        )
        await asyncio.sleep(0.6)
        goes()

    def _person(self, ahead: float) -> Pillar:
        pose = self._simulation.world.pose
        x = pose.x + ahead * math.cos(pose.heading)
        return Pillar((x, pose.y + ahead * math.sin(pose.heading)), 0.12)

    async def _lose_range_finder(self) -> None:
        robot, simulation = self._robot, self._simulation
        blind_before = self.explore.blind
        unplugged, at = simulation.time, self._loop.time()
        place = self._place()
        simulation.front.unplug()
        await self._happens(
            "the loss is noticed",
            lambda: self._state("ranges") is not ResourceState.READY,
        )
        safe = await self._happens(
            "the wheels stop", lambda: self._stopped_since(unplugged) is not None
        )
        await self._happens(
            "avoid is parked", lambda: self._is("avoid", BehaviorState.PARKED)
        )
        reason, _, _ = robot.resources.why("wheels").rule.partition(":")
        lost = self._witness.turns.get(("ranges", Kind.DOWN), at) - at
        stopped = self._stopped_since(unplugged)
        safe = safe if stopped is None else stopped - unplugged
        self._happened(
            "unplug",
            at,
            place,
            "the range finder is unplugged",
            f"noticed after {_ms(lost)}, both wheels stopped after {_ms(safe)}; "
            f"the rover stands still because {reason}",
        )
        await self._until(at - self._begin + OUTAGE)
        moved_blind = self._moving_since(unplugged + safe)
        if moved_blind is not None:
            self.unmet.append("the wheels stand while the range finder is away")
        plugged, at = simulation.time, self._loop.time()
        place = self._place()
        simulation.front.plug()
        back = await self._happens(
            "the range finder is back", lambda: self._is("avoid", BehaviorState.RUNNING)
        )
        await self._happens(
            "a fresh command moves the wheels",
            lambda: self._moving_since(plugged) is not None,
        )
        moved = (self._moving_since(plugged) or plugged) - plugged
        back = min(back, moved)  # who moves has seen already, whenever it was looked
        holder = robot.resources.why("wheels").holder
        self._happened(
            "plug",
            at,
            place,
            "the range finder is plugged in again",
            f"back after {_ms(back)}, all resume; nothing moved before a fresh "
            f"command of {holder} after {_ms(moved)}",
        )
        missed = self.explore.blind - blind_before
        self.faults.append(
            Fault(
                "range finder unplugged",
                lost,
                safe,
                back,
                moved,
                f"{missed} commands of explore not made, avoid parked",
            )
        )

    async def _refuse_passenger(self) -> None:
        passenger = Passenger()
        at, place = self._loop.time(), self._place()
        await self._robot.behaviors.add(passenger)
        await self._happens(
            "the passenger is refused", lambda: passenger.answer is not None
        )
        await self._robot.behaviors.remove("passenger")
        answer = passenger.answer
        if answer is not None:
            self._happened(
                "refuse",
                at,
                place,
                "a passenger of priority -10 wants the wheels",
                f"refused: {answer.holder} holds them with priority {answer.priority}",
            )

    async def _send_home(self) -> None:
        at, place = self._loop.time(), self._place()
        x, y, _ = self._simulation.world.arena.start
        home = Home(place=(x, y))
        await self._robot.behaviors.replace("explore", home)
        self.home = home
        took = self._loop.time() - at
        self._happened(
            "swap",
            at,
            place,
            "the user replaces explore by a way home",
            f"done in {_ms(took)}, everything else kept running",
        )
        await self._happens(
            "the rover is at home",
            lambda: home.arrived,
            patience=self._duration - (self._loop.time() - self._begin),
            must=False,
        )
        await asyncio.sleep(0.5)
        where = "is home" if home.arrived else "is on its way home"
        self._happened(
            "end",
            self._loop.time(),
            self._place(),
            f"the rover {where}",
            "the robot stops; the wheels get their safe command last of all",
        )

    def _happened(
        self, kind: str, at: float, place: Point, text: str, detail: str
    ) -> None:
        self._tell(Event(at - self._begin, kind, text, detail, place))

    # What can be seen.

    def _place(self) -> Point:
        pose = self._simulation.world.pose
        return pose.x, pose.y

    def _state(self, resource: str) -> ResourceState:
        return self._robot.resources.query(resource).state

    def _is(self, behavior: str, state: BehaviorState) -> bool:
        return self._robot.behaviors.query(behavior).state is state

    def _commands_since(self, time: float) -> Iterator[tuple[float, int, bool]]:
        sides = {command_id(side): side for side in (LEFT, RIGHT)}
        recent: list[tuple[float, int, bool]] = []
        for when, frame in reversed(self._simulation.frames):
            if when < time:
                break
            if frame.id in sides:
                command = decode_command(sides[frame.id], frame.data)
                moves = command.enable and command.speed != 0.0
                recent.append((when, sides[frame.id], moves))
        return reversed(recent)

    def _stopped_since(self, time: float) -> float | None:
        """Return when the later wheel got a stop that nothing followed."""
        stopped: dict[int, float | None] = {LEFT: None, RIGHT: None}
        for when, side, moves in self._commands_since(time):
            if moves:
                stopped[side] = None
            elif stopped[side] is None:
                stopped[side] = when
        left, right = stopped[LEFT], stopped[RIGHT]
        return None if left is None or right is None else max(left, right)

    def _moving_since(self, time: float) -> float | None:
        return next(
            (when for when, _, moves in self._commands_since(time) if moves), None
        )

    # Time.

    async def _until(self, time: float) -> None:
        await asyncio.sleep(max(0.0, self._begin + time - self._loop.time()))

    async def _happens(
        self,
        what: str,
        condition: Callable[[], bool],
        *,
        patience: float = PATIENCE,
        must: bool = True,
    ) -> float:
        """Wait until something is so; return how long it took, in seconds."""
        begin = self._loop.time()
        tag = ("story", what)  # what a replay cannot see, the recording tells
        while not ask_outside(tag, condition):
            if self._loop.time() - begin > patience:
                if must:
                    self.unmet.append(what)
                break
            # It is the world that is looked at: nothing could tell when to look.
            await asyncio.sleep(LOOK_PERIOD)
        return self._loop.time() - begin


def _ms(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 1.0 else f"{1000 * seconds:.0f} ms"
