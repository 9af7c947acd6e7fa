"""The fake serial line does what it is told, in memory and on a pseudo-terminal."""

from __future__ import annotations

import asyncio
import random

import pytest

from esair.exceptions import DeviceLostError, DriverStuckError
from esair.testing import FakeSerial


async def write_on(line: FakeSerial) -> None:
    """Write until an error comes; a kernel takes a moment to see what was sent."""
    async with asyncio.timeout(5):
        while True:
            await line.write(b"x\n")
            await asyncio.sleep(0.001)


class Checks:
    """What holds on both clocks."""

    async def test_what_is_fed_is_heard(self) -> None:
        """As bytes, or as a message that is framed."""
        line = FakeSerial("front", framing="nmea")
        await line.open()
        inbox = line.frames()

        line.feed(b"$A,1*5C\r\n")
        line.say(b"B,2")

        assert await inbox.take(timeout=2) == b"A,1"
        assert await inbox.take(timeout=2) == b"B,2"
        await line.close()

    async def test_what_is_sent_is_remembered(self) -> None:
        """As messages, and as bytes."""
        line = FakeSerial("front")
        await line.open()

        await line.send(b"one")
        await line.write(b"two\nthr")

        assert await line.until(b"two", timeout=2) == b"two"
        assert list(line.sent) == [b"one", b"two"]
        assert line.written.startswith(b"one\ntwo\n")
        await line.close()

    async def test_until_takes_a_condition(self) -> None:
        """What was sent before counts; what did not come is told with what did."""
        line = FakeSerial("front")
        await line.open()
        waiting = asyncio.create_task(line.until(lambda m: m[:2] == b"v=", timeout=2))
        await asyncio.sleep(0)
        await line.send(b"x=1")
        await line.send(b"v=2")

        assert await waiting == b"v=2"
        assert await line.until(b"x=1") == b"x=1"
        with pytest.raises(TimeoutError, match=r"front: b'y'.*\[b'x=1', b'v=2'\]"):
            await line.until(b"y", timeout=0.01)
        await line.close()

    async def test_it_answers_by_its_script(self) -> None:
        """A reply, a function of the request, silence; and all the others."""
        line = FakeSerial("front", write_timeout=2.0)
        line.answer(b"who?", b"sonar")
        line.answer(b"twice", lambda request: request * 2)
        line.answer(b"nothing", lambda _: None)
        line.on_frame = lambda message: b"what? " + message
        await line.open()

        assert await line.ask(b"who?") == b"sonar"
        assert await line.ask(b"twice") == b"twicetwice"
        assert await line.ask(b"else") == b"what? else"
        with pytest.raises(DriverStuckError):
            await line.ask(b"nothing", timeout=0.05)
        await line.close()

    async def test_it_answers_bytes(self) -> None:
        """For a protocol that the framing does not know."""
        line = FakeSerial("front", framing="raw")
        line.on_write = lambda data: bytes(reversed(data))
        await line.open()

        assert await line.ask(b"abc", timeout=2) == b"cba"
        await line.close()

    async def test_it_repeats(self) -> None:
        """At its period while it is open, and again after a loss."""
        line = FakeSerial("front")
        numbers = iter(range(100))
        line.repeat(lambda: b"n%d\n" % next(numbers), 0.01)
        await line.open()
        inbox = line.frames(b"n")

        assert await inbox.take(timeout=2) == b"n0"
        assert await inbox.take(timeout=2) == b"n1"
        line.unplug()
        with pytest.raises(DeviceLostError):
            async for _ in inbox:
                pass
        count = next(numbers)
        await asyncio.sleep(0.05)
        assert next(numbers) == count + 1
        line.plug()
        await line.open()
        assert (await line.frames(b"n").take(timeout=2))[:1] == b"n"
        await line.close()

    async def test_pieces_of_any_size(self) -> None:
        """The robot gets them one by one."""
        line = FakeSerial("front", framing="raw")
        await line.open()
        inbox = line.frames()
        line.split(3)

        chunks = 0
        for _ in range(20):  # who comes late finds them joined
            line.feed(b"abcdefgh")
            got = b""
            while len(got) < 8:
                got += await inbox.take(timeout=2)
                chunks += 1
            assert got == b"abcdefgh"
        assert chunks > 20
        await line.close()

    async def test_slowly(self) -> None:
        """At so many bytes in a second."""
        line = FakeSerial("front")
        loop = asyncio.get_running_loop()
        await line.open()
        inbox = line.frames()
        line.slow(1000.0)
        begin = loop.time()

        line.feed(b"x" * 99 + b"\n")

        await inbox.take(timeout=5)
        assert loop.time() - begin >= 0.0985
        await line.close()

    async def test_the_same_garbage_for_the_same_seed(self) -> None:
        """So that a failure can be repeated."""
        line = FakeSerial("front", framing="raw")
        await line.open()
        inbox = line.frames()

        line.garbage(7, 100)

        got = b""
        while len(got) < 100:
            got += await inbox.take(timeout=2)
        assert got == random.Random(7).randbytes(100)
        await line.close()

    @pytest.mark.fault("D16")
    async def test_stalled_it_takes_and_gives_nothing(self) -> None:
        """A write times out; after that everything goes on."""
        line = FakeSerial("front", write_timeout=0.1)
        await line.open()
        inbox = line.frames()
        line.stall()
        line.feed(b"later\n")

        with pytest.raises(DriverStuckError):
            await line.write(b"x\n")
        assert len(inbox) == 0
        line.resume()

        assert await inbox.take(timeout=2) == b"later"
        await line.write(b"y\n")
        await line.until(b"y", timeout=2)
        assert line.written == b"y\n"
        await line.close()

    @pytest.mark.fault("D16")
    async def test_xoff_stops_who_heeds_it(self) -> None:
        """And XON lets it go on."""
        line = FakeSerial("front", write_timeout=0.1, xonxoff=True)
        await line.open()
        line.xoff()

        with pytest.raises(DriverStuckError):
            await write_on(line)
        line.xon()

        async with asyncio.timeout(5):
            while line.written[-2:] != b"y\n":
                try:
                    await line.write(b"y\n")
                except DriverStuckError:
                    continue
                await asyncio.sleep(0.001)
        await line.close()

    async def test_xoff_is_a_byte_for_who_does_not_heed_it(self) -> None:
        """As on a line without flow control."""
        line = FakeSerial("front", framing="raw")
        await line.open()
        inbox = line.frames()

        line.xoff()

        assert await inbox.take(timeout=2) == b"\x13"
        await line.write(b"x")
        await line.close()

    @pytest.mark.fault("D01", "D04")
    async def test_unplugged_it_is_lost_and_plugged_it_comes_back(self) -> None:
        """Whoever waits is told, an opening fails meanwhile, an arrival is told."""
        line = FakeSerial("front")
        arrivals: list[int] = []
        line.on_arrival(lambda: arrivals.append(1))
        await line.open()
        inbox = line.frames()
        line.unplug()
        with pytest.raises(DeviceLostError):
            await inbox.take(timeout=2)

        with pytest.raises(DeviceLostError, match="plugged"):
            await line.open()
        line.plug()

        assert arrivals == [1]
        await line.open()
        await line.send(b"again")
        await line.until(b"again", timeout=2)
        await line.close()

    @pytest.mark.fault("D01")
    async def test_at_the_end_of_the_file_the_port_is_still_there(self) -> None:
        """The line is lost, and can be opened at once."""
        line = FakeSerial("front")
        await line.open()
        inbox = line.frames()

        line.end_of_file()

        with pytest.raises(DeviceLostError):
            await inbox.take(timeout=2)
        await line.open()
        await line.send(b"again")
        await line.until(b"again", timeout=2)
        await line.close()

    @pytest.mark.fault("D23", "D24")
    async def test_it_fails_as_often_as_it_is_told(self) -> None:
        """After so many writes, for so many; an OSError is the end of the line."""
        line = FakeSerial("front")
        await line.open()
        line.fail(ValueError("odd"), after=1, times=2)
        await line.send(b"1")
        for _ in range(2):
            with pytest.raises(ValueError, match="odd"):
                await line.send(b"2")
        await line.send(b"3")
        assert line.is_open

        line.fail(OSError(5, "Input/output error"), times=None)
        for _ in range(2):
            with pytest.raises(DeviceLostError, match="Input/output"):
                await line.send(b"4")
            assert not line.is_open
            await line.open()
        await line.close()

    async def test_told_before_it_is_opened(self) -> None:
        """All of it counts when it is."""
        line = FakeSerial("front", write_timeout=0.05)
        line.unplug()
        with pytest.raises(DeviceLostError):
            await line.open()
        line.plug()
        line.stall()
        line.feed(b"nobody hears this\n")
        await line.open()

        with pytest.raises(DriverStuckError):
            await line.write(b"x\n")
        assert line.lost_bytes == len(b"nobody hears this\n")
        await line.close()


@pytest.mark.virtual_clock
class TestInMemory(Checks):
    """On the virtual clock."""

    async def test_a_stall_can_come_in_the_middle_of_a_write(self) -> None:
        """So many bytes are taken before."""
        line = FakeSerial("front")
        await line.open()
        line.stall(after=4)

        with pytest.raises(DriverStuckError):
            await line.write(b"forward\n")

        assert line.written == b"forw"
        await line.close()

    async def test_it_takes_no_time_of_its_own(self) -> None:
        """An exchange in memory is over in the same moment."""
        line = FakeSerial("front")
        line.answer(b"who?", b"sonar")
        await line.open()

        for _ in range(100):
            await line.ask(b"who?")

        assert asyncio.get_running_loop().time() == 0.0
        await line.close()


@pytest.mark.real_clock
class TestOnATerminal(Checks):
    """Through the kernel."""

    async def test_its_port_is_a_device_file(self) -> None:
        """Any program could open it, if the bus had not locked it."""
        line = FakeSerial("front")
        await line.open()

        assert line.path.startswith("/dev/")
        other = FakeSerial("other")
        other._wire = None
        other.port = line.path
        with pytest.raises(DeviceLostError, match="one user"):
            await other.open()

        await other.close()
        await line.close()

    async def test_what_was_sent_last_is_heard(self) -> None:
        """A safe command that is followed by the close at once is in `sent`."""
        line = FakeSerial("front")
        await line.open()
        for number in range(100):
            await line.send(b"%d" % number)
        await line.close()

        assert line.sent[-1] == b"99"
