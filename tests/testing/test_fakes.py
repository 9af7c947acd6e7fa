"""The fakes of the kit: late, deaf, and true about when a command lands."""

from __future__ import annotations

import asyncio

import pytest

from esair.testing import FakeActuator, FakeSensor

pytestmark = pytest.mark.virtual_clock


def now() -> float:
    return asyncio.get_running_loop().time()


async def test_a_slow_fake_notes_when_a_command_lands() -> None:
    """Not when the call begins, nor when it returns."""
    wheels = FakeActuator("wheels", safe=0.0)
    wheels.slow(0.5, acknowledge=0.3)
    writing = asyncio.create_task(wheels.write(1.0))
    await asyncio.sleep(0.4)
    assert wheels.commands == []
    await asyncio.sleep(0.2)
    assert wheels.commands == [1.0]
    assert wheels.landed == pytest.approx([0.5])
    assert not writing.done()
    await writing
    assert now() == pytest.approx(0.8)


async def test_a_fake_swallows_as_many_cancellations_as_told() -> None:
    """The command lands all the same; the next cancellation ends the call."""
    wheels = FakeActuator("wheels", safe=0.0)
    wheels.slow(1.0)
    wheels.swallow(1)
    for command, lands in ((1.0, True), (2.0, False)):
        writing = asyncio.create_task(wheels.write(command))
        await asyncio.sleep(0.1)
        writing.cancel()
        await asyncio.wait({writing})
        assert writing.cancelled() is not lands
        assert (command in wheels.commands) is lands


async def test_a_slow_sensor_answers_with_what_it_measured() -> None:
    """What is fed while it answers comes with the next answer."""
    sonar = FakeSensor("sonar", 1.0)
    sonar.slow(0.1, acknowledge=0.2)
    reading = asyncio.create_task(sonar.read())
    await asyncio.sleep(0.2)
    sonar.feed(2.0)
    assert await reading == 1.0
    assert await sonar.read() == 2.0


async def test_a_power_cycle_takes_the_set_up() -> None:
    """Until it is opened again."""
    sonar = FakeSensor("sonar", 1.0)
    await sonar.open()
    assert await sonar.is_set_up()
    sonar.power_cycle()
    assert not await sonar.is_set_up()
    await sonar.open()
    assert await sonar.is_set_up()


async def test_what_is_in_a_command_is_kept_as_it_was_when_it_landed() -> None:
    """An object that changes later does not change what the device was told."""
    wheels = FakeActuator("wheels", safe={"left": 0.0})
    command = {"left": 1.0}
    await wheels.write(command)
    command["left"] = 2.0
    assert wheels.commands == [{"left": 1.0}]
