"""A board on a serial line: a real MicroPython on a pseudo-terminal, in a robot of STD."""

import asyncio
import contextlib
import os
import pty
import struct
import tty
from collections.abc import Callable
from typing import Any

import pytest
from tests.minimal import attacks
from tests.minimal.linked import Plugged

import esair
from esair.boards import link
from esair.buses import SerialBus
from esair.drivers.board import Board, BoardActuator, BoardSensor, wire

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-4")]


class Explore(esair.Behavior):
    """Drives on, faster than the board lets it."""

    wheels = esair.writes(tuple)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write((1.0, 0.25))


class Follow(esair.Reaction):
    """Drives towards a light that only this computer looks at."""

    light = esair.reads(float)
    wheels = esair.writes(tuple)

    def react(self, light: float) -> tuple[float, float]:
        return (light / 2, light / 2)


def host(
    board: Plugged, behavior: esair.Behavior | esair.Reaction | None = None
) -> tuple[esair.Robot, Board]:
    bus = SerialBus(name="base", port=str(board.port), framing="cobs")
    base = Board(name="base", bus=bus)
    robot = esair.Robot(
        resources=[
            base,
            BoardSensor(name="bumper", bus=bus),
            BoardSensor(name="light", bus=bus),
            BoardActuator(name="wheels", bus=bus, safe=(0.0, 0.0)),
        ],
        behaviors=[behavior or Explore()],
    )
    return robot, base


async def until(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    async with asyncio.timeout(seconds):
        while True:  # what another process does, nobody here can tell
            if condition():
                return
            await asyncio.sleep(0.02)


def last(board: Plugged) -> tuple[float, ...]:
    told = board.told
    return told[-1] if told else ()


async def test_the_board_does_what_the_computer_wants_and_its_reflexes_outrank_it(
    plugged,
) -> None:
    """The guard on the board weakens it, the reflex takes over, and gives back."""
    robot, _ = host(plugged)
    async with robot:
        await until(lambda: last(plugged) == (0.5, 0.25))
        plugged.bump(True)
        await until(lambda: last(plugged) == (-0.5, -0.5))
        assert robot.resources.query("bumper").state is esair.ResourceState.READY
        plugged.bump(False)
        await until(lambda: last(plugged) == (0.5, 0.25))
    await until(lambda: last(plugged) == (0.0, 0.0))


async def test_how_the_board_is_can_be_read(plugged) -> None:
    """Steps, faults, memory, the reason of its start; its sensors as they come."""

    class Look(esair.Behavior):
        base = esair.reads(object)
        bumper = esair.reads(object)
        seen: object = None

        async def run(self) -> None:
            await self.bumper.read()
            async for state in self.base:
                self.seen = state

    robot, _ = host(plugged)
    look = Look()
    async with robot:
        await robot.behaviors.add(look)
        await until(lambda: getattr(look.seen, "armed", False))
        state = look.seen
        assert state.steps > 0
        assert state.faults == 0
        assert state.memory > 0
        assert state.cause == "power-on"
        assert state.actuators == ("wheels",)
        (plugged.folder / "bumper.txt").unlink()
        await until(lambda: look.seen.faults > 0)
        assert "bumper: OSError" in look.seen.fault
        plugged.bump(False)


async def test_a_sensor_that_fails_on_the_board_blinds_who_reads_it_here(
    plugged,
) -> None:
    """It keeps no last value: nobody drives on by it, until it gives one again."""
    robot, _ = host(plugged, Follow())
    light = plugged.folder / "light.txt"
    async with robot:
        await until(lambda: last(plugged) == (0.25, 0.25))
        light.unlink()
        parked = esair.BehaviorState.PARKED
        await until(lambda: robot.behaviors.query("follow").state is parked)
        assert "no reading on the board" in str(robot.behaviors.query("follow").detail)
        await until(lambda: last(plugged) == (0.0, 0.0))
        light.write_text("1.0")
        await until(lambda: last(plugged) == (0.5, 0.5), seconds=20.0)


async def test_a_board_that_is_unplugged_comes_back(plugged) -> None:
    """Lost here, and it drives on when it is there again."""
    robot, _ = host(plugged)
    async with robot:
        await until(lambda: last(plugged) == (0.5, 0.25))
        plugged.unplug()
        await until(
            lambda: (
                robot.resources.query("wheels").state is not esair.ResourceState.READY
            )
        )
        plugged.plug()
        await until(lambda: last(plugged) == (0.5, 0.25), seconds=20.0)


async def test_the_board_is_safe_when_the_computer_is_silent(plugged) -> None:
    """Without beats, although the port is still there."""
    robot, base = host(plugged)
    async with robot:
        await until(lambda: last(plugged) == (0.5, 0.25))
        loop = asyncio.get_running_loop()
        begin = loop.time()
        told = plugged.told
        while last(plugged) != (0.0, 0.0):
            assert loop.time() - begin < 3.0
            __import__("time").sleep(0.02)  # the whole computer stands still
        assert len(plugged.told) >= len(told)
        await until(lambda: last(plugged) == (0.5, 0.25))
    assert base.name == "base"


async def test_a_second_computer_gets_no_word_in(plugged) -> None:
    """The line has one owner: another robot is told so, and the first drives on."""

    class Still(esair.Behavior):
        wheels = esair.writes(tuple)

        async def run(self) -> None:
            async for _ in esair.every(0.05):
                await self.wheels.write((-0.25, -0.25))

    first, _ = host(plugged)
    second, _ = host(plugged, Still())
    async with first:
        await until(lambda: last(plugged) == (0.5, 0.25))
        async with second:
            await until(lambda: second.resources.query("base").error is not None)
            error = str(second.resources.query("base").error)
            told = len(plugged.told)
            await until(lambda: len(plugged.told) > told + 20)
            assert second.resources.query("base").state is not esair.ResourceState.READY
        assert set(plugged.told[told : told + 20]) == {(0.5, 0.25)}
        assert first.resources.query("wheels").losses == 0
    assert "a port has one user" in error


async def test_a_board_that_has_restarted_is_lost_first() -> None:
    """It came back before anybody missed its beats, and knows nothing of before."""
    mine, other = pty.openpty()
    tty.setraw(other)
    now_ms = [60_000]

    async def beat() -> None:
        async for _ in esair.every(0.05):
            now_ms[0] += 50
            head = ord("b"), link.VERSION, 1, 255, 0
            beat = struct.pack("<BBBBHIIIIHH", *head, now_ms[0], *[0] * 5)
            names = b"n" + struct.pack("<II", 50_000, 0) + b";"
            os.write(mine, wire.stuffed(beat) + wire.stuffed(names))

    bus = SerialBus(name="base", port=os.ttyname(other), framing="cobs")
    robot = esair.Robot(resources=[Board(name="base", bus=bus)])
    beats = asyncio.create_task(beat())
    try:
        async with robot:
            ready = esair.ResourceState.READY
            await until(lambda: robot.resources.query("base").state is ready)
            assert robot.resources.query("base").losses == 0
            now_ms[0] = 0
            await until(lambda: robot.resources.query("base").losses == 1)
            await until(lambda: robot.resources.query("base").state is ready)
            assert robot.resources.query("base").losses == 1
    finally:
        beats.cancel()
        os.close(mine)
        os.close(other)


@pytest.mark.long
async def test_garbage_on_the_line_disturbs_neither_side(plugged) -> None:
    """What is damaged is counted, and what is whole still gets through."""
    robot, base = host(plugged)
    async with robot:
        await until(lambda: last(plugged) == (0.5, 0.25))
        for _ in range(20):
            await base.bus.write(bytes(range(1, 256)) * 4 + b"\0" + os.urandom(500))
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.5)
        plugged.bump(True)
        await until(lambda: last(plugged) == (-0.5, -0.5))
        plugged.bump(False)
        await until(lambda: last(plugged) == (0.5, 0.25))


@pytest.mark.parametrize("size", [1, 4, 249, 250, 251, 252, 253, 254, 255, 600])
def test_both_sides_stuff_the_same_way(size) -> None:
    """The board's own code and the package cobs agree, zeros or not."""
    from cobs import cobs

    for payload in (bytes(size), b"x" * size, bytes(i % 256 for i in range(size))):
        data = wire.stuffed(payload)
        assert data[0] == data[-1] == 0
        assert b"\0" not in data[1:-1]
        assert cobs.decode(data[1:-1])[:-4] == payload
        assert wire.unstuffed(cobs.encode(cobs.decode(data[1:-1]))) == payload


def test_a_damaged_message_is_none() -> None:
    """Each flipped bit is noticed."""
    data = wire.stuffed(b"W wheels\0[0.5, 0.25]")[1:-1]

    for at in range(len(data)):
        for bit in range(8):
            damaged = bytearray(data)
            damaged[at] ^= 1 << bit
            with contextlib.suppress(IndexError):
                assert wire.unstuffed(bytes(damaged)) is None


def test_a_reading_that_comes_with_each_beat_is_sent() -> None:
    """A sensor of ten readings a second, as many as there are beats, is not left out."""
    board = attacks.Board()
    board.bumper.rate = 10.0
    board = attacks.Board(bumper=board.bumper)
    wire_ = wire.Wire()
    values = []
    for i in range(200):
        board.step(1, [attacks.ASK, b"r\0\x64\0"][i % 2 :][:1])
        for whole in b"".join(board.said).split(b"\0"):
            said = wire.unstuffed(whole)
            for each in wire_.said(said) if said else ():
                values += [each] if isinstance(each, wire.Heard) else []
        board.said.clear()
    assert len(values) >= 35


def test_what_waits_for_one_step_goes_in_one_message() -> None:
    """Commands and rates, the oldest first."""
    wire_ = wire.Wire()
    beat = struct.pack("<BBBBHIIIIHH", 98, link.VERSION, *[0] * 9)
    names = b"n" + struct.pack("<II", 50_000, 0) + b"a,b;" + b",".join(WHEELS)
    assert [each.version for each in wire_.said(beat) + wire_.said(names)] == [
        link.VERSION
    ]
    many = {each.decode(): wire_.command(each.decode(), 0.5) or b"" for each in WHEELS}

    message, sent = wire_.commands(many)
    assert sent == list(many)[:7]
    assert len(wire.stuffed(message[:-4])) <= link.AT_ONCE
    assert len(wire_.rates({"a": 10.0, "b": 5.0})) == 1


WHEELS = [b"w%d" % number for number in range(20)]


def test_a_command_never_goes_to_another_actuator() -> None:
    """Of more than a message tells apart the rest is not there: nothing is sent to it."""
    wire_ = wire.Wire()
    beat = struct.pack("<BBBBHIIIIHH", 98, link.VERSION, *[0] * 9)
    many = [f"w{number}" for number in range(wire.PLACES + 1)]
    names = b"n" + struct.pack("<II", 50_000, 0) + b";" + ",".join(many).encode()
    wire_.said(beat)
    wire_.said(names)

    told = [wire_.command(each, 0.5) for each in many]
    assert told.pop() is None
    assert [each[0] & 31 for each in told if each] == [*range(wire.PLACES)]


@pytest.mark.parametrize(
    "value",
    [
        (float("inf"), 1.0, -float("inf")),
        (float("nan"), 0.25),
        (1, float("inf")),
        float("inf"),
        0.1,
        -3,
        1 << 40,
        True,
        "näher",
        ("a", (1.5, 2), ()),
        [0.5, 0.25],
        None,
    ],
)
def test_each_value_crosses_as_what_it_is(value) -> None:
    """Infinity and NaN in rows too, whole numbers and texts, both ways the same."""
    buffer = bytearray(200)
    end = link.packed(buffer, 3, value)
    found, at = link.unpacked(bytes(buffer), 3)
    assert (repr(found), at) == (repr(wire.tuples(value)), end)


def answered(board: attacks.Board, *messages: bytes | str) -> tuple[str, str, object]:
    """Return what a board answers to a command: the reason, who, and what was done."""
    reads = wire.Wire()
    board.step(2, [attacks.ASK])
    board.step(20)
    board.said.clear()
    board.step(1, [*messages])
    board.step(4)
    said = [wire.unstuffed(each) for each in b"".join(board.said).split(b"\0") if each]
    names = b"n" + struct.pack("<II", 50_000, 0) + b";motor"
    beat = struct.pack("<BBBBHIIIIHH", 98, link.VERSION, *[0] * 9)
    told = [each for one in [beat, names, *said] for each in reads.said(one or b"")]
    (answer,) = (each for each in told if isinstance(each, wire.Answer))
    return answer.reason, answer.who, answer.done


def test_each_command_is_answered() -> None:
    """By what the board did with it: all of it, a part, or who was against it."""
    go, beat = attacks.go(0.5), attacks.BEAT
    held, moved = attacks.Board(), attacks.Board()
    held.bumper.hit = True
    limited = attacks.Board()
    limited.loop.outputs["motor"].limits, limited.loop.outputs["motor"].clamp = (
        {"": (-0.25, 0.25)},
        True,
    )

    assert answered(moved, beat, go) == ("", "", None)
    assert answered(moved, beat, attacks.go(0.0)) == ("", "", None)
    assert answered(limited, beat, go) == ("", "", 0.25)
    assert answered(held, beat, go) == ("it holds it", "avoid", None)
    assert answered(held, beat, attacks.go(0.0)) == ("it holds it", "avoid", None)
    unarmed = answered(attacks.Board(armed=False), beat, go)
    assert unarmed == ("the board is not armed", "", None)
    late = answered(moved, attacks.beat(moved, 2000), go)
    assert late == ("it came too late", "", None)
    wrong = answered(moved, beat, attacks.go("x"))
    assert wrong == ("the board takes no such command", "", None)


async def test_a_command_that_the_board_does_not_do_is_refused(plugged) -> None:
    """Its writer hears who drives; what is said of it is not that it was applied."""
    answers: list[esair.Written[Any] | esair.Refused] = []

    class Ask(Explore):
        async def run(self) -> None:
            async for _ in esair.every(0.05):
                answers[:] = [*answers, await self.wheels.write((1.0, 0.25))]

    robot, _ = host(plugged, Ask())
    async with robot:
        await until(lambda: (0.5, 0.25) in [each.command for each in answers if each])
        plugged.bump(True)
        await until(lambda: not answers[-1])
        assert isinstance(answers[-1], esair.Refused)
        assert (answers[-1].holder, answers[-1].rule) == ("base:avoid", "it holds it")
        plugged.bump(False)
        await until(lambda: bool(answers[-1]))


@pytest.mark.promise("OPS-3")
async def test_a_board_that_stands_still_has_not_answered(plugged) -> None:
    """Nobody says of its wheels that they are safe, while it cannot have heard it."""
    robot, _ = host(plugged)
    async with robot:
        await until(lambda: last(plugged) == (0.5, 0.25))
        plugged.cable.freeze()
        told = await robot.halt("a test")
        plugged.cable.freeze(still=False)
    assert [each.answered for each in told] == [False]
