"""A port belongs to its robot's event loop: another one gets an error that says so."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

import esair
from esair.loop import TurnLoop
from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.promise("CALL-4")


class Wheels(FakeActuator[float]):
    """Remember in which threads their driver was called."""

    threads: set[int]

    @esair.operation
    async def home(self) -> None:
        """Go home."""
        self.threads.add(threading.get_ident())

    async def write(self, command: float) -> None:
        self.threads.add(threading.get_ident())
        await super().write(command)


class Sonar(FakeSensor[float]):
    """Remembers in which threads its driver was called."""

    threads: set[int]

    async def read(self) -> float:
        self.threads.add(threading.get_ident())
        return await super().read()


class Wander(esair.Behavior):
    """Has ports, and keeps them for others."""

    wheels = esair.writes(float, configure=True)
    sonar = esair.reads(float)

    async def run(self) -> None:
        await asyncio.Event().wait()


async def each(port: Any) -> Any:
    return await anext(aiter(port))


USES: dict[str, Callable[[Wander], Awaitable[object]]] = {
    "write": lambda it: it.wheels.write(0.9),
    "release": lambda it: it.wheels.release(),
    "operate": lambda it: it.wheels.operate("home"),
    "configure": lambda it: it.wheels.configure(),
    "read": lambda it: it.sonar.read(),
    "fresh": lambda it: it.sonar.read(fresh=True),
    "reading": lambda it: it.sonar.reading(),
    "each": lambda it: each(it.sonar),
}


async def foreign(use: Callable[[Wander], Awaitable[object]], it: Wander) -> object:
    """Use a port in a loop of its own, as somebody in a thread may try."""

    async def inside() -> object:
        return await use(it)

    try:
        return await asyncio.to_thread(asyncio.run, inside())
    except Exception as error:
        return error


@pytest.mark.parametrize("factory", [TurnLoop, asyncio.SelectorEventLoop])
def test_a_foreign_loop_reaches_no_driver(factory: Any) -> None:
    """Whatever it calls, it hears what to use instead; nothing was checked or sent."""
    home = threading.get_ident()
    wheels, sonar = Wheels("wheels", safe=0.0), Sonar("sonar", 1.0, type=float)
    wheels.threads, sonar.threads = set(), set()

    async def main() -> dict[str, object]:
        wander = Wander()
        async with esair.Robot(
            resources=[wheels, sonar], behaviors=[wander], policies=[ALL]
        ) as robot:
            heard = {name: await foreign(use, wander) for name, use in USES.items()}
            right = await robot.resources.register(
                wander, wheels, esair.Access.WRITE, priority=3
            )
            connection = robot.actuators
            heard["connection"] = await foreign(
                lambda _: connection.write(right, 0.9), wander
            )
            assert await wander.wheels.write(0.1)
            assert await wander.sonar.read() == 1.0
        return heard

    with asyncio.Runner(loop_factory=factory) as runner:
        heard = runner.run(main())
    for name, error in heard.items():
        assert isinstance(error, esair.WrongLoopError), (name, error)
        assert isinstance(error, RuntimeError)
        assert "ThreadBehavior" in str(error)
    assert wheels.threads == {home}
    assert sonar.threads == {home}
    assert 0.9 not in wheels.commands


ALL = esair.Policy("wheels", allow={"*": esair.Access.WRITE | esair.Access.CONFIGURE})


@pytest.mark.virtual_clock
async def test_the_ports_of_a_thread_behavior_wait() -> None:
    """What the error names works."""
    told: list[object] = []

    class Thread(esair.ThreadBehavior):
        wheels = esair.writes(float)

        def run(self) -> None:
            told.append(bool(self.wheels.write(0.5)))
            self.wheels.release()

    wheels = FakeActuator("wheels", safe=0.0)
    async with esair.Robot(resources=[wheels], behaviors=[Thread()]):
        await wheels.until(0.5, timeout=1.0)
    assert told == [True]
