"""The head, with a camera that plays pictures and a servo that is none."""

import asyncio

import follow_color
import numpy as np
import pytest

from esair.drivers.camera import Camera
from esair.drivers.camera.fake import FakeCamera
from esair.drivers.servo import GOAL_VELOCITY, ServoBus
from esair.drivers.servo.fake import FakeServos

pytestmark = pytest.mark.virtual_clock


def scene(column: int | None) -> np.ndarray:
    """A gray room, with a red ball or none."""
    made = np.full((48, 64, 3), 90, dtype=np.uint8)
    if column is not None:
        made[20:28, max(0, column - 4) : column + 4] = (20, 20, 220)
    return made


async def test_it_turns_to_the_ball_and_stands_without_one() -> None:
    """To the left it is positive, as angles are."""
    far, servos = FakeCamera([scene(None)]), FakeServos([1])
    bus = ServoBus(name="line", wire=servos)
    turns = {}
    async with follow_color.make_robot(Camera(name="eye", opener=far.open), bus):
        for where, column in [("left", 8), ("none", None), ("right", 56)]:
            far.pictures[:] = [scene(column)]
            await asyncio.sleep(1.0)
            turns[where] = servos.servos[1].get(GOAL_VELOCITY)
        far.silent = True
        await asyncio.sleep(3.0)
        assert servos.servos[1].get(GOAL_VELOCITY) == 0
    assert turns["left"] > 30
    assert turns["none"] == 0
    assert turns["right"] < -30
