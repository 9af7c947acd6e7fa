"""Settings: typed, with unit and limits, and checked before anything is applied."""

from __future__ import annotations

import fractions
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import esair
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
