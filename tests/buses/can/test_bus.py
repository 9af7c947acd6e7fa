"""The CAN bus: listeners, sending, states; on a bus in memory and on scripted links."""

from __future__ import annotations

import ast
import asyncio
import errno
import itertools
import re
import tracemalloc
from collections.abc import AsyncIterator, Callable, Collection
from pathlib import Path
from typing import Any

import hypothesis
import pytest
from hypothesis import strategies as st

import esair
from esair.buses import CanBus, CanState, Frame, FrameKind, FrameLink, Wire
from esair.buses.can import ALL, Filter, Ids, Mask
from esair.exceptions import (
    BadValueError,
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.loop import COMMAND, OPENING, SAFE, Urgency, urgency
from esair.testing import FakeCan, VirtualLoop

pytestmark = pytest.mark.virtual_clock


class Link(Wire):
    """A node that does what a test says."""

    def __init__(self) -> None:
        super().__init__()
        self.state = CanState.ACTIVE
        self.sent: list[Frame] = []
        self.heard: list[set[int]] = []
        self.full = 0
        self.closed = 0
        self.opened = 0
        self.received: Callable[[Frame], None] = lambda _frame: None
        self.gone: Callable[[Exception], None] = lambda _error: None
        self.on_open: Callable[[], None] = lambda: None

    async def open(
        self,
        received: Callable[[Frame], None],
        gone: Callable[[Exception], None],
    ) -> FrameLink:
        self.opened += 1
        self.received, self.gone = received, gone
        self.on_open()
        return self

    def listen(self, filters: Collection[Filter] | None) -> None:
        self.heard.append({each.key for each in filters or ()})

    async def send(self, frame: Frame, timeout: float) -> bool:
        if self.full:
            self.full -= 1
            return False
        self.sent.append(frame)
        return True

    async def close(self) -> None:
        self.closed += 1


@pytest.fixture
def link() -> Link:
    return Link()


@pytest.fixture
async def bus(link: Link) -> AsyncIterator[CanBus]:
    made = CanBus(name="drive", wire=link)
    yield made
    await made.close()


async def test_each_listener_gets_the_frames_with_its_ids(
    link: Link, bus: CanBus
) -> None:
    """What nobody listens to is counted."""
    await bus.open()
    left, both = bus.frames(1), bus.frames(1, 2)

    for number in (1, 2, 3):
        link.received(Frame(number, b""))

    assert [(await left.take()).id, len(left)] == [1, 0]
    assert [(await both.take()).id, (await both.take()).id] == [1, 2]
    assert bus.stats.unheard == 1
    both.close()
    link.received(Frame(2, b""))
    assert bus.stats.unheard == 2
    assert bus.stats.received == 4


async def test_a_node_is_told_which_ids_somebody_listens_to(
    link: Link, bus: CanBus
) -> None:
    """All of them together, after each change; extended ones have their own bit."""
    await bus.open()

    first = bus.frames(1, 2)
    second = bus.frames(2, extended=True)
    first.close()
    second.close()

    extended = 2 | 1 << 31
    assert link.heard == [{1, 2}, {1, 2, extended}, {extended}, set()]


@hypothesis.given(
    subscriptions=st.lists(
        st.tuples(
            st.one_of(
                st.integers(0, 0x7FF),
                st.builds(Mask, st.integers(0, 0x7FF), st.integers(0, 0x7FF)),
                st.tuples(st.integers(0, 0x7FF), st.integers(0, 0x7FF)).map(
                    lambda ends: range(min(ends), max(ends) + 1)
                ),
                st.just(ALL),
            ),
            st.booleans(),
        ),
        min_size=1,
        max_size=4,
    ),
    frames=st.lists(st.tuples(st.integers(0, 0x7FF), st.booleans()), max_size=30),
)
@pytest.mark.promise("BUS-4")
def test_ids_masks_ranges_and_all(
    subscriptions: list[tuple[Ids, bool]], frames: list[tuple[int, bool]]
) -> None:
    """Each listener gets exactly its frames, once; the kernel is told the same."""

    def wanted(ids: Ids, extended: bool, number: int, is_extended: bool) -> bool:
        if ids is ALL:
            return True
        if extended is not is_extended:
            return False
        if isinstance(ids, Mask):
            return (number ^ ids.id) & ids.mask == 0
        return number in ids if isinstance(ids, range) else number == ids

    async def main() -> None:
        link = Link()
        bus = CanBus(name="drive", wire=link)
        filters: list[Filter] = []
        link.listen = filters.extend  # type: ignore[method-assign,assignment]
        await bus.open()
        for ids, extended in subscriptions:
            filters.clear()
            inbox = bus.frames(ids, ids, extended=extended, limit=64)
            expected = []
            for number, is_extended in frames:
                link.received(Frame(number, b"", is_extended))
                key = number | (1 << 31 if is_extended else 0)
                heard = any(key & mask == each for each, mask in filters)
                assert heard is wanted(ids, extended, number, is_extended)
                if heard:
                    expected.append((number, is_extended))
            found = [(await inbox.take())[::2][:2] for _ in range(len(inbox))]
            assert found == expected
            inbox.close()
        await bus.close()

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main())


async def test_who_listens_to_an_id_may_change_at_any_time(
    link: Link, bus: CanBus
) -> None:
    """What was found out about an id is forgotten when somebody comes or goes."""
    await bus.open()
    every = bus.frames(ALL, limit=5000)
    link.received(Frame(7, b""))
    one = bus.frames(range(4, 8))
    link.received(Frame(7, b""))
    every.close()
    link.received(Frame(7, b""))
    for number in range(5000):  # more than are remembered
        link.received(Frame(number, b"", extended=True))
    link.received(Frame(7, b""))

    assert (len(every), len(one)) == (2, 3)
    assert len(bus._routes) <= 4096


async def test_the_newest_frame_of_each_id_of_a_mask(link: Link, bus: CanBus) -> None:
    """As many ids as the limit says: then the one that waited longest gives way."""
    await bus.open()
    inbox = bus.frames(ALL, newest=True, limit=2)

    for number, data in [(1, b"a"), (2, b"b"), (1, b"c"), (3, b"d"), (2, b"e")]:
        link.received(Frame(number, data))

    assert [(await inbox.take()).data for _ in range(2)] == [b"e", b"d"]
    assert (len(inbox), inbox.dropped) == (0, 3)


@pytest.mark.fault("C10")
async def test_an_extended_id_is_another_id(link: Link, bus: CanBus) -> None:
    """A standard id with the same number has its own listeners."""
    await bus.open()
    standard, extended = bus.frames(0x123), bus.frames(0x123, extended=True)

    link.received(Frame(0x123, b"s"))
    link.received(Frame(0x123, b"e", extended=True))

    assert (len(standard), (await standard.take()).data) == (1, b"s")
    assert (len(extended), (await extended.take()).data) == (1, b"e")


@pytest.mark.fault("C10")
async def test_a_frame_of_the_wrong_length_is_counted(link: Link, bus: CanBus) -> None:
    """It never reaches who expects another length; who expects none gets it."""
    await bus.open()
    exact, newest, any_length = (
        bus.frames(1, length=2),
        bus.frames(1, length=2, newest=True),
        bus.frames(1),
    )

    for data in (b"", b"a", b"ab", b"abc"):
        link.received(Frame(1, data))

    assert (len(exact), (await exact.take()).data) == (1, b"ab")
    assert (len(newest), (await newest.take()).data) == (1, b"ab")
    assert len(any_length) == 4
    assert (exact.bad_frames, newest.bad_frames, bus.stats.bad_frames) == (3, 3, 6)


@pytest.mark.fault("C10")
async def test_an_id_that_is_named_twice_gives_each_frame_once(
    link: Link, bus: CanBus
) -> None:
    """And a frame that comes twice is two frames: the bus cannot know better."""
    await bus.open()
    inbox = bus.frames(1, 1, 1)

    link.received(Frame(1, b""))
    assert len(inbox) == 1
    link.received(Frame(1, b""))
    assert len(inbox) == 2


FRAMES = st.lists(
    st.builds(
        Frame,
        id=st.integers(0, 3),
        data=st.binary(max_size=3),
        extended=st.booleans(),
        kind=st.sampled_from([FrameKind.DATA, FrameKind.REMOTE]),
    ),
    max_size=40,
)


@hypothesis.given(frames=FRAMES)
@pytest.mark.fault("C10")
def test_every_frame_is_taken_or_counted(frames: list[Frame]) -> None:
    """Each listener gets exactly its frames, in order; the counters add up."""

    async def check() -> None:
        link = Link()
        bus = CanBus(name="drive", wire=link)
        await bus.open()
        wanted = {
            (1, False): bus.frames(1, limit=100),
            (2, True): bus.frames(2, extended=True, limit=100),
        }
        for frame in frames:
            link.received(frame)
        taken = 0
        for (number, extended), inbox in wanted.items():
            expected = [
                frame
                for frame in frames
                if (frame.id, frame.extended) == (number, extended)
                and frame.kind is FrameKind.DATA
            ]
            assert [await inbox.take() for _ in range(len(inbox))] == expected
            taken += len(expected)
        stats = bus.stats
        assert stats.received == len(frames)
        assert taken + stats.bad_frames + stats.unheard == len(frames)
        await bus.close()

    loop = VirtualLoop()
    try:
        loop.run_until_complete(check())
    finally:
        loop.close()


@pytest.mark.fault("C07")
@pytest.mark.long
async def test_frames_that_nobody_takes_give_way_to_newer_ones(
    link: Link, bus: CanBus
) -> None:
    """A million frames take no more memory than those that are kept."""
    await bus.open()
    inbox, newest = bus.frames(1, limit=4), bus.frames(1, newest=True)
    frames = [Frame(1, bytes((number,))) for number in range(100)]
    received = link.received
    tracemalloc.start()
    try:
        for frame in frames:
            received(frame)
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for frame in frames * 10:
            received(frame)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak - before < 20_000
    for _ in range(9_989):
        for frame in frames:
            received(frame)

    assert bus.stats.received == 1_000_000
    assert (len(inbox), len(newest)) == (4, 1)
    assert (inbox.dropped, newest.dropped) == (999_996, 999_999)
    assert bus.stats.dropped == 999_996 + 999_999
    assert [(await inbox.take()).data[0] for _ in range(4)] == [96, 97, 98, 99]
    assert (await newest.take()).data[0] == 99


@pytest.mark.fault("C07")
async def test_a_fast_id_does_not_push_out_a_slow_one(link: Link, bus: CanBus) -> None:
    """With ``newest`` each id has a place of its own, and keeps it."""
    await bus.open()
    inbox = bus.frames(1, 2, 3, newest=True)

    link.received(Frame(2, b"slow"))
    for number in range(100):
        link.received(Frame(1, bytes((number,))))
    link.received(Frame(3, b""))

    taken = [await inbox.take() for _ in range(3)]
    assert [(frame.id, frame.data) for frame in taken] == [
        (2, b"slow"),
        (1, bytes((99,))),
        (3, b""),
    ]
    with pytest.raises(TimeoutError):
        await inbox.take(timeout=1)


async def test_a_waiting_listener_is_woken_by_either_inbox(
    link: Link, bus: CanBus
) -> None:
    """Also by the one that keeps only the newest."""
    await bus.open()
    for newest in (False, True):
        inbox = bus.frames(1, newest=newest)
        waiting = asyncio.create_task(inbox.take(timeout=1))
        await asyncio.sleep(0)
        link.received(Frame(1, b"x"))
        assert (await waiting).data == b"x"
    link.gone(ConnectionError("gone"))
    with pytest.raises(DeviceLostError):
        await inbox.take()


@pytest.mark.parametrize("ids", [(), (0x800,), (-1,), ("1",)])
async def test_nobody_listens_to_what_is_no_id(bus: CanBus, ids: Any) -> None:
    """The error names what is wrong."""
    await bus.open()
    with pytest.raises(BadValueError, match=r"drive: ids?:"):
        bus.frames(*ids)


@pytest.mark.fault("C04", "C09")
async def test_a_full_queue_is_tried_again_until_the_deadline(
    link: Link, bus: CanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame that finds room late is sent once; the wall clock has no say in it."""
    walls = itertools.cycle([0.0, 1e9, 5.0])
    monkeypatch.setattr("time.time", lambda: next(walls))
    await bus.open()
    loop = asyncio.get_running_loop()

    link.full = 3
    await bus.send(1, b"a")
    link.full = 10_000
    begin = loop.time()
    with pytest.raises(DeviceFaultError, match=r"0\.25 s"):
        await bus.send(1, b"b", timeout=0.25)

    assert loop.time() - begin == pytest.approx(0.25, abs=1e-6)
    assert [frame.data for frame in link.sent] == [b"a"]
    assert bus.stats.retries > 3
    assert (bus.stats.sent, bus.stats.discarded, bus.stats.errors) == (1, 1, 1)
    assert bus.waiting == 0


@pytest.mark.fault("C04")
async def test_a_bus_that_is_only_busy_is_no_fault(link: Link, bus: CanBus) -> None:
    """While frames of others come, somebody acknowledges: the bus is full, no more."""
    await bus.open()
    link.full = 10_000
    sending = asyncio.create_task(bus.send(1, b"b"))
    await asyncio.sleep(0.05)

    link.received(Frame(0, b""))

    with pytest.raises(DriverStuckError, match=r"0\.1 s"):
        await sending


@pytest.mark.fault("C05")
async def test_nobody_acknowledges() -> None:
    """What the controller cannot hold is refused in time, with the likely cause."""
    bus = FakeCan("drive", send_timeout=0.1)
    await bus.open()
    loop = asyncio.get_running_loop()
    bus.acknowledge(False)

    for number in range(10):
        await bus.send(1, bytes((number,)))
    begin = loop.time()
    with pytest.raises(DeviceFaultError, match="no other node acknowledges"):
        await bus.send(1, b"x")

    assert loop.time() - begin == pytest.approx(0.1, abs=1e-6)
    assert list(bus.sent) == []
    assert bus.is_open, "the next command may find a whole bus"
    assert "acknowledges" in bus.stats.last_error
    bus.acknowledge()
    await bus.send(1, b"on")
    await bus.until(lambda frame: frame.data == b"on")
    assert [frame.data for frame in bus.sent] == [*map(bytes, zip(range(10))), b"on"]
    await bus.close()


async def test_a_frame_from_another_node_ends_the_suspicion(
    link: Link, bus: CanBus
) -> None:
    """Who speaks is there, and acknowledges."""
    await bus.open()
    link.received(Frame(0x20, bytes(8), kind=FrameKind.ERROR))
    link.full = 10_000
    sending = asyncio.create_task(bus.send(1, b"b"))
    await asyncio.sleep(0.05)

    link.received(Frame(0, b""))

    with pytest.raises(DriverStuckError):
        await sending


@pytest.mark.promise("BUS-4")
async def test_a_newer_frame_makes_a_waiting_one_obsolete_if_declared(
    link: Link, bus: CanBus
) -> None:
    """Of two commands with one id only the newer is sent; other ids are others."""
    await bus.open()
    link.full = 2
    older = asyncio.create_task(bus.send(1, b"old"))
    other = asyncio.create_task(bus.send(1, b"other", extended=True))
    await asyncio.sleep(0)
    assert bus.waiting == 2

    newer = asyncio.create_task(bus.send(1, b"new", replaces=True))
    await asyncio.gather(older, other, newer)

    assert [
        frame.data for frame in link.sent if frame.id == 1 and not frame.extended
    ] == [
        b"old",
        b"new",
    ]
    link.sent.clear()
    link.full = 2
    older = asyncio.create_task(bus.send(1, b"old", replaces=True))
    await asyncio.sleep(0)
    await bus.send(1, b"new", replaces=True)
    with pytest.raises(BusyError):
        await older
    assert [frame.data for frame in link.sent] == [b"new"]
    assert (bus.stats.refused, bus.stats.sent) == (1, 4)


@pytest.mark.promise("BUS-4")
async def test_a_frame_replaces_only_what_is_about_the_same(
    link: Link, bus: CanBus
) -> None:
    """Commands of one id for two motors: each keeps its newest, in their order."""
    await bus.open()
    link.full = 1
    sent = [
        asyncio.create_task(bus.send(1, data, replaces=(data[:1],)))
        for data in (b"a1", b"b1", b"a2", b"c1", b"a3")
    ]
    done = await asyncio.gather(*sent, return_exceptions=True)

    assert [frame.data for frame in link.sent] == [b"b1", b"c1", b"a3"]
    assert [type(each) for each in done if each is not None] == [BusyError, BusyError]
    assert isinstance(done[0], BusyError), "each sender knows what became of its frame"
    assert bus.waiting == 0


async def test_frames_of_one_id_keep_their_order(link: Link, bus: CanBus) -> None:
    """Also those that came while the first waited for room."""
    await bus.open()
    link.full = 3
    async with asyncio.TaskGroup() as group:
        for number in range(20):
            group.create_task(bus.send(1, bytes((number,))))
            await asyncio.sleep(0.0005)

    assert [frame.data[0] for frame in link.sent] == list(range(20))


async def test_a_frame_that_found_no_room_does_not_follow_a_newer_one(
    link: Link, bus: CanBus
) -> None:
    """Also where the answer of the controller takes its time."""
    send = link.send

    async def answer_late(frame: Frame, timeout: float) -> bool:
        sent = await send(frame, timeout)
        await asyncio.sleep(0.01)
        return sent

    link.send = answer_late  # type: ignore[method-assign]
    await bus.open()
    link.full = 1
    older = asyncio.create_task(bus.send(1, b"old", replaces=True))
    await asyncio.sleep(0)
    await bus.send(1, b"new", replaces=True)

    with pytest.raises(BusyError):
        await older
    assert [frame.data for frame in link.sent] == [b"new"]


@pytest.mark.promise("BUS-5", "ROB-2")
async def test_what_is_urgent_gets_the_first_room(link: Link, bus: CanBus) -> None:
    """What makes safe goes first, then an opening, then commands and polls by turns."""
    await bus.open()
    link.full = 4
    polls, commands = Urgency(), Urgency(COMMAND)
    opening, safe = Urgency(COMMAND + OPENING), Urgency(COMMAND + SAFE)
    asked = [polls, polls, commands, commands, opening, safe, polls]

    async def send(number: int, urgent: Urgency) -> None:
        urgency.set(urgent)
        await bus.send(number, b"")

    await asyncio.gather(*(send(number, each) for number, each in enumerate(asked)))

    assert [frame.id for frame in link.sent] == [5, 4, 2, 0, 3, 1, 6]


async def test_a_frame_may_become_urgent_while_it_waits(
    link: Link, bus: CanBus
) -> None:
    """Its actuator is made safe: that counts for what it has asked before, too."""
    await bus.open()
    link.full = 3
    late = Urgency(COMMAND)

    async def send(number: int, urgent: Urgency) -> None:
        urgency.set(urgent)
        await bus.send(number, b"")

    sending = asyncio.gather(send(1, Urgency()), send(2, Urgency()), send(3, late))
    await asyncio.sleep(0.001)
    with late.raised(SAFE):
        await sending

    assert [frame.id for frame in link.sent] == [3, 1, 2]


async def test_only_so_many_frames_wait(link: Link, bus: CanBus) -> None:
    """The bound is named; nothing is sent that was refused."""
    await bus.open()
    link.full = 10_000
    waiting = [asyncio.create_task(bus.send(number, b"")) for number in range(256)]
    await asyncio.sleep(0)

    with pytest.raises(BusyError, match="256"):
        await bus.send(300, b"")

    link.full = 0
    await asyncio.gather(*waiting)
    assert len(link.sent) == 256


async def test_a_cancelled_send_is_forgotten(link: Link, bus: CanBus) -> None:
    """Nothing waits for it, and it is not sent later."""
    await bus.open()
    link.full = 5
    sending = asyncio.create_task(bus.send(1, b"x"))
    await asyncio.sleep(0)

    sending.cancel()
    await asyncio.wait({sending})
    await asyncio.sleep(1)

    assert (bus.waiting, link.sent) == (0, [])


@pytest.mark.parametrize(
    ("number", "data", "extended", "fd", "field"),
    [
        (0x800, b"", False, False, "id"),
        (1 << 29, b"", True, False, "id"),
        (-1, b"", False, False, "id"),
        (1.0, b"", False, False, "id"),
        (1, bytes(9), False, False, "data"),
        (1, bytes(9), False, True, "data"),
        (1, bytes(65), False, True, "data"),
        (1, 5, False, False, "data"),
        (1, "text", False, False, "data"),
    ],
)
async def test_what_is_no_frame_is_not_sent(
    link: Link, number: Any, data: Any, extended: bool, fd: bool, field: str
) -> None:
    """The error names the part that is wrong."""
    bus = CanBus(name="drive", wire=link, fd=fd)
    await bus.open()

    with pytest.raises(BadValueError) as caught:
        await bus.send(number, data, extended=extended)

    assert caught.value.field == field
    assert link.sent == []
    await bus.close()


async def test_can_fd_carries_the_lengths_it_has(link: Link) -> None:
    """0 to 8, then 12, 16, 20, 24, 32, 48 and 64 bytes."""
    bus = CanBus(name="drive", wire=link, fd=True)
    await bus.open()
    good = []
    for length in range(66):
        try:
            await bus.send(1, bytes(length))
        except BadValueError:
            continue
        good.append(length)

    assert good == [*range(9), 12, 16, 20, 24, 32, 48, 64]
    assert [len(frame.data) for frame in link.sent] == good
    await bus.close()


async def test_a_failed_send_is_a_loss_of_the_bus() -> None:
    """The sender and everybody who listens learn of it; the node is closed."""
    bus = FakeCan("drive")
    await bus.open()
    inbox = bus.frames(1)
    bus.fail(OSError(errno.ENETDOWN, "network is down"))

    with pytest.raises(DeviceLostError, match="network is down"):
        await bus.send(1, b"")
    with pytest.raises(DeviceLostError):
        await inbox.take()
    assert not bus.is_open

    await bus.open()
    await bus.send(1, b"again")
    await bus.until(1)
    assert bus._wire._robots == [bus._outbox.link]
    await bus.close()


@pytest.mark.fault("B12")
async def test_a_behavior_that_meets_the_loss_may_end_at_once(link: Link) -> None:
    """The node is closed in any case."""

    async def close() -> None:
        await asyncio.sleep(0.1)
        link.closed += 1

    async def fail(frame: Frame, timeout: float) -> bool:
        raise OSError(errno.ENETDOWN, "network is down")

    class Once(esair.Behavior):
        async def run(self) -> None:
            with pytest.raises(DeviceLostError):
                await bus.send(1, b"")

    bus = CanBus(name="drive", wire=link)
    link.close, link.send = close, fail  # type: ignore[method-assign]
    await bus.open()
    async with esair.Robot(behaviors=[Once()]):
        await asyncio.sleep(1.0)

    assert link.closed == 1
    await bus.close()


async def test_a_frame_does_not_wait_for_a_bus_that_was_lost(
    link: Link, bus: CanBus
) -> None:
    """Not even if the bus is open again: a command must be fresh."""
    await bus.open()
    link.full = 3
    sending = asyncio.create_task(bus.send(1, b"old", timeout=10))
    await asyncio.sleep(0)
    link.gone(ConnectionError("gone"))
    other = Link()
    bus._wire = other
    await bus.open()

    with pytest.raises(DeviceLostError, match="while a frame waited"):
        await sending
    assert (link.sent, other.sent) == ([], [])
    assert bus.is_open


async def test_what_a_former_opening_reports_is_ignored(
    link: Link, bus: CanBus
) -> None:
    """A late error of a link that was replaced does not take the new one down."""
    await bus.open()
    former = link.gone
    former(ConnectionError("first"))
    await bus.open()

    former(ConnectionError("late"))

    assert bus.is_open
    assert link.closed == 1


async def test_a_bus_that_is_lost_while_it_opens_does_not_open(
    link: Link, bus: CanBus
) -> None:
    """Nobody is left with an open bus that hears nothing."""
    link.on_open = lambda: link.received(Frame(0x40, bytes(8), kind=FrameKind.ERROR))
    with pytest.raises(DeviceLostError, match="bus-off"):
        await bus.open()
    link.on_open = lambda: link.gone(ConnectionError("early"))
    with pytest.raises(DeviceLostError, match="early"):
        await bus.open()
    assert (bus.is_open, link.closed) == (False, 2)

    link.on_open = lambda: None
    await bus.open()
    await bus.send(1, b"")


async def test_a_link_that_cannot_choose_or_close_is_a_loss_and_no_more(
    link: Link, bus: CanBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interface that has just gone fails in every call; the bus opens again."""

    def fail(_keys: object) -> None:
        raise OSError(errno.ENODEV, "no such device")

    async def fail_to_close() -> None:
        raise RuntimeError("no such device")

    await bus.open()
    with monkeypatch.context() as patched:
        patched.setattr(link, "listen", fail)
        patched.setattr(link, "close", fail_to_close)
        inbox = bus.frames(1)
        with pytest.raises(DeviceLostError, match="no such device"):
            await inbox.take()
        await asyncio.sleep(0)

    assert not bus.is_open
    assert bus.stats.lost == 1
    await bus.open()
    await bus.send(1, b"")


@pytest.mark.fault("C02")
async def test_bus_off_is_told_to_everybody_and_lasts() -> None:
    """Nothing is sent until the controller was started and the bus opened again."""
    bus = FakeCan("drive")
    told: list[BaseException] = []
    states: list[CanState] = []
    bus.on_lost(told.append)
    bus.on_state(states.append)
    await bus.open()
    listening = asyncio.create_task(bus.frames(1).take())
    bus.acknowledge(False)
    await bus.send(1, b"stale")

    bus.bus_off()

    with pytest.raises(DeviceLostError, match="bus-off"):
        await listening
    for _ in range(3):
        with pytest.raises(DeviceLostError, match="not open"):
            await bus.send(1, b"no")
        with pytest.raises(DeviceLostError, match="bus-off"):
            await bus.open()
    assert bus.state is CanState.BUS_OFF
    bus.acknowledge()
    bus.restart()
    await bus.open()
    await bus.send(1, b"fresh")
    await bus.until(1)
    assert [frame.data for frame in bus.sent] == [b"fresh"]
    assert len(told) == 1
    assert states == [CanState.BUS_OFF, CanState.ACTIVE]
    await bus.close()


@pytest.mark.fault("C02")
async def test_a_controller_that_starts_again_by_itself_is_a_loss() -> None:
    """With ``restart-ms`` too a command after bus-off must be a fresh one."""
    bus = FakeCan("drive")
    await bus.open()

    bus.error_frame(0x100)
    await asyncio.sleep(0.01)

    assert not bus.is_open
    with pytest.raises(DeviceLostError):
        await bus.send(1, b"no")
    await bus.open()
    assert bus.state is CanState.ACTIVE
    await bus.close()


@pytest.mark.fault("C02")
async def test_after_bus_off_an_actuator_stays_safe_until_a_fresh_command() -> None:
    """The last frame before that is its safe command."""

    class Wheel(esair.Actuator[int]):
        bus: CanBus
        safe = 0

        async def write(self, command: int) -> None:
            await self.bus.send(0x101, bytes((command,)))

    class Go(esair.Behavior):
        wheel = esair.writes(int)

        async def run(self) -> None:
            while not bus.stats.lost:
                await self.wheel.write(9)
                await asyncio.sleep(0.05)
            await asyncio.sleep(100)

    bus = FakeCan("drive")
    async with esair.Robot(resources=[Wheel(bus=bus)], behaviors=[Go()]):
        await bus.until(lambda frame: frame.data == b"\x09")
        bus.bus_off()
        await asyncio.sleep(0.5)
        bus.sent.clear()
        bus.restart()
        while not bus.sent:  # noqa: ASYNC110 - the condition is of the fake
            await asyncio.sleep(0.01)
        await asyncio.sleep(5)
        assert {frame.data for frame in bus.sent} == {b"\x00"}
    assert bus.sent[-1].data == b"\x00"


@pytest.mark.fault("C03")
async def test_states_of_the_controller_are_events() -> None:
    """Warning and passive are told once each; everything goes on."""
    bus = FakeCan("drive")
    states: list[CanState] = []
    forget = bus.on_state(states.append)
    await bus.open()

    for state in (CanState.WARNING, CanState.WARNING, CanState.PASSIVE):
        bus.error_frame(state)
    await asyncio.sleep(0.01)

    assert states == [CanState.WARNING, CanState.PASSIVE]
    assert bus.state is CanState.PASSIVE
    assert (bus.is_open, bus.stats.lost, bus.stats.errors) == (True, 0, 3)
    assert "error-passive in sending" in bus.stats.last_error
    await bus.send(1, b"on")
    forget()
    bus.error_frame(CanState.ACTIVE)
    await asyncio.sleep(0.01)
    assert (len(states), bus.state) == (2, CanState.ACTIVE)
    await bus.close()


@pytest.mark.fault("C03")
async def test_a_bus_stops_at_the_state_it_is_told() -> None:
    """And is not opened before its controller is better."""
    bus = FakeCan("drive", lost_when="passive")
    await bus.open()

    bus.error_frame(CanState.WARNING)
    await asyncio.sleep(0.01)
    assert bus.is_open
    bus.error_frame(CanState.PASSIVE)
    bus._wire.state = CanState.PASSIVE
    await asyncio.sleep(0.01)

    assert not bus.is_open
    with pytest.raises(DeviceLostError, match="error-passive"):
        await bus.open()
    bus.restart()
    await bus.open()
    await bus.close()


async def test_a_listener_that_fails_does_not_take_the_bus_down() -> None:
    """The others are told, and the error is reported."""
    reported: list[Any] = []
    asyncio.get_running_loop().set_exception_handler(
        lambda _loop, context: reported.append(context["exception"])
    )
    bus = FakeCan("drive")
    states: list[CanState] = []

    def fail(_state: CanState) -> None:
        raise ZeroDivisionError

    bus.on_state(fail)
    bus.on_state(states.append)
    await bus.open()

    bus.error_frame(CanState.WARNING)
    await asyncio.sleep(0.01)

    assert bus.is_open
    assert states == [CanState.WARNING]
    assert [type(error) for error in reported] == [ZeroDivisionError]
    await bus.close()


async def test_frames_that_the_controller_lost_are_counted() -> None:
    """It says so in an error frame."""
    bus = FakeCan("drive")
    await bus.open()

    bus.error_frame(0x04, bytes((0, 0x01)))
    await asyncio.sleep(0.01)

    assert (bus.stats.dropped, bus.stats.errors) == (1, 1)
    assert bus.state is CanState.ACTIVE
    await bus.close()


@pytest.mark.fault("C08")
def test_nothing_here_lets_the_kernel_repeat_a_frame() -> None:
    """A cyclic frame would keep the last motion alive while this process hangs."""
    cyclic = re.compile(r"send_periodic|CAN_BCM|CyclicTask")
    found = []
    for path in Path(esair.__file__).parent.rglob("*.py"):
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if cyclic.search(text) else ():
            name = getattr(node, "attr", getattr(node, "id", ""))
            if cyclic.search(name):
                found.append((path, name))

    assert found == []
    assert not any("cycl" in name or "period" in name for name in dir(CanBus))


async def test_a_bus_that_is_described_wrongly_is_refused() -> None:
    """Nothing is opened to find out."""
    with pytest.raises(ConfigError, match="channel"):
        CanBus(name="drive")
    with pytest.raises(ConfigError, match="lost_when"):
        CanBus(name="drive", channel="can0", lost_when="never")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="bitrate_switch: only CAN FD has it"):
        CanBus(name="drive", channel="can0", bitrate_switch=True)
