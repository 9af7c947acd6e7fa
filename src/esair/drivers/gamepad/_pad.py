"""What the events of the kernel mean: sticks from -1 to 1, buttons by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

import attrs

SYN, KEY, ABS = 0, 1, 3
"""The types of events that count."""

SYN_REPORT, SYN_DROPPED = 0, 3

BUTTONS: Final[dict[int, str]] = {
    0x130: "south", 0x131: "east", 0x133: "north", 0x134: "west",
    0x136: "tl", 0x137: "tr", 0x138: "tl2", 0x139: "tr2",
    0x13A: "select", 0x13B: "start", 0x13C: "mode",
    0x13D: "thumbl", 0x13E: "thumbr",
    0x220: "up", 0x221: "down", 0x222: "left", 0x223: "right",
    0x120: "trigger", 0x121: "thumb", 0x122: "thumb2", 0x123: "top", 0x124: "top2",
}  # fmt: skip
"""Buttons by their codes; others are called by theirs, such as ``"button_0x2c0"``."""

AXES: Final[dict[int, str]] = {
    0: "x", 1: "y", 2: "z", 3: "rx", 4: "ry", 5: "rz",
    6: "throttle", 7: "rudder", 8: "wheel", 9: "gas", 10: "brake",
    16: "hat_x", 17: "hat_y",
}  # fmt: skip
"""Axes by their codes; others are no axes of a pad."""

_DOWN_IS_POSITIVE: Final = frozenset({1, 4, 17})
_MAY_BE_TRIGGERS: Final = frozenset({2, 5, 9, 10})


@attrs.frozen
class Pad:
    """What the hands on a pad do.

    Attributes:
        axes: Sticks from -1 to 1, right and up are positive; triggers from 0 to 1. All
            are 0 while the dead man's button is not held.
        buttons: The names of those that are pressed.
        held: Whether the dead man's button is held; True if there is none.
    """

    axes: Mapping[str, float]
    buttons: frozenset[str]
    held: bool

    def axis(self, name: str) -> float:
        """Return an axis; 0 if the pad has none of that name."""
        return self.axes.get(name, 0.0)


@attrs.frozen
class Axis:
    """An axis as the kernel has it.

    Attributes:
        least: Its least number.
        most: Its greatest number.
        value: Where it is.
    """

    least: int
    most: int
    value: int


class PadState:
    """The state of a pad, from one event to the next.

    Args:
        axes: Its axes by their codes.
        pressed: The codes of the buttons that are pressed.
        dead_man: The name of the dead man's button; None if there is none.
        dead_zone: How far from its middle a stick counts as in it, 0 to 1.
    """

    def __init__(
        self,
        axes: Mapping[int, Axis],
        pressed: Iterable[int],
        *,
        dead_man: str | None = None,
        dead_zone: float = 0.1,
    ) -> None:
        self._dead_man = dead_man
        self._dead_zone = dead_zone
        self._axes = {code: axis for code, axis in axes.items() if code in AXES}
        # What rests at its end is a trigger; sticks of some pads have the same codes.
        self._triggers = {
            code
            for code, axis in self._axes.items()
            if code in _MAY_BE_TRIGGERS
            and axis.value <= axis.least + (axis.most - axis.least) / 8
        }
        self._pressed = set(pressed)
        self._must_let_go = False

    def renew(self, axes: Mapping[int, Axis], pressed: Iterable[int]) -> None:
        """Be as the kernel says now: events were lost."""
        self._axes.update({code: axes[code] for code in self._axes if code in axes})
        self._pressed = set(pressed)
        self._look_at_dead_man()

    def be_still(self) -> None:
        """Count the dead man's button as let go, until it is let go and pressed anew."""
        self._must_let_go = True
        self._look_at_dead_man()

    def take(self, kind: int, code: int, value: int) -> None:
        """Take an event that is a change."""
        if kind == ABS and code in self._axes:
            self._axes[code] = attrs.evolve(self._axes[code], value=value)
        elif kind == KEY:
            (self._pressed.add if value else self._pressed.discard)(code)
            self._look_at_dead_man()

    def _look_at_dead_man(self) -> None:
        if _names(self._pressed).isdisjoint({self._dead_man}):
            self._must_let_go = False

    def pad(self) -> Pad:
        """Return what it is now."""
        buttons = _names(self._pressed)
        held = self._dead_man is None or self._dead_man in buttons
        held = held and not self._must_let_go
        axes = {
            AXES[code]: self._scaled(code, axis) if held else 0.0
            for code, axis in self._axes.items()
        }
        return Pad(axes, buttons, held)

    def _scaled(self, code: int, axis: Axis) -> float:
        span = axis.most - axis.least
        if span <= 0:
            return 0.0
        share = (axis.value - axis.least) / span
        if code not in self._triggers:
            share = 2 * share - 1
            if code in _DOWN_IS_POSITIVE:
                share = -share
        beyond = (abs(share) - self._dead_zone) / (1 - self._dead_zone)
        if beyond <= 0:
            return 0.0
        return min(1.0, beyond) if share > 0 else -min(1.0, beyond)


def _names(codes: Iterable[int]) -> frozenset[str]:
    return frozenset(BUTTONS.get(code, f"button_{code:#x}") for code in codes)
