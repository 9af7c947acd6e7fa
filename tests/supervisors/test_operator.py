"""What an operator types, and what is told."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from tests.supervisors.actors import Driver, Idle, wheels

import esair

pytestmark = pytest.mark.virtual_clock


async def test_the_operators_commands() -> None:
    """Each command answers in words."""
    device = wheels()
    async with esair.Robot(resources=[device], behaviors=[Driver(), Idle()]) as robot:
        command = robot.behaviors.command
        await asyncio.sleep(0.1)
        await robot.behaviors.put(1, sender="user", receiver="idle")

        assert await command("list") == "driver: running\nidle: running"
        assert await command("query driver") == "driver: running, 0 restarts"
        assert "held by driver" in await command("why wheels")
        assert "remove" in await command("help")
        assert await command("remove idle") == (
            "idle was removed; 1 messages were not taken"
        )
        assert await command("remove driver") == "driver was removed"


async def test_the_operators_mistakes_are_explained() -> None:
    """The error says what was expected."""
    async with esair.Robot() as robot:
        for text, expected in (
            ("", "there are list"),
            ("remov x", "did you mean 'remove'"),
            ("remove", "expected: remove NAME"),
            ("list all", "expected: list"),
            ("remove 'x", "quotation"),
        ):
            with pytest.raises(esair.ConfigError, match=expected):
                await robot.behaviors.command(text)
        with pytest.raises(esair.UnknownNameError):
            await robot.behaviors.command("query nobody")
        with pytest.raises(esair.ConfigError, match="expected a line of text"):
            await robot.behaviors.command(None)  # type: ignore[arg-type]


@pytest.mark.promise("SEC-1")
async def test_a_command_that_is_not_known_is_quoted_in_the_error() -> None:
    """No escape of a terminal gets through, and no text without end."""
    async with esair.Robot() as robot:
        with pytest.raises(esair.ConfigError) as raised:
            await robot.behaviors.command("\x1b[31m" + "x" * 10_000)

    assert "\x1b" not in str(raised.value)
    assert len(str(raised.value)) < 300


@pytest.mark.promise("SUP-1")
async def test_what_is_typed_while_it_starts_is_done() -> None:
    """And the error of one that does not run says in words what it is doing."""
    told: list[str] = []

    class Early(esair.Behavior):
        async def run(self) -> None:
            told.append(await robot.behaviors.command("list"))

    robot = esair.Robot(behaviors=[Early()])
    with pytest.raises(esair.StoppingError, match="it is not started yet"):
        await robot.behaviors.command("list")
    async with robot:
        await robot.ended()
    assert told == ["early: running"]
    with pytest.raises(esair.StoppingError, match="it is stopped"):
        await robot.behaviors.command("list")


class Pace(esair.Behavior):
    """A behavior that a line can bring."""

    speed = 0.1

    async def run(self) -> None:
        await asyncio.sleep(3600.0)


class Level(esair.Sensor[float]):
    """A sensor that a line can bring."""

    offset = 0.0

    async def read(self) -> float:
        return 1.0 + self.offset


@pytest.mark.promise("SUP-1")
async def test_a_typed_line_brings_a_class_with_its_keys() -> None:
    """What a robot.toml could say of a component can be typed, for both supervisors."""
    here = __name__
    async with esair.Robot() as robot:
        behaviors, resources = robot.behaviors, robot.resources
        told = await behaviors.command(f"add {here}:Pace name=left speed=0.3")
        assert told == "left was added"
        assert behaviors.action("left").speed == 0.3
        await behaviors.command(f"replace left {here}:Pace speed=0.5")
        assert behaviors.action("left").speed == 0.5
        await resources.command(f"add {here}:Level offset=2")
        assert robot.resources.get("level").offset == 2
        for line, expected in (
            (f"add {here}:Pace spede=1", "did you mean 'speed'"),
            (f"add {here}:Pac", "did you mean 'Pace'"),
            (f"add {here}:asyncio", "no class"),
            (f"add {here}:pytest.Item", "expected a Sensor, an Actuator"),
            ("add no_module:Pace", "there is no module"),
            (f"add x {here}:Pace", "expected: add module:Class"),
            (f"add {here}:Pace name=left", "left"),
            (f"replace nobody {here}:Pace", "nobody"),
        ):
            with pytest.raises(esair.EsairError, match=expected):
                await behaviors.command(line)
        assert behaviors.names() == ["left"]


@pytest.mark.promise("SUP-1")
async def test_a_sender_must_exist() -> None:
    """Nothing is asked in the name of a component that is not there."""

    class Count(esair.Request[int]):
        pass

    async with esair.Robot(behaviors=[Idle(), Pace()]) as robot:
        there = robot.behaviors
        for request in (
            there.put(1, sender="pase", receiver="idle"),
            there.get(sender="idle", receiver="pase"),
            there.ask(Count(), sender="pase", receiver="idle"),
        ):
            with pytest.raises(esair.UnknownNameError, match="did you mean 'pace'"):
                await request
        for sender in ("pace", "user", "operator"):
            await there.put(1, sender=sender, receiver="idle")


@pytest.mark.parametrize("what", ["behaviors", "resources"])
async def test_a_class_in_place_of_a_component_is_told_what_to_write(what) -> None:
    """The commonest slip has its own words."""
    given: dict[str, Any] = {what: [Pace if what == "behaviors" else Level]}
    with pytest.raises(ExceptionGroup) as raised:
        async with esair.Robot(**given):
            pass
    assert raised.group_contains(esair.ConfigError, match=r"you gave the class: write ")
    given = {what: given[what][0]()}
    with pytest.raises(esair.ConfigError, match=r"expected a list of components"):
        esair.Robot(**given)
