"""P8 and P9: devices on serial, CAN and I²C, and from a frame to a command."""

from __future__ import annotations

import asyncio
import collections
import contextlib
import os
import statistics
import struct
import threading
import time
import tty
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import can
import serial_asyncio

import esair
from benchmarks.cases.components import Meter
from benchmarks.cases.limits import bare_wheel
from benchmarks.cases.peers import (
    FRAME,
    PairBus,
    answer,
    ask_and_time,
    can_peer,
    echo_terminal,
    flood,
)
from benchmarks.harness import Row, ms, neighbors, percentile, repeated, us
from esair.buses import CanBus, I2CBus, SerialBus
from esair.buses.i2c import ChipBus

COUNT = 300
LINE = b"x" * 63
BURST = 20


async def rows() -> list[Row]:
    return [
        *await _serial(),
        *await _can(),
        *await _flood(),
        *await _i2c(),
        *await _p9(),
    ]


async def cpu_of(operation: Callable[[], Awaitable[Any]], count: int = COUNT) -> float:
    """Return what an operation costs this process, all threads, in seconds."""
    begin = time.process_time()
    for _ in range(count):
        await operation()
    return (time.process_time() - begin) / count


class Echo(esair.Sensor[bytes]):
    """A device that answers each line."""

    bus: SerialBus

    async def read(self) -> bytes:
        return await self.bus.ask(LINE)


class Answer(esair.Sensor[bytes]):
    """A device that answers each frame."""

    bus: CanBus

    async def open(self) -> None:
        self._frames = self.bus.frames(0x181)

    async def read(self) -> bytes:
        await self.bus.send(0x101, bytes(8))
        return (await self._frames.take()).data


class Register(esair.Sensor[bytes]):
    """A chip with registers."""

    bus: I2CBus

    async def read(self) -> bytes:
        return await self.bus.read(0x48, 0, 2)


class Follower(esair.Behavior):
    """Reads a device."""

    device = esair.reads(bytes)


@contextlib.asynccontextmanager
async def _reading(sensor: esair.Sensor[bytes]) -> AsyncIterator[Any]:
    sensor.rate = 0.001  # nobody follows it: every read of the benchmark is its own
    follower = Follower()
    robot = esair.Robot(resources=[sensor], behaviors=[follower])
    async with robot:
        yield lambda: follower.device.read(fresh=True)


async def _serial() -> list[Row]:
    loop = asyncio.get_running_loop()
    with echo_terminal() as path, echo_terminal() as second, echo_terminal() as third:
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(fd)
        buffer = bytearray()
        waiting: list[asyncio.Future[bytes]] = []

        def readable() -> None:
            buffer.extend(os.read(fd, 4096))
            if buffer.endswith(b"\n"):
                line = bytes(buffer)
                buffer.clear()
                waiting.pop().set_result(line)

        loop.add_reader(fd, readable)

        async def bare() -> bytes:
            future: asyncio.Future[bytes] = loop.create_future()
            waiting.append(future)
            os.write(fd, LINE + b"\n")
            return await future

        reader, writer = await serial_asyncio.open_serial_connection(
            url=second, baudrate=115200
        )

        async def streams() -> bytes:
            writer.write(LINE + b"\n")
            line: bytes = await reader.readuntil(b"\n")
            return line

        device = Echo(name="device", bus=SerialBus(name="line", port=third))
        async with _reading(device) as read:
            mine, limit, ratio = await neighbors(
                lambda: cpu_of(read), lambda: cpu_of(bare)
            )
            same, peer, peer_ratio = await neighbors(
                lambda: cpu_of(read), lambda: cpu_of(streams)
            )
        loop.remove_reader(fd)
        os.close(fd)
        writer.transport.abort()
        await asyncio.sleep(0.05)
    return [
        Row(
            "P8 serial: read of 64 bytes, to a bare descriptor",
            us(mine), us(limit), ratio, 2.0, "CPU of this process",
        ),
        Row(
            "P8 serial: the same, to pyserial-asyncio's streams",
            us(same), us(peer), peer_ratio, 1.0, "no deadline, no checks there",
        ),
    ]  # fmt: skip


class BareCan:
    """A socket with frames, watched by the event loop: no check of anything."""

    def __init__(self, channel: str, heard: Callable[[bytes], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._socket = PairBus.ends[channel]
        self._heard = heard
        self._loop.add_reader(self._socket.fileno(), self._readable)

    def send(self, number: int, data: bytes) -> None:
        self._socket.send(FRAME.pack(number, len(data), data))

    def close(self) -> None:
        self._loop.remove_reader(self._socket.fileno())

    def _readable(self) -> None:
        _number, length, data = FRAME.unpack(self._socket.recv(FRAME.size))
        self._heard(data[:length])


class BarePythonCan:
    """A bus of python-can, watched by the event loop."""

    def __init__(self, channel: str, heard: Callable[[bytes], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._bus = can.Bus(channel, interface="pair")
        self._heard = heard
        self._loop.add_reader(self._bus.fileno(), self._readable)

    def send(self, number: int, data: bytes) -> None:
        self._bus.send(
            can.Message(arbitration_id=number, data=data, is_extended_id=False)
        )

    def close(self) -> None:
        self._loop.remove_reader(self._bus.fileno())
        self._bus.shutdown()

    def _readable(self) -> None:
        message = self._bus.recv(timeout=0)
        if message is not None:
            self._heard(bytes(message.data))


async def _can() -> list[Row]:
    found = []
    for bare, goal, what in (
        (BarePythonCan, 1.15, "python-can in a bare add_reader"),
        (BareCan, None, "a bare socket in an add_reader"),
    ):
        mine, limit, ratio = await _answers(bare)
        case = f"P8 CAN: request and answer, to {what}"
        found.append(Row(case, us(mine), us(limit), ratio, goal, "CPU of this process"))
    return found


async def _answers(
    kind: type[BareCan | BarePythonCan],
) -> tuple[float, float, float]:
    loop = asyncio.get_running_loop()
    waiting: list[asyncio.Future[bytes]] = []
    with can_peer(answer) as (channel, _), can_peer(answer) as (other, _):
        bus = kind(channel, lambda data: waiting.pop().set_result(data))

        async def bare() -> bytes:
            future: asyncio.Future[bytes] = loop.create_future()
            waiting.append(future)
            bus.send(0x101, bytes(8))
            return await future

        wire = CanBus(name="wire", interface="pair", channel=other)
        async with _reading(Answer(name="device", bus=wire)) as read:
            measured = await neighbors(lambda: cpu_of(read), lambda: cpu_of(bare))
        bus.close()
    return measured


async def _flood() -> list[Row]:
    """Frames as fast as they come, to whoever listens."""
    frames = 4000
    loop = asyncio.get_running_loop()
    with can_peer(flood) as (channel, pipe), can_peer(flood) as (other, second):
        left, done = 0, loop.create_future()

        def heard(_data: bytes) -> None:
            nonlocal left
            left -= 1
            if not left:
                done.set_result(None)

        bus = BarePythonCan(channel, heard)

        async def bare() -> float:
            nonlocal left, done
            left, done = frames, loop.create_future()
            begin = time.process_time()
            pipe.send(frames)
            await done
            return (time.process_time() - begin) / frames

        wire = CanBus(name="wire", interface="pair", channel=other)
        await wire.open()
        inbox = wire.frames(0x181, limit=256)

        async def esair_frames() -> float:
            begin = time.process_time()
            second.send(frames)
            for _ in range(frames):
                await inbox.take()
            return (time.process_time() - begin) / frames

        mine, limit, ratio = await neighbors(esair_frames, bare, rounds=5)
        dropped = inbox.dropped
        await wire.close()
        bus.close()
    note = f"{1 / mine:,.0f} frames/s of CPU, {dropped} dropped"
    return [Row("P8 CAN: a frame of a flood", us(mine), us(limit), ratio, 1.3, note)]


class Executor:
    """The least that a thread for blocking calls can be.

    Args:
        batched: Whether one wake-up of the loop brings all results that are there.
    """

    def __init__(self, *, batched: bool) -> None:
        self._loop = asyncio.get_running_loop()
        self._batched = batched
        self._jobs: collections.deque[Any] = collections.deque()
        self._ready = threading.Semaphore(0)
        self._done: collections.deque[Any] = collections.deque()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def call(self, function: Callable[[], Any]) -> asyncio.Future[Any]:
        future: asyncio.Future[Any] = self._loop.create_future()
        self._jobs.append((function, future))
        self._ready.release()
        return future

    def close(self) -> None:
        self._jobs.append(None)
        self._ready.release()
        self._thread.join()

    def _work(self) -> None:
        while True:
            self._ready.acquire()
            job = self._jobs.popleft()
            if job is None:
                return
            function, future = job
            self._done.append((future, function()))
            if not self._batched or not self._jobs:
                self._loop.call_soon_threadsafe(self._deliver)

    def _deliver(self) -> None:
        while self._done:
            future, result = self._done.popleft()
            future.set_result(result)


class Words:
    """A chip that answers at once."""

    def read(self, register: int, length: int) -> bytes:
        return bytes(length)

    def write(self, register: int, data: bytes) -> None:
        return None


async def _i2c() -> list[Row]:
    chips = ChipBus({0x48: Words()})
    single, batched = Executor(batched=False), Executor(batched=True)

    def transfer() -> bytes:
        return bytes(chips.read_i2c_block_data(0x48, 0, 2))

    async def bare() -> bytes:
        result: bytes = await single.call(transfer)
        return result

    bus = I2CBus(name="chips", wire=ChipBus({0x48: Words()}))
    async with _reading(Register(name="device", bus=bus)) as read:
        mine, limit, ratio = await neighbors(lambda: cpu_of(read), lambda: cpu_of(bare))

        async def esair_burst() -> float:
            return await cpu_of(
                lambda: asyncio.gather(*(bus.read(0x48, 0, 2) for _ in range(BURST))),
                COUNT // BURST,
            )

        async def bare_burst() -> float:
            return await cpu_of(
                lambda: asyncio.gather(*(batched.call(transfer) for _ in range(BURST))),
                COUNT // BURST,
            )

        burst, least, burst_ratio = await neighbors(esair_burst, bare_burst)
    single.close()
    batched.close()
    return [
        Row(
            "P8 I2C: read of a register, to a bare executor thread",
            us(mine), us(limit), ratio, 1.35, "CPU of this process",
        ),
        Row(
            f"P8 I2C: {BURST} reads at once, to a batched executor",
            us(burst / BURST), us(least / BURST), burst_ratio, 2.0, "each",
        ),
    ]  # fmt: skip


class Arrival(esair.Sensor[int]):
    """A device that sends a number in a frame."""

    bus: CanBus

    async def stream(self) -> AsyncIterator[int]:
        with contextlib.closing(self.bus.frames(0x181)) as frames:
            async for frame in frames:
                yield int.from_bytes(frame.data, "little")


class Command(esair.Actuator[int]):
    """A device that takes a number in a frame."""

    bus: CanBus
    safe = -1
    command_timeout = 60.0

    async def write(self, command: int) -> None:
        await self.bus.send(0x101, struct.pack("<q", command))


class Reflex(esair.Reaction):
    """Gives back each number."""

    arrival = esair.reads(int)
    command = esair.writes(int)

    def react(self, arrival: int) -> int:
        return arrival


async def _p9() -> list[Row]:
    """P9: from a frame to the command that answers it, with others at 100 Hz."""
    count, pause = 120, 0.004

    async def timed(pipe: Any) -> list[float]:
        pipe.send((count, pause))
        took: list[float] = await asyncio.to_thread(pipe.recv)
        return took

    async def bare() -> list[float]:
        with can_peer(ask_and_time) as (channel, pipe):
            bus = BarePythonCan(channel, lambda data: bus.send(0x101, data))
            async with bare_wheel([lambda _now: None] * 50, 0.01):
                took = await timed(pipe)
            bus.close()
            return took

    async def reflex() -> list[float]:
        with can_peer(ask_and_time) as (channel, pipe):
            wire = CanBus(name="wire", interface="pair", channel=channel)
            meters = [Meter(name=f"meter_{number}") for number in range(50)]
            beside = [
                esair_beside(f"beside_{number}", f"meter_{number}")
                for number in range(50)
            ]
            robot = esair.Robot(
                resources=[Arrival(bus=wire), Command(bus=wire), *meters],
                behaviors=[Reflex(), *beside],
            )
            async with robot:
                await asyncio.sleep(0.1)
                return await timed(pipe)

    mine: list[list[float]] = []
    limit: list[list[float]] = []
    for _ in repeated(5):
        mine.append(await reflex())
        limit.append(await bare())
    found = []
    for share, goal in ((0.5, 1.6), (0.99, 2.0)):
        a = statistics.median(percentile(each, share) for each in mine)
        b = statistics.median(percentile(each, share) for each in limit)
        ratios = [
            percentile(x, share) / percentile(y, share)
            for x, y in zip(mine, limit, strict=True)
        ]
        case = f"P9 frame to command, 50 others at 100 Hz, p{share * 100:.0f}"
        found.append(Row(case, ms(a), ms(b), statistics.median(ratios), goal))
    return found


class Beside(esair.Reaction):
    """One of the others."""

    rate = 100.0

    def react(self, meter: float) -> None:
        return None


def esair_beside(name: str, meter: str) -> esair.Reaction:
    return Beside(name=name, reads={"meter": esair.reads(float, name=meter)})
