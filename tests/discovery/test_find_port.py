"""A serial port is found by who it is, wherever it is plugged in."""

from __future__ import annotations

import platform
from types import SimpleNamespace

import hypothesis
import hypothesis.strategies as st
import pytest

from esair.buses.serial import devices as serial_ports
from esair.discovery import find_port, serial_identity
from esair.exceptions import ConfigError

pytestmark = pytest.mark.promise("BUS-2")

FTDI = "usb:0403:6001:A50285BI"


def one_ftdi(tree, name: str = "ttyUSB0", place: str = "1-2") -> None:
    tree.usb_serial(
        name,
        place,
        "0403",
        "6001",
        serial="A50285BI",
        maker="FTDI",
        words="FT232R USB UART",
        by_id="usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0",
    )


@pytest.mark.parametrize("identity", [FTDI, "usb:0403:6001", "usb:0403:6001".upper()])
def test_a_port_is_found_by_its_identity(tree, identity) -> None:
    """With or without the serial number; its lasting name is returned."""
    one_ftdi(tree)
    tree.usb_serial("ttyACM0", "1-3", "2341", "0043", serial="7")

    if identity.isupper():
        identity = identity.replace("USB", "usb")
    assert find_port(identity, tree.root) == (
        "/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0"
    )


@pytest.mark.fault("D06")
def test_a_renumbered_port_is_the_same_port(tree) -> None:
    """Another number and another socket change nothing for who asks by identity."""
    one_ftdi(tree, "ttyUSB7", "1-4")

    assert find_port(FTDI, tree.root).endswith("A50285BI-if00-port0")
    assert serial_identity("/dev/ttyUSB7", tree.root) == FTDI


def test_without_udev_the_path_is_what_there_is(tree) -> None:
    """A container has no links."""
    tree.usb_serial("ttyACM3", "1-3", "2341", "0043", serial="7")

    assert find_port("usb:2341:0043", tree.root) == "/dev/ttyACM3"


def test_a_port_that_is_not_there_is_a_lost_connection(tree) -> None:
    """And the message says what is there instead."""
    one_ftdi(tree)

    with pytest.raises(ConnectionError, match=rf"usb:2341:0043 is not there.*{FTDI}"):
        find_port("usb:2341:0043", tree.root)


@pytest.mark.fault("D05")
def test_another_piece_of_the_same_product_is_not_it(tree) -> None:
    """The serial number counts if it is given."""
    one_ftdi(tree)

    with pytest.raises(ConnectionError, match="not there"):
        find_port("usb:0403:6001:B1", tree.root)


def test_of_two_alike_the_serial_number_is_asked_for(tree) -> None:
    """Nobody guesses which arm of the robot is meant."""
    one_ftdi(tree)
    tree.usb_serial("ttyUSB1", "1-3", "0403", "6001", serial="B1")

    with pytest.raises(
        ConnectionError, match=rf"ttyUSB0 \({FTDI}\), /dev/ttyUSB1 .*add the serial"
    ):
        find_port("usb:0403:6001", tree.root)
    assert find_port("usb:0403:6001:B1", tree.root) == "/dev/ttyUSB1"


def test_of_two_that_cannot_be_told_apart_the_path_is_asked_for(tree) -> None:
    """Cheap adapters have no serial number, and the ports of one device share it."""
    tree.usb_serial("ttyUSB0", "1-2", "1a86", "7523")
    tree.usb_serial("ttyUSB1", "1-3", "1a86", "7523")

    with pytest.raises(ConnectionError, match="by its path"):
        find_port("usb:1a86:7523", tree.root)


@pytest.mark.parametrize(
    "text",
    [
        "usb:",
        "usb:403:6001",
        "usb:0403",
        "usb:0403:6001:",
        "USB:0403:6001",
        "0403:6001",
    ],
)
def test_what_is_no_identity_is_a_mistake_in_the_configuration(tree, text) -> None:
    """Not a device that may come later."""
    with pytest.raises(ConfigError, match="expected usb:VID:PID"):
        find_port(text, tree.root)


def test_a_link_has_the_identity_of_its_port(tree) -> None:
    """So that a path can be checked after it was opened."""
    one_ftdi(tree)
    (tree.root / "dev/arm").symlink_to("ttyUSB0")

    assert serial_identity("/dev/arm", tree.root) == FTDI


def test_what_is_no_usb_device_has_no_identity(tree) -> None:
    """A console, a port of the computer, nothing at all."""
    tree.tty("tty0", None)
    tree.tty("ttyAMA0", tree.root / "sys/devices/platform/uart")

    for path in ("/dev/tty0", "/dev/ttyAMA0", "/dev/ttyUSB0"):
        assert serial_identity(path, tree.root) is None


def test_a_serial_number_of_a_blank_memory_is_none(tree) -> None:
    """It would match every device of the kind, in no characters anybody could type."""
    tree.usb_serial("ttyUSB0", "1-2", "1a86", "7523", serial="\x01\x1b[2J\x02")

    assert serial_identity("/dev/ttyUSB0", tree.root) == "usb:1a86:7523"


printable = st.text(
    st.characters(codec="ascii", categories=["L", "N", "P"], exclude_characters="?"),
    min_size=1,
    max_size=12,
)


@hypothesis.given(
    st.lists(
        st.tuples(
            st.sampled_from(["0403", "1a86"]),
            st.sampled_from(["6001", "7523"]),
            st.one_of(st.none(), printable),
        ),
        max_size=5,
    )
)
@hypothesis.settings(max_examples=60)
@pytest.mark.long
def test_what_is_listed_is_found_again(new_tree, parts) -> None:
    """An address that is an identity leads to the very port it was listed for."""
    tree = new_tree()
    for number, (vendor, product, serial) in enumerate(parts):
        more = {} if serial is None else {"serial": serial}
        tree.usb_serial(f"ttyUSB{number}", f"1-{number}", vendor, product, **more)

    listed = serial_ports(tree.root)

    assert [port.path for port in listed] == [
        f"/dev/ttyUSB{number}" for number in range(len(parts))
    ]
    for port in listed:
        if port.address.startswith("usb:"):
            assert find_port(port.address, tree.root) == port.path
        else:
            assert port.address == port.path
            with pytest.raises(ConnectionError, match="ports"):
                find_port(str(port.identity), tree.root)


def test_elsewhere_than_on_linux_pyserial_knows_the_ports(monkeypatch) -> None:
    """There is no ``/sys`` to look into."""
    from serial.tools import list_ports

    def port(**known):
        return SimpleNamespace(**{"description": "n/a", **known})

    found = [
        port(device="/dev/cu.usb2", vid=0x2341, pid=0x43, serial_number="7"),
        port(device="/dev/cu.bluetooth", vid=None, pid=None, serial_number=None),
    ]
    monkeypatch.setattr(platform, "system", lambda: "Darwin")
    monkeypatch.setattr(list_ports, "comports", lambda: found)

    assert find_port("usb:2341:0043:7") == "/dev/cu.usb2"
    assert [each.identity for each in serial_ports()] == [
        None,
        "usb:2341:0043:7",
    ]
