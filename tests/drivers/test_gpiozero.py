"""Parts of gpiozero on pins that it pretends itself: each class of the two tables."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

gpiozero = pytest.importorskip("gpiozero", reason="the extra 'gpiozero' is missing")

from gpiozero.pins.mock import (  # noqa: E402
    MockFactory,
    MockPin,
    MockPWMPin,
    MockTriggerPin,
)

import esair  # noqa: E402
from esair.drivers.gpiozero import (  # noqa: E402
    READS,
    TELLS,
    Colour,
    EchoSensor,
    GpiozeroActuator,
    GpiozeroSensor,
    encoder,
)
from esair.exceptions import BadValueError, ConfigError  # noqa: E402

# Its parts have threads of their own, on the clock of the computer.
pytestmark = [
    pytest.mark.real_clock,
    pytest.mark.filterwarnings("ignore::gpiozero.PWMSoftwareFallback"),
    # As an error it would end the thread that looks.
    pytest.mark.filterwarnings("ignore::gpiozero.DistanceSensorNoEcho"),
]

PINS = {
    "ButtonBoard": [5, 6],
    "DistanceSensor": {"echo": 5, "trigger": 6, "partial": True, "queue_len": 1},
    "Energenie": {"socket": 1},
    "LEDBarGraph": [5, 6, 13],
    "LightSensor": {"pin": 5, "partial": True},
    "LineSensor": {"pin": 5, "partial": True},
    "Motor": {"forward": 5, "backward": 6},
    "MotionSensor": {"pin": 5, "partial": True},
    "PhaseEnableMotor": {"phase": 5, "enable": 6},
    "PingServer": {"host": "localhost"},
    "RGBLED": {"red": 5, "green": 6, "blue": 13},
    "RotaryEncoder": {"a": 5, "b": 6},
}
"""What a class is made with, if not with one pin."""


def free(name: str) -> esair.Policy:
    return esair.Policy(name, allow={"*": esair.Access.READ | esair.Access.WRITE})


INTERNAL = {"CPUTemperature", "DiskUsage", "LoadAverage", "TimeOfDay"}
"""They ask the computer itself; their files are not on each one."""


@pytest.fixture(autouse=True)
def factory() -> Iterator[Any]:
    before = gpiozero.Device.pin_factory
    made = gpiozero.Device.pin_factory = MockFactory(pin_class=MockPWMPin)
    yield made
    made.reset()
    gpiozero.Device.pin_factory = before


def arguments(device: str) -> Any:
    if device.startswith("MCP"):
        return {} if device in {"MCP3001", "MCP3201", "MCP3301"} else {"channel": 1}
    return PINS.get(device, {"pin": 5})


def most_of(device: Any) -> Any:
    if device.limits is None:
        return True
    return (
        device.limits["red"][1] if isinstance(device.limits, dict) else device.limits[1]
    )


async def used(device: Any) -> Any:
    """What comes of a part in a robot: its reading, or its driver's object."""
    async with esair.Robot(resources=[device], policies=[free(device.name)]) as robot:
        if isinstance(device, esair.Sensor):
            right = await robot.resources.register("me", device.name, esair.Access.READ)
            return await robot.sensors.read(right, fresh=True, timeout=2.0)
        right = await robot.resources.register("me", device.name, esair.Access.WRITE)
        high = most_of(device)
        command = Colour(high, high, high) if isinstance(device.safe, tuple) else high
        assert await robot.actuators.write(right, command)
        return (
            device.object.it.angle
            if "Angular" in type(device.object.it).__name__
            else (device.object.it.value)
        )


@pytest.mark.parametrize(
    "device",
    sorted(
        n
        for n in READS
        if not n.startswith("MCP") and n not in INTERNAL | {"PingServer"}
    ),
)
async def test_each_sensor_is_read(device, factory) -> None:
    """By what the table says of its class."""
    if device == "DistanceSensor":
        factory.pin_class = MockPin
        factory.pin(
            6, pin_class=MockTriggerPin, echo_pin=factory.pin(5), echo_time=0.002
        )

    value = await used(
        GpiozeroSensor(name="part", device=device, arguments=arguments(device))
    )

    assert isinstance(value, bool | int | float | tuple)


async def test_an_encoder_counts_without_an_end(factory) -> None:
    """The class has its count stay at 16, as if the wheel stood still."""
    wheel = GpiozeroSensor(
        name="wheel", device="RotaryEncoder", arguments={"a": 5, "b": 6}
    )
    async with esair.Robot(resources=[wheel], policies=[free("wheel")]) as robot:
        right = await robot.resources.register("me", "wheel", esair.Access.READ)
        for _ in range(40):
            for pin, level in ((5, "low"), (6, "low"), (5, "high"), (6, "high")):
                getattr(factory.pin(pin), f"drive_{level}")()
        assert abs((await robot.sensors.read(right, fresh=True)).value) == 40


def test_an_encoder_that_wraps_does(factory) -> None:
    """At the 16 steps of the class, unless it is told where."""
    for named, ends in (({}, 0), ({"wrap": True}, 16), ({"max_steps": 9}, 9)):
        made = encoder(5, 6, **named)
        assert made.max_steps == ends
        made.close()


def test_a_server_that_is_away_is_soon(tmp_path, monkeypatch) -> None:
    """The program waits for ten seconds by itself, which no reading may take."""
    (ping := tmp_path / "ping").write_text(
        '#!/bin/sh\n[ "$2" = -W1 ] || exit 0; exit 1'
    )
    ping.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    server = GpiozeroSensor(
        name="base", device="PingServer", arguments={"host": "192.0.2.1"}
    )
    server.open()
    assert server.read() is False
    server.close()


@pytest.mark.promise("SC-3")
async def test_what_comes_close_is_told_soon(factory) -> None:
    """The class has the median of nine echoes: it told 0.4 s later, as if it were new."""
    factory.pin_class = MockPin
    trigger = factory.pin(
        6, pin_class=MockTriggerPin, echo_pin=factory.pin(5), echo_time=0.004
    )
    sonar = GpiozeroSensor(
        name="sonar", device="DistanceSensor", arguments={"echo": 5, "trigger": 6}
    )
    async with esair.Robot(resources=[sonar], policies=[free("sonar")]) as robot:
        right = await robot.resources.register("me", "sonar", esair.Access.READ)
        assert (await robot.sensors.read(right, fresh=True, timeout=3.0)).value > 0.6
        assert sonar.object.it.queue_len == 3
        trigger.echo_time = 0.0006
        await asyncio.sleep(0.6)
        assert (await robot.sensors.read(right, fresh=True)).value < 0.2


def test_its_trigger_is_not_taken_from_its_thread(factory, monkeypatch) -> None:
    """The class closes it first, and the thread ends by a traceback."""
    factory.pin_class = MockPin
    factory.pin(6, pin_class=MockTriggerPin, echo_pin=factory.pin(5), echo_time=0.002)
    triggered = threading.Event()

    def sleep(seconds: float) -> None:
        triggered.set()
        time.sleep(0.05)

    monkeypatch.setattr("gpiozero.input_devices.sleep", sleep)
    sonar = EchoSensor(5, 6)
    assert triggered.wait(3.0)
    sonar.close()
    assert sonar.closed


@pytest.mark.fault("D15")
@pytest.mark.parametrize("partial", [True, False])
async def test_a_distance_without_an_echo_is_none(factory, partial) -> None:
    """Its cable is off: gpiozero tells what it heard last, again and again."""
    factory.pin_class = MockPin
    trigger = factory.pin(
        6, pin_class=MockTriggerPin, echo_pin=factory.pin(5), echo_time=0.002
    )
    pins = {"echo": 5, "trigger": 6, "partial": partial, "queue_len": 2}
    sonar = GpiozeroSensor(name="sonar", device="DistanceSensor", arguments=pins)
    async with esair.Robot(resources=[sonar], policies=[free("sonar")]) as robot:
        right = await robot.resources.register("me", "sonar", esair.Access.READ)
        assert (await robot.sensors.read(right, fresh=True, timeout=3.0)).value > 0.1
        trigger.echo_pin = factory.pin(13)
        await asyncio.sleep(1.0)
        with pytest.raises(esair.DeviceFaultError, match="no echo comes"):
            await robot.sensors.read(right, fresh=True, timeout=3.0)


@pytest.mark.fault("D15")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
async def test_what_nobody_looks_at_any_more_is_lost(factory, monkeypatch) -> None:
    """The thread of gpiozero that does has ended; its last values stay for ever."""
    pins = {"pin": 5, "partial": True}
    eye = GpiozeroSensor(name="eye", device="MotionSensor", arguments=pins)
    async with esair.Robot(resources=[eye], policies=[free("eye")]) as robot:
        right = await robot.resources.register("me", "eye", esair.Access.READ)
        await robot.sensors.read(right, fresh=True, timeout=3.0)
        queue = eye.object.it._queue
        monkeypatch.setattr(gpiozero.MotionSensor, "_read", lambda _: 1 / 0)
        await asyncio.to_thread(queue.join, 3.0)
        with pytest.raises(esair.DeviceLostError, match="does not look at it any more"):
            await robot.sensors.read(right, fresh=True, timeout=3.0)
        monkeypatch.undo()
        await asyncio.sleep(1.0)
        assert await robot.sensors.read(right, fresh=True, timeout=3.0)


@pytest.mark.parametrize(
    "device",
    [
        pytest.param(each, marks=[pytest.mark.long] if each == "Energenie" else [])
        for each in sorted(TELLS)
    ],
)
async def test_each_actuator_obeys(device) -> None:
    """It is told the most that it takes, and has it."""
    part = GpiozeroActuator(name="part", device=device, arguments=arguments(device))

    value = await used(part)

    most = most_of(part)
    wanted = (most,) * 3 if isinstance(part.safe, tuple) else most
    assert value == (
        wanted if isinstance(wanted, tuple) else pytest.approx(float(wanted))
    )


def test_thirty_classes_are_known() -> None:
    """Each of them is used, or at least looked at, here."""
    assert len(READS.keys() | TELLS.keys()) >= 30


@pytest.mark.parametrize("device", sorted([*INTERNAL, "PingServer"]))
async def test_what_asks_the_computer_can_be_made(device, tmp_path) -> None:
    """With the arguments of its class; the class is there under that name."""
    assert hasattr(getattr(gpiozero, device), READS[device])


@pytest.mark.parametrize("device", sorted(n for n in READS if n.startswith("MCP")))
def test_converters_are_in_the_package(device) -> None:
    """Each has the value that the table reads."""
    assert hasattr(getattr(gpiozero, device), READS[device])


async def test_a_motor_stands_after_the_robot(factory) -> None:
    """It is told safe last, and its pins are low."""
    motor = GpiozeroActuator(
        name="left", device="Motor", arguments={"forward": 5, "backward": 6}
    )
    async with esair.Robot(resources=[motor], policies=[free("left")]) as robot:
        right = await robot.resources.register("me", "left", esair.Access.WRITE)
        assert await robot.actuators.write(right, -0.5)
        assert (factory.pin(5).state, factory.pin(6).state) == (0, 0.5)
        with pytest.raises(BadValueError, match="left"):
            await robot.actuators.write(right, 1.5)

    assert (factory.pin(5).state, factory.pin(6).state) == (0, 0)


async def test_a_servo_does_not_turn_by_itself(factory) -> None:
    """Neither when it is made nor by its safe command, which is to stay."""
    servo = GpiozeroActuator(name="arm", device="AngularServo", arguments={"pin": 5})
    async with esair.Robot(resources=[servo], policies=[free("arm")]) as robot:
        assert servo.object.it.value is None
        right = await robot.resources.register("me", "arm", esair.Access.WRITE)
        assert await robot.actuators.write(right, 45.0)
        await asyncio.sleep(0.4)
        assert servo.object.it.angle == pytest.approx(45.0)


@pytest.mark.parametrize("device", ["Servo", "AngularServo"])
async def test_a_servo_whose_pins_are_a_list_does_not_turn_by_itself(
    factory, device
) -> None:
    """Its class would have it turn to its middle when it is made."""
    servo = GpiozeroActuator(name="arm", device=device, arguments=[5])
    async with esair.Robot(resources=[servo]):
        assert servo.object.it.value is None


def test_a_servo_that_turns_the_other_way_has_the_angles_in_between() -> None:
    """As in the examples of the package, where the least angle is the greater one."""
    ends = {"pin": 5, "min_angle": 42, "max_angle": -44}
    servo = GpiozeroActuator(name="arm", device="AngularServo", arguments=ends)
    assert servo.limits == (-44.0, 42.0)


def test_what_is_not_in_the_table_is_named() -> None:
    """With what is."""
    with pytest.raises(ConfigError, match="expected one of AngularServo, Buzzer"):
        GpiozeroActuator(device="Toaster")
    with pytest.raises(ConfigError, match="expected one of Button"):
        GpiozeroSensor(device="Toaster")
