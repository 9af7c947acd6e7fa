"""A secret setting works as any other, and nobody sees its value."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import esair
from esair.journal import Kind

SECRET = "hunter2-and-more"


class Camera(esair.Sensor[float]):
    """Has a password, and notes which one its device was told."""

    password = esair.setting("", secret=True, doc="of the stream")
    told = ""

    async def read(self) -> float:
        return 1.0

    async def apply(self, **changes: Any) -> None:
        self.told = changes.get("password", self.told)


@pytest.mark.promise("RS-4")
@pytest.mark.virtual_clock
async def test_a_secret_is_applied_and_never_shown() -> None:
    """The device has it; status and journal, which recordings are made of, have not."""
    camera = Camera()
    right = esair.Access.READ | esair.Access.CONFIGURE
    policy = esair.Policy("camera", allow={"*": right})
    events: list[Any] = []
    async with esair.Robot(resources=[camera], policies=[policy]) as robot:
        robot.journal.listen(events.append)
        mine = await robot.resources.register("me", "camera", right)
        await robot.resources.configure(mine, password=SECRET)
        await asyncio.sleep(0.01)
        assert camera.told == camera.password == SECRET
        assert SECRET not in repr(robot.resources.query("camera"))
        with pytest.raises(esair.BadValueError, match="password") as caught:
            await robot.resources.configure(mine, password=[SECRET])
        assert SECRET not in str(caught.value)
    assert any(each.kind is Kind.CONFIGURED for each in events)
    assert SECRET not in repr(events)


@pytest.mark.promise("RS-4")
@pytest.mark.virtual_clock
async def test_what_is_no_secret_is_shown_beside_one() -> None:
    """As it was applied, with the word that stands for the secret."""

    class Zooms(Camera):
        zoom = esair.setting(1.0)

    right = esair.Access.READ | esair.Access.CONFIGURE
    policy = esair.Policy("camera", allow={"*": right})
    shown: list[Any] = []
    async with esair.Robot(
        resources=[Zooms(name="camera")], policies=[policy]
    ) as robot:
        robot.journal.listen(
            lambda event: shown.append(event.value), kinds=[Kind.CONFIGURED]
        )
        mine = await robot.resources.register("me", "camera", right)
        await robot.resources.configure(mine, zoom=2, password=SECRET)
        await asyncio.sleep(0.01)
    assert shown == [{"zoom": 2.0, "password": "(secret)"}]


def test_a_subclass_keeps_the_secret() -> None:
    """Another default is as secret as the first."""

    class Mine(Camera):
        password = SECRET

    with pytest.raises(esair.BadValueError) as caught:
        Mine(password=1.5)
    assert SECRET not in str(caught.value)
    assert vars(Mine)["password"].secret
