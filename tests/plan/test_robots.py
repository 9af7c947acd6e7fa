"""What only the whole robot shows: names, modes, rights, who starves, what nobody uses."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import pytest
from tests.plan import rulebook_parts as parts

import esair
from esair import Mode, Policy, Restart, minimal
from esair.messages import Access, Modes
from esair.plan import (
    Plan,
    depths,
    examine,
    examine_action,
    examine_resource,
    examine_step,
    failures,
)
from esair.testing import FakeCan, FakeI2c

pytestmark = pytest.mark.promise("RS-8")


class Motor(parts.Wheels):
    moves = False


def mover(name: str, kind: type = esair.Behavior, **terms: Any) -> Any:
    """Make who writes the wheels."""
    return kind(name=name, writes={"wheels": esair.writes(float, **terms)})


def told(rule: str, *behaviors: Any, **more: Any) -> list[tuple[str, str]]:
    """Return what one rule says of a robot: of whom, and the words."""
    more.setdefault("resources", [parts.Sonar(), Motor(name="wheels")])
    found = examine(Plan(behaviors=behaviors, **more))
    return [(each.component, each.text) for each in found if each.rule == rule]


# Who keeps others from an actuator.


class Steps(esair.Reaction):
    rate = 50.0

    def react(self) -> None: ...


def test_equals_keep_each_other_out() -> None:
    """Whoever writes first holds it."""
    assert told("starve", mover("one"), mover("two")) == [
        (
            "two",
            "'one' and 'two' write 'wheels' with the same priority (0): whoever holds it "
            "keeps the other out: raise one of them",
        )
    ]


def test_a_behavior_above_another_may_never_let_go() -> None:
    """Whatever the order in which they are listed."""
    wanted = [
        (
            "two",
            "'two' is no reaction, so it may write 'wheels' without pause, and its "
            "priority 5 is above that of 'one' (0): see that it releases 'wheels', or "
            "lower its priority",
        )
    ]
    one, two = mover("one"), mover("two", priority=5)
    assert told("starve", one, two) == wanted
    assert told("starve", two, one) == wanted


@pytest.mark.parametrize("blind", ["safe", "release"])
def test_a_reaction_above_a_behavior_starves_nobody(blind: str) -> None:
    """It has no say while it has nothing to say; so have two reactions."""
    above = mover("two", Steps, priority=5, blind=blind)
    assert told("starve", mover("one"), above) == []


def test_equals_of_which_one_is_kept_safe_are_told_by_that() -> None:
    """Not twice: the blind hold at their priority says it."""
    level = mover("two", Steps)
    assert told("starve", mover("one"), level) == []
    assert [who for who, _ in told("protect", mover("one"), level)] == ["two"]


def test_equals_of_which_none_is_kept_safe_only_starve() -> None:
    """A reaction may say that it has no say while it is blind, too."""
    level = mover("two", Steps, blind="release")
    assert [who for who, _ in told("starve", mover("one"), level)] == ["two"]
    assert told("protect", mover("one"), level) == []


def test_those_who_never_meet_do_not_starve() -> None:
    """Each has a mode of its own."""
    modes = Modes({"a": Mode(["one"], then="b"), "b": Mode(["two"])}, "a")
    assert told("starve", mover("one"), mover("two"), modes=modes) == []


# Modes.


def test_a_mode_may_follow_a_failure() -> None:
    """It is one that the robot comes to by itself; one that nothing leads to is told."""
    table = {"a": Mode(["one"], on_failure="b"), "b": Mode(["two"]), "c": Mode([])}
    assert told("mode", mover("one"), mover("two"), modes=Modes(table, "a")) == [
        (
            "mode.c",
            "no then or on_failure leads there, and no behavior may switch: only people "
            "come to it: esair mode, robot.behaviors.switch",
        )
    ]


def test_modes_may_follow_each_other_in_a_circle() -> None:
    """Then the robot comes to all of them."""
    table = {"a": Mode(["one"], then="b"), "b": Mode(["two"], then="a")}
    assert told("mode", mover("one"), mover("two"), modes=Modes(table, "a")) == []


def test_a_policy_that_lets_nobody_manage_leads_to_no_mode() -> None:
    """Only people come to the other one, and only they move what is moved there."""
    table = {"a": Mode([]), "b": Mode(["one"])}
    policies = [Policy.behaviors(allow={})]
    found = told("mode", mover("one"), modes=Modes(table, "a"), policies=policies)
    assert [who for who, _ in found] == ["mode.b", "wheels"]


# What becomes of one that fails.


@pytest.mark.promise("SUP-4")
@pytest.mark.parametrize(
    ("restart", "essential", "words"),
    [
        (Restart(max=1, within=5.0), False,
         "1 restart in 5 s, then it is FAILED: mode b follows a"),
        (Restart(), True, "3 restarts in 30 s, then the robot ends with an exit code"),
        (Restart(retry=300.0), False,
         "3 restarts in 30 s, then again every 300 s, for ever"),
        (3, False, "its restart is none"),
    ],
)  # fmt: skip
def test_what_the_failure_of_a_behavior_means(
    restart: Any, essential: bool, words: str
) -> None:
    """A mode that follows, the end of the robot, another try."""
    one = mover("one")
    one.restart, one.essential = restart, essential
    modes = Modes({"a": Mode(["one"], on_failure="b"), "b": Mode(["one"])}, "a")
    assert failures(Plan(behaviors=[one], modes=modes)) == {"one": words}


@pytest.mark.promise("SUP-4")
def test_without_a_mode_the_others_go_on() -> None:
    """Nothing follows where no mode says so."""
    (words,) = failures(Plan(behaviors=[mover("one")])).values()
    assert words.endswith("then it is FAILED: the others go on without it")


@pytest.mark.promise("SUP-4")
@pytest.mark.parametrize("retry", [None, 300.0])
@pytest.mark.parametrize("essential", [True, False])
def test_what_is_tried_for_ever_is_not_essential(
    retry: float | None, essential: bool
) -> None:
    """The robot would never end for it."""
    one = mover("one")
    one.restart, one.essential = Restart(retry=retry), essential
    found = [words for _, words in told("declaration", one) if "essential" in words]
    assert found == (
        ["it is essential, and never FAILED, for restart.retry tries for ever: leave one "
         "out"]
        if retry and essential
        else []
    )  # fmt: skip


# What nobody uses, and buses.


class Free(esair.Derived[float]):
    sonar = esair.reads(float)

    def compute(self, sonar: float) -> float:
        return sonar


def test_what_nobody_declares_to_use_is_told() -> None:
    """Not what is computed of, nor what came with another part."""
    resources = [parts.Sonar(), Free(), Motor(name="wheels"), parts.Slow(name="more")]
    assert told("unused", resources=resources, implied=["more"]) == [
        ("free", "no behavior declares that it reads it"),
        ("wheels", "no behavior declares that it writes it"),
    ]
    assert told("unused", resources=resources, missing={"drive": "behavior"}) == []


def test_a_bus_without_a_device_is_told() -> None:
    """Unless a part could not be made: it may be that part's."""
    buses: Any = {"front": FakeCan("front"), "drive": FakeCan("drive")}
    resources = [parts.Node(name="left", bus=buses["drive"])]
    assert told("unused", mover("one"), resources=resources, buses=buses)[-1:] == [
        ("front", "no device is on it")
    ]
    missing = {"eye": "sensor"}
    found = told("unused", resources=resources, buses=buses, missing=missing)
    assert ("front", "no device is on it") not in found


@pytest.mark.parametrize(
    ("port", "count"),
    [("/dev/ttyUSB0", 1), ("/dev/ttyACM3", 1), ("/dev/ttyAMA0", 0), (3, 0)],
)
def test_a_port_with_another_number_after_the_next_plugging(
    port: object, count: int
) -> None:
    """It is told with the path that stays; in whatever place the bus was given."""
    bus: Any = FakeCan("front")
    bus.port = port
    found = told("port", resources=[parts.Node(name="left", bus=bus)])
    assert [who for who, _ in found] == ["front"] * count


class Register(parts.Sonar):
    rate = esair.setting(10.0, unit="Hz", min=0.1, max=10_000.0)


class PushesToo(Register):
    async def stream(self) -> AsyncIterator[float]:
        yield 1.0


class Coil(Motor):
    command_timeout = 0.1


class Slack(Motor):
    command_timeout: Any = None


@pytest.mark.parametrize(
    ("devices", "seconds", "load"),
    [
        ((Register,), 0.09, "90%"),
        ((Register,), 0.08, None),
        ((Register, Coil), 0.045, "90%"),
        ((Coil,), 0.09, "90%"),
        ((PushesToo,), 0.9, None),
        ((Slack,), 0.9, None),
    ],
)
def test_a_bus_that_is_asked_for_more_than_it_can_is_told(
    devices: Any, seconds: float, load: str | None
) -> None:
    """What is asked ten times a second, and told as often, adds up; a push costs nothing."""
    bus, other = FakeI2c("front"), FakeI2c("back")
    bus.stretch(seconds)
    resources = [each(name=f"a_{n}", bus=bus) for n, each in enumerate(devices)]
    resources += [Register(name="far", bus=other)]
    found = told("load", resources=resources)
    assert found == (
        []
        if load is None
        else [
            (
                "front",
                f"its devices ask {load} of its time at their rates: lower their rates, "
                "or give some of them another bus",
            )
        ]
    )


def test_what_writes_nobody_is_told_beside_all_else() -> None:
    """A mistake ends no look at the rest."""
    lamp = esair.writes(float)
    writes = {"wheels": esair.writes(float), "lamp": lamp, "sonar": esair.writes(float)}
    found = told("need", Steps(name="one", writes=writes))
    assert [words.partition(",")[0] for _, words in found] == [
        "no resource is named 'lamp'; there are sonar",
        "it writes 'sonar'",
    ]


@pytest.mark.parametrize(("rate", "count"), [(800.0, 0), (820.0, 1)])
def test_eight_bytes_are_asked_for_unless_it_says_otherwise(
    rate: float, count: int
) -> None:
    """With two addresses and a register, at 100,000 bits in a second."""
    asked = Register(name="asked", bus=FakeI2c("front"))
    asked.rate = rate
    assert len(told("load", resources=[asked])) == count


# Times.


@pytest.mark.parametrize(
    ("rate", "hold", "count"),
    [(5.0, None, 1), (5.1, None, 0), (5.1, 0.1, 1), (20.0, 0.1, 0), (2.0, 9.0, 1)],
)
def test_a_command_that_ends_before_the_next_is_told(
    rate: float, hold: float | None, count: int
) -> None:
    """It is good for its hold, and no longer than the actuator's command timeout."""
    steps = mover("one", Steps, hold=hold)
    steps.rate = rate
    found = told("time", steps)
    assert len(found) == count
    assert all("but a command is good for 0." in words for _, words in found)


@pytest.mark.parametrize(("max_age", "count"), [(1.0, 1), (1.01, 0), (None, 0)])
def test_a_reading_comes_before_it_is_too_old(max_age: Any, count: int) -> None:
    """As old as one period it may become; a behavior asks when it wants one."""
    reads = {"sonar": esair.reads(float, max_age=max_age)}
    resources = [parts.Slow(name="sonar")]
    steps = esair.Behavior(name="one", reads=reads)
    assert told("time", steps, resources=resources) == []

    class Looks(esair.Reaction):
        def react(self, sonar: float) -> None: ...

    looks = Looks(name="one", reads=reads)
    assert len(told("time", looks, resources=resources)) == count


# Policies.

WRITE = {"one": Access.WRITE}


@pytest.mark.promise("RS-2")
@pytest.mark.parametrize(
    ("policy", "of", "words"),
    [
        (Policy("whels"), "policy of 'whels'", "did you mean 'wheels'"),
        (3, "policies", "expected an esair.Policy, not 3"),
        (Policy("wheels", allow=WRITE, max_priority={"one": 1.5}),  # type: ignore[dict-item]
         "policy of 'wheels'", "expected a whole number, not 1.5"),
        (Policy("wheels", allow={**WRITE, "tvo": Access.WRITE}), "policy of 'wheels'",
         "no behavior is named 'tvo'; did you mean 'two'?"),
        (Policy("wheels", allow={**WRITE, "later": Access.WRITE}), "policy of 'wheels'",
         "nobody here has this right: no behavior is named 'later'"),
        (Policy("wheels", allow={"*": Access.WRITE}, max_priority={"later": 1}),
         "policy of 'wheels'", "nobody here has this right: no behavior is named 'later'"),
        (Policy.behaviors(allow={"ome": "manage"}), "policy of behaviors",
         "no behavior is named 'ome'; did you mean 'one'?"),
    ],
)  # fmt: skip
def test_a_policy_that_does_not_fit_is_told(policy: Any, of: str, words: str) -> None:
    """By its name, with what was meant, maybe."""
    found = told("rights", mover("one"), mover("two"), policies=[policy])
    assert [who for who, _ in found] == [of]
    assert words in found[0][1]


@pytest.mark.promise("RS-2")
@pytest.mark.parametrize(
    "policy",
    [
        Policy("wheels", allow={"one": Access.WRITE, "*": Access.READ}),
        Policy("wheels", allow={"*": Access.WRITE}, max_priority={"*": 5, "one": 3}),
        Policy("sonar", allow={"free": Access.READ}),
        Policy.behaviors(allow={"*": "manage"}),
        # What is like another that is named, too, is one that comes later.
        Policy("wheels", allow={"one": Access.WRITE, "one_b": Access.WRITE}),
    ],
)
def test_a_policy_that_fits_is_fine(policy: Any) -> None:
    """Of a behavior, of what is computed, of everybody."""
    resources = [parts.Sonar(), Motor(name="wheels"), Free()]
    found = told("rights", mover("one"), resources=resources, policies=[policy])
    later = [words for _, words in found if "'one_b'" in words]
    assert len(found) == len(later)
    assert all(each.startswith("nobody here has this right") for each in later)


@pytest.mark.promise("RS-2")
def test_two_policies_of_one_resource_are_told_once() -> None:
    """They could say different things."""
    policies = [Policy("wheels", allow=WRITE), Policy("wheels", allow=WRITE)]
    policies += [Policy("sonar", allow={"one": Access.READ})]
    assert told("rights", mover("one"), policies=policies) == [
        ("policy of 'wheels'", "it has more than one policy: join them")
    ]


@pytest.mark.promise("RS-2")
@pytest.mark.parametrize(("priority", "count"), [(5, 0), (6, 1)])
def test_the_highest_priority_that_is_allowed_is_allowed(
    priority: int, count: int
) -> None:
    """One more is not; a name of one's own counts before everybody's."""
    policy = Policy(
        "wheels", allow={"*": Access.WRITE}, max_priority={"one": 5, "*": 0}
    )
    found = told("denied", mover("one", priority=priority), policies=[policy])
    assert len(found) == count


@pytest.mark.promise("RS-2")
def test_an_exclusive_actuator_is_for_those_who_never_meet() -> None:
    """The later one is refused if both run at a time; who only reads it is not."""
    policies = [
        Policy("wheels", allow={"*": Access.WRITE | Access.READ}, exclusive=True)
    ]
    reads = {"it": esair.reads(float, name="wheels.applied")}
    reader = esair.Behavior(name="three", reads=reads)
    both = told("denied", mover("one"), reader, mover("two"), policies=policies)
    assert [words.partition(":")[0] for _, words in both] == [
        "'two' may not WRITE 'wheels'"
    ]
    modes = Modes({"a": Mode(["one"], then="b"), "b": Mode(["two"])}, "a")
    apart = told("denied", mover("one"), mover("two"), policies=policies, modes=modes)
    assert apart == []


@pytest.mark.promise("RS-2")
def test_what_is_computed_reads_in_its_own_name() -> None:
    """A policy that does not name it keeps the reading from it."""
    resources = [parts.Sonar(), Free()]
    denied = told(
        "denied", resources=resources, policies=[Policy("sonar", allow=WRITE)]
    )
    assert [words.partition(":")[0] for _, words in denied] == [
        "'free' may not READ 'sonar'"
    ]


# Names.


class Named(esair.Behavior):
    """Its class has its name as a plain attribute."""

    name = "Wander About"  # type: ignore[assignment]


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (esair.Behavior, "you gave the class: write Behavior()"),
        (minimal.Reaction, "you gave the class: write Reaction()"),
        (parts.Sonar(), "expected an esair.Behavior or esair.Reaction"),
        (float, "expected an esair.Behavior or esair.Reaction"),
        (Named(), "expected a lower-case letter, then letters, digits or '_', 63 at most"),
        (esair.Behavior(name="operator"),
         "this is the name in which people act: choose another name="),
    ],
)  # fmt: skip
def test_what_is_no_action_is_told(what: object, words: str) -> None:
    """A class, a resource, whatever has no good name."""
    (error,) = [each for each in examine(Plan(behaviors=[what])) if each.is_error]
    assert error.text == words


@pytest.mark.parametrize(
    ("what", "words"),
    [
        (parts.Sonar, "you gave the class: write Sonar()"),
        (minimal.Sensor, "you gave the class: write Sensor()"),
        (minimal.Actuator, "you gave the class: write Actuator()"),
        (esair.Behavior(name="one"), "expected an esair.Sensor or esair.Actuator"),
    ],
)
def test_what_is_no_resource_is_told(what: object, words: str) -> None:
    """A class, an action."""
    (error,) = examine(Plan(resources=[what]))
    assert error.text == words


def test_each_that_has_the_name_of_another_is_told() -> None:
    """The first one has it; one that is there twice, and one that could not be made."""
    one, two = mover("one"), mover("two")
    behaviors = [one, mover("one"), two, two, mover("eye")]
    found = told("name", *behaviors, missing={"eye": "behavior", "sonar": "sensor"})
    assert [words.partition(":")[0] for _, words in found] == [
        "a resource named 'sonar' is already there",
        "a behavior named 'one' is already there",
        "a behavior named 'two' is already there",
        "a behavior named 'eye' is already there",
    ]


# What comes into a robot that runs.


def test_no_action_takes_its_own_place() -> None:
    """Another one does."""
    one = mover("one")
    plan = Plan(resources=[Motor(name="wheels")], behaviors=[one])
    (error,) = examine_action(plan, one, instead_of=one)
    assert error.text == "it cannot take its own place"
    assert examine_action(plan, mover("one"), instead_of=one) == []
    (error,) = examine_action(plan, mover("one"))
    assert error.rule == "name"


def test_a_resource_may_take_its_own_place() -> None:
    """Its name is its own, and nothing of the plan is changed by the look."""
    sonar = parts.Sonar()
    plan = Plan(resources=[sonar])
    assert examine_resource(plan, sonar, instead_of=sonar) == []
    assert examine_resource(plan, parts.Slow(name="other")) == []
    (error,) = examine_resource(plan, parts.Slow(name="sonar"))
    assert error.rule == "name"
    (error,) = examine_resource(plan, "sonar")
    assert error.rule == "declaration"
    assert (plan.resource_of, list(plan.resource_names)) == (
        {"sonar": sonar},
        ["sonar"],
    )


class Takes(parts.Drive):
    orders = esair.takes(parts.Order)

    async def run(self) -> None: ...


def test_a_step_has_no_requests_and_no_process() -> None:
    """It runs where its performer runs, in the name of that one."""
    plan = Plan(resources=[Motor(name="wheels")], behaviors=[])
    takes, placed = Takes(), parts.Drive()
    placed.placement = "process"
    (error,) = examine_step(plan, takes, performer="one")
    assert (
        error.text == "it takes requests: a step has no name of its own to be asked by"
    )
    (error,) = examine_step(plan, placed, performer="one")
    assert error.text == (
        "a step runs where its performer runs, in no process of its own: give it "
        "placement 'task', or add it to the robot and ask it"
    )
    assert examine_step(plan, parts.Drive(), performer="one") == []


def test_a_step_has_the_rights_of_its_performer() -> None:
    """Not those of its own name."""
    policies = [Policy("wheels", allow={"drive": Access.WRITE})]
    plan = Plan(resources=[Motor(name="wheels")], behaviors=[], policies=policies)
    assert examine_step(plan, parts.Drive(), performer="drive") == []
    (error,) = examine_step(plan, parts.Drive(), performer="one")
    assert error.rule == "denied"


# What is computed of what.


def sum_of(name: str, *sources: str) -> Any:
    class Sum(esair.Derived[float]):
        def compute(self, **readings: float) -> float:
            return sum(readings.values())

    return Sum(
        name=name, reads={f"in_{s}": esair.reads(float, name=s) for s in sources}
    )


def test_what_is_computed_of_itself_is_told() -> None:
    """With the way around; one beside the circle is not in it."""
    circle = [sum_of("a", "sonar", "b"), sum_of("b", "c"), sum_of("c", "a")]
    resources = [parts.Sonar(), *circle, sum_of("d", "a", "sonar")]
    found = [each for each in told("need", resources=resources) if "itself" in each[1]]
    assert found == [
        ("a", "it is computed of itself: a of b of c of a"),
        ("b", "it is computed of itself: b of c of a of b"),
        ("c", "it is computed of itself: c of a of b of c"),
    ]


def test_what_is_computed_of_others_comes_after_them() -> None:
    """So many computations come before each."""
    last = sum_of("last", "sonar", "second")
    resources = [
        last,
        sum_of("second", "first"),
        sum_of("first", "sonar"),
        parts.Sonar(),
    ]
    assert depths(resources) == {"sonar": 0, "first": 1, "second": 2, "last": 3}
