"""The same component does the same in the robot's process and in one of its own."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from typing import Any

import pytest
from tests.placement.actors import (
    ERRORS,
    LEAVES,
    Acts,
    Ages,
    AgesAsStep,
    Crashes,
    Falls,
    Follow,
    Gets,
    Gives,
    Leaves,
    Opens,
    PlainGets,
    PlainLeaves,
    Pushed,
    SmallFollow,
    Told,
    Values,
    Waits,
    Worker,
)

import esair
from esair import BehaviorState
from esair.exceptions import line_of, told_traceback
from esair.testing import FakeActuator, FakeSensor

pytestmark = [
    pytest.mark.placements,
    pytest.mark.virtual_clock,
    pytest.mark.promise("PLC-1"),
    pytest.mark.xdist_group("placement"),
]

Place = Callable[[Any], Any]
MAY = esair.Policy.behaviors(allow={"acts": "manage"})


class World:
    """A robot of one that acts, with wheels and a sonar, and others."""

    def __init__(self, acts: Any, *others: Any, **more: Any) -> None:
        self.wheels: FakeActuator[float] = FakeActuator("wheels", safe=0.0)
        self.sonar = FakeSensor("sonar", 1.0, type=float)
        self.robot = esair.Robot(
            resources=[self.wheels, self.sonar, *more.pop("resources", [])],
            behaviors=[acts, *others],
            **more,
        )

    async def __aenter__(self) -> World:
        await self.robot.__aenter__()
        return self

    async def __aexit__(self, *error: Any) -> None:
        await self.robot.__aexit__(*error)

    async def said(self, within: float = 30.0, of: str = "acts") -> Any:
        """What came of the next act."""
        return await self.robot.behaviors.get(
            sender=of, receiver="user", interval=within
        )

    async def until(self, condition: Callable[[], Any]) -> None:
        async with asyncio.timeout(10.0):
            while not condition():  # noqa: ASYNC110
                await asyncio.sleep(0.01)


async def outcome(place: Place, *acts: tuple[Any, ...], **more: Any) -> Any:
    """What came of some acts: of the one, or of each."""
    async with World(place(Acts(*acts)), **more) as world:
        found = [await world.said() for _ in acts]
    return found[0] if len(found) == 1 else found


# Steps.


@pytest.mark.promise("BEH-3")
async def test_a_step_is_performed(place: Place) -> None:
    """From setup to teardown, with its return value; then its actuator is safe."""
    async with World(place(Acts(("perform", "Go", 0.5, 2.0), ("why",)))) as world:
        assert await world.said() == ["setup", "teardown"]
        assert await world.said() == ""
        assert world.wheels.commands.count(0.5) == 40
        assert world.wheels.commands[-1] == 0.0


@pytest.mark.promise("BEH-3")
async def test_a_step_may_be_performed_again(place: Place) -> None:
    """The same object: what it remembers stays with its performer."""
    assert await outcome(place, ("again",)) == [2, 4]


@pytest.mark.promise("BEH-3")
@pytest.mark.parametrize("error", ["stuck", "setup"])
async def test_the_error_of_a_step_is_its_performers(place: Place, error: str) -> None:
    """The very error, of its own class; the wheels are safe."""
    async with World(place(Acts(("perform", "Go", 0.5, 0.2, error)))) as world:
        assert await world.said() == ("StepError", error)
        assert world.wheels.commands[-1:] in ([0.0], [])


@pytest.mark.promise("BEH-3")
async def test_a_step_has_a_timeout(place: Place) -> None:
    """An error that names it; its teardown has run."""
    act = ("perform_for", 1.0, "Go", 0.5, 100.0)
    async with World(place(Acts(act))) as world:
        assert await world.said() == ["setup", "teardown"]
        told = "'go' could not come to its end for 1 s (it is a step of acts)"
        assert await world.said() == ("BehaviorUnavailableError", told)


@pytest.mark.promise("BEH-3")
async def test_a_step_moves_nothing_when_its_time_is_long_over(place: Place) -> None:
    """Though it heeds no cancellation."""
    acts = place(Acts(("perform_for", 1.0, "Unheeding")))
    async with World(acts, grace=0.5) as world:
        await world.wheels.until(0.5, timeout=1.0)
        await asyncio.sleep(1.7)
        assert world.wheels.commands.count(0.5) <= 31
        assert world.wheels.commands[-1] == 0.0


@pytest.mark.promise("BEH-3")
async def test_steps_in_a_task_group(place: Place) -> None:
    """One that fails ends the others."""
    async with World(place(Acts(("group",), ("why",)))) as world:
        assert await world.said() == "bang"
        assert await world.said() == ""
        assert world.wheels.commands[-1] == 0.0
        assert world.wheels.commands.count(0.5) <= 8


@pytest.mark.promise("BEH-3")
async def test_a_step_ends_with_its_performer(place: Place) -> None:
    """Nothing of it moves after the removal."""
    async with World(place(Acts(("perform", "Go", 0.5, 100.0)))) as world:
        await world.wheels.until(0.5, timeout=1.0)
        assert world.robot.behaviors.query("acts").detail == "performs go"
        await world.robot.behaviors.remove("acts")
        after = len(world.wheels.commands)
        await asyncio.sleep(2.0)
        assert world.wheels.commands[after - 1 :] == [0.0]


@pytest.mark.promise("BEH-3")
async def test_a_step_writes_with_its_performers_priority_at_most(place: Place) -> None:
    """Seven is declared, three is what its performer has."""
    async with World(place(Acts(("perform", "Go", 0.5, 1.0)))) as world:
        await world.wheels.until(0.5, timeout=1.0)
        assert world.robot.resources.why("wheels").priority == 3


@pytest.mark.promise("BEH-3")
async def test_a_policy_for_the_performer_counts(place: Place) -> None:
    """What it may not do, no step of it may."""
    arm = FakeActuator("arm", safe=0.0)
    rule = esair.Policy("arm", allow={"nobody": esair.Access.WRITE})
    act = ("perform", "Arm", 0.5, 1.0)
    name, told = await outcome(place, act, resources=[arm], policies=[rule])
    assert name == "AccessDeniedError"
    assert "arm" in told


@pytest.mark.promise("BEH-3")
async def test_a_step_may_be_plain_and_have_steps(place: Place) -> None:
    """In a thread of its own, with what it performs."""
    async with World(place(Acts(("perform", "PlainGo")))) as world:
        assert await world.said() == "plain, setup"
        assert 0.7 in world.wheels.commands
        assert world.wheels.commands[-1] == 0.0


@pytest.mark.promise("BEH-3")
async def test_what_a_step_registers_ends_with_it(place: Place) -> None:
    """With its performer's priority at most, and not after its end."""
    async with World(place(Acts(("perform", "Registers"), ("why",)))) as world:
        assert await world.said() is True
        assert await world.said() == ""
        assert world.wheels.commands[1:] == [0.9, 0.0]


@pytest.mark.promise("BEH-3")
@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("Elsewhere", "a step runs where its performer runs"),
        ("Worker", "it takes requests"),
    ],
)
async def test_what_cannot_be_a_step_is_told(place: Place, kind: str, why: str) -> None:
    """One that is placed, or is asked by its name."""
    name, told = await outcome(place, ("perform", kind))
    assert name == "ConfigError"
    assert why in told


@pytest.mark.promise("BEH-3")
async def test_a_step_is_performed_once_at_a_time(place: Place) -> None:
    """The second time it is refused: it is in use."""
    name, told = await outcome(place, ("at_once",))
    assert name == "ExceptionGroup" or "already" in told


@pytest.mark.promise("BEH-2")
@pytest.mark.parametrize("act", ["follow", "small"])
async def test_a_reaction_as_a_step_runs_until_its_condition(
    place: Place, act: str
) -> None:
    """It decides on each reading; the condition may know its readings by name."""
    async with World(place(Acts((act, 0.3), ("why",)))) as world:
        await world.wheels.until(1.0, timeout=1.0)
        world.sonar.feed(0.8)
        await world.wheels.until(0.8, timeout=1.0)
        assert world.robot.resources.why("wheels").priority == 10
        world.sonar.feed(0.2)
        assert await world.said() in {True, (True, True)}
        assert await world.said() == ""
        assert 0.2 not in world.wheels.commands
        assert world.wheels.commands[-1] == 0.0


@pytest.mark.promise("BEH-2")
async def test_a_reaction_as_a_step_has_a_timeout(place: Place) -> None:
    """False says that the time was over."""
    async with World(place(Acts(("follow", 0.3, 1.0)))) as world:
        assert await world.said() == (False, True)
        assert world.wheels.commands[-1] == 0.0


@pytest.mark.promise("BEH-2")
async def test_a_reaction_that_fails_as_a_step_is_its_performers(place: Place) -> None:
    """The very error; nothing of it moves."""
    async with World(place(Acts(("perform", "Follow", 2)))) as world:
        await world.wheels.until(1.0, timeout=1.0)
        world.sonar.feed(0.8)
        assert await world.said() == ("StepError", "react")
        assert world.wheels.commands[-1] == 0.0


@pytest.mark.promise("BEH-2")
async def test_a_reaction_as_a_step_is_blind_for_a_limited_time(place: Place) -> None:
    """It is told what is missing."""
    async with World(place(Acts(("perform_blind",)))) as world:
        await world.wheels.until(1.0, timeout=1.0)
        world.sonar.unplug()
        name, _ = await world.said()
        assert name in {"DeviceLostError", "StaleReadingError"}


# The supervisor in hand.


@pytest.mark.promise("BEH-6")
async def test_a_manager_adds_replaces_restarts_and_removes(place: Place) -> None:
    """As the user does, with its right, and the journal says who did it."""
    acts = [
        ("sleep", 0.1),
        ("manage", "add", ("Acts", ("write", 0.3))),
        ("manage", "restart", "second"),
        ("manage", "replace", "second", ("Acts", ("write", 0.6))),
        ("query", "second"),
        ("manage", "remove", "second"),
    ]
    events: list[Any] = []
    async with World(place(Acts(*acts)), policies=[MAY]) as world:
        world.robot.journal.listen(events.append)
        found = [await world.said() for _ in acts]
        assert found == [None, None, None, [], "running", []]
        await asyncio.sleep(0.01)
        assert world.robot.behaviors.names() == ["acts"]
        assert {0.3, 0.6} <= set(world.wheels.commands)
    done = [(e.text, e.component) for e in events if e.peer == "acts"]
    assert [each for each in done if each[1] == "second"][:4] == [
        ("add", "second"),
        ("restart", "second"),
        ("replace", "second"),
        ("remove", "second"),
    ]


@pytest.mark.promise("BEH-6")
@pytest.mark.parametrize("verb", ["add", "replace", "remove", "restart"])
async def test_without_the_right_nothing_is_done(place: Place, verb: str) -> None:
    """Each is denied, with the policy that is missing."""
    given: dict[str, tuple[Any, ...]] = {
        "add": (("Acts",),),
        "replace": ("waits", ("Acts",)),
        "remove": ("waits",),
        "restart": ("waits",),
    }
    acts = Acts(("manage", verb, *given[verb]))
    async with World(place(acts), Waits()) as world:
        name, told = await world.said()
        assert name == "AccessDeniedError"
        assert "Policy.behaviors" in told
        assert world.robot.behaviors.names() == ["acts", "waits"]


@pytest.mark.promise("BEH-6", "MODE-1")
async def test_a_manager_switches_the_mode(place: Place) -> None:
    """With its right, as the user does."""
    modes = {"look": ["acts", "waits"], "rest": ["acts"]}
    more = {"modes": modes, "mode": "look", "policies": [MAY]}
    acts = Acts(("manage", "switch", "rest"), ("query", "waits"))
    async with World(place(acts), Waits(), **more) as world:
        await world.said()
        assert await world.said() == "resting"


@pytest.mark.promise("BEH-6")
async def test_what_is_no_action_is_refused(place: Place) -> None:
    """A sensor is added by nobody but the user."""
    name, _ = await outcome(place, ("manage", "add", ("Values",)), policies=[MAY])
    assert name in {"ConfigError", "AccessDeniedError", "BadValueError"}


# Data between behaviors.


@pytest.mark.promise("BS-1", "BS-2")
async def test_put_reaches_a_receiver_that_has_room(place: Place) -> None:
    """Data is in the inbox when put returns; a full one is waited for, and given up."""
    acts = Acts(("put", "waits", {"x": 1.5}, 1.0), ("put", "waits", 2, 0.5))
    waits = Waits()
    async with World(place(acts), waits) as world:
        begin = esair.now()
        assert await world.said() is None
        assert (await world.said())[0] == "BehaviorUnavailableError"
        assert 0.45 < esair.now() - begin < 0.65
        assert await world.robot.behaviors.remove("waits") == [{"x": 1.5}]


@pytest.mark.promise("BS-1")
async def test_receive_tells_who_has_put_it_and_gives_up_in_time(place: Place) -> None:
    """In the order in which it came."""
    acts = Acts(("receive", 1.0), ("receive", 1.0), ("receive", 0.3))
    async with World(place(acts)) as world:
        for data in (1, 2):
            await world.robot.behaviors.put(data, sender="user", receiver="acts")
        assert [await world.said(), await world.said()] == [["user", 1], ["user", 2]]
        assert (await world.said())[0] == "BehaviorUnavailableError"


@pytest.mark.promise("BS-3")
async def test_get_takes_what_was_offered_or_is_made(place: Place) -> None:
    """Offers in order; then it is made on demand."""
    asks = ("get", "gives", 1.0)
    async with World(Acts(("sleep", 0.5), *[asks] * 3), place(Gives())) as world:
        assert [await world.said() for _ in range(4)] == [None, [1], [2], 3.5]


@pytest.mark.promise("BS-3")
@pytest.mark.parametrize("who", ["nobody", "waits"])
async def test_a_get_that_cannot_be_answered_is_an_error(
    place: Place, who: str
) -> None:
    """Of nobody at once, of one that gives nothing in time."""
    async with World(place(Acts(("get", who, 0.5))), Waits()) as world:
        name, _ = await world.said()
        expected = {"nobody": "UnknownNameError", "waits": "BehaviorUnavailableError"}
        assert name == expected[who]


# Requests.

ANSWERS = {
    "": (42, ["begun"]),
    "refuse": "RefusedError",
    "fail": "BehaviorFailedError",
    "end": "BehaviorFailedError",
    "forget": "BehaviorFailedError",
    "slow": "BehaviorUnavailableError",
}


@pytest.mark.promise("BS-8", "BS-10")
@pytest.mark.parametrize("mood", ANSWERS)
@pytest.mark.parametrize("other_way", [False, True])
async def test_an_ask_has_one_outcome(place: Place, mood: str, other_way: bool) -> None:
    """Whatever the other does with it, and whichever of both has a process."""
    acts, worker = Acts(("ask", "worker", 5.0)), Worker(mood)
    place(worker if other_way else acts)
    async with World(acts, worker) as world:
        found = await world.said()
        assert found == ANSWERS[mood] or found[0] == ANSWERS[mood]


@pytest.mark.promise("BS-11")
@pytest.mark.parametrize("other_way", [False, True])
async def test_an_asker_that_ends_withdraws(place: Place, other_way: bool) -> None:
    """Its request is over, and the work on it is cancelled."""
    acts, worker = Acts(("ask", "worker", 100.0)), Worker("slow")
    place(worker if other_way else acts)
    async with World(acts, worker) as world:
        await world.until(lambda: world.robot.behaviors.query("worker").working)
        await world.robot.behaviors.remove("acts")
        assert await world.said(of="worker") == "done"
        await world.until(lambda: not world.robot.behaviors.query("worker").working)


@pytest.mark.promise("BS-10")
@pytest.mark.parametrize("other_way", [False, True])
@pytest.mark.parametrize("how", ["remove", "replace"])
async def test_a_worker_that_goes_ends_the_work_at_once(
    place: Place, other_way: bool, how: str
) -> None:
    """Its asker is told so."""
    acts, worker = Acts(("ask", "worker", 100.0)), Worker("slow")
    place(worker if other_way else acts)
    async with World(acts, worker) as world:
        await world.until(lambda: world.robot.behaviors.query("worker").working)
        if how == "remove":
            await world.robot.behaviors.remove("worker")
        else:
            await world.robot.behaviors.replace("worker", Worker())
        assert (await world.said())[0] == "BehaviorRemovedError"


# Life.


@pytest.mark.promise("BEH-4")
async def test_a_crash_makes_safe_and_begins_anew_within_the_budget(
    place: Place,
) -> None:
    """The second crash is one too many."""
    async with World(place(Crashes())) as world:
        query = world.robot.behaviors.query
        for restarts in (1, 1):
            await world.wheels.until(0.4, timeout=1.0)
            await world.robot.behaviors.put(restarts, sender="user", receiver="crashes")
            before = len(world.wheels.commands)
            await asyncio.sleep(0.3)
            assert 0.0 in world.wheels.commands[before - 1 :]
            assert query("crashes").restarts == restarts
        assert query("crashes").state is BehaviorState.FAILED


@pytest.mark.promise("PLC-3")
@pytest.mark.parametrize("how", ERRORS)
async def test_a_crash_is_told_as_what_it_is_and_where_it_was(
    place: Place, how: str
) -> None:
    """By its own class, and by the user's own line, which its log shows."""
    async with World(place(Falls())) as world:
        await world.robot.behaviors.put(how, sender="user", receiver="falls")
        query = world.robot.behaviors.query
        await world.until(lambda: query("falls").state is BehaviorState.FAILED)
        error = query("falls").error
        assert type(error) is type(ERRORS[how])
        assert line_of(error).endswith("in run: raise ERRORS[await self.receive()]")


@pytest.mark.promise("PLC-3")
async def test_the_traceback_of_a_crash_has_lines(place: Place) -> None:
    """As Python prints it, that of its process too."""
    async with World(place(Falls())) as world:
        await world.robot.behaviors.put("value", sender="user", receiver="falls")
        query = world.robot.behaviors.query
        await world.until(lambda: query("falls").state is BehaviorState.FAILED)
        error = query("falls").error
        assert error is not None
        lines = told_traceback(error).splitlines()
        assert "    raise ERRORS[await self.receive()]" in lines


@pytest.mark.promise("SUP-4")
async def test_a_restart_begins_anew(place: Place) -> None:
    """By the user: the count of its crashes is none, it does all of it again."""
    async with World(place(Acts(("write", 0.5)))) as world:
        assert await world.said()
        await world.robot.behaviors.restart("acts")
        assert await world.said()
        assert world.wheels.commands[1:] == [0.5, 0.0, 0.5]
        assert world.robot.behaviors.query("acts").restarts == 0


@pytest.mark.promise("SUP-4", "PLC-7", "REP-3")
async def test_each_life_draws_its_own_random_numbers(place: Place) -> None:
    """Made from the seed, the name and the number of the life, wherever it runs."""
    async with World(place(Acts(("draw",), ("draw",))), seed=7) as world:
        for life in ("7/acts", "7/acts/2", "7/acts/3"):
            dice = random.Random(life)
            assert [await world.said(), await world.said()] == [
                dice.random(),
                dice.random(),
            ]
            await world.robot.behaviors.restart("acts")


@pytest.mark.promise("PLC-7")
async def test_no_timer_rings_early(place: Place) -> None:
    """Not even if something else happens 50 us before it is due."""
    told: list[float] = []
    async with World(place(Acts(("write_twice", 5e-5)))) as world:
        world.robot.journal.listen(
            lambda event: (
                told.append(event.time) if event.kind.value == "sent" else None
            )
        )
        await world.said()
        assert told[-1] - told[-2] == pytest.approx(5e-5, abs=1e-6)


@pytest.mark.promise("SUP-3")
async def test_a_removal_ends_rights_and_makes_safe(place: Place) -> None:
    """When it returns; the name is free for another."""
    async with World(place(Acts(("write", 0.5)))) as world:
        await world.said()
        await world.robot.behaviors.remove("acts")
        assert world.wheels.commands[-1] == 0.0
        assert world.robot.behaviors.names() == []
        await world.robot.behaviors.add(place(Acts(("write", 0.6))))
        await world.wheels.until(0.6, timeout=1.0)


@pytest.mark.promise("SUP-5")
async def test_a_replacement_takes_its_place(place: Place) -> None:
    """The old one is safe before the new one moves; what it has left is returned."""
    async with World(place(Acts(("write", 0.5)))) as world:
        await world.said()
        await world.robot.behaviors.put("left", sender="user", receiver="acts")
        new = place(Acts(("write", 0.7)))
        assert await world.robot.behaviors.replace("acts", new) == ["left"]
        assert await world.said()
        assert world.wheels.commands[1:] == [0.5, 0.0, 0.7]


@pytest.mark.promise("SUP-2")
async def test_a_component_that_is_added_runs(place: Place) -> None:
    """When add returns it is there."""
    async with World(Waits()) as world:
        await world.robot.behaviors.add(place(Acts(("write", 0.5))))
        state = world.robot.behaviors.query("acts").state
        assert state is BehaviorState.RUNNING
        await world.wheels.until(0.5, timeout=1.0)


# Reactions and sensors.


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("kind", [Follow, SmallFollow])
async def test_a_reaction_decides_on_each_reading(place: Place, kind: Any) -> None:
    """Its command takes the actuator; a crash makes safe."""
    async with World(place(kind())) as world:
        for value in (0.3, 0.8, 0.6):
            world.sonar.feed(value)
            await world.wheels.until(value, timeout=1.0)


@pytest.mark.promise("PLC-7", "BEH-5")
@pytest.mark.parametrize("kind", [Ages, AgesAsStep])
async def test_a_reaction_knows_what_time_it_is(place: Place, kind: Any) -> None:
    """In its step it is the moment of that step, not of the one before."""
    async with World(place(kind())) as world:
        for value in (0.3, 0.8, 0.6):
            await asyncio.sleep(0.25)
            world.sonar.feed(value)
        await asyncio.sleep(0.25)
    assert {each for each in world.wheels.commands if each} == {1.0}


@pytest.mark.promise("PLC-1")
@pytest.mark.parametrize("kind", [Values, Pushed])
async def test_a_sensor_is_read_set_and_operated(place: Place, kind: Any) -> None:
    """Its readings are heard in order; a setting is applied, an operation answered."""
    right = esair.Access.READ | esair.Access.CONFIGURE
    rule = esair.Policy("eye", allow={"user": right})
    eye = place(kind(name="eye", **({"rate": 20.0} if kind is Values else {})))
    async with World(Waits(), resources=[eye], policies=[rule]) as world:
        robot = world.robot
        registered = await robot.resources.register("user", "eye", right)
        first = await robot.sensors.read(registered, fresh=True, timeout=5.0)
        second = await robot.sensors.read(registered, fresh=True, timeout=5.0)
        assert second > first
        if kind is Values:
            await robot.resources.configure(registered, gain=3.0)
            assert robot.resources.get("eye").gain == 3.0
            assert await robot.resources.operate(registered, "zero") == "zeroed"


@pytest.mark.promise("PLC-1", "RES-4")
async def test_a_device_is_opened_again_with_its_settings(place: Place) -> None:
    """With those that it has by now, and not with those that it began with."""
    right = esair.Access.READ | esair.Access.CONFIGURE
    rule = esair.Policy("eye", allow={"user": right})
    eye = place(Opens(name="eye", rate=20.0))
    async with World(Waits(), resources=[eye], policies=[rule]) as world:
        robot = world.robot
        registered = await robot.resources.register("user", "eye", right)
        first = await robot.sensors.read(registered, fresh=True, timeout=5.0)
        await robot.resources.configure(registered, gain=3.0)
        assert await robot.resources.operate(registered, "unplug") == "unplugged"
        await world.until(lambda: robot.resources.query("eye").losses == 1)
        await world.until(lambda: robot.resources.query("eye").state.value == "ready")
        again = await robot.sensors.read(registered, fresh=True, timeout=5.0)
        assert (first.value, again.value) == (1.0, 3.0)


@pytest.mark.promise("PLC-1", "PLC-3")
@pytest.mark.parametrize("kind", [Leaves, PlainLeaves])
@pytest.mark.parametrize("how", LEAVES)
async def test_what_no_driver_should_raise_is_told_in_one_way(
    place: Place, kind: Any, how: str
) -> None:
    """As an error of its driver, whatever that is written in and wherever it runs."""
    async with World(Waits(), resources=[place(kind(how, name="eye"))]) as world:
        error = world.robot.resources.query("eye").error
        assert isinstance(error, esair.DeviceLostError)
        assert f"the driver raised {type(LEAVES[how]).__name__}" in str(error)


# Circles of requests.


@pytest.mark.promise("BS-5")
@pytest.mark.parametrize("kind", [Gets, PlainGets])
@pytest.mark.parametrize("both", [True, False])
async def test_a_circle_of_get_is_refused_at_once(
    place: Place, kind: Any, both: bool
) -> None:
    """Nobody of either can go on: the path is in the error, and no time has passed."""
    told, b = Told(), kind("b", "a")
    others = (place(b) if both else b, told)
    async with World(place(kind("a", "b")), *others) as world:
        await world.until(lambda: told.all)
        name, error, when = told.all[0]
        path = "b -> a -> b" if name == "b" else "a -> b -> a"
        assert error == ("CircularRequestError", f"a circle of requests: {path}")
        assert when < 0.01


@pytest.mark.promise("BS-5")
@pytest.mark.parametrize(
    ("beside", "comes"),
    [
        ("sleeps", "after a while"),
        ("hears", "as it was told"),
        ("looks", "as it was seen"),
    ],
)
async def test_who_has_another_task_closes_no_circle(
    place: Place, beside: str, comes: str
) -> None:
    """It can still offer what is waited for, and does."""
    told = Told()
    async with World(place(Gets("a", "b", beside)), place(Gets("b", "a")), told) as w:
        await asyncio.sleep(0.5)
        assert (told.all == []) == (beside != "looks")
        if beside == "hears":
            await w.robot.behaviors.put("go on", sender="user", receiver="a")
        await w.until(lambda: told.all)
        assert told.all[0][:2] == ("b", comes)


@pytest.mark.promise("BS-5")
async def test_tasks_that_wait_for_each_other_close_no_circle(place: Place) -> None:
    """Who of a behavior waits for what nobody else sees may know better: it is given time."""
    told = Told()
    acts = place(Gets("a", "b", "wait_for_ever")), place(Gets("b", "a"))
    async with World(*acts, told) as world:
        await world.until(lambda: len(told.all) == 2)
        assert {error[0] for _, error, _ in told.all} == {"BehaviorUnavailableError"}
        assert all(when >= 3.0 for _, _, when in told.all)
