"""What an operator types, and what is told."""

from __future__ import annotations

import asyncio

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
