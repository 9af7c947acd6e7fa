"""What stops a robot from starting, or a resource from being added."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Protocol

import pytest

import esair
from esair.buses import CanBus, I2CBus
from esair.testing import FakeActuator, FakeCan, FakeI2c

if TYPE_CHECKING:
    from esair.buses import SerialBus

pytestmark = pytest.mark.virtual_clock


class Motor(FakeActuator):
    """A motor that is one node of a bus."""

    def __init__(self, name: str, node: int, bus: Any) -> None:
        super().__init__(name, safe=0.0)
        self.bus = bus
        self.claim = f"node {node}"


async def refused(*resources: Any) -> list[str]:
    """Return the mistakes for which a robot does not start."""
    with pytest.raises(ExceptionGroup) as caught:
        await esair.Robot(resources=resources).__aenter__()
    return [str(each) for each in caught.value.exceptions]


async def test_two_actuators_of_one_motor_do_not_start() -> None:
    """Each would have priorities and a time-out of its own."""
    bus = FakeCan("drive")

    assert await refused(Motor("left", 1, bus), Motor("right", 1, bus)) == [
        "right: node 1 belongs to 'left': they cannot share it"
    ]


async def test_what_is_claimed_is_claimed_on_one_bus() -> None:
    """There is a node 1 on each bus."""
    one, other = FakeCan("one"), FakeCan("other")
    motors = [Motor("a", 1, one), Motor("b", 2, one), Motor("c", 1, other)]

    async with esair.Robot(resources=motors):
        assert all(motor.commands == [0.0] for motor in motors)


async def test_what_is_claimed_cannot_be_added_again() -> None:
    """But the new one may take the place of the old one."""
    bus = FakeCan("drive")

    async with esair.Robot(resources=[Motor("left", 1, bus)]) as robot:
        with pytest.raises(esair.ConfigError, match="right: node 1 belongs to 'left'"):
            await robot.resources.add(Motor("right", 1, bus))
        await robot.resources.replace("left", Motor("left", 1, bus))
        await robot.resources.remove("left")
        await robot.resources.add(Motor("right", 1, bus))


class Chip(esair.Sensor[float]):
    """A part on an I2C bus."""

    bus: I2CBus

    async def read(self) -> float:
        return 1.0


class Either(Chip):
    """A part that comes for two buses."""

    bus: I2CBus | CanBus  # type: ignore[assignment]


class Unsaid(esair.Sensor[float]):
    """A part whose bus only a type checker can see."""

    bus: SerialBus

    async def read(self) -> float:
        return 1.0


class Sends(Protocol):
    """What a bus can do."""

    async def send(self, data: bytes) -> None: ...


class Loose(esair.Sensor[float]):
    """A part for whatever sends; that cannot be told before it does."""

    bus: Sends

    async def read(self) -> float:
        return 1.0


@pytest.mark.parametrize("bus", [None, FakeCan("drive")])
async def test_a_device_on_a_wrong_bus_does_not_start(bus: Any) -> None:
    """Its class says which one it needs; a mistake is not waited for."""
    (told,) = await refused(Chip(bus=bus))

    assert told.startswith("chip: bus: expected an I2CBus, ")


@pytest.mark.parametrize(
    "chip",
    [
        lambda: Chip(bus=FakeI2c()),
        lambda: Either(bus=FakeCan()),
        lambda: Unsaid(bus=FakeCan()),
        lambda: Unsaid(),
        lambda: Loose(bus=FakeCan()),
    ],
)
async def test_a_device_on_a_bus_that_fits_starts(chip: Any) -> None:
    """One of several, or one that cannot be told."""
    async with esair.Robot(resources=[chip()]) as robot:
        assert len(robot.resources.names()) == 1


def raises(_: Any) -> Any:
    """Compute an attribute of a class whose author made a mistake."""
    raise ValueError("boom")


@pytest.mark.parametrize("field", ["value_type", "deadline", "limits"])
async def test_a_property_that_raises_is_a_mistake_of_one_field(field: str) -> None:
    """Its component and its name are told, of a robot as of what is added to one."""
    broken = type("Broken", (Chip,), {field: property(raises)})
    said = f"broken: {field}: expected a value, its property raises ValueError: boom"

    assert await refused(broken(bus=FakeI2c())) == [said]
    async with esair.Robot() as robot:
        with pytest.raises(esair.ConfigError, match=said):
            await robot.resources.add(broken(bus=FakeI2c()))


@pytest.mark.parametrize("field", ["inbox_size", "restart", "essential"])
async def test_a_property_of_a_behavior_is_one_too(field: str) -> None:
    """No other rule is asked of what cannot tell its own fields."""
    broken = type("Broken", (esair.Behavior,), {field: property(raises)})

    with pytest.raises(ExceptionGroup) as caught:
        await esair.Robot(behaviors=[broken()]).__aenter__()
    assert [each.field for each in caught.value.exceptions] == [field]


async def test_what_is_asked_when_open_may_not_be_known_before() -> None:
    """Of a driver that looks at its device for it; what raises then is its fault."""

    class Late(FakeActuator):
        """It knows by what its device says whether it can tell."""

        async def open(self) -> None:
            self.can_tell = False

        @property
        def can_tell_set_up(self) -> bool:
            return self.can_tell

    broken = type("Broken", (Late,), {"can_tell_set_up": property(raises)})
    parts = [Late("wheels", safe=0.0), broken("arm", safe=0.0)]
    async with asyncio.timeout(5.0):
        async with esair.Robot(resources=parts) as robot:
            states = [robot.resources.query(each.name) for each in parts]

    ready, lost = esair.ResourceState.READY, esair.ResourceState.LOST
    assert [each.state for each in states] == [ready, lost]
    assert "boom" in str(states[1].error)


@pytest.mark.parametrize("field", ["counts", "counted", "is_set_up"])
async def test_a_property_that_nobody_asks_before_it_is_open_may_raise(
    field: str,
) -> None:
    """An encoder has its counts when its device is there."""
    late = type("Late", (Chip,), {field: property(raises)})

    async with esair.Robot(resources=[late(bus=FakeI2c())]) as robot:
        state = robot.resources.query("late").state

    assert state is esair.ResourceState.READY
