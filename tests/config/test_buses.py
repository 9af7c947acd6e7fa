"""The buses of the package, as a file names them."""

import pytest

from esair import buses, config
from esair.buses.serial import _ports
from esair.exceptions import ConfigError


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        ('type = "serial"\nport = "/dev/ttyS0"\nbaudrate = 9600', "SerialBus"),
        (
            'type = "serial"\nport = "/dev/ttyS0"\nparity = "E"\nstopbits = 2',
            "SerialBus",
        ),
        ('type = "serial"\nport = "/dev/ttyS0"\nframing = "nmea"', "SerialBus"),
        ('type = "can"\ninterface = "socketcan"\nchannel = "can0"', "CanBus"),
        ('type = "can"\nchannel = "can0"\nbitrate = 500000', "CanBus"),
        ('type = "can"\nchannel = "a"\noptions = {{ app_name = "x" }}', "CanBus"),
        ('type = "i2c"\nbus = 1', "I2CBus"),
        ('type = "spi"\nbus = 1\nmode = 3', "SpiBus"),
    ],
)
def test_the_buses_of_the_media_need_no_module_name(project, table, kind) -> None:
    """serial, can, i2c, spi, with the keys of their classes and of what is behind them."""
    described = config.load(project.write(f"[bus.x]\n{table}\n"))

    assert type(described.buses["x"]) is getattr(buses, kind)
    assert described.buses["x"].name == "x"
    assert not described.buses["x"].is_open


def test_bytes_are_written_as_strings(project) -> None:
    """TOML has no bytes."""
    text = (
        '[bus.x]\ntype = "serial"\nport = "/dev/ttyS0"\n'
        'framing = {{ type = "lines", delimiter = "\\r\\n" }}\n'
    )

    assert config.load(project.write(text)).buses["x"].framing.delimiter == b"\r\n"


@pytest.mark.parametrize(
    ("table", "key", "told"),
    [
        ('type = "serial"\nport = "x"\nbaudrte = 1', "bus.x.baudrte", "'baudrate'?"),
        ('type = "serial"\nport = "x"\nparity = "X"', "bus.x.parity", "one of 'N'"),
        ('type = "serial"\nport = "x"\nstopbits = 0', "bus.x.stopbits", "1, 1.5 or 2"),
        ('type = "serial"', "bus.x.port", "expected the path"),
        (
            'type = "serial"\nport = "x"\nframing = "cob"',
            "bus.x.framing",
            "did you mean 'cobs'?",
        ),
        (
            'type = "serial"\nport = "x"\nframing = {{ type = "lines", max = 3 }}',
            "bus.x.framing",
            "lines has no 'max'",
        ),
        ('type = "can"\nchannel = "can0"\nbitrate = "fast"', "bus.x.bitrate", "whole"),
        ('type = "can"\nchannel = "a"\noptions = 3', "bus.x.options", "a table"),
        (
            'type = "can"\nchannel = "a"\noptions = {{ channel = "b" }}',
            "bus.x.options.channel",
            "its place is bus.x.channel",
        ),
        ('type = "i2c"\nbus = -1', "bus.x.bus", "the N of /dev/i2c-N"),
        ('type = "i2c"\nbus = "1"', "bus.x.bus", "a whole number"),
    ],
)
def test_mistakes_in_their_keys_are_told(project, table, key, told) -> None:
    """A misspelled key is not handed on to the package behind."""
    project.write(f"[bus.x]\n{table}\n")

    assert told in project.mistakes()[key]


def test_a_bus_class_of_ones_own_must_be_a_bus(project) -> None:
    """Whatever has the right methods but is none would lack an executor."""
    project.write('[bus.x]\ntype = "{m}:Sonar"\n')

    with pytest.raises(ExceptionGroup) as caught:
        config.load(project.file)
    (error,) = caught.value.exceptions
    assert isinstance(error, ConfigError)
    assert "expected a Bus" in str(error)


@pytest.mark.parametrize("second", ["usb:0403:6001", "{link}", "{port}"])
def test_a_port_has_one_bus(project, tmp_path, monkeypatch, second) -> None:
    """However it is written, if it is the same device file now."""
    port, link = tmp_path / "ttyUSB7", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    monkeypatch.setattr(_ports, "find_port", lambda _identity: str(link))
    text = '[bus.{}]\ntype = "serial"\nport = "{}"\n'
    named = second.format(link=link, port=port)
    both = text.format("a", port) + text.format("b", named)

    with pytest.raises(ExceptionGroup) as caught:
        config.load(project.write(both))

    (mistake,) = caught.value.exceptions
    assert str(mistake).endswith(
        f"bus.b.port: {port} belongs to the bus 'a': a port has one bus"
    )


def test_ports_that_are_not_there_are_told_apart_by_their_names(
    project, monkeypatch
) -> None:
    """Nobody knows which they will be; and each URL is a line of its own."""

    def find(identity: str) -> str:
        raise ConnectionError(f"{identity} is not there")

    monkeypatch.setattr(_ports, "find_port", find)
    ports = ["usb:0403:6001", "usb:2e8a:0005", "loop://", "loop://", "/dev/none"]
    tables = [
        f'[bus.b{n}]\ntype = "serial"\nport = "{port}"\n'
        for n, port in enumerate(ports)
    ]

    assert len(config.load(project.write("".join(tables))).buses) == len(ports)
