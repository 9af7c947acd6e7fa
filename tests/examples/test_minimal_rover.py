"""The rover on a Pico: the same file on CPython, in MIN and in STD."""

import sys

import pytest

import esair
from esair.boards import stand_in
from esair.minimal import Loop


@pytest.fixture
def pins(monkeypatch):
    """Nothing in the way, nothing touched."""
    for each in ("inputs", "outputs", "echoes"):
        monkeypatch.setattr(stand_in, each, {})
    monkeypatch.setitem(sys.modules, "machine", stand_in)
    stand_in.echoes.update({3: 9000, 5: 9000, 7: 9000})
    return stand_in


def parts():
    from minimal_rover import rover_pins as rover

    return (
        [rover.Ranges((2, 4, 6), (3, 5, 7)), rover.Bumper(14, 15)],
        rover.Wheels(16, 17),
    )


@pytest.mark.promise("MIN-2")
def test_it_turns_away_from_a_wall(pins) -> None:
    """In MIN: a wall ahead, and the wheels turn against each other."""
    from esair.demo import Avoid, Bump

    sensors, wheels = parts()
    loop = Loop([Bump(), Avoid()], sensors, [wheels], rate=20)
    loop.step()
    pins.echoes[5] = 800
    loop.step()
    loop.close()

    left, right = pins.outputs[16], pins.outputs[17]
    assert left[-3] + right[-3] == 3000000
    assert left[-3] != right[-3]
    assert left[-2:] == right[-2:] == [1500000, 0]
    assert loop.faults == 0


@pytest.mark.virtual_clock
@pytest.mark.promise("MIN-2")
async def test_it_turns_away_in_std_too(pins) -> None:
    """The same parts in a Robot."""
    import asyncio

    from esair.demo import Avoid, Bump

    sensors, wheels = parts()
    pins.echoes[5] = 800

    async with esair.Robot(resources=[*sensors, wheels], behaviors=[Bump(), Avoid()]):
        await asyncio.sleep(0.5)

    left, right = pins.outputs[16], pins.outputs[17]
    assert any(a + b == 3000000 != 2 * a for a, b in zip(left, right, strict=True))
    assert left[-2:] == right[-2:] == [1500000, 0]
