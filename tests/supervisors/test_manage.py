"""A behavior with its supervisor in hand: it looks at others, and may manage them."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

import esair
from esair import BehaviorState

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("BEH-6")]

MAY = esair.Policy.behaviors(allow={"captain": "manage"})


class Wander(esair.Behavior):
    """Runs until it is ended, and counts its runs."""

    runs = 0

    async def run(self) -> None:
        self.runs += 1
        await asyncio.sleep(1000.0)


class Captain(esair.Behavior):
    """Leaves its verbs to the test."""


async def test_everybody_may_look_at_the_others() -> None:
    """Without a right, and without a wait."""
    captain = Captain()
    async with esair.Robot(behaviors=[captain, Wander()]):
        assert captain.supervisor.query("wander").state is BehaviorState.RUNNING
        with pytest.raises(esair.UnknownNameError):
            captain.supervisor.query("wonder")


async def test_without_the_right_nothing_is_done() -> None:
    """Each of the four is denied, with the policy that is missing."""
    captain, wander = Captain(), Wander()
    allows_another = esair.Policy.behaviors(allow={"pilot": "manage"})
    async with esair.Robot(
        behaviors=[captain, wander], policies=[allows_another]
    ) as robot:
        hand = captain.supervisor
        for attempt in (
            hand.add(Wander(name="second")),
            hand.remove("wander"),
            hand.replace("wander", Wander()),
            hand.restart("wander"),
        ):
            with pytest.raises(esair.AccessDeniedError, match=r"Policy\.behaviors"):
                await attempt
        await asyncio.sleep(1.0)
        assert robot.behaviors.names() == ["captain", "wander"]
        assert wander.runs == 1


async def test_a_manager_adds_replaces_restarts_and_removes() -> None:
    """As the user does, and the journal says who did it."""
    captain, wander = Captain(), Wander()
    events: list[Any] = []
    async with esair.Robot(behaviors=[captain, wander], policies=[MAY]) as robot:
        robot.journal.listen(events.append)
        hand = captain.supervisor
        second = Wander(name="second")
        await hand.add(second)
        assert second.runs == 1
        await hand.restart("second")
        assert second.runs == 2
        third = Wander()
        await hand.replace("wander", third)
        assert (wander.runs, third.runs) == (1, 1)
        await hand.remove("second")
        assert robot.behaviors.names() == ["captain", "wander"]
        with pytest.raises(esair.UnknownNameError):
            await hand.remove("second")
        await asyncio.sleep(0.01)
    acts = [(e.text, e.component) for e in events if e.peer == "captain"]
    assert acts[:4] == [
        ("add", "second"),
        ("restart", "second"),
        ("replace", "wander"),
        ("remove", "second"),
    ]


async def test_who_was_removed_manages_nobody() -> None:
    """What is left of its run has no rights any more."""
    escaped: list[BaseException] = []

    class Stubborn(esair.Behavior):
        async def run(self) -> None:
            while True:
                try:
                    await asyncio.sleep(1000.0)
                except asyncio.CancelledError:
                    try:
                        await self.supervisor.remove("wander")
                    except BaseException as error:
                        escaped.append(error)
                        raise

    policy = esair.Policy.behaviors(allow={"*": "manage"})
    async with esair.Robot(
        behaviors=[Stubborn(), Wander()], policies=[policy]
    ) as robot:
        await robot.behaviors.remove("stubborn")
        await asyncio.sleep(2.0)
        assert "wander" in robot.behaviors.names()
    assert isinstance(escaped[0], esair.BehaviorRemovedError)


@pytest.mark.real_clock
async def test_a_thread_manages_by_calls_that_wait() -> None:
    """`ThreadBehavior` has the blocking form, and so has a plain run."""
    done = threading.Event()
    seen: list[Any] = []

    class Chief(esair.ThreadBehavior):
        def run(self) -> None:
            seen.append(self.supervisor.query("wander").state)
            self.supervisor.add(Wander(name="second"))
            self.supervisor.restart("second")
            seen.append(self.supervisor.remove("second"))
            done.set()

    policy = esair.Policy.behaviors(allow={"chief": "manage"})
    async with esair.Robot(behaviors=[Wander(), Chief()], policies=[policy]):
        assert await asyncio.to_thread(done.wait, 5.0)
    assert seen == [BehaviorState.RUNNING, []]


async def test_restart_is_a_word_of_the_operator() -> None:
    """As remove is."""
    wander = Wander()
    async with esair.Robot(behaviors=[wander]) as robot:
        assert await robot.behaviors.command("restart wander") == "wander was restarted"
        await asyncio.sleep(0.01)
        assert wander.runs == 2
        assert "restart NAME" in await robot.behaviors.command("help")


def test_a_policy_of_behaviors_gives_one_right() -> None:
    """A wrong word, or a wrong name, is told at once."""
    with pytest.raises(esair.ConfigError, match='expected "manage"'):
        esair.Policy.behaviors(allow={"captain": "command"})  # type: ignore[dict-item]
    with pytest.raises(esair.ConfigError, match="lower-case"):
        esair.Policy.behaviors(allow={"Captain": "manage"})
