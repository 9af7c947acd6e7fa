"""The rover that docks, on a clock that jumps."""

import asyncio

import docking
import pytest
import yard as world

import esair


@pytest.mark.virtual_clock
async def test_docks_at_the_second_attempt(capsys) -> None:
    """It gets stuck at the stone, remembers where, backs off, and drives in."""
    yard = world.Yard()

    async with docking.make_robot(yard) as robot:
        await asyncio.sleep(15.0)

        assert robot.behaviors.query("captain").state is esair.BehaviorState.FINISHED
        assert await robot.behaviors.get(
            sender="memory", receiver="user"
        ) == pytest.approx(0.5)

    assert capsys.readouterr().out == "battery low: dock\ndocked, attempt 2\n"
    assert yard.distance < 0.02
    assert yard.twist == world.Wheels.safe


@pytest.mark.virtual_clock
async def test_gives_up_after_three_attempts(capsys) -> None:
    """A stone that stays costs three attempts, then the captain is told."""

    class Blocked(world.Yard):
        def look(self) -> world.Sight:
            self.stone = True
            return super().look()

    yard = Blocked()

    async with docking.make_robot(yard):
        await asyncio.sleep(40.0)

    assert capsys.readouterr().out == "battery low: dock\nno way in\n"
    assert yard.twist == world.Wheels.safe


async def test_approach_is_slow_where_it_got_stuck(fake_sensor, fake_actuator) -> None:
    """What the memory gives decides from where on the rover is careful."""
    beacon = fake_sensor("beacon", world.Sight(bearing=0.0, distance=0.45))
    battery = fake_sensor("battery", 12.0)
    wheels = fake_actuator("wheels", safe=world.Twist(0.0, 0.0))
    robot = esair.Robot(
        resources=[beacon, battery, wheels],
        behaviors=[docking.Memory(), docking.Docking()],
    )

    async with robot:
        await robot.behaviors.put(0.4, sender="user", receiver="memory")
        asking = asyncio.ensure_future(
            robot.behaviors.ask(docking.Dock(), sender="user", receiver="docking")
        )
        await wheels.until(lambda twist: twist.linear > 0.0, timeout=6.0)

        assert wheels.commands[-1] == world.Twist(0.2, 0.0)
        asking.cancel()
