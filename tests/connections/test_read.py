"""Reading a sensor: newest, fresh, streamed, past; and never too old."""

from __future__ import annotations

import asyncio
import fractions
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import esair
from esair.testing import FakeSensor, VirtualLoop

pytestmark = pytest.mark.virtual_clock


@pytest.mark.promise("SC-1")
async def test_the_newest_value_is_enough_within_the_period(
    fake_sensor: Any, user_of: Any
) -> None:
    """The device is asked again only when the newest reading is older than its period."""
    sonar = fake_sensor("sonar", 1.0, rate=10.0)
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]):
        assert await user.sonar.read() == 1.0
        for _ in range(100):
            await user.sonar.read()
        assert sonar.reads == 1
        await asyncio.sleep(0.11)
        await user.sonar.read()
        assert sonar.reads == 2


@pytest.mark.promise("SC-1")
async def test_readers_of_a_silent_device_have_each_their_own_time(
    fake_sensor: Any, user_of: Any
) -> None:
    """Whoever asked first, and also when one of them gives up meanwhile."""
    sonar = fake_sensor("sonar", 1.0, rate=10.0)
    user = user_of("user", sonar=esair.reads(float))
    loop, told = asyncio.get_running_loop(), []

    async def read(timeout: float) -> None:
        with pytest.raises(esair.StaleReadingError):
            await user.sonar.read(timeout=timeout)
        told.append((timeout, round(loop.time() - began, 6)))

    async with esair.Robot(resources=[sonar], behaviors=[user]):
        sonar.stall()
        began = loop.time()
        readers = [asyncio.create_task(read(each)) for each in (0.4, 0.1, 0.3, 0.2)]
        await asyncio.sleep(0.15)
        readers.pop().cancel()
        await asyncio.gather(*readers)

    assert told == [(0.1, 0.1), (0.3, 0.3), (0.4, 0.4)]


@pytest.mark.promise("SC-1")
async def test_every_reading_has_its_time_and_number(
    fake_sensor: Any, user_of: Any
) -> None:
    """The number grows by one with each value, the time is that of its arrival."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))
    loop = asyncio.get_running_loop()

    async with esair.Robot(resources=[sonar], behaviors=[user]):
        first = await user.sonar.reading()
        await asyncio.sleep(1.0)
        second = await user.sonar.reading()

        assert (first.value, first.sequence, second.sequence) == (1.0, 1, 2)
        assert second.time - first.time == pytest.approx(1.0)
        assert second.time == loop.time()


@pytest.mark.promise("SC-1")
async def test_fresh_is_newer_than_the_call(user_of: Any) -> None:
    """A transaction that is under way already does not count as fresh."""
    counter = 0

    class Slow(esair.Sensor[int]):
        async def read(self) -> int:
            nonlocal counter
            counter += 1
            mine = counter
            await asyncio.sleep(0.1)
            return mine

    user = user_of("user", slow=esair.reads(int))
    async with esair.Robot(resources=[Slow()], behaviors=[user]):
        under_way = asyncio.create_task(user.slow.read())
        await asyncio.sleep(0.05)
        joins = asyncio.create_task(user.slow.read())
        fresh = asyncio.create_task(user.slow.read(fresh=True))

        assert await under_way == 1
        assert await joins == 1
        assert await fresh == 2


@pytest.mark.promise("SC-2")
async def test_one_transaction_serves_all_who_ask_at_once(user_of: Any) -> None:
    """A thousand readers cost one question to the device, fresh or not."""
    asked = 0

    class Slow(esair.Sensor[int]):
        async def read(self) -> int:
            nonlocal asked
            asked += 1
            await asyncio.sleep(0.1)
            return asked

    user = user_of("user", slow=esair.reads(int))
    async with esair.Robot(resources=[Slow()], behaviors=[user]):
        values = await asyncio.gather(
            *(user.slow.read(fresh=bool(n % 2)) for n in range(1000))
        )

    assert set(values) == {1}
    assert asked == 1


@pytest.mark.promise("SC-2")
async def test_followers_do_not_add_to_the_cost(fake_sensor: Any) -> None:
    """Fifty reactions at one sensor poll it as often as one does."""

    class Look(esair.Reaction):
        sonar = esair.reads(float)

        def react(self, sonar: float) -> None:
            return None

    asked = []
    for count in (1, 50):
        sonar = fake_sensor("sonar", 1.0, rate=10.0)
        looks = [Look(name=f"look_{n}") for n in range(count)]
        async with esair.Robot(resources=[sonar], behaviors=looks):
            await asyncio.sleep(2.0)
        asked.append(sonar.reads)

    assert asked[0] == asked[1]
    assert asked[0] == pytest.approx(20, abs=1)


@pytest.mark.promise("SC-1")
async def test_waiting_readers_are_bounded(fake_sensor: Any, user_of: Any) -> None:
    """Over the bound a reader is refused at once."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]):
        sonar.stall()
        waiting = [asyncio.create_task(user.sonar.read()) for _ in range(1024)]
        await asyncio.sleep(0.01)
        with pytest.raises(esair.BusyError, match="1024"):
            await user.sonar.read()
        sonar.resume()
        assert await asyncio.gather(*waiting) == [1.0] * 1024


@pytest.mark.promise("SC-3")
@pytest.mark.fault("D14")
async def test_a_silent_pusher_is_stale(fake_sensor: Any, user_of: Any) -> None:
    """What it pushed is current for max_age, and then never again."""
    radar = fake_sensor("radar")
    user = user_of("user", radar=esair.reads(float, max_age=0.5))

    async with esair.Robot(resources=[radar], behaviors=[user]):
        with pytest.raises(esair.StaleReadingError, match="no reading yet"):
            await user.radar.read(timeout=0.1)
        radar.feed(7.0)
        await asyncio.sleep(0.5)
        assert await user.radar.read() == 7.0
        await asyncio.sleep(0.1)
        with pytest.raises(esair.StaleReadingError) as caught:
            await user.radar.read()
        assert caught.value.age == pytest.approx(0.6)
        assert caught.value.limit == 0.5
        assert isinstance(caught.value, TimeoutError)
        assert await user.radar.read(max_age=1.0) == 7.0


@pytest.mark.promise("SC-3")
@pytest.mark.fault("D14", "T06")
@settings(max_examples=60, deadline=None)
@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from(["feed", "wait", "read", "stall", "resume", "fresh"]),
            st.floats(0.0, 0.7),
        ),
        max_size=20,
    ),
    max_age=st.floats(0.01, 0.5),
    pushes=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_the_age_of_a_reading_is_never_above_its_limit(
    steps: list[tuple[str, float]], max_age: float, pushes: bool, seed: int
) -> None:
    """Whatever the device does, a value is current or there is an error."""
    sonar = FakeSensor("sonar", type=float) if pushes else FakeSensor("sonar", 0.0)
    user = esair.Behavior(
        name="user", reads={"sonar": esair.reads(float, max_age=max_age)}
    )

    async def play() -> None:
        loop = asyncio.get_running_loop()
        async with esair.Robot(resources=[sonar], behaviors=[user]):
            for kind, seconds in steps:
                if kind == "feed":
                    sonar.feed(seconds)
                elif kind == "wait":
                    await asyncio.sleep(seconds)
                elif kind in {"stall", "resume"}:
                    getattr(sonar, kind)()
                else:
                    try:
                        reading = await user.sonar.reading(
                            fresh=kind == "fresh", timeout=0.2
                        )
                    except (esair.StaleReadingError, esair.DriverStuckError):
                        continue
                    assert loop.time() - reading.time <= max_age

    with asyncio.Runner(loop_factory=lambda: VirtualLoop(seed=seed)) as runner:
        runner.run(play())


@pytest.mark.fault("M17")
@pytest.mark.parametrize("seconds", [0, -1.0, math.nan, math.inf, True, "soon"])
@pytest.mark.parametrize("field", ["max_age", "timeout"])
async def test_intervals_are_numbers_of_seconds(
    fake_sensor: Any, user_of: Any, field: str, seconds: Any
) -> None:
    """Anything else is refused, on both ways to read, before the device is asked."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        with pytest.raises(esair.BadValueError, match=field):
            await user.sonar.read(**{field: seconds})
        with pytest.raises(esair.BadValueError, match=field):
            await robot.sensors.read(user.sonar.registration, **{field: seconds})
        assert sonar.reads == 0


@pytest.mark.promise("SC-1")
async def test_the_connection_reads_what_the_port_would(
    fake_sensor: Any, user_of: Any
) -> None:
    """`robot.sensors.read` takes a registration, and has the same answers."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        registration = user.sonar.registration
        first = await robot.sensors.read(registration)
        assert first.value == 1.0
        assert await robot.sensors.read(registration, max_age=5.0) is first
        newer = await robot.sensors.read(registration, fresh=True, timeout=0.5)
        assert newer.sequence == 2
        assert robot.sensors.names() == ["sonar"]
        with pytest.raises(esair.UnknownNameError, match="did you mean 'sonar'"):
            robot.sensors.channel("sona")
        with pytest.raises(esair.NotRegisteredError):
            await robot.sensors.read("user")  # type: ignore[arg-type]
        await robot.resources.remove("sonar")
        with pytest.raises(esair.ResourceRemovedError):
            await robot.sensors.read(registration)


@pytest.mark.promise("SC-1")
async def test_history_is_short_and_in_order(fake_sensor: Any, user_of: Any) -> None:
    """The last readings, the oldest first; never more than are kept."""
    radar = fake_sensor("radar")
    user = user_of("user", radar=esair.reads(float))

    async with esair.Robot(resources=[radar], behaviors=[user]) as robot:
        for value in range(100):
            radar.feed(float(value))
        await asyncio.sleep(0.01)

        assert [r.value for r in user.radar.history(3)] == [97.0, 98.0, 99.0]
        assert len(user.radar.history(1000)) == 64
        assert user.radar.history(0) == []
        robot.resources.revoke(user.radar.registration)
        with pytest.raises(esair.NotRegisteredError):
            user.radar.history(1)


@pytest.mark.promise("SC-1")
@pytest.mark.fault("D13")
async def test_a_slow_reader_of_a_stream_gets_the_newest(
    fake_sensor: Any, user_of: Any
) -> None:
    """Values that come meanwhile are dropped and counted; memory does not grow."""
    radar = fake_sensor("radar")
    user = user_of("user", radar=esair.reads(float))

    async with esair.Robot(resources=[radar], behaviors=[user]) as robot:
        seen: list[float] = []

        async def look() -> None:
            async for value in user.radar:
                seen.append(value)
                await asyncio.sleep(1.0)

        looking = asyncio.create_task(look())
        await asyncio.sleep(0.01)
        for value in range(1000):
            radar.feed(float(value))
            await asyncio.sleep(0.01)
        await asyncio.sleep(1.0)
        looking.cancel()
        await asyncio.wait({looking})

        assert len(seen) <= 12
        assert seen == sorted(seen)
        assert seen[-1] == 999.0
        assert robot.sensors.channels["radar"].dropped >= 1000 - len(seen) - 100
        assert robot.sensors.channels["radar"]._followers == ()


@pytest.mark.promise("SC-3")
@pytest.mark.parametrize("what", ["silent", "lost", "slept", "again"])
async def test_a_slow_reader_of_a_stream_never_gets_an_old_value(
    what: str, fake_sensor: Any, user_of: Any
) -> None:
    """It waits for the next one: that value came while it was busy, and is old now."""
    loop: Any = asyncio.get_running_loop()
    sonar = fake_sensor("sonar")
    user = user_of("user", sonar=esair.reads(float, max_age=0.5))
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        ticks = esair.every(0.01)
        await anext(ticks)
        values = aiter(user.sonar)
        first = asyncio.create_task(anext(values))
        await asyncio.sleep(0.01)
        sonar.feed(1.0)
        assert await first == 1.0
        sonar.feed(2.0)
        await asyncio.sleep(0.1)
        if what == "silent":
            await asyncio.sleep(0.5)
        elif what == "slept":
            loop.suspend(60.0)
            for _ in "ab":
                await anext(ticks)  # somebody has to turn the wheel
        else:
            sonar.unplug()
            await asyncio.sleep(0.01)
        if what == "again":
            sonar.plug()
            await asyncio.sleep(0.01)
        second = asyncio.create_task(anext(values))
        await asyncio.sleep(0.2)
        assert not second.done()
        if what == "lost":
            sonar.plug()
            await asyncio.sleep(0.2)
        sonar.feed(3.0)
        assert await second == 3.0
        await values.aclose()


@pytest.mark.promise("SC-1", "SUP-5")
@pytest.mark.fault("R10")
async def test_a_stream_waits_through_a_loss_and_ends_with_a_removal(
    fake_sensor: Any, user_of: Any
) -> None:
    """Loss is a pause; removal is an error, at once."""
    radar = fake_sensor("radar")
    user = user_of("user", radar=esair.reads(float))

    async with esair.Robot(resources=[radar], behaviors=[user]) as robot:
        values = aiter(user.radar)
        following = asyncio.create_task(anext(values))
        await asyncio.sleep(0.01)
        radar.unplug()
        await asyncio.sleep(1.0)
        assert not following.done()
        radar.plug()
        await asyncio.sleep(0.01)
        radar.feed(1.0)
        assert await following == 1.0
        following = asyncio.create_task(anext(values))
        await asyncio.sleep(0.01)
        await robot.resources.remove("radar")
        with pytest.raises(esair.ResourceRemovedError):
            await following


@pytest.mark.promise("RS-3")
@pytest.mark.fault("R06")
async def test_a_stream_ends_when_its_registration_is_revoked(
    fake_sensor: Any, user_of: Any
) -> None:
    """Nobody waits for ever on a right that is void."""
    radar = fake_sensor("radar")
    user = user_of("user", radar=esair.reads(float))

    async with esair.Robot(resources=[radar], behaviors=[user]) as robot:
        following = asyncio.create_task(anext(aiter(user.radar)))
        await asyncio.sleep(0.01)
        robot.resources.revoke(user.radar.registration)
        with pytest.raises(esair.NotRegisteredError):
            await following
        radar.value = 1.0  # who begins then gets no value either
        with pytest.raises(esair.NotRegisteredError):
            await anext(aiter(user.radar))


@pytest.mark.promise("SC-3")
@pytest.mark.fault("D01", "R10")
async def test_waiting_readers_are_told_of_a_loss_at_once(
    fake_sensor: Any, user_of: Any
) -> None:
    """They do not wait for their time-outs; what was cached is not current any more."""
    sonar = fake_sensor("sonar", 1.0)
    user = user_of("user", sonar=esair.reads(float))
    loop = asyncio.get_running_loop()

    async with esair.Robot(resources=[sonar], behaviors=[user]):
        await user.sonar.read()
        sonar.stall()
        reading = asyncio.create_task(user.sonar.read(fresh=True))
        await asyncio.sleep(0.01)
        began = loop.time()
        sonar.unplug()
        with pytest.raises(esair.DeviceLostError, match="unplugged"):
            await reading
        assert loop.time() == began
        with pytest.raises(esair.DeviceLostError):
            await user.sonar.read()


async def test_the_rate_can_be_changed_while_it_is_polled(fake_sensor: Any) -> None:
    """A new rate holds from the moment it is configured."""

    class Look(esair.Reaction):
        sonar = esair.reads(float, configure=True)

        def react(self, sonar: float) -> None:
            return None

    sonar = fake_sensor("sonar", 1.0, rate=1.0)
    look = Look()
    async with esair.Robot(resources=[sonar], behaviors=[look]) as robot:
        registration = await robot.resources.register(
            look, "sonar", esair.Access.READ | esair.Access.CONFIGURE
        )
        await asyncio.sleep(2.5)
        slow = sonar.reads
        await robot.resources.configure(registration, rate=100.0)
        await asyncio.sleep(1.0)

        assert slow <= 3
        assert sonar.reads - slow == pytest.approx(100, abs=2)


@pytest.mark.fault("D15")
async def test_a_frozen_device_is_at_fault(fake_sensor: Any, user_of: Any) -> None:
    """More equal values than it may give are not passed on; then it is reopened."""
    sonar = fake_sensor("sonar", 1.0)
    sonar.max_repeat = 3
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]) as robot:
        for _ in range(3):
            assert await user.sonar.read(fresh=True) == 1.0
        with pytest.raises(
            esair.DeviceFaultError, match=r"frozen: it gave 1\.0 4 times"
        ):
            await user.sonar.read(fresh=True)
        sonar._value = 2.0  # it moves again
        assert await user.sonar.read(fresh=True) == 2.0

        for _ in range(2):
            assert await user.sonar.read(fresh=True) == 2.0
        for _ in range(3):
            with pytest.raises(esair.DeviceFaultError):
                await user.sonar.read(fresh=True)
        assert robot.resources.query("sonar").state is esair.ResourceState.LOST
        await asyncio.sleep(1.0)
        assert sonar.opened == 2
        assert await user.sonar.read(fresh=True) == 2.0  # it is given a new chance


@pytest.mark.fault("D15")
@pytest.mark.parametrize("broken", [False, True])
async def test_values_that_are_arrays_or_cannot_be_compared(
    user_of: Any, broken: bool
) -> None:
    """An array repeats if all of it does; what cannot be compared never repeats."""

    class Same:
        def all(self) -> bool:
            if broken:
                raise RuntimeError("no")
            return True

    class Scan:
        def __eq__(self, other: object) -> Any:
            return Same()

        __hash__ = None  # type: ignore[assignment]

    class Lidar(esair.Sensor[Any]):
        max_repeat = 1

        async def read(self) -> Scan:
            return Scan()

    user = user_of("user", lidar=esair.reads(Any))
    async with esair.Robot(resources=[Lidar()], behaviors=[user]):
        await user.lidar.read(fresh=True)
        if broken:
            await user.lidar.read(fresh=True)
        else:
            with pytest.raises(esair.DeviceFaultError, match="frozen"):
                await user.lidar.read(fresh=True)


@pytest.mark.fault("D15")
@pytest.mark.parametrize("limit", [0, -1, 2.5, True, "3"])
async def test_the_limit_of_repeats_is_a_number(
    fake_sensor: Any, limit: object
) -> None:
    """Anything but a whole number above zero is a mistake of the developer."""
    sonar = fake_sensor("sonar", 1.0)
    sonar.max_repeat = limit

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(resources=[sonar]):
            pytest.fail("it started")

    assert caught.group_contains(esair.ConfigError, match="max_repeat")


@pytest.mark.promise("SC-1")
async def test_a_sensor_may_give_any_real_number(user_of: Any) -> None:
    """A number of another class than float is no fault of the device; a bool is."""

    class Sonar(esair.Sensor[float]):
        value: Any = fractions.Fraction(1, 2)

        async def read(self) -> float:
            return self.value  # type: ignore[no-any-return]

    sonar, user = Sonar(), user_of("user", sonar=esair.reads(float))
    async with esair.Robot(resources=[sonar], behaviors=[user]):
        assert await user.sonar.read() == 0.5
        sonar.value = True
        with pytest.raises(esair.DeviceFaultError, match="expected float"):
            await user.sonar.read(fresh=True)


@pytest.mark.promise("SC-1")
@pytest.mark.parametrize("count", [-1, 1.5, None, "2", True])
async def test_a_history_is_asked_for_by_a_whole_number(
    fake_sensor: Any, user_of: Any, count: Any
) -> None:
    """Everything else is refused by name."""
    user = user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[fake_sensor("sonar", 1.0)], behaviors=[user]):
        with pytest.raises(esair.BadValueError, match="sonar: history: expected"):
            user.sonar.history(count)


@pytest.mark.promise("SC-3")
@pytest.mark.fault("D14")
async def test_a_device_that_does_not_answer_is_said_to_be_silent(
    fake_sensor: Any, user_of: Any
) -> None:
    """The error tells a time that was waited from an age that was asked for."""
    sonar, user = fake_sensor("sonar", 1.0), user_of("user", sonar=esair.reads(float))

    async with esair.Robot(resources=[sonar], behaviors=[user]):
        await user.sonar.read()
        sonar.stall()
        await asyncio.sleep(0.3)
        with pytest.raises(esair.StaleReadingError) as caught:
            await user.sonar.read(max_age=0.1, timeout=0.5)
        sonar.resume()

    assert "newest is 0.8 s old" in str(caught.value)
    assert "did not answer in 0.5 s" in str(caught.value)


@pytest.mark.promise("SC-1")
async def test_times_may_be_of_a_class_of_floats(
    fake_sensor: Any, fake_actuator: Any
) -> None:
    """As numpy's are: for a read, a write, a put, a tick, and where they are declared."""

    class Float64(float):
        pass

    half = Float64(0.5)

    class Mapper(esair.Behavior):
        sonar = esair.reads(float, max_age=half)
        wheels = esair.writes(float, hold=half)

    mapper = Mapper()
    wheels = fake_actuator("wheels", safe=0.0, command_timeout=half)
    async with esair.Robot(
        resources=[fake_sensor("sonar", 1.0), wheels], behaviors=[mapper]
    ):
        assert await mapper.sonar.read(max_age=half, timeout=half) == 1.0
        assert await mapper.wheels.write(1.0, hold=half)
        await mapper.put("mapper", 1, interval=half)
        async for _ in esair.every(half):
            break


async def test_who_comes_while_the_device_is_asked_has_the_next_question() -> None:
    """It follows at once, however seldom the device is asked by itself."""

    class Slow(esair.Sensor[float]):
        rate = 0.1
        deadline = 5.0

        async def read(self) -> float:
            await asyncio.sleep(0.1)
            return 1.0

    user: Any = esair.Behavior(name="user", reads={"slow": esair.reads(float)})
    async with esair.Robot(resources=[Slow()], behaviors=[user]):
        loop = asyncio.get_running_loop()
        began = loop.time()
        first = asyncio.create_task(user.slow.read(fresh=True))
        await asyncio.sleep(0.05)
        second = asyncio.create_task(user.slow.read(fresh=True))
        await first
        assert loop.time() - began == pytest.approx(0.1)
        await second
        assert loop.time() - began == pytest.approx(0.2)
