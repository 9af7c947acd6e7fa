"""The soak: torture on robots that are made from numbers; and what it has found."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.torture.generated import maker
from tests.torture.small import ROBOTS

import esair.demo
from esair.torture import Step, Story, Target, World, survive, torture
from esair.torture._torture import tell

EXAMPLES = Path(__file__).parents[2] / "examples"

FAULTS, LONG, SOAK = 500, 1_500, 100_000
EACH = 500
"""How many faults one robot gets."""

SEED = 100


def soak(faults: int, *, placed: bool = False) -> None:
    """Torture one robot after the other; fail with the first finding."""
    seed = SEED
    while faults > 0:
        target = Target(f"robot {seed}", maker(seed, placed=placed))
        report = torture(target, seed=seed, faults=min(faults, EACH))
        assert [
            (seed, str(each.violation), each.story) for each in report.findings
        ] == []
        faults -= report.faults
        seed += 1


@pytest.mark.long
@pytest.mark.promise("CALL-2", "PRO-1", "ROB-2", "ROB-4", "BS-10", "AC-4")
@pytest.mark.fault("D21", "D22", "R09", "R11", "X06", "B10")
def test_soak(request: pytest.FixtureRequest) -> None:
    """No order, no fault and no end breaks what must hold."""
    option = request.config.getoption
    long = LONG if option("--esair-long") else FAULTS
    soak(SOAK if option("--esair-soak") else long)


@pytest.mark.long
@pytest.mark.promise("PLC-3", "PLC-4")
def test_soak_of_processes(request: pytest.FixtureRequest) -> None:
    """Nor where every second action has a process of its own."""
    soak(
        SOAK // 20 if request.config.getoption("--esair-soak") else FAULTS, placed=True
    )


@pytest.mark.long
@pytest.mark.promise("RS-5", "SUP-3", "TOR-1")
@pytest.mark.parametrize("kind", ROBOTS)
def test_soak_of_the_small(request: pytest.FixtureRequest, kind: str) -> None:
    """Nor what happens within a second to one sensor, one actuator and who uses them."""
    faults = 50_000 if request.config.getoption("--esair-soak") else LONG
    report = torture(Target(kind, ROBOTS[kind]), seed=SEED, faults=faults)
    assert [(str(each.violation), each.story) for each in report.findings] == []


@pytest.mark.promise("ROB-2", "SUP-3")
def test_a_device_that_is_removed_while_the_robot_stops_is_not_opened_again() -> None:
    """The last try of the stop to reach it opened it, and left it open."""
    steps = (
        Step(1.3, "silent", "blockingmotor_1", lasts=0.1),
        Step(1.3, "restart", "pushing_0"),
        Step(1.331, "held up", much=2),
        Step(1.7, "remove", "blockingmotor_1", lasts=0.02),
        Step(1.9, "late", "blockingmotor_1", lasts=0.1, how="after deaf", much=0.3),
    )
    world = World(Target("robot 3", maker(3)), Story(0, steps, 2.222))
    assert world.run().violations == ()


@pytest.mark.promise("ROB-2", "SUP-3")
def test_the_stop_closes_what_an_addition_in_vain_undoes() -> None:
    """Both forgot the device; the one that came second ended the stop half done."""
    survive(
        f"{EXAMPLES / 'slow_arm.py'}:robot",
        seed=881628831,
        lasts=1.788,
        own=True,
        steps=[
            Step(0.515, "halt", lasts=0.02),
            Step(0.515, "crash", "visitor", how="SystemExit"),
            Step(0.515, "hang", "guard", lasts=1, how="deaf"),
            Step(0.515, "hang", "visitor", lasts=0.1, how="deaf"),
            Step(0.515, "replace", "arm"),
            Step(0.788, "remove", "arm", lasts=1),
            Step(1.788, "end", how="error"),
        ],
    )


@pytest.mark.long
@pytest.mark.promise("SUP-3")
def test_the_demo_ends_though_it_did_not_hear_its_cancellation() -> None:
    """It took its own removal for that of its mapper, and went on for ever."""
    steps = (
        Step(2.3, "hang", "explore", lasts=1, how="deaf"),
        Step(2.3, "replace", "explore"),
    )
    demo = Path(esair.demo.__file__).with_name("robot.toml")
    world = World(Target.of(str(demo)), Story(0, steps, 4.688))
    assert world.run().violations == ()
    assert not any(each.is_running for each in world.levers.values())


@pytest.mark.promise("ROB-6")
def test_deadlines_of_a_stop_do_not_add_up() -> None:
    """A deaf behavior, then a silent device twice: longer than `esair.run` waits."""
    survive(
        f"{EXAMPLES / 'wander_and_avoid.py'}:robot",
        lasts=3.087,
        steps=[
            Step(1.5, "held up", much=2),
            Step(1.8, "silent", "wheels", lasts=4),
            Step(2.8, "hang", "wander", lasts=4, how="deaf"),
            Step(2.8, "replace", "avoid"),
        ],
    )


@pytest.mark.promise("TURN-1", "PRO-1")
def test_a_sleep_of_the_computer_is_not_noticed_within_a_command() -> None:
    """The scheduler, which was at rest, looked when the command woke it: safe came first."""
    survive(
        f"{EXAMPLES / 'slow_arm.py'}:robot",
        seed=0,
        lasts=4.857,
        own=True,
        steps=[
            Step(0.4, "unplugged", "arm", lasts=4),
            Step(2.0, "suspended", much=3600),
        ],
    )


@pytest.mark.promise("SC-3", "PRO-1")
def test_an_initial_value_counts_from_the_end_of_the_opening() -> None:
    """Its settings were applied 0.3 s after it was open; who looks is not blind yet."""
    steps = (
        Step(0.8, "configure", "pushing_0"),
        Step(1.017, "late", "pushing_0", lasts=0.1, how="before", much=1.5),
        Step(2.6, "wrong", "pushing_0", lasts=1.0, how="nan"),
        Step(2.861, "late", "pushing_0", lasts=0.3, how="before", much=0.3),
    )
    world = World(Target("robot 266", maker(266)), Story(2011021320, steps, 3.861))
    assert world.run().violations == ()


@pytest.mark.promise("CALL-2", "SUP-3")
def test_what_lands_on_a_device_that_was_replaced_is_not_its_successors() -> None:
    """Its last motion landed in the instant in which it was closed."""
    steps = (
        Step(1.194, "unplugged", "servo_0", lasts=0.3),
        Step(1.6, "silent", "servo_0", lasts=1.0),
        Step(1.6, "late", "servo_0", lasts=4.0, how="after deaf", much=1.5),
        Step(2.1, "replace", "servo_0"),
        Step(2.7, "silent", "servo_0", lasts=0.3),
        Step(3.0, "remove", "servo_0", lasts=0.02),
    )
    world = World(Target("robot 260", maker(260)), Story(1508357323, steps, 3.322))
    assert world.run().violations == ()


@pytest.mark.promise("RS-4", "SUP-1")
def test_a_setting_that_waits_while_the_robot_stops_is_told_of_it() -> None:
    """It had its turn when the device was closed, and its right was still one."""
    steps = (
        Step(0.8, "silent", "sonar", lasts=1.0),
        Step(1.3, "configure", "sonar"),
        Step(1.4, "configure", "sonar"),
        Step(1.6, "held up", much=0.5),
        Step(1.6, "configure", "sonar"),
    )
    world = World(Target("robot", ROBOTS["computed"]), Story(0, steps, 1.9))
    assert world.run().violations == ()


@pytest.mark.promise("TOR-1")
def test_what_is_computed_is_added_when_its_sources_are_there() -> None:
    """Both were taken away, and it comes back first: no finding, the user tries again."""
    steps = (
        Step(3.0, "remove", "twice", lasts=0.02),
        Step(3.0, "remove", "sonar", lasts=0.02),
    )
    world = World(Target("robot", ROBOTS["computed"]), Story(0, steps, 19.956))
    assert world.run().violations == ()


@pytest.mark.promise("TOR-1")
def test_a_crash_of_what_waits_for_a_restart_is_none_of_later() -> None:
    """It has no code that could raise; else it would crash once more when that comes."""
    steps = tuple(
        Step(at, "crash", "on_twice", how="OSError") for at in (3.0, 3.2, 3.236)
    )
    world = World(Target("robot", ROBOTS["computed"]), Story(0, steps, 18.736))
    assert world.run().violations == ()
    assert world.done["crash"] == 2


def test_what_was_removed_does_not_crash() -> None:
    """It has no place in that moment."""
    steps = (
        Step(1.6, "remove", "on_twice", lasts=0.3),
        Step(1.8, "crash", "on_twice", how="OSError"),
    )
    world = World(Target("robot", ROBOTS["computed"]), Story(0, steps, 3.0))
    assert world.run().violations == ()
    assert world.done.total() == 1


@pytest.mark.promise("TOR-1")
@pytest.mark.parametrize(
    ("kind", "lasts", "steps"),
    [
        (
            "a latch, blocking",
            18.8,
            (Step(3.0, "failing", "sonar", lasts=0.3, how="SystemExit"),),
        ),
        (
            "a reader, polled",
            4.761,
            (
                Step(2.3, "halt", lasts=1.0),
                Step(2.8, "silent", "wheels", lasts=1.0),
                Step(3.4, "halt", lasts=0.02),
                Step(3.5, "late", "wheels", lasts=1.0, how="after deaf", much=1.5),
                Step(3.761, "remove", "reader", lasts=0.02),
            ),
        ),
    ],
    ids=["reset when it can be", "safe again once the motion's call has ended"],
)
def test_a_small_robot_is_not_blamed(
    kind: str, lasts: float, steps: tuple[Step, ...]
) -> None:
    """Neither for a latch that nobody could reset, nor for what it could not know."""
    story = Story(0, steps, lasts)
    assert tell(Target(kind, ROBOTS[kind]), story).violations == ()
