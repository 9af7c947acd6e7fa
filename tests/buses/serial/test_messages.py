"""Messages, exchanges and faults of a serial line, on the virtual clock."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest

from esair.buses import Inbox
from esair.exceptions import (
    BusyError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    NoTurnError,
)
from esair.loop import SAFE, Urgency, urgency
from esair.testing import FakeSerial

Make = Callable[..., FakeSerial]


@pytest.fixture
async def line(fake_serial: Make) -> AsyncIterator[FakeSerial]:
    made = fake_serial("front")
    yield made
    await made.close()


async def test_send_frames_and_write_does_not(line: FakeSerial) -> None:
    """A payload gets what the framing adds; bytes go as they are."""
    await line.open()

    await line.send(b"one")
    await line.write(b"two\nthree\n")
    await line.until(b"three")

    assert line.written == b"one\ntwo\nthree\n"
    assert list(line.sent) == [b"one", b"two", b"three"]


@pytest.mark.parametrize(
    ("framing", "wire"),
    [
        ("lines", b"hello\n"),
        ("nmea", b"$hello*62\r\n"),
        ("raw", b"hello"),
        ({"type": "lines", "delimiter": ";"}, b"hello;"),
    ],
)
async def test_a_framing_is_named_or_described(
    fake_serial: Make, framing: object, wire: bytes
) -> None:
    """As a configuration file does it: by its name, or as a table with parameters."""
    line = fake_serial("front", framing=framing)
    line.on_frame = lambda message: message
    await line.open()

    assert await line.ask(b"hello") == b"hello"
    assert line.written == wire
    await line.close()


async def test_each_opening_begins_with_a_clean_decoder(line: FakeSerial) -> None:
    """Half a message from before a loss is not joined with what comes after it."""
    await line.open()
    inbox = line.frames()
    line.feed(b"half a mess")
    await asyncio.sleep(0.01)
    line.unplug()
    with pytest.raises(DeviceLostError):
        await inbox.take()
    line.plug()
    await line.open()
    inbox = line.frames()

    line.feed(b"whole\n")

    assert await inbox.take() == b"whole"


# Echo.


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-3")
async def test_what_was_thrown_away_has_no_echo() -> None:
    """Else the echo of the next request would be taken for its answer."""
    line = FakeSerial("servos", echo=True, write_timeout=0.1)
    await line.open()
    line.stall(after=3)
    with pytest.raises(DriverStuckError):
        await line.write(b"first\n")
    line.resume()

    asking = asyncio.create_task(line.ask(b"second", prefix=b"second"))
    await line.until(b"second")
    line.say(b"second: 2")

    assert await asking == b"second: 2"
    await line.close()


@pytest.mark.virtual_clock
@pytest.mark.promise("BUS-3")
@pytest.mark.parametrize("damaged", [b"", b"set 1", b"st 1\n", b"et 1\n"])
@pytest.mark.parametrize("size", [1, 4, 100])
async def test_an_echo_behind_a_damaged_one_is_no_answer(
    damaged: bytes, size: int
) -> None:
    """A board that confirms a command by the same words would have confirmed it."""
    line = FakeSerial("servos", echo=True, write_timeout=0.1, late_limit=0.05)
    line.on_write = lambda data: None
    await line.open()
    asking = asyncio.create_task(line.ask(b"set 1", prefix=b"set"))
    await asyncio.sleep(0.01)
    line.feed(damaged)
    with pytest.raises(DriverStuckError):
        await asking
    await asyncio.sleep(0.1)

    asking = asyncio.create_task(line.ask(b"set 2", prefix=b"set"))
    await asyncio.sleep(0.01)
    for at in range(0, 6, size):
        line.feed(b"set 2\n"[at : at + size])
        await asyncio.sleep(0.001)
    with pytest.raises(DriverStuckError):
        await asking
    await asyncio.sleep(0.1)

    asking = asyncio.create_task(line.ask(b"set 3", prefix=b"set"))
    await asyncio.sleep(0.01)
    line.feed(b"set 3\nset 3\n")
    assert await asking == b"set 3"
    await line.close()


@pytest.mark.virtual_clock
async def test_a_fake_with_one_wire_echoes_before_it_answers() -> None:
    """Without an echo the head of an answer, which is that of the request, went away."""
    line = FakeSerial("servos", echo=True)
    line.split(1)
    line.answer(b"angle?", b"angle? 12")
    line.on_frame = lambda message: message if message == b"again" else None
    await line.open()

    assert await line.ask(b"angle?") == b"angle? 12"
    assert await line.ask(b"again") == b"again"
    await line.send(b"no answer")
    async with asyncio.timeout(5.0):
        while line._echo:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    assert line.stats.bad_frames == 0
    await line.close()


@pytest.mark.virtual_clock
async def test_an_echo_that_never_comes_is_not_kept_for_ever() -> None:
    """A line that was said to have one, and has none, costs no memory."""
    line = FakeSerial("servos", echo=True)
    line.on_write = lambda data: None
    await line.open()
    for _ in range(1000):
        await line.write(bytes(1000))

    assert len(line._echo) <= 65536
    assert line.stats.bad_frames > 0
    line.say(b"heard")
    await asyncio.sleep(0)
    await line.close()


# Exchanges.


async def test_exchanges_never_overlap(line: FakeSerial) -> None:
    """Each request is sent when the answer to the one before has come."""
    times: list[tuple[float, bytes]] = []
    loop = asyncio.get_running_loop()

    def hear(message: bytes) -> None:
        times.append((loop.time(), message))
        loop.call_later(0.1, line.say, b"re " + message)

    line.on_frame = hear
    await line.open()

    answers = await asyncio.gather(*(line.ask(b"%d" % n) for n in range(3)))

    assert answers == [b"re 0", b"re 1", b"re 2"]
    assert [message for _, message in times] == [b"0", b"1", b"2"]
    assert [time for time, _ in times] == pytest.approx([0.0, 0.1, 0.2], abs=1e-6)


@pytest.mark.promise("BUS-5")
async def test_the_wait_for_the_turn_ends_apart_from_the_time(line: FakeSerial) -> None:
    """Who waits behind a slow exchange gives up in time, has sent nothing, and says so."""
    loop = asyncio.get_running_loop()
    await line.open()
    slow = asyncio.create_task(line.ask(b"slow", timeout=2.0))
    await asyncio.sleep(0)

    with pytest.raises(NoTurnError, match="quick"):
        await line.ask(b"quick", timeout=0.3)

    assert loop.time() == pytest.approx(1.0)
    assert line.stats.no_turn == 1
    assert list(line.sent) == [b"slow"]
    line.say(b"at last")
    assert await slow == b"at last"


async def test_a_turn_that_nobody_wants_any_more_is_passed_on(line: FakeSerial) -> None:
    """Cancelled and timed-out requests leave the line to those behind them."""
    line.answer(b"last", b"fine")
    await line.open()
    first = asyncio.create_task(line.ask(b"first", timeout=1.0))
    await asyncio.sleep(0)
    cancelled = asyncio.create_task(line.ask(b"cancelled", timeout=5.0))
    late = asyncio.create_task(line.ask(b"late", timeout=0.5))
    last = asyncio.create_task(line.ask(b"last", timeout=5.0))
    await asyncio.sleep(0.1)

    cancelled.cancel()

    assert await last == b"fine"
    done = await asyncio.gather(first, late, cancelled, return_exceptions=True)
    assert [type(each) for each in done] == [
        DriverStuckError, DriverStuckError, asyncio.CancelledError,
    ]  # fmt: skip
    assert list(line.sent) == [b"first", b"last"]
    assert await line.ask(b"last") == b"fine"


@pytest.mark.fault("X07")
@pytest.mark.parametrize("when", ["before", "with", "after"])
async def test_cancelled_in_the_tick_its_turn_comes(
    line: FakeSerial, when: str
) -> None:
    """The turn is not lost with the one who got it."""
    line.answer(b"first", b"one")
    line.answer(b"third", b"three")

    def cancel(_answer: bytes) -> bool:
        if when == "before":
            second.cancel()
        elif when == "with":
            asyncio.get_running_loop().call_soon(second.cancel)
        return True

    await line.open()
    first = asyncio.create_task(line.ask(b"first", answers=cancel))
    second = asyncio.create_task(line.ask(b"second"))
    third = asyncio.create_task(line.ask(b"third", timeout=2.0))
    if when == "after":
        first.add_done_callback(lambda _: second.cancel())

    assert await third == b"three"

    assert await first == b"one"
    assert second.cancelled()
    assert (b"second" in line.sent) == (when == "after")


@pytest.mark.fault("X01", "X07")
@pytest.mark.parametrize("step", range(8))
@pytest.mark.parametrize("stalled", [False, True])
async def test_cancelled_at_any_step(
    line: FakeSerial, step: int, stalled: bool
) -> None:
    """The turn is given back, nobody listens any more, and the next request works."""
    line.answer(b"one", b"first")
    line.answer(b"two", b"second")
    await line.open()
    if stalled:
        line.stall()
    asking = asyncio.create_task(line.ask(b"one"))
    waiting = asyncio.create_task(line.ask(b"two", prefix=b"s", timeout=9.0))
    for _ in range(step):
        await asyncio.sleep(0)

    asking.cancel()
    await asyncio.wait({asking})
    line.resume()

    assert asking.cancelled() or asking.result() == b"first"
    assert await waiting == b"second"
    assert await line.ask(b"two", prefix=b"s") == b"second"
    assert line._exchanges.waiting == 0
    assert line._inboxes == []


async def test_requests_that_wait_are_bounded(line: FakeSerial) -> None:
    """Beyond the bound a request is refused at once."""
    await line.open()
    asking = [asyncio.create_task(line.ask(b"x", timeout=1.0)) for _ in range(257)]
    await asyncio.sleep(0)

    with pytest.raises(BusyError, match="256"):
        await line.ask(b"x")

    assert line.stats.refused == 1
    await asyncio.wait(asking)
    assert all(isinstance(each.exception(), DriverStuckError) for each in asking)


async def test_what_came_before_the_request_is_no_answer(line: FakeSerial) -> None:
    """A late answer to a request that was given up is thrown away."""
    await line.open()
    with pytest.raises(DriverStuckError):
        await line.ask(b"range?", timeout=0.1)
    line.say(b"range=1")
    await asyncio.sleep(0.1)
    line.answer(b"range?", b"range=2")

    assert await line.ask(b"range?") == b"range=2"
    assert (line.stats.unheard, line.stats.late) == (1, 1)


async def test_a_sequence_number_tells_late_answers_apart(line: FakeSerial) -> None:
    """Even if the late answer comes in the middle of the next exchange."""

    def late_and_right(_request: bytes) -> bytes:
        line.say(b"1 late")
        return b"2 right"

    await line.open()
    with pytest.raises(DriverStuckError):
        await line.ask(b"get 1", prefix=b"1 ", timeout=0.1)
    line.answer(b"get 2", late_and_right)

    answer = await line.ask(b"get 2", answers=lambda message: message[:1] == b"2")

    assert answer == b"2 right"


async def test_a_loss_ends_every_exchange(line: FakeSerial) -> None:
    """The one on the line and those that wait for their turn."""
    await line.open()
    asking = [asyncio.create_task(line.ask(b"x", timeout=9.0)) for _ in range(3)]
    await asyncio.sleep(0.1)

    line.unplug()

    await asyncio.wait(asking, timeout=0.1)
    assert [type(each.exception()) for each in asking] == [DeviceLostError] * 3


# Faults.


@pytest.mark.fault("D02")
@pytest.mark.parametrize("taken", range(len(b"forward 1.0\n")))
async def test_unplugged_in_the_middle_of_a_write(line: FakeSerial, taken: int) -> None:
    """The writer is told that it is unknown; what was left is never sent."""
    await line.open()
    line.stall(after=taken)
    writing = asyncio.create_task(line.write(b"forward 1.0\n", timeout=9.0))
    await asyncio.sleep(0.1)

    line.unplug()

    with pytest.raises(DeviceLostError):
        await writing
    line.plug()
    line.resume()
    await line.open()
    await asyncio.sleep(1.0)
    assert line.written == b"forward 1.0\n"[:taken]


@pytest.mark.fault("D16")
async def test_what_waits_when_the_deadline_passes_is_never_sent(
    line: FakeSerial,
) -> None:
    """A command that is late is not obeyed later."""
    await line.open()
    line.stall(after=3)

    with pytest.raises(DriverStuckError, match=r"0\.5 s"):
        await line.write(b"forward\n")

    assert line.stats.discarded == 5
    assert line.waiting == 0
    line.resume()
    await asyncio.sleep(1.0)
    assert line.written == b"for"


@pytest.mark.fault("D16", "D02")
@pytest.mark.parametrize("how", ["stuck", "unplugged"])
@pytest.mark.parametrize(
    ("framing", "message"), [("lines", b"forward"), ("cobs", b"fo\0ward")]
)
async def test_a_message_that_was_cut_does_not_take_the_next_one_with_it(
    fake_serial: Make, framing: str, message: bytes, how: str
) -> None:
    """The next one is the safe command, as a rule."""
    line = fake_serial("front", framing=framing)
    await line.open()
    line.stall(after=3)
    writing = asyncio.create_task(line.send(message))
    await asyncio.sleep(0.1)
    if how == "unplugged":
        line.unplug()
        line.plug()
    await asyncio.wait({writing})
    assert writing.exception() is not None
    line.resume()
    if how == "unplugged":
        await line.open()

    await line.send(b"stop")
    await line.send(b"stop again")
    await line.until(b"stop again")

    assert list(line.sent)[-2:] == [b"stop", b"stop again"]
    assert line.written.endswith(b"stop again" + line.written[-1:])
    assert line.stats.discarded > 0
    await line.close()


@pytest.mark.fault("D16")
async def test_what_waits_gives_way_to_what_is_safe(fake_serial: Make) -> None:
    """It would come first, and late; what is safe, too, stays, and is never refused."""
    line = fake_serial("front", out_limit=24)
    await line.open()
    line.stall(after=3)
    motions = [asyncio.create_task(line.send(b"forward")) for _ in range(3)]
    await asyncio.sleep(0.3)

    urgency.set(Urgency(SAFE))
    stops = [asyncio.create_task(line.send(each)) for each in (b"stop 1", b"stop 2")]
    urgency.set(Urgency())
    await asyncio.wait(motions)
    after = asyncio.create_task(line.send(b"back"))
    await asyncio.sleep(0.1)
    line.resume()
    await asyncio.gather(*stops, after)
    await line.until(b"back")

    assert [type(each.exception()) for each in motions] == [DriverStuckError] * 3
    assert line.written == b"for\nstop 1\nstop 2\nback\n"
    await line.close()


@pytest.mark.fault("D16")
async def test_a_request_that_waits_gives_way_to_what_is_safe(line: FakeSerial) -> None:
    """So the safe one has its turn, and no answer is owed that it would wait for."""
    line.on_frame = lambda message: message.replace(b"=", b":")
    await line.open()
    line.stall()
    motion = asyncio.create_task(line.ask(b"speed=1", prefix=b"speed:"))
    await asyncio.sleep(0.1)

    urgency.set(Urgency(SAFE))
    stop = asyncio.create_task(line.ask(b"speed=0", prefix=b"speed:"))
    await asyncio.sleep(0.1)
    line.resume()

    assert await stop == b"speed:0"
    assert asyncio.get_running_loop().time() == pytest.approx(0.2, abs=0.01)
    assert isinstance(motion.exception(), BusyError)
    assert list(line.sent) == [b"speed=0"]


@pytest.mark.fault("D16")
async def test_what_is_cut_gives_way_only_if_a_delimiter_can_end_it(
    fake_serial: Make,
) -> None:
    """Else what is safe would be taken for its rest."""
    framing = {"type": "length-crc", "sync": "AA 55"}
    line = fake_serial("front", framing=framing)
    await line.open()
    line.stall(after=3)
    motion = asyncio.create_task(line.send(b"forward"))
    await asyncio.sleep(0.1)

    urgency.set(Urgency(SAFE))
    stop = asyncio.create_task(line.send(b"stop"))
    await asyncio.sleep(0.1)
    line.resume()
    await asyncio.gather(motion, stop)
    await line.until(b"stop")

    assert list(line.sent) == [b"forward", b"stop"]
    await line.close()


@pytest.mark.fault("D16", "X01")
async def test_a_write_that_is_cancelled_is_taken_back(line: FakeSerial) -> None:
    """Nobody wants it any more: it does not come late."""
    await line.open()
    line.stall()
    writing = asyncio.create_task(line.write(b"forward\n"))
    await asyncio.sleep(0.1)

    writing.cancel()
    await asyncio.wait({writing})

    assert line.waiting == 0
    line.resume()
    await line.write(b"stop\n")
    await line.until(b"stop")
    assert line.written == b"stop\n"


@pytest.mark.fault("D16", "X01")
async def test_a_cancelled_write_takes_nobody_elses_bytes_back(
    line: FakeSerial,
) -> None:
    """What waits behind it goes out, in order."""
    await line.open()
    line.stall()
    one = asyncio.create_task(line.write(b"one\n"))
    two = asyncio.create_task(line.write(b"two\n"))
    await asyncio.sleep(0.1)

    one.cancel()
    await asyncio.sleep(0.1)
    line.resume()

    await two
    await line.until(b"two")
    assert line.written == b"one\ntwo\n"


@pytest.mark.fault("D16")
async def test_a_request_that_cannot_be_sent_waits_no_longer_than_it_may(
    line: FakeSerial,
) -> None:
    """And none of it comes late."""
    await line.open()
    line.stall()

    with pytest.raises(DriverStuckError):
        await line.ask(b"range?", timeout=0.2)

    assert asyncio.get_running_loop().time() == pytest.approx(0.2)
    assert line.waiting == 0
    line.resume()
    await asyncio.sleep(1.0)
    assert line.written == b""


@pytest.mark.fault("D08")
@pytest.mark.parametrize("size", [1, 2, 3, 5, 7, 11])
async def test_pieces_make_no_difference(line: FakeSerial, size: int) -> None:
    """Messages are the same whatever the pieces in which their bytes come."""
    await line.open()
    inbox = line.frames()
    line.split(size)

    line.feed(b"one\ntwo two\n\nfour\n")

    got = [await inbox.take(timeout=1) for _ in range(4)]
    assert got == [b"one", b"two two", b"", b"four"]


@pytest.mark.fault("D09")
@pytest.mark.parametrize("seed", range(20))
async def test_the_message_after_garbage_is_heard(fake_serial: Make, seed: int) -> None:
    """Noise is counted, raises nothing, and costs at most the message it touches."""
    line = fake_serial("front", framing="nmea")
    await line.open()
    inbox = line.frames(b"RF")
    line.garbage(seed, 500)
    line.say(b"RFSWP,0")

    line.say(b"RFSWP,1")

    first = await inbox.take(timeout=1)
    assert b"RFSWP,1" in [first, *await rest(inbox)]
    assert line.stats.received > 500
    await line.close()


@pytest.mark.fault("D10")
async def test_nothing_but_damage_is_a_fault(fake_serial: Make) -> None:
    """A wrong baud rate does not look like a silent device for ever."""
    line = fake_serial("front", framing="nmea", bad_limit=10)
    await line.open()
    inbox = line.frames()

    line.feed(b"$GPGGA,1*00\r\n" * 10)

    with pytest.raises(DeviceFaultError, match="check the baud rate"):
        await inbox.take(timeout=1)
    assert line.stats.bad_frames == 10
    assert line.is_open
    again = line.frames()
    line.say(b"GPGGA,2")
    assert await again.take(timeout=1) == b"GPGGA,2"
    await line.close()


@pytest.mark.fault("D10")
async def test_damage_now_and_then_is_only_counted(fake_serial: Make) -> None:
    """One good message begins the count anew."""
    line = fake_serial("front", framing="nmea", bad_limit=10)
    await line.open()
    inbox = line.frames()

    for _ in range(5):
        line.feed(b"$GPGGA,1*00\r\n" * 9)
        line.say(b"GPGGA,2")

    assert [await inbox.take(timeout=1) for _ in range(5)] == [b"GPGGA,2"] * 5
    assert line.stats.bad_frames == 45
    await line.close()


@pytest.mark.fault("D13")
async def test_a_flood_is_cut_to_the_newest(line: FakeSerial) -> None:
    """A million messages cost no memory, and each is counted."""
    await line.open()
    inbox = line.frames(b"n", limit=8)

    for _ in range(100):
        line.feed(b"n\n" * 10_000)
        await asyncio.sleep(0.001)
    line.feed(b"newest\n")
    await asyncio.sleep(0.001)

    assert len(inbox) == 8
    assert line.stats.dropped == 1_000_001 - 8
    assert (await rest(inbox))[-1] == b"newest"


@pytest.mark.fault("D11")
async def test_a_stream_without_an_end_takes_no_memory(line: FakeSerial) -> None:
    """A hundred megabytes without a delimiter are counted and thrown away."""
    await line.open()
    inbox = line.frames()
    piece = b"x" * 50_000

    for _ in range(2000):
        line.feed(piece)
        await asyncio.sleep(0.001)
    line.feed(b"\nwhole\n")

    assert await inbox.take(timeout=1) == b"whole"
    assert line.stats.received == 100_000_007
    assert line.framing.discarded >= 99_000_000


@pytest.mark.fault("D14")
async def test_a_silent_device_costs_its_asker_the_deadline(line: FakeSerial) -> None:
    """The line stays open, and others on it go on."""
    line.answer(b"b?", b"b=1")
    await line.open()

    with pytest.raises(DriverStuckError, match=r"answer to b'a\?'"):
        await line.ask(b"a?", timeout=0.2)

    assert await line.ask(b"b?") == b"b=1"
    assert line.is_open
    assert line.stats.errors == 1


@pytest.mark.fault("D23")
@pytest.mark.parametrize("after", range(3))
async def test_a_write_that_fails_once(line: FakeSerial, after: int) -> None:
    """The error of the kernel ends the line; the next opening works."""
    line.fail(OSError(5, "Input/output error"), after=after)
    await line.open()

    for _ in range(after):
        await line.send(b"good")
    with pytest.raises(DeviceLostError, match="Input/output error"):
        await line.send(b"bad")

    assert not line.is_open
    await line.open()
    await line.send(b"good again")
    await line.until(b"good again")
    assert b"bad" not in line.sent


@pytest.mark.fault("D01")
@pytest.mark.parametrize("heard", range(len(b"range=1.25\n")))
async def test_unplugged_at_each_byte_of_a_message(
    line: FakeSerial, heard: int
) -> None:
    """Whoever waits is told at once; a half message is none."""
    await line.open()
    waiting = asyncio.create_task(line.frames().take(timeout=60))
    line.feed(b"range=1.25\n"[:heard])
    await asyncio.sleep(0.1)

    line.unplug()

    with pytest.raises(DeviceLostError):
        await waiting
    assert asyncio.get_running_loop().time() == pytest.approx(0.1)


async def rest(inbox: Inbox[bytes]) -> list[bytes]:
    """Take everything that is there."""
    return [await inbox.take() for _ in range(len(inbox))]


@pytest.mark.fault("D16", "D22")
async def test_a_message_sent_after_a_stall_is_not_thrown_away_with_it(
    fake_serial: Make,
) -> None:
    """Several wait for a line that is stuck; whoever is told first sends the stop."""
    line = fake_serial("front", write_timeout=0.2)
    await line.open()
    line.stall()

    async def drive_and_stop() -> None:
        try:
            await line.send(b"drive")
        except DriverStuckError:
            asyncio.get_running_loop().call_later(0.05, line.resume)
            await line.send(b"stop")

    async def blink() -> None:
        with pytest.raises(DriverStuckError):
            await line.send(b"blink", timeout=0.3)

    await asyncio.gather(drive_and_stop(), blink())

    assert list(line.sent)[-1] == b"stop"
    assert line.stats.errors == 1
    await line.close()


async def test_the_error_of_a_lost_line_does_not_grow(line: FakeSerial) -> None:
    """Whoever asks again and again leaves nothing in its traceback."""
    await line.open()
    inbox = line.frames()
    line.unplug()
    depths = []

    for _ in range(20):
        with pytest.raises(DeviceLostError) as caught:
            await inbox.take(timeout=1)
        depths.append(len(caught.traceback))

    assert depths[1:] == depths[1:2] * 19


async def test_each_message_of_a_read_is_counted_once(line: FakeSerial) -> None:
    """By who heard it, took it as an answer, let it go for newer ones, or by nobody."""
    await line.open()
    loud, quiet = line.frames(b"x=", limit=2), line.frames(b"y=")
    asked = asyncio.ensure_future(line.ask(b"z?", prefix=b"z="))
    await asyncio.sleep(0.01)

    line.feed(b"x=1\n\nx=2\ny=1\nnoise\nz=7\nx=3\nz=8\n")
    assert await asked == b"z=7"

    assert [await loud.take() for _ in range(2)] == [b"x=2", b"x=3"]
    assert await quiet.take() == b"y=1"
    assert (line.stats.dropped, line.stats.unheard) == (1, 3)
