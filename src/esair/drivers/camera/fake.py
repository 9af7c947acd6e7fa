"""A camera that plays pictures."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np

from esair.drivers.camera import CameraRequest

Picture = np.ndarray[Any, Any]


class FakeCamera:
    """Plays pictures again and again; ``open`` is the opener of a `Camera`.

    Args:
        pictures: Arrays of ``uint8`` with the shape (height, width, 3), blue, green and
            red; or files of ``numpy.save`` with one.
        fps: How many it takes in a second.

    Attributes:
        pictures: What it plays now; change it.
        taken: How many pictures it has taken.
        silent: Whether it takes none, as one that hangs.
        plugged: Whether it is there.
        powered: How often it got its power.
    """

    def __init__(
        self, pictures: Iterable[Picture | str | os.PathLike[str]], *, fps: float = 30.0
    ) -> None:
        self.pictures = [
            each if isinstance(each, np.ndarray) else np.load(each) for each in pictures
        ]
        self.fps = fps
        self.taken = 0
        self.silent = False
        self.powered: int = 1
        self.plugged: bool = True

    def open(self, request: CameraRequest) -> _FakeLink:
        """Open it.

        Raises:
            OSError: It is unplugged.
        """
        if not self.plugged:
            raise FileNotFoundError(f"no camera is {request.device!r}")
        return _FakeLink(self)

    def unplug(self) -> None:
        """Be gone, from this moment on."""
        self.plugged = False

    def plug(self) -> None:
        """Be there again."""
        self.plugged = True

    def power_cycle(self) -> None:
        """Lose the power for a moment: it is there again, and nobody has it open."""
        self.powered += 1


class _FakeLink:
    def __init__(self, camera: FakeCamera) -> None:
        self.pace: float = 1.0 / camera.fps
        self._camera = camera
        self._powered = camera.powered
        self._picture: Picture | None = None

    def grab(self) -> bool:
        camera = self._camera
        is_there = camera.plugged and camera.powered == self._powered
        if not is_there or camera.silent:
            return False
        self._picture = camera.pictures[camera.taken % len(camera.pictures)]
        camera.taken += 1
        return True

    def retrieve(self) -> Picture | None:
        return self._picture

    def close(self) -> None:
        self._picture = None
