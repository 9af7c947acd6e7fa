"""A device is told its settings while it does nothing else."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

import pytest

import esair
from esair.testing import FakeActuator

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("CALL-3")]


class Alone:
    """Notes which calls of its driver met others."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.now: list[str] = []
        self.met: set[tuple[str, ...]] = set()
        self.done: list[str] = []

    async def does(self, what: str, seconds: float) -> None:
        self.now.append(what)
        if len(self.now) > 1:
            self.met.add(tuple(self.now))
        try:
            await asyncio.sleep(seconds)
        finally:
            self.now.remove(what)
        self.done.append(what)


class Scale(Alone, esair.Sensor[float]):
    """Is busy most of the time."""

    rate = 73.0
    gain = esair.setting(1.0)

    async def read(self) -> float:
        await self.does("read", 0.011)
        return self.gain

    async def apply(self, **changes: Any) -> None:
        await self.does("apply", 0.029)


class Motor(Alone, esair.Actuator[float]):
    """Takes its time for commands and for settings."""

    safe = 0.0
    command_timeout = 2.0
    gain = esair.setting(1.0)

    async def write(self, command: float) -> None:
        await self.does(f"{command}", 0.031 if command else 0.0)

    async def apply(self, **changes: Any) -> None:
        await self.does("apply", 0.5)


async def test_a_sensor_is_not_read_meanwhile(user_of: Any) -> None:
    """A poll that comes in that time is left out; it is read again after."""
    scale, user = Scale(), user_of("user", scale=esair.reads(float, configure=True))
    async with esair.Robot(resources=[scale], behaviors=[user]):
        for gain in (2.0, 3.0, 4.0):
            configured = asyncio.ensure_future(user.scale.configure(gain=gain))
            while not configured.done():
                await user.scale.read(fresh=True)
            assert await user.scale.read(fresh=True) == gain
    assert scale.met == set()
    assert scale.done.count("apply") == 3


async def test_an_actuator_is_not_moved_meanwhile(user_of: Any) -> None:
    """A write waits for the settings, and they for a write that is on its way."""
    motor, user = Motor(), user_of("user", motor=esair.writes(float, configure=True))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        first = asyncio.ensure_future(user.motor.write(1.0))
        await asyncio.sleep(0.011)
        configured = asyncio.ensure_future(user.motor.configure(gain=2.0))
        await asyncio.sleep(0.07)
        assert await user.motor.write(2.0)
        assert await first
        await configured
        assert motor.done[-3:] == ["1.0", "apply", "2.0"]
    assert motor.met == set()


async def test_what_is_safe_does_not_wait_for_settings(user_of: Any) -> None:
    """Nor does it cost them anything."""
    motor, user = Motor(), user_of("user", motor=esair.writes(float, configure=True))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        assert await user.motor.write(1.0)
        configured = asyncio.ensure_future(user.motor.configure(gain=2.0))
        await asyncio.sleep(0.05)
        robot.halt("enough")
        await asyncio.sleep(0.01)
        assert motor.now == ["apply"]
        assert motor.done[-1] == "0.0"
        await configured
        assert motor.gain == 2.0
        await asyncio.sleep(0.1)
        assert motor.done[-2:] == ["0.0", "apply"]  # which has undone nothing


async def test_who_gives_up_waiting_disturbs_nobody(user_of: Any) -> None:
    """What was begun goes on, in its turn: whether it waits or is on its way."""
    motor, user = Motor(), user_of("user", motor=esair.writes(float, configure=True))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        for before in (0.0, 0.1):
            writing = asyncio.ensure_future(user.motor.write(1.0))
            await asyncio.sleep(before)
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.02):
                    await user.motor.configure(gain=2.0)
            assert await writing
            assert await user.motor.write(2.0)
        assert motor.met == set()
        assert motor.gain == 2.0


async def test_a_device_that_is_busy_for_long_keeps_its_settings(user_of: Any) -> None:
    """It was not told: it stays READY, and who asked hears that it had no turn."""

    class Slow(FakeActuator[float]):
        deadline = 9.0
        gain = esair.setting(1.0)

        async def write(self, command: float) -> None:
            await super().write(command)

        async def apply(self, **changes: Any) -> None:
            raise AssertionError

    motor = Slow("motor", safe=0.0, command_timeout=9.0)
    user = user_of("user", motor=esair.writes(float, configure=True))
    async with esair.Robot(resources=[motor], behaviors=[user]) as robot:
        motor.slow(5.0)
        writing = asyncio.ensure_future(user.motor.write(1.0))
        await asyncio.sleep(0.01)
        motor.deadline = 1.0
        with pytest.raises(
            esair.DriverStuckError, match="apply of 'motor' got no turn"
        ):
            await user.motor.configure(gain=2.0)
        assert robot.resources.query("motor").state is esair.ResourceState.READY
        assert motor.gain == 1.0
        motor.slow(0.0)
        await writing


@pytest.mark.promise("CALL-1", "AC-1")
@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("what", ["settings", "operation"])
async def test_a_write_waits_for_what_takes_longer_than_a_write(
    what: str, after: bool, user_of: Any
) -> None:
    """Nobody fails because somebody else has the device for a time that it may take."""

    class Valve(Motor):
        deadline = 0.2

        @esair.operation(deadline=2.0)
        async def flush(self) -> None:
            await self.does("flush", 0.9)

    valve, user = Valve(), user_of("user", valve=esair.writes(float, configure=True))
    async with esair.Robot(resources=[valve], behaviors=[user]):
        first = asyncio.ensure_future(user.valve.write(1.0)) if after else None
        await asyncio.sleep(0.011)
        second = asyncio.ensure_future(user.valve.write(2.0)) if after else None
        if what == "settings":
            other = asyncio.ensure_future(user.valve.configure(gain=2.0))
        else:
            other = asyncio.ensure_future(user.valve.operate("flush"))
        await asyncio.sleep(0.05)
        assert await (second or user.valve.write(2.0))
        await other
        if first is not None:
            await first
        assert valve.done[-1] == "2.0"
    assert valve.met == set()


async def test_a_setting_may_have_any_name(user_of: Any) -> None:
    """Of what tells the device nothing is meant by it, at the opening and later."""

    class Named(FakeActuator[float]):
        limit = esair.setting(1.0)
        method = esair.setting(1.0)
        kind = esair.setting(1.0)

        async def apply(self, **changes: Any) -> None:
            told.append(changes)

    told: list[dict[str, Any]] = []
    motor = Named("motor", safe=0.0)
    motor.limit, motor.method, motor.kind = 2.0, 3.0, 4.0
    user = user_of("user", motor=esair.writes(float, configure=True))
    async with esair.Robot(resources=[motor], behaviors=[user]):
        assert told == [{"limit": 2.0, "method": 3.0, "kind": 4.0}]
        await user.motor.configure(limit=5.0, method=6.0)
        assert told[1:] == [{"limit": 5.0, "method": 6.0}]


async def test_what_fails_when_nobody_waits_any_more_is_no_noise(
    user_of: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Who gave up is told nothing, and the event loop does not complain of it."""

    class Picky(Motor):
        async def apply(self, **changes: Any) -> None:
            await super().apply(**changes)
            if changes["gain"] > 1.0:
                raise ValueError("too much")

    motor, user = (
        Picky(name="motor"),
        user_of("user", motor=esair.writes(float, configure=True)),
    )
    async with esair.Robot(resources=[motor], behaviors=[user]):
        configuring = asyncio.ensure_future(user.motor.configure(gain=2.0))
        await asyncio.sleep(0.1)
        configuring.cancel()
        del configuring
        await asyncio.sleep(2.0)
        gc.collect()
        assert motor.done == ["0.0", "apply", "apply"]
    assert "never retrieved" not in caplog.text
