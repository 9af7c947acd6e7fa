"""One rulebook: each mistake once, four ways in, in the same words."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Any

import attrs
import pytest
from tests.plan import rulebook_parts as parts

import esair
from esair import config
from esair.messages import Access, Policy
from esair.plan import Plan, Severity, errors_in, examine

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("RS-8")]

KINDS = {esair.Sensor: "sensor", esair.Actuator: "actuator"}


@attrs.frozen
class Case:
    """A robot with one mistake; the last part is the one that brings it.

    Attributes:
        wrong: The class of the last part.
        words: What is said about it, as it is said.
        component: Who is named.
        field: Which field.
        error: What is raised where no file is.
        sonar: The class of the sensor that is there before.
        others: Classes of behaviors that are there before.
        name: The name of the last part; that of its class unless given.
        policy: The policy of the wheels.
    """

    wrong: type
    words: str
    component: str
    field: str
    error: type[Exception] = esair.ConfigError
    sonar: type = parts.Sonar
    others: tuple[type, ...] = ()
    name: str | None = None
    policy: Policy | None = None

    def __str__(self) -> str:
        return self.wrong.__name__ + ("" if self.policy is None else "-denied")

    @property
    def is_resource(self) -> bool:
        return issubclass(self.wrong, esair.Sensor | esair.Actuator)

    def resources(self) -> list[Any]:
        return [self.sonar(name="sonar"), parts.Wheels(name="wheels")]

    def behaviors(self) -> list[Any]:
        return [each() for each in self.others]

    def last(self) -> Any:
        return self.wrong(name=self.name) if self.name else self.wrong()

    def policies(self) -> list[Policy]:
        return [] if self.policy is None else [self.policy]

    def robot(self) -> esair.Robot:
        """Make the robot as a script does."""
        resources, behaviors = self.resources(), self.behaviors()
        (resources if self.is_resource else behaviors).append(self.last())
        return esair.Robot(
            resources=resources, behaviors=behaviors, policies=self.policies()
        )

    def file(self, folder: Path) -> Path:
        """Write the robot as a file."""
        rows = []
        for cls, name in (
            (self.sonar, "sonar"),
            (parts.Wheels, "wheels"),
            *((each, each.__name__.lower()) for each in self.others),
            (self.wrong, self.name or self.last().name),
        ):
            kind = next((k for b, k in KINDS.items() if issubclass(cls, b)), "behavior")
            rows += [
                f"[{kind}.{name}]",
                f'driver = "tests.plan.rulebook_parts:{cls.__name__}"',
            ]
        if self.policy is not None:
            rows.append("[access.wheels]")
            for who, access in self.policy.allow.items():
                rows.append(f'"{who}" = "{str(access).lower()}"')
            for who, level in self.policy.max_priority.items():
                rows.append(f'max_priority."{who}" = {level}')
            rows.append(f"exclusive = {str(self.policy.exclusive).lower()}")
        path = folder / "robot.toml"
        path.write_text("\n".join(rows) + "\n")
        return path


def _resource(wrong: type, field: str, words: str) -> Case:
    return Case(wrong, words, wrong.__name__.lower(), field)


SECONDS = "expected seconds > 0, not"
EVERYBODY = {"*": Access.WRITE}

CASES = [
    Case(parts.Unsafe, "an actuator must declare its safe command: safe = ...",
         "unsafe", "safe"),
    Case(parts.NoTimeout, f"{SECONDS} 0.0", "no_timeout", "command_timeout"),
    Case(parts.OutsideLimits, "0.0 is outside the limits", "outside_limits", "safe"),
    Case(parts.UpsideDown, "expected (least, greatest), not (1.0, -1.0)",
         "upside_down", "limits"),
    Case(parts.Backwards, "expected a change per second > 0, not -1.0",
         "backwards", "slew"),
    Case(parts.TakesNothing, "expected a method with one parameter, the command: "
         "too many positional arguments", "takes_nothing", "write"),
    Case(parts.WriteYields, "expected a method that does not yield",
         "write_yields", "write"),
    Case(parts.Mute, "an actuator must have a write method", "mute", "write"),
    Case(parts.Deaf, "a sensor must have a read or stream method", "deaf", "read"),
    Case(parts.ReadAsks, "expected a method without parameters: missing a required "
         "argument: 'channel'", "read_asks", "read"),
    Case(parts.ReadYields, "expected a method that returns one value: name it stream",
         "read_yields", "read"),
    Case(parts.StreamAsks, "expected a method without parameters: missing a required "
         "argument: 'channel'", "stream_asks", "stream"),
    Case(parts.StreamReturns, "expected a method that yields its values",
         "stream_returns", "stream"),
    Case(parts.OpenAsks, "expected a method without parameters: missing a required "
         "argument: 'path'", "open_asks", "open"),
    Case(parts.ApplyAsks, "expected a method that takes its settings by name: missing "
         "a required argument: 'gain'", "apply_asks", "apply"),
    Case(parts.Unbound, "its least or greatest value is not a number",
         "unbound", "gain"),
    Case(parts.NoneFits, "its default is not allowed: expected one of 'slow', 'slower', "
         "not 'fast'", "none_fits", "mode"),
    Case(parts.Hasty, f"{SECONDS} 0.0", "hasty", "deadline"),
    Case(parts.Nobody, "its class has no identify to compare it with",
         "nobody", "identity"),
    Case(parts.Repeats, "expected a whole number > 0, not 0", "repeats", "max_repeat"),
    Case(parts.NeverFaulty, "expected a whole number > 0, not 0",
         "never_faulty", "fault_limit"),
    Case(parts.WithoutPast, "expected a whole number > 0, not 0",
         "without_past", "history_size"),
    Case(parts.LessThanNothing, "expected bytes >= 0, not -1",
         "less_than_nothing", "traffic"),
    Case(parts.Promised, "expected seconds > 0 or None, not 'soon'",
         "promised", "period"),
    Case(parts.Inverted, "expected (least, greatest), not (3.0, 1.0)",
         "inverted", "limits"),
    Case(parts.NoSuchField, "float has no such field", "no_such_field", "limits.left"),
    Case(parts.PairForOne, "expected a pair for each field of Twist, not (0.0, 1.0)",
         "pair_for_one", "limits"),
    Case(parts.SaysAWord, "it is no reading of this sensor: expected float, it gave "
         "'far'", "says_a_word", "initial"),
    Case(parts.SaysTooMuch, "it is no reading of this sensor: expected 0 to 1, it gave "
         "9.0", "says_too_much", "initial"),
    Case(parts.Clamps, "expected True or False, not 'yes'", "clamps", "clamp"),
    Case(parts.PairForArray, "expected a pair for each field of array([0., 0.]), not "
         "(-1.0, 1.0)", "pair_for_array", "limits"),
    Case(parts.PairForAll, "expected a pair for each field of {'left': 0.0}, not "
         "(-1.0, 1.0)", "pair_for_all", "limits"),
    Case(parts.OnAWord, "expected a bus such as esair.buses.SerialBus, not 'front'",
         "on_a_word", "bus"),
    Case(parts.Sonar, "a resource named 'sonar' is already there: choose another name=, "
         "or use replace('sonar', ...)", "", "", esair.NameTakenError),
    Case(parts.BadName, "expected a lower-case letter, then letters, digits or '_', "
         "63 at most", "bad_name", "sonar"),
    Case(parts.BadType, "expected a type such as float, not 'sonar' (a name is given by "
         "name=)", "bad_type", "sonar"),
    Case(parts.BadNumber, "expected a lower-case letter, then letters, digits or '_', "
         "63 at most", "bad_number", "sonar"),
    Case(parts.BadFlag, "expected True or False, not 'no'",
         "bad_flag", "sonar.optional"),
    Case(parts.GuardsItself, "only a reaction guards: make one of it",
         "guards_itself", "wheels"),
    Case(parts.BadEvery, "only a reaction runs on every reading; here the newest wins",
         "bad_every", "sonar.every"),
    Case(parts.BadTaker, "only a behavior takes requests", "bad_taker", "orders"),
    Case(parts.AnswersAsSensor, "only a behavior takes requests", "answers_as_sensor",
         "order"),
    Case(parts.HasPort, "only a behavior, a reaction or a derived sensor (esair.Derived) "
         "has ports", "has_port", "other"),
    Case(parts.HasSetting, "only a sensor or an actuator has settings: an attribute of an "
         "action is plain: speed: float = 0.3", "has_setting", "speed"),
    Case(parts.HasOperation, "only a sensor or an actuator has operations: a behavior "
         "answers requests: esair.answers", "has_operation", "home"),
    Case(parts.NoMethod, "an operation must be a method, with or without async",
         "no_method", "tare"),
    Case(parts.StaticAbove, "an operation must be a method, with or without async",
         "static_above", "tare"),
    Case(parts.NoSelf, "expected a method without parameters: it does not take self",
         "no_self", "read"),
    Case(parts.Hides, "run hides the port by self.wheels = ...: to send a command use "
         "its write(...), to keep a value choose another name", "hides", "wheels"),
    Case(parts.ReactHides, "react hides the port by self.wheels = ...: to send a command "
         "return it, to keep a value choose another name", "react_hides", "wheels"),
    Case(parts.NoReaction, "it never runs: derive from esair.Reaction, or write run",
         "no_reaction", "react"),
    Case(parts.OnlyAnnotated, "an annotation declares nothing: write = instead of :",
         "only_annotated", "speed"),
    Case(parts.NotCalled, "expected esair.writes(...), not the function",
         "not_called", "wheels"),
    Case(parts.AsyncThread, "expected a plain function, not async: it runs in a thread",
         "async_thread", "run"),
    Case(parts.BadAnswers, "expected a method that returns its answer, not one that "
         "yields", "bad_answers", "order"),
    Case(parts.BadAge, f"{SECONDS} 0.0", "bad_age", "sonar.max_age"),
    Case(parts.BadHold, f"{SECONDS} -1.0", "bad_hold", "wheels.hold"),
    Case(parts.BadPriority, "expected a whole number, not 1.5",
         "bad_priority", "wheels.priority"),
    Case(parts.BadRate, "expected Hz > 0, at most 100000, not -1.0", "bad_rate", "rate"),
    Case(parts.BadBudget, f"{SECONDS} 0.0", "bad_budget", "budget"),
    Case(parts.BadLimit, "expected a whole number, not -1",
         "bad_limit", "overrun_limit"),
    Case(parts.BadRestart, "expected an esair.Restart", "bad_restart", "restart"),
    Case(parts.BadInbox, "expected a whole number > 0, not 0",
         "bad_inbox", "inbox_size"),
    Case(parts.BadOutbox, "expected 'reject', 'drop_oldest' or 'latest', not 'perhaps'",
         "bad_outbox", "outbox_policy"),
    Case(parts.NeverRuns, "it reads no sensor, so it needs a rate (Hz) to run at",
         "never_runs", "rate"),
    Case(parts.InInit, "a port is an attribute of the class: write it there, not in "
         "__init__, or give it to super().__init__(reads={...}, writes={...})",
         "in_init", "sonar"),
    Case(parts.Twice, "it writes 'wheels' by 'wheels' already: one port is enough, "
         "unless their priorities differ", "twice", "other"),
    Case(parts.NoReact, "a reaction must have a react method", "no_react", "react"),
    Case(parts.AsyncReact, "expected a plain function, not async",
         "async_react", "react"),
    Case(parts.ReactYields, "expected a plain function that does not yield",
         "react_yields", "react"),
    Case(parts.ReactMisses, "its parameters must be its readings (sonar): missing a "
         "required argument: 'sonra'", "react_misses", "react"),
    Case(parts.ReactMistyped, "its parameter 'sonar' is a str, but the port 'sonar' "
         "reads float: annotate it as float", "react_mistyped", "react"),
    Case(parts.ReactReadingMistyped, "but the port 'sonar' reads float",
         "react_reading_mistyped", "react"),
    Case(parts.ReactMaybeMistyped, "its parameter 'sonar' is a bytes | None",
         "react_maybe_mistyped", "react"),
    Case(parts.RunAsks, "expected a method without parameters: missing a required "
         "argument: 'speed'", "run_asks", "run"),
    Case(parts.RunYields, "expected a method that does not yield", "run_yields", "run"),
    Case(parts.Unknown_, "no resource is named 'sonra'; did you mean 'sonar'?",
         "", "", esair.UnknownNameError),
    Case(parts.ReadsWheels, "it reads 'wheels', which is an actuator",
         "reads_wheels", "sonar"),
    Case(parts.WritesSonar, "it writes 'sonar', which is a sensor",
         "writes_sonar", "wheels"),
    Case(parts.WritesText, "it writes str, but 'wheels' takes float",
         "writes_text", "wheels"),
    Case(parts.TooYoung, "its readings of 'sonar' may be 0.1 s old at most, but come "
         "every 1 s only: raise the rate or max_age",
         "too_young", "sonar.max_age", sonar=parts.Slow),
    Case(parts.Drive, "'drive' may not WRITE 'wheels': the policy of 'wheels' allows it "
         "nothing: allow 'drive' WRITE there", "", "", esair.AccessDeniedError,
         policy=Policy("wheels", allow={"later": Access.WRITE})),
    Case(parts.Brake, "'brake' may not WRITE with priority 10 'wheels': the policy of "
         "'wheels' allows it priority 5 at most", "", "", esair.AccessDeniedError,
         policy=Policy("wheels", allow=EVERYBODY, max_priority={"*": 5})),
    Case(parts.Brake, "'brake' may not WRITE 'wheels': the policy of 'wheels' is "
         "exclusive, and 'drive' writes it", "", "", esair.AccessDeniedError,
         others=(parts.Drive,),
         policy=Policy("wheels", allow=EVERYBODY, exclusive=True)),
]  # fmt: skip

UNIQUE = [case for case in CASES if case.error is not esair.NameTakenError]
"""Two tables of one name are no TOML, and a replacement has the name that it takes."""


def _told(case: Case, errors: Any) -> None:
    """See that one error says it, in the words of the case."""
    (error,) = errors
    assert type(error) is case.error
    assert case.words in str(error)
    if isinstance(error, esair.ConfigError):
        assert (error.component, error.field) == (case.component, case.field)


@pytest.mark.parametrize("case", CASES, ids=str)
async def test_a_script_with_a_mistake_does_not_start(case: Case) -> None:
    """Nothing is opened, and the mistake is in one group with all others."""
    with pytest.raises(ExceptionGroup, match="cannot start") as caught:
        await case.robot().__aenter__()

    _told(case, caught.value.exceptions)


@pytest.mark.parametrize("case", CASES, ids=str)
async def test_add_refuses_the_same_in_the_same_words(case: Case) -> None:
    """The one error itself; the robot goes on, and no component has crashed."""
    async with esair.Robot(
        resources=case.resources(), behaviors=case.behaviors(), policies=case.policies()
    ) as robot:
        names = robot.resources.names(), robot.behaviors.names()
        add = robot.resources.add if case.is_resource else robot.behaviors.add
        with pytest.raises(case.error) as caught:
            await add(case.last())
        assert (robot.resources.names(), robot.behaviors.names()) == names

    _told(case, [caught.value])


@pytest.mark.parametrize("case", UNIQUE, ids=str)
def test_a_file_is_refused_in_the_same_words(case: Case, tmp_path: Path) -> None:
    """It adds the file, the line and the key, and nothing else."""
    path = case.file(tmp_path)
    with pytest.raises(ExceptionGroup) as caught:
        esair.Robot.from_config(path)

    (error,) = caught.value.exceptions
    assert isinstance(error, config.ConfigFileError)
    assert case.words in error.reason
    assert str(error) == f"{path}:{error.line}: {error.key}: {error.reason}"
    assert error.line is not None


@pytest.mark.parametrize("case", UNIQUE, ids=str)
def test_check_finds_the_same_in_the_same_words(case: Case, tmp_path: Path) -> None:
    """The only error of the report, at the key that a load names."""
    report = config.check(case.file(tmp_path))

    (error,) = [each for each in report.findings if each.severity == "error"]
    assert case.words in error.message


@pytest.mark.parametrize("case", UNIQUE, ids=str)
async def test_replace_refuses_the_same(case: Case) -> None:
    """What was there stays, and goes on."""
    there = parts.Sonar(name="old") if case.is_resource else esair.Behavior(name="old")
    resources, behaviors = case.resources(), case.behaviors()
    (resources if case.is_resource else behaviors).append(there)
    policy = case.policies()
    if policy and "drive" in case.words.split()[0]:
        policy = [Policy("wheels", allow={"later": Access.WRITE})]
    async with esair.Robot(
        resources=resources, behaviors=behaviors, policies=policy
    ) as robot:
        supervisor = robot.resources if case.is_resource else robot.behaviors
        with pytest.raises(case.error):
            await supervisor.replace("old", case.last())
        assert "old" in supervisor.names()


@pytest.mark.parametrize(
    "sound",
    [
        *(parts.Annotated, parts.Unresolved, parts.AnswersReact, parts.ReadsReact),
        parts.TakesOne,
    ],
)
def test_what_fits_is_no_mistake(sound: type) -> None:
    """A reading, a value or nothing, what only a type checker can see, any name."""
    plan = Plan(resources=[parts.Sonar(), parts.Wheels()], behaviors=[sound()])

    assert errors_in(examine(plan)) == []


@pytest.mark.promise("PRO-4")
def test_a_sensor_that_may_be_silent_is_a_warning() -> None:
    """Who needs it cannot decide before it speaks."""
    plan = Plan(resources=[parts.Bumper(), parts.Wheels()], behaviors=[parts.Bumped()])

    (finding,) = examine(plan)
    assert finding.severity is Severity.WARNING
    assert finding.text == (
        "it is blind until 'bumper' first speaks: give Bumper a read, an initial value, "
        "or a period (its greatest silence)"
    )


@pytest.mark.promise("PRO-4", "SC-3")
@pytest.mark.parametrize("says", ["initial", "period"])
def test_a_sensor_that_says_how_it_begins_is_fine(says: str) -> None:
    """Its value at each opening, and for how long that is current; or how soon it speaks."""

    class Cautious(parts.Bumped):
        bumper = esair.reads(bool, max_age=0.5)

    bumper = parts.Bumper()
    setattr(bumper, says, 0.5 if says == "period" else False)
    bumped = parts.Bumped() if says == "period" else Cautious()
    plan = Plan(resources=[bumper, parts.Wheels()], behaviors=[bumped])

    assert examine(plan) == []


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize("reader", ["optional", "initial", "behavior", "computed"])
def test_a_sensor_whose_reading_lasts_for_ever_is_a_warning(reader: str) -> None:
    """Whoever reads it takes what it said last for what is."""

    class Optional(esair.Reaction):
        bumper = esair.reads(bool, optional=True)
        wheels = esair.writes(float)

        def react(self, bumper: bool | None) -> float | None:
            return None

    class Waiting(esair.Behavior):
        bumper = esair.reads(bool)
        wheels = esair.writes(float)

    class Free(esair.Derived[bool]):
        bumper = esair.reads(bool)

        def compute(self, bumper: bool) -> bool:
            return not bumper

    class Follows(esair.Behavior):
        free = esair.reads(bool, max_age=1.0)
        wheels = esair.writes(float)

    bumper = parts.Bumper()
    resources: list[Any] = [bumper, parts.Wheels()]
    action: Any = {"optional": Optional, "behavior": Waiting, "computed": Follows}.get(
        reader, parts.Bumped
    )()
    if reader == "initial":
        bumper.initial = False
    if reader == "computed":
        resources.append(Free())
    who = "free" if reader == "computed" else action.name
    findings = examine(Plan(resources=resources, behaviors=[action]))
    told = [f.text for f in findings if f.component == "bumper"]
    assert told == [
        f"however long it is silent, its last reading is current for {who}: give it a "
        "period (its greatest silence), or each of them a max_age"
    ]


async def test_two_nodes_of_one_name_on_a_bus_are_told_once() -> None:
    """Who claims what another one has is named, with the other one."""
    bus = esair.testing.FakeCan("drive")
    first, second = parts.Node(name="left", bus=bus), parts.Node(name="right", bus=bus)

    (error,) = errors_in(examine(Plan(resources=[first, second])))
    assert str(error) == "right: node 1 belongs to 'left': they cannot share it"


def test_several_mistakes_come_in_one_group() -> None:
    """`examine` does not stop at the first one."""
    plan = Plan(
        resources=[parts.Deaf(), parts.Unsafe(), "lamp"],
        behaviors=[parts.BadRate(), parts.RunAsks(), None],
        policies=[Policy("whels"), 3],
    )

    assert len(errors_in(examine(plan))) == 8


class Idle(esair.Behavior):
    async def rum(self) -> None:
        """Its name is mistyped."""


class IdleThread(esair.ThreadBehavior):
    def rum(self) -> None:
        """The same."""


class Answers(esair.Behavior):
    @esair.answers
    async def ordered(self, request: parts.Order) -> int:
        return 1


@pytest.mark.parametrize(
    ("behavior", "count"),
    [(Idle(), 1), (IdleThread(), 1), (Answers(), 0), (esair.Behavior(name="user"), 0)],
)
def test_what_does_nothing_is_told(behavior: esair.Behavior, count: int) -> None:
    """A class of its own is there to do something."""
    findings = examine(Plan(resources=[], behaviors=[behavior]))
    assert [each.field for each in findings] == ["run"] * count


@pytest.mark.parametrize(
    ("resource", "access", "told"),
    [
        ("sonar", Access.READ, ""),
        ("sonar", Access.CONFIGURE, "read"),
        ("wheels", Access.WRITE, ""),
        ("wheels", Access.READ, "write"),
        ("arm", Access.WRITE, ""),
        ("arm", Access.READ, "write"),
        ("eye", Access.READ, ""),
        ("eye", Access.CONFIGURE, "read"),
    ],
)
def test_a_policy_that_lets_nobody_use_it_is_told(
    resource: str, access: Access, told: str
) -> None:
    """To read a sensor, to write an actuator; also of one that could not be made."""
    plan = Plan(
        resources=[parts.Sonar(), parts.Wheels()],
        behaviors=[parts.Drive()],
        policies=[Policy(resource, allow={"*": access})],
        missing={"arm": "actuator", "eye": "sensor"},
    )
    (words,) = [each.text for each in examine(plan) if each.rule == "rights"] or [""]
    assert words == (
        told and f"nobody here may {told} it: no behavior of the robot is allowed to"
    )


class Sees(esair.Reaction):
    sonar = esair.reads(float)
    wheels = esair.guards(float)

    def react(self, sonar: float, wheels: float) -> float:
        return wheels


class Given(esair.Behavior):
    def __init__(self, what: object) -> None:
        super().__init__()
        self.what = what


@pytest.mark.parametrize(
    ("behavior", "told"),
    [
        (Sees(), "a guard stays in the robot's process: commands cannot wait for "
         "another: place what it reads as a sensor, or write it as a reaction"),
        (Given(print), "[0] cannot be sent to a process"),
        (Given([1.0]), ""),
    ],
)  # fmt: skip
def test_what_cannot_live_in_a_process_is_told(
    behavior: esair.Behavior | esair.Reaction, told: str
) -> None:
    """A guard, and what is made of something that is no plain data."""
    behavior.placement = "process"
    plan = Plan(resources=[parts.Sonar(), parts.Wheels()], behaviors=[behavior])
    words = [str(each) for each in errors_in(examine(plan))]
    assert len(words) == bool(told)
    assert all(told in each for each in words)


class Gear(enum.Enum):
    LOW = 1
    HIGH = 2


@attrs.frozen
class Shift:
    gear: Gear
    speed: float


def test_what_a_field_is_shows_where_safe_is_to_stay_too() -> None:
    """Its class says so: there is no safe command that could."""

    class Box(esair.Actuator[Shift]):
        safe = esair.HOLD
        slew = {"gear": 1.0, "speed": 0.5}  # noqa: RUF012 - not changed

        async def write(self, command: Shift) -> None: ...

    told = [str(each) for each in errors_in(examine(Plan(resources=[Box()])))]
    assert told == [
        "box: slew.gear: Gear has no steps between its members: leave it out"
    ]
