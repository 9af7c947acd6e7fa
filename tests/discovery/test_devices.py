"""Everything that is plugged in is listed, with the lines for a robot.toml."""

from __future__ import annotations

import os
import sys
import tomllib

import pytest

from esair.buses import finding
from esair.buses.can import CanState, _interfaces
from esair.buses.can._interfaces import Interface
from esair.buses.finding import who_may
from esair.config import check
from esair.discovery import devices, toml
from esair.drivers import gpio

pytestmark = pytest.mark.promise("BUS-2")


@pytest.fixture
def full(tree):
    """A computer with one or two of everything."""
    tree.usb_serial(
        "ttyUSB0", "1-2", "0403", "6001", serial="A5", maker="FTDI", words="FTDI UART"
    )
    tree.tty("ttyAMA0", tree.root / "sys/devices/platform/uart")
    tree.tty("tty1", None)
    adapter = tree.usb(
        "1-3", "1d50", "606f", serial="C1", maker="Geschwister Schneider"
    )
    tree.can("can0", flags="0x40080", device=adapter / "1-3:1.0")
    tree.can("vcan0", flags="0x400c1")
    tree.ethernet("eth0")
    tiny = tree.usb("1-4", "0403", "c631", words="i2c-tiny-usb")
    tree.i2c(10, "i2c-tiny-usb at bus 001 device 004", tiny / "1-4:1.0")
    tree.i2c(1, "bcm2835 (i2c@7e804000)")
    tree.gpio(0, "pinctrl-bcm2711", 58)
    tree.gpio(10, "expander", 8)
    return tree


def test_every_kind_is_listed_in_its_natural_order(full) -> None:
    """Serial, CAN, I²C, GPIO; number 10 comes after number 2."""
    assert [(each.kind, each.path) for each in devices(full.root)] == [
        ("serial", "/dev/ttyAMA0"),
        ("serial", "/dev/ttyUSB0"),
        ("can", "can0"),
        ("can", "vcan0"),
        ("i2c", "/dev/i2c-1"),
        ("i2c", "/dev/i2c-10"),
        ("gpio", "/dev/gpiochip0"),
        ("gpio", "/dev/gpiochip10"),
    ]


def test_each_is_described_as_far_as_it_can_be_known(full) -> None:
    """Who made it, who it is, whether it is up, how many lines."""
    by_path = {each.path: each for each in devices(full.root)}

    usb = by_path["/dev/ttyUSB0"]
    assert usb.description == "FTDI UART"  # the maker once
    assert usb.identity == usb.address == "usb:0403:6001:A5"
    can = by_path["can0"]
    assert can.identity == "usb:1d50:606f:C1"
    assert (can.address, can.state) == ("can0", "down")
    assert by_path["vcan0"].state == "up"
    assert by_path["vcan0"].description == "virtual CAN"
    assert by_path["/dev/i2c-1"].address == "1"
    assert by_path["/dev/i2c-10"].address == "name:i2c-tiny-usb"
    assert by_path["/dev/gpiochip0"].lines == 58
    assert by_path["/dev/gpiochip0"].address == "pinctrl-bcm2711"


def test_nothing_plugged_in_is_an_empty_list(tree) -> None:
    """No directory of ``/sys`` has to be there."""
    assert devices(tree.root) == []


def test_a_device_without_its_node_is_not_listed(full) -> None:
    """A container shares ``/sys`` and not ``/dev``."""
    for node in ("ttyUSB0", "i2c-1", "gpiochip0"):
        (full.root / "dev" / node).unlink()

    paths = {each.path for each in devices(full.root)}

    assert paths == {"/dev/ttyAMA0", "can0", "vcan0", "/dev/i2c-10", "/dev/gpiochip10"}


def test_what_the_kernel_only_provides_for_is_not_listed(tree) -> None:
    """A computer with no serial port has sixty-four names for one."""
    for number, kind in enumerate(("0", "4")):
        tree.tty(f"ttyS{number}", tree.root / f"sys/devices/platform/serial{number}")
        (tree.root / f"sys/class/tty/ttyS{number}/type").write_text(kind)

    assert [each.path for each in devices(tree.root)] == ["/dev/ttyS1"]


@pytest.mark.fault("D06")
def test_of_two_alike_the_place_is_what_tells_them_apart(tree) -> None:
    """Their links by identity would lead to whichever came last."""
    for number in range(2):
        tree.usb_serial(
            f"ttyUSB{number}",
            f"1-{number}",
            "1a86",
            "7523",
            by_path=f"pci-0-usb-0:{number}:1.0-port0",
            **({"by_id": "usb-1a86_USB_Serial-if00-port0"} if number else {}),
        )

    assert [each.address for each in devices(tree.root)] == [
        "/dev/serial/by-path/pci-0-usb-0:0:1.0-port0",
        "/dev/serial/by-path/pci-0-usb-0:1:1.0-port0",
    ]


def test_the_ports_of_one_device_are_told_apart_by_their_links(tree) -> None:
    """They have one identity."""
    device = tree.usb("1-2", "0403", "6010", serial="Q")
    for number in range(2):
        tree.tty(
            f"ttyUSB{number}",
            device / f"1-2:1.{number}",
            by_id=f"usb-FTDI_Q-if0{number}-port0",
        )

    assert [each.address for each in devices(tree.root)] == [
        "/dev/serial/by-id/usb-FTDI_Q-if00-port0",
        "/dev/serial/by-id/usb-FTDI_Q-if01-port0",
    ]


@pytest.mark.fault("P06")
def test_what_a_device_calls_itself_cannot_move_the_cursor(tree) -> None:
    """A product name with escape codes is shown, not obeyed; it ends no comment."""
    tree.usb_serial(
        "ttyACM0", "1-2", "2341", "0043", words="\x1b[2Jnice\ndriver = 1\u202e"
    )
    (port,) = devices(tree.root)

    assert port.description.isprintable()
    assert tomllib.loads(toml(port)) == {
        "bus": {
            "ttyacm0": {"type": "serial", "port": "usb:2341:0043", "baudrate": 115200}
        }
    }


def test_what_is_unplugged_while_it_is_looked_at_is_no_usb_device(
    tree, monkeypatch
) -> None:
    """A link that goes between two looks at it ends the look at no other device."""
    tree.usb_serial("ttyACM0", "1-2", "2341", "0043")
    place = tree.root / "sys/class/tty/ttyACM0"
    assert finding.usb_device(place, tree.root) is not None

    def gone(path):
        raise FileNotFoundError(path)

    monkeypatch.setattr(os, "readlink", gone)
    assert finding.usb_device(place, tree.root) is None


def test_the_lines_for_all_of_them_make_a_robot(full, tmp_path) -> None:
    """Pasted into a robot.toml they have no mistake."""
    text = "\n".join(toml(each) for each in devices(full.root))
    file = tmp_path / "robot.toml"
    file.write_text(f'[robot]\nname = "rover"\n\n{text}')

    report = check(file)

    assert [each for each in report.findings if each.severity == "error"] == []
    described = tomllib.loads(text)
    assert described["bus"]["i2c_1"]["bus"] == 1
    assert described["bus"]["i2c_10"]["bus"] == "name:i2c-tiny-usb"
    assert len(described["bus"]) == 6
    assert len(described["sensor"]) == 2


def test_a_can_interface_that_is_down_comes_with_its_command(full) -> None:
    """The bit rate is asked for only if it has none."""
    texts = {each.path: toml(each) for each in devices(full.root)}

    assert "sudo ip link set can0 up type can bitrate 500000" in texts["can0"]
    assert "sudo" not in texts["vcan0"]


def test_a_virtual_can_interface_has_no_bit_rate(tree) -> None:
    """The kernel makes it down, and would refuse the command of a real one."""
    tree.can("vcan0", flags="0x80")
    (device,) = devices(tree.root)

    assert "# it is down: sudo ip link set vcan0 up\n" in toml(device)


class OldGpiod:
    """The module of libgpiod 1, which has the same name."""

    class Chip:
        """It knows nothing of ``get_info``."""


@pytest.mark.parametrize("module", [OldGpiod, None])
def test_gpio_chips_are_listed_without_libgpiod_2(monkeypatch, module) -> None:
    """With the bindings of version 1, as distributions have them, or with none."""
    monkeypatch.setitem(sys.modules, "gpiod", module)

    assert gpio._gpiod() is None
    assert all(each.kind == "gpio" for each in gpio.devices())


@pytest.mark.parametrize(
    ("interface", "state", "bitrate"),
    [
        (Interface(3, True, 16, CanState.PASSIVE, 500_000, True),
         "up, 500 kbit/s, error-passive", 500_000),
        (Interface(3, True, 16, CanState.ACTIVE), "up", None),
        (OSError("no such interface"), "up", None),
    ],
)  # fmt: skip
def test_the_kernel_is_asked_for_the_state_and_the_bit_rate(
    tree, monkeypatch, interface, state, bitrate
) -> None:
    """As a bus asks before it opens; an interface that just went leaves them unknown."""

    def look_up(_name: str) -> object:
        if isinstance(interface, OSError):
            raise interface
        return interface

    tree.can("can0", flags="0x41")
    monkeypatch.setattr(_interfaces, "ROOT", tree.root)
    monkeypatch.setattr(_interfaces, "look_up", look_up)

    (found,) = _interfaces.devices(tree.root)

    assert (found.state, found.bitrate) == (state, bitrate)


def test_what_may_not_be_opened_is_told(monkeypatch, tree) -> None:
    """In the list, before somebody finds out."""
    tree.tty("ttyAMA0", tree.root / "sys/devices/platform/uart")
    tree.i2c(1, "bcm2835 (i2c@7e804000)")
    allowed = {each.state for each in devices(tree.root)}
    monkeypatch.setattr(finding.os, "access", lambda *_: False)
    refused = [each.state for each in devices(tree.root)]

    assert allowed == {""}
    assert len(refused) == 2
    assert all(state.startswith("no permission") for state in refused)


@pytest.mark.parametrize(
    ("mode", "group", "words"),
    [
        (0o20660, 987_654, "no permission: join the group 987654"),
        (0o20660, 0, "no permission"),
        (0o20600, 987_654, "no permission"),
    ],
)
def test_the_group_that_may_open_it_is_named(mode, group, words) -> None:
    """``dialout``, mostly; nobody is told to join that of the superuser."""
    assert who_may(mode, group) == words
