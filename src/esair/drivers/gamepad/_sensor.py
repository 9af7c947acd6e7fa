"""A pad that pushes what the hands on it do."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from typing import Any, Protocol, Unpack

from esair.drivers._on_descriptor import arrivals
from esair.drivers.gamepad._find import find_pad
from esair.drivers.gamepad._pad import (
    AXES,
    BUTTONS,
    SYN,
    SYN_DROPPED,
    SYN_REPORT,
    Axis,
    Pad,
    PadState,
)
from esair.exceptions import ConfigError, DeviceLostError, describe, did_you_mean
from esair.resources import Sensor, SensorSettings, setting
from esair.values import check_seconds


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
        self._opener = opener or _open_pad
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

    def __init__(self, path: str) -> None:
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


def _open_pad(device: str) -> PadLink:
    return _Pad(find_pad(device))
