"""The parts of control: within their limits whatever comes in, and right where it counts."""

import json
import math
import shutil
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.minimal.conftest import MicroPython, program_or_skip

from esair import control
from esair.control import (
    Complementary,
    Debounce,
    Hysteresis,
    LowPass,
    MovingMedian,
    Pid,
    Slew,
    TrapezoidProfile,
)

pytestmark = pytest.mark.promise("CTL-1")

ANYTHING = st.floats() | st.sampled_from([0.0, -0.0, 1e30, -1e30, 1e-30, 1e308])
SANE = st.floats(-1e3, 1e3)
GAP = st.sampled_from([0, 1, 20, 50, 333, 100_000, 2**31]) | st.integers(-5, 10**12)
GAINS = st.floats(0.0, 1e4)


@given(
    gains=st.tuples(GAINS, GAINS, GAINS),
    low=st.floats(-100.0, -0.01),
    high=st.floats(0.01, 100.0),
    wrap=st.sampled_from([0.0, 360.0, 2 * math.pi]),
    steps=st.lists(st.tuples(ANYTHING, ANYTHING, GAP), max_size=30),
)
def test_a_pid_never_leaves_its_limits(gains, low, high, wrap, steps) -> None:
    """Whatever it is told, in whatever time."""
    pid = Pid(*gains, low=low, high=high, wrap=wrap)

    for target, measured, elapsed_ms in steps:
        assert low <= pid.step(target, measured, elapsed_ms) <= high


@given(
    p=st.floats(0.0, 100.0),
    i=st.floats(0.1, 100.0),
    d=st.floats(0.0, 100.0),
    high=st.floats(0.1, 10.0),
    before=st.lists(st.tuples(ANYTHING, SANE, GAP), max_size=30),
    error=st.floats(0.1, 10.0) | st.floats(-10.0, -0.1),
    elapsed_ms=st.integers(1, 100),
)
def test_a_lasting_error_has_its_sign_in_bounded_time(
    p, i, d, high, before, error, elapsed_ms
) -> None:
    """After any gap and any errors: there is no wind-up."""
    pid = Pid(p, i, d, low=-high, high=high)
    for told in before:
        pid.step(*told)

    bound_ms = 1000.0 * 2 * high / (i * abs(error))
    for _ in range(2 + math.ceil(bound_ms / elapsed_ms)):
        output = pid.step(error, 0.0, elapsed_ms)

    assert output * error > 0.0


def test_ten_minutes_of_error_and_a_gap_cost_nothing_afterwards() -> None:
    """The full turn the wrong way ends within a second of the opposite error."""
    pid = Pid(2.5, 0.2, 0.1, low=-1.5, high=1.5)
    pid.step(0.0, -0.3, 0)
    assert pid.step(0.0, -0.3, 600_000) == pytest.approx(0.75, abs=0.01)
    for _ in range(12_000):
        pid.step(0.0, -2.0, 50)

    outputs = [pid.step(0.0, 0.3, 50) for _ in range(20)]

    assert outputs[-1] == pytest.approx(-0.75, abs=0.1)


@given(p=st.floats(0.5, 4.0), i=st.floats(0.2, 2.0), push=st.floats(-0.5, 0.5))
def test_a_pid_reaches_its_target_under_a_steady_push(p, i, push) -> None:
    """Its integral carries what the push takes."""
    pid, place = Pid(p, i, 0.05, low=-1.0, high=1.0), 0.0

    for _ in range(4000):
        place += 0.02 * (pid.step(1.0, place, 20) + push)

    assert place == pytest.approx(1.0, abs=0.02)


def test_a_new_target_makes_no_jump_of_the_derivative() -> None:
    """It is that of the measurement; the first step has none."""
    pid = Pid(0.0, 0.0, 5.0, low=-1.0, high=1.0)

    assert [pid.step(t, 0.5, 20) for t in (0.0, 9.0, -9.0)] == [0.0, 0.0, 0.0]
    assert pid.step(0.0, 0.502, 20) == pytest.approx(-0.5)


def test_an_angle_goes_the_shorter_way_round() -> None:
    """Over the seam, for the error and for the derivative."""
    pid = Pid(0.01, 0.0, 0.001, low=-1.0, high=1.0, wrap=360.0)

    assert pid.step(-170.0, 170.0, 20) == pytest.approx(0.2)
    assert pid.step(-170.0, -179.0, 1000) == pytest.approx(0.09 - 0.011)


def test_a_bad_number_is_left_out() -> None:
    """The output of before stands, and the integral has not moved."""
    pid = Pid(1.0, 1.0, 0.0, low=-2.0, high=2.0)
    before = pid.step(1.0, 0.5, 20)

    assert pid.step(math.nan, 0.5, 20) == before
    assert pid.step(1.0, math.inf, 20) == before
    assert pid.integral == pytest.approx(0.01)


def test_what_moved_during_bad_numbers_is_no_jump() -> None:
    """One step's time does not stand for a change of many: there is no derivative."""
    pid = Pid(0.0, 0.0, 1.0, low=-50.0, high=50.0)
    pid.step(0.0, 0.1, 20)
    for _ in range(25):
        pid.step(0.0, math.nan, 20)

    assert pid.step(0.0, 0.63, 20) == 0.0
    assert pid.step(0.0, 0.65, 20) == pytest.approx(-1.0)


def test_reset_forgets_everything() -> None:
    """A part that was reset gives what a new one gives."""
    told = {
        Pid: ((1.0, 0.2, 20), (0.0, 0.7, 20)),
        LowPass: ((1.0, 0), (0.0, 20)),
        Slew: ((1.0, 50), (-1.0, 20)),
        Debounce: ((True, 50), (True, 60)),
        Hysteresis: ((5.0,), (0.5,)),
        MovingMedian: ((3.0,), (1.0,)),
        Complementary: ((1.0, 0.3, 0), (0.0, 0.2, 20)),
        TrapezoidProfile: ((1.0, 50), (-1.0, 20)),
    }
    assert {type(part) for part in parts()} == set(told)
    for part in parts():
        first = [part.step(*each) for each in told[type(part)]]
        part.step(*told[type(part)][0])
        part.reset()
        assert [part.step(*each) for each in told[type(part)]] == first


def parts() -> list:
    return [
        Pid(1.0, 0.5, 0.1, low=-1.0, high=1.0),
        LowPass(200),
        Slew(2.0, 5.0),
        Debounce(50, 20),
        Hysteresis(0.2, 0.8),
        MovingMedian(5),
        Complementary(500),
        TrapezoidProfile(0.5, 1.0),
    ]


@pytest.mark.parametrize("steps", [1, 7, 100])
def test_the_low_pass_does_not_ask_how_often(steps) -> None:
    """After its time 63 % of a jump are through, in one step or in a hundred."""
    low_pass = LowPass(2100)
    assert low_pass.step(0.0, 0) == 0.0

    for _ in range(steps):
        value = low_pass.step(1.0, 2100 // steps)

    assert value == pytest.approx(0.632, abs=0.001)


@given(values=st.lists(st.tuples(ANYTHING, GAP), min_size=1, max_size=30))
def test_a_low_pass_stays_among_what_it_heard(values) -> None:
    """It never overshoots, and is never NaN."""
    low_pass, heard = LowPass(80), [0.0]

    for value, elapsed_ms in values:
        if abs(value) < 1e30:
            heard.append(value)
        slack = 1e-9 * max(abs(v) for v in heard)
        assert min(heard) - slack <= low_pass.step(value, elapsed_ms)
        assert low_pass.value <= max(heard) + slack


@given(
    up=st.floats(0.1, 50.0),
    down=st.floats(0.1, 50.0),
    steps=st.lists(st.tuples(ANYTHING, GAP), max_size=30),
)
def test_a_slew_never_jumps(up, down, steps) -> None:
    """Not after a gap either: that counts as a tenth of a second."""
    slew, before = Slew(up, down, start=1.0), 1.0

    for value, elapsed_ms in steps:
        after = slew.step(value, elapsed_ms)
        seconds = min(max(elapsed_ms, 0), control.LONGEST_MS) / 1000
        assert before - down * seconds - 1e-9 <= after <= before + up * seconds + 1e-9
        before = after


def test_a_slew_arrives() -> None:
    """And stays."""
    slew = Slew(2.0)

    assert [round(slew.step(0.5, 100), 6) for _ in range(4)] == [0.2, 0.4, 0.5, 0.5]


def test_a_bouncing_switch_is_believed_when_it_has_stayed() -> None:
    """From the first step that saw the change; short ones never come through."""
    debounce = Debounce(40, 0)

    bounces = [True, False, True, True, True, True, False]
    assert [debounce.step(b, 20) for b in bounces] == [
        *(False, False, False, False, True, True),
        False,
    ]


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 30)), max_size=60))
def test_a_debounced_switch_changes_only_after_its_time(steps) -> None:
    """Against the history of what it was told."""
    debounce, believed, since, now = Debounce(50), False, None, 0

    for value, elapsed_ms in steps:
        now += elapsed_ms
        since = None if value == believed else now if since is None else since
        if since is not None and now - since >= 50:
            believed, since = value, None
        assert debounce.step(value, elapsed_ms) == believed


def test_hysteresis_keeps_what_it_was_between_its_borders() -> None:
    """NaN is between all borders."""
    hysteresis = Hysteresis(0.2, 0.8)

    told = [0.5, 0.8, 0.5, math.nan, 0.21, 0.2, 0.5, math.inf, -math.inf]
    assert [hysteresis.step(v) for v in told] == [
        *(False, True, True, True, True, False, False, True, False)
    ]


@given(st.integers(1, 9), st.lists(ANYTHING, max_size=30))
def test_a_median_is_that_of_the_last_values(count, values) -> None:
    """Of the usable ones; a single wrong one never comes through."""
    median = MovingMedian(count)
    usable: list[float] = []

    for value in values:
        usable += [value] if abs(value) < 1e30 else []
        last = sorted(usable[-count:])
        assert median.step(value) == (last[(len(last) - 1) // 2] if last else 0.0)


def test_two_sensors_of_an_angle_complete_each_other() -> None:
    """A drift is held within its share; a quick turn is seen at once."""
    both, angle = Complementary(1000), 0.0
    for _ in range(500):
        both.step(0.05, 0.0, 20)  # the gyroscope drifts
    assert abs(both.value) <= 0.05 * 1.0 + 1e-6

    both.reset()
    both.step(0.0, 0.0, 0)
    for _ in range(10):
        angle += 0.02 * 2.0
        value = both.step(2.0, 0.0, 20)  # the accelerometer has not moved yet
    assert value == pytest.approx(angle, rel=0.2)


@given(
    wrap=st.sampled_from([0.0, 360.0]),
    steps=st.lists(st.tuples(ANYTHING, ANYTHING, GAP), max_size=30),
)
def test_a_fused_angle_is_always_a_number(wrap, steps) -> None:
    """Within half a turn of zero where it goes round."""
    both = Complementary(300, wrap=wrap)

    for told in steps:
        value = both.step(*told)
        assert math.isfinite(value)
        assert not wrap or -180.0 <= value <= 180.0


@given(
    speed=st.floats(0.05, 10.0),
    acceleration=st.floats(0.05, 10.0),
    steps=st.lists(st.tuples(ANYTHING | SANE, GAP), max_size=40),
)
def test_a_profile_keeps_its_limits(speed, acceleration, steps) -> None:
    """Wherever it is sent while it is under way."""
    profile = TrapezoidProfile(speed, acceleration)

    for target, elapsed_ms in steps:
        before, velocity = profile.position, profile.velocity
        seconds = min(max(elapsed_ms, 0), control.LONGEST_MS) / 1000
        after = profile.step(target, elapsed_ms)
        assert math.isfinite(after)
        assert abs(profile.velocity) <= speed * 1.000001
        assert abs(profile.velocity - velocity) <= acceleration * seconds * 1.000001
        assert abs(after - before) <= speed * seconds * 1.000001


@pytest.mark.long
@given(
    speed=st.floats(0.1, 10.0),
    acceleration=st.floats(0.1, 10.0),
    first=st.floats(-20.0, 20.0),
    target=st.floats(-20.0, 20.0),
    moved=st.integers(0, 200),
    elapsed_ms=st.integers(1, 100),
)
def test_a_profile_arrives_and_stands(
    speed, acceleration, first, target, moved, elapsed_ms
) -> None:
    """In the time that its limits need, also if it was on its way elsewhere."""
    profile = TrapezoidProfile(speed, acceleration)
    for _ in range(moved):
        profile.step(first, elapsed_ms)

    far = abs(target - profile.position) + speed * speed / acceleration
    needed_ms = 1000 * (far / speed + 4 * speed / acceleration + 1.0) + 20 * elapsed_ms
    for _ in range(math.ceil(needed_ms / elapsed_ms)):
        profile.step(target, elapsed_ms)

    assert profile.position == pytest.approx(target, abs=1e-6 * max(1.0, speed))
    assert abs(profile.velocity) <= acceleration * elapsed_ms / 1000


def test_a_profile_from_rest_does_not_overshoot() -> None:
    """Nor does it creep: it is there in the time of the trapezoid and three steps."""
    profile = TrapezoidProfile(0.5, 1.0)

    way = [profile.step(1.0, 20) for _ in range(200)]

    assert max(way) <= 1.0 + 1e-9
    assert way[int((1.0 / 0.5 + 0.5 / 1.0) / 0.02) + 3] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Pid(math.nan, low=-1, high=1), "Pid: p is nan: expected a finite"),
        (lambda: Pid(1.0, low=1, high=-1), "Pid: high is -1: .* 1 or more"),
        (lambda: Pid(1.0, low=1, high=1), "low and high are equal"),
        (lambda: Pid(1.0, -1.0, low=-1, high=1), "different signs"),
        (lambda: Pid(1.0, low=-1, high=1, longest_ms=0), "longest_ms"),
        (lambda: LowPass(0), "LowPass: time_ms is 0"),
        (lambda: Slew(0.0), "Slew: up_per_s"),
        (lambda: Slew(1.0, -1.0), "Slew: down_per_s"),
        (lambda: Debounce(-1), "Debounce: on_ms"),
        (lambda: Hysteresis(0.8, 0.2), "off has to be below on"),
        (lambda: MovingMedian(0), "expected 1 to 63"),
        (lambda: MovingMedian(64), "expected 1 to 63"),
        (lambda: Complementary(-5), "Complementary: time_ms"),
        (lambda: TrapezoidProfile(1.0, 0.0), "acceleration_per_s2"),
    ],
)
def test_what_cannot_work_is_refused_when_it_is_made(make, says) -> None:
    """With part, field, and what was expected."""
    with pytest.raises(ValueError, match=says):
        make()


DECIDE = """
from esair.control import *
made = [
    Pid(1.7, 0.5, 0.1, low=-1.0, high=1.0, wrap=6.283185307179586),
    LowPass(230.0), Slew(2.0, 5.0), MovingMedian(5),
    Complementary(500.0, wrap=6.283185307179586), TrapezoidProfile(0.5, 1.0),
]
for a, b, ms in told:
    out.append([
        made[0].step(a, b, ms), made[1].step(a, ms), made[2].step(b, ms),
        made[3].step(a), made[4].step(a, b, ms), made[5].step(b, ms),
    ])
"""


def test_it_decides_on_a_board_as_here(tmp_path) -> None:
    """The very file, under MicroPython with double floats."""
    micropython = MicroPython(program_or_skip())
    (tmp_path / "esair").mkdir()
    shutil.copy(Path(control.__file__), tmp_path / "esair" / "control.py")
    told = [
        [math.sin(0.37 * n) * 4, math.cos(0.21 * n) * 3, 7 + (n * 13) % 50]
        for n in range(300)
    ]
    here: dict = {"told": told, "out": []}
    exec(DECIDE, here)
    told_there = 'import json\nout = []\ntold = json.load(open("data.json"))\n'

    there = micropython.run(
        tmp_path, f"{told_there}{DECIDE}print(json.dumps(out))", data=told
    )

    for ours, theirs in zip(here["out"], json.loads(there), strict=True):
        assert theirs == pytest.approx(ours, rel=1e-9, abs=1e-9)
