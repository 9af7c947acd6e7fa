"""Cameras: pictures as arrays, the newest wins, off the loop; who is plugged in."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.drivers.parts import Powered

import esair
from esair import discovery
from esair.drivers import camera
from esair.drivers.camera import Camera, devices, find_camera
from esair.drivers.camera.fake import FakeCamera
from esair.exceptions import (
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.testing import SensorContract

pytestmark = pytest.mark.virtual_clock


def picture(shade: int = 0, height: int = 4, width: int = 6) -> Any:
    """A picture that is blue at the top and red elsewhere."""
    made = np.zeros((height, width, 3), dtype=np.uint8)
    made[0, :, 0] = 200
    made[1:, :, 2] = shade
    return made


class TestCamera(Powered, SensorContract):
    def make(self) -> Camera:
        self.far = FakeCamera([picture(1), picture(2)])
        return Camera(opener=self.far.open, width=6, height=4)

    async def unplug(self, _device: Any) -> None:
        self.far.unplug()

    keeps_nothing = "the kernel gives it a new device, which is opened again"


async def first(device: Camera) -> Any:
    await device.open()
    stream: Any = device.stream()
    try:
        return await anext(stream)
    finally:
        await stream.aclose()
        await device.close()


async def test_a_picture_has_the_shape_and_the_order_that_is_said() -> None:
    """Rows first, the top one first; nobody can draw into what others read."""
    far = FakeCamera([picture(90)])
    found = {
        colors: await first(Camera(opener=far.open, colors=colors))
        for colors in ("bgr", "rgb", "gray")
    }
    assert found["bgr"].shape == found["rgb"].shape == (4, 6, 3)
    assert found["bgr"][0, 0].tolist() == [200, 0, 0]
    assert found["rgb"][0, 0].tolist() == [0, 0, 200]
    assert found["rgb"][1, 0].tolist() == [90, 0, 0]
    assert found["gray"].shape == (4, 6)
    assert found["gray"][0, 0] == 200 * 29 // 256
    for each in found.values():
        assert each.dtype == np.uint8
        with pytest.raises(ValueError, match="read-only"):
            each[0, 0] = 1


async def test_it_is_a_sensor_as_any_other() -> None:
    """A robot reads it; the pictures come at the pace of the camera."""
    far = FakeCamera([picture(n) for n in range(10)], fps=20.0)
    seen: list[int] = []

    def look(frame: Any) -> None:
        seen.append(int(frame[1, 0, 2]))

    class Look(esair.Behavior):
        eye = esair.reads(np.ndarray)

        async def run(self) -> None:
            async for each in self.eye:
                look(each)

    robot = esair.Robot(
        resources=[Camera(name="eye", opener=far.open)], behaviors=[Look()]
    )
    async with robot:
        await asyncio.sleep(2.02)
    assert len(seen) in {39, 40, 41}
    assert seen[:5] == [seen[0] + n for n in range(5)]


@pytest.mark.fault("D14")
async def test_a_camera_that_hangs_is_lost_and_comes_back() -> None:
    """As one that was pulled."""
    far = FakeCamera([picture()])
    async with esair.Robot(resources=[Camera(name="eye", opener=far.open)]) as robot:
        await asyncio.sleep(0.2)
        for event in ("silent", "unplugged"):
            before = robot.resources.query("eye").losses
            far.silent = event == "silent"
            if event == "unplugged":
                far.unplug()
            await asyncio.sleep(0.2)
            assert robot.resources.query("eye").losses > before
            far.silent = False
            far.plug()
            await asyncio.sleep(6.0)
            assert robot.resources.query("eye").state is esair.ResourceState.READY


async def test_another_size_than_was_asked_for_is_a_fault() -> None:
    """Not a picture that is cut somewhere else."""
    far = FakeCamera([picture()])
    device = Camera(opener=far.open, width=640, height=480)
    with pytest.raises(DeviceFaultError, match="its pictures are 6 x 4"):
        await device.open()
    await device.close()


class Kernel:
    """A camera whose pictures wait in the kernel, at most four; grabbing blocks."""

    pace = 0.0

    def __init__(self) -> None:
        self.waiting: list[int] = []
        self.number = 0
        self.more = threading.Condition()
        self.hangs = threading.Event()
        self.closed = threading.Event()

    def take(self) -> None:
        with self.more:
            self.number += 1
            self.waiting = [*self.waiting, self.number][-4:]
            self.more.notify()

    def grab(self) -> bool:
        with self.more:
            if not self.more.wait_for(lambda: self.waiting or self.hangs.is_set(), 5.0):
                return False
            if self.hangs.is_set():
                self.hangs.wait()
                self.more.wait(0.5)
            self.now = self.waiting.pop(0) if self.waiting else 0
        return True

    def retrieve(self) -> Any:
        return picture(self.now)

    def close(self) -> None:
        self.closed.set()


@pytest.mark.real_clock
async def test_what_waits_in_the_kernel_is_thrown_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A slow reader gets the newest picture, and the loop waits for none."""
    monkeypatch.setattr(camera, "AT_ONCE", 0.25)  # on a busy computer, too
    kernel = Kernel()
    device = Camera(opener=lambda _request: kernel)
    loop = asyncio.get_running_loop()
    kernel.take()
    loop.call_later(0.5, kernel.take)
    await device.open()
    stream: Any = device.stream()
    for _ in range(4):
        kernel.take()
    newest = kernel.number
    loop.call_later(0.5, kernel.take)
    begin = time.monotonic()
    beats = 0

    async def beat() -> None:
        nonlocal beats
        while True:
            await asyncio.sleep(0.005)
            beats += 1

    beating = asyncio.ensure_future(beat())
    found = await anext(stream)
    beating.cancel()

    assert int(found[1, 0, 2]) == newest + 1
    assert device.dropped >= 4
    assert time.monotonic() - begin > 0.25
    assert beats > 3, "the loop has turned meanwhile"
    await stream.aclose()
    await device.close()
    assert kernel.closed.is_set()


@pytest.mark.real_clock
@pytest.mark.fault("D21")
async def test_a_grab_that_does_not_return_costs_its_time_only() -> None:
    """It is lost; the camera is closed when its thread has come back, not before."""
    kernel = Kernel()
    device = Camera(opener=lambda _request: kernel)

    async def feed() -> None:
        while True:
            kernel.take()
            await asyncio.sleep(0.02)

    feeding = asyncio.ensure_future(feed())
    await device.open()
    feeding.cancel()
    device.silent_after = 0.2  # from here on: the opening may meet a busy computer
    kernel.hangs.set()
    stream: Any = device.stream()
    with pytest.raises(DeviceLostError, match=r"no picture for 0\.2 s"):
        await anext(stream)
    assert not kernel.closed.is_set()
    await device.close()
    await asyncio.to_thread(kernel.closed.wait, 5.0)
    assert kernel.closed.is_set()


class Hanging:
    """A camera that never gives a picture, until it is let go."""

    pace = 0.0

    def __init__(self, let_go: threading.Event) -> None:
        self.let_go = let_go
        self.closed = threading.Event()

    def grab(self) -> bool:
        return self.let_go.wait(30.0)

    def retrieve(self) -> Any:
        return picture(1)

    def close(self) -> None:
        self.closed.set()


@pytest.mark.real_clock
@pytest.mark.fault("D21")
async def test_a_camera_that_hangs_has_one_thread_however_often_it_is_tried() -> None:
    """It is not opened anew until its thread has come back and has closed it."""
    let_go, made = threading.Event(), []

    def opener(_request: Any) -> Hanging:
        made.append(Hanging(let_go))
        return made[-1]

    device = Camera(opener=opener, silent_after=0.05)
    threads = threading.active_count()
    try:
        for _ in range(3):
            with pytest.raises(DeviceLostError):
                await device.open()
            await device.close()
        assert len(made) == 1
        assert threading.active_count() <= threads + 1
        with pytest.raises(DeviceLostError, match="an earlier picture is still waited"):
            await device.open()
    finally:
        let_go.set()
    await asyncio.to_thread(made[0].closed.wait, 5.0)
    async with asyncio.timeout(10.0):
        while len(made) == 1:
            await asyncio.sleep(0.02)
            with contextlib.suppress(DeviceLostError):
                await device.open()
    assert made[0].closed.is_set()
    await device.close()


@pytest.mark.real_clock
@pytest.mark.fault("D21")
async def test_a_camera_that_opens_too_late_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nobody has it: nobody else could open it."""
    monkeypatch.setattr(camera, "OPEN_TIMEOUT", 0.05)
    let_go = threading.Event()
    late = Hanging(let_go)

    def opener(_request: Any) -> Hanging:
        let_go.wait(30.0)
        return late

    device = Camera(opener=opener)
    with pytest.raises(DriverStuckError):
        await device.open()
    await device.close()
    let_go.set()
    assert await asyncio.to_thread(late.closed.wait, 10.0)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A computer with a camera on USB, which has two files, and one that is not."""
    usb = tmp_path / "sys/devices/usb1/1-1"
    usb.mkdir(parents=True)
    for name, text in [("idVendor", "046d"), ("idProduct", "0825"), ("serial", "A1")]:
        (usb / name).write_text(f"{text}\n")
    for name, index, about in [
        ("video0", "0", "UVC Camera"),
        ("video1", "1", "UVC Camera"),
        ("video10", "0", "bcm2835-codec"),
    ]:
        place = tmp_path / "sys/class/video4linux" / name
        place.mkdir(parents=True)
        (place / "index").write_text(f"{index}\n")
        (place / "name").write_text(f"{about}\n")
        if about == "UVC Camera":
            (place / "device").symlink_to(usb)
    return tmp_path


@pytest.mark.promise("BUS-2")
def test_cameras_are_found_by_who_they_are(root: Path) -> None:
    """And esair devices lists them, with the lines for a robot.toml."""
    assert [each.path for each in devices(root)] == ["/dev/video0", "/dev/video10"]
    assert find_camera("usb:046d:0825", root) == "/dev/video0"
    assert find_camera("bcm", root) == "/dev/video10"
    assert find_camera("/dev/video7", root) == "/dev/video7"
    with pytest.raises(FileNotFoundError, match="several cameras are 'there'"):
        find_camera("", root)
    found = [each for each in discovery.devices(root) if each.kind == "camera"]
    assert found[0].identity == "usb:046d:0825:A1"
    assert 'device = "usb:046d:0825:A1"' in discovery.toml(found[0])


def test_without_its_packages_it_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Said before the robot starts, which it ended."""
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(ModuleNotFoundError, match=r"numpy.*esair\[camera\]"):
        Camera()


async def test_a_camera_that_is_not_there_is_lost(tmp_path: Path) -> None:
    """With its path and the reason."""
    pytest.importorskip("cv2", reason="pip install '.[ci]'")
    device = Camera(device=str(tmp_path / "video9"))
    with pytest.raises(DeviceLostError, match="No such file or directory"):
        await device.open()
    await device.close()
