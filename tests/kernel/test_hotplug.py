"""USB devices of a real kernel are pulled, renumbered and found again."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import esair
from esair.buses import SerialBus, finding
from esair.discovery import devices, find_port, serial_identity, watch
from esair.messages import ResourceState
from esair.supervisors import _resource_life
from esair.testing import Leaks

pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.kernel("built"),
    pytest.mark.promise("BUS-2"),
]

PATIENCE = 30.0
"""The guest has one slow processor."""

VENDOR, PRODUCT = 0x2341, 0x0043


@pytest.fixture
def plug() -> Iterator[Callable[..., Any]]:
    """Plug serial adapters in, each in a port of its own; all are pulled at the end."""
    from usb_parts import SerialAdapter

    plugged: list[Any] = []

    def plug_in(serial: str, port: int = 0) -> Any:
        adapter = SerialAdapter(
            port=port, serial=serial, vendor=VENDOR, product=PRODUCT
        )
        plugged.append(adapter)
        return put_in(adapter)

    yield plug_in
    for adapter in plugged:
        adapter.unplug()
        wait_until_gone(adapter)


def wait(condition: Callable[[], Any]) -> Any:
    """Wait for something that the kernel does."""
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
    return found


def wait_until_gone(adapter: Any) -> None:
    """Wait until the kernel has noticed that an adapter was pulled."""
    wait(lambda: adapter.path() is None)


async def until(condition: Callable[[], Any]) -> None:
    """Wait for something that the robot does."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        await asyncio.sleep(0.01)


def put_in(adapter: Any) -> Any:
    """Plug an adapter in and wait until the kernel has made its node."""
    adapter.plug()
    wait(lambda: os.path.exists(adapter.path() or ""))
    return adapter


@contextlib.contextmanager
def far_end(adapter: Any) -> Iterator[Callable[[], bytes]]:
    """Open the device's end of the line; yields how to take what has come."""
    fd = os.open(adapter.far, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def take() -> bytes:
        try:
            return os.read(fd, 4096)
        except BlockingIOError:
            return b""

    try:
        tty.setraw(fd)
        termios.tcflush(fd, termios.TCIOFLUSH)
        yield take
    finally:
        os.close(fd)


class Motor(esair.Actuator[int]):
    """One byte is one command."""

    safe = 0

    async def write(self, command: int) -> None:
        await self.bus.send(bytes([command]))


async def settle(robot: esair.Robot, state: ResourceState) -> None:
    await until(lambda: robot.resources.query("motor").state is state)


@pytest.fixture
def long_pauses(monkeypatch) -> None:
    """Between two tries lies the longest pause, from the first one on."""
    monkeypatch.setattr(_resource_life, "FIRST_DELAY", 20.0)


async def comes_back(adapter: Any, port: str, rounds: int) -> None:
    """Pull and restore; each time it is there at once and hears its safe command."""
    leaks = Leaks()
    motor = Motor(name="motor", bus=SerialBus(name="line", port=port, framing="raw"))
    async with esair.Robot(resources=[motor]) as robot:
        await settle(robot, ResourceState.READY)
        for _ in range(rounds):
            await asyncio.to_thread(adapter.unplug)
            await settle(robot, ResourceState.LOST)
            await asyncio.sleep(0.2)
            with far_end(adapter) as take:
                await asyncio.to_thread(put_in, adapter)
                begin = time.monotonic()
                await settle(robot, ResourceState.READY)
                assert time.monotonic() - begin < 10.0
                heard = bytearray()
                async with asyncio.timeout(PATIENCE):
                    while not heard:
                        heard += take()
                        await asyncio.sleep(0.01)
                assert set(heard) == {Motor.safe}
    left = [each for each in await leaks.check(5.0) if "asyncio_" not in each]
    assert left == []


@pytest.mark.fault("D03", "D04")
async def test_a_device_comes_back_by_its_identity(plug, long_pauses) -> None:
    """Pulled and put in again, ten times."""
    adapter = plug("ESAIR1")

    await comes_back(adapter, "usb:2341:0043:ESAIR1", rounds=10)


@pytest.mark.fault("D04", "D19")
async def test_a_device_comes_back_by_its_path(plug, long_pauses) -> None:
    """The lost port is closed before the next try, and so gives its number back."""
    adapter = plug("ESAIR6")

    await comes_back(adapter, adapter.path(), rounds=3)


@pytest.mark.fault("D04", "D06")
@pytest.mark.kernel("built", udev=True)
async def test_a_device_comes_back_by_the_link_of_udev(plug, long_pauses) -> None:
    """``/dev/serial/by-id`` appears some time after the device."""
    adapter = plug("ESAIR2")
    link = "/dev/serial/by-id/usb-esair_robot_ESAIR2-if00"
    wait(lambda: os.path.exists(link))

    assert find_port("usb:2341:0043:ESAIR2") == link
    await comes_back(adapter, link, rounds=5)


@pytest.mark.fault("D05", "D06")
async def test_a_renumbered_device_is_found_and_another_is_not_it(plug) -> None:
    """While it was away another one has taken its number."""
    ours = plug("OURS")
    path = ours.path()
    line = SerialBus(name="line", port="usb:2341:0043:OURS", framing="raw")
    async with esair.Robot(resources=[Motor(name="motor", bus=line)]) as robot:
        await settle(robot, ResourceState.READY)
        await asyncio.to_thread(ours.unplug)
        await settle(robot, ResourceState.LOST)
        tries = line.stats.errors
        await until(lambda: line.stats.errors > tries)  # it has let the number go

        other = await asyncio.to_thread(plug, "OTHER", 1)
        assert other.path() == path
        with far_end(other) as take:
            await asyncio.sleep(1.0)
            assert robot.resources.query("motor").state is not ResourceState.READY
            assert take() == b""

            await asyncio.to_thread(put_in, ours)
            await settle(robot, ResourceState.READY)
            assert ours.path() != path
            assert take() == b""


async def test_an_event_of_the_kernel_wakes_who_waits(plug, monkeypatch) -> None:
    """With pyudev nobody has to look; without udev's rules in a container either."""
    pytest.importorskip("pyudev")
    monkeypatch.setattr(finding, "PERIOD", 60.0)
    adapter = plug("ESAIR3")
    identity = "usb:2341:0043:ESAIR3"
    adapter.unplug()
    wait_until_gone(adapter)
    looked, told = threading.Event(), []

    def look() -> str | None:
        looked.set()
        with contextlib.suppress(ConnectionError):
            return find_port(identity)
        return None

    forget = watch(look, lambda: told.append(time.monotonic()))
    await asyncio.to_thread(looked.wait, PATIENCE)
    await asyncio.sleep(0.5)
    await asyncio.to_thread(put_in, adapter)
    await until(lambda: told)
    forget()


def test_what_is_plugged_in_is_listed(plug) -> None:
    """Emulated parts under the kernel's own drivers, with who they are."""
    from usb_parts import CanAdapter

    adapter = plug("ESAIR4")
    with CanAdapter(bus="vcan1", port=1) as can:
        wait(lambda: Path("/sys/class/net/can0").exists())
        subprocess.run(
            "ip link set can0 type can bitrate 500000 && ip link set can0 up",
            shell=True,
            check=True,
        )
        listed = {each.path: each for each in devices()}
    can._pipe.close()

    serial = listed[adapter.path()]
    assert serial.identity == serial.address == "usb:2341:0043:ESAIR4"
    assert serial.description == "esair robot"
    assert serial_identity(adapter.path()) == serial.identity
    assert listed["can0"].identity == "usb:1d50:606f:CAN0001"
    assert listed["can0"].bitrate == 500_000
    assert listed["can0"].state == "up, 500 kbit/s, error-active"
    assert listed["vcan0"].state == "up"
    assert listed["/dev/i2c-0"].description == "SMBus stub driver"
    assert listed["/dev/gpiochip0"].lines == 8


def test_the_command_names_what_is_unplugged(plug) -> None:
    """``esair devices --find --json``, as a user would do it."""
    adapter = plug("ESAIR5")
    path = adapter.path()
    process = subprocess.Popen(
        [sys.executable, "-m", "esair", "devices", "--find", "--json", "--for", "30"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    process.stderr.readline()  # it has looked what there is
    adapter.unplug()
    told, _ = process.communicate(timeout=PATIENCE)

    assert process.returncode == 0
    assert json.loads(told)["devices"][0]["path"] == path
