"""A bus that is asked for more than it can do: its devices are late, none is lost."""

import asyncio
import statistics
from collections.abc import Callable

import pytest

import esair
from esair.buses import I2CBus, SerialBus
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
