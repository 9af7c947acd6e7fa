"""The greenhouse, on a clock that jumps."""

import asyncio

import greenhouse
import pytest

import esair


@pytest.mark.virtual_clock
async def test_a_day_goes_by_the_plan_and_within_the_limits() -> None:
    """The relays are on only in their hours, and never against a limit."""
    house = greenhouse.House()
    seen: set[tuple[str, int]] = set()

    async with greenhouse.make_robot(house):
        for _ in range(1440):
            await asyncio.sleep(0.1)
            seen |= {(name, int(house.hour)) for name, on in house.on.items() if on}
            assert house.air < 26.5
            assert house.soil < 0.45

    assert {hour for name, hour in seen if name == "lamp"} <= {16, 17, 18, 19, 20, 21}
    assert {hour for name, hour in seen if name == "heater"} & {6, 7, 8}
    assert {hour for name, hour in seen if name == "pump"} <= {7, 8, 19, 20}
    assert house.on == {"heater": False, "pump": False, "lamp": False}


async def switch(robot: esair.Robot, relay: str, on: bool, seconds: float) -> float:
    return await robot.behaviors.ask(
        greenhouse.Switch(relay, on, seconds), sender="user", receiver="hand"
    )


@pytest.mark.virtual_clock
async def test_a_hand_overrides_the_plan_for_a_while() -> None:
    """At night the lamp goes on for as long as was asked, and off by itself."""
    house = greenhouse.House()

    async with greenhouse.make_robot(house) as robot:
        await asyncio.sleep(0.5)
        assert not house.on["lamp"]
        asked = asyncio.ensure_future(switch(robot, "lamp", True, 5.0))
        await asyncio.sleep(3.0)
        assert house.on["lamp"]
        assert await asked == 5.0
        await asyncio.sleep(0.3)
        assert not house.on["lamp"]


@pytest.mark.virtual_clock
async def test_a_hand_does_not_override_a_limit() -> None:
    """Who asks for heat in the warm is told which guard said no."""
    house = greenhouse.House()
    house.air = 30.0

    async with greenhouse.make_robot(house) as robot:
        await asyncio.sleep(0.5)
        with pytest.raises(esair.RefusedError, match="not_too_warm does not allow"):
            await switch(robot, "heater", True, 5.0)
        with pytest.raises(esair.RefusedError, match="there are heater, pump, lamp"):
            await switch(robot, "fan", True, 5.0)
        assert not house.on["heater"]


async def test_a_silent_thermometer_switches_the_heater_off(
    fake_sensor, fake_actuator
) -> None:
    """Whatever the plan says."""
    air, soil = fake_sensor("air", 15.0), fake_sensor("soil", 0.2)
    hour = fake_sensor("hour", 7.0)
    relays = [
        fake_actuator(name, safe=False, command_timeout=2.0) for name in greenhouse.PLAN
    ]
    robot = esair.Robot(
        resources=[air, soil, hour, *relays],
        behaviors=[greenhouse.NotTooWarm(), greenhouse.NotTooWet(), greenhouse.Plan()],
    )

    async with robot:
        await relays[0].until(True, timeout=2.0)
        air.stall()
        await relays[0].until(False, timeout=3.5)
        told = len(relays[0].commands)
        await asyncio.sleep(5.0)
        assert True not in relays[0].commands[told:]
        assert relays[1].commands[-1] is True
