"""Registration: who may use what, and what happens to those who may not."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair import Access, Policy
from esair.connections import Terms

pytestmark = pytest.mark.virtual_clock


def writer(name: str, priority: int = 0) -> esair.Behavior:
    return esair.Behavior(
        name=name, writes={"wheels": esair.writes(float, priority=priority)}
    )


@pytest.mark.promise("RS-1")
@pytest.mark.fault("R01")
async def test_a_port_outside_a_robot_is_not_registered() -> None:
    """Before the start nothing can be used, and no driver is touched."""

    class Wander(esair.Behavior):
        sonar = esair.reads(float)
        wheels = esair.writes(float)

    wander = Wander()
    for port in ("sonar", "wheels"):
        with pytest.raises(esair.NotRegisteredError, match="not in a running robot"):
            getattr(wander, port)


@pytest.mark.promise("RS-8")
async def test_what_is_no_name_is_told_as_a_wrong_one(fake_actuator: Any) -> None:
    """Not by an error from inside."""
    wheels, wander = fake_actuator("wheels", safe=0.0), esair.Behavior(name="wander")
    async with esair.Robot(resources=[wheels], behaviors=[wander]):
        with pytest.raises(esair.UnknownNameError, match="there are wheels"):
            await wander.register(wheels, esair.Access.WRITE)


@pytest.mark.promise("RS-1")
@pytest.mark.fault("R01", "R08")
async def test_a_registration_is_for_one_resource_and_one_access(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """A right to read one sensor writes nothing and reads nothing else."""
    sonar, wheels = fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[sonar, wheels]) as robot:
        reading = await robot.resources.register("me", "sonar", Access.READ)
        with pytest.raises((esair.UnknownNameError, esair.NotRegisteredError)):
            await robot.actuators.write(reading, 1.0)
        assert (await robot.sensors.read(reading)).value == 1.0
        assert wheels.commands == [0.0]


@pytest.mark.promise("RS-1")
async def test_the_right_to_configure_moves_nothing(fake_actuator: Any) -> None:
    """CONFIGURE alone neither reads nor writes."""
    wheels = fake_actuator("wheels", safe=0.0)

    async with esair.Robot(
        resources=[wheels],
        policies=[Policy("wheels", allow={"me": Access.CONFIGURE})],
        behaviors=[esair.Behavior(name="me")],
    ) as robot:
        right = await robot.resources.register("me", "wheels", Access.CONFIGURE)
        with pytest.raises(esair.NotRegisteredError, match="for CONFIGURE only"):
            await robot.actuators.write(right, 1.0)


@pytest.mark.promise("RS-1")
@pytest.mark.fault("B19")
async def test_a_port_kept_after_the_removal_is_void(fake_actuator: Any) -> None:
    """A reference that outlives its behavior moves nothing."""
    wheels = fake_actuator("wheels", safe=0.0)
    user = writer("user")

    async with esair.Robot(resources=[wheels], behaviors=[user]) as robot:
        port = user.wheels  # type: ignore[attr-defined]
        await robot.behaviors.remove("user")
        with pytest.raises(esair.NotRegisteredError) as caught:
            await port.write(1.0)
        assert isinstance(caught.value, esair.BehaviorRemovedError)
        assert wheels.commands == [0.0]


@pytest.mark.fault("R02")
async def test_asking_again_on_the_same_terms_gives_the_same_right(
    fake_sensor: Any,
) -> None:
    """Registering is idempotent; other terms are another registration."""
    sonar = fake_sensor("sonar", 1.0)

    async with esair.Robot(resources=[sonar]) as robot:
        first = await robot.resources.register("me", "sonar", Access.READ)
        again = await robot.resources.register("me", "sonar", Access.READ)
        other = await robot.resources.register("you", "sonar", Access.READ)

        assert again is first
        assert other.number > first.number
        assert "me may READ sonar" in repr(first)
        assert robot.resources.query("sonar").users == ("me", "you")


@pytest.mark.promise("RS-2")
async def test_without_rules_reading_is_open_and_writing_follows_the_class(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Who did not declare to write may not write; anybody may read."""
    sonar, wheels = fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)

    async with esair.Robot(
        resources=[sonar, wheels], behaviors=[writer("user")]
    ) as robot:
        await robot.resources.register("anybody", "sonar", Access.READ)
        await robot.resources.register("user", "wheels", Access.WRITE)
        with pytest.raises(esair.AccessDeniedError, match="does not declare it"):
            await robot.resources.register("anybody", "wheels", Access.WRITE)
        with pytest.raises(esair.AccessDeniedError, match="CONFIGURE"):
            await robot.resources.register(
                "anybody", "sonar", Access.READ | Access.CONFIGURE
            )


@pytest.mark.promise("RS-2", "RS-6")
async def test_a_denial_names_everything(fake_sensor: Any) -> None:
    """Behavior, resource, what was asked, and the rule."""
    sonar = fake_sensor("sonar", 1.0)
    policy = Policy("sonar", allow={"friend": Access.READ})

    async with esair.Robot(resources=[sonar], policies=[policy]) as robot:
        await robot.resources.register("friend", "sonar", Access.READ)
        with pytest.raises(esair.AccessDeniedError) as caught:
            await robot.resources.register("stranger", "sonar", Access.READ)

    error = caught.value
    assert (error.behavior, error.resource, error.asked) == (
        "stranger",
        "sonar",
        "READ",
    )
    assert "policy of 'sonar' allows it nothing" in error.rule
    assert "'stranger' may not READ 'sonar'" in str(error)
    assert isinstance(error, PermissionError)


@pytest.mark.promise("RS-2")
async def test_the_star_stands_for_everybody_else(fake_sensor: Any) -> None:
    """Named behaviors have their own line, also when it allows less."""
    sonar = fake_sensor("sonar", 1.0)
    policy = Policy("sonar", allow={"enemy": Access(0), "*": Access.READ})

    async with esair.Robot(resources=[sonar], policies=[policy]) as robot:
        await robot.resources.register("somebody", "sonar", Access.READ)
        with pytest.raises(esair.AccessDeniedError):
            await robot.resources.register("enemy", "sonar", Access.READ)


@pytest.mark.promise("RS-2")
@pytest.mark.fault("R07")
async def test_a_policy_bounds_the_priority(fake_actuator: Any) -> None:
    """Nobody outbids the level that the developer gave."""
    wheels = fake_actuator("wheels", safe=0.0)
    policy = Policy("wheels", allow={"*": Access.WRITE}, max_priority={"*": 3})

    async with esair.Robot(resources=[wheels], policies=[policy]) as robot:
        await robot.resources.register("me", "wheels", Access.WRITE, priority=3)
        with pytest.raises(esair.AccessDeniedError, match="priority 3 at most"):
            await robot.resources.register("me", "wheels", Access.WRITE, priority=4)


@pytest.mark.promise("RS-2")
@pytest.mark.fault("R03")
async def test_exclusive_use_has_one_writer_at_a_time(fake_actuator: Any) -> None:
    """The second is denied by name of the first, until the first is gone."""
    wheels = fake_actuator("wheels", safe=0.0)
    policy = Policy("wheels", allow={"*": Access.WRITE}, exclusive=True)

    async with esair.Robot(
        resources=[wheels], policies=[policy], behaviors=[writer("first")]
    ) as robot:
        with pytest.raises(esair.AccessDeniedError, match="'first' writes it"):
            await robot.resources.register("second", "wheels", Access.WRITE)
        await robot.behaviors.remove("first")
        assert await robot.resources.register("second", "wheels", Access.WRITE)


@pytest.mark.promise("RS-2")
async def test_a_wrong_kind_of_access_is_denied(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Sensors are read, actuators are written, and nothing is asked for nothing."""
    sonar, wheels = fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[sonar, wheels]) as robot:
        register = robot.resources.register
        with pytest.raises(esair.AccessDeniedError, match="a sensor is read"):
            await register("me", "sonar", Access.WRITE)
        with pytest.raises(esair.AccessDeniedError, match="an actuator is written"):
            await register("me", "wheels", Access.READ)
        with pytest.raises(esair.AccessDeniedError, match="ask for some access"):
            await register("me", "wheels", Access(0))


@pytest.mark.promise("RS-2")
@pytest.mark.fault("M10", "L02")
async def test_bad_terms_are_refused_before_anything_is_registered(
    fake_actuator: Any,
) -> None:
    """Unknown resource, bad name, access, priority or hold."""
    wheels = fake_actuator("wheels", safe=0.0)

    async with esair.Robot(resources=[wheels], behaviors=[writer("user")]) as robot:
        register = robot.resources.register
        with pytest.raises(esair.UnknownNameError, match="did you mean 'wheels'"):
            await register("user", "weels", Access.WRITE)
        with pytest.raises(esair.ConfigError, match="name"):
            await register("No Name", "wheels", Access.WRITE)
        with pytest.raises(esair.ConfigError, match=r"expected an esair\.Access"):
            await register("user", "wheels", 2)  # type: ignore[arg-type]
        with pytest.raises(esair.ConfigError, match="priority"):
            await register("user", "wheels", Access.WRITE, priority=True)
        for hold in (0, -1.0, float("nan"), float("inf"), True):
            with pytest.raises(esair.ConfigError, match="hold"):
                await register("user", "wheels", Access.WRITE, hold=hold)
        assert robot.resources.query("wheels").users == ("user",)


async def test_a_policy_may_name_a_behavior_that_comes_later(
    fake_actuator: Any,
) -> None:
    """A name that is like no other is no mistake: it may be added while it runs."""
    policy = Policy("wheels", allow={"later": Access.WRITE, "user": Access.WRITE})
    async with esair.Robot(
        resources=[fake_actuator("wheels", safe=0.0)],
        behaviors=[writer("user")],
        policies=[policy],
    ) as robot:
        await robot.behaviors.add(writer("later"))

        assert robot.resources.query("wheels").users == ("user", "later")


async def test_a_name_that_is_like_a_named_one_is_no_mistake(
    fake_actuator: Any,
) -> None:
    """Who has rights of its own was not misspelt by another's name."""
    policy = Policy("wheels", allow={"user": Access.WRITE, "user2": Access.WRITE})
    async with esair.Robot(
        resources=[fake_actuator("wheels", safe=0.0)],
        behaviors=[writer("user")],
        policies=[policy],
    ) as robot:
        await robot.behaviors.add(writer("user2"))

        assert robot.resources.query("wheels").users == ("user", "user2")


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"allow": "write"}, "allow: expected a dict"),
        ({"allow": {"me": "write"}}, "allow.me: expected an esair.Access"),
        ({"allow": {"Me": Access.WRITE}}, "allow 'Me': name"),
        ({"max_priority": 5}, "max_priority: expected a dict"),
        ({"max_priority": {5: 5}}, "max_priority 5: name"),
        ({"exclusive": "yes"}, "exclusive: expected True or False"),
    ],
)
def test_a_policy_is_checked_when_it_is_made(options: Any, part: str) -> None:
    """The error names the resource and the field."""
    with pytest.raises(esair.ConfigError, match=f"policy of 'wheels': {part}"):
        Policy("wheels", **options)


async def test_policies_with_mistakes_stop_the_start(fake_actuator: Any) -> None:
    """All mistakes at once: unknown resource and behavior, bad priority, two policies."""
    wheels = fake_actuator("wheels", safe=0.0)
    policies = [
        Policy("weels", allow={}),
        Policy("wheels", allow={"usr": Access.WRITE}, max_priority={"user": "high"}),  # type: ignore[dict-item]
        Policy("wheels", allow={"usr": Access.WRITE}, max_priority={"user": "high"}),  # type: ignore[dict-item]
    ]
    robot = esair.Robot(
        resources=[wheels], behaviors=[writer("user")], policies=policies
    )

    with pytest.raises(ExceptionGroup) as caught:
        await robot.__aenter__()

    text = "\n".join(str(error) for error in caught.value.exceptions)
    for part in ("'weels'", "more than one policy", "max_priority.user", "allow.usr"):
        assert part in text
    assert wheels.opened == 0


@pytest.mark.promise("RS-3")
@pytest.mark.fault("R09", "B19")
async def test_a_revoked_writer_leaves_a_safe_actuator(fake_actuator: Any) -> None:
    """What the device did was his will, so it ends; others are not disturbed."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    a, b = writer("a", 1), writer("b", 2)

    async with esair.Robot(resources=[wheels], behaviors=[a, b]) as robot:
        await a.wheels.write(1.0)  # type: ignore[attr-defined]
        await b.wheels.write(2.0)  # type: ignore[attr-defined]
        robot.resources.revoke(a.wheels.registration)  # type: ignore[attr-defined]
        await asyncio.sleep(0)
        assert wheels.commands == [0.0, 1.0, 2.0]
        robot.resources.revoke(b.wheels.registration)  # type: ignore[attr-defined]
        robot.resources.revoke(b.wheels.registration)  # type: ignore[attr-defined]
        await asyncio.sleep(0.01)
        assert wheels.commands == [0.0, 1.0, 2.0, 0.0]


@pytest.mark.promise("RS-3")
@pytest.mark.fault("R14")
async def test_a_zombie_of_an_earlier_run_moves_nothing(fake_actuator: Any) -> None:
    """After a restart the old port is refused, the new one works."""
    wheels = fake_actuator("wheels", safe=0.0)
    ports: list[Any] = []

    class Crashes(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            ports.append(self.wheels)
            await self.wheels.write(1.0)
            if len(ports) == 1:
                raise ValueError("crash")
            await asyncio.sleep(10)

    async with esair.Robot(resources=[wheels], behaviors=[Crashes()]):
        await asyncio.sleep(0.5)
        with pytest.raises(esair.NotRegisteredError):
            await ports[0].write(0.7)
        assert await ports[1].write(0.5)
        assert 0.7 not in wheels.commands


@pytest.mark.fault("R16")
async def test_supervisor_and_connections_see_one_table(fake_sensor: Any) -> None:
    """A right that the supervisor revokes is void at the connection in the same step."""
    sonar = fake_sensor("sonar", 1.0)

    async with esair.Robot(resources=[sonar]) as robot:
        right = await robot.resources.register("me", "sonar", Access.READ)
        await robot.sensors.read(right)
        table = robot.sensors.channels["sonar"].registrations
        assert list(table) == [right]
        before = len(table)
        robot.resources.revoke(right)
        assert len(table) == before - 1
        with pytest.raises(esair.NotRegisteredError):
            await robot.sensors.read(right)


@pytest.mark.fault("R15")
async def test_a_stop_is_not_queued_behind_motion(fake_actuator: Any) -> None:
    """A flood of writes does not delay the safe command of the stop."""
    wheels = fake_actuator("wheels", safe=0.0)
    loop = asyncio.get_running_loop()

    class Flood(esair.Behavior):
        wheels = esair.writes(float)

        async def run(self) -> None:
            await asyncio.gather(*(self.pour() for _ in range(100)))

        async def pour(self) -> None:
            while True:
                await self.wheels.write(1.0)
                await asyncio.sleep(0.001)

    async with esair.Robot(resources=[wheels], behaviors=[Flood()]):
        await asyncio.sleep(0.1)
        began = loop.time()
        count = len(wheels.commands)

    assert loop.time() - began < 0.05
    assert wheels.commands[-1] == 0.0
    # One of each that was due already, and safe: at once, and once more at the end.
    assert len(wheels.commands) - count <= 102


async def test_registrations_are_bounded(fake_sensor: Any) -> None:
    """Over the bound registering is refused; memory does not grow."""
    sonar = fake_sensor("sonar", 1.0)

    async with esair.Robot(resources=[sonar]) as robot:
        table = robot.sensors.channels["sonar"].registrations
        for _ in range(65_536):
            table.issue(Terms("me", "sonar", Access.READ))
        with pytest.raises(esair.BusyError, match="registrations"):
            await robot.resources.register("you", "sonar", Access.READ)


async def test_nobody_registers_after_the_stop(fake_sensor: Any) -> None:
    """A stopped robot says so."""
    robot = esair.Robot(resources=[fake_sensor("sonar", 1.0)])
    async with robot:
        pass

    with pytest.raises(esair.StoppingError):
        await robot.resources.register("me", "sonar", Access.READ)


@pytest.mark.promise("RS-1")
async def test_behavior_and_resource_may_be_given_as_they_are(
    fake_sensor: Any,
) -> None:
    """Registering takes the objects as well as their names."""
    sonar, user = fake_sensor("sonar", 1.0), esair.Behavior(name="user")

    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        right = await robot.resources.register(user, sonar, Access.READ)

        assert (right.behavior, right.resource) == ("user", "sonar")


@pytest.mark.fault("M10", "L05")
@pytest.mark.parametrize("name", [None, 5, esair.Behavior(name="user")])
async def test_what_is_no_name_is_the_name_of_nobody(
    fake_sensor: Any, name: Any
) -> None:
    """The error says what was asked for, and which names there are."""
    async with esair.Robot(
        resources=[fake_sensor("sonar", 1.0)], behaviors=[esair.Behavior(name="user")]
    ) as robot:
        with pytest.raises(esair.UnknownNameError, match="user"):
            await robot.behaviors.remove(name)
        with pytest.raises(esair.UnknownNameError, match="sonar"):
            await robot.resources.remove(name)
        with pytest.raises(esair.NotRegisteredError, match="is no registration"):
            await robot.resources.configure(name, rate=1.0)
