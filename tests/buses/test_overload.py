"""A bus that is asked for more than it can do: its devices are late, none is lost."""

import asyncio
import statistics
from collections.abc import Callable

import pytest

import esair
from esair.buses import I2CBus, SerialBus
from esair.buses.i2c import Registers
from esair.exceptions import DriverStuckError, NoTurnError
from esair.messages import ResourceState
from esair.plan import examine
from esair.testing import FakeI2c, FakeSerial

TRANSFER = 0.008


class Chip(esair.Sensor[int]):
    """A chip of two registers, or of as many as it has transfers."""

    transfers = 1
    rate = 20.0
    bus: I2CBus

    def __init__(self, *, address: int, **options) -> None:
        super().__init__(**options)
        self.address = address
        self.count = 0

    async def read(self) -> int:
        """Read them."""
        for _ in range(self.transfers):
            data = await self.bus.read(self.address, 0)
        self.count += 1
        return data[0]


class Blocking(Chip):
    """The same, by plain methods on the thread of the bus."""

    def read(self) -> int:  # type: ignore[override]
        """Read it."""
        value: int = self.bus.direct(
            lambda link: link.read_byte_data(self.address, 0), address=self.address
        )
        self.count += 1
        return value


NAMES = [f"chip_{n}" for n in range(32)]


class Watcher(esair.Behavior):
    """Follows every chip."""

    names = NAMES

    async def run(self) -> None:
        """Have them polled, for ever."""

        async def follow(name: str) -> None:
            async for _ in getattr(self, name):
                pass

        await asyncio.gather(*(follow(name) for name in self.names))


def test_an_actuator_is_told_as_often_as_its_time_limit_asks_for() -> None:
    """Whoever moves it tells it so often at least."""

    class Motor(esair.Actuator[float]):
        safe = 0.0
        command_timeout = 0.1

        async def write(self, command: float) -> None:
            """Tell it."""

    bus = FakeI2c(chips={0x10: {0: 0}}, name="motors")
    bus.stretch(0.09)
    robot = esair.Robot(resources=[Motor(name="motor", bus=bus)])
    (load,) = [each for each in examine(robot.plan) if each.rule == "load"]
    assert "90%" in str(load)


async def until(condition: Callable[[], object]) -> None:
    """Look again and again, on whatever clock."""
    while not condition():  # noqa: ASYNC110 - states have no event
        await asyncio.sleep(0.05)


async def overload(kind: type[Chip], seconds: float) -> list[int]:
    """Ask 32 chips for five times what their bus can do; returns how often each answered."""
    bus = FakeI2c(chips={0x10 + n: {0: n} for n in range(32)}, name="chips")
    bus.stretch(TRANSFER)
    chips = [kind(name=name, address=0x10 + n, bus=bus) for n, name in enumerate(NAMES)]
    needs = {name: esair.reads(int, max_age=30.0) for name in NAMES}
    robot = esair.Robot(resources=chips, behaviors=[Watcher(reads=needs, writes={})])
    (load,) = [each for each in examine(robot.plan) if each.rule == "load"]
    assert "512%" in str(load)
    assert "chips" in str(load)

    async with robot:
        await until(
            lambda: all(
                robot.resources.query(each).state is ResourceState.READY
                for each in NAMES
            )
        )
        before = [each.count for each in chips]
        await asyncio.sleep(seconds)
        counts = robot.journal.counts()
        assert sum(counts[each]["losses"] for each in NAMES) == 0
        assert sum(counts[each]["faults"] for each in NAMES) == 0
        return [each.count - was for each, was in zip(chips, before, strict=True)]


@pytest.mark.long
@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
@pytest.mark.parametrize("transfers", [1, pytest.param(3, marks=pytest.mark.long)])
async def test_an_overloaded_bus_loses_nobody(monkeypatch, transfers: int) -> None:
    """The slowest is read at least half as often as the one in the middle."""
    monkeypatch.setattr(Chip, "transfers", transfers)

    rates = await overload(Chip, 60.0)

    assert min(rates) / statistics.median(rates) >= 0.5
    assert sum(rates) * TRANSFER * transfers >= 30.0  # the bus is not idle meanwhile


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
@pytest.mark.long
async def test_not_even_where_a_reading_takes_longer_than_its_deadline(
    monkeypatch,
) -> None:
    """Eight turns of a quarter of a second: every reading is late, no chip is lost."""
    monkeypatch.setattr(Chip, "transfers", 8)

    await overload(Chip, 60.0)


@pytest.mark.real_clock
@pytest.mark.long
@pytest.mark.promise("BUS-5")
@pytest.mark.parametrize("kind", [Chip, Blocking])
async def test_an_overloaded_bus_loses_nobody_on_its_thread(kind: type[Chip]) -> None:
    """Nor where calls are made on the thread of the bus, as on a real one."""
    rates = await overload(kind, 10.0)

    assert min(rates) / statistics.median(rates) >= 0.5


class Unit(esair.Sensor[int]):
    """One of many devices that are asked over one line."""

    rate = 20.0
    bus: SerialBus

    async def read(self) -> int:
        """Ask it."""
        key = self.name.encode() + b"="
        return int((await self.bus.ask(key + b"?", prefix=key)).removeprefix(key))


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
@pytest.mark.parametrize("count", [40, pytest.param(300, marks=pytest.mark.long)])
async def test_a_full_line_loses_nobody(count: int) -> None:
    """What is refused because too many wait already was not asked: that is no fault."""
    names = [f"unit_{n}" for n in range(count)]
    line = FakeSerial("line")
    loop = asyncio.get_running_loop()

    def hear(asked: bytes) -> None:
        loop.call_later(0.03, line.say, asked[:-1] + b"7")

    line.on_frame = hear
    needs = {name: esair.reads(int, max_age=60.0) for name in names}
    watcher = Watcher(reads=needs, writes={})
    watcher.names = names
    units = [Unit(name=name, bus=line) for name in names]
    robot = esair.Robot(resources=units, behaviors=[watcher])
    async with robot:
        await asyncio.sleep(20.0)
        counts = robot.journal.counts()

    assert line.stats.sent > 100
    assert sum(counts[each]["losses"] + counts[each]["faults"] for each in names) == 0


@pytest.mark.virtual_clock
async def test_a_request_without_a_turn_is_one_error() -> None:
    """It is counted once."""
    line = FakeSerial("line")
    await line.open()
    slow = asyncio.create_task(line.ask(b"a?", prefix=b"a", timeout=3.0))
    await asyncio.sleep(0.0)

    with pytest.raises(NoTurnError):
        await line.ask(b"b?", prefix=b"b", timeout=0.5)
    assert (line.stats.errors, line.stats.no_turn) == (1, 1)
    slow.cancel()
    await line.close()


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
async def test_silence_is_told_from_having_no_turn() -> None:
    """One device of a line is silent: it alone did not answer; the other got no turn."""
    line = FakeSerial(name="line")
    await line.open()
    silent = asyncio.create_task(line.ask(b"a?", prefix=b"a", timeout=3.0))
    await asyncio.sleep(0.0)

    with pytest.raises(NoTurnError):
        await line.ask(b"b?", prefix=b"b", timeout=0.5)
    with pytest.raises(DriverStuckError) as stuck:
        await silent
    assert not isinstance(stuck.value, NoTurnError)
    await line.close()


class Heater(esair.Actuator[float]):
    """An output of a chip: one transfer turns it."""

    safe = 0.0
    bus: I2CBus

    async def write(self, command: float) -> None:
        """Write it."""
        await self.bus.write(0x70, 0, bytes([int(command)]))


class Kettle(esair.Actuator[float]):
    """An output of a unit on a line: it answers."""

    safe = 0.0
    bus: SerialBus

    async def write(self, command: float) -> None:
        """Tell it."""
        await self.bus.ask(b"kettle=%d" % command, prefix=b"kettle")


class Cook(esair.Behavior):
    """Heats."""

    async def run(self) -> None:
        """Write for ever."""
        async for _ in esair.every(0.05):
            await self.output.write(9.0)


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
@pytest.mark.promise("ROB-4")
async def test_safe_has_the_next_turn_on_its_chips() -> None:
    """Polls that wait for a turn come after it, and after the write that it waits for."""
    stove = Registers()
    chips = {0x70: stove, **{0x10 + n: Registers(bytes([n])) for n in range(32)}}
    bus = FakeI2c(chips=chips, name="chips")
    polled = [
        Chip(name=name, address=0x10 + n, bus=bus) for n, name in enumerate(NAMES)
    ]
    watcher = Watcher(reads={name: esair.reads(int) for name in NAMES}, writes={})
    cook = Cook(writes={"output": esair.writes(float)})
    heater = Heater(name="output", bus=bus)

    async with esair.Robot(
        resources=[heater, *polled], behaviors=[watcher, cook]
    ) as robot:
        await asyncio.sleep(0.9)
        bus.stretch(0.04)
        await asyncio.sleep(2.0)  # a round of all polls takes 1.3 s
        assert stove.content[0] == 9
        assert sum(each.count for each in polled) >= 20
        assert robot.actuators.channels["output"].stillness.timeouts == 0
        robot.halt("a look")
        await asyncio.sleep(0.125)
        assert stove.content[0] == 0
        assert robot.resources.query("output").losses == 0
        assert robot.behaviors.query("cook").restarts == 0


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
@pytest.mark.promise("ROB-4")
async def test_safe_has_the_next_turn_on_its_line() -> None:
    """Nor do requests that wait for their turn keep it."""
    line, told, delay = FakeSerial("line"), [b""], [0.0]
    loop = asyncio.get_running_loop()

    def hear(asked: bytes) -> None:
        if asked.startswith(b"kettle"):
            told[0] = asked
        loop.call_later(delay[0], line.say, asked[:-1] + b"7")

    line.on_frame = hear
    units = [Unit(name=name, bus=line) for name in NAMES]
    watcher = Watcher(reads={name: esair.reads(int) for name in NAMES}, writes={})
    cook = Cook(writes={"output": esair.writes(float)})
    kettle = Kettle(name="output", bus=line)

    async with esair.Robot(
        resources=[kettle, *units], behaviors=[watcher, cook]
    ) as robot:
        await asyncio.sleep(0.9)
        delay[0] = 0.04
        await asyncio.sleep(0.1)
        assert told[0] == b"kettle=9"
        robot.halt("a look")
        await asyncio.sleep(0.125)
        assert told[0] == b"kettle=0"


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-5")
async def test_who_gets_no_turn_to_be_safe_is_late(caplog) -> None:
    """A bus that is held up for ten seconds loses no actuator; then safe is told at once."""
    stove = Registers()
    bus = FakeI2c(chips={0x10: Registers(), 0x70: stove}, name="chips")
    chip = Chip(name="chip", address=0x10, bus=bus)
    user = esair.Behavior(name="user", reads={"chip": esair.reads(int)}, writes={})
    cook = Cook(writes={"output": esair.writes(float)})
    heater = Heater(name="output", bus=bus)
    heater.command_timeout = 2.0

    async with esair.Robot(resources=[heater, chip], behaviors=[cook, user]) as robot:
        await asyncio.sleep(0.12)
        bus.stall()
        with pytest.raises(DriverStuckError):
            await user.chip.read(fresh=True)
        robot.halt("a look")
        await asyncio.sleep(10.0)
        assert stove.content[0] == 9
        assert robot.resources.query("output").state is ResourceState.READY
        assert robot.journal.counts()["output"]["no_turns"] > 0
        bus.resume()
        await asyncio.sleep(0.15)
        assert stove.content[0] == 0

    assert "UNSAFE" not in caplog.text
    assert "output: still not told to be safe" in caplog.text
