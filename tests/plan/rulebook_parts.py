"""Parts of robots with one mistake each, for files, scripts and running robots."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy

import esair
from esair.buses import CanBus, I2CBus

if TYPE_CHECKING:
    from somewhere import Unknown  # type: ignore[import-not-found]


class Sonar(esair.Sensor[float]):
    async def read(self) -> float:
        return 1.0


class Slow(Sonar):
    rate = esair.setting(1.0, unit="Hz", min=0.1, max=100.0)


class Bumper(esair.Sensor[bool]):
    async def stream(self) -> AsyncIterator[bool]:
        yield True


class Wheels(esair.Actuator[float]):
    safe = 0.0

    async def write(self, command: float) -> None: ...


class Drive(esair.Behavior):
    wheels = esair.writes(float)


class Brake(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=10)

    def react(self, sonar: float) -> float | None:
        return 0.0 if sonar < 0.4 else None


class Annotated(Brake):
    """Every way to annotate a parameter that fits."""

    def react(self, sonar: esair.Reading[float] | float | None) -> float | None:
        return None


class Unresolved(Brake):
    """A type that only a type checker can see is no mistake."""

    def react(self, sonar: Unknown) -> float | None:
        return None


# Mistakes of a resource.


class Unsafe(esair.Actuator[float]):
    async def write(self, command: float) -> None: ...


class NoTimeout(Wheels):
    command_timeout = 0.0


class OutsideLimits(Wheels):
    limits = (1.0, 2.0)


class UpsideDown(Wheels):
    limits = (1.0, -1.0)


class Backwards(Wheels):
    slew = -1.0


class TakesNothing(Wheels):
    async def write(self) -> None: ...  # type: ignore[override]


class WriteYields(Wheels):
    async def write(self, command: float) -> Any:  # type: ignore[override]
        yield command


class Mute(esair.Actuator[float]):
    safe = 0.0


class Deaf(esair.Sensor[float]): ...


class ReadAsks(esair.Sensor[float]):
    async def read(self, channel: int) -> float:  # type: ignore[override]
        return 1.0


class ReadYields(esair.Sensor[float]):
    async def read(self) -> Any:
        yield 1.0


class StreamAsks(esair.Sensor[float]):
    async def stream(self, channel: int) -> Any:  # type: ignore[override]
        yield 1.0


class StreamReturns(esair.Sensor[float]):
    async def stream(self) -> Any:  # type: ignore[override]
        return 1.0


class OpenAsks(Sonar):
    async def open(self, path: str) -> None: ...  # type: ignore[override]


class ApplyAsks(Sonar):
    async def apply(self, gain: int) -> None: ...  # type: ignore[override]


class Unbound(Sonar):
    gain = esair.setting(1.0, max=math.nan)


class NoneFits(Sonar):
    mode = esair.setting("fast", choices=("slow", "slower"))


class Hasty(Sonar):
    deadline = 0.0


class Nobody(Sonar):
    identity = "serial 7"


class Repeats(Sonar):
    max_repeat = 0


class NeverFaulty(Sonar):
    fault_limit = 0


class WithoutPast(Sonar):
    history_size = 0


class LessThanNothing(Sonar):
    traffic = -1


class Promised(Sonar):
    period: Any = "soon"


class Inverted(Sonar):
    limits = (3.0, 1.0)


class NoSuchField(Sonar):
    limits = {"left": (0.0, 1.0)}  # noqa: RUF012 - as users write it


class Twist(NamedTuple):
    linear: float


class PairForOne(esair.Sensor[Twist]):
    limits = (0.0, 1.0)

    async def read(self) -> Twist:
        return Twist(0.0)


class SaysAWord(esair.Sensor[float]):
    initial: Any = "far"

    async def stream(self) -> AsyncIterator[float]:
        yield 1.0


class SaysTooMuch(SaysAWord):
    initial = 9.0
    limits = (0.0, 1.0)


class Clamps(Wheels):
    clamp: Any = "yes"


class PairForAll(esair.Actuator[dict[str, float]]):
    safe = {"left": 0.0}  # noqa: RUF012 - as users write it
    limits = (-1.0, 1.0)

    async def write(self, command: dict[str, float]) -> None: ...


class PairForArray(esair.Actuator[numpy.ndarray]):
    safe = numpy.zeros(2)
    limits = (-1.0, 1.0)

    async def write(self, command: numpy.ndarray) -> None: ...


class OnAWord(Sonar):
    bus = "front"


class Chip(Sonar):
    bus: I2CBus


class Node(Wheels):
    bus: CanBus
    claim = "node 1"


# Mistakes of an action.


class BadName(Brake):
    sonar = esair.reads(float, name="Front Sonar")


class BadType(Brake):
    sonar = esair.reads("sonar")  # type: ignore[arg-type,var-annotated]


class BadNumber(Brake):
    sonar = esair.reads(float, name=3)  # type: ignore[arg-type]


class BadFlag(Brake):
    sonar = esair.reads(float, optional="no")  # type: ignore[arg-type]


class GuardsItself(esair.Behavior):
    wheels = esair.guards(float)


class BadEvery(esair.Behavior):
    sonar = esair.reads(float, every=True)


class Order(esair.Request[int]):
    """What a worker is asked."""


class BadTaker(Brake):
    orders = esair.takes(Order)


class AnswersAsSensor(Sonar):
    @esair.answers
    async def order(self, request: Order) -> int:
        return 1


class HasPort(Sonar):
    other = esair.reads(float)


class HasSetting(Drive):
    speed = esair.setting(0.3)


class HasOperation(Drive):
    @esair.operation
    async def home(self) -> None: ...


class NoMethod(Sonar):
    @esair.operation
    @staticmethod
    async def tare() -> None: ...


class StaticAbove(Sonar):
    @staticmethod
    @esair.operation
    async def tare() -> None: ...


class NoSelf(esair.Sensor[float]):
    async def read() -> float:  # type: ignore[misc]
        return 1.0


class Hides(Drive):
    async def run(self) -> None:
        self.wheels = 1.0  # type: ignore[assignment]


class ReactHides(Brake):
    def react(self, sonar: float) -> float | None:
        self.wheels = 0.0  # type: ignore[assignment]
        return None


class NoReaction(Drive):
    def react(self) -> float:
        return 1.0


class AnswersReact(esair.Behavior):
    @esair.answers
    async def react(self, request: Order) -> int:
        return 1


class TakesOne(esair.Behavior):
    orders = esair.takes(Order, queue=1)


class ReadsReact(esair.Behavior):
    react = esair.reads(float, name="sonar")


class OnlyAnnotated(Drive):
    speed: esair.writes(float)  # type: ignore[valid-type]


class NotCalled(esair.Behavior):
    wheels = esair.writes


class AsyncThread(esair.ThreadBehavior):
    async def run(self) -> None: ...  # type: ignore[override]


class BadAnswers(esair.Behavior):
    @esair.answers
    async def order(self, request: Order) -> int:  # type: ignore[misc]
        yield 1


class BadAge(Brake):
    sonar = esair.reads(float, max_age=0.0)


class BadHold(Drive):
    wheels = esair.writes(float, hold=-1.0)


class BadPriority(Drive):
    wheels = esair.writes(float, priority=1.5)  # type: ignore[arg-type]


class BadRate(Brake):
    rate = -1.0


class BadBudget(Brake):
    budget = 0.0


class BadLimit(Brake):
    overrun_limit = -1


class BadRestart(Drive):
    restart = 3  # type: ignore[assignment]


class BadInbox(Drive):
    inbox_size = 0


class BadOutbox(Drive):
    outbox_policy = "perhaps"  # type: ignore[assignment]


class NeverRuns(esair.Reaction):
    wheels = esair.writes(float)

    def react(self) -> float:
        return 1.0


class InInit(Drive):
    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.sonar = esair.reads(float)


class Twice(Brake):
    other = esair.writes(float, name="wheels", priority=10)
    third = esair.writes(float, name="wheels", priority=-1)


class NoReact(esair.Reaction):
    sonar = esair.reads(float)


class AsyncReact(Brake):
    async def react(self, sonar: float) -> float | None:  # type: ignore[override]
        return None


class ReactYields(Brake):
    def react(self, sonar: float) -> Any:
        yield 1.0


class ReactMisses(Brake):
    def react(self, sonra: float) -> float | None:  # type: ignore[override]
        return None


class ReactMistyped(Brake):
    def react(self, sonar: str) -> float | None:  # type: ignore[override]
        return None


class ReactReadingMistyped(Brake):
    def react(self, sonar: esair.Reading[str]) -> float | None:  # type: ignore[override]
        return None


class ReactMaybeMistyped(Brake):
    def react(self, sonar: bytes | None) -> float | None:  # type: ignore[override]
        return None


class RunAsks(Drive):
    async def run(self, speed: float) -> None: ...  # type: ignore[override]


class RunYields(Drive):
    async def run(self) -> Any:  # type: ignore[override]
        yield 1


class Unknown_(Brake):  # noqa: N801 - what it names is unknown
    sonar = esair.reads(float, name="sonra")


class ReadsWheels(Brake):
    sonar = esair.reads(float, name="wheels")


class WritesSonar(Drive):
    wheels = esair.writes(float, name="sonar")


class WritesText(Drive):
    wheels = esair.writes(str)  # type: ignore[assignment]


class TooYoung(Brake):
    sonar = esair.reads(float, max_age=0.1)


class Bumped(esair.Reaction):
    bumper = esair.reads(bool)
    wheels = esair.writes(float, priority=20)

    def react(self, bumper: bool) -> float | None:
        return 0.0 if bumper else None
