"""The resource supervisor: add, remove, replace, configure."""

from __future__ import annotations

import asyncio
import threading
from dataclasses import dataclass
from typing import Any, Optional, Protocol, TypedDict

import attrs
import pytest

import esair
from esair import Access, ResourceState

pytestmark = pytest.mark.virtual_clock


class Gain(esair.Sensor[float]):
    """A sensor with settings that remembers what it was told."""

    gain = esair.setting(1, min=0, max=7)
    offset = esair.setting(0.0, unit="m")

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.log: list[dict[str, Any]] = []
        self.errors: list[BaseException] = []
        self.slow = 0.0

    async def apply(self, **changes: Any) -> None:
        self.log.append(changes)
        await asyncio.sleep(self.slow)
        if self.errors:
            raise self.errors.pop(0)

    async def read(self) -> float:
        return self.gain + self.offset


def user(configure: bool = True) -> Any:
    return esair.Behavior(
        name="user", reads={"gain": esair.reads(float, configure=configure)}
    )


@pytest.mark.promise("RS-4")
async def test_configure_changes_settings_in_the_device() -> None:
    """The device is told, then the attributes change."""
    sensor, me = Gain(), user()

    async with esair.Robot(resources=[sensor], behaviors=[me]) as robot:
        await me.gain.configure(gain=3, offset=1)

        assert sensor.log == [{"gain": 3, "offset": 1}] or sensor.log == [
            {"gain": 3, "offset": 1.0}
        ]
        assert me.gain.settings["gain"] == 3
        assert sensor.settings == {"rate": 10.0, "gain": 3, "offset": 1.0}
        assert robot.resources.query("gain").settings["offset"] == 1.0
        assert await me.gain.read() == 4.0


@pytest.mark.promise("RS-4")
@pytest.mark.fault("G02", "G03")
async def test_every_mistake_of_a_configure_is_named_and_nothing_changes() -> None:
    """Unknown name, wrong type, outside the limits: all at once, before the device."""
    sensor, me = Gain(), user()

    async with esair.Robot(resources=[sensor], behaviors=[me]):
        with pytest.raises(esair.BadValueError) as caught:
            await me.gain.configure(gian=1, gain=9, offset="far", rate=20.0)

        for part in (
            "gian",
            "did you mean 'gain'",
            "at most 7",
            "expected a number in m",
        ):
            assert part in str(caught.value)
        assert sensor.log == []
        assert sensor.settings == {"rate": 10.0, "gain": 1, "offset": 0.0}


@pytest.mark.promise("RS-4")
async def test_configure_needs_the_right() -> None:
    """READ is not CONFIGURE, and a void registration is nothing."""
    sensor, me = Gain(), user(configure=False)

    async with esair.Robot(resources=[sensor], behaviors=[me]) as robot:
        with pytest.raises(
            esair.AccessDeniedError, match="READ only: declare configure=True"
        ):
            await me.gain.configure(gain=3)
        registration = me.gain.registration
        robot.resources.revoke(registration)
        with pytest.raises(esair.NotRegisteredError):
            await robot.resources.configure(registration, gain=3)
        assert sensor.log == []


@pytest.mark.promise("RS-4")
@pytest.mark.fault("R12")
@pytest.mark.parametrize(
    "error", [ValueError("no"), SystemExit(1)], ids=["error", "exit"]
)
async def test_a_half_applied_configure_is_put_back(error: BaseException) -> None:
    """The device gets the values from before; the attributes stay."""
    sensor, me = Gain(), user()

    async with esair.Robot(resources=[sensor], behaviors=[me]):
        sensor.errors = [error]
        with pytest.raises(esair.DeviceFaultError):
            await me.gain.configure(gain=3)

        assert sensor.log == [{"gain": 3}, {"gain": 1}]
        assert sensor.settings["gain"] == 1


@pytest.mark.promise("RS-4")
@pytest.mark.fault("R12")
async def test_a_device_with_unknown_settings_is_opened_anew() -> None:
    """If even putting back fails the device begins again from what is known."""
    sensor, me = Gain(gain=2), user()

    async with esair.Robot(resources=[sensor], behaviors=[me]) as robot:
        sensor.errors = [ValueError("no"), ValueError("no again")]
        with pytest.raises(esair.DeviceFaultError):
            await me.gain.configure(gain=3)
        assert robot.resources.query("gain").state is ResourceState.LOST
        with pytest.raises(esair.DeviceLostError, match="settings are unknown"):
            await me.gain.configure(gain=3)
        await asyncio.sleep(0.3)
        assert robot.resources.query("gain").state is ResourceState.READY
        assert sensor.log[-1] == {"gain": 2}


@pytest.mark.promise("RS-4")
@pytest.mark.fault("X01", "R11")
async def test_a_cancelled_configure_is_finished_without_its_caller() -> None:
    """All settings or none, whoever is impatient; the next one waits for it."""
    sensor, me = Gain(), user()
    sensor.slow = 0.1

    async with esair.Robot(resources=[sensor], behaviors=[me]):
        first = asyncio.create_task(me.gain.configure(gain=3))
        await asyncio.sleep(0.01)
        first.cancel()
        await me.gain.configure(offset=1.0)

        assert first.cancelled()
        assert sensor.settings["gain"] == 3
        assert sensor.settings["offset"] == 1.0


@pytest.mark.promise("RS-4")
async def test_a_configure_that_hangs_is_given_up() -> None:
    """The caller learns of it within the deadline; the settings stay."""
    sensor, me = Gain(), user()

    async with esair.Robot(resources=[sensor], behaviors=[me]):
        sensor.slow = 1000.0
        with pytest.raises(esair.DriverStuckError):
            await me.gain.configure(gain=3)
        assert sensor.settings["gain"] == 1


@pytest.mark.promise("SUP-2")
async def test_an_added_resource_can_be_used_at_once(fake_sensor: Any) -> None:
    """`add` returns when the device was tried."""
    async with esair.Robot() as robot:
        await robot.resources.add(fake_sensor("sonar", 1.0))

        assert robot.resources.names() == ["sonar"]
        assert robot.resources.get("sonar").name == "sonar"
        right = await robot.resources.register("me", "sonar", Access.READ)
        assert (await robot.sensors.read(right)).value == 1.0


@pytest.mark.fault("L01", "G08")
async def test_what_cannot_be_added_leaves_nothing(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """A taken name, a wrong class, a declaration with mistakes, a required one absent."""

    class Mute(esair.Sensor[float]):
        pass

    class Lame(esair.Actuator[float]):
        safe = 0.0

    absent = fake_sensor("absent", 1.0, required=True)
    absent.unplug()
    late = fake_sensor("late", 1.0)
    late.deadline = 0
    async with esair.Robot(resources=[fake_sensor("sonar", 1.0)]) as robot:
        add = robot.resources.add
        with pytest.raises(esair.NameTakenError, match="sonar"):
            await add(fake_sensor("sonar", 2.0))
        with pytest.raises(esair.ConfigError, match="read or stream"):
            await add(Mute())
        with pytest.raises(esair.ConfigError, match="write method"):
            await add(Lame())
        with pytest.raises(esair.ConfigError, match="safe"):
            await add(fake_actuator("wheels"))
        with pytest.raises(esair.ConfigError, match="deadline"):
            await add(late)
        with pytest.raises(ExceptionGroup) as caught:
            await add(
                fake_actuator("wheels", safe=5.0, command_timeout=0, limits=(0, 1))
            )
        assert len(caught.value.exceptions) == 2
        with pytest.raises(esair.DeviceLostError):
            await add(absent)

        assert robot.resources.names() == ["sonar"]
        assert not absent.is_open


@pytest.mark.promise("SUP-5")
@pytest.mark.fault("R10", "L05")
async def test_a_removal_needs_nobodys_consent(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """The actuator is made safe first, its users are told, the name is free again."""
    sonar = fake_sensor("sonar", 1.0)
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=5.0)
    me = esair.Behavior(
        name="me",
        reads={"sonar": esair.reads(float)},
        writes={"wheels": esair.writes(float)},
    )

    async with esair.Robot(resources=[sonar, wheels], behaviors=[me]) as robot:
        await me.wheels.write(1.0)  # type: ignore[attr-defined]
        sonar.stall()
        reading = asyncio.create_task(me.sonar.read())  # type: ignore[attr-defined]
        await asyncio.sleep(0.01)
        await robot.resources.remove("wheels")
        await robot.resources.remove("sonar")

        assert wheels.commands == [0.0, 1.0, 0.0]
        assert not wheels.is_open
        with pytest.raises(esair.ResourceRemovedError):
            await reading
        with pytest.raises(esair.ResourceRemovedError, match="wheels"):
            await me.wheels.write(1.0)  # type: ignore[attr-defined]
        with pytest.raises(esair.UnknownNameError):
            await robot.resources.remove("wheels")
        with pytest.raises(esair.UnknownNameError):
            robot.resources.why("wheels")
        with pytest.raises(esair.UnknownNameError):
            robot.resources.query("sonar")


@pytest.mark.promise("RS-5")
async def test_a_replaced_resource_of_the_same_type_keeps_its_registrations(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Ports go on with the new device; the old actuator is made safe first."""
    old_sonar, new_sonar = (
        fake_sensor("sonar", 1.0, type=float),
        fake_sensor("x", 2.0, type=float),
    )
    old, new = fake_actuator("wheels", safe=0.0), fake_actuator("y", safe=0.0)
    me = esair.Behavior(
        name="me",
        reads={"sonar": esair.reads(float)},
        writes={"wheels": esair.writes(float)},
    )

    async with esair.Robot(resources=[old_sonar, old], behaviors=[me]) as robot:
        assert await me.sonar.read() == 1.0  # type: ignore[attr-defined]
        await me.wheels.write(1.0)  # type: ignore[attr-defined]
        await robot.resources.replace("sonar", new_sonar)
        await robot.resources.replace("wheels", new)

        assert await me.sonar.read() == 2.0  # type: ignore[attr-defined]
        assert await me.wheels.write(0.5)  # type: ignore[attr-defined]
        assert old.commands == [0.0, 1.0, 0.0]
        assert new.commands == [0.0, 0.5]
        assert not old_sonar.is_open
        assert new_sonar.name == "sonar"


@pytest.mark.promise("RS-5")
async def test_a_replaced_resource_of_another_type_loses_its_registrations(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """Who was registered must register again."""
    me = esair.Behavior(name="me", reads={"sonar": esair.reads(float)})

    async with esair.Robot(
        resources=[fake_sensor("sonar", 1.0, type=float)], behaviors=[me]
    ) as robot:
        await robot.resources.replace("sonar", fake_sensor("x", "far", type=str))
        with pytest.raises(esair.ResourceRemovedError):
            await me.sonar.read()  # type: ignore[attr-defined]
        right = await robot.resources.register("me", "sonar", Access.READ)
        assert (await robot.sensors.read(right)).value == "far"
        await robot.resources.replace("sonar", fake_actuator("y", safe=0.0))
        with pytest.raises(esair.ResourceRemovedError):
            await robot.sensors.read(right)
        assert robot.resources.why("sonar").state is ResourceState.READY


@pytest.mark.promise("RS-5")
async def test_a_bad_replacement_leaves_the_old_one_running(fake_sensor: Any) -> None:
    """Mistakes are found before the old one is touched."""
    async with esair.Robot(resources=[fake_sensor("sonar", 1.0)]) as robot:
        with pytest.raises(esair.ConfigError):
            await robot.resources.replace("sonar", "no resource")  # type: ignore[arg-type]
        with pytest.raises(esair.UnknownNameError):
            await robot.resources.replace("radar", fake_sensor("x", 2.0))
        right = await robot.resources.register("me", "sonar", Access.READ)
        assert (await robot.sensors.read(right)).value == 1.0


@pytest.mark.promise("RS-5")
@pytest.mark.fault("D04")
async def test_a_resource_that_vanishes_and_returns_keeps_its_registrations(
    fake_actuator: Any,
) -> None:
    """The same port, the same number, and disarmed until a fresh command."""
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=10.0)
    me = esair.Behavior(name="me", writes={"wheels": esair.writes(float)})

    async with esair.Robot(resources=[wheels], behaviors=[me]) as robot:
        await me.wheels.write(1.0)  # type: ignore[attr-defined]
        number = me.wheels.registration.number  # type: ignore[attr-defined]
        wheels.unplug()
        with pytest.raises(esair.DeviceLostError):
            await me.wheels.write(1.0)  # type: ignore[attr-defined]
        wheels.plug()
        await asyncio.sleep(1.0)
        assert wheels.commands == [0.0, 1.0, 0.0]
        assert await me.wheels.write(0.5)  # type: ignore[attr-defined]
        assert me.wheels.registration.number == number  # type: ignore[attr-defined]
        assert robot.resources.query("wheels").users == ("me",)


@pytest.mark.promise("RS-4")
@pytest.mark.real_clock
async def test_a_blocking_apply_runs_on_the_thread() -> None:
    """Settings of blocking drivers are sent where its other calls are made."""
    threads: list[str] = []

    class Arm(esair.Actuator[float]):
        safe = 0.0
        gain = esair.setting(1)

        def apply(self, **changes: Any) -> None:
            threads.append(threading.current_thread().name)

        def write(self, command: float) -> None:
            return None

    me = esair.Behavior(name="me", writes={"arm": esair.writes(float, configure=True)})
    async with esair.Robot(resources=[Arm()], behaviors=[me]):
        await me.arm.configure(gain=5)  # type: ignore[attr-defined]
        assert me.arm.settings == {"gain": 5}  # type: ignore[attr-defined]
        assert me.arm.state is ResourceState.READY  # type: ignore[attr-defined]
    assert threads == ["esair-arm"]


async def test_what_is_no_resource_is_not_added() -> None:
    """The error says what was expected, whatever was given."""
    async with esair.Robot() as robot:
        for wrong in ("lamp", None, esair.Behavior(name="user")):
            with pytest.raises(esair.ConfigError, match="expected an esair"):
                await robot.resources.add(wrong)  # type: ignore[arg-type]


@pytest.mark.promise("RES-1", "RS-5")
async def test_a_resource_may_say_what_it_is_only_when_it_is_open() -> None:
    """Its `repr` is not asked for before."""

    class Named(Gain):
        async def open(self) -> None:
            self.number = 7

        def __repr__(self) -> str:
            return f"<gain {self.number}>"

    async with esair.Robot() as robot:
        await robot.resources.add(Named(name="gain"))
        assert robot.resources.query("gain").state is ResourceState.READY


async def test_a_union_or_a_described_dict_is_a_type_of_values() -> None:
    """Each alternative may come; what has no instances of its own is not checked."""

    class Fix(TypedDict):
        latitude: float

    class Named(Protocol):
        name: str

    class Sonar(esair.Sensor["float | None"]):
        value: Any = None
        kind: Any = float | None

        @property
        def value_type(self) -> Any:
            return self.kind

        async def read(self) -> Any:
            return self.value

    fits: list[tuple[Any, Any, Any]] = [
        (float | None, float | None, None),
        (float | None, Optional[float], 1.0),  # noqa: UP045 - the same in old words
        (float, float | None, 1.0),
        (Fix, Fix, {"latitude": 1.0}),
        (Named, Named, 1),
    ]
    for kind, wanted, value in fits:
        sonar = Sonar()
        sonar.kind, sonar.value = kind, value
        user: Any = esair.Behavior(name="user", reads={"sonar": esair.reads(wanted)})
        async with esair.Robot(resources=[sonar], behaviors=[user]):
            assert await user.sonar.read() == value

    misfits: list[tuple[Any, Any]] = [
        (float | None, float),
        (float | str, float | None),
        (dict, Fix),
    ]
    for kind, wanted in misfits:
        sonar = Sonar()
        sonar.kind = kind
        user = esair.Behavior(name="user", reads={"sonar": esair.reads(wanted)})
        with pytest.raises(ExceptionGroup):
            await esair.Robot(resources=[sonar], behaviors=[user]).__aenter__()


@pytest.mark.parametrize("kind", ["sonar", 5, None])
async def test_a_declared_type_is_a_type(fake_sensor: Any, kind: Any) -> None:
    """A name in its place, which is an easy mistake, stops the start."""
    user = esair.Behavior(name="user", reads={"sonar": esair.reads(kind)})
    with pytest.raises(ExceptionGroup) as caught:
        await esair.Robot(
            resources=[fake_sensor("sonar", 1.0)], behaviors=[user]
        ).__aenter__()
    assert "user: sonar: expected a type" in str(caught.value.exceptions[0])


@dataclass
class Pump(esair.Actuator[float]):
    """A device whose class compares its fields, and so has no hash."""

    pin: int = 3
    safe = 0.0

    async def write(self, command: float) -> None:
        """Nothing is connected."""


async def test_a_device_may_be_a_dataclass() -> None:
    """What can be compared and has no hash is opened like any other."""
    async with esair.Robot(resources=[Pump(pin=4)]) as robot:
        assert robot.resources.query("pump").state is ResourceState.READY


class Lamp(esair.Sensor["Light"]):
    """A sensor of a type that its module defines below it."""

    async def read(self) -> Light:
        return Light("red")


@attrs.frozen
class Light:
    """What it shows."""

    color: str


class Stop(esair.Reaction):
    """Reads it by its class."""

    lamp = esair.reads(Light)
    pump = esair.writes(float)

    def react(self, lamp: Light) -> float:
        return 0.0 if lamp.color == "red" else 1.0


async def test_a_type_may_be_named_before_it_is_defined() -> None:
    """A type in quotes is the class of that name in its module."""
    async with esair.Robot(resources=[Lamp(), Pump()], behaviors=[Stop()]) as robot:
        assert robot.resources.query("lamp").state is ResourceState.READY


@dataclass(frozen=True)
class Frozen(esair.Sensor[float]):
    """A device that could keep nothing."""


@attrs.frozen
class FrozenToo(esair.Behavior):
    """A behavior that could keep nothing."""


@pytest.mark.parametrize("cls", [Frozen, FrozenToo])
def test_a_component_cannot_be_frozen(cls: type) -> None:
    """It is told when it is made, by the name of its class."""
    with pytest.raises(esair.ConfigError, match="frozen"):
        cls()
