"""``esair devices``: what is plugged in, as a person and as a program sees it."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from esair.config import check

pytestmark = pytest.mark.promise("BUS-2")

PATIENCE = 60.0


class Computer:
    """A ``/sys`` and a ``/dev`` with USB serial adapters."""

    def __init__(self, root: Path) -> None:
        self.root = root
        (root / "dev").mkdir()

    def plug(self, number: int, serial: str = "A50285BI") -> None:
        """Plug an adapter in that becomes ttyUSB<number>."""
        device = self.root / f"sys/devices/usb1/1-{number}"
        part = device / f"1-{number}:1.0"
        place = part / f"tty/ttyUSB{number}"
        place.mkdir(parents=True)
        for name, text in (
            ("idVendor", "0403"),
            ("idProduct", "6001"),
            ("serial", serial),
            ("manufacturer", "FTDI"),
            ("product", "FT232R USB UART"),
        ):
            (device / name).write_text(f"{text}\n")
        (place / "device").symlink_to(part)
        (self.root / "dev" / place.name).touch()
        ports = self.root / "sys/class/tty"
        ports.mkdir(parents=True, exist_ok=True)
        (ports / place.name).symlink_to(place)  # last: now it is there

    def pull(self, number: int) -> None:
        """Pull an adapter out."""
        (self.root / f"sys/class/tty/ttyUSB{number}").unlink()
        (self.root / f"dev/ttyUSB{number}").unlink()
        shutil.rmtree(self.root / f"sys/devices/usb1/1-{number}")

    def can(self) -> None:
        """Add a CAN interface that is down."""
        place = self.root / "sys/class/net/can0"
        place.mkdir(parents=True)
        (place / "type").write_text("280\n")
        (place / "flags").write_text("0x40080\n")


@pytest.fixture
def computer(tmp_path) -> Computer:
    return Computer(tmp_path)


@pytest.fixture(autouse=True)
def narrow(monkeypatch) -> None:
    """The terminal has 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")


def test_the_table_fits_a_terminal(esair_command, computer, capsys) -> None:
    """80 columns are enough for a name, an identity and what it is, each in one line."""
    computer.plug(0)
    computer.can()

    assert esair_command("devices", "--root", computer.root) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    (row,) = [line for line in lines if "ttyUSB0" in line and "serial" in line]
    assert "usb:0403:6001:A50285BI" in row
    assert "FTDI FT232R USB UART" in row
    (row,) = [line for line in lines if line.lstrip().startswith("can ")]
    assert "down" in row


def test_its_toml_is_a_robot(esair_command, computer, capsys) -> None:
    """``esair devices --toml >> robot.toml`` leaves nothing to be mended."""
    computer.plug(0)
    computer.can()

    assert esair_command("devices", "--toml", "--root", computer.root) == 0
    text = capsys.readouterr().out
    file = computer.root / "robot.toml"
    file.write_text(f'[robot]\nname = "rover"\n{text}')

    assert check(file).errors == 0
    assert tomllib.loads(text)["bus"]["ttyusb0"] == {
        "type": "serial",
        "port": "usb:0403:6001:A50285BI",
        "baudrate": 115200,
    }


def test_json_has_everything(esair_command, computer, capsys) -> None:
    """For programs."""
    computer.plug(0)

    assert esair_command("devices", "--json", "--root", computer.root) == 0
    answer = json.loads(capsys.readouterr().out)

    assert answer["schema"] == 1
    (device,) = answer["devices"]
    toml = device.pop("toml")
    assert tomllib.loads(toml)["bus"]["ttyusb0"]["port"] == device["address"]
    assert device == {
        "kind": "serial",
        "path": "/dev/ttyUSB0",
        "address": "usb:0403:6001:A50285BI",
        "identity": "usb:0403:6001:A50285BI",
        "description": "FTDI FT232R USB UART",
        "by_id": None,
        "state": "",
        "bitrate": None,
        "lines": None,
    }


def test_nothing_plugged_in_is_said(esair_command, computer, capsys) -> None:
    """An empty table would be a riddle."""
    assert esair_command("devices", "--root", computer.root) == 0
    assert "nothing is plugged in" in capsys.readouterr().out


def test_nothing_to_scan_is_said(esair_command, computer, capsys) -> None:
    """With what may help, and its own exit code."""
    assert esair_command("devices", "--scan", "--root", computer.root) == 1
    assert "i2c-dev" in capsys.readouterr().err


def test_a_bus_that_cannot_be_scanned_is_said(esair_command, computer, capsys) -> None:
    """The others are shown nevertheless."""
    place = computer.root / "sys/class/i2c-dev/i2c-250"
    place.mkdir(parents=True)
    (place / "name").write_text("adapter\n")
    (computer.root / "dev/i2c-250").touch()

    assert esair_command("devices", "--scan", "--root", computer.root) == 1
    told = capsys.readouterr()
    assert "/dev/i2c-250: device of 'scan' is lost: cannot be opened" in told.err
    assert "adapter" in told.out


@pytest.mark.parametrize(
    "words",
    [
        ["--watch", "--find"],
        ["--toml", "--json"],
        ["--for", "1"],
        ["--watch", "--for", "0"],
        ["--find", "--for", "nan"],
    ],
)
def test_what_does_not_go_together_is_told(esair_command, capsys, words) -> None:
    """One line on the standard error, exit code 2."""
    assert esair_command("devices", *words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "expected" in line


@pytest.fixture
def running(start, computer) -> Callable[..., subprocess.Popen[str]]:
    """Start ``esair devices ...`` in a process of its own, for a limited time."""
    return lambda *words: start(
        "devices", *words, "--for", PATIENCE, "--root", computer.root, cwd=computer.root
    )


@pytest.mark.real_clock
@pytest.mark.long
def test_watch_tells_what_comes_and_goes(running, computer) -> None:
    """One JSON object per line: what is there, then each change; Ctrl-C ends it."""
    computer.plug(0)
    process = running("--watch", "--json")

    def told() -> tuple[str, str]:
        line = json.loads(process.stdout.readline())
        return line["event"], line["device"]["path"]

    assert told() == ("there", "/dev/ttyUSB0")
    computer.plug(1, "B")
    assert told() == ("plugged", "/dev/ttyUSB1")
    computer.pull(0)
    assert told() == ("unplugged", "/dev/ttyUSB0")

    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=PATIENCE)
    assert (out, error) == ("", "")
    assert process.returncode == 130


@pytest.mark.long
@pytest.mark.real_clock
def test_watch_tells_people_in_one_line_each(running, computer) -> None:
    """Plus and minus, as in a list of changes."""
    computer.plug(0)
    process = running("--watch")

    assert process.stdout.readline().startswith("  serial /dev/ttyUSB0")
    for number in (1, 2):
        computer.plug(number)
        line = process.stdout.readline()
        assert line.startswith("+ serial /dev/ttyUSB")
        assert "FTDI FT232R USB UART" in line
        computer.pull(number)
        assert process.stdout.readline().startswith("- serial /dev/ttyUSB")
    process.send_signal(signal.SIGINT)


@pytest.mark.long
@pytest.mark.real_clock
def test_find_names_the_one_that_was_unplugged(running, computer) -> None:
    """With its lines for the robot.toml, and not those of the others."""
    computer.plug(0)
    computer.plug(1, "B")
    process = running("--find")

    assert "unplug the device now" in process.stderr.readline()
    computer.pull(1)
    told, _ = process.communicate(timeout=PATIENCE)

    assert process.returncode == 0
    assert "That was FTDI FT232R USB UART: /dev/ttyUSB1" in told
    assert 'port = "usb:0403:6001:B"' in told
    assert "ttyUSB0" not in told


@pytest.mark.real_clock
def test_find_gives_up_when_its_time_is_over(esair_command, computer, capsys) -> None:
    """Exit code 1."""
    words = ["devices", "--find", "--for", "0.1", "--root", computer.root]
    assert esair_command(*words) == 1
    assert "nothing was unplugged" in capsys.readouterr().err
