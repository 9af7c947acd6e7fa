"""Digital inputs and outputs on the lines of a GPIO chip, through libgpiod 2.

::

    [sensor.bumper]
    driver = "gpio"
    chip = "pinctrl-bcm2711"        # a label, a name, or a path
    line = 17                       # or a name, such as "GPIO17"
    bias = "pull_up"
    active_low = true

    [actuator.lamp]
    driver = "gpio"
    chip = "/dev/gpiochip0"
    line = "GPIO27"

Values are logical: with ``active_low`` a low voltage is True.

Source: the kernel's GPIO character device, version 2 (linux/gpio.h), by libgpiod.
"""

from __future__ import annotations

import contextlib
import errno
import select
import struct
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import (
    Any,
    Literal,
    NamedTuple,
    Protocol,
    Required,
    TypedDict,
    Unpack,
    get_args,
)

import attrs

from esair.buses.finding import ROOT, Device, entries, quoted, read
from esair.drivers._on_descriptor import arrivals
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    hint_for,
)
from esair.loading import of_extra
from esair.resources import (
    Actuator,
    ActuatorSettings,
    Resource,
    Sensor,
    SensorSettings,
    setting,
)
from esair.values import check_choice, check_whole
from esair.watchdog import Outlet, SafeFrames

__all__ = ["DigitalInput", "DigitalOutput", "devices", "toml"]


def devices(root: Path = ROOT) -> list[Device]:
    """Return the GPIO chips that are there, by their numbers."""
    gpiod = _gpiod() if root == ROOT else None
    known = {
        place.name: _look(place, root) if gpiod is None else _ask(gpiod, place.name)
        for place in entries(root / "sys/bus/gpio/devices")
        if place.name.startswith("gpiochip") and (root / "dev" / place.name).exists()
    }
    labels = [label for label, _, _ in known.values()]
    return [
        Device(
            kind="gpio",
            path=f"/dev/{name}",
            # Numbers depend on the order in which drivers come.
            address=label if label and labels.count(label) == 1 else f"/dev/{name}",
            description=label,
            state=state,
            lines=lines,
        )
        for name, (label, lines, state) in known.items()
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for an input on the first line of a chip."""
    return [
        f"[sensor.{name}_line0]",
        'driver = "gpio"',
        f"chip = {quoted(device.address)}",
        "line = 0",
    ]


def _gpiod() -> Any:
    """Return the bindings of libgpiod; None if they are not there, or those of 1.x."""
    with contextlib.suppress(ImportError):
        import gpiod

        return gpiod if hasattr(gpiod, "LineSettings") else None
    return None


def _ask(gpiod: Any, name: str) -> tuple[str, int | None, str]:
    try:
        with gpiod.Chip(f"/dev/{name}") as chip:
            info = chip.get_info()
    except PermissionError:
        return "", None, "no permission"
    except OSError:  # it is just being unplugged
        return "", None, ""
    label = "".join(each if each.isprintable() else "?" for each in info.label)
    return label, info.num_lines, ""


def _look(place: Path, root: Path) -> tuple[str, int | None, str]:
    """Look into the old class of GPIO, which says it without opening the chip."""
    parent = place.resolve().parent
    for old in entries(root / "sys/class/gpio"):
        if (old / "ngpio").exists() and (old / "device").resolve() == parent:
            lines = read(old / "ngpio")
            return read(old / "label"), int(lines) if lines.isdecimal() else None, ""
    return "", None, ""


CHECK_PERIOD = 0.5
"""How often an input that does not change is looked after, in seconds."""

Bias = Literal["as_is", "disabled", "pull_up", "pull_down"]
Drive = Literal["push_pull", "open_drain", "open_source"]


@attrs.frozen
class LineRequest:
    """Which line is wanted, and how it is to be set.

    Attributes:
        device: The name of the device, for errors.
        chip: The path, the name or the label of the chip.
        line: The number or the name of the line.
        output: What an output is at first; None for an input.
        bias: The resistor of an input.
        drive: What an output drives.
        active_low: Whether a low voltage is True.
        debounce: How long an input must be steady to count, in seconds.
    """

    device: str
    chip: str
    line: int | str
    output: bool | None = None
    bias: Bias = "as_is"
    drive: Drive = "push_pull"
    active_low: bool = False
    debounce: float = 0.0


class Edge(NamedTuple):
    """A change of an input.

    Attributes:
        value: What it is now.
        number: Counts the changes of the line, those that were dropped too.
    """

    value: bool
    number: int


class Line(Protocol):
    """One line that was requested. Its methods may block, but `edges` does not."""

    def fileno(self) -> int:
        """Return a descriptor that is readable when there are edges."""

    def get(self) -> bool:
        """Return what the line is."""

    def set(self, value: bool) -> None:
        """Set an output."""

    def edges(self) -> list[Edge]:
        """Return the changes since the last call, when the descriptor is readable."""

    def debounce(self, seconds: float) -> None:
        """Change how long an input must be steady to count."""

    def close(self) -> None:
        """Let the line go."""


LineOpener = Callable[[LineRequest], Line]
"""Requests a line; may block. Raises what the drivers raise."""


class _OnLine(Resource):
    """What inputs and outputs have in common: a line that is open, or not."""

    claim: str | None

    def __init__(
        self,
        *,
        chip: str,
        line: int | str,
        active_low: bool = False,
        opener: LineOpener | None = None,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        if not chip:
            raise ConfigError(
                self.name, "chip", "expected a path, a name or a label of a GPIO chip"
            )
        if not isinstance(line, str):
            check_whole(self.name, "line", line, 0)
        self.claim = f"line {line} of {chip}"
        self._request = LineRequest(self.name, chip, line, active_low=active_low)
        self._opener = opener or gpiod_line
        self._line: Line | None = None

    def open(self) -> None:
        """Request the line."""
        self.close()
        self._line = self._opener(self._request)

    def close(self) -> None:
        """Let the line go."""
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def is_set_up(self) -> bool:
        """Tell whether the line is still there; its chip may have been pulled."""
        self._open.get()
        return True

    @property
    def _open(self) -> Line:
        if self._line is None:
            raise DeviceLostError(self.name, "the line is not open")
        return self._line


class _LineSettings(TypedDict, total=False):
    chip: Required[str]
    line: Required[int | str]
    active_low: bool
    opener: LineOpener | None


class _InputSettings(_LineSettings, SensorSettings, total=False):
    debounce: float


class _OutputSettings(_LineSettings, ActuatorSettings): ...


class DigitalInput(_OnLine, Sensor[bool]):
    """A line that is read: a value when it is asked, and one at each change.

    Args:
        chip: The path, the name or the label of the chip.
        line: The number or the name of the line.
        bias: The resistor: ``"pull_up"``, ``"pull_down"``, ``"disabled"``, ``"as_is"``.
        active_low: Whether a low voltage is True.
        opener: Requests something else than a line of the kernel, such as a fake.

    Attributes:
        missed: How many changes nobody saw, because they came too fast.
    """

    debounce: float = setting(
        0.0,
        unit="s",
        min=0.0,
        max=10.0,
        doc="how long a new value must be steady before it counts",
    )

    def __init__(
        self, *, bias: Bias = "as_is", **settings: Unpack[_InputSettings]
    ) -> None:
        super().__init__(**settings)
        check_choice(self.name, "bias", bias, get_args(Bias))
        self._request = attrs.evolve(self._request, bias=bias)
        self.missed: int = 0
        self._seen = False
        """What it is as far as the stream has told, or was at the opening."""

    def open(self) -> None:
        """Request the line."""
        self._request = attrs.evolve(self._request, debounce=self.debounce)
        super().open()
        self._seen = self._open.get()

    def apply(self, *, debounce: float | None = None, **_: object) -> None:
        """Change the time for which it must be steady."""
        if debounce is not None:
            self._open.debounce(debounce)

    def read(self) -> bool:
        """Ask what the line is."""
        return self._open.get()

    async def stream(self) -> AsyncIterator[bool]:
        """Yield what it is, and each change."""
        line = self._open
        number: int | None = None
        with arrivals(line.fileno(), line.edges) as (descriptor, changes):
            yield self._seen
            while True:
                try:
                    edge = await changes.take(timeout=CHECK_PERIOD)
                except TimeoutError:
                    _check_hang_up(descriptor)
                    continue
                if number is not None:
                    self.missed += edge.number - number - 1
                number, self._seen = edge.number, edge.value
                yield edge.value


class DigitalOutput(_OnLine, Actuator[bool]):
    """A line that is set.

    It is requested with its safe value, so there is no other one in between. What a
    line is after it was let go, or after this process has died, is up to the chip:
    where that matters a resistor decides it.

    Args:
        safe: The safe command.
        drive: What it drives: ``"push_pull"``, ``"open_drain"``, ``"open_source"``.
        **settings: ``chip``, ``line`` and more, as of a `DigitalInput`.
    """

    def __init__(
        self,
        *,
        safe: bool = False,
        drive: Drive = "push_pull",
        **settings: Unpack[_OutputSettings],
    ) -> None:
        super().__init__(**settings)
        if type(safe) is not bool:
            raise ConfigError(self.name, "safe", f"expected a bool, not {safe!r:.80}")
        check_choice(self.name, "drive", drive, get_args(Drive))
        self.safe = safe
        self._request = attrs.evolve(self._request, output=safe, drive=drive)

    @property
    def outlet(self) -> Outlet | None:
        """A duplicate of its line, so that the line stays driven."""
        try:
            return Outlet("gpio", descriptor=self._open.fileno())
        except OSError:  # it is not open
            return None

    def safe_frames(self) -> SafeFrames:
        """The safe value, as the kernel takes it: values, and which of them count."""
        return SafeFrames([struct.pack("=QQ", int(self.safe), 1)])

    def write(self, command: bool) -> None:
        """Set the line."""
        self._open.set(command)


def _check_hang_up(descriptor: int) -> None:
    """Raise if the chip is gone; older kernels do not wake who waits."""
    poll = select.poll()
    poll.register(descriptor, 0)  # errors and hang-ups are told in any case
    if poll.poll(0):
        raise OSError(errno.ENODEV, "the chip is gone")


def gpiod_line(request: LineRequest) -> Line:
    """Request a line of the kernel.

    Raises:
        DeviceLostError: The chip is not there.
        DeviceFaultError: It has no such line, or somebody else has it.
    """
    with of_extra("gpio"):
        import gpiod

    try:
        with gpiod.Chip(_path_of(request)) as chip:
            return _GpiodLine(chip, _offset_of(chip, request), request)
    except FileNotFoundError as error:
        raise DeviceLostError(
            request.device, f"there is no chip {request.chip!r}"
        ) from error


class _GpiodLine:
    def __init__(self, chip: Any, offset: int, request: LineRequest) -> None:
        self._offset = offset
        self._wanted = request
        try:
            self._lines = chip.request_lines(
                {offset: _settings(request)},
                consumer=f"esair {request.device}"[:31],
                event_buffer_size=64,
            )
        except OSError as error:
            if error.errno != errno.EBUSY:
                raise
            consumer = chip.get_line_info(offset).consumer or "the kernel"
            told = f"line {request.line} of {request.chip} is in use by {consumer!r}"
            raise DeviceFaultError(request.device, told) from error

    def fileno(self) -> int:
        return int(self._lines.fd)

    def get(self) -> bool:
        return bool(self._lines.get_value(self._offset).value)

    def set(self, value: bool) -> None:
        from gpiod.line import Value

        self._lines.set_value(self._offset, Value.ACTIVE if value else Value.INACTIVE)

    def edges(self) -> list[Edge]:
        return [
            Edge(event.event_type is event.Type.RISING_EDGE, event.line_seqno)
            for event in self._lines.read_edge_events()
        ]

    def debounce(self, seconds: float) -> None:
        settings = _settings(attrs.evolve(self._wanted, debounce=seconds))
        self._lines.reconfigure_lines({self._offset: settings})

    def close(self) -> None:
        self._lines.release()


def _settings(request: LineRequest) -> Any:
    import datetime

    import gpiod
    from gpiod import line

    if request.output is not None:
        return gpiod.LineSettings(
            direction=line.Direction.OUTPUT,
            drive=line.Drive[request.drive.upper()],
            active_low=request.active_low,
            output_value=line.Value.ACTIVE if request.output else line.Value.INACTIVE,
        )
    return gpiod.LineSettings(
        direction=line.Direction.INPUT,
        edge_detection=line.Edge.BOTH,
        bias=line.Bias[request.bias.upper()],
        active_low=request.active_low,
        debounce_period=datetime.timedelta(seconds=request.debounce),
    )


def _path_of(request: LineRequest) -> str:
    """Return the path of a chip that is named by its path, its name or its label."""
    if "/" in request.chip:
        return request.chip
    chips = [
        (each.path, {Path(each.path).name, each.description}) for each in devices()
    ]
    fitting = [path for path, names in chips if request.chip in names]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        told = f"several chips are named {request.chip!r}: {', '.join(fitting)}"
        raise DeviceFaultError(request.device, told)
    known = sorted(name for _, names in chips for name in names if name)
    hint = hint_for(request.chip, known)
    raise DeviceLostError(request.device, f"there is no chip {request.chip!r}{hint}")


def _offset_of(chip: Any, request: LineRequest) -> int:
    """Return the number of a line that is named by its number or its name."""
    count = int(chip.get_info().num_lines)
    if isinstance(request.line, int):
        if request.line < count:
            return request.line
        raise DeviceFaultError(
            request.device, f"{request.chip} has the lines 0 to {count - 1}"
        )
    names = [chip.get_line_info(offset).name for offset in range(count)]
    if request.line in names:
        return names.index(request.line)
    hint = hint_for(request.line, filter(None, names), "its lines are named")
    raise DeviceFaultError(
        request.device, f"{request.chip} has no line {request.line!r}{hint}"
    )
