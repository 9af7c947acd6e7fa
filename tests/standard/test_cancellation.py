"""Cancellation at every await of every public coroutine leaves everything whole.

Each operation is run again and again in a fresh world, and cancelled at its first
suspension, its second, and so on, until a run ends untouched: while it waits
(*pending*), in the tick in which what it waits for is done (*raced*), and a second
time while it cleans up (*twice*).
"""

from __future__ import annotations

import asyncio
import sys
import types
from collections.abc import Callable, Coroutine, Generator
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator, FakeSensor, VirtualLoop

MODES = ("pending", "raced", "twice")
CONDITIONS = ("idle", "busy", "slow", "removed")
SUSPENSIONS = 300
"""No operation suspends more often than this."""


@types.coroutine
def drive(
    coroutine: Coroutine[Any, Any, Any],
    k: int,
    mode: str,
    seen: list[int],
    told: list[bool],
) -> Generator[Any, Any, Any]:
    """Run a coroutine in the current task, and cancel it at its k-th suspension.

    Args:
        coroutine: What to run.
        k: Where to cancel it.
        mode: How to cancel it.
        seen: Counts its suspensions.
        told: For each cancellation, whether it came before the task had ended.
    """
    me = asyncio.current_task()
    assert me is not None
    send: Callable[[Any], Any] = coroutine.send
    argument: Any = None
    while True:
        try:
            future = send(argument)
        except StopIteration as stop:
            return stop.value
        seen[0] += 1
        if seen[0] == k or (mode == "twice" and seen[0] == k + 1):
            if mode == "raced" and future is not None:
                future.add_done_callback(lambda _: told.append(me.cancel()))
            else:
                told.append(me.cancel())
        try:
            argument, send = (yield future), coroutine.send
        except BaseException as error:
            argument, send = error, coroutine.throw


class Idle(esair.Behavior):
    """Does nothing: tests act in its name."""


class Peer(esair.Behavior):
    """Takes one piece of data at a time, and makes data on demand."""

    inbox_size = 1
    pause = 0.0

    async def provide(self) -> str:
        await asyncio.sleep(self.pause)
        return "made"


class Guest(esair.Behavior):
    """Comes and goes; it uses both devices."""

    sonar = esair.reads(float)
    wheels = esair.writes(float, priority=-1)

    def __init__(self, pause: float = 0.0) -> None:
        super().__init__(name="guest")
        self.pause = pause

    async def setup(self) -> None:
        await asyncio.sleep(self.pause)
        await self.register("sonar", esair.Access.READ, max_age=1.0)

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            try:
                await self.wheels.write(-1.0)
            except (esair.DriverStuckError, esair.DeviceFaultError):
                continue

    async def teardown(self) -> None:
        await asyncio.sleep(self.pause)


class Follow(esair.Reaction):
    """Writes what it reads."""

    sonar = esair.reads(float)
    wheels = esair.writes(float)

    def react(self, sonar: float) -> float:
        return sonar


class World:
    """A robot with two behaviors and two devices, in one of the conditions."""

    def __init__(self, condition: str) -> None:
        self.slow = condition == "slow"
        self.pause = 0.2 if self.slow else 0.0
        self.condition = condition
        self.sonar = FakeSensor("sonar", 1.0)
        self.wheels = FakeActuator("wheels", safe=0.0)
        self.all_wheels = [self.wheels]
        self.actor = Actor(name="actor")
        self.peer = self.new_peer()
        self.robot = esair.Robot(
            resources=[self.sonar, self.wheels], behaviors=[self.actor, self.peer]
        )

    def new_peer(self) -> Peer:
        peer = Peer(name="peer")
        peer.pause = self.pause
        return peer

    def new_wheels(self, name: str = "wheels") -> FakeActuator[float]:
        wheels = FakeActuator(name, safe=0.0)
        self.all_wheels.append(wheels)
        return wheels

    def new_sensor(self, name: str = "extra") -> FakeSensor[float]:
        sensor = FakeSensor(name, 2.0)
        if self.slow:
            sensor.stall()
            asyncio.get_running_loop().call_later(0.2, sensor.resume)
        return sensor

    async def disturb(self, victims: tuple[str, ...]) -> list[asyncio.Future[Any]]:
        """Bring about the condition, and let it pass after a while."""
        loop = asyncio.get_running_loop()
        robot = self.robot
        if self.condition == "busy":
            await robot.behaviors.put("first", sender="user", receiver="peer")
            busy = [
                asyncio.ensure_future(robot.behaviors.add(_named("hog"))),
                asyncio.ensure_future(robot.resources.add(_SlowSensor(name="slow"))),
                asyncio.ensure_future(self.actor.wheels.write(0.5)),
            ]

            async def relieve() -> None:
                await asyncio.sleep(0.3)
                while True:
                    try:
                        async with asyncio.timeout(0.05):
                            await self.peer.receive()
                    except TimeoutError:
                        return
                    except esair.EsairError:
                        return

            return [*busy, asyncio.ensure_future(relieve())]
        if self.slow:
            self.sonar.stall()
            self.wheels.stall()
            loop.call_later(0.1, self.sonar.resume)
            loop.call_later(0.1, self.wheels.resume)
        if self.condition == "removed":
            self.sonar.stall()

            async def remove() -> None:
                await asyncio.sleep(0.05)
                for victim in victims:
                    supervisor: Any = (
                        robot.behaviors
                        if victim in robot.behaviors.names()
                        else robot.resources
                    )
                    await supervisor.remove(victim)

            return [asyncio.ensure_future(remove())]
        return []

    async def restore(self) -> None:
        """Have everybody there again."""
        behaviors, resources = self.robot.behaviors, self.robot.resources
        self.sonar.resume()
        self.wheels.resume()
        if "sonar" not in resources.names():
            self.sonar = FakeSensor("sonar", 1.0)
            await resources.add(self.sonar)
        if "wheels" not in resources.names():
            self.wheels = self.new_wheels()
            await resources.add(self.wheels)
        if "peer" not in behaviors.names():
            self.peer = self.new_peer()
            await behaviors.add(self.peer)
        for name in ("hog", "guest"):
            if name in behaviors.names():
                await behaviors.remove(name)
        if "extra" in resources.names():
            await resources.remove("extra")
        await behaviors.remove("actor")
        self.actor = Actor(name="actor")
        await behaviors.add(self.actor)
        while self.robot._behaviors.members["peer"].mail.inbox:
            await self.peer.receive()

    def check(self) -> None:
        """Nothing is lost, doubled or left over (INV1, INV2)."""
        robot = self.robot
        mediator = robot._behaviors.mediator
        assert mediator.pending == 0
        assert mediator.of_asker == {}
        members = robot._behaviors.members
        for member in members.values():
            assert member.mail.senders.count == member.mail.askers.count == 0
            assert member.mail.askers.current is None
            assert member.mail.takers == []
            assert not member.steps
            assert member.mail.state in {
                esair.BehaviorState.RUNNING,
                esair.BehaviorState.PARKED,
            }, member.mail.state
        assert robot._behaviors.coming == []
        assert robot._behaviors.ending == []
        waiting = esair.SupervisorPhase.WAIT_REQUEST
        assert (robot.behaviors.phase, robot.resources.phase) == (waiting, waiting)
        held = {each.number for m in members.values() for each in m.uses()}
        there = {
            each.number
            for m in members.values()
            for each in m.uses()
            if each.resource in robot.resources.names() and each.reason is None
        }
        live = set(robot._resources.registrations.live)
        assert live <= held, "a ghost: nobody has this registration"
        assert there <= live, "a registration was lost"


class Actor(Idle):
    """In whose name the operations are done."""

    sonar = esair.reads(float, configure=True)
    wheels = esair.writes(float)


def _named(name: str) -> esair.Behavior:
    class Hog(esair.Behavior):
        async def setup(self) -> None:
            await asyncio.sleep(0.3)

    return Hog(name=name)


class _SlowSensor(esair.Sensor[float]):
    async def open(self) -> None:
        await asyncio.sleep(0.3)

    async def read(self) -> float:
        return 0.0


Operation = Callable[[World], Coroutine[Any, Any, Any]]


async def put(world: World) -> None:
    await world.actor.put("peer", "data", interval=0.5)


async def get(world: World) -> None:
    assert await world.actor.get("peer", interval=0.5) == "made"


async def register(world: World) -> None:
    port = await world.actor.register("sonar", esair.Access.READ)
    assert await port.read() == 1.0


async def configure(world: World) -> None:
    await world.actor.sonar.configure(rate=25.0)
    assert world.sonar.rate == 25.0


async def add(world: World) -> None:
    await world.robot.behaviors.add(Guest(world.pause))
    assert world.robot.behaviors.query("guest")


async def remove(world: World) -> None:
    await world.robot.behaviors.remove("guest")
    assert "guest" not in world.robot.behaviors.names()


async def replace(world: World) -> None:
    await world.robot.behaviors.replace("guest", Guest(world.pause))


async def add_resource(world: World) -> None:
    await world.robot.resources.add(world.new_sensor())
    assert "extra" in world.robot.resources.names()


async def remove_resource(world: World) -> None:
    await world.robot.resources.remove("wheels")
    assert "wheels" not in world.robot.resources.names()


async def replace_resource(world: World) -> None:
    world.wheels = world.new_wheels()
    await world.robot.resources.replace("wheels", world.wheels)


async def receive(world: World) -> None:
    asyncio.get_running_loop().call_later(
        0.01,
        lambda: world.robot._behaviors.mediator.hand("data", "user", "peer", 1.0),
    )
    async with asyncio.timeout(2.0):
        await world.peer.receive()


async def perform(world: World) -> None:
    assert not await world.actor.perform(Follow(), timeout=0.15)


async def read(world: World) -> None:
    assert await world.actor.sonar.read(fresh=True) == 1.0


async def write(world: World) -> None:
    assert await world.actor.wheels.write(2.0)


async def guest_first(world: World) -> None:
    if "guest" not in world.robot.behaviors.names():
        await world.robot.behaviors.add(Guest(world.pause))


OPERATIONS: dict[str, tuple[Operation, tuple[str, ...]]] = {
    "put": (put, ("peer",)),
    "get": (get, ("peer",)),
    "register": (register, ("sonar",)),
    "configure": (configure, ("sonar",)),
    "add": (add, ("sonar",)),
    "remove": (remove, ("wheels",)),
    "replace": (replace, ("wheels",)),
    "add resource": (add_resource, ("peer",)),
    "remove resource": (remove_resource, ("peer",)),
    "replace resource": (replace_resource, ("peer",)),
    "receive": (receive, ("peer",)),
    "perform": (perform, ("sonar",)),
    "port.read": (read, ("sonar",)),
    "port.write": (write, ("wheels",)),
}


async def one_run(name: str, condition: str, mode: str, k: int) -> bool:
    """Cancel an operation at its k-th suspension; tells whether it had so many."""
    operation, victims = OPERATIONS[name]
    world = World(condition)
    seen, told = [0], list[bool]()
    async with world.robot:
        if operation in {remove, replace}:
            await guest_first(world)
        disturbances = await world.disturb(victims)
        await asyncio.sleep(0)
        task = asyncio.ensure_future(
            _await(drive(operation(world), k, mode, seen, told))
        )
        await asyncio.wait({task})
        reached = seen[0] >= k
        if any(told):
            assert task.cancelled(), f"the cancellation was swallowed: {task!r}"
        elif task.exception() is not None:
            assert reached or condition != "idle"
            assert isinstance(task.exception(), esair.EsairError), task.exception()
        results = await asyncio.gather(*disturbances, return_exceptions=True)
        for result in results:
            assert not isinstance(result, Exception) or isinstance(
                result, esair.EsairError
            ), result
        await asyncio.sleep(3.0)
        world.check()

        await world.restore()
        if operation in {remove, replace}:
            await guest_first(world)
        await operation(world)
        await asyncio.sleep(3.0)
        world.check()
    for wheels in world.all_wheels:
        assert not wheels.commands or wheels.commands[-1] == 0.0
    assert asyncio.all_tasks() == {asyncio.current_task()}
    return reached


async def _await(work: Any) -> Any:
    return await work


def _collect(problems: list[Any]) -> Callable[[Any, Any], None]:
    return lambda _loop, context: problems.append(context)


def sweep(name: str, condition: str, mode: str, seed: int, *, eager: bool) -> int:
    """Cancel an operation at each of its suspensions; returns how many there were."""
    for k in range(1, SUSPENSIONS):
        problems: list[Any] = []
        with asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=seed)) as runner:
            loop = runner.get_loop()
            loop.set_exception_handler(_collect(problems))
            if eager:
                loop.set_task_factory(asyncio.eager_task_factory)  # type: ignore[attr-defined]
            reached = runner.run(one_run(name, condition, mode, k))
        assert problems == []
        if not reached:
            return k - 1
    raise AssertionError("it never ended untouched")


@pytest.mark.promise("BS-4", "SUP-2")
@pytest.mark.fault("X01", "X02", "X03", "X05", "X07", "M07", "L12")
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("name", OPERATIONS)
def test_cancelled_at_every_await(name: str, condition: str, mode: str) -> None:
    """Nothing is lost or left over, and the same operation works right after."""
    sweep(name, condition, mode, seed=0, eager=False)


@pytest.mark.fault("X01", "X02", "X03")
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", OPERATIONS)
def test_cancelled_at_every_await_in_any_order(name: str, seed: int) -> None:
    """The same with the steps of tasks in another order."""
    for condition in ("busy", "removed"):
        sweep(name, condition, "raced", seed=seed, eager=False)


@pytest.mark.skipif(sys.version_info < (3, 12), reason="eager tasks came with 3.12")
@pytest.mark.fault("X10")
@pytest.mark.parametrize("condition", ["idle", "removed"])
@pytest.mark.parametrize("name", OPERATIONS)
def test_cancelled_at_every_await_of_eager_tasks(name: str, condition: str) -> None:
    """The same with tasks that begin before their creator goes on."""
    for mode in MODES:
        sweep(name, condition, mode, seed=0, eager=True)


def test_the_sweep_reaches_waits() -> None:
    """Most operations suspend at all, so that there is something to cancel."""
    reached = {
        name: sweep(name, "slow", "pending", seed=0, eager=False)
        for name in ("put", "get", "add", "remove", "port.read", "port.write")
    }
    assert reached["put"] == 0  # a receiver with room costs no wait
    assert all(count > 0 for name, count in reached.items() if name != "put")
