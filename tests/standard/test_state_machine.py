"""Both supervisors against a model of plain dictionaries, under random schedules.

The rules are synchronous: each one starts or finishes work in an event loop with a
virtual clock whose order of tasks is drawn too, so that schedules shrink as well.
"""

from __future__ import annotations

import asyncio
from typing import Any

import hypothesis.strategies as st
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

import esair
from esair.connections import Registration
from esair.messages import Answer, Written
from esair.supervisors import Outcome
from esair.testing import FakeActuator, FakeSensor, VirtualLoop

NAMES = st.sampled_from(["a", "b", "c"])
EXAMPLES, LONG_EXAMPLES, STEPS = 25, 120, 40
SOAK_EXAMPLES, SOAK_STEPS = 5_000, 60
SAFE = 0.0
GRACE = 0.3
PENDING = 24
"""How many operations may be in flight."""

ALLOWED: dict[str, tuple[type[Exception], ...]] = {
    "put": (
        esair.BehaviorUnavailableError,
        esair.BehaviorRemovedError,
        esair.BehaviorFailedError,
        esair.BusyError,
        esair.NotRegisteredError,
    ),
    "get": (
        esair.BehaviorUnavailableError,
        esair.BehaviorRemovedError,
        esair.BehaviorFailedError,
        esair.CircularRequestError,
        esair.BusyError,
        esair.NotRegisteredError,
    ),
    "write": (
        esair.DeviceLostError,
        esair.DeviceFaultError,
        esair.DriverStuckError,
        esair.ResourceRemovedError,
        esair.NotRegisteredError,
        esair.BehaviorRemovedError,
        esair.BusyError,
    ),
    "configure": (
        esair.DeviceLostError,
        esair.DeviceFaultError,
        esair.DriverStuckError,
        esair.ResourceRemovedError,
        esair.NotRegisteredError,
        esair.BehaviorRemovedError,
    ),
}


class Wheels(FakeActuator[float]):
    """Wheels with a setting; the device forgets it whenever it is opened."""

    gain = esair.setting(0, min=0, max=9)
    in_device = 0
    was_odd = was_slow = False

    def __init__(self) -> None:
        super().__init__("wheels", safe=SAFE)
        self.alive = 0
        """How many commands the driver has not ended, their callers gone or not."""

    async def write(self, command: float) -> None:
        self.alive += 1
        try:
            await super().write(command)
        finally:
            self.alive -= 1

    async def open(self) -> None:
        await super().open()
        self.in_device = 0

    async def apply(self, *, gain: int) -> None:
        await self._faults.call()
        self.in_device = gain

    @property
    def can_be_told(self) -> bool:
        faults = self._faults
        return faults.plugged and faults.go.is_set() and not self.is_odd

    @property
    def answers(self) -> bool:
        """Whether each call ends well, and before its deadline."""
        faults = self._faults
        in_time = faults.delay + faults.ack < self.deadline
        return faults.plugged and faults.go.is_set() and in_time

    @property
    def is_quick(self) -> bool:
        """Whether a command and the safe one after it land while a removal waits."""
        return 2 * (self._faults.delay + self._faults.ack) < GRACE

    @property
    def comes_to_rest(self) -> bool:
        """Whether nothing is on its way, and a command and safe had time to land."""
        return self.answers and self.is_quick and not self.alive

    @property
    def is_odd(self) -> bool:
        """Whether it takes its time, or swallows cancellations."""
        faults = self._faults
        return bool(faults.delay or faults.ack or faults.deaf)


class Worker(esair.Behavior):
    """Acts as the rules tell it; its commands carry its number."""

    wheels = esair.writes(float, configure=True)
    inbox_size = 2
    outbox_size = 2
    restart = esair.Restart(max=2, within=5.0)

    def __init__(self, name: str, number: int) -> None:
        super().__init__(name=name)
        self.number = number
        self.crash = asyncio.Event()

    async def run(self) -> None:
        await self.crash.wait()
        self.crash.clear()
        raise RuntimeError("told to crash")


class Request:
    """A put in the model: what it carries, and what became of it."""

    def __init__(self, number: int, sender: str, receiver: str) -> None:
        self.number = number
        self.sender = sender
        self.receiver = receiver
        self.task: asyncio.Task[Any]


class Change:
    """A change of settings in the model: of which device, and to what."""

    def __init__(self, device: Wheels, gain: int, task: asyncio.Task[Any]) -> None:
        self.device = device
        self.gain = gain
        self.task = task


class SupervisorMachine(RuleBasedStateMachine):
    """What a user, behaviors and devices may do to a robot, in any order."""

    configured = 0
    """How many changes of settings have succeeded, in all examples."""

    late = 0
    """How many driver calls have outlived their deadline, or their caller."""

    @initialize(seed=st.integers(0, 2**16))
    def start(self, seed: int) -> None:
        self.loop = VirtualLoop(seed=seed)
        self.problems: list[Any] = []
        self.loop.set_exception_handler(
            lambda _loop, context: self.problems.append(context)
        )
        self.numbers = 0
        self.workers: dict[str, Worker] = {}
        self.gone: set[int] = set()
        self.resources: dict[str, Any] = {}
        self.removed_devices: list[Wheels] = []
        self.wheels_ever: list[Wheels] = []
        self.changes: list[Change] = []
        self.extra: dict[str, list[Registration]] = {}
        self.puts: list[Request] = []
        self.seen: dict[str, list[int]] = {}
        self.handed_back: list[int] = []
        self.flying: list[tuple[str, asyncio.Task[Any]]] = []
        self.robot = esair.Robot(grace=GRACE)
        self.run(self.robot.__aenter__())
        self.add_resource("wheels")
        self.add_resource("sonar")
        self.add("a")

    # Helpers.

    def run(self, work: Any) -> Any:
        return self.loop.run_until_complete(work)

    def made(self, name: str) -> Any:
        """Make a resource; all wheels there ever were may have a command that lives."""
        if name != "wheels":
            return FakeSensor(name, 1.0)
        self.wheels_ever.append(Wheels())
        return self.wheels_ever[-1]

    def is_unsettled(self) -> bool:
        """Whether a command is alive, of these wheels or of some before them."""
        return any(each.alive for each in self.wheels_ever)

    def next(self) -> int:
        self.numbers += 1
        return self.numbers

    def fly(self, kind: str, work: Any) -> asyncio.Task[Any]:
        """Start work and leave it in flight."""
        task = self.loop.create_task(work)
        self.flying.append((kind, task))
        self.settle()
        return task

    def settle(self) -> None:
        async def turns() -> None:
            for _ in range(6):
                await asyncio.sleep(0)

        self.run(turns())

    def refused(self, error: type[Exception], work: Any) -> None:
        with pytest.raises(error):
            self.run(work)

    def is_busy(self) -> bool:
        return len(self.flying) >= PENDING

    # The user.

    @rule(name=NAMES)
    def add(self, name: str) -> None:
        worker = Worker(name, self.next())
        work = self.robot.behaviors.add(worker)
        mistakes: list[type[Exception]] = []
        if name in self.workers:
            mistakes.append(esair.NameTakenError)
        if "wheels" not in self.resources:
            mistakes.append(esair.UnknownNameError)
        if mistakes:  # all of them are told
            self.refused(mistakes[0] if len(mistakes) == 1 else ExceptionGroup, work)
        else:
            self.run(work)
            self.workers[name] = worker

    @rule(name=NAMES)
    def remove(self, name: str) -> None:
        work = self.robot.behaviors.remove(name)
        if name not in self.workers:
            self.refused(esair.UnknownNameError, work)
            return
        self.handed_back += self.run(work)
        self.gone.add(self.workers.pop(name).number)
        self.seen[name] = []
        self.extra.pop(name, None)

    @rule(name=NAMES)
    def replace(self, name: str) -> None:
        worker = Worker(name, self.next())
        work = self.robot.behaviors.replace(name, worker)
        if name not in self.workers or "wheels" not in self.resources:
            self.refused(esair.UnknownNameError, work)
            return
        self.handed_back += self.run(work)
        self.gone.add(self.workers[name].number)
        self.workers[name] = worker
        self.extra.pop(name, None)

    @rule(name=st.sampled_from(["wheels", "sonar"]))
    def add_resource(self, name: str) -> None:
        resource = self.made(name)
        work = self.robot.resources.add(resource)
        if name in self.resources:
            self.refused(esair.NameTakenError, work)
        else:
            self.run(work)
            self.resources[name] = resource

    @rule(name=st.sampled_from(["wheels", "sonar"]))
    def remove_resource(self, name: str) -> None:
        work = self.robot.resources.remove(name)
        if name not in self.resources:
            self.refused(esair.UnknownNameError, work)
            return
        reachable = name == "wheels" and self.resources[name].can_be_told
        self.run(work)
        resource = self.resources.pop(name)
        if name == "wheels":
            if reachable:
                assert resource.commands[-1] == SAFE
            if resource.comes_to_rest:
                assert resource.commands[-1] == SAFE, (
                    "a motion came after the last safe"
                )
            self.removed_devices.append(resource)
            self.counts = [len(each.commands) for each in self.removed_devices]

    @rule(name=st.sampled_from(["wheels", "sonar"]))
    def replace_resource(self, name: str) -> None:
        resource = self.made(name)
        work = self.robot.resources.replace(name, resource)
        if name not in self.resources:
            self.refused(esair.UnknownNameError, work)
        else:
            self.run(work)
            self.resources[name] = resource

    # Behaviors.

    @rule(name=NAMES, resource=st.sampled_from(["wheels", "sonar"]))
    def register(self, name: str, resource: str) -> None:
        access = esair.Access.WRITE if resource == "wheels" else esair.Access.READ
        worker = self.workers.get(name)
        if worker is None:
            return
        failed = self.state(name) is esair.BehaviorState.FAILED
        if failed or resource not in self.resources:
            self.refused(self.mistake(name), worker.register(resource, access))
            return
        port = self.run(worker.register(resource, access))
        self.extra.setdefault(name, []).append(port.registration)

    @precondition(lambda self: not self.is_busy())
    @rule(
        sender=NAMES,
        receiver=NAMES,
        interval=st.sampled_from([0.05, 0.5, 5.0]),
    )
    def put(self, sender: str, receiver: str, interval: float) -> None:
        if sender not in self.workers:
            return
        request = Request(self.next(), sender, receiver)
        work = self.workers[sender].put(receiver, request.number, interval=interval)
        if receiver not in self.workers:
            self.refused(self.mistake(sender), work)
            return
        self.puts.append(request)
        request.task = self.fly("put", work)

    @precondition(lambda self: not self.is_busy())
    @rule(sender=NAMES, receiver=NAMES, interval=st.sampled_from([0.05, 0.5, 5.0]))
    def get(self, sender: str, receiver: str, interval: float) -> None:
        if receiver not in self.workers:
            return
        work = self.workers[receiver].get(sender, interval=interval)
        if sender not in self.workers:
            self.refused(self.mistake(receiver), work)
        elif sender == receiver:
            self.refused(self.mistake(sender, esair.CircularRequestError), work)
        else:
            self.fly("get", work)

    def mistake(
        self, asker: str, error: type[Exception] = esair.UnknownNameError
    ) -> type[Exception]:
        """Which error tells of a mistake: one who has failed learns of that first."""
        if self.state(asker) is esair.BehaviorState.FAILED:
            return esair.BehaviorFailedError
        return error

    @rule(name=NAMES)
    def offer(self, name: str) -> None:
        worker = self.workers.get(name)
        if worker is None:
            return
        try:
            worker.offer(self.next())
        except esair.BusyError:
            assert not self.robot._behaviors.members[name].mail.askers.count
        except esair.BehaviorFailedError:
            assert self.state(name) is esair.BehaviorState.FAILED
        self.settle()

    @rule(name=NAMES)
    def receive(self, name: str) -> None:
        worker = self.workers.get(name)
        member = self.robot._behaviors.members.get(name)
        if (
            worker is None
            or member is None
            or not (member.mail.inbox and member.mail.alive)
        ):
            return
        self.seen.setdefault(name, []).append(self.run(worker.receive()))
        self.settle()

    @precondition(lambda self: not self.is_busy())
    @rule(name=NAMES)
    def write(self, name: str) -> None:
        worker = self.workers.get(name)
        if worker is not None:
            self.fly("write", worker.wheels.write(float(worker.number)))

    @precondition(lambda self: not self.is_busy())
    @rule(name=NAMES, gain=st.integers(0, 10))
    def configure(self, name: str, gain: int) -> None:
        worker, wheels = self.workers.get(name), self.resources.get("wheels")
        if worker is None or wheels is None:
            return
        if gain > 9:
            with pytest.raises((esair.BadValueError, *ALLOWED["configure"])):
                self.run(worker.wheels.configure(gain=gain))
            return
        task = self.fly("configure", worker.wheels.configure(gain=gain))
        self.changes.append(Change(wheels, gain, task))

    @rule(name=NAMES)
    def crash(self, name: str) -> None:
        if name in self.workers:
            self.workers[name].crash.set()
            self.settle()

    @precondition(lambda self: self.flying)
    @rule(data=st.data())
    def cancel(self, data: st.DataObject) -> None:
        index = data.draw(st.integers(0, len(self.flying) - 1))
        _, task = self.flying[index]
        task.cancel()
        self.settle()
        assert task.done()

    # Devices and time.

    @rule(
        name=st.sampled_from(["wheels", "sonar"]),
        what=st.sampled_from(["unplug", "plug", "stall", "resume"]),
    )
    def disturb(self, name: str, what: str) -> None:
        if name in self.resources:
            self.loop.call_soon(getattr(self.resources[name], what))
            self.settle()

    @rule(
        name=st.sampled_from(["wheels", "sonar"]),
        seconds=st.sampled_from([0.0, 0.03, 0.4, 1.7]),
        acknowledge=st.sampled_from([0.0, 0.4, 1.7]),
        swallows=st.sampled_from([0, 0, 1, 3]),
    )
    def slow(
        self, name: str, seconds: float, acknowledge: float, swallows: int
    ) -> None:
        """A device that answers late, after its command has landed, or past a deadline."""
        if name in self.resources:
            self.resources[name].slow(seconds, acknowledge=acknowledge)
            self.resources[name].swallow(swallows)
            self.resources[name].was_odd = True
            if name == "wheels" and not self.resources[name].is_quick:
                self.resources[name].was_slow = True
            if not self.is_busy():
                self.write("a")  # so that often there is a call that takes its time

    @rule(seconds=st.sampled_from([0.01, 0.1, 0.3, 1.0, 6.0]))
    def wait(self, seconds: float) -> None:
        self.run(asyncio.sleep(seconds))
        self.settle()  # who has an outcome since this very moment goes on
        wheels = self.resources.get("wheels")
        if wheels is not None and seconds >= 6.0 and self.works(wheels):
            assert wheels.commands[-1] == SAFE, "nobody writes, and it is not safe"

    def works(self, device: Wheels) -> bool:
        """Whether the wheels can be told anything, and esair knows it."""
        return bool(device.answers and self.robot._resources.is_ready("wheels"))

    def state(self, name: str) -> esair.BehaviorState:
        return self.robot.behaviors.query(name).state

    # What always holds.

    @invariant()
    def what_is_over_ended_as_allowed(self) -> None:
        """INV1: one outcome for each request."""
        still = []
        for kind, task in self.flying:
            if not task.done():
                still.append((kind, task))
                continue
            if task.cancelled():
                continue
            error = task.exception()
            if error is not None:
                assert isinstance(error, ALLOWED[kind]), (kind, error)
            elif kind == "write":
                assert isinstance(task.result(), Answer)
                assert not task.result() or isinstance(task.result(), Written)
        self.flying = still

    @invariant()
    def what_was_put_is_where_its_outcome_says(self) -> None:
        """INV1: delivered once, or not at all; in the order of its sender."""
        members = self.robot._behaviors.members
        inboxes = {
            name: [data for _, data in member.mail.inbox]
            for name, member in members.items()
        }
        everywhere = [
            *self.handed_back,
            *(n for seen in self.seen_ever() for n in seen),
            *(n for inbox in inboxes.values() for n in inbox),
        ]
        assert len(everywhere) == len(set(everywhere)), "delivered twice"
        arrived = set(everywhere)
        for request in self.puts:
            if not request.task.done() or request.task.cancelled():
                continue
            delivered = request.task.exception() is None
            assert delivered == (request.number in arrived), request.number
        by_number = {request.number: request for request in self.puts}
        for name, inbox in inboxes.items():
            order = [*self.seen.get(name, []), *inbox]
            for sender in "abc":
                numbers = [n for n in order if by_number[n].sender == sender]
                assert numbers == sorted(numbers), "the order was lost"

    def seen_ever(self) -> list[list[int]]:
        self.archive = getattr(self, "archive", [])
        for seen in self.seen.values():
            if seen and not any(seen is each for each in self.archive):
                self.archive.append(seen)
        return self.archive

    @invariant()
    def the_registry_equals_the_model(self) -> None:
        """INV2: no lost, ghost or doubled component or registration."""
        robot = self.robot
        assert sorted(robot.behaviors.names()) == sorted(self.workers)
        assert sorted(robot.resources.names()) == sorted(self.resources)
        waits = esair.SupervisorPhase.WAIT_REQUEST
        assert (robot.behaviors.phase, robot.resources.phase) == (waits, waits)
        live = robot._resources.registrations.live
        used: list[int] = []
        for name, member in robot._behaviors.members.items():
            used += [r.number for r in member.uses()]
            assert all(r.behavior == name for r in member.uses())
        assert len(used) == len(set(used)), "two behaviors share a registration"
        assert set(live) <= set(used), "a ghost: nobody has this registration"
        for registration in live.values():
            assert registration.resource in self.resources
        for name, worker in self.workers.items():
            if self.state(name) is esair.BehaviorState.RUNNING:
                own = worker.wheels.registration
                assert own.number in live or own.reason is not None

    @invariant()
    def requests_are_counted_exactly(self) -> None:
        """INV1: the bounds are not eaten up by what has ended."""
        pending = sum(
            kind in {"put", "get"} and not task.done() for kind, task in self.flying
        )
        mediator = self.robot._behaviors.mediator
        assert mediator.pending == pending
        assert sum(map(len, mediator.of_asker.values())) == pending
        assert all(
            isinstance(each.outcome, Outcome)
            for each in self.robot.behaviors.outcomes()
        )

    @invariant()
    def nobody_moves_what_was_taken_away(self) -> None:
        """INV3: who is gone writes nothing; a removed device hears nothing."""
        wheels = self.resources.get("wheels")
        if wheels is not None and wheels.commands:
            last = wheels.commands[-1]
            told = self.works(wheels) and not wheels.was_slow
            assert last == SAFE or int(last) not in self.gone or not told
        for device, count in zip(
            self.removed_devices, getattr(self, "counts", []), strict=False
        ):
            new = device.commands[count:]
            # What does not end when it is told to may land late: the log names it.
            assert device.was_odd or all(command == SAFE for command in new)

    @invariant()
    def settings_are_what_was_asked_for_and_what_the_device_has(self) -> None:
        """R12: the last change that succeeded counts, and the device agrees."""
        wheels = self.resources.get("wheels")
        if wheels is None:
            return
        possible = {0}
        for change in self.changes:
            if change.device is not wheels:
                continue
            if not change.task.done() or change.task.cancelled():
                possible.add(change.gain)  # nobody has heard of its outcome
            elif change.task.exception() is None:
                possible = {change.gain}
                type(self).configured += 1
        assert wheels.settings["gain"] in possible
        life = self.robot._resources.lives["wheels"]
        if self.robot._resources.is_ready("wheels") and not life.configuring.locked():
            assert wheels.in_device == wheels.settings["gain"]

    @invariant()
    def nothing_was_reported_to_the_loop(self) -> None:
        assert self.problems == []

    def teardown(self) -> None:
        if not hasattr(self, "loop"):
            return
        try:
            for _, task in self.flying:
                task.cancel()
            wheels: Any = self.resources.get("wheels")
            reachable = wheels is not None and wheels.can_be_told
            unsettled = self.is_unsettled()
            self.run(self.robot.__aexit__(None, None, None))
            for told in self.robot.stopped:
                assert not told.answered or wheels.commands[-1] == SAFE
                assert not told.answered or not self.is_unsettled(), told
                # What ended while it stopped may have ended after the report.
                assert told.answered or unsettled or not reachable, told
            if reachable:  # also if it was lost: there is a last try
                assert wheels.commands[-1] == SAFE
            if wheels is not None and wheels.comes_to_rest:
                assert wheels.commands[-1] == SAFE, "a motion came after the last safe"

            async def left() -> set[asyncio.Task[Any]]:
                await asyncio.sleep(5.0)
                return asyncio.all_tasks() - {asyncio.current_task()}

            for channel in self.robot.actuators.channels.values():
                type(self).late += channel.calls.late
            last = list(wheels.commands) if wheels is not None else []
            answered = all(told.answered for told in self.robot.stopped)
            assert self.run(left()) == set()
            if wheels is not None and answered:
                assert wheels.commands == last, "something landed after the stop"
            assert self.problems == []
        finally:
            self.loop.close()


@pytest.mark.longer
@pytest.mark.promise("BS-4", "SUP-1", "SUP-2", "SUP-3", "SUP-4", "RS-3")
@pytest.mark.fault("L01", "L03", "L05", "B19", "M04", "M13", "M14", "M15", "R12")
def test_the_supervisors_follow_their_model(request: pytest.FixtureRequest) -> None:
    """Whatever is done in whatever order, the invariants hold after every step."""
    option = request.config.getoption
    soak, long = option("--esair-soak"), option("--esair-long")
    run_state_machine_as_test(
        SupervisorMachine,
        settings=settings(
            max_examples=SOAK_EXAMPLES if soak else LONG_EXAMPLES if long else EXAMPLES,
            stateful_step_count=SOAK_STEPS if soak else STEPS,
            deadline=None,
            suppress_health_check=list(HealthCheck),
            database=None,
        ),
    )
    assert SupervisorMachine.configured > 0  # the rule is more than its refusals
    if soak or long:  # a few examples may have none
        assert SupervisorMachine.late > 0
