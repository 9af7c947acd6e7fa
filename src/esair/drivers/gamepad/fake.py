"""A gamepad whose sticks and buttons are moved by a test."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Mapping

from esair.drivers._on_descriptor import FakeDescriptor
from esair.drivers.gamepad import AXES, BUTTONS, Axis

_CODES = {name: code for code, name in BUTTONS.items()}
_AXES = {name: code for code, name in AXES.items()}


class FakeGamepad:
    """A pad with two sticks, two triggers and a hat; ``open`` is the opener of a `Gamepad`.

    Example:
        >>> far = FakeGamepad()
        >>> pad = Gamepad(opener=far.open, dead_man="tl")
        >>> far.press("tl")
        >>> far.move("y", 1.0)
    """

    buffer = 64
    """How many events the kernel keeps until they are read; then all are dropped."""

    def __init__(self) -> None:
        sticks = dict.fromkeys((0, 1, 3, 4), Axis(-32768, 32767, 0))
        triggers = dict.fromkeys((2, 5), Axis(0, 255, 0))
        hats = dict.fromkeys((16, 17), Axis(-1, 1, 0))
        self._axes: dict[int, Axis] = {**sticks, **triggers, **hats}
        self._pressed: set[int] = set()
        self._plugged = True
        self._links: list[_FakeLink] = []

    def open(self, device: str) -> _FakeLink:
        """Open it.

        Raises:
            OSError: It is unplugged.
        """
        if not self._plugged:
            raise FileNotFoundError(errno.ENOENT, "no such pad", device)
        link = _FakeLink(self)
        self._links.append(link)
        return link

    def press(self, *buttons: str) -> None:
        """Press buttons, by name, and hold them."""
        for button in buttons:
            self._pressed.add(_CODES[button])
            self._tell(1, _CODES[button], 1)

    def release(self, *buttons: str) -> None:
        """Let buttons go."""
        for button in buttons:
            self._pressed.discard(_CODES[button])
            self._tell(1, _CODES[button], 0)

    def move(self, axis: str, value: float) -> None:
        """Move an axis: a stick from -1 to 1, up and right; a trigger from 0 to 1."""
        code = _AXES[axis]
        known = self._axes[code]
        if known.least < 0:
            value = ((-value if code in {1, 4, 17} else value) + 1) / 2
        raw = round(known.least + value * (known.most - known.least))
        self._axes[code] = Axis(known.least, known.most, raw)
        self._tell(3, code, raw)

    def unplug(self) -> None:
        """Be gone, from this moment on."""
        self._plugged = False
        links, self._links = self._links, []
        for link in links:
            link.is_gone = True
            link.wake()

    def plug(self) -> None:
        """Be there again."""
        self._plugged = True

    def power_cycle(self) -> None:
        """Lose the power for a moment: it is there again, and nobody has it open."""
        self.unplug()
        self.plug()

    def axes(self) -> Mapping[int, Axis]:
        """Return the axes as they are."""
        return dict(self._axes)

    def pressed(self) -> Iterable[int]:
        """Return the codes of the buttons that are pressed."""
        return tuple(self._pressed)

    def forget(self, link: _FakeLink) -> None:
        """Tell a link nothing more."""
        if link in self._links:
            self._links.remove(link)

    def _tell(self, kind: int, code: int, value: int) -> None:
        for link in tuple(self._links):
            link.tell((kind, code, value))


class _FakeLink(FakeDescriptor):
    def __init__(self, pad: FakeGamepad) -> None:
        super().__init__()
        self.is_gone = False
        self._pad = pad
        self._events: list[tuple[int, int, int]] = []

    def events(self) -> list[tuple[int, int, int]]:
        self._check()
        os.eventfd_read(self._event)
        events, self._events = self._events, []
        return events

    def axes(self) -> Mapping[int, Axis]:
        self._check()
        return self._pad.axes()

    def pressed(self) -> Iterable[int]:
        return self._pad.pressed()

    def close(self) -> None:
        self._pad.forget(self)
        super().close()

    def _check(self) -> None:
        if self.is_gone:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    def tell(self, event: tuple[int, int, int]) -> None:
        if len(self._events) + 2 > self._pad.buffer:
            self._events = [(0, 3, 0)]
        self._events += [event, (0, 0, 0)]
        self.wake()
