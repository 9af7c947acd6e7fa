"""Draws what the parts of `esair.control` make of a step, a spike, a bounce.

python docs/code/step_responses.py docs/images/control.png
"""

import random
import sys

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from esair.control import (
    Debounce,
    Hysteresis,
    LowPass,
    MovingMedian,
    Pid,
    Slew,
    TrapezoidProfile,
)

STEP_MS = 20
GREY, BLUE, RED, GREEN = "#888888", "#0072b2", "#d55e00", "#009e73"


def times(count: int) -> list[float]:
    """Return the moments of the steps, in seconds."""
    return [n * STEP_MS / 1000 for n in range(count)]


def draw_pid(axes: Axes) -> None:
    """A heater that is pushed to its limit, and back: with and without an integral."""
    for i, colour in ((0.0, RED), (0.8, BLUE)):
        pid, value, values = Pid(4.0, i, 0.3, low=-1.0, high=1.0), 0.0, []
        for n in range(500):
            target = 1.0 if n < 250 else 0.0
            value += (pid.step(target, value, STEP_MS) - 0.3) * STEP_MS / 1000
            values.append(value)
        axes.plot(times(500), values, color=colour, label=f"Pid, i = {i}")
    axes.step(times(500), [1.0] * 250 + [0.0] * 250, color=GREY, label="target")
    axes.set_title("Pid, against a steady push of 0.3")


def draw_filters(axes: Axes) -> None:
    """Noise, a step, and two spikes."""
    noise = random.Random(1)
    raw = [(n > 60) + noise.gauss(0.0, 0.05) for n in range(150)]
    raw[30], raw[110] = 2.0, -1.0
    low_pass, median = LowPass(200), MovingMedian(5)
    axes.plot(times(150), raw, color=GREY, lw=0.8, label="measured")
    axes.plot(
        times(150),
        [low_pass.step(each, STEP_MS) for each in raw],
        color=RED,
        label="LowPass(200)",
    )
    axes.plot(
        times(150),
        [median.step(each) for each in raw],
        color=BLUE,
        label="MovingMedian(5)",
    )
    axes.set_title("Two filters: noise, a step, two spikes")


def draw_ways(axes: Axes) -> None:
    """A step of the target, as a way that a motor can follow."""
    slew, profile = Slew(0.8), TrapezoidProfile(0.8, 1.0)
    target = [1.0 if n > 10 else 0.0 for n in range(150)]
    axes.step(times(150), target, color=GREY, label="target")
    axes.plot(
        times(150),
        [slew.step(each, STEP_MS) for each in target],
        color=RED,
        label="Slew(0.8)",
    )
    axes.plot(
        times(150),
        [profile.step(each, STEP_MS) for each in target],
        color=BLUE,
        label="TrapezoidProfile(0.8, 1.0)",
    )
    axes.set_title("Two ways to a new target")


def draw_switches(axes: Axes) -> None:
    """A wave that crosses two borders, and a switch that bounces."""
    noise = random.Random(2)
    wave = [0.5 + 0.4 * (n / 75 - 1) + noise.gauss(0.0, 0.12) for n in range(150)]
    hysteresis, debounce = Hysteresis(0.35, 0.65), Debounce(100)
    axes.plot(times(150), wave, color=GREY, lw=0.8, label="measured")
    plain = [value > 0.5 for value in wave]
    for level, colour, name, values in (
        (-0.4, GREEN, "above 0.5?", plain),
        (-0.8, RED, "Hysteresis(0.35, 0.65)", [hysteresis.step(v) for v in wave]),
        (-1.2, BLUE, "Debounce(100)", [debounce.step(v, STEP_MS) for v in plain]),
    ):
        places = [level + 0.3 * value for value in values]
        axes.step(times(150), places, color=colour, label=name)
    axes.set_ylim(-1.4, 2.2)
    axes.set_title("Two ways to decide")


def draw(path: str) -> None:
    """Write the picture to a file."""
    figure, grid = plt.subplots(2, 2, figsize=(10, 6.5), layout="constrained")
    for draw_one, axes in zip(
        (draw_pid, draw_filters, draw_ways, draw_switches), grid.flat, strict=True
    ):
        draw_one(axes)
        axes.set_xlabel("s")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    draw(sys.argv[1])
