"""Ports: what an action holds in its hand."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("RS-1", "SC-1", "AC-1")
async def test_a_port_knows_its_resource(fake_sensor: Any, fake_actuator: Any) -> None:
    """Name, state and settings, without a wait."""
    sonar, wheels = fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)
    user = esair.Behavior(
        name="user",
        reads={"sonar": esair.reads(float)},
        writes={"wheels": esair.writes(float)},
    )

    async with esair.Robot(resources=[sonar, wheels], behaviors=[user]):
        for port, name in ((user.sonar, "sonar"), (user.wheels, "wheels")):  # type: ignore[attr-defined]
            assert port.resource == name
            assert port.state is esair.ResourceState.READY
            assert f"user may {port.registration.access} {name}" in repr(port)
        assert user.sonar.settings["rate"] == 10.0  # type: ignore[attr-defined]


@pytest.mark.promise("BEH-2", "SC-1", "AC-1")
async def test_a_plain_behavior_has_blocking_ports(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Read, stream, history, write, release and configure, each waiting in its thread."""
    result: dict[str, Any] = {}

    class Plain(esair.Behavior):
        sonar = esair.reads(float, configure=True)
        wheels = esair.writes(float, configure=True)

        def run(self) -> None:
            sonar: Any = self.sonar
            wheels: Any = self.wheels
            result["read"] = sonar.read()
            result["number"] = sonar.reading().sequence
            seen = []
            for value in sonar:
                seen.append(value)
                if len(seen) == 3:
                    break
            result["seen"] = seen
            result["history"] = len(sonar.history(2))
            sonar.configure(rate=20.0)
            result["rate"] = sonar.settings["rate"]
            result["written"] = wheels.write(1.0, hold=0.1)
            wheels.release()
            wheels.configure()
            result["settings"] = dict(wheels.settings)

    sonar, wheels = fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)
    async with esair.Robot(resources=[sonar, wheels], behaviors=[Plain()]) as robot:
        await robot.ended()
        assert robot.sensors.channels["sonar"]._followers == ()

    assert result["written"]
    del result["written"]
    assert result == {
        "read": 1.0, "number": 1, "seen": [1.0] * 3, "history": 2, "rate": 20.0,
        "settings": {},
    }  # fmt: skip
    assert wheels.commands[1] == 1.0


@pytest.mark.promise("BEH-2")
async def test_a_plain_behavior_in_a_stream_can_be_removed(fake_sensor: Any) -> None:
    """The thread that waits for a value learns that it is over."""
    ended: list[BaseException] = []

    class Plain(esair.Behavior):
        radar = esair.reads(float)

        def run(self) -> None:
            radar: Any = self.radar
            try:
                for _ in radar:
                    pass
            except BaseException as error:
                ended.append(error)
                raise

    async with esair.Robot(
        resources=[fake_sensor("radar")], behaviors=[Plain()]
    ) as robot:
        await asyncio.sleep(0.1)
        await robot.behaviors.remove("plain")
        assert robot.sensors.channels["radar"]._followers == ()

    assert [type(error) for error in ended] == [esair.BehaviorRemovedError]


@pytest.mark.promise("RS-4")
async def test_an_actuator_port_configures(fake_actuator: Any) -> None:
    """Settings of actuators go the same way, with the same checks."""

    class Arm(esair.Actuator[float]):
        safe = 0.0
        gain = esair.setting(1, min=0)

        async def write(self, command: float) -> None:
            return None

    user = esair.Behavior(
        name="user", writes={"arm": esair.writes(float, configure=True)}
    )
    async with esair.Robot(resources=[Arm()], behaviors=[user]):
        port = user.arm  # type: ignore[attr-defined]
        await port.configure(gain=4)
        assert port.settings == {"gain": 4}
        with pytest.raises(esair.BadValueError, match="at least 0"):
            await port.configure(gain=-1)


@pytest.mark.promise("AC-2")
async def test_giving_back_may_be_awaited(fake_actuator: Any) -> None:
    """It is done before the await, which is there for those who await every verb."""
    users = [
        esair.Behavior(name=name, writes={"wheels": esair.writes(float, hold=10.0)})
        for name in ("first", "second")
    ]
    wheels = fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[wheels], behaviors=users):
        first, second = (user.wheels for user in users)  # type: ignore[attr-defined]
        assert await first.write(1.0)
        assert not await second.write(2.0)
        giving_back = first.release()
        assert await second.write(2.0)
        await giving_back


@pytest.mark.promise("BEH-2")
async def test_a_loop_of_a_thread_may_be_ended_by_the_collector(
    fake_sensor: Any,
) -> None:
    """Which runs in the event loop, where nothing may wait for it."""

    class Plain(esair.ThreadBehavior):
        sonar = esair.reads(float)

        def run(self) -> None:
            self.values = iter(self.sonar)
            next(self.values)

    plain = Plain()
    sonar = fake_sensor("sonar", 1.0)
    async with esair.Robot(resources=[sonar], behaviors=[plain]) as robot:
        await robot.ended()
        plain.values.close()  # type: ignore[attr-defined]
        with pytest.raises(StopIteration):
            next(plain.values)


def test_a_port_hides_nothing_of_its_action() -> None:
    """It is told where it is declared, in the class or in the call."""
    port = esair.reads(float, name="sonar")
    for attribute in ("name", "run", "setup", "restart"):
        with pytest.raises(esair.ConfigError, match=f"a '{attribute}' of its own"):
            type("Odd", (esair.Behavior,), {attribute: port})
        with pytest.raises(esair.ConfigError, match=f"a '{attribute}' of its own"):
            esair.Behavior(reads={attribute: port})


async def test_a_port_of_a_thread_tells_what_every_port_does(
    fake_sensor: Any,
) -> None:
    """Which device it is of, how that is, its newest reading and how old that may be."""
    told: list[Any] = []

    class Plain(esair.ThreadBehavior):
        sonar = esair.reads(float, max_age=0.5)

        def run(self) -> None:
            port = self.sonar
            value = port.read()
            told.extend([port.resource, port.state, port.max_age])
            told.append(port.newest.value == value)

    sonar = fake_sensor("sonar", 1.0)
    async with esair.Robot(resources=[sonar], behaviors=[Plain()]) as robot:
        await robot.ended()
    assert told == ["sonar", esair.ResourceState.READY, 0.5, True]


def test_a_guard_holds_no_port() -> None:
    """It is told where the command is; its class says what it guards."""

    class Guard(esair.Reaction):
        wheels = esair.guards(float)

    assert Guard.wheels.resource == "wheels"
    with pytest.raises(AttributeError, match="gets the command as a parameter"):
        Guard().wheels.resource  # noqa: B018 - it raises


def test_what_takes_requests_says_of_which_type() -> None:
    """Also where no robot runs: who looks for requests is told which."""

    class Dock(esair.Request[int]): ...

    class Dockyard(esair.Behavior):
        orders = esair.takes(Dock)

    with pytest.raises(esair.NotRegisteredError, match="'Dock'"):
        Dockyard().orders.waiting  # noqa: B018 - it raises


@pytest.mark.parametrize(
    "call",
    [
        *(esair.Reaction().react, esair.Derived().compute, esair.Sensor().read),
        *(esair.Sensor().stream, lambda: esair.Actuator[Any]().write(0.0)),
    ],
    ids=["react", "compute", "read", "stream", "write"],
)
def test_what_nobody_has_written_decides_nothing(call: Any) -> None:
    """It is an error, and no opinion."""
    with pytest.raises(NotImplementedError):
        call()


async def test_a_thread_without_work_waits() -> None:
    """As a behavior without a run does: it can be asked for, and goes when it must."""
    idle = esair.ThreadBehavior(name="idle")
    async with esair.Robot(behaviors=[idle]) as robot:
        await asyncio.sleep(1.0)
        assert robot.behaviors.query("idle").state is esair.BehaviorState.RUNNING
        await robot.behaviors.remove("idle")
