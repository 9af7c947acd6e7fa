"""The screen of ``esair top``, drawn from a picture of the robot."""

import io
from typing import Any

import attrs
import numpy as np
import pytest
from rich.console import Console

from esair.recording import size_of
from esair.seat._values import TEXT, numbers_of, short
from esair.seat.screen import event_line, picture


@attrs.frozen
class Three:
    """A value with three numbers."""

    a: Any
    b: Any
    c: Any


def row(name: str, state: str = "ready", **more: Any) -> dict[str, Any]:
    """A sensor as a robot tells it."""
    return {
        "name": name,
        "kind": "sensor",
        "state": state,
        "error": "",
        "rate": 20.0,
        "age": 0.01,
        "late": 0,
        "losses": 0,
        "refusals": 0,
        "value": "1.25",
        **more,
    }


def wheels(**more: Any) -> dict[str, Any]:
    """An actuator as a robot tells it."""
    told = {"holder": "wander", "priority": 3, "stands": "", "value": "0.3"}
    return row("wheels", kind="actuator", **{**told, **more})


def status(*resources: dict[str, Any], halted: str | None = None) -> dict[str, Any]:
    """A picture of a robot."""
    return {
        "robot": "rover",
        "up": 5.0,
        "halted": halted,
        "resources": list(resources),
        "behaviors": [],
    }


def shown(
    found: dict[str, Any], *, width: int = 80, height: int = 24, **more: Any
) -> str:
    """What so many columns show of it."""
    text = io.StringIO()
    console = Console(file=text, width=width, height=height)
    console.print(picture(found, console, **more))
    return text.getvalue()


@pytest.mark.promise("OPS-2")
def test_a_number_that_cannot_be_drawn_is_left_out():
    """A whole number may be too large for a drawing, and spoils no picture."""
    assert numbers_of(Three(10**400, float("inf"), 0.5)) == {"c": 0.5}


@pytest.mark.promise("OPS-2")
def test_an_actuator_tells_who_moves_it_or_why_it_stands():
    """The holder with its priority; a blind hold or a halt instead of it."""
    assert "wander (3) 0.3" in shown(status(wheels()))
    blind = "avoid is blind: sonar lost"
    text = shown(status(wheels(holder="avoid", stands=blind)))
    assert blind in text
    assert "avoid (" not in text


@pytest.mark.promise("OPS-2")
@pytest.mark.parametrize("width", [80, 70, 60, 50, 40])
def test_the_holder_is_told_where_it_is_narrow(width: int) -> None:
    """Beside a long name and a long state; the numbers make room for it."""
    text = shown(status(row("s" * 63, "restarting"), wheels()), width=width)
    assert "wander (3)" in text
    assert ("refused" in text) == (width == 80)
    assert all(len(line) <= width for line in text.splitlines())


@pytest.mark.promise("OPS-2")
def test_what_has_a_problem_is_seen_where_there_is_little_room():
    """Of 60 sensors on 24 lines the one that is lost is shown, and how many are not."""
    rows = [row(f"s{n}", "lost" if n == 44 else "ready") for n in range(60)]
    text = shown(status(*rows))
    assert len(text.splitlines()) <= 24
    assert "s44" in text
    assert "40 more rows have no room" in text


def test_the_newest_events_fill_the_rest():
    """Below the table, the newest last, never more than there is room for."""
    events = [
        event_line(
            {
                "kind": "down",
                "component": f"s{n}",
                "peer": "",
                "text": "gone " * 40,
                "value": None,
            },
            "12:00:00",
        )
        for n in range(50)
    ]
    lines = shown(status(row("a"), wheels()), happened=events).splitlines()
    assert len(lines) <= 24
    assert lines[-1].startswith("12:00:00 s49 down gone")
    assert not any("s10 " in line for line in lines)


@pytest.mark.promise("OPS-2")
def test_a_long_path_leaves_room_for_what_is_wrong_with_it() -> None:
    """A word that is long is told by its ends."""
    port = (
        "/dev/serial/by-id/usb-Silicon_Labs_CP2102N_USB_to_UART_Bridge_0001-if00-port0"
    )
    text = shown(status(row("a", "lost", error=f"{port} is no device")))
    assert "/dev/…_0001-if00-port0 is no dev" in text


@pytest.mark.promise("OPS-2", "OPS-3")
def test_long_names_leave_room_for_what_matters() -> None:
    """On 80 columns of a robot, a mode and a sensor with 63 letters each: halt, holder."""
    found = status(row("s" * 63), wheels(), halted="a cat")
    text = shown({**found, "robot": "r" * 63, "mode": "m" * 63})
    assert "HALTED: a cat" in text
    assert "wander (3)" in text


def test_a_mode_is_told_as_one() -> None:
    """The mode is no component that does something."""
    event = {"kind": "mode", "component": "dock", "peer": "", "value": "explore"}
    told = event_line({**event, "text": "the battery is low"}, "12:00:00")
    assert told.plain == "12:00:00 mode dock the battery is low"


@pytest.mark.promise("SEC-1")
def test_nothing_of_a_device_reaches_the_terminal_raw():
    """Escapes, line ends and bidi characters of names, values, errors and events."""
    evil = "\x1b[2J\r\n\u202eevil"
    event = {"kind": evil, "component": evil, "peer": evil, "text": evil, "value": None}
    text = shown(
        status(
            row("a", value=evil),
            row("b", "lost", error=evil),
            wheels(stands=evil),
            wheels(holder=evil),
            halted=evil,
        ),
        happened=[event_line(event, "12:00:00")],
    )
    assert "\x1b" not in text
    assert "\r" not in text
    assert "\u202e" not in text
    assert text.count("evil") >= 5


@attrs.frozen
class Scan:
    first: float
    ranges: tuple[float, ...]


class Broken:
    def __repr__(self) -> str:
        raise RuntimeError


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, ""),
        (1.23456789, "1.235"),
        (float("nan"), "nan"),
        (Scan(-2.0943951, (1.0,) * 41), "Scan(first=-2.094, ranges=[1, 1, 1, 1, 1, 1, … 35 more])"),
        ({"left": 0.5}, "{'left': 0.5}"),
        (np.zeros((480, 640)), "float64 array of 480 x 640"),
        (Broken(), "<Broken: RuntimeError>"),
        ("x" * 500, "'" + "x" * (TEXT - 2) + "…"),
    ],
)  # fmt: skip
def test_a_value_is_a_short_text(value, text):
    """Its fields by name, the first of many, the shape of an array; never an error."""
    assert short(value) == text


def test_a_large_value_is_not_encoded_to_be_looked_at():
    """By its size alone, also where it is a field."""
    assert size_of(b"x" * 10_000_000) == 10_000_000
    assert size_of(Scan(0.0, (1.0,) * 1_000_000)) == 8_000_008
    assert size_of({"images": [np.zeros(10)]}) == 80
    assert size_of(np.zeros(10_000_000, np.uint8)) == 10_000_000
    assert size_of(Scan(0.0, (1.0,) * 41)) < 1000
    assert len(short(Scan(0.0, (1.0,) * 1_000_000))) <= TEXT
