"""Cameras that the kernel knows as video devices, by OpenCV.

::

    [sensor.front]
    driver = "camera"
    device = "usb:046d:0825"      # or a path, or the beginning of its name
    width = 640
    height = 480
    fps = 30

    pip install 'esair[camera]'

A reading is a `numpy.ndarray` of ``uint8`` with the shape ``(height, width, 3)``, the top
row first; its colours are blue, green, red (``colors="bgr"``, as OpenCV has them), red,
green, blue (``"rgb"``), or it has the shape ``(height, width)`` (``"gray"``). It cannot be
written: everybody who reads the sensor has the same one; take ``frame.copy()``.

Source: the kernel's ``Documentation/userspace-api/media/v4l``; OpenCV's ``VideoCapture``.
"""

from __future__ import annotations

import asyncio
import functools
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, Protocol, Unpack

import attrs

from esair.buses import finding, open_on, shut_on
from esair.buses.finding import ROOT, Device
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    describe,
)
from esair.loading import of_extra
from esair.loop import Executor
from esair.resources import Sensor, SensorSettings
from esair.values import check_choice, check_seconds, check_whole

if TYPE_CHECKING:
    import numpy as np

__all__ = ["Camera", "CameraLink", "CameraRequest", "devices", "find_camera", "toml"]


def devices(root: Path = ROOT) -> list[Device]:
    """Return the cameras that are there, by their numbers.

    Of the files of one camera the first is its pictures; the others are of no use here.
    """
    return [
        _camera(place, root)
        for place in finding.entries(root / "sys/class/video4linux")
        if place.name.removeprefix("video").isdecimal()
        and finding.read(place / "index") in {"", "0"}
    ]


def toml(device: Device, name: str) -> list[str]:
    """Return the lines of a robot.toml for a camera."""
    return [
        f"[sensor.{name}]",
        'driver = "camera"',
        f"device = {finding.quoted(device.address)}",
        "width = 640",
        "height = 480",
    ]


def find_camera(wanted: str, root: Path = ROOT) -> str:
    """Return the path of a camera; what is wanted, and errors, are those of `pick`."""
    return finding.pick(wanted, devices(root), "camera")


def _camera(place: Path, root: Path) -> Device:
    identity = finding.identity_of(finding.usb_device(place / "device", root))
    path = f"/dev/{place.name}"
    name = finding.read(place / "name")
    return Device(
        kind="camera",
        path=path,
        address=identity or name or path,
        description=name,
        identity=identity,
        state=finding.permission(root / path.removeprefix("/")),
    )


OPEN_TIMEOUT: Final = 10.0
"""How long opening a camera may take, in seconds: some find out their formats."""

BUFFERS: Final = 8
"""How many pictures the kernel may keep for us at most."""

AT_ONCE: Final = 0.002
"""A picture that is there sooner was waiting in the kernel, in seconds."""


@attrs.frozen
class CameraRequest:
    """What is asked of a camera.

    Attributes:
        device: Which one.
        width: How wide its pictures are; as they come if None.
        height: How high they are; as they come if None.
        fps: How many it shall take in a second; as it does if None.
    """

    device: str
    width: int | None = None
    height: int | None = None
    fps: float | None = None


class CameraLink(Protocol):
    """An open camera, used by one thread.

    Attributes:
        pace: How long to wait before each picture, in seconds; 0 where `grab` waits.
    """

    pace: float

    def grab(self) -> bool:
        """Wait for the next picture; tells whether there is one."""

    def retrieve(self) -> np.ndarray[Any, Any] | None:
        """Return the picture that was grabbed: height, width, blue, green and red."""

    def close(self) -> None:
        """Let the camera go."""


class Camera(Sensor[Any]):
    """The pictures of a camera, each as an array; see the module for its shape.

    A thread of its own waits for them. What waits in the kernel while nobody takes it
    is thrown away, so a picture is never older than the time in which one is taken.

    Args:
        device: Its path, ``usb:VID:PID[:SERIAL]``, or the beginning of its name; the only
            camera that is there if empty.
        width: How wide its pictures shall be, in pixels; as they come if None.
        height: How high they shall be, in pixels; as they come if None.
        fps: How many it shall take in a second; as it does if None.
        colors: The order of the colours: ``"bgr"``, ``"rgb"`` or ``"gray"``.
        silent_after: After how many seconds without a picture it is lost.
        opener: Opens something else than a camera of the kernel, such as a fake; may
            block.

    Attributes:
        dropped: How many pictures were thrown away because newer ones were there.
    """

    deadline: float = OPEN_TIMEOUT + 2.0
    counted: ClassVar[tuple[str, ...]] = ("dropped",)

    def __init__(
        self,
        *,
        device: str = "",
        width: int | None = None,
        height: int | None = None,
        fps: float | None = None,
        colors: Literal["bgr", "rgb", "gray"] = "bgr",
        silent_after: float = 2.0,
        opener: Callable[[CameraRequest], CameraLink] | None = None,
        **settings: Unpack[SensorSettings],
    ) -> None:
        super().__init__(**settings)
        for field, pixels in (("width", width), ("height", height)):
            if pixels is not None:
                check_whole(self.name, field, pixels, 1)
        if fps is not None and not 0 < fps <= 1000:
            raise ConfigError(self.name, "fps", f"expected 1 to 1000, not {fps!r:.80}")
        if (width is None) is not (height is None):
            raise ConfigError(self.name, "height", "expected both, width and height")
        self.colors = check_choice(self.name, "colors", colors, ("bgr", "rgb", "gray"))
        self.silent_after: float = check_seconds(
            self.name, "silent_after", silent_after
        )
        self.dropped: int = 0
        with of_extra("camera"):
            import numpy as np
        self._array = np.ndarray
        self._request = CameraRequest(device, width, height, fps)
        self._opener = opener or _Capture
        self._executor: Executor | None = None
        self._hanging: Executor | None = None
        self._link: CameraLink | None = None

    @property
    def value_type(self) -> Any:
        """An array of numpy."""
        return self._array

    async def open(self) -> None:
        """Find the camera, open it and wait for its first picture.

        Raises:
            DeviceLostError: It is not there, or takes no picture.
        """
        await self.close()
        if self._hanging is not None and self._hanging.stuck_since is not None:
            raise DeviceLostError(self.name, "an earlier picture is still waited for")
        self._executor = executor = Executor(f"{self.name}_camera")
        make = functools.partial(self._opener, self._request)
        try:
            self._link = await open_on(
                executor, make, lambda link: link.close(), timeout=OPEN_TIMEOUT
            )
        except DriverStuckError:
            raise
        except OSError as error:
            raise DeviceLostError(self.name, describe(error)) from error
        await self._next()

    async def close(self) -> None:
        """Let the camera go, once its thread has come back."""
        executor, self._executor = self._executor, None
        link, self._link = self._link, None
        if executor is None:
            return
        if link is not None:
            await shut_on(executor, link.close, timeout=1.0)
        if not await executor.join(timeout=0.2):
            self._hanging = executor  # or there would be a thread for each attempt

    async def stream(self) -> AsyncIterator[np.ndarray[Any, Any]]:
        """Yield each picture, the newest one."""
        while True:
            yield await self._next()

    async def _next(self) -> np.ndarray[Any, Any]:
        executor, link = self._executor, self._link
        if executor is None or link is None:
            raise DeviceLostError(self.name, "the camera is not open")
        if link.pace:
            await asyncio.sleep(link.pace)
        try:
            picture, dropped = await executor.call(
                _take, link, self.colors, timeout=self.silent_after
            )
        except DriverStuckError:
            raise DeviceLostError(
                self.name, f"no picture for {self.silent_after:g} s"
            ) from None
        if picture is None:
            raise DeviceLostError(self.name, "it takes no picture any more")
        self.dropped += dropped
        wanted = self._request.height, self._request.width
        if None not in wanted and picture.shape[:2] != wanted:
            height, width = picture.shape[:2]
            raise DeviceFaultError(
                self.name, f"its pictures are {width} x {height}: it has no other size?"
            )
        return picture


def _take(link: CameraLink, colors: str) -> tuple[np.ndarray[Any, Any] | None, int]:
    """Take the newest picture, in the thread; and how many older ones there were."""
    import numpy as np

    dropped = -1
    while dropped < BUFFERS:
        begin = time.monotonic()
        if not link.grab():
            return None, 0
        dropped += 1
        if link.pace or time.monotonic() - begin > AT_ONCE:
            break  # it was waited for
    picture = link.retrieve()
    if picture is None:
        return None, 0
    if colors == "rgb":
        picture = picture[:, :, ::-1]
    elif colors == "gray":  # as ITU-R BT.601 weighs them, and OpenCV
        weighed = picture @ np.array((29, 150, 77), dtype=np.uint32)
        picture = (weighed >> 8).astype(np.uint8)
    picture = np.ascontiguousarray(picture)
    picture.flags.writeable = False
    return picture, dropped


class _Capture:
    """A camera of the kernel, by OpenCV."""

    pace = 0.0

    def __init__(self, request: CameraRequest) -> None:
        path = find_camera(request.device)
        try:
            import cv2
        except ImportError as error:
            raise ConfigError(
                "camera", "driver", f"pip install 'esair[camera]': {describe(error)}"
            ) from error
        with open(path, "rb"):  # says why, which OpenCV does not
            pass
        self._capture: Any = cv2.VideoCapture(path, cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise OSError(f"{path} takes no pictures")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        for what, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, request.width),
            (cv2.CAP_PROP_FRAME_HEIGHT, request.height),
            (cv2.CAP_PROP_FPS, request.fps),
        ):
            if value is not None:
                self._capture.set(what, value)

    def grab(self) -> bool:
        return bool(self._capture.grab())

    def retrieve(self) -> np.ndarray[Any, Any] | None:
        there, picture = self._capture.retrieve()
        return picture if there else None

    def close(self) -> None:
        self._capture.release()
