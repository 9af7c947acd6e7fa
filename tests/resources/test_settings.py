"""Settings: typed, with unit and limits, and checked before anything is applied."""

from __future__ import annotations

import asyncio
import decimal
import fractions
import functools
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import esair
from esair.buses import I2CBus
from esair.plan import Plan, examine
from esair.testing import FakeI2c
from esair.values import same_type


class Sonar(esair.Sensor[float]):
    rate = esair.setting(20.0, unit="Hz", min=1.0, max=50.0)
    gain = esair.setting(3, min=0, max=7, doc="amplification step")
    mode = esair.setting("near", choices=["near", "far"])
    label = esair.setting(None)

    async def read(self) -> float:
        return 1.0


@pytest.mark.promise("RS-4")
def test_settings_are_discoverable() -> None:
    """Class attributes describe them: type, unit, limits, choices."""
    described: Any = Sonar.rate

    assert (described.name, described.type, described.unit) == ("rate", float, "Hz")
    assert (described.min, described.max, described.default) == (1.0, 50.0, 20.0)
    assert dict(Sonar().settings) == {
        "rate": 20.0,
        "gain": 3,
        "mode": "near",
        "label": None,
    }
    with pytest.raises(TypeError):
        Sonar().settings["rate"] = 1.0  # type: ignore[index]


@pytest.mark.promise("RS-4")
def test_the_constructor_sets_them() -> None:
    """The first values are checked like later ones; a whole number is a float."""
    sonar = Sonar(rate=30, gain=5, mode="far", label="front")

    assert (sonar.rate, sonar.gain, sonar.mode) == (30.0, 5, "far")
    assert type(sonar.rate) is float


class Arm(esair.Actuator[float]):
    safe = 0.0
    home = esair.setting((0.0, 0.0))

    async def write(self, command: float) -> None: ...

    @esair.operation
    async def follow(self, points: list[float], pace: float | str = 1.0) -> None: ...


@pytest.mark.promise("RS-4", "RS-7", "AC-1")
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_inside_is_finite(bad: float) -> None:
    """Of a setting, and of a parameter of an operation, as of a command."""
    with pytest.raises(
        esair.BadValueError, match="home: expected a finite number at 1"
    ):
        Arm(home=(0.0, bad))
    follow = Arm().operations["follow"]
    for points, pace in (([0.5, bad], 1.0), ([0.5], bad)):
        with pytest.raises(esair.BadValueError, match="expected a finite number"):
            follow.check("arm", {"points": points, "pace": pace})
    assert follow.check("arm", {"points": [0.5], "pace": "slow"})


@pytest.mark.promise("RS-4")
@pytest.mark.parametrize("bad", ["Infinity", "-Infinity", "NaN", "sNaN"])
def test_a_decimal_is_finite_too(bad: str) -> None:
    """Alone and within: an infinite one raises where others compare."""
    number = decimal.Decimal(bad)
    for value in (number, (number, 1.0), {"a": number}):
        with pytest.raises(esair.BadValueError, match="expected a finite number"):
            Sonar(label=value)
    assert Sonar(label=decimal.Decimal("0.1")).label == decimal.Decimal("0.1")


@pytest.mark.promise("RS-4")
@pytest.mark.fault("G02", "G03")
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("rate", "fast", "expected a number in Hz"),
        ("rate", True, "expected a number"),
        ("rate", math.nan, "finite"),
        ("rate", math.inf, "finite"),
        ("rate", 0.5, "at least 1.0 Hz"),
        ("rate", 51, "at most 50.0 Hz"),
        ("gain", 1.5, "expected a whole number"),
        ("gain", False, "expected a whole number"),
        ("mode", "middle", "one of 'near', 'far'"),
        ("gian", 1, "did you mean 'gain'"),
        ("volume", 1, "there are gain, label, mode, rate"),
    ],
)
def test_a_bad_setting_is_named(name: str, value: Any, message: str) -> None:
    """Field, what was expected, and the nearest name."""
    with pytest.raises(esair.BadValueError, match=message) as caught:
        Sonar(**{name: value})

    assert caught.value.field == name


@pytest.mark.fault("G03")
@given(value=st.one_of(st.floats(), st.integers(), st.booleans(), st.text(), st.none()))
def test_what_is_accepted_is_within_the_limits(value: Any) -> None:
    """No value of any type slips through."""
    try:
        sonar = Sonar(rate=value)
    except esair.BadValueError:
        return
    assert type(sonar.rate) is float
    assert 1.0 <= sonar.rate <= 50.0


def test_a_subclass_gives_another_default() -> None:
    """`rate = 5` in a subclass keeps the unit and the limits, and is checked."""

    class Slow(Sonar):
        rate = 5  # type: ignore[assignment]

    described: Any = Slow.rate
    assert (Slow().rate, described.unit, described.max) == (5.0, "Hz", 50.0)
    assert Sonar().rate == 20.0
    with pytest.raises(esair.BadValueError, match="class TooFast: rate"):

        class TooFast(Sonar):
            rate = 500.0


@pytest.mark.promise("RES-1")
def test_a_sensor_is_asked_ten_times_a_second_unless_it_says_otherwise() -> None:
    """The default rate of the contract."""
    assert esair.Sensor().rate == 10.0


@pytest.mark.parametrize(
    ("given_", "wanted", "fits"),
    [
        (float, float, True), (int, float, True), (float, int, False), (Any, str, True),
        (str, object, True), (bool, int, True), (list[float], list, True),
        (str, float, False), (int | str, int | str, True), (int | str, int, False),
    ],
)  # fmt: skip
def test_types_that_fit(given_: Any, wanted: Any, fits: bool) -> None:
    """A reading of one type serves where another is wanted."""
    assert same_type(given_, wanted) is fits


@pytest.mark.promise("RES-1")
def test_names_come_from_the_class_or_the_keyword() -> None:
    """Snake case unless ``name=`` says otherwise; flags are kept."""

    class RangeFinder(Sonar):
        pass

    assert RangeFinder().name == "range_finder"
    front = RangeFinder(name="front", required=True)
    assert (front.name, front.required) == ("front", True)
    assert "front" in repr(front)
    with pytest.raises(esair.ConfigError, match="lower-case"):
        RangeFinder(name="Front")
    front.report_lost()  # nobody listens yet
    front.report_arrived()


@pytest.mark.promise("RES-1", "RS-4")
def test_a_rate_can_be_kept_whatever_limits_it_is_given() -> None:
    """A class that describes its rate anew cannot allow one that is 0, or endless."""

    class Bare(esair.Sensor[float]):
        rate = esair.setting(10, unit="Hz")

    class Loose(esair.Sensor[float]):
        rate = esair.setting(10.0, unit="Hz", min=0.0, max=1e12)

    class Fast(Loose):
        rate = 50

    for cls in (Bare, Loose, Fast):
        for rate in (0, -1.0, 1e9, math.nan):
            with pytest.raises(esair.BadValueError, match="rate: expected"):
                cls(rate=rate)
        assert cls(rate=20.5).rate == 20.5
    assert (Bare().rate, Fast().rate) == (10.0, 50.0)
    with pytest.raises(esair.BadValueError, match="class Never: rate: expected"):

        class Never(esair.Sensor[float]):
            rate = esair.setting(0.0)


@pytest.mark.promise("RS-4")
def test_a_number_is_turned_into_the_class_of_the_setting() -> None:
    """Numpy's float64 is a float; a fraction is a number; a bool is neither."""

    class Float64(float):
        pass

    for rate in (Float64(30.0), fractions.Fraction(30)):
        sonar = Sonar(rate=rate)
        assert sonar.rate == 30.0
        assert type(sonar.rate) is float
    for wrong in (True, "30", 10**400):
        with pytest.raises(esair.BadValueError, match="expected a number in Hz"):
            Sonar(rate=wrong)


@pytest.mark.promise("RS-4", "AC-4")
@pytest.mark.virtual_clock
@pytest.mark.parametrize(
    ("name", "wrong"),
    [("command_timeout", 0.0), ("command_timeout", -1.0), ("fault_limit", 0)],
)
async def test_what_every_device_has_stays_what_its_class_may_say(
    name: str, wrong: float
) -> None:
    """A time limit that is set while the robot runs is one, too."""

    class Wheels(esair.Actuator[float]):
        safe = 0.0
        command_timeout: float = esair.setting(0.2)
        fault_limit: int = esair.setting(3)

        async def write(self, command: float) -> None: ...

    wheels = Wheels(name="wheels")
    right = esair.Access.WRITE | esair.Access.CONFIGURE
    policy = esair.Policy("wheels", allow={"*": right})
    async with esair.Robot(resources=[wheels], policies=[policy]) as robot:
        mine = await robot.resources.register("me", "wheels", right)
        with pytest.raises(esair.BadValueError, match=f"{name}: expected .* > 0"):
            await robot.resources.configure(mine, **{name: wrong})
        assert (wheels.command_timeout, wheels.fault_limit) == (0.2, 3)
        await robot.resources.configure(mine, command_timeout=0.3, fault_limit=2)
        assert (wheels.command_timeout, wheels.fault_limit) == (0.3, 2)


# What holds unless a class says otherwise.


@pytest.mark.promise("RES-1")
@pytest.mark.parametrize(
    ("right", "wrong"), [(0.001, 0.0009), (100_000.0, 100_001.0), (1.0, 0.0)]
)
def test_a_rate_is_from_a_thousandth_to_a_hundred_thousand(
    right: float, wrong: float
) -> None:
    """Once in a quarter of an hour, and as often as a computer can."""

    class Bare(esair.Sensor[float]):
        """Says nothing of its rate."""

    assert Bare(rate=right).rate == right
    with pytest.raises(esair.BadValueError, match="rate: expected at"):
        Bare(rate=wrong)


class Part(esair.Sensor[float]):
    """Notes what it is asked."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.asked: list[str] = []

    async def open(self) -> None:
        self.asked.append("open")

    async def close(self) -> None:
        self.asked.append("close")

    async def is_set_up(self) -> bool:
        self.asked.append("is_set_up")
        return True

    async def read(self) -> float:
        self.asked.append("read")
        raise ValueError("a checksum that is wrong")

    @esair.operation
    async def hang(self) -> None:
        await asyncio.Event().wait()


@pytest.mark.virtual_clock
async def test_a_driver_has_a_second_three_faults_and_is_looked_after() -> None:
    """Its call is given up after 1 s, it is reopened after the third fault in a row, and
    asked each second whether it is still set up."""
    part = Part(name="part")
    user: Any = esair.Behavior(
        name="user", reads={"part": esair.reads(float, configure=True)}
    )
    async with esair.Robot(resources=[part], behaviors=[user]):
        began = esair.now()
        with pytest.raises(esair.DriverStuckError):
            await user.part.operate("hang")
        assert esair.now() - began == pytest.approx(1.0, abs=0.01)
        part.asked.clear()
        await asyncio.sleep(10.5)
        assert 9 <= part.asked.count("is_set_up") <= 11
        part.asked.clear()
        for _ in range(3):
            with pytest.raises(esair.EsairError):
                await user.part.read(fresh=True)
        await asyncio.sleep(0.01)
        assert [each for each in part.asked if each != "is_set_up"][:4] == [
            *("read", "read", "read", "close")
        ]


# What operations say of themselves.


class Lamp(esair.Actuator[float]):
    safe = 0.0

    async def write(self, command: float) -> None: ...

    @esair.operation(deadline=5.0)
    async def blink(self, times: int, pause: float = 0.5) -> None:
        """Show that it is there.

        And nothing else.
        """

    @esair.operation
    def test(self) -> None: ...


@pytest.mark.promise("RS-7")
def test_operations_are_discoverable() -> None:
    """With their parameters, what each is unless given, and the first line of their
    text."""
    blink, test = Lamp().operations["blink"], Lamp().operations["test"]
    assert str(blink) == "blink(times: int, pause: float = 0.5)"
    assert [(each.required, each.default) for each in blink.parameters] == [
        (True, None),
        (False, 0.5),
    ]
    assert (blink.deadline, blink.doc) == (5.0, "Show that it is there.")
    assert (str(test), test.deadline, test.doc) == ("test()", None, "")


@pytest.mark.promise("RS-7")
@pytest.mark.parametrize(
    ("given_", "told"),
    [
        ({"tmies": 1}, "times: it is missing; it is blink(times: int, pause: float = 0.5)"),
        ({"tmies": 1}, "tmies: there is no such parameter; did you mean 'times'?"),
        ({"times": 1, "loudly": True}, "loudly: there is no such parameter; it is blink("),
        ({"times": 1.5, "pause": math.nan}, "times: expected int, not 1.5; pause: expected "
         "a finite number"),
        ({"times": 1, "pause": 10**400}, "pause: "),
    ],
)  # fmt: skip
def test_every_mistake_of_a_call_is_told_at_once(
    given_: dict[str, Any], told: str
) -> None:
    """By the names of the parameters, and what there is."""
    with pytest.raises(esair.BadValueError) as caught:
        Lamp().operations["blink"].check("lamp", given_)
    assert told in str(caught.value)


@pytest.mark.promise("RS-7")
def test_a_number_is_turned_into_the_class_of_the_parameter() -> None:
    """As of a setting."""
    blink = Lamp().operations["blink"]
    checked = blink.check("lamp", {"times": 3, "pause": 1})
    assert checked == {"times": 3, "pause": 1.0}
    assert type(checked["pause"]) is float


@pytest.mark.promise("RS-4")
def test_every_mistake_in_settings_is_told_at_once() -> None:
    """The field of the error names all of them."""
    with pytest.raises(esair.BadValueError) as caught:
        Sonar(rate=0.0, gain=9)
    assert caught.value.field == "rate, gain"
    assert "rate: expected at least 1.0 Hz" in str(caught.value)
    assert "gain: expected at most 7, not 9" in str(caught.value)


class Odd(Lamp):
    """None of these can be called by its name."""

    @esair.operation
    async def stream(self) -> None: ...

    @esair.operation
    async def _hidden(self) -> None: ...

    @esair.operation
    async def some(self) -> Any:
        yield 1

    @esair.operation
    def more(self) -> Any:
        yield 1

    @esair.operation
    @staticmethod
    async def apart(one: Any, angle) -> None:  # type: ignore[no-untyped-def]
        """Told once, not for its parameters."""

    @esair.operation
    async def large(self, size: float = 10**400) -> None: ...

    @esair.operation(deadline=2.0)
    async def fine(self, size: float = 1, name: str = "") -> None: ...


@pytest.mark.promise("RS-7", "RS-8")
def test_what_is_no_operation_is_told() -> None:
    """With the method, and what was expected."""
    found = examine(Plan(resources=[Odd()]))
    told = [(each.field, each.text) for each in found if each.rule == "declaration"]
    assert told[:4] == [
        ("stream", "a method that esair calls by itself is no operation"),
        ("_hidden", "an operation has a name without an underscore before it"),
        ("some", "expected a method that does not yield"),
        ("more", "expected a method that does not yield"),
    ]
    assert [field for field, _ in told[4:]] == ["apart", "large"]
    assert told[5][1].startswith("the default of 'size': ")


# What the errors of a package mean.


class GoneError(Exception):
    """A package's."""


def packages() -> tuple[type[esair.Sensor[float]], ...]:
    """Make the classes: what they say counts from then on."""

    class Package(esair.Sensor[float]):
        errors = {GoneError: esair.DeviceLostError}  # noqa: RUF012 - as users write it

        async def read(self) -> float:
            raise GoneError("cable")

        async def stream(self) -> Any:
            yield 1.0
            raise GoneError("cable")

        def close(self) -> None:  # type: ignore[override]
            raise GoneError("cable")

        def identify(self) -> Any:
            raise KeyError("serial")

        async def is_set_up(self) -> bool:
            raise esair.DeviceFaultError("package", "its own word")

    class Deeper(Package):
        def stream(self) -> Any:  # type: ignore[override]
            yield 2.0
            raise GoneError("cable")

        async def read(self) -> float:
            return await super().read()

    return Package, Deeper


@pytest.mark.virtual_clock
@pytest.mark.parametrize("deep", [0, 1])
async def test_an_error_of_a_package_is_what_the_class_says(
    deep: int,
) -> None:
    """From each kind of method, once; all else, and what is of esair, as it is."""
    part: Any = packages()[deep](name="part")
    stream = part.stream()
    ends = functools.partial(_next, stream) if deep else stream.__anext__
    assert await ends() == (2.0 if deep else 1.0)
    calls: list[Any] = [
        part.read,
        ends,
        functools.partial(asyncio.to_thread, part.close),
    ]
    for call in calls:
        with pytest.raises(esair.DeviceLostError) as lost:
            await call()
        assert str(lost.value).endswith("GoneError: cable")
        assert isinstance(lost.value.__cause__, GoneError)
    with pytest.raises(KeyError):
        part.identify()
    with pytest.raises(esair.DeviceFaultError, match="its own word"):
        await part.is_set_up()


async def _next(values: Any) -> Any:
    return next(values)


@pytest.mark.virtual_clock
async def test_a_driver_that_is_opened_by_hand_says_that_its_bus_is_missing() -> None:
    """With one it opens, and one that declares none needs none."""

    class Chip(esair.Sensor[float]):
        bus: I2CBus

        async def open(self) -> None: ...

    class Newer(Chip):
        """Opens as the other does."""

    class Bare(Sonar):
        async def open(self) -> None: ...

    with pytest.raises(
        esair.ConfigError, match="expected an I2CBus, not None: give it"
    ):
        await Chip().open()
    with pytest.raises(esair.ConfigError, match="newer: bus: expected an I2CBus"):
        await Newer().open()
    await Chip(bus=FakeI2c("front")).open()
    await Bare().open()
    assert Chip.open.__name__ == "open"
