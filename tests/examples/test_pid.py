"""The controller and the filter that the examples use."""

import pytest
from pid import LowPass, Pid


def test_the_pid_reaches_its_goal_and_does_not_wind_up() -> None:
    """Under a steady push too; an hour at its limit costs nothing afterwards."""
    pid, value = Pid(2.0, 1.0, 0.1, limit=1.0), 0.0
    for _ in range(2000):
        value += 0.01 * (pid.step(1.0 - value, 0.01) - 0.3)
    assert value == pytest.approx(1.0, abs=0.01)

    for _ in range(360_000):
        pid.step(100.0, 0.01)
    assert pid.integral < 1.0


def test_a_pid_may_be_asked_twice_at_one_moment() -> None:
    """Its first step has no time before it."""
    assert Pid(1.0, 1.0, 1.0, limit=2.0).step(0.5, 0.0) == 0.5


@pytest.mark.parametrize("steps", [1, 7, 100])
def test_the_low_pass_does_not_ask_how_often(steps) -> None:
    """After its time 63 % of a step are through, in one step or in a hundred."""
    low_pass = LowPass(2.0)
    assert low_pass.step(0.0, 0.0) == 0.0

    for _ in range(steps):
        value = low_pass.step(1.0, 2.0 / steps)

    assert value == pytest.approx(0.632, abs=0.001)
