"""Gamepads and joysticks of the kernel's input system, with a dead man's button.

::

    [sensor.pad]
    driver = "gamepad"
    device = "usb:045e:028e"      # or a path, or the beginning of its name
    dead_man = "tl"               # the left shoulder; nothing moves unless it is held

    pip install 'esair[gamepad]'

The package evdev is built from its source, which needs a compiler and the headers of Python
and Linux (``apt install python3-dev linux-libc-dev gcc``).

A pad that loses its radio link says nothing for seconds, until the kernel gives it up:
its sticks and buttons stay as they were; one with a dongle of its own may never say that it
is gone. Where that matters it needs a cable, or ``still_after = 1.0``: a hand that has not
moved at all for so long holds nothing any more.

Source: the kernel's ``Documentation/input/gamepad.rst`` and ``linux/input-event-codes.h``.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Protocol, Unpack

import attrs

from esair.buses import finding
from esair.buses.finding import ROOT, Device
from esair.drivers._on_descriptor import arrivals
from esair.exceptions import ConfigError, DeviceLostError, describe, did_you_mean
from esair.resources import Sensor, SensorSettings, setting
from esair.values import check_seconds

__all__ = [
    "AXES",
    "BUTTONS",
    "Axis",
    "Gamepad",
    "Pad",
    "PadLink",
    "PadState",
    "devices",
    "find_pad",
    "toml",
]

_GAMEPAD, _JOYSTICK = 0x130, 0x120
"""A pad has the first of these buttons, and a joystick the second."""


def devices(root: Path = ROOT) -> list[Device]:
    """Return the pads that are there, by the numbers of their events."""
    return [
        _pad(place, root)
        for place in finding.entries(root / "sys/class/input")
        if place.name.removeprefix("event").isdecimal() and _is_pad(place)
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a pad."""
    return [
        f"[sensor.{name}]",
        'driver = "gamepad"',
        f"device = {finding.quoted(device.address)}",
        'dead_man = "tl"',
    ]


def find_pad(wanted: str, root: Path = ROOT) -> str:
    """Return the path of a pad; what is wanted, and errors, are those of `pick`."""
    return finding.pick(wanted, devices(root), "pad")


def _is_pad(place: Path) -> bool:
    # The bits of the buttons, the highest word first, in hexadecimal.
    bits, size = 0, 64
    for word in finding.read(place / "device/capabilities/key", 1024).split():
        try:
            bits = bits << size | int(word, 16)
        except ValueError:
            return False
    return bool(bits >> _GAMEPAD & 1 or bits >> _JOYSTICK & 1)


def _pad(place: Path, root: Path) -> Device:
    path = f"/dev/input/{place.name}"
    name = finding.read(place / "device/name")
    identity = None
    if finding.read(place / "device/id/bustype") == "0003":  # USB
        try:
            found = finding.UsbIdentity(
                int(finding.read(place / "device/id/vendor"), 16),
                int(finding.read(place / "device/id/product"), 16),
                finding.read(place / "device/uniq"),
            )
            identity = str(found)
        except ValueError:  # it is just being unplugged
            identity = None
    return Device(
        kind="gamepad",
        path=path,
        address=identity or name or path,
        description=name,
        identity=identity,
        state=finding.permission(root / path.removeprefix("/")),
    )


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
_TRIGGERS: Final = frozenset({9, 10})
_MAY_BE_TRIGGERS: Final = frozenset({2, 5})


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
        # Where sticks have a middle of 0 that tells them apart, whatever is held now.
        signed = any(axis.least < 0 for code, axis in self._axes.items() if code < 2)
        self._triggers = {
            code
            for code, axis in self._axes.items()
            if code in _TRIGGERS
            or (
                code in _MAY_BE_TRIGGERS
                and axis.least >= 0
                and (signed or axis.value <= axis.least + (axis.most - axis.least) / 8)
            )
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


class PadLink(Protocol):
    """An open pad; its methods do not wait."""

    def fileno(self) -> int:
        """Return a descriptor that is readable when there are events."""

    def events(self) -> list[tuple[int, int, int]]:
        """Return the events that have come: type, code, value.

        Raises:
            OSError: The pad is gone.
        """

    def axes(self) -> Mapping[int, Axis]:
        """Return its axes as they are now, by their codes."""

    def pressed(self) -> Iterable[int]:
        """Return the codes of the buttons that are pressed."""

    def close(self) -> None:
        """Let it go."""


class _Settings(SensorSettings, total=False):
    repeat: float


class Gamepad(Sensor[Pad]):
    """What the hands on a pad do: at each change, and again and again.

    With ``dead_man`` all axes are 0 unless that button is held, so that a pad that was
    put down moves nothing; one that is held when the pad comes back must be pressed
    anew. What is pushed is repeated, so a reading with a ``max_age`` is there as long as
    the pad is; a pad that is unplugged is lost at once.

    Args:
        device: Its path, ``usb:VID:PID[:SERIAL]``, or the beginning of its name; the only
            pad that is there if empty.
        dead_man: The name of the dead man's button, such as ``"tl"``; None for none.
        dead_zone: How far from its middle a stick counts as in it, 0 to 0.9.
        still_after: After how many seconds without any move of a hand the dead man's
            button counts as let go, until it is pressed anew: for a pad by radio, whose
            sticks and buttons stay as they were when its battery is empty. It may be
            held for ever if None.
        opener: Opens something else than a pad of the kernel, such as a fake; gets
            ``device``, may block.
    """

    repeat: float = setting(
        20.0, unit="Hz", min=1.0, max=100.0, doc="how often it is told without a change"
    )

    def __init__(
        self,
        *,
        device: str = "",
        dead_man: str | None = None,
        dead_zone: float = 0.1,
        still_after: float | None = None,
        opener: Callable[[str], PadLink] | None = None,
        **settings: Unpack[_Settings],
    ) -> None:
        super().__init__(**settings)
        if dead_man is not None and dead_man not in BUTTONS.values():
            hint = did_you_mean(dead_man, BUTTONS.values())
            told = (
                f"no button {dead_man!r}{hint}; there are {', '.join(BUTTONS.values())}"
            )
            raise ConfigError(self.name, "dead_man", told)
        if not 0 <= dead_zone <= 0.9:
            raise ConfigError(
                self.name, "dead_zone", f"expected 0 to 0.9, not {dead_zone!r:.80}"
            )
        if still_after is not None:
            check_seconds(self.name, "still_after", still_after)
            if dead_man is None:
                raise ConfigError(
                    self.name, "still_after", "expected a dead_man, which it is about"
                )
        self.still_after = still_after
        self.device = device
        self.dead_man = dead_man
        self.dead_zone = dead_zone
        self._opener = opener or _Pad
        self._link: PadLink | None = None

    def open(self) -> None:
        """Find the pad and open it.

        Raises:
            DeviceLostError: It is not there, or may not be read.
        """
        try:
            self._link = self._opener(self.device)
        except OSError as error:
            raise DeviceLostError(self.name, describe(error)) from error

    def close(self) -> None:
        """Let the pad go."""
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def apply(self, **_: object) -> None:
        """Take another rhythm with the next repetition."""

    async def stream(self) -> AsyncIterator[Pad]:
        """Yield what it is, each change, and the same again where nothing changes."""
        loop = asyncio.get_running_loop()
        link = self._link
        if link is None:
            raise DeviceLostError(self.name, "the pad is not open")
        state = PadState(
            link.axes(),
            link.pressed(),
            dead_man=self.dead_man,
            dead_zone=self.dead_zone,
        )
        state.be_still()  # what was held before counts from now on, pressed anew
        dropped = False

        def changed() -> Iterator[Pad]:
            nonlocal dropped
            for kind, code, value in link.events():
                if kind != SYN:
                    state.take(kind, code, value)
                elif code == SYN_DROPPED:
                    dropped = True
                elif code == SYN_REPORT:
                    if dropped:  # what came since was only a part of it
                        dropped = False
                        state.renew(link.axes(), link.pressed())
                    yield state.pad()

        pad = state.pad()
        moved = loop.time()
        with arrivals(link.fileno(), changed) as (_, changes):
            while True:
                yield pad
                try:
                    pad = await changes.take(timeout=1.0 / self.repeat)
                    moved = loop.time()
                except TimeoutError:
                    still = loop.time() - moved
                    if self.still_after is not None and still >= self.still_after:
                        state.be_still()
                        pad = state.pad()


class _Pad:
    """A pad of the kernel, by the package evdev."""

    def __init__(self, device: str) -> None:
        path = find_pad(device)
        try:
            import evdev
        except ImportError as error:
            raise ConfigError(
                "gamepad", "driver", f"pip install 'esair[gamepad]': {describe(error)}"
            ) from error
        self._device: Any = evdev.InputDevice(path)

    def fileno(self) -> int:
        return int(self._device.fd)

    def events(self) -> list[tuple[int, int, int]]:
        try:
            return [(each.type, each.code, each.value) for each in self._device.read()]
        except BlockingIOError:
            return []

    def axes(self) -> Mapping[int, Axis]:
        found = {}
        for code, _ in self._device.capabilities(absinfo=True).get(3, ()):
            if code in AXES:
                info = self._device.absinfo(code)
                found[code] = Axis(info.min, info.max, info.value)
        return found

    def pressed(self) -> Iterable[int]:
        codes: list[int] = self._device.active_keys()
        return codes

    def close(self) -> None:
        self._device.close()
