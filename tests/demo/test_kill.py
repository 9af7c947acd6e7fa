"""``esair demo --kill``: what is shown is what came over the line."""

from __future__ import annotations

import io
import signal

import pytest
from rich.console import Console

from esair.demo import _kill
from esair.demo._kill import Death, die, kill

MOVES = (-0.05, b"speed=0.3")


@pytest.mark.parametrize(
    ("lines", "safe"),
    [
        ((MOVES, (0.003, b""), (0.004, b"speed=0")), 0.004),
        ((MOVES, (0.001, b"speed=0.3"), (0.01, b"speed=0"), (0.02, b"speed=0")), 0.01),
        ((MOVES, (0.004, b"speed=0"), (0.1, b"speed=0.3")), None),
        ((MOVES,), None),
        (((0.004, b"speed=0"),), None),
    ],
)
def test_safe_is_what_came_last_and_stayed(
    lines: tuple[tuple[float, bytes], ...], safe: float | None
) -> None:
    """A motion after it, no word at all, or wheels that never moved, are no success."""
    assert Death(lines, "").safe_after == safe


@pytest.mark.long
@pytest.mark.real_clock
@pytest.mark.promise("GRD-1")
def test_a_killed_robot_is_shown_to_be_safe(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last line is the safe frame of the watchdog, within the second."""
    monkeypatch.setattr(_kill, "WAYS", {signal.SIGKILL: "killed"})
    text = io.StringIO()

    assert kill(Console(file=text, width=100)) == 0

    assert "the wheels are safe after" in text.getvalue()
    assert "its process died: wheels safe" in text.getvalue()


@pytest.mark.real_clock
def test_a_robot_that_never_drives_is_no_success(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What it said at its end is shown."""
    monkeypatch.setattr(_kill, "DRIVES", 1)
    monkeypatch.setattr(_kill, "PATIENCE", 0.0)

    death = die(signal.SIGKILL)

    assert death.safe_after is None
