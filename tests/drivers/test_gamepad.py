"""Gamepads: what the hands do, the dead man, who is plugged in; the kernel's own."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.drivers.parts import Plugged

import esair
from esair import discovery
from esair.drivers.gamepad import Axis, Gamepad, PadState, devices, find_pad, toml
from esair.drivers.gamepad.fake import FakeGamepad
from esair.exceptions import ConfigError
from esair.testing import SensorContract

pytestmark = pytest.mark.virtual_clock


class TestGamepad(Plugged, SensorContract):
    def make(self) -> Gamepad:
        self.far = FakeGamepad()
        return Gamepad(opener=self.far.open)

    keeps_nothing = "the kernel gives it a new device, which is opened again"


@asynccontextmanager
async def followed(device: Gamepad) -> AsyncIterator[Any]:
    device.open()
    stream: Any = device.stream()
    try:
        yield stream
    finally:
        await stream.aclose()
        device.close()


async def test_sticks_triggers_and_buttons_in_the_hands_words() -> None:
    """Up and right are 1, a trigger goes from 0 to 1, small moves are none."""
    far = FakeGamepad()
    async with followed(Gamepad(opener=far.open)) as stream:
        first = await anext(stream)
        assert first.held
        assert set(first.axes.values()) == {0.0}
        assert first.buttons == frozenset()
        far.move("x", 1.0)
        far.move("y", 1.0)
        far.move("ry", -1.0)
        far.move("z", 1.0)
        far.move("rx", 0.05)
        far.move("hat_y", 1.0)
        far.press("south", "tl")
        for _ in range(8):
            pad = await anext(stream)
        assert pad.axis("x") == pad.axis("y") == pad.axis("z") == 1.0
        assert (pad.axis("ry"), pad.axis("rx"), pad.axis("hat_y")) == (-1.0, 0.0, 1.0)
        assert pad.axis("wheel") == 0.0
        assert pad.buttons == {"south", "tl"}


@pytest.mark.promise("RES-1")
async def test_a_hand_that_does_not_move_at_all_holds_nothing() -> None:
    """A pad by radio stays as it was for ever; then the dead man is pressed anew."""
    far = FakeGamepad()
    device = Gamepad(opener=far.open, dead_man="tl", still_after=1.0)
    clock = asyncio.get_running_loop().time
    async with followed(device) as stream:
        await anext(stream)
        far.press("tl")
        far.move("y", 1.0)
        while not (pad := await anext(stream)).axis("y"):
            pass
        begin = clock()
        while (pad := await anext(stream)).held:
            assert pad.axis("y") == 1.0
        assert clock() - begin == pytest.approx(1.0, abs=0.06)
        assert set(pad.axes.values()) == {0.0}
        far.move("y", 0.9)
        for _ in range(30):
            assert not (await anext(stream)).held
        far.release("tl")
        far.press("tl")
        held = [(await anext(stream)).held for _ in range(3)]
        assert held[-1]
    with pytest.raises(ConfigError, match="still_after: expected a dead_man"):
        Gamepad(opener=far.open, still_after=1.0)


@pytest.mark.promise("RES-1")
async def test_what_is_held_when_it_comes_back_is_pressed_anew() -> None:
    """An operator who holds on while the cable is put back starts nothing."""
    far = FakeGamepad()
    far.press("tl")
    far.move("y", 1.0)
    async with followed(Gamepad(opener=far.open, dead_man="tl")) as stream:
        assert not (await anext(stream)).held
        far.move("y", 0.9)
        assert not (await anext(stream)).axis("y")
        far.release("tl")
        far.press("tl")
        assert [(await anext(stream)).held for _ in range(2)] == [False, True]


@pytest.mark.promise("RES-1")
async def test_nothing_moves_unless_the_dead_man_is_held() -> None:
    """Also what was moved before; at once when it is let go."""
    far = FakeGamepad()
    async with followed(Gamepad(opener=far.open, dead_man="tl")) as stream:
        await anext(stream)
        far.move("y", 1.0)
        pad = await anext(stream)
        assert (pad.held, pad.axis("y")) == (False, 0.0)
        far.press("tl")
        pad = await anext(stream)
        assert (pad.held, pad.axis("y")) == (True, 1.0)
        far.release("tl")
        pad = await anext(stream)
        assert (pad.held, pad.axis("y")) == (False, 0.0)


async def test_what_is_held_still_is_told_again() -> None:
    """A stick that does not move says nothing, but its reading must not grow old."""
    far = FakeGamepad()
    device = Gamepad(opener=far.open, repeat=10.0)
    async with followed(device) as stream:
        far.move("x", 1.0)
        await anext(stream)
        begin = asyncio.get_running_loop().time()
        for _ in range(21):
            pad = await anext(stream)
        assert asyncio.get_running_loop().time() - begin == pytest.approx(2.0, abs=0.11)
        assert pad.axis("x") == 1.0


@pytest.mark.fault("D13")
async def test_events_that_were_lost_are_made_up_for() -> None:
    """The kernel says that it dropped some; then the whole state is asked for."""
    far = FakeGamepad()
    async with followed(Gamepad(opener=far.open)) as stream:
        await anext(stream)
        far.press("east")
        for step in range(200):
            far.move("x", step / 200)
        far.move("y", 1.0)
        await asyncio.sleep(0.01)
        for _ in range(64):
            pad = await anext(stream)
        assert pad.buttons == {"east"}
        assert (pad.axis("x"), pad.axis("y")) == (pytest.approx(0.995, abs=0.01), 1.0)


@pytest.mark.fault("D01", "D04")
async def test_a_pad_that_is_pulled_is_lost_and_comes_back() -> None:
    """A robot without it holds still; nothing is held when it is there again."""
    far = FakeGamepad()
    device = Gamepad(name="pad", opener=far.open, dead_man="tl")
    async with esair.Robot(resources=[device]) as robot:
        await asyncio.sleep(0.1)
        assert robot.resources.query("pad").state is esair.ResourceState.READY
        far.unplug()
        await asyncio.sleep(0.1)
        assert robot.resources.query("pad").losses == 1
        far.plug()
        await asyncio.sleep(6.0)
        assert robot.resources.query("pad").state is esair.ResourceState.READY


def test_what_is_held_at_the_opening_is_what_it_is() -> None:
    """Let go, a stick would have told 0.5, and a trigger -1, for ever."""
    stick, trigger = Axis(-32768, 32767, -32768), Axis(0, 1023, 1023)
    state = PadState({2: stick, 9: trigger}, ())
    assert (state.pad().axis("z"), state.pad().axis("gas")) == (-1.0, 1.0)
    state.take(3, 2, 0)
    state.take(3, 9, 0)
    assert (state.pad().axis("z"), state.pad().axis("gas")) == (0.0, 0.0)


def test_a_trigger_of_an_xbox_pad_may_be_held_at_the_opening() -> None:
    """Its sticks have a middle of 0, so it is none: let go it would have told -1."""
    x, trigger = Axis(-32768, 32767, 0), Axis(0, 1023, 1023)
    state = PadState({0: x, 2: trigger}, ())
    assert state.pad().axis("z") == 1.0
    state.take(3, 2, 0)
    assert state.pad().axis("z") == 0.0


def test_a_right_stick_with_the_code_of_a_trigger_is_a_stick() -> None:
    """By where it rests."""
    stick = PadState({2: Axis(0, 255, 128), 5: Axis(0, 255, 0)}, ())
    stick.take(3, 2, 0)
    stick.take(3, 5, 255)

    assert dict(stick.pad().axes) == {"z": -1.0, "rz": 1.0}


def test_an_axis_without_a_range_is_none() -> None:
    """And a button without a name has its code."""
    state = PadState({0: Axis(0, 0, 0), 40: Axis(0, 1, 1)}, [0x2C0])

    assert dict(state.pad().axes) == {"x": 0.0}
    assert state.pad().buttons == {"button_0x2c0"}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A computer with a mouse, a pad on USB and a joystick that is none of USB."""
    keys = {
        "event3": "70000 0 0 0 0",
        "event12": "7cdb000000000000 0 0 0 0",
        "event7": "100000000 0 0 0 0",
    }
    for number, (place, bits) in enumerate(keys.items()):
        at = tmp_path / f"sys/class/input/{place}/device"
        (at / "capabilities").mkdir(parents=True)
        (at / "id").mkdir()
        (at / "capabilities/key").write_text(f"{bits}\n")
        (at / "name").write_text(f"Thing {number}\n")
        (at / "uniq").write_text("\n")
        (at / "id/bustype").write_text("0003\n" if number == 1 else "0005\n")
        (at / "id/vendor").write_text("045e\n")
        (at / "id/product").write_text("028e\n")
    return tmp_path


@pytest.mark.promise("BUS-2")
def test_pads_are_found_by_who_they_are(root: Path) -> None:
    """By vendor and product, by name, by path, or because there is no other."""
    assert [each.path for each in devices(root)] == [
        "/dev/input/event7",
        "/dev/input/event12",
    ]
    assert find_pad("usb:045e:028e", root) == "/dev/input/event12"
    assert find_pad("Thing 2", root) == "/dev/input/event7"
    assert find_pad("/dev/input/event1", root) == "/dev/input/event1"
    with pytest.raises(FileNotFoundError, match="several pads are 'Thing'"):
        find_pad("Thing", root)
    with pytest.raises(FileNotFoundError, match=r"no pad is 'usb:1111:2222'; there is"):
        find_pad("usb:1111:2222", root)


def test_a_keyboard_with_many_keys_is_no_pad(root: Path) -> None:
    """What it has is read to its end: the last of it are the lowest keys."""
    words = ["f" * 16] * 12
    words[-5] = "0"  # where a pad has its buttons
    (root / "sys/class/input/event3/device/capabilities/key").write_text(
        " ".join(words)
    )
    assert "/dev/input/event3" not in [each.path for each in devices(root)]


def test_esair_devices_lists_pads(root: Path) -> None:
    """With the lines for a robot.toml, and a dead man in them."""
    found = [each for each in discovery.devices(root) if each.kind == "gamepad"]

    assert [each.identity for each in found] == [None, "usb:045e:028e"]
    assert 'device = "usb:045e:028e"' in discovery.toml(found[1])
    assert toml(found[0], "pad")[-1] == 'dead_man = "tl"'


@pytest.mark.real_clock
async def test_a_pad_of_the_kernel() -> None:
    """Made by uinput, where a program may: sticks, buttons and its unplugging."""
    evdev = pytest.importorskip("evdev", reason="the extra 'gamepad' is not built")
    codes: Any = evdev.ecodes
    sticks = [(code, evdev.AbsInfo(0, -100, 100, 0, 0, 0)) for code in (0, 1)]
    try:
        made = evdev.UInput({codes.EV_ABS: sticks, codes.EV_KEY: [0x130, 0x136]})
    except (OSError, evdev.UInputError) as error:
        pytest.skip(f"no uinput: {error}")
    await asyncio.sleep(0.2)
    device = Gamepad(device=made.device.path)
    async with followed(device) as stream:
        await anext(stream)
        made.write(codes.EV_ABS, 1, -100)
        made.write(codes.EV_KEY, 0x136, 1)
        made.syn()
        pad = await anext(stream)
        while "tl" not in pad.buttons:
            pad = await anext(stream)
        assert pad.axis("y") == 1.0
        made.close()
        with pytest.raises(OSError, match="No such device"):
            _ = [each async for each in stream]
