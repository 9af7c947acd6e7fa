"""Behaviors in turns: modes, and the way from one to another."""

from __future__ import annotations

import asyncio
import logging
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import esair
from esair import BehaviorState, Mode
from esair.journal import Event, Kind
from esair.plan import examine
from esair.testing import FakeActuator, FakeSensor

pytestmark = [pytest.mark.virtual_clock]

HISTORIES, LONG_HISTORIES, SOAK_HISTORIES = 30, 300, 2_000
RESTING, RUNNING = BehaviorState.RESTING, BehaviorState.RUNNING
MAY = esair.Policy.behaviors(allow={"captain": "manage"})


class Mover(esair.Behavior):
    """Writes its speed, and notes its life."""

    wheels = esair.writes(float)
    restart = esair.Restart(max=0)

    def __init__(
        self,
        name: str,
        speed: float,
        *,
        sets_up: float | BaseException = 0.0,
        lasts: float = 1e6,
        fails: bool = False,
        deaf: float = 0.0,
        story: list[str] | None = None,
    ) -> None:
        super().__init__(name=name)
        self.speed, self.sets_up, self.lasts = speed, sets_up, lasts
        self.fails, self.deaf = fails, deaf
        self.story: list[str] = [] if story is None else story
        self.running = 0
        self.others: list[Mover] = []  # those of other modes
        self.overlaps: list[str] = []

    async def setup(self) -> None:
        self.story.append(f"{self.name} sets up")
        if isinstance(self.sets_up, BaseException):
            raise self.sets_up
        try:
            await asyncio.sleep(self.sets_up)
        except asyncio.CancelledError:
            if not self.deaf:
                raise
            await asyncio.sleep(self.deaf)

    async def run(self) -> None:
        self.running += 1
        self.story.append(f"{self.name} runs")
        self.overlaps += [each.name for each in self.others if each.running]
        end = esair.now() + self.lasts
        try:
            async for _ in esair.every(0.05):
                if esair.now() >= end:
                    break
                await self.wheels.write(self.speed)
            if self.fails:
                raise RuntimeError("it does not work")
        except asyncio.CancelledError:
            if self.deaf:
                await asyncio.sleep(self.deaf)
            raise
        finally:
            self.running -= 1
            self.story.append(f"{self.name} ends")


class Captain(esair.Behavior):
    """Leaves its verbs to the test."""


class Stopper(esair.Reaction):
    """Guards the wheels, or is blind without its sensor."""

    sonar = esair.reads(float, max_age=0.5)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float | None:
        return wheels if sonar > 0.5 else 0.0


def wheels_() -> FakeActuator[float]:
    return FakeActuator("wheels", safe=0.0)


def make(
    *behaviors: Any, modes: dict[str, Any], mode: str = "explore", **more: Any
) -> tuple[esair.Robot, FakeActuator[float]]:
    wheels = wheels_()
    resources = [wheels, *more.pop("resources", [])]
    robot = esair.Robot(
        resources=resources, behaviors=behaviors, modes=modes, mode=mode, **more
    )
    return robot, wheels


TWO = {"explore": ["wander"], "dock": ["dock"]}


@pytest.mark.promise("MODE-1")
async def test_only_those_of_the_mode_run() -> None:
    """Those of another rest, whoever is in no mode runs."""
    wander, dock, captain = Mover("wander", 1.0), Mover("dock", 2.0), Captain()
    robot, wheels = make(wander, dock, captain, modes=TWO)
    async with robot:
        await asyncio.sleep(1.0)
        states = {n: robot.behaviors.query(n).state for n in robot.behaviors.names()}
        assert states == {"captain": RUNNING, "dock": RESTING, "wander": RUNNING}
        assert (robot.behaviors.mode, dock.story) == ("explore", [])
        assert set(wheels.commands) == {0.0, 1.0}
        told = robot.behaviors.query("dock").detail
        assert told == "it runs in mode dock"
        why = str(robot.resources.why("wheels"))
        assert "dock rests in mode explore: it runs in dock" in why


@pytest.mark.promise("MODE-2")
async def test_a_switch_has_the_order_of_replace() -> None:
    """The new one is set up while the old one drives; safe is between their commands."""
    story: list[str] = []
    wander = Mover("wander", 1.0, story=story)
    dock = Mover("dock", 2.0, sets_up=0.5, story=story)
    both = Captain()
    robot, wheels = make(
        wander,
        dock,
        both,
        modes={"explore": ["wander", "captain"], "dock": ["dock", "captain"]},
    )
    heard: list[Event] = []
    robot.journal.listen(heard.append, kinds=(Kind.MODE,))
    async with robot:
        await asyncio.sleep(1.0)
        driven = len(wheels.commands)
        switch = asyncio.create_task(robot.behaviors.switch("dock", reason="dark"))
        await asyncio.sleep(0.4)
        assert robot.behaviors.mode == "explore"
        assert wheels.commands[driven:] == [1.0] * (len(wheels.commands) - driven)
        assert len(wheels.commands) - driven >= 7
        await switch
        assert robot.behaviors.mode == "dock"
        assert robot.behaviors.query("wander").state is RESTING
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("captain").restarts == 0
    assert story == [
        "wander sets up",
        "wander runs",
        "dock sets up",
        "wander ends",
        "dock runs",
        "dock ends",
    ]
    seen = [
        c for n, c in enumerate(wheels.commands) if not n or c != wheels.commands[n - 1]
    ]
    assert seen == [0.0, 1.0, 0.0, 2.0, 0.0]
    (event,) = heard
    assert (event.component, event.value, event.text) == ("dock", "explore", "dark")


@pytest.mark.promise("MODE-2")
@pytest.mark.parametrize("trouble", [RuntimeError("no dock in sight"), 60.0])
async def test_if_one_cannot_be_set_up_the_old_mode_goes_on(trouble: Any) -> None:
    """The error says why; the old ones never noticed, and it can be tried again."""
    wander, dock = Mover("wander", 1.0), Mover("dock", 2.0, sets_up=trouble)
    side = Mover("side", 3.0)
    robot, wheels = make(
        wander, dock, side, modes={"explore": ["wander"], "dock": ["side", "dock"]}
    )
    async with robot:
        with pytest.raises(esair.BehaviorFailedError, match="dock"):
            await robot.behaviors.switch("dock")
        assert robot.behaviors.mode == "explore"
        assert robot.behaviors.query("dock").state is RESTING
        assert robot.behaviors.query("side").state is RESTING
        await asyncio.sleep(0.2)
        assert wander.story == ["wander sets up", "wander runs"]
        assert "side runs" not in side.story
        assert wheels.commands[-1] == 1.0
        dock.sets_up = 0.0
        await robot.behaviors.switch("dock")
        assert (robot.behaviors.mode, dock.running, side.running) == ("dock", 1, 1)


@pytest.mark.promise("MODE-2")
async def test_what_runs_in_both_modes_goes_on() -> None:
    """It misses nothing, and is not set up again."""
    wander, dock, mapper = Mover("wander", 1.0), Mover("dock", 2.0), Captain(name="map")
    modes = {"explore": ["wander", "map"], "dock": ["dock", "map"]}
    robot, _ = make(wander, dock, mapper, modes=modes)
    heard: list[Event] = []
    robot.journal.listen(heard.append, kinds=(Kind.RUNNING,))
    async with robot:
        for mode in ("dock", "explore", "dock"):
            await robot.behaviors.switch(mode)
        await asyncio.sleep(0.1)
    assert [each.component for each in heard].count("map") == 1


@pytest.mark.promise("MODE-2")
@pytest.mark.parametrize("verb", ["add", "replace"])
async def test_what_comes_while_the_old_ones_end_waits_for_its_turn(verb: str) -> None:
    """It is added to a mode, or put in a place there, whose switch is under way."""
    story: list[str] = []
    wander = Mover("wander", 1.0, deaf=0.3, story=story)
    near = Mover("near", 2.5, sets_up=0.1, story=story)
    modes = {**TWO, "dock": ["dock", "near"]}
    robot, _ = make(wander, Mover("dock", 2.0, story=story), near, modes=modes)
    async with robot:
        await asyncio.sleep(0.1)
        if verb == "add":
            await robot.behaviors.remove("dock")
        switch = asyncio.create_task(robot.behaviors.switch("dock"))
        await asyncio.sleep(0.2)
        assert robot.behaviors.mode == "dock"
        assert "wander ends" not in story
        other = Mover("dock", 3.0, story=story)
        if verb == "add":
            await robot.behaviors.add(other)
        else:
            await robot.behaviors.replace("dock", other)
        await switch
        assert other.running
    assert story.index("wander ends") < story.index("dock runs")


@pytest.mark.promise("MODE-2", "SUP-3")
async def test_what_waits_for_those_who_end_holds_up_no_other_command() -> None:
    """One is added while the old mode ends slowly; another is taken away meanwhile."""
    wander = Mover("wander", 1.0, deaf=3.0)
    near = Mover("near", 2.5, sets_up=0.1)
    modes = {**TWO, "dock": ["dock", "near"]}
    captain = Captain(name="captain")
    robot, _ = make(wander, Mover("dock", 2.0), near, captain, modes=modes)
    async with robot:
        await robot.behaviors.remove("dock")
        switch = asyncio.create_task(robot.behaviors.switch("dock"))
        await asyncio.sleep(0.2)
        add = asyncio.create_task(robot.behaviors.add(Mover("dock", 3.0)))
        await asyncio.sleep(0.1)
        began = esair.now()
        await robot.behaviors.remove("captain")
        assert esair.now() - began < 0.5
        assert not add.done()
        await add
        await switch


@pytest.mark.promise("MODE-2")
async def test_who_is_just_removed_ends_before_the_new_ones_begin() -> None:
    """The removal had begun when the switch came."""
    story: list[str] = []
    wander = Mover("wander", 1.0, deaf=0.3, story=story)
    robot, _ = make(wander, Mover("dock", 2.0, story=story), modes=TWO)
    async with robot:
        await asyncio.sleep(0.1)
        removing = asyncio.create_task(robot.behaviors.remove("wander"))
        await asyncio.sleep(0.1)
        await robot.behaviors.switch("dock")
        await removing
    assert story.index("wander ends") < story.index("dock runs")


@pytest.mark.promise("MODE-2")
async def test_who_is_just_removed_is_not_set_up_for_a_mode() -> None:
    """Its setup swallows its end, and a switch comes meanwhile: it goes without it."""
    story: list[str] = []
    near = Mover("near", 2.5, sets_up=0.3, deaf=0.1, story=story)
    modes = {**TWO, "dock": ["dock", "near"]}
    robot, _ = make(Mover("wander", 1.0), Mover("dock", 2.0), near, modes=modes)
    async with robot:
        first = asyncio.create_task(robot.behaviors.switch("dock"))
        await asyncio.sleep(0.1)
        removing = asyncio.create_task(robot.behaviors.remove("near"))
        await asyncio.gather(first, return_exceptions=True)
        async with asyncio.timeout(1.0):
            await robot.behaviors.switch("dock")
        await removing
    assert story == ["near sets up"]


@pytest.mark.promise("MODE-2")
@pytest.mark.parametrize("ends", [0.0, 0.5], ids=["gone", "going"])
async def test_a_switch_whose_behavior_is_removed_leaves_the_old_mode(
    ends: float,
) -> None:
    """It was set up, and waited for another one that enters."""

    class Near(Mover):
        async def teardown(self) -> None:
            await asyncio.sleep(ends)

    near, dock = Near("near", 2.5), Mover("dock", 2.0, sets_up=0.3)
    modes = {**TWO, "dock": ["near", "dock"]}
    policy = esair.Policy("wheels", allow={"*": esair.Access.WRITE})
    robot, wheels = make(
        Mover("wander", 1.0), near, dock, modes=modes, policies=[policy]
    )
    async with robot:
        switch = asyncio.create_task(robot.behaviors.switch("dock"))
        await asyncio.sleep(0.1)
        await robot.behaviors.remove("near")
        with pytest.raises(esair.BehaviorRemovedError, match="near"):
            await switch
        assert robot.behaviors.mode == "explore"
        await asyncio.sleep(0.5)
        assert set(wheels.commands) == {0.0, 1.0}


@pytest.mark.promise("MODE-2")
@pytest.mark.parametrize("verb", ["switch", "restart", "remove"])
async def test_a_setup_that_swallows_its_end_is_not_followed_by_a_run(
    verb: str,
) -> None:
    """It is for another mode by now, was begun anew, or is gone."""

    class Deaf(Mover):
        async def setup(self) -> None:
            self.story.append("sets up")
            try:
                await asyncio.sleep(0.3)
            except asyncio.CancelledError:
                await asyncio.sleep(0.1)

    dock = Deaf("dock", 2.0)
    first = "explore" if verb == "switch" else "dock"
    robot, _ = make(Mover("wander", 1.0), dock, modes=TWO, mode=first)
    async with robot:
        if verb == "switch":
            going = asyncio.create_task(robot.behaviors.switch("dock"))
            await asyncio.sleep(0.1)
            await robot.behaviors.switch("explore")
            await asyncio.gather(going, return_exceptions=True)
        else:
            going = asyncio.create_task(robot.behaviors.restart("dock"))
            await asyncio.sleep(0.1)
            await getattr(robot.behaviors, verb)("dock")
            await asyncio.gather(going, return_exceptions=True)
        await asyncio.sleep(1.0)
        assert dock.running == (verb == "restart")
        ran = dock.story.count("dock runs")
    assert ran == {"switch": 0, "restart": 2, "remove": 1}[verb]


@pytest.mark.promise("MODE-2")
async def test_a_guard_that_enters_counts_before_who_leaves_has_ended() -> None:
    """And one that rests keeps nothing still, blind or not."""
    sonar = FakeSensor("sonar", 0.1)
    wander, dock = Mover("wander", 1.0, deaf=0.3), Mover("dock", 2.0)
    always = Mover("always", 5.0)
    robot, wheels = make(
        wander,
        dock,
        always,
        Stopper(name="stopper"),
        modes={"explore": ["wander"], "dock": ["dock", "stopper"]},
        resources=[sonar],
    )
    always.sets_up = 0.0
    async with robot:
        await asyncio.sleep(0.5)
        assert set(wheels.commands[1:]) - {0.0}
        marks: list[int] = []
        robot.journal.listen(
            lambda _: marks.append(len(wheels.commands)), kinds=(Kind.MODE,)
        )
        await robot.behaviors.switch("dock")
        await asyncio.sleep(0.5)
        assert set(wheels.commands[marks[0] :]) <= {0.0}
        assert robot.resources.why("wheels").guards
        await robot.behaviors.switch("explore")
        assert not robot.resources.why("wheels").guards
        await asyncio.sleep(0.5)
        assert wheels.commands[-1] != 0.0


async def test_a_latch_outlasts_the_rest_of_its_guard() -> None:
    """Only the user ends it; the guard decides about that when it runs again."""

    class Latch(Stopper):
        wheels = esair.guards(float, latch=True)

        def react(self, sonar: float, wheels: float) -> float | None:
            return wheels if sonar > 0.5 else None

    sonar = FakeSensor("sonar", 0.1)
    robot, wheels = make(
        Mover("wander", 1.0),
        Mover("dock", 2.0),
        Latch(name="latch"),
        modes={"explore": ["wander", "latch"], "dock": ["dock"]},
        resources=[sonar],
    )
    async with robot:
        await asyncio.sleep(0.5)
        await robot.behaviors.switch("dock")
        await asyncio.sleep(0.5)
        assert set(wheels.commands) == {0.0}
        sonar.feed(2.0)
        await robot.behaviors.switch("explore")
        await asyncio.sleep(0.3)
        assert set(wheels.commands) == {0.0}
        robot.behaviors.reset("latch")
        await wheels.until(1.0, timeout=1.0)


@pytest.mark.promise("MODE-2")
async def test_who_is_about_to_enter_is_not_restarted() -> None:
    """A reaction, too: it would run twice, and the first one beyond the robot's end."""
    steps: list[float] = []

    class Step(esair.Reaction):
        rate = 10.0
        sonar = esair.reads(float)
        wheels = esair.writes(float)

        def react(self, sonar: float) -> None:
            steps.append(esair.now())

    robot, _ = make(
        Mover("wander", 1.0, deaf=0.2),
        Mover("dock", 0.0, sets_up=0.05),
        Step(name="step"),
        modes={"explore": ["wander"], "dock": ["dock", "step"]},
        resources=[FakeSensor("sonar", 1.0)],
    )
    async with robot:
        await asyncio.sleep(0.2)
        switching = asyncio.create_task(robot.behaviors.switch("dock"))
        await asyncio.sleep(0.1)
        with pytest.raises(esair.RefusedError, match="it runs in mode dock"):
            await robot.behaviors.restart("step")
        await switching
        await asyncio.sleep(0.5)
    assert len(steps) == len(set(steps))
    steps.clear()
    await asyncio.sleep(0.5)
    assert not steps


@pytest.mark.promise("MODE-2", "PRO-2")
@pytest.mark.parametrize("verb", ["replace", "remove"])
@pytest.mark.parametrize("when", ["at rest", "amid the switch"])
async def test_a_guard_that_is_replaced_where_it_rests_leaves_nothing_behind(
    when: str, verb: str
) -> None:
    """But its latch, which the new one has; also while others of its mode still end."""

    class Latch(Stopper):
        wheels = esair.guards(float, latch=True)

        def react(self, sonar: float, wheels: float) -> float | None:
            return wheels if sonar > 0.5 else None

    sonar = FakeSensor("sonar", 0.1)
    robot, wheels = make(
        Mover("wander", 1.0, deaf=0.2),
        Mover("dock", 2.0),
        Latch(name="latch"),
        modes={"explore": ["wander", "latch"], "dock": ["dock"]},
        resources=[sonar],
    )
    async with robot:
        await asyncio.sleep(0.5)
        switching = asyncio.create_task(robot.behaviors.switch("dock"))
        await asyncio.sleep(0.1)
        if when == "at rest":
            await switching
        await robot.behaviors.replace("latch", Latch())
        sonar.feed(2.0)
        await switching
        await asyncio.sleep(0.5)
        assert set(wheels.commands) == {0.0}
        with pytest.raises(esair.AccessDeniedError, match="it rests"):
            robot.behaviors.reset("latch")
        if verb == "remove":
            await robot.behaviors.remove("latch")
        else:
            await robot.behaviors.switch("explore")
            await asyncio.sleep(0.5)
            assert set(wheels.commands) == {0.0}
            robot.behaviors.reset("latch")
        await wheels.until(lambda command: command > 0.0, timeout=0.1)
        assert len(robot.resources.why("wheels").guards) == (verb == "replace")


@pytest.mark.promise("MODE-3")
async def test_when_all_of_a_mode_have_ended_the_next_one_follows() -> None:
    """Explore, dock, charge: and the end of the last one is that of the robot."""
    robot, _ = make(
        Mover("wander", 1.0, lasts=1.0),
        Mover("dock", 2.0, lasts=1.0),
        Mover("charge", 0.0, lasts=1.0),
        modes={
            "explore": Mode(["wander"], then="dock"),
            "dock": Mode(["dock"], then="charge", on_failure="explore"),
            "charge": ["charge"],
        },
    )
    heard: list[Event] = []
    robot.journal.listen(heard.append, kinds=(Kind.MODE,))
    async with robot:
        await asyncio.wait_for(robot.ended(), 10.0)
    assert [each.component for each in heard] == ["dock", "charge"]
    assert [each.text for each in heard] == ["explore has ended", "dock has ended"]


@pytest.mark.promise("MODE-3")
async def test_after_a_failure_its_mode_follows() -> None:
    """And a mode that cannot be set up leads there, too."""
    robot, wheels = make(
        Mover("wander", 1.0, lasts=0.5),
        Mover("dock", 2.0, sets_up=RuntimeError("no dock")),
        Mover("broken", 2.0, lasts=0.5, fails=True),
        modes={
            "explore": Mode(["wander"], then="dock", on_failure="broken"),
            "dock": ["dock"],
            "broken": Mode(["broken"], on_failure="safe"),
            "safe": [],
        },
    )
    async with robot:
        await asyncio.sleep(5.0)
        assert robot.behaviors.mode == "safe"
        assert robot.behaviors.query("broken").state is RESTING
        assert wheels.commands[-1] == 0.0
        ended = asyncio.create_task(robot.ended())  # people decide what comes next
        await asyncio.sleep(5.0)
        assert not ended.done()
        ended.cancel()


async def test_a_behavior_switches_by_a_right() -> None:
    """Its own end by the switch does not undo that; without the right it is denied."""
    captain, wander = Captain(), Mover("wander", 1.0)
    dock = Mover("dock", 2.0)
    modes = {"explore": ["wander", "captain"], "dock": ["dock"]}
    robot, _ = make(captain, wander, dock, modes=modes, policies=[MAY])
    async with robot:
        with pytest.raises(esair.AccessDeniedError, match=r"Policy\.behaviors"):
            await wander.supervisor.switch("dock")
        asyncio.create_task(captain.supervisor.switch("dock", reason="tired"))  # noqa: RUF006
        await asyncio.sleep(0.5)
        assert (robot.behaviors.mode, dock.running) == ("dock", 1)
        assert robot.behaviors.query("captain").state is RESTING


async def test_what_rests_takes_data_only_if_it_says_so() -> None:
    """Closed: the sender waits; open: it lies in the inbox until the mode comes."""

    class Open(Mover):
        open_at_rest = True

    closed, opened = Mover("closed", 1.0), Open("opened", 1.0)
    modes: dict[str, Any] = {"explore": ["wander"], "dock": ["closed", "opened"]}
    robot, _ = make(Mover("wander", 1.0), closed, opened, modes=modes)
    async with robot:
        put = robot.behaviors.put
        with pytest.raises(esair.BehaviorUnavailableError, match="resting"):
            await put(1, sender="wander", receiver="closed", interval=0.5)
        await put(2, sender="wander", receiver="opened", interval=0.5)
        late = asyncio.create_task(
            put(3, sender="wander", receiver="closed", interval=5.0)
        )
        await robot.behaviors.switch("dock")
        await late
        assert await opened.receive(timeout=0.1) == 2
        assert await closed.receive(timeout=0.1) == 3


async def test_what_comes_for_another_mode_rests_at_once() -> None:
    """By add and replace; restart of it is refused with the way to go."""
    robot, _ = make(
        Mover("wander", 1.0),
        Mover("dock", 2.0),
        Mover("late", 1.0),
        modes={"explore": ["wander"], "dock": ["dock", "late"]},
    )
    async with robot:
        await robot.behaviors.remove("late")
        late, dock = Mover("late", 3.0), Mover("dock", 4.0)
        await robot.behaviors.add(late)
        await robot.behaviors.replace("dock", dock)
        assert late.story == dock.story == []
        assert robot.behaviors.query("dock").state is RESTING
        with pytest.raises(esair.RefusedError, match="switch to its mode"):
            await robot.behaviors.restart("dock")
        await robot.behaviors.switch("dock")
        assert (late.running, dock.running) == (1, 1)
        await robot.behaviors.remove("dock")
        assert robot.behaviors.names() == ["wander", "late"]


async def test_a_newer_switch_ends_one_that_waits() -> None:
    """People who want the safe mode do not wait for a setup."""
    robot, _ = make(
        Mover("wander", 1.0),
        Mover("dock", 2.0, sets_up=4.0),
        modes={"explore": ["wander"], "dock": ["dock"], "safe": []},
    )
    async with robot:
        first = asyncio.create_task(robot.behaviors.switch("dock"))
        await asyncio.sleep(0.5)
        began = esair.now()
        await robot.behaviors.switch("safe")
        assert esair.now() - began < 0.2
        with pytest.raises(esair.RefusedError, match="a newer switch to safe"):
            await first
        await asyncio.sleep(5.0)
        assert robot.behaviors.mode == "safe"
        assert robot.behaviors.query("dock").state is RESTING


async def test_an_exclusive_actuator_goes_from_one_mode_to_the_next() -> None:
    """Those that never run together do not keep each other out."""
    rule = esair.Policy("wheels", allow={"*": esair.Access.WRITE}, exclusive=True)
    robot, wheels = make(
        Mover("wander", 1.0), Mover("dock", 2.0), modes=TWO, policies=[rule]
    )
    async with robot:
        await robot.behaviors.switch("dock")
        await wheels.until(2.0, timeout=1.0)
        await robot.behaviors.switch("explore")
        await wheels.until(1.0, timeout=1.0)


async def test_no_such_mode() -> None:
    """The nearest name is told."""
    robot, _ = make(Mover("wander", 1.0), Mover("dock", 2.0), modes=TWO)
    async with robot:
        with pytest.raises(esair.UnknownNameError, match="did you mean 'dock'"):
            await robot.behaviors.switch("dok")
        assert await robot.behaviors.command("mode") == "explore (the others: dock)"
        assert (
            await robot.behaviors.command("mode dock") == "dock (the others: explore)"
        )


# The rulebook.


@pytest.mark.parametrize(
    ("modes", "mode", "told"),
    [
        ({"explore": ["wonder"]}, "explore", "did you mean 'wander'"),
        ({"explore": ["wander", "wander"]}, "explore", "more than once"),
        ({"explore": ["wander"]}, None, "the mode that it begins in is missing"),
        ({"explore": ["wander"]}, "exlore", "did you mean 'explore'"),
        ({"explore": Mode(["wander"], then="dok"), "dock": []}, "explore", "'dock'"),
        ({"explore": Mode(["wander"], then="explore")}, "explore", "the mode itself"),
        (
            {"explore": Mode([], on_failure="safe")},
            "explore",
            "no mode is named 'safe'",
        ),
    ],
)
@pytest.mark.promise("MODE-1")
def test_a_mistake_in_modes_is_told(modes: Any, mode: Any, told: str) -> None:
    """The robot does not start."""
    robot, _ = make(Mover("wander", 1.0), modes=modes, mode=mode)
    errors = [each.text for each in examine(robot.plan) if each.is_error]
    assert len(errors) == 1
    assert told in errors[0]


def test_a_mode_that_nobody_reaches_is_told() -> None:
    """And an actuator that nobody moves then; who may manage may reach all."""
    modes = {"explore": ["wander"], "dock": ["dock"]}
    arm = FakeActuator("arm", safe=0.0)

    class Grip(esair.Behavior):
        arm = esair.writes(float)

    def found(**more: Any) -> list[tuple[str, str]]:
        robot, _ = make(
            Mover("wander", 1.0),
            Grip(name="dock"),
            modes=modes,
            resources=[arm],
            **more,
        )
        return [(f.component, f.wrong) for f in examine(robot.plan) if f.rule == "mode"]

    assert [component for component, _ in found()] == ["mode.dock", "arm"]
    everybody = esair.Policy.behaviors(allow={"wander": "manage"})
    assert not found(policies=[everybody])


def test_protection_counts_where_it_runs() -> None:
    """A guard that rests protects nobody, and who never meet do not starve."""

    class Plain(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 0.2

        async def write(self, command: float) -> None: ...

    robot = esair.Robot(
        resources=[Plain(name="wheels"), FakeSensor("sonar", 1.0)],
        behaviors=[Mover("wander", 1.0), Mover("dock", 2.0), Stopper(name="stopper")],
        modes={"explore": Mode(["wander"], then="dock"), "dock": ["dock", "stopper"]},
        mode="explore",
    )
    told = [
        each.text for each in examine(robot.plan) if each.rule in {"protect", "starve"}
    ]
    assert len(told) == 1
    assert "in mode 'explore'" in told[0]


def test_modes_of_a_file(tmp_path: Path) -> None:
    """Tables [mode.NAME], and the first one; a mistake names its line."""
    (tmp_path / "idle.py").write_text("import esair\nclass Idle(esair.Behavior): ...\n")
    path = tmp_path / "robot.toml"
    text = """
[robot]
mode = "explore"
[behavior.wander]
driver = "idle:Idle"
[behavior.dock]
driver = "idle:Idle"
[mode.explore]
behaviors = ["wander"]
then = "dock"
[mode.dock]
behaviors = ["dock"]
on_failure = "explore"
"""
    path.write_text(text)
    robot = esair.Robot.from_config(path)
    assert (robot.behaviors.mode, list(robot.behaviors.modes.table)) == (
        "explore",
        ["explore", "dock"],
    )
    assert robot.behaviors.modes.table["dock"] == Mode(["dock"], on_failure="explore")
    path.write_text(text.replace('["dock"]', '["dok"]'))
    with pytest.raises(ExceptionGroup) as raised:
        esair.Robot.from_config(path)
    (error,) = (e for e in raised.value.exceptions if "mode" in str(e))
    assert "12" in str(error)
    assert "mode.dock.behaviors" in str(error)
    assert "did you mean 'dock'" in str(error)


# Whatever interrupts it.


class _Wheels(esair.Actuator[float]):
    """Notes what it was told, and in which mode."""

    safe = 0.0
    command_timeout = 0.2

    def __init__(self, took: float) -> None:
        super().__init__(name="wheels")
        self.told: list[tuple[str | None, float]] = []
        self.took = took
        self.robot: esair.Robot

    async def write(self, command: float) -> None:
        mode = self.robot.behaviors.mode
        await asyncio.sleep(self.took)
        self.told.append((mode, command))


SET_UPS: list[float | BaseException] = [
    *(0.0, 0.0, 0.03, 0.03, 0.3, 0.3),
    *(RuntimeError("no"), SystemExit(3)),
]
"""How long a setup takes, in seconds, or what it raises."""


async def _history(seed: int) -> None:
    """Tell one history of a switch that is interrupted at any await, and judge it."""
    dice = random.Random(seed)
    names = {"explore": ["wander", "look"], "dock": ["dock", "near", "stopper"]}
    speeds = {"wander": 1.0, "look": 1.5, "dock": 2.0, "near": 2.5}
    mode_of = {speed: m for m in names for n, speed in speeds.items() if n in names[m]}
    all_movers: list[Mover] = []

    def new(name: str) -> Mover:
        made = Mover(
            name,
            speeds[name],
            sets_up=dice.choice(SET_UPS),
            lasts=dice.choice([1e6, 1e6, 0.3]),
            fails=dice.random() < 0.2,
            deaf=dice.choice([0.0, 0.0, 0.1, 3.0]),
        )
        all_movers.append(made)
        for one in all_movers:
            one.others = [  # who swallows its end is fenced off, and not waited for
                other
                for other in all_movers
                if mode_of[other.speed] != mode_of[one.speed] and other.deaf <= 0.1
            ]
        return made

    movers = {name: new(name) for name in speeds}
    for name in ("wander", "look"):
        movers[name].sets_up = 0.0
    wheels = _Wheels(dice.choice([0.0, 0.0, 0.01]))
    then: dict[str, str] = {}
    if dice.random() < 0.3:
        then = {"then": "dock", "on_failure": "dock"}
    robot = esair.Robot(
        resources=[wheels, FakeSensor("sonar", 2.0)],
        behaviors=[*movers.values(), Captain(), Stopper(name="stopper")],
        modes={"explore": Mode(names["explore"], **then), "dock": names["dock"]},  # type: ignore[arg-type]
        mode="explore",
        grace=0.2,
    )
    wheels.robot = robot
    removed: set[str] = set()

    async def remove(name: str) -> None:
        removed.add(name)
        await robot.behaviors.remove(name)

    async def replace(name: str) -> None:
        await robot.behaviors.replace(name, new(name))

    async def crash(name: str) -> None:
        for task in asyncio.all_tasks():
            if task.get_name() == name:
                task.cancel()

    async def halt() -> None:
        await robot.halt("a history")
        await asyncio.sleep(0.2)
        robot.resume()

    acts: list[Callable[[], Any]] = [
        lambda: remove(dice.choice([*speeds, "stopper"])),
        lambda: replace(dice.choice([*speeds])),
        lambda: crash(dice.choice([*speeds])),
        lambda: robot.behaviors.switch(dice.choice([*names])),
        lambda: robot.behaviors.restart(dice.choice([*speeds])),
        halt,
        lambda: asyncio.sleep(0.0),
    ]
    stops = dice.random() < 0.2
    async with robot:
        await asyncio.sleep(dice.choice([0.0, 0.12, 0.4]))
        first = asyncio.create_task(robot.behaviors.switch("dock"))
        asked = [first]
        for _ in range(dice.randint(1, 2)):
            for _ in range(dice.choice([0, 1, 2, 3, 5, 8, 13, 21])):
                await asyncio.sleep(0.0)
            await asyncio.sleep(dice.choice([0.0, 0.0, 0.02, 0.1, 0.35]))
            if dice.random() < 0.3:
                first.cancel()
            asked.append(asyncio.create_task(dice.choice(acts)()))
        if not stops:
            outcomes = await asyncio.gather(*asked, return_exceptions=True)
            for each in outcomes:
                assert each is None or isinstance(
                    each, esair.EsairError | asyncio.CancelledError | list
                ), each
            await asyncio.sleep(4.0)
            for name in movers.keys() & {*robot.behaviors.names()}:
                movers[name] = robot.behaviors.action(name)  # type: ignore[assignment]
            _judge_mode(robot, movers, names, removed)
    await asyncio.gather(*asked, return_exceptions=True)
    assert wheels.told[-1][1] == 0.0
    assert not any(each.overlaps for each in all_movers)
    assert not any(each.running for each in all_movers if not each.deaf)
    _judge_commands(wheels, mode_of)


def _judge_mode(
    robot: esair.Robot,
    movers: dict[str, Mover],
    names: dict[str, list[str]],
    removed: set[str],
) -> None:
    """One mode, whole: whose turn it is has begun, whose it is not rests."""
    mode = robot.behaviors.mode
    assert mode in names
    for name, mover in movers.items():
        if name in removed:
            assert name not in robot.behaviors.names()
            assert not mover.running
            continue
        state = robot.behaviors.query(name).state
        if name in names[mode]:
            assert state in {RUNNING, BehaviorState.FINISHED, BehaviorState.FAILED}, (
                name,
                state,
            )
            assert mover.running == (state is RUNNING)
        else:
            assert state is RESTING, (name, state)
            assert not mover.running
    if "stopper" in robot.behaviors.names():
        state = robot.behaviors.query("stopper").state
        assert state is (RUNNING if mode == "dock" else RESTING)
        entries = robot.actuators.protections.of("wheels")
        assert len(entries) == (mode == "dock")
        assert not any(each.reason for each in entries)


def _judge_commands(wheels: _Wheels, mode_of: dict[float, str]) -> None:
    """Nothing of a mode is sent in another, and safe is between two of them."""
    last = ""
    for now, command in wheels.told:
        if command == 0.0:
            last = ""
            continue
        mode = mode_of[command]
        assert mode == now, f"{command} was sent in mode {now}"
        assert last in {"", mode}, "no safe command was between two modes"
        last = mode


@pytest.mark.long
@pytest.mark.promise("MODE-2")
def test_whatever_interrupts_a_switch_leaves_one_mode(
    request: pytest.FixtureRequest,
) -> None:
    """A crash, a removal, a halt, a cancellation, a stop, another switch, at any await."""
    from esair.testing import VirtualLoop

    logging.getLogger("esair").setLevel(logging.CRITICAL)
    option = request.config.getoption
    soak, long = option("--esair-soak"), option("--esair-long")
    many = SOAK_HISTORIES if soak else LONG_HISTORIES if long else HISTORIES
    try:
        for seed in range(many):
            with asyncio.Runner(
                loop_factory=lambda seed=seed: VirtualLoop(seed=seed)  # type: ignore[misc]
            ) as runner:
                try:
                    runner.run(_history(seed))
                except Exception as error:
                    raise AssertionError(f"history {seed}") from error
    finally:
        logging.getLogger("esair").setLevel(logging.NOTSET)


class Works(esair.Behavior):
    """Is done after a while, or fails; its setup may take long."""

    restart = esair.Restart(max=0)

    def __init__(
        self, name: str, lasts: float = 1e6, *, fails: bool = False, setup: float = 0.0
    ) -> None:
        super().__init__(name=name)
        self.lasts, self.fails, self.slow = lasts, fails, setup

    async def setup(self) -> None:
        await asyncio.sleep(self.slow)

    async def run(self) -> None:
        if self.lasts:
            await asyncio.sleep(self.lasts)
        if self.fails:
            raise RuntimeError("no dock")


@pytest.mark.promise("MODE-3")
@pytest.mark.parametrize("fails", [False, True])
async def test_a_mode_whose_behavior_is_done_at_once_is_followed(fails: bool) -> None:
    """It was gone to by itself, and all of it has ended before that was over."""
    modes = {
        "explore": Mode(["explore"], then="dock"),
        "dock": Mode(["dock"], then="charge", on_failure="charge"),
        "charge": Mode(["charge"]),
    }
    behaviors = [
        Works("explore", 0.3), Works("dock", 0.0, fails=fails), Works("charge")
    ]  # fmt: skip
    async with esair.Robot(behaviors=behaviors, modes=modes, mode="explore") as robot:
        await asyncio.sleep(1.0)
        assert robot.behaviors.mode == "charge"
        assert robot.behaviors.query("charge").state is BehaviorState.RUNNING


@pytest.mark.promise("MODE-2", "MODE-3")
async def test_the_users_switch_wins_over_one_that_follows() -> None:
    """It ends that, which is no failure: nothing newer comes after it."""
    modes = {
        "explore": Mode(["explore"], then="dock", on_failure="home"),
        "dock": Mode(["dock"]),
        "home": Mode(["home"]),
        "safe": Mode(["safe"]),
    }
    behaviors = [
        Works("explore", 0.3), Works("dock", setup=3.0), Works("home"), Works("safe")
    ]  # fmt: skip
    async with esair.Robot(behaviors=behaviors, modes=modes, mode="explore") as robot:
        await asyncio.sleep(1.0)
        await robot.behaviors.switch("safe", reason="the user")
        await asyncio.sleep(5.0)
        assert robot.behaviors.mode == "safe"
        assert robot.behaviors.query("home").state is BehaviorState.RESTING


@pytest.mark.promise("MODE-3", "TURN-4")
@pytest.mark.parametrize("fails", [False, True])
async def test_modes_that_end_at_once_follow_each_other_in_good_time(
    fails: bool,
) -> None:
    """A circle of them takes neither the loop nor the time of the others."""
    works = Works("works", 0.0, fails=fails)
    modes = {
        "one": Mode(["works"], then="two", on_failure="two"),
        "two": Mode(["works"], then="one", on_failure="one"),
    }
    robot = esair.Robot(behaviors=[works], modes=modes, mode="one")
    heard: list[Event] = []
    robot.journal.listen(heard.append, kinds=(Kind.MODE,))
    async with robot:
        await asyncio.sleep(2.6)
    assert [each.component for each in heard[:4]] == ["two", "one", "two", "one"]
    assert len(heard) <= 12


@pytest.mark.promise("MODE-2")
async def test_what_shall_replace_one_that_rests_by_now_does_not_run() -> None:
    """Its set-up took longer than its turn: the old one rests, and stays."""
    ran: list[str] = []

    class Late(esair.Behavior):
        async def setup(self) -> None:
            await asyncio.sleep(0.5)

        async def run(self) -> None:
            ran.append(self.name)

    old = esair.Behavior(name="a")
    modes = {"one": esair.Mode(["a"]), "two": esair.Mode([])}
    async with esair.Robot(behaviors=[old], modes=modes, mode="one") as robot:
        replacing = asyncio.ensure_future(robot.behaviors.replace("a", Late(name="a")))
        await asyncio.sleep(0.1)
        await robot.behaviors.switch("two")
        with pytest.raises(esair.BehaviorRemovedError):
            await replacing
        assert robot.behaviors.action("a") is old
        assert robot.behaviors.query("a").state is esair.BehaviorState.RESTING
    assert ran == []


@pytest.mark.promise("MODE-3")
async def test_a_mode_without_a_behavior_of_its_own_lasts_until_it_is_switched() -> (
    None
):
    """Whoever is in no mode has ended; the robot has not."""

    class Ends(esair.Behavior):
        async def run(self) -> None:
            await asyncio.sleep(0.1)

    ends, goes = Ends(), esair.Behavior(name="goes")
    modes = {"rest": esair.Mode([]), "go": esair.Mode(["goes"])}
    async with esair.Robot(behaviors=[ends, goes], modes=modes, mode="rest") as robot:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(robot.ended(), 5.0)
