"""Behaviors that do what a test tells them in plain data: in the robot's process, or not."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any, Final

import attrs

import esair
import esair.minimal as emin


class Go(esair.Behavior):
    """Drives for a while, and says how it was."""

    wheels = esair.writes(float, priority=7)

    def __init__(self, speed: float, seconds: float, error: str = "") -> None:
        super().__init__()
        self.speed, self.seconds, self.error = speed, seconds, error
        self.story: list[str] = []

    async def setup(self) -> None:
        self.story.append("setup")
        if self.error == "setup":
            raise StepError(self.error)

    async def run(self) -> list[str]:
        end = esair.now() + self.seconds
        async for _ in esair.every(0.05):
            if esair.now() >= end:
                break
            await self.wheels.write(self.speed)
        if self.error:
            raise StepError(self.error)
        return self.story

    async def teardown(self) -> None:
        self.story.append("teardown")


class Unheeding(esair.Behavior):
    """Drives, and heeds no cancellation."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        while True:
            with contextlib.suppress(asyncio.CancelledError):
                await self.wheels.write(0.5)
                await asyncio.sleep(0.05)


class StepError(Exception):
    """No error that crosses by its class; its reason does."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class PlainGo(esair.ThreadBehavior):
    """Drives in a thread, with a step of its own."""

    wheels = esair.writes(float)

    def run(self) -> str:
        self.wheels.write(0.7)
        story = self.perform(Go(0.5, 0.2))
        return f"plain, {story[0]}"


class Arm(Go):
    arm = esair.writes(float)


class Registers(esair.Behavior):
    """Asks for its port while it runs."""

    async def run(self) -> bool:
        wheels = await self.register("wheels", esair.Access.WRITE, priority=9)
        return bool(await wheels.write(0.9)) and wheels.why().priority == 3


class Elsewhere(esair.Behavior):
    placement = "process"


class Ages(esair.Reaction):
    """Says how old what it decides on is, from 1 on."""

    sonar = esair.reads(float, max_age=1.0)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return 1.0 + (esair.now() - self.sonar.newest.time)  # type: ignore[union-attr]


class AgesAsStep(esair.Behavior):
    """The same, performed."""

    sonar = esair.reads(float, max_age=1.0)
    wheels = esair.writes(float)

    async def run(self) -> None:
        await self.perform(Ages())


class Follow(esair.Reaction):
    """Goes as fast as it sees; counts its steps."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.writes(float, priority=10)

    def __init__(self, fail_at: int = 0) -> None:
        super().__init__()
        self.fail_at = fail_at
        self.steps = 0

    def react(self, sonar: float) -> float:
        self.steps += 1
        if self.steps == self.fail_at:
            raise StepError("react")
        return sonar


class SmallFollow(emin.Reaction):
    sonar = emin.reads(float)
    wheels = emin.writes(float, priority=10)

    def react(self, sonar: float) -> float:
        return sonar


class Stop(esair.Reaction):
    wheels = esair.guards(float)

    def react(self, wheels: float) -> float:
        return 0.0


@attrs.frozen
class Number(esair.Request[int]):
    """Some number."""


class Acts(esair.Behavior):
    """Does one thing after another, as a test says, and offers what came of it.

    An act is a verb and its arguments; an error is its class and its text.
    """

    wheels = esair.writes(float, priority=3)
    outbox_size = 64

    def __init__(self, *acts: tuple[Any, ...], name: str | None = None) -> None:
        super().__init__(name=name)
        self.acts = acts

    async def run(self) -> None:
        for verb, *given in self.acts:
            try:
                outcome = await getattr(self, f"do_{verb}")(*given)
            except (Exception, ExceptionGroup) as error:
                outcome = type(error).__name__, str(error)
            self.offer(outcome)
        await asyncio.get_running_loop().create_future()

    async def do_perform(self, kind: str, *given: Any, **options: Any) -> Any:
        step = globals()[kind](*given)
        return await self.perform(step, **options)

    async def do_perform_for(self, timeout: float, kind: str, *given: Any) -> Any:
        step = globals()[kind](*given)
        try:
            return await self.perform(step, timeout=timeout)
        finally:
            self.offer(getattr(step, "story", None))

    async def do_follow(self, until: float, timeout: float | None = None) -> Any:
        step = Follow()
        over = await self.perform(
            step, until=lambda sonar: sonar < until, timeout=timeout
        )
        return over, step.steps > 0

    async def do_perform_blind(self) -> Any:
        return await self.perform(Follow(), blind_timeout=1.0)

    async def do_small(self, until: float) -> bool:
        return await self.perform(SmallFollow(), until=lambda sonar: sonar < until)

    async def do_group(self) -> str:
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.perform(Go(0.5, 100.0)))
                group.create_task(self.perform(Go(0.0, 0.3, "bang")))
        except* StepError as errors:
            told = str(errors.exceptions[0])
        return told

    async def do_again(self) -> Any:
        go = Go(0.5, 0.1)
        return [len(await self.perform(go)) for _ in range(2)]

    async def do_at_once(self) -> None:
        go = Go(0.5, 1.0)
        async with asyncio.TaskGroup() as group:
            group.create_task(self.perform(go))
            await asyncio.sleep(0.1)
            await self.perform(go)

    async def do_write_twice(self, apart: float) -> None:
        async with asyncio.TaskGroup() as group:
            for seconds in (0.5, 0.5 + apart):
                group.create_task(self.do_write_after(seconds))

    async def do_write_after(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        await self.wheels.write(seconds)

    async def do_draw(self) -> float:
        return esair.random.random()

    async def do_why(self) -> str:
        return self.wheels.why().holder or ""

    async def do_write(self, speed: float) -> bool:
        return bool(await self.wheels.write(speed))

    async def do_manage(self, verb: str, *given: Any) -> Any:
        made = [self._made(each) for each in given]
        return await getattr(self.supervisor, verb)(*made)

    def _made(self, given: Any) -> Any:
        if isinstance(given, str):
            return given
        kind, *args = given
        return globals()[kind](*args, **({"name": "second"} if kind == "Acts" else {}))

    async def do_query(self, name: str) -> str:
        return self.supervisor.query(name).state.value

    async def do_put(self, receiver: str, data: Any, interval: float) -> None:
        await self.put(receiver, data, interval)

    async def do_get(self, sender: str, interval: float) -> Any:
        return await self.get(sender, interval)

    async def do_receive(self, timeout: float) -> Any:
        return list(await self.receive_from(timeout=timeout))

    async def do_ask(self, receiver: str, timeout: float) -> Any:
        news: list[Any] = []
        answer = await self.ask(
            receiver, Number(), timeout=timeout, progress=news.append
        )
        return answer, news

    async def do_sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def do_fail(self, text: str) -> None:
        raise SystemExit(text)


class Gets(esair.Behavior):
    """Gets something of another, while one more task of it does something else."""

    sonar = esair.reads(float)

    def __init__(self, name: str, other: str, beside: str = "") -> None:
        super().__init__(name=name)
        self.other, self.beside = other, beside

    async def setup(self) -> None:
        self.free = asyncio.Event()

    async def run(self) -> None:
        if self.beside:
            await self.sonar.read()  # then the next one comes at once
            await asyncio.sleep(0.1)  # who is asked waits for this one by then
        other = getattr(self, self.beside)() if self.beside else None
        task = None if other is None else asyncio.create_task(other)
        await asyncio.sleep(0)  # the other one begins
        try:
            told = await self.get(self.other, 3.0)
        except esair.EsairError as error:
            told = type(error).__name__, str(error)
        await self.put("told", (self.name, told, esair.now()))
        if task is not None:
            task.cancel()
        await self.wait_for_ever()

    async def sleeps(self) -> None:
        await asyncio.sleep(1.0)
        self.offer("after a while")

    async def hears(self) -> None:
        await self.receive()
        self.offer("as it was told")

    async def looks(self) -> None:
        await self.sonar.read()
        self.offer("as it was seen")

    async def wait_for_ever(self) -> None:
        await self.free.wait()


class PlainGets(esair.ThreadBehavior):
    """The same in a thread."""

    def __init__(self, name: str, other: str, beside: str = "") -> None:
        super().__init__(name=name)
        self.other = other

    def run(self) -> None:
        try:
            told: Any = self.get(self.other, 3.0)
        except esair.EsairError as error:
            told = type(error).__name__, str(error)
        self.put("told", (self.name, told, esair.now()))
        self.receive()


class Told(esair.Behavior):
    """Keeps what it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.all: list[Any] = []

    async def run(self) -> None:
        while True:
            self.all.append(await self.receive())


class Gives(esair.Behavior):
    """Makes what it is asked for."""

    async def run(self) -> None:
        self.offer([1])
        self.offer([2])
        await asyncio.get_running_loop().create_future()

    async def provide(self) -> float:
        return 3.5


class Waits(esair.Behavior):
    """Its inbox has one place, and nobody takes what lies there."""

    inbox_size = 1


class Crashes(esair.Behavior):
    """Takes what it is told, and fails."""

    restart = esair.Restart(max=1, delay=0.1)
    wheels = esair.writes(float, priority=1)

    async def run(self) -> None:
        await self.wheels.write(0.4)
        raise StepError(str(await self.receive()))


class Worker(esair.Behavior):
    """Answers requests one after the other; a mood decides how."""

    numbers = esair.takes(Number, queue=2)
    inbox_size = 4

    def __init__(self, mood: str = "", name: str | None = None) -> None:
        super().__init__(name=name)
        self.mood = mood

    async def run(self) -> None:
        async for request in self.numbers:
            async with request:
                await self.work(request)

    async def work(self, request: Any) -> None:
        request.progress("begun")
        try:
            await asyncio.sleep(1e6 if self.mood == "slow" else 0.2)
        finally:
            self.offer("done", latest=True)
        if self.mood == "refuse":
            request.refuse("no time")
        elif self.mood == "fail":
            raise ValueError("it cannot count")
        elif self.mood == "end":
            raise SystemExit(3)
        elif self.mood != "forget":
            request.answer(42)


class Values(esair.Sensor[float]):
    """Polled; each value is higher than the one before."""

    value = 0.0
    gain = esair.setting(1.0, min=0.5, max=4.0)

    async def read(self) -> float:
        self.value += self.gain
        return self.value

    async def apply(self, **settings: Any) -> None:
        """There is no device to tell."""

    @esair.operation
    async def zero(self) -> str:
        self.value = 0.0
        return "zeroed"


class Opens(Values):
    """Tells with which gain it was opened, in its own device."""

    opened = 0.0

    async def open(self) -> None:
        self.opened = self.gain

    async def read(self) -> float:
        return self.opened

    @esair.operation
    async def unplug(self) -> str:
        self.report_lost(ConnectionError("unplugged"))
        return "unplugged"


class Falls(esair.Behavior):
    """Takes an error by its name, and fails of it."""

    restart = esair.Restart(max=0)

    async def run(self) -> None:
        raise ERRORS[await self.receive()]


ERRORS: Final = {
    "value": ValueError("no such place"),
    "bad": esair.BadValueError("falls", "place", "there is none"),
    "exit": SystemExit(3),
    "break": KeyboardInterrupt(),
}
LEAVES: Final = {"exit": SystemExit(3), "cancel": asyncio.CancelledError()}


class Leaves(esair.Sensor[float]):
    """Raises in its `open` what would end a program, or a task."""

    def __init__(self, how: str, **settings: Any) -> None:
        super().__init__(**settings)
        self.how = how

    async def open(self) -> None:
        raise LEAVES[self.how]

    async def read(self) -> float:
        return 0.0


class PlainLeaves(Leaves):
    """The same, as it is written with plain methods."""

    def open(self) -> None:  # type: ignore[override]
        raise LEAVES[self.how]


class Deaf(esair.Sensor[float]):
    """Pushes one value, and does not hear of its end."""

    async def stream(self) -> AsyncIterator[float]:
        yield 1.0
        for _ in range(2):
            try:
                await asyncio.sleep(1e6)
            except asyncio.CancelledError:
                continue


class Pushed(esair.Sensor[float]):
    """Pushes each value."""

    async def stream(self) -> AsyncIterator[float]:
        value = 0.0
        while True:
            value += 1.0
            yield value
            await asyncio.sleep(0.05)
