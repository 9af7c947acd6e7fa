"""Shared arm: two ask one behavior, which does one thing after the other.

arm     PPPPSSSSPPPPSSSS
"""

import attrs
from steps import Reach

import esair


@attrs.frozen
class Move(esair.Request[str]):
    """What the arm shall do."""

    command: str


class Arm(esair.Behavior):
    """Is the only one that moves the arm; orders wait in their order."""

    orders = esair.takes(Move)

    async def run(self) -> None:
        async for request in self.orders:
            async with request:
                request.answer(await self.perform(Reach(request.data.command)))


class Picker(esair.Behavior):
    """Wants the arm again and again."""

    command = "pick"

    async def run(self) -> None:
        for _ in range(2):
            await self.ask("arm_owner", Move(self.command))


class Sorter(Picker):
    """So does this one."""

    command = "sort"


def make_robot(*parts: esair.Resource) -> esair.Robot:
    """Return the robot."""
    people = [Picker(), Sorter()]
    return esair.Robot(resources=parts, behaviors=[Arm(name="arm_owner"), *people])
