"""Vehicles by MAVLink: what they tell, and sticks that let go by themselves."""

from __future__ import annotations

import asyncio
import math
import socket
import threading
from typing import Any

import pytest
from tests.drivers.parts import Powered, opened

pytest.importorskip("pymavlink", reason="pip install 'esair[mavlink]'")

import esair
from esair.buses import SerialBus
from esair.buses.serial import FakeSerial
from esair.drivers.mavlink import (
    Attitude,
    Heartbeat,
    MavlinkSensor,
    Position,
    RcOverride,
)
from esair.drivers.mavlink.fake import FakeVehicle
from esair.exceptions import BadValueError, ConfigError, DeviceLostError
from esair.framing import Mavlink
from esair.testing import ActuatorContract, SensorContract

pytestmark = pytest.mark.virtual_clock

STICKS: dict[str, Any] = {
    "channels": {"steering": 1, "throttle": 3},
    "safe": {"steering": 0.0, "throttle": 0.0},
}


class OnLine(Powered):
    def line(self) -> FakeSerial:
        line = FakeSerial(framing="mavlink")
        self.far = FakeVehicle(line)
        return line


class TestSensor(OnLine, SensorContract):
    keeps_nothing = "what it is told it is told again"

    def make(self) -> MavlinkSensor:
        return MavlinkSensor(message="ATTITUDE", period=0.1, bus=self.line())


class TestOverride(OnLine, ActuatorContract):
    keeps_nothing = "what it was told it forgets by itself"

    def make(self) -> RcOverride:
        return RcOverride(**STICKS, bus=self.line())

    def commands(self) -> list[Any]:
        return [{"steering": -1.0, "throttle": 0.5}, {"steering": 1.0, "throttle": 0.0}]


def packet(framing: Mavlink, message: str, *fields: Any) -> bytes:
    mav = framing.dialect.MAVLink(None, 7, 1)
    kind = getattr(framing.dialect, f"MAVLink_{message}_message")
    return bytes(kind(*fields).pack(mav, force_mavlink1=framing.version == 1))


@pytest.mark.parametrize("version", [1, 2])
def test_a_packet_is_found_in_whatever_is_around_it(version: Any) -> None:
    """Also behind one that was cut, and one whose dialect is another."""
    framing = Mavlink(version=version)
    wire = packet(framing, "heartbeat", 10, 3, 128, 0, 4, 3)
    unknown = bytearray(wire)
    unknown[7 if version == 2 else 5] = 255
    stream = b"\xfd\xfe" + wire[:9] + wire + bytes(unknown) + wire + bytes(300)

    payloads = framing.feed(stream)

    assert payloads == [wire[2:-2]] * 2
    assert framing.bad_frames > 0
    assert framing.encode(payloads[0]) == wire
    with pytest.raises(BadValueError, match="no such message"):
        framing.encode(bytes(unknown[2:-2]))


async def test_readings_are_in_units_of_the_house() -> None:
    """Radians, metres and degrees of WGS 84; other messages as they are, or scaled."""
    line = FakeSerial(framing="mavlink")
    FakeVehicle(line, system=9)
    FakeVehicle(line, system=1).yaw = math.pi / 2
    beat = MavlinkSensor(name="beat", bus=line)
    turned = MavlinkSensor(message="ATTITUDE", name="turned", bus=line)
    place = MavlinkSensor(message="GLOBAL_POSITION_INT", name="place", bus=line)
    raw = MavlinkSensor(
        message="ATTITUDE", value="yaw", scale=2.0, name="raw", bus=line
    )
    async with opened(beat, turned, place, raw):
        assert await anext(beat.stream()) == Heartbeat(True, 0, 4, 10)
        attitude = await anext(turned.stream())
        assert isinstance(attitude, Attitude)
        assert attitude.yaw == pytest.approx(math.pi / 2)
        position = await anext(place.stream())
        assert isinstance(position, Position)
        assert position.heading == pytest.approx(math.pi / 2)
        assert await anext(raw.stream()) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("message", "field", "value"),
    [
        ("DISTANCE_SENSOR", "id", "current_distance"),
        ("NAMED_VALUE_FLOAT", "name", "value"),
    ],
)
async def test_of_several_of_a_kind_one_is_read(
    message: str, field: str, value: str
) -> None:
    """The distance behind is not that ahead; one that falls silent is lost alone."""
    line = FakeSerial(framing="mavlink")
    kind = getattr(line.framing.dialect, f"MAVLink_{message.lower()}_message")
    mav = line.framing.dialect.MAVLink(None, 1, 1)
    names: list[Any] = [0, 1] if field == "id" else [b"ahead", b"behind"]
    there = {name: 10 + n for n, name in enumerate(names)}

    def packed() -> bytes:
        fields: dict[str, Any] = dict.fromkeys(kind.fieldnames, 0)
        if "quaternion" in fields:
            fields["quaternion"] = [0.0] * 4
        told = [fields | {field: name, value: far} for name, far in there.items()]
        return b"".join(bytes(kind(**each).pack(mav)) for each in told)

    line.repeat(packed, 0.1)
    ahead, behind = (
        MavlinkSensor(
            name=f"at_{n}",
            message=message,
            value=value,
            instance=name if field == "id" else name.decode(),
            bus=line,
        )
        for n, name in enumerate(names)
    )
    async with opened(ahead, behind):
        streams = ahead.stream(), behind.stream()
        assert {await anext(streams[0]) for _ in range(5)} == {10}
        assert {await anext(streams[1]) for _ in range(5)} == {11}
        del there[names[1]]
        with pytest.raises(DeviceLostError, match=f"no {message} .* instance"):
            _ = [told async for told in streams[1]]
        assert await anext(streams[0]) == 10


def test_a_message_that_there_is_but_once_has_no_instance() -> None:
    """Said as soon as it is made."""
    line = FakeSerial(framing="mavlink")
    with pytest.raises(ConfigError, match="has but one ATTITUDE"):
        MavlinkSensor(name="turn", message="ATTITUDE", instance=0, bus=line)


@pytest.mark.parametrize(
    ("message", "field", "none", "known"),
    [
        ("SYS_STATUS", "voltage_battery", 65535, 11_900),
        ("SYS_STATUS", "battery_remaining", -1, 80),
        ("BATTERY_STATUS", "temperature", 32767, 2500),
        ("GLOBAL_POSITION_INT", "hdg", 65535, 9000),
        ("ESTIMATOR_STATUS", "pos_horiz_accuracy", math.nan, 0.5),
    ],
)
async def test_what_a_vehicle_does_not_know_is_no_reading(
    message: str, field: str, none: float, known: float
) -> None:
    """Which number says so is told by the standard; the vehicle is there all the same."""
    line = FakeSerial(framing="mavlink")
    kind = getattr(line.framing.dialect, f"MAVLink_{message.lower()}_message")
    mav = line.framing.dialect.MAVLink(None, 1, 1)
    told = iter([none, none, *[known] * 99])

    def packed() -> bytes:
        fields: dict[str, Any] = dict.fromkeys(kind.fieldnames, 0)
        if "voltages" in fields:
            fields |= {"voltages": [0] * 10, "voltages_ext": [0] * 4}
        return bytes(kind(**fields | {field: next(told)}).pack(mav))

    line.repeat(packed, 0.1)
    sensor = MavlinkSensor(message=message, value=field, bus=line)
    async with opened(sensor):
        assert await anext(sensor.stream()) == known
        assert sensor.counts() == {"unknown": 1}


@pytest.mark.promise("RES-4")
async def test_how_often_a_message_comes_is_told_again() -> None:
    """A vehicle that restarts quickly is not missed, and a radio may lose what is said."""
    line = FakeSerial(framing="mavlink")
    vehicle = FakeVehicle(line)
    sensor = MavlinkSensor(message="ATTITUDE", period=0.1, name="yaw", bus=line)
    async with esair.Robot(resources=[sensor]) as robot:
        await asyncio.sleep(1.0)
        asked = vehicle.heard.pop("COMMAND_LONG")
        await asyncio.sleep(6.0)
        assert vehicle.heard["COMMAND_LONG"].to_dict() == asked.to_dict()
        assert robot.resources.query("yaw").losses == 0


async def test_a_message_comes_as_often_as_any_needs_it() -> None:
    """Several values of one message are sensors of their own."""
    line = FakeSerial(framing="mavlink")
    vehicle = FakeVehicle(line)
    yaw, roll = (
        MavlinkSensor(message="ATTITUDE", value=v, period=p, name=v, bus=line)
        for v, p in (("yaw", 0.1), ("roll", 1.0))
    )
    async with opened(yaw, roll):
        assert vehicle.heard["COMMAND_LONG"].param2 == 0.1e6
        await yaw.close()
        await roll.open()
        assert vehicle.heard["COMMAND_LONG"].param2 == 1e6


async def test_a_place_of_nought_is_none() -> None:
    """ArduPilot tells it until it knows where it is."""
    line = FakeSerial(framing="mavlink")
    kind = line.framing.dialect.MAVLink_global_position_int_message
    mav = line.framing.dialect.MAVLink(None, 1, 1)
    north = iter([0, 0, *[470_000_000] * 99])
    line.repeat(lambda: bytes(kind(0, next(north), 0, 9, 9, 0, 0, 0, 0).pack(mav)), 0.1)
    place = MavlinkSensor(message="GLOBAL_POSITION_INT", bus=line)
    async with opened(place):
        assert (await anext(place.stream())).latitude_deg == pytest.approx(47.0)


async def test_a_vehicle_that_signs_is_heard_too() -> None:
    """Its signature is left out; packets with other flags are not read."""
    line = FakeSerial(framing="mavlink")
    mav = line.framing.dialect.MAVLink(None, 1, 1)
    mav.signing.secret_key, mav.signing.sign_outgoing = bytes(range(32)), True
    beat = line.framing.dialect.MAVLink_heartbeat_message(10, 3, 128, 0, 4, 3)
    sensor = MavlinkSensor(bus=line)
    line.repeat(lambda: bytes(beat.pack(mav)), 0.5)
    async with opened(sensor):
        assert await anext(sensor.stream()) == Heartbeat(True, 0, 4, 10)
        talk = sensor._talk
        plain = line.framing.feed(bytes(beat.pack(mav)))[0]
        assert talk.decoded(plain, 1, 0) is not None
        assert talk.decoded(b"\x02" + plain[1:], 1, 0) is None


async def test_the_heartbeat_of_a_gimbal_is_not_the_vehicles() -> None:
    """It has the vehicle's number, and is no autopilot: it does not keep it alive."""
    line = FakeSerial(framing="mavlink")
    far = FakeVehicle(line)
    sensor = MavlinkSensor(bus=line, silent_after=3.0)
    assert isinstance(line.framing, Mavlink)
    gimbal = line.framing.dialect.MAVLink(None, 1, 154)
    kind = line.framing.dialect.MAVLink_heartbeat_message
    line.repeat(lambda: bytes(kind(26, 8, 0, 0, 4, 3).pack(gimbal)), 0.3)
    await line.open()
    await sensor.open()

    values = sensor.stream()
    assert [(await anext(values)).armed for _ in range(5)] == [True] * 5
    far.silent = True
    with pytest.raises(DeviceLostError, match="no HEARTBEAT of system 1 for 3 s"):
        await anext(values)
    await line.close()


async def test_a_beat_that_waits_behind_another_message_is_in_time() -> None:
    """The event loop was held up until the next beat was due."""
    line = FakeSerial(framing="mavlink")
    dialect = line.framing.dialect
    mav = dialect.MAVLink(None, 1, 1)
    beat = bytes(dialect.MAVLink_heartbeat_message(10, 3, 128, 0, 4, 3).pack(mav))
    other = bytes(dialect.MAVLink_attitude_message(0, *[0.0] * 6).pack(mav))
    sensor = MavlinkSensor(bus=line, silent_after=1.0)
    await line.open()
    values = sensor.stream()
    for _ in range(3):
        reading = asyncio.ensure_future(anext(values))
        await asyncio.sleep(1.0)
        line.feed(other + beat)
        assert (await reading).armed
    await line.close()


async def test_sticks_that_are_not_held_let_go() -> None:
    """The vehicle's own time-out ends what was told last; its station is known to it."""
    line = FakeSerial(framing="mavlink")
    rover = FakeVehicle(line, own_timeout=1.0)
    sticks = RcOverride(**STICKS, own_timeout=1.0, bus=line)
    async with opened(sticks):
        await sticks.write({"steering": 0.0, "throttle": 1.0})
        await asyncio.sleep(0.5)
        assert rover.sticks == [1500, 2000]
        assert rover.speed == 5.0
        assert rover.heard["RC_CHANNELS_OVERRIDE"].chan2_raw == 65535
        await asyncio.sleep(1.0)
        assert rover.speed == 0.0
        assert rover.heard["HEARTBEAT"].type == 6
        before = rover.heard["HEARTBEAT"]
        await asyncio.sleep(1.1)
        assert rover.heard["HEARTBEAT"] is not before


async def test_a_line_that_stands_ends_no_heartbeats() -> None:
    """They go on with it: else the vehicle would act as if its station had gone."""
    line = FakeSerial(framing="mavlink", xonxoff=True)
    vehicle = FakeVehicle(line)
    async with opened(RcOverride(**STICKS, bus=line)):
        line.xoff()
        await asyncio.sleep(3.0)
        line.xon()
        vehicle.heard.clear()
        await asyncio.sleep(3.0)
        assert "HEARTBEAT" in vehicle.heard


def test_mistakes_are_told() -> None:
    """A message, a field and a stick that are none."""
    line = FakeSerial(framing="mavlink")
    with pytest.raises(ConfigError, match="message: the dialect has no 'SONG'"):
        MavlinkSensor(message="SONG", bus=line)
    with pytest.raises(ConfigError, match="value: expected one of time_boot_ms, roll"):
        MavlinkSensor(message="ATTITUDE", value="rol", bus=line)
    with pytest.raises(ConfigError, match="channels: expected a channel for each"):
        RcOverride(channels={"a": 1}, safe={"b": 0.0}, bus=line)
    with pytest.raises(ConfigError, match="channels: expected another channel for"):
        RcOverride(channels={"a": 1, "b": 1}, safe={"a": 0.0, "b": 0.0}, bus=line)
    with pytest.raises(ConfigError, match="framing='mavlink'"):
        MavlinkSensor(bus=FakeSerial())


@pytest.mark.real_clock
async def test_pymavlink_itself_is_the_vehicle(monkeypatch) -> None:
    """Its own connection, on TCP: it is heard, and hears the sticks."""
    monkeypatch.setenv("MAVLINK20", "1")  # else it speaks version 1
    from pymavlink import mavutil

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    vehicle = mavutil.mavlink_connection(
        f"tcpin:127.0.0.1:{port}", source_system=1, dialect="ardupilotmega"
    )
    heard: list[Any] = []
    done = threading.Event()

    def drive() -> None:
        while not done.wait(0.02):
            told = vehicle.recv_match(blocking=False)
            if told is not None:
                heard.append(told)
            vehicle.mav.heartbeat_send(10, 3, 128, 0, 4)
            vehicle.mav.attitude_send(0, 0.5, 0, 0, 0, 0, 0)

    driving = threading.Thread(target=drive)
    driving.start()
    try:
        bus = SerialBus(name="v", port=f"socket://127.0.0.1:{port}", framing="mavlink")
        turned = MavlinkSensor(message="ATTITUDE", name="turned", bus=bus)
        sticks = RcOverride(**STICKS, name="sticks", bus=bus)
        async with opened(turned, sticks):
            assert (await anext(turned.stream())).roll == 0.5
            await sticks.write({"steering": 1.0, "throttle": -1.0})
            async with asyncio.timeout(10.0):
                while "RC_CHANNELS_OVERRIDE" not in {m.get_type() for m in heard}:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
    finally:
        done.set()
        driving.join()
        vehicle.close()

    told = next(m for m in heard if m.get_type() == "RC_CHANNELS_OVERRIDE")
    assert (told.chan1_raw, told.chan3_raw) == (2000, 1000)


@pytest.mark.promise("SC-3")
def test_a_message_that_comes_late_is_no_silence() -> None:
    """A reading is current for three of the periods that the vehicle is told."""
    line = FakeSerial(framing="mavlink")
    often = MavlinkSensor(message="ATTITUDE", period=0.1, bus=line)
    assert often.period == pytest.approx(0.3)
    assert MavlinkSensor(message="ATTITUDE", silent_after=2.0, bus=line).period == 2.0
