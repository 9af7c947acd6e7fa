"""What a command must be before it may leave."""

from __future__ import annotations

import asyncio
import collections
import copy
import dataclasses
import decimal
import enum
import fractions
import math
import numbers
import re
from typing import Any, NamedTuple

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import esair
from esair.connections._values import CommandCheck
from esair.messages import Refused
from esair.plan import Finding, examine_resource
from esair.plan import Plan as RobotPlan
from esair.testing import FakeActuator


def check_declaration(actuator: esair.Actuator[Any]) -> list[Finding]:
    """Return what the rulebook says about an actuator."""
    return examine_resource(RobotPlan(), actuator)


NOT_FINITE = [math.nan, math.inf, -math.inf]


@attrs.frozen
class Twist:
    linear: float
    angular: float


@attrs.frozen
class Aliased:
    linear: float = attrs.field(alias="forward")


@attrs.frozen
class Speed:
    speed: float


@attrs.frozen
class Plan:
    speed: float
    path: Any


@attrs.frozen
class Faster(Twist):
    boost: float = 0.0


@dataclasses.dataclass
class Pose:
    x: float
    inner: Any = None


class Pair(NamedTuple):
    left: float
    right: float


class Plain:
    def __init__(self, x: Any) -> None:
        self.x = x


class Slotted:
    __slots__ = ("__hidden", "unset", "x")

    def __init__(self, x: Any) -> None:
        self.x = 0.0
        self.__hidden = x


class Array:
    """What numpy's arrays look like."""

    __array__ = None

    def __init__(self, *values: float) -> None:
        self._values = values

    def ravel(self) -> Array:
        return self

    def tolist(self) -> list[float]:
        return list(self._values)


def check(safe: Any, **options: Any) -> CommandCheck:
    return CommandCheck(FakeActuator("wheels", safe=safe, **options))


WRAPS = [
    lambda x: [x],
    lambda x: (0.0, x),
    lambda x: {"left": x},
    lambda x: {x: "left"},
    lambda x: frozenset({x}),
    lambda x: collections.deque([x]),
    lambda x: Plan(0.0, [x]),
    lambda x: Pose(0.0, x),
    lambda x: Pair(x, 0.0),
    lambda x: Plain(x),
    lambda x: Slotted(x),
    lambda x: Array(0.0, x),
    lambda x: enum.Enum("Gear", {"HIGH": x}).HIGH,
]
"""Ways to hide a number in a command."""


@pytest.mark.promise("AC-1")
@pytest.mark.fault("V01")
@given(
    number=st.sampled_from([*NOT_FINITE, complex(0, math.nan), decimal.Decimal("NaN")]),
    wraps=st.lists(st.sampled_from(WRAPS[:1] + WRAPS[1:3] + WRAPS[5:12]), max_size=5),
)
def test_a_number_that_is_not_finite_never_passes_however_deep(
    number: Any, wraps: list[Any]
) -> None:
    """NaN and infinity are found in every nesting of every kind of structure."""
    command = number
    for wrap in wraps:
        command = wrap(command)

    with pytest.raises(esair.BadValueError, match="wheels"):
        check(object(), limits=None).checked(command)


@pytest.mark.fault("V01")
@pytest.mark.parametrize("wrap", WRAPS)
def test_each_kind_of_structure_is_looked_into(wrap: Any) -> None:
    """A structure with NaN is refused, the same structure with 1.0 is not."""
    wanted = check(object())

    wanted.checked(wrap(1.0))
    with pytest.raises(esair.BadValueError):
        wanted.checked(wrap(math.nan))


@pytest.mark.fault("V01")
def test_nan_beside_the_number_fields_is_found() -> None:
    """A field that is no number in the safe command is looked into all the same."""
    wanted = check(Plan(0.0, None))

    assert wanted.checked(Plan(1.0, [2.0])) == Plan(1.0, [2.0])
    with pytest.raises(esair.BadValueError, match=r"path\.0"):
        wanted.checked(Plan(1.0, [math.nan]))


@pytest.mark.fault("V01")
def test_nan_in_a_field_of_a_subclass_is_found() -> None:
    """A command of a subclass may have more fields than the safe command."""
    wanted = check(Twist(0.0, 0.0))

    assert wanted.checked(Faster(0.0, 0.0, 1.0)) == Faster(0.0, 0.0, 1.0)
    with pytest.raises(esair.BadValueError, match="boost"):
        wanted.checked(Faster(0.0, 0.0, math.nan))


@pytest.mark.fault("V01")
def test_infinite_decimals_are_refused() -> None:
    """A number whose arithmetic raises cannot be checked, so it may not leave."""
    with pytest.raises(esair.BadValueError, match="cannot be checked"):
        check(decimal.Decimal(0)).checked(decimal.Decimal("Infinity"))


@pytest.mark.fault("V04")
def test_a_structure_that_holds_itself_is_refused() -> None:
    """A command that never ends is refused instead of looked at for ever."""
    endless: list[Any] = []
    endless.append(endless)

    with pytest.raises(esair.BadValueError, match="nested too deeply"):
        check([0.0]).checked(endless)


@pytest.mark.fault("V04")
@pytest.mark.parametrize("command", ["fast", None, b"1", [1.0], True, Twist(0, 0)])
def test_a_command_of_another_type_is_refused(command: object) -> None:
    """A float is wanted, and only numbers are floats."""
    with pytest.raises(esair.BadValueError, match="expected float"):
        check(0.0).checked(command)


@attrs.frozen
class Place:
    x: Any
    y: Any


@attrs.frozen
class Goal:
    at: Any
    yaw: Any
    frame: Any = "map"


@pytest.mark.promise("AC-1")
@pytest.mark.fault("V04")
@pytest.mark.parametrize(
    ("command", "told"),
    [
        (Goal(Place(None, 0.0), 0.0), "at.x: expected a number, not None"),
        (Goal(Place("1", 0.0), 0.0), "at.x: expected a number, not '1'"),
        (Goal(None, 0.0), "at: expected Place, not None"),
        (Goal(1.5, 0.0), "at: expected Place, not 1.5"),
        (Goal(Place(0.0, 0.0), None), "yaw: expected a number, not None"),
    ],
)
def test_a_part_of_another_type_is_refused(command: Goal, told: str) -> None:
    """Where the safe command has numbers, however deep, a command has them too."""
    checked = check(Goal(Place(0.0, 0.0), 0.0)).checked
    with pytest.raises(esair.BadValueError, match=re.escape(told)):
        checked(command)
    good = Goal(Place(1, 2.5), 0.5, frame=None)
    assert checked(good) == good


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize("wrong", [None, "1", [1.0]])
def test_a_dictionary_of_numbers_has_numbers(wrong: object) -> None:
    """Its type says so: one without a type may have what its driver takes."""

    class Arms(FakeActuator[dict[str, float]]):
        pass

    typed = CommandCheck(Arms("arms", safe={"left": 0.0}))
    assert typed.checked({"left": 1.0}) == {"left": 1.0}
    with pytest.raises(esair.BadValueError, match="left: expected a number"):
        typed.checked({"left": wrong})
    untyped = check({"left": 0.0})
    assert untyped.checked({"left": wrong}) == {"left": wrong}


@pytest.mark.promise("AC-1")
def test_a_whole_number_serves_as_a_float() -> None:
    """People write 1 and mean 1.0."""
    command = check(0.0).checked(1)

    assert type(command) is float
    assert command == 1.0


def test_true_is_no_whole_number() -> None:
    """A bool is not accepted where an int is wanted."""
    with pytest.raises(esair.BadValueError, match="expected int"):
        check(0).checked(True)


@pytest.mark.promise("AC-1")
@pytest.mark.fault("V04")
@pytest.mark.parametrize("safe", [Pair(0.0, 0.0), (0.0, 0.0), ("off", 0.0)])
@pytest.mark.parametrize("value", ["1", None, [1.0], np.asarray(1.0)])
def test_a_place_of_a_tuple_that_must_be_a_number_is_one(safe: Any, value: Any) -> None:
    """Commands for boards are tuples: they are checked as other structures are."""
    command = (*safe[:1], value) if type(safe) is tuple else Pair(0.0, value)

    with pytest.raises(esair.BadValueError, match="1: expected a number"):
        check(safe).checked(command)
    assert check(safe).checked(safe) == safe


class Wheels(esair.Actuator[Any]):
    safe = (0.0, 0.0)
    value_type: Any = None

    def __init__(self, kind: Any) -> None:
        super().__init__()
        self.value_type = kind


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize("command", [(1.0,), (1.0, 2.0, 3.0), ()])
def test_a_tuple_has_as_many_values_as_its_type_says(
    command: tuple[float, ...],
) -> None:
    """One that may have any number of them says so: ``tuple[float, ...]``, ``tuple``."""
    with pytest.raises(esair.BadValueError, match="expected 2 values"):
        CommandCheck(Wheels(tuple[float, float])).checked(command)
    for kind in (tuple[float, ...], tuple):
        assert CommandCheck(Wheels(kind)).checked(command) == command


@pytest.mark.fault("V04")
@pytest.mark.parametrize("value", ["1", None, [1.0], Plain(1.0), np.asarray(1.0)])
def test_a_field_that_must_be_a_number_is_one(value: object) -> None:
    """The field is named when it holds something else."""
    with pytest.raises(esair.BadValueError, match="linear: expected a number"):
        check(Twist(0.0, 0.0)).checked(Twist(value, 0.0))  # type: ignore[arg-type]


@pytest.mark.fault("V05")
@pytest.mark.parametrize("command", [10**400, -(10**400)])
def test_a_number_too_large_for_a_float_is_refused(command: int) -> None:
    """A huge integer is a bad value, not an OverflowError on its way to the wire."""
    with pytest.raises(esair.BadValueError, match="cannot be checked"):
        check(0.0).checked(command)
    with pytest.raises(esair.BadValueError):
        check(0.0, limits=(-1.0, 1.0)).checked(command)


@pytest.mark.fault("V05")
def test_a_huge_field_passes_only_where_no_limit_forbids_it() -> None:
    """An integer has no NaN; a limit is what bounds it."""
    huge = Twist(10**400, 0.0)

    assert check(Twist(0.0, 0.0)).checked(huge) == huge
    with pytest.raises(esair.BadValueError):
        check(Twist(0.0, 0.0), limits={"linear": (-1.0, 1.0)}).checked(huge)


@pytest.mark.promise("AC-1")
@pytest.mark.fault("V02")
@given(st.floats(allow_nan=True, allow_infinity=True))
def test_outside_the_limits_is_refused_by_default(value: float) -> None:
    """What passes is the command itself, and within the limits."""
    wanted = check(0.0, limits=(-1.0, 2.0))

    if -1.0 <= value <= 2.0:
        assert wanted.checked(value) == value
    else:
        with pytest.raises(esair.BadValueError):
            wanted.checked(value)


@pytest.mark.promise("AC-1")
def test_what_is_hardly_outside_is_told_as_it_is() -> None:
    """A sum of floats: "expected -0.3 to 0.3, not 0.3" would help nobody."""
    wanted = check(0.0, limits=(-0.3, 0.3))

    with pytest.raises(esair.BadValueError, match=r"to 0\.3, not 0\.30000000000000004"):
        wanted.checked(0.1 + 0.2)


@pytest.mark.fault("V02")
@given(st.floats(allow_nan=True, allow_infinity=True))
def test_a_clamp_is_safe_for_nan(value: float) -> None:
    """A declared clamp moves finite values only; NaN does not become full speed."""
    wanted = check(0.0, limits=(-1.0, 2.0), clamp=True)

    if math.isfinite(value):
        assert wanted.checked(value) == min(2.0, max(-1.0, value))
    else:
        with pytest.raises(esair.BadValueError, match="finite"):
            wanted.checked(value)


@pytest.mark.fault("V02")
@pytest.mark.parametrize(
    ("safe", "fast", "slow"),
    [
        (Twist(0.0, 0.0), Twist(9.0, 0.5), Twist(1.0, 0.5)),
        ({"linear": 0.0}, {"linear": 9.0}, {"linear": 1.0}),
        (Pose(0.0), None, None),
    ],
)
def test_fields_are_clamped_by_name(safe: Any, fast: Any, slow: Any) -> None:
    """Limits by field work for attrs classes, dataclasses and mappings."""
    if fast is None:
        wanted = check(safe, limits={"x": (-1.0, 1.0)}, clamp=True)
        assert wanted.checked(Pose(9.0)) == Pose(1.0)
    else:
        wanted = check(safe, limits={"linear": (-1.0, 1.0)}, clamp=True)
        assert wanted.checked(fast) == slow


@pytest.mark.fault("V02")
def test_a_field_that_attrs_calls_otherwise_is_clamped() -> None:
    """By the name that it has in a command, whatever its constructor calls it."""
    wanted = check(Aliased(0.0), limits={"linear": (-1.0, 1.0)}, clamp=True)

    assert wanted.checked(Aliased(3.0)) == Aliased(1.0)


def test_named_tuples_and_plain_objects_are_clamped_too() -> None:
    """The original is left as it is; a changed copy is sent."""
    pair = check(Pair(0.0, 0.0), limits={"left": (-1.0, 1.0)}, clamp=True)
    assert pair.checked(Pair(3.0, 0.0)) == Pair(1.0, 0.0)

    plain = check(Plain(0.0), limits={"x": (-1.0, 1.0)}, clamp=True)
    given_ = Plain(3.0)
    assert plain.checked(given_).x == 1.0
    assert given_.x == 3.0


@pytest.mark.fault("V04")
def test_a_missing_field_is_a_bad_value() -> None:
    """A command without the limited field is refused, not a KeyError in a reaction."""
    with pytest.raises(esair.BadValueError, match="KeyError"):
        check({"linear": 0.0}, limits={"linear": (-1.0, 1.0)}).checked({})


@attrs.frozen
class Pwm:
    duty: int


@pytest.mark.fault("V03")
@pytest.mark.promise("PRO-6")
@given(
    targets=st.lists(st.integers(-40, 40), min_size=1, max_size=4),
    slew=st.floats(0.7, 90.0),
    seconds=st.floats(0.003, 0.15),
    of=st.sampled_from([lambda number: number, Pwm]),
)
def test_whole_numbers_change_no_faster_and_get_there(
    targets: list[int], slew: float, seconds: float, of: Any
) -> None:
    """They stay whole, keep the pace in both directions, and reach what was asked for."""
    its = check(of(0), slew=slew if of is not Pwm else {"duty": slew})
    told, passed = of(0), 0.0
    for target in targets:
        begun, first = passed, getattr(told, "duty", told)
        steps = math.ceil(abs(target - first) / (slew * seconds) * 1.01) + 2
        for _ in range(steps):
            passed += seconds
            told = its.slewed(of(target), told, seconds)
            number = getattr(told, "duty", told)
            assert type(number) is int
            assert min(first, target) <= number <= max(first, target)
            assert abs(number - first) <= slew * (passed - begun) + 1.0
        assert number == target


@pytest.mark.fault("V03")
@given(
    value=st.floats(-10, 10),
    before=st.floats(-10, 10),
    slew=st.floats(0.01, 5),
    seconds=st.floats(-1, 2),
)
def test_a_command_changes_no_faster_than_its_slew(
    value: float, before: float, slew: float, seconds: float
) -> None:
    """The step is bounded, and never beyond what was asked for."""
    slewed = check(0.0, slew=slew).slewed(value, before, seconds)

    assert abs(slewed - before) <= slew * max(seconds, 0.0) + 1e-9
    assert min(before, value) - 1e-9 <= slewed <= max(before, value) + 1e-9


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"command_timeout": 0}, "command_timeout"),
        ({"command_timeout": math.nan}, "command_timeout"),
        ({"command_timeout": True}, "command_timeout"),
        ({"safe": ...}, "safe"),
        ({"safe": math.nan}, "safe"),
        ({"safe": 5.0, "limits": (0.0, 1.0)}, "safe"),
        ({"limits": 1.0}, "limits"),
        ({"limits": {"speed": (0.0, 1.0)}}, "limits.speed"),
        ({"limits": ("low", "high")}, "limits"),
        ({"limits": (1.0, -1.0)}, "limits"),
        ({"slew": {"speed": 1.0}}, "slew"),
        ({"slew": "fast"}, "slew"),
    ],
)
@pytest.mark.fault("G08")
def test_mistakes_of_a_declaration_are_named(
    options: dict[str, Any], field: str
) -> None:
    """An actuator with a declaration that cannot hold is refused, by field."""
    options = {"safe": 0.0, **options}
    if options["safe"] is ...:
        del options["safe"]

    mistakes = check_declaration(FakeActuator("wheels", **options))

    assert [mistake.field for mistake in mistakes] == [field]


@pytest.mark.parametrize("seconds", [0, -1.0, math.nan, "soon"])
def test_a_time_out_of_its_own_is_a_time(seconds: Any) -> None:
    """What a device is said to do by itself can be done."""
    wheels = FakeActuator("wheels", safe=0.0)
    wheels.own_timeout = seconds

    assert [mistake.field for mistake in check_declaration(wheels)] == ["own_timeout"]


@pytest.mark.promise("AC-1")
def test_a_command_without_a_field_that_slews_is_refused() -> None:
    """There is nothing to move from, or to."""
    wheels = check({"speed": 0.0}, slew={"speed": 1.0})

    with pytest.raises(esair.BadValueError, match=r"wheels: speed: .* each command"):
        wheels.slewed({"other": 1.0}, {"speed": 0.0}, 0.1)


@numbers.Integral.register
class Int64:
    """What numpy's whole numbers look like."""

    def __int__(self) -> int:
        return 3

    def __float__(self) -> float:
        return 3.0


class Smallest(int):
    """Is less than each limit, if one asks it."""

    __le__ = __ge__ = lambda *_: True


@pytest.mark.promise("AC-1")
@pytest.mark.parametrize(
    ("safe", "command", "sent"),
    [
        (0.0, Int64(), 3.0),
        (0.0, fractions.Fraction(1, 2), 0.5),
        (0, Int64(), 3),
        (0, Smallest(5), 5),
    ],
)
def test_any_number_of_the_kind_is_sent_as_what_is_wanted(
    safe: float, command: Any, sent: float
) -> None:
    """The driver gets a plain int or float, whatever class the number had.

    So it cannot compare with the limits as it likes.
    """
    checked = CommandCheck(FakeActuator("arm", safe=safe)).checked(command)

    assert checked == sent
    assert type(checked) is type(sent)


@pytest.mark.promise("AC-1")
@pytest.mark.fault("V04")
@pytest.mark.parametrize(
    ("safe", "command"), [(0, fractions.Fraction(1, 2)), (0, True), (0.0, True)]
)
def test_a_number_of_another_kind_is_refused(safe: float, command: Any) -> None:
    """A fraction is no whole number, and a bool is no number at all."""
    with pytest.raises(esair.BadValueError, match="command: expected"):
        CommandCheck(FakeActuator("arm", safe=safe)).checked(command)


def test_a_right_declaration_has_no_mistakes() -> None:
    """Limits, slew and a safe command that fit each other are accepted."""
    arm = FakeActuator(
        "arm", safe=Speed(0.0), limits={"speed": (-1, 1)}, slew={"speed": 2}
    )

    assert check_declaration(arm) == []
    assert CommandCheck(arm).checked(Speed(0.5)) == Speed(0.5)


class Even(esair.Actuator[int]):
    """Takes even numbers only, and keeps what it was shown and told."""

    safe = 0
    limits = (-10, 10)
    clamp = True

    def __init__(self) -> None:
        super().__init__(name="even")
        self.shown: list[int] = []
        self.told: list[int] = []

    def check(self, command: int) -> None:
        self.shown.append(command)
        if command % 2:
            raise esair.BadValueError(self.name, "command", "expected an even number")

    async def write(self, command: int) -> None:
        self.told.append(command)


@pytest.mark.promise("AC-1")
@pytest.mark.virtual_clock
async def test_a_device_refuses_what_it_cannot_take_before_it_leaves() -> None:
    """Its own check sees each command within its limits, and the safe one."""
    even = Even()
    policy = esair.Policy("even", allow={"me": esair.Access.WRITE})
    async with esair.Robot(resources=[even], policies=[policy]) as robot:
        right = await robot.resources.register("me", "even", esair.Access.WRITE)
        await robot.actuators.write(right, 4)
        await robot.actuators.write(right, 99)
        with pytest.raises(
            esair.BadValueError, match="even: command: expected an even"
        ):
            await robot.actuators.write(right, 3)

        assert even.shown[-3:] == [4, 10, 3]
        assert [each for each in even.told if each] == [4, 10]
        assert robot.resources.query("even").faults == 0


@attrs.frozen
class Lift:
    """Drives or lifts; only one of them has a speed."""

    height: float
    speed: float | None = None


@pytest.mark.promise("AC-1")
def test_a_device_that_checks_itself_may_be_told_less_than_it_limits() -> None:
    """What a command does not have is in no limits; its own check knows of that."""
    shown: list[Lift] = []

    class Own(FakeActuator[Lift]):
        def check(self, command: Lift) -> None:
            shown.append(command)

    options: dict[str, Any] = {"limits": {"speed": (0.0, 1.0), "height": (0.0, 2.0)}}
    own = CommandCheck(Own("lift", safe=Lift(0.0), **options))
    assert own.checked(Lift(1.0)) == Lift(1.0)
    assert shown == [Lift(1.0)]
    for bad in (Lift(3.0), Lift(1.0, 2.0)):
        with pytest.raises(esair.BadValueError, match="expected 0 to"):
            own.checked(bad)
    with pytest.raises(esair.BadValueError):
        CommandCheck(FakeActuator("lift", safe=Lift(0.0), **options)).checked(Lift(1.0))


def test_a_safe_command_that_the_device_refuses_is_a_mistake() -> None:
    """It is told before the robot starts."""
    even = Even()
    even.safe = 5

    (mistake,) = check_declaration(even)

    assert "even number" in str(mistake)


# What was checked is what leaves.


@attrs.define
class Arm:
    """A command that can be changed."""

    left: float
    right: float


class Recorder(esair.Actuator[Any]):
    """Writes down what a command held when it landed; a write takes a while."""

    def __init__(self, safe: Any, takes: float = 0.0, **declared: Any) -> None:
        super().__init__(name="arm")
        self.safe = safe
        self.takes = takes
        self.landed: list[Any] = []
        vars(self).update(declared)

    async def write(self, command: Any) -> None:
        if self.takes:
            await asyncio.sleep(self.takes)
        self.landed.append(copy.deepcopy(command))


MUTABLE = [
    ({"left": 0.0, "right": 0.0}, lambda command, value: command.update(left=value)),
    (Arm(0.0, 0.0), lambda command, value: setattr(command, "left", value)),
    ([0.0, 0.0], lambda command, value: command.__setitem__(0, value)),
    (np.zeros(2), lambda command, value: command.__setitem__(0, value)),
]


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-5")
@pytest.mark.parametrize(
    ("safe", "change"), MUTABLE, ids=["dict", "attrs", "list", "array"]
)
async def test_a_command_changed_while_the_driver_is_busy_leaves_as_it_was_checked(
    safe: Any, change: Any
) -> None:
    """NaN never reaches the device through an object that was good at its check."""
    arm = Recorder(safe, takes=0.05)
    user: Any = esair.Behavior(name="user", writes={"arm": esair.writes(type(safe))})
    async with esair.Robot(resources=[arm], behaviors=[user]):
        command = copy.deepcopy(safe)
        writes = []
        for value in (1.0, 2.0):
            change(command, value)
            writes.append(asyncio.create_task(user.arm.write(command)))
            await asyncio.sleep(0.01)
        change(command, float("nan"))
        await asyncio.wait(writes)
        assert len(arm.landed) == 3
        for value, landed in zip((1.0, 2.0), arm.landed[1:], strict=True):
            wanted = copy.deepcopy(safe)
            change(wanted, value)
            assert np.array_equal(landed, wanted)


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-5")
async def test_a_reused_dictionary_does_not_bypass_slew() -> None:
    """What the device was told last is kept apart from the object that told it."""
    arm = Recorder({"speed": 0.0}, slew={"speed": 1.0})
    user: Any = esair.Behavior(name="user", writes={"arm": esair.writes(dict)})
    async with esair.Robot(resources=[arm], behaviors=[user]):
        command = {"speed": 0.0}
        for speed in (0.0, 100.0):
            command["speed"] = speed
            written = await user.arm.write(command)
            written.command["speed"] = speed
            await asyncio.sleep(0.1)
        command["speed"] = 100.0
        await user.arm.write(command)
        assert all(each["speed"] <= 0.5 for each in arm.landed)


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-1", "AC-5")
async def test_a_wrong_type_under_slew_is_a_bad_value() -> None:
    """It names the field, and nothing leaves."""
    arm = Recorder({"speed": 0.0}, slew={"speed": 1.0})
    user: Any = esair.Behavior(name="user", writes={"arm": esair.writes(dict)})
    async with esair.Robot(resources=[arm], behaviors=[user]):
        for wrong in ("fast", None, [1.0]):
            with pytest.raises(esair.BadValueError, match="speed"):
                await user.arm.write({"speed": wrong})
        assert arm.landed == [{"speed": 0.0}]


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-1")
async def test_a_driver_that_refuses_has_not_written() -> None:
    """Its answer is the writer's, and false in a condition."""

    class Proud(esair.Actuator[float]):
        safe = 0.0

        async def write(self, command: float) -> Any:
            if command:
                return Refused("device", 0, "it is locked", 0.0, 0.0)
            return None

    user: Any = esair.Behavior(name="user", writes={"proud": esair.writes(float)})
    async with esair.Robot(resources=[Proud()], behaviors=[user]):
        outcome = await user.proud.write(1.0)
        assert not outcome
        assert outcome.rule == "it is locked"


@pytest.mark.virtual_clock
@pytest.mark.promise("AC-5")
async def test_a_number_in_a_frozen_command_is_one_that_stays() -> None:
    """What only looks like one can be changed while the driver is busy."""
    wheels = FakeActuator("wheels", safe=Twist(0.0, 0.0))
    user: Any = esair.Behavior(name="user", writes={"wheels": esair.writes(Twist)})
    speed: Any = np.asarray(0.3)
    async with esair.Robot(resources=[wheels], behaviors=[user]):
        with pytest.raises(esair.BadValueError, match="linear: expected a number"):
            await user.wheels.write(Twist(speed, 0.0))
        assert await user.wheels.write(Twist(speed[()], 0.0))
    assert wheels.commands[1] == Twist(0.3, 0.0)
