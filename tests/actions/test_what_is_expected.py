"""A behavior may say which type it expects, and is told when something else comes."""

from __future__ import annotations

from typing import Any

import pytest

import esair

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("BS-9", "BEH-1")]


class Sonar(esair.Sensor[float]):
    """Metres."""

    async def read(self) -> float:
        return 2.5


class Lamp(esair.Actuator[bool]):
    """On or off."""

    safe = False

    async def write(self, command: bool) -> None:
        """Switch."""


class Idle(esair.Behavior):
    """Does nothing."""


async def test_data_of_the_type_is_handed_over() -> None:
    """A whole number passes as a float; what comes is untouched."""
    one, two = Idle(name="one"), Idle(name="two")
    async with esair.Robot(behaviors=[one, two]):
        one.offer(2)
        await one.put("two", "text")
        await one.put("two", 3)

        assert await two.get("one", as_type=float) == 2
        assert await two.receive(as_type=str) == "text"
        assert await two.receive_from(as_type=int) == ("one", 3)


@pytest.mark.parametrize("verb", ["get", "receive", "receive_from"])
async def test_something_else_is_named_with_its_sender(verb: str) -> None:
    """Behavior and verb, what was expected from whom, and what came."""
    one, two = Idle(name="one"), Idle(name="two")
    async with esair.Robot(behaviors=[one, two]):
        one.offer("a map")
        await one.put("two", "a map")
        asked: Any = getattr(two, verb)
        arguments = ["one"] if verb == "get" else []

        with pytest.raises(
            esair.BadValueError, match=r"two: \w+: expected float from one, not 'a map'"
        ):
            await asked(*arguments, as_type=float)


async def test_a_port_of_another_type_is_refused_before_it_is_registered() -> None:
    """What a resource gives or takes is checked as for a declared port."""
    idle = Idle()
    parts = [Sonar(), Lamp()]
    async with esair.Robot(resources=parts, behaviors=[idle]) as robot:
        with pytest.raises(
            esair.ConfigError, match="reads str, but 'sonar' gives float"
        ):
            await idle.register("sonar", esair.Access.READ, as_type=str)
        with pytest.raises(
            esair.ConfigError, match="writes float, but 'lamp' takes bool"
        ):
            await idle.register("lamp", esair.Access.WRITE, as_type=float)

        assert len(robot._resources.registrations) == 0


async def test_a_thread_may_say_so_too() -> None:
    """The same with calls that wait."""
    seen: list[object] = []

    class Counts(esair.ThreadBehavior):
        def run(self) -> None:
            seen.append(self.receive(as_type=int))
            sonar = self.register("sonar", esair.Access.READ, as_type=float)
            seen.append(sonar.read())
            try:
                self.receive(as_type=int)
            except esair.BadValueError as error:
                seen.append(str(error))

    async with esair.Robot(resources=[Sonar()], behaviors=[Counts()]) as robot:
        await robot.behaviors.put(1, sender="user", receiver="counts")
        await robot.behaviors.put("x", sender="user", receiver="counts")
        await robot.ended()

    assert seen == [1, 2.5, "counts: receive: expected int from user, not 'x'"]
