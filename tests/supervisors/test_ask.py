"""`ask`: a request that is answered, and has one outcome whatever happens."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from typing import Any

import attrs
import pytest
from tests.supervisors.actors import Idle, seeds, soon

import esair
from esair.journal import Kind
from esair.supervisors import Outcome
from esair.supervisors._mediator import REQUESTS_PER_SENDER

pytestmark = pytest.mark.virtual_clock


@attrs.frozen
class Docked:
    bay: int


@attrs.frozen
class Dock(esair.Request[Docked]):
    bay: int


@dataclasses.dataclass(frozen=True)
class Charge(esair.Request[float]):
    volts: float


class Docking(esair.Behavior):
    """Takes orders in a loop; each takes a while."""

    orders = esair.takes(Dock, queue=3)
    pause = 1.0
    restart = esair.Restart(max=3, delay=0.1)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.begun: list[int] = []
        self.cut: list[int] = []

    async def run(self) -> None:
        async for request in self.orders:
            async with request:
                self.begun.append(request.bay)
                try:
                    await self.work(request)
                except asyncio.CancelledError:
                    self.cut.append(request.bay)
                    raise

    async def work(self, request: Dock) -> None:
        await asyncio.sleep(self.pause)
        request.answer(Docked(request.bay))


class Methods(esair.Behavior):
    """Answers by its methods."""

    @esair.answers
    async def dock(self, request: Dock) -> Docked:
        await asyncio.sleep(1.0)
        return Docked(request.bay)

    @esair.answers
    async def charge(self, request: Charge) -> float:
        return request.volts + 1.0


def outcomes(robot: esair.Robot) -> list[Outcome]:
    return [record.outcome for record in robot.behaviors.outcomes()]


@pytest.mark.promise("BS-8")
@pytest.mark.parametrize("worker", [Docking, Methods])
async def test_an_answer_comes_back(worker: type[esair.Behavior]) -> None:
    """Both ways to take a request give the asker its answer."""
    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, worker(name="docking")]) as robot:
        assert await a.ask("docking", Dock(2), timeout=10.0) == Docked(2)
        answer = await robot.behaviors.ask(
            Dock(3), sender="user", receiver="docking", timeout=2
        )

        assert answer == Docked(3)
        assert outcomes(robot) == [Outcome.ANSWERED] * 2


@pytest.mark.promise("BS-8")
async def test_who_takes_it_knows_who_asks_for_what() -> None:
    """A request is what was asked, and knows its sender; the asker's own knows neither."""
    seen: list[Any] = []

    class Curious(Docking):
        async def work(self, request: Dock) -> None:
            seen.append((request.data, request.sender, request.cancelled, request))
            await super().work(request)

    a, order = Idle(name="a"), Dock(2)
    async with esair.Robot(behaviors=[a, Curious(name="docking")]):
        await a.ask("docking", order)

    data, sender, cancelled, request = seen[0]
    assert data is order
    assert (sender, cancelled) == ("a", False)
    assert request == order
    with pytest.raises(esair.BadValueError, match="taken from a port"):
        order.answer(Docked(1))


@pytest.mark.promise("BS-8")
async def test_each_method_takes_one_at_a_time() -> None:
    """Two methods work at the same time, one method never twice."""
    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Methods(name="docking")]):
        begin = loop.time()
        docks = [await soon(a.ask("docking", Dock(n))) for n in range(3)]
        assert await a.ask("docking", Charge(11.0)) == 12.0
        assert loop.time() == begin
        assert await asyncio.gather(*docks) == [Docked(n) for n in range(3)]
        assert loop.time() - begin == pytest.approx(3.0, abs=0.01)


@pytest.mark.promise("BS-8")
@pytest.mark.real_clock
async def test_threads_ask_and_answer() -> None:
    """A plain run takes, answers, asks and tells of progress; its calls wait."""
    told: list[Any] = []

    class Worker(esair.Behavior):
        orders = esair.takes(Dock)

        def run(self) -> None:
            for request in self.orders:  # type: ignore[attr-defined]
                with request:
                    request.progress("near")
                    request.answer(Docked(request.bay))
                    assert request.answer(Docked(0)) is False

    class Asker(esair.Behavior):
        def run(self) -> None:
            told.append(self.ask("worker", Dock(7)))
            try:
                self.ask("worker", Charge(1.0))  # type: ignore[unused-coroutine]
            except esair.RefusedError as error:
                told.append(error.behavior)

    async with esair.Robot(behaviors=[Worker(), Asker()]) as robot:
        for _ in range(500):
            if len(told) == 2:
                break
            await asyncio.sleep(0.01)
        assert told == [Docked(7), "worker"]
        assert robot.journal.counts()["behaviors"]["late_answers"] == 1


@pytest.mark.promise("BS-8")
async def test_plain_methods_answer_on_a_thread() -> None:
    """A plain method may block."""

    class Plain(esair.Behavior):
        @esair.answers
        def charge(self, request: Charge) -> float:
            return request.volts * 2

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Plain(name="b")]):
        assert await a.ask("b", Charge(6.0)) == 12.0


@pytest.mark.promise("BS-8", "BS-11")
async def test_the_newest_progress_wins() -> None:
    """The asker is told of the newest only, and a slow asker holds nobody up."""
    told: list[int] = []

    class Telling(Docking):
        async def work(self, request: Dock) -> None:
            for n in range(10):
                request.progress(n)
            await asyncio.sleep(1.0)
            request.progress(10)
            request.answer(Docked(1))
            assert request.progress(11) is False

    async def slowly(value: int) -> None:
        told.append(value)
        await asyncio.sleep(0.5)

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Telling(name="docking")]):
        begin = loop.time()
        assert await a.ask("docking", Dock(1), progress=told.append) == Docked(1)
        assert loop.time() - begin == pytest.approx(1.0, abs=0.01)
        assert told == [9, 10]
        told.clear()
        await a.ask("docking", Dock(1), progress=slowly)
        assert told == [9, 10]


@pytest.mark.promise("BS-10")
@pytest.mark.parametrize("receiver", ["nobody", "reflex"])
async def test_only_a_behavior_can_be_asked(receiver: str) -> None:
    """A name that nobody has, or a reaction has, is unknown."""

    class Reflex(esair.Reaction):
        rate = 1.0

        def react(self) -> None: ...

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Reflex()]):
        with pytest.raises(esair.UnknownNameError):
            await a.ask(receiver, Dock(1))


@pytest.mark.promise("BS-10")
async def test_a_type_that_nobody_takes_is_refused_at_once() -> None:
    """The error names what the other takes."""
    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Docking()]) as robot:
        begin = loop.time()
        with pytest.raises(esair.RefusedError, match=r"docking.*no Charge.*Dock"):
            await a.ask("docking", Charge(1.0))
        with pytest.raises(esair.RefusedError, match="takes no requests"):
            await a.ask("a", Charge(1.0))
        assert loop.time() == begin
        assert outcomes(robot) == [Outcome.REFUSED] * 2


@pytest.mark.promise("BS-10")
@pytest.mark.parametrize("timeout", [0, -1.0, "1", True, float("nan")])
async def test_nonsense_is_refused(timeout: Any) -> None:
    """A timeout is seconds or None; a request is a Request; progress goes to a function."""
    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Docking()]) as robot:
        with pytest.raises(esair.BadValueError, match="timeout"):
            await a.ask("docking", Dock(1), timeout=timeout)
        with pytest.raises(esair.BadValueError, match=r"esair\.Request"):
            await a.ask("docking", 17)  # type: ignore[arg-type]
        with pytest.raises(esair.BadValueError, match="progress: expected a function"):
            await a.ask("docking", Dock(1), progress="tell me")  # type: ignore[arg-type]
        assert robot._behaviors.mediator.pending == 0


@pytest.mark.promise("BS-10")
async def test_a_refusal_gives_its_reason() -> None:
    """By the request itself, or by an error of a method."""

    class Full(Docking):
        async def work(self, request: Dock) -> None:
            assert request.refuse("full")

    class Raises(Methods):
        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            raise esair.RefusedError("full")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Full(name="b"), Raises(name="c")]) as robot:
        for name in ("b", "c"):
            with pytest.raises(esair.RefusedError) as caught:
                await a.ask(name, Dock(1))
            assert (caught.value.reason, caught.value.behavior) == ("full", name)
            state = robot.behaviors.query(name).state
            assert state is esair.BehaviorState.RUNNING


@pytest.mark.promise("BS-10")
async def test_an_error_that_leaves_the_block_fails_the_request_at_once() -> None:
    """Also while the clean-up still runs; the next run takes the next request."""

    class Breaks(Docking):
        async def work(self, request: Dock) -> None:
            if request.bay == 1:
                raise LookupError("no bay")
            await super().work(request)

        async def teardown(self) -> None:
            await asyncio.sleep(5.0)

    a = Idle(name="a")
    worker = Breaks(name="docking")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, worker], grace=0.1) as robot:
        begin = loop.time()
        second = asyncio.ensure_future(a.ask("docking", Dock(2)))
        first = asyncio.ensure_future(a.ask("docking", Dock(1)))
        with pytest.raises(esair.BehaviorFailedError, match="no bay") as caught:
            await first
        assert isinstance(caught.value.__cause__, LookupError)
        assert loop.time() - begin == pytest.approx(1.0, abs=0.01)
        third = await soon(a.ask("docking", Dock(3)))
        assert await second == Docked(2)
        assert await third == Docked(3)
        assert worker.begun == [2, 1, 3]
        assert robot.behaviors.query("docking").restarts == 1


@pytest.mark.promise("BS-10")
async def test_an_error_outside_a_block_fails_the_request_before_the_clean_up() -> None:
    """Without a block the end of the run fails it."""

    class Breaks(Docking):
        async def run(self) -> None:
            async for request in self.orders:
                raise LookupError(request.bay)

        async def teardown(self) -> None:
            await asyncio.sleep(5.0)

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Breaks(name="docking")], grace=0.1):
        with pytest.raises(esair.BehaviorFailedError, match="LookupError"):
            await a.ask("docking", Dock(1))
        assert loop.time() == 0.0


@pytest.mark.promise("BS-10")
async def test_a_failing_method_fails_its_request_only() -> None:
    """The behavior goes on, as after a failing provide."""

    class Breaks(Methods):
        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            raise LookupError("no bay")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Breaks(name="b")]) as robot:
        with pytest.raises(esair.BehaviorFailedError, match="no bay"):
            await a.ask("b", Dock(1))
        assert robot.behaviors.query("b").state is esair.BehaviorState.RUNNING
        assert await a.ask("b", Charge(1.0)) == 2.0


@pytest.mark.promise("BS-10")
@pytest.mark.parametrize("block", [True, False])
async def test_going_on_without_an_answer_fails_the_request(block: bool) -> None:
    """Leaving the block, or asking for the next one, is the end of it."""

    class Forgets(Docking):
        async def run(self) -> None:
            async for request in self.orders:
                if block:
                    async with request:
                        pass
                await asyncio.sleep(0.0 if not block else 9.0)

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Forgets(name="docking")]):
        with pytest.raises(esair.BehaviorFailedError, match="without an answer"):
            await a.ask("docking", Dock(1))
        assert loop.time() == 0.0


@pytest.mark.promise("BS-10")
async def test_a_run_that_ends_fails_what_it_had_and_what_waits() -> None:
    """FINISHED holds nothing: later requests fail at once."""

    class Once(Docking):
        async def run(self) -> None:
            async for _ in self.orders:
                await asyncio.sleep(1.0)
                return

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Once(name="docking")]) as robot:
        asks = [await soon(a.ask("docking", Dock(n))) for n in range(2)]
        for ask in asks:
            with pytest.raises(esair.BehaviorFailedError, match="run"):
                await ask
        assert loop.time() == pytest.approx(1.0, abs=0.01)
        assert robot.behaviors.query("docking").state is esair.BehaviorState.FINISHED
        with pytest.raises(esair.BehaviorFailedError, match="its run has ended"):
            await a.ask("docking", Dock(3))
        assert robot._behaviors.mediator.pending == 0


@pytest.mark.promise("BS-10")
async def test_one_that_has_failed_for_good_fails_what_waits() -> None:
    """Nobody waits for what will not come back."""

    class Breaks(Docking):
        restart = esair.Restart(max=0)

        async def work(self, request: Dock) -> None:
            await asyncio.sleep(1.0)
            raise LookupError("no bay")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Breaks(name="docking")]):
        asks = [await soon(a.ask("docking", Dock(n))) for n in range(2)]
        for ask in asks:
            with pytest.raises(esair.BehaviorFailedError, match="no bay"):
                await ask
        with pytest.raises(esair.BehaviorFailedError, match="no bay"):
            await a.ask("docking", Dock(9))


@pytest.mark.promise("BS-10")
async def test_a_removal_ends_what_waits_and_what_is_worked_on_at_once() -> None:
    """Whatever the worker does with its cancellation."""

    class Stubborn(Docking):
        async def work(self, request: Dock) -> None:
            try:
                await asyncio.sleep(9.0)
            except asyncio.CancelledError:
                await asyncio.sleep(9.0)

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Stubborn(name="docking")], grace=0.3) as robot:
        asks = [await soon(a.ask("docking", Dock(n))) for n in range(2)]
        removing = await soon(robot.behaviors.remove("docking"))
        for ask in asks:
            with pytest.raises(esair.BehaviorRemovedError):
                await ask
        with pytest.raises((esair.BehaviorRemovedError, esair.UnknownNameError)):
            await a.ask("docking", Dock(9))
        assert loop.time() == 0.0
        await removing


@pytest.mark.promise("BS-10")
async def test_what_was_not_taken_goes_on_to_the_replacement() -> None:
    """What was being worked on is never given twice."""
    a, old, new = Idle(name="a"), Docking(name="docking"), Docking()
    async with esair.Robot(behaviors=[a, old]) as robot:
        asks = [await soon(a.ask("docking", Dock(n))) for n in range(2)]
        await robot.behaviors.replace("docking", new)
        with pytest.raises(esair.BehaviorRemovedError):
            await asks[0]
        assert await asks[1] == Docked(1)
        assert (old.begun, new.begun) == ([0], [1])


@pytest.mark.promise("BS-10")
async def test_a_replacement_that_does_not_take_it_refuses_what_waits() -> None:
    """Nobody waits for one who will never take it."""
    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Docking()]) as robot:
        asks = [await soon(a.ask("docking", Dock(n))) for n in range(2)]
        await robot.behaviors.replace("docking", Idle())
        with pytest.raises(esair.BehaviorRemovedError):
            await asks[0]
        with pytest.raises(esair.RefusedError, match="was replaced"):
            await asks[1]


@pytest.mark.promise("BS-10", "BS-11")
async def test_the_timeout_counts_waiting_and_work_together() -> None:
    """One that waits is never seen, one that is worked on is cut; the loop goes on."""
    a, worker = Idle(name="a"), Docking()
    worker.pause = 3.0
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, worker]):
        first = await soon(a.ask("docking", Dock(1), timeout=2.0))
        never = await soon(a.ask("docking", Dock(2), timeout=1.0))
        third = await soon(a.ask("docking", Dock(3), timeout=None))
        with pytest.raises(esair.BehaviorUnavailableError, match="answer for 1 s"):
            await never
        with pytest.raises(TimeoutError):
            await first
        assert loop.time() == pytest.approx(2.0, abs=0.01)
        assert await third == Docked(3)
        assert loop.time() == pytest.approx(5.0, abs=0.01)
        assert (worker.begun, worker.cut) == ([1, 3], [1])


@pytest.mark.promise("BS-10", "BS-7")
async def test_requests_are_bounded() -> None:
    """Those that wait at a worker, and those of one asker."""
    a, worker = Idle(name="a"), Docking()
    async with esair.Robot(
        behaviors=[a, worker, *(Docking(name=f"d{n}") for n in range(5))]
    ) as robot:
        asks = [await soon(a.ask("docking", Dock(n))) for n in range(4)]
        with pytest.raises(esair.BusyError, match="queue of Dock"):
            await a.ask("docking", Dock(9))
        asks += [
            await soon(a.ask(f"d{n // 4}", Dock(n)))
            for n in range(REQUESTS_PER_SENDER - 4)
        ]
        with pytest.raises(esair.BusyError, match="number of its requests"):
            await a.ask("d4", Dock(9))
        await asyncio.gather(*asks)
        assert robot._behaviors.mediator.pending == 0


@pytest.mark.promise("BS-10")
async def test_a_new_request_supersedes_those_before_it() -> None:
    """With newest=True only the last one counts, also over the one in work."""

    class Newest(Docking):
        orders = esair.takes(Dock, newest=True)

    a, b, worker = Idle(name="a"), Idle(name="captain"), Newest(name="docking")
    async with esair.Robot(behaviors=[a, b, worker]):
        first = await soon(a.ask("docking", Dock(1)))
        second = asyncio.ensure_future(a.ask("docking", Dock(2)))
        third = asyncio.ensure_future(b.ask("docking", Dock(3)))
        for old in (first, second):
            with pytest.raises(esair.RefusedError, match="superseded by"):
                await old
        assert await third == Docked(3)
        assert (worker.begun, worker.cut) == ([1, 3], [1])


@pytest.mark.promise("BS-11")
@pytest.mark.parametrize("worker", [Docking, Methods])
@pytest.mark.parametrize("seed", seeds)
async def test_an_asker_that_is_cancelled_withdraws(worker: Any, seed: int) -> None:
    """The work on its request is cancelled, once, and the next one is served."""
    a, b = Idle(name="a"), worker(name="b")
    async with esair.Robot(behaviors=[a, b]) as robot:
        working = await soon(a.ask("b", Dock(1)))
        waiting = await soon(a.ask("b", Dock(2)))
        other = await soon(a.ask("b", Dock(3)))
        began = asyncio.get_running_loop().time()
        for each in (working, waiting):
            each.cancel()
        assert await other == Docked(3)
        assert asyncio.get_running_loop().time() - began == pytest.approx(1.0)
        assert robot.behaviors.query("b").restarts == 0
        assert sorted(o.name for o in outcomes(robot)) == [
            "ANSWERED",
            "WITHDRAWN",
            "WITHDRAWN",
        ]
        if worker is Docking:
            assert (b.begun, b.cut) == ([1, 3], [1])


@pytest.mark.promise("BS-11")
@pytest.mark.parametrize("end", ["remove", "crash", "finish"])
async def test_an_asker_that_ends_withdraws(end: str) -> None:
    """Whatever task made the request, even one that is not the asker's own."""
    go = asyncio.Event()

    class Asker(esair.Behavior):
        restart = esair.Restart(max=1)

        async def run(self) -> None:
            await go.wait()
            go.clear()
            if end == "crash":
                raise RuntimeError("told to")

    a, worker = Asker(name="a"), Docking()
    worker.pause = 60.0
    async with esair.Robot(behaviors=[a, worker]) as robot:
        ask = await soon(a.ask("docking", Dock(1), timeout=None))
        if end == "remove":
            await robot.behaviors.remove("a")
        else:
            go.set()
        with pytest.raises((esair.BehaviorRemovedError, esair.NotRegisteredError)):
            await ask
        await asyncio.sleep(0.0)
        assert worker.cut == [1]
        worker.pause = 0.1
        user = robot.behaviors.ask(Dock(2), sender="user", receiver="docking")
        assert await user == Docked(2)


@pytest.mark.promise("BS-11")
async def test_without_a_block_the_request_tells_that_it_was_withdrawn() -> None:
    """An answer that comes then is refused, and counted."""
    seen: list[bool] = []

    class Polite(Docking):
        async def run(self) -> None:
            async for request in self.orders:
                async for _ in esair.every(0.1):
                    if request.cancelled:
                        break
                seen.append(request.answer(Docked(1)))

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Polite(name="docking")]) as robot:
        with pytest.raises(esair.BehaviorUnavailableError):
            await a.ask("docking", Dock(1), timeout=0.5)
        await asyncio.sleep(0.2)
        assert seen == [False]
        assert robot.journal.counts()["behaviors"]["late_answers"] == 1


@pytest.mark.promise("BS-11")
async def test_a_worker_that_swallows_its_end_delays_only_the_next() -> None:
    """Its cancellation is not left behind in its task."""
    left: list[int] = []

    class Swallows(Docking):
        async def run(self) -> None:
            async for request in self.orders:
                async with request:
                    try:
                        await asyncio.sleep(1.0)
                    except asyncio.CancelledError:
                        await asyncio.sleep(1.0)
                    request.answer(Docked(request.bay))
                left.append(asyncio.current_task().cancelling())

    a = Idle(name="a")
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, Swallows(name="docking")]):
        first = await soon(a.ask("docking", Dock(1)))
        second = await soon(a.ask("docking", Dock(2)))
        await asyncio.sleep(0.5)
        first.cancel()
        assert await second == Docked(2)
        assert loop.time() == pytest.approx(2.5, abs=0.01)
        assert left == [0, 0]


@pytest.mark.promise("BS-11", "SUP-3")
async def test_a_withdrawal_does_not_hide_a_removal() -> None:
    """Cancelled twice in the same moment, the worker ends."""
    a, worker = Idle(name="a"), Docking()
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=[a, worker]) as robot:
        ask = await soon(a.ask("docking", Dock(1)))
        ask.cancel()
        await robot.behaviors.remove("docking")
        assert loop.time() == 0.0
        assert robot._behaviors.zombie_count == 0


@pytest.mark.promise("BS-11")
async def test_a_worker_may_end_its_own_asker() -> None:
    """What it does itself cancels it where it waits next, and no later."""

    class Mutiny(Docking):
        captain: asyncio.Task[Any]

        async def work(self, request: Dock) -> None:
            self.captain.cancel()
            await asyncio.sleep(0)
            await super().work(request)

    a, worker = Idle(name="a"), Mutiny(name="docking")
    async with esair.Robot(behaviors=[a, worker]):
        worker.captain = asyncio.ensure_future(a.ask("docking", Dock(1)))
        await asyncio.wait({worker.captain})
        assert worker.cut == [1]
        worker.captain = asyncio.ensure_future(asyncio.sleep(9.0))
        other = await soon(a.ask("docking", Dock(2)))
        assert await other == Docked(2)


@pytest.mark.promise("BS-10")
async def test_the_stop_ends_every_request() -> None:
    """Those that wait, those in work, and those that come later."""
    robot = esair.Robot(behaviors=[Docking()], grace=0.1)
    async with robot:
        asks = [
            await soon(robot.behaviors.ask(Dock(n), sender="user", receiver="docking"))
            for n in range(2)
        ]
    for ask in asks:
        with pytest.raises(esair.StoppingError):
            await ask
    with pytest.raises(esair.StoppingError):
        await robot.behaviors.ask(Dock(1), sender="user", receiver="docking")


@pytest.mark.promise("BS-5")
@pytest.mark.parametrize("child", [False, True])
@pytest.mark.parametrize("names", ["ab", "abc", "abcd"])
async def test_a_circle_of_ask_is_refused_at_once(names: str, child: bool) -> None:
    """The path is in order, also if a child task of the one that serves asks back."""

    class Asks(Methods):
        other = ""

        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            ask = self.ask(self.other, request)
            return await (asyncio.ensure_future(ask) if child else ask)

    members = [Asks(name=name) for name in names]
    for member, other in zip(members, [*names[1:], "a"], strict=True):
        member.other = other
    loop = asyncio.get_running_loop()
    async with esair.Robot(behaviors=members) as robot:
        with pytest.raises(esair.BehaviorFailedError) as caught:
            await robot.behaviors.ask(Dock(1), sender="user", receiver="a")
        inner: BaseException | None = caught.value
        while isinstance(inner, esair.BehaviorFailedError):
            inner = inner.__cause__
        assert isinstance(inner, esair.CircularRequestError)
        assert inner.path == (*names, "a")
        assert loop.time() == 0.0


@pytest.mark.promise("BS-5")
@pytest.mark.real_clock
async def test_a_circle_through_threads_is_refused_at_once() -> None:
    """The chain goes through a plain run, and through its calls."""

    class Asks(esair.Behavior):
        orders = esair.takes(Dock)
        other = ""

        def run(self) -> None:
            for request in self.orders:  # type: ignore[attr-defined]
                with request:
                    try:
                        request.answer(self.ask(self.other, Dock(0)))  # type: ignore[arg-type]
                    except esair.EsairError as error:
                        request.refuse(str(error))

    a, b = Asks(name="a"), Asks(name="b")
    a.other, b.other = "b", "a"
    async with esair.Robot(behaviors=[a, b]) as robot:
        with pytest.raises(esair.RefusedError, match="a -> b -> a"):
            await robot.behaviors.ask(Dock(1), sender="user", receiver="a", timeout=5.0)


@pytest.mark.promise("BS-5")
async def test_a_peer_with_a_free_loop_may_be_asked_back() -> None:
    """Only a request that would wait for itself is refused."""

    class Battery(esair.Behavior):
        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            volts = await self.ask("charger", Charge(1.0))
            return Docked(round(volts))

        @esair.answers
        async def charge(self, request: Charge) -> float:
            return request.volts

    class Charger(esair.Behavior):
        @esair.answers
        async def charge(self, request: Charge) -> float:
            return 1.0 + await self.ask("battery", request)

    async with esair.Robot(behaviors=[Battery(), Charger()]) as robot:
        asked = robot.behaviors.ask(Dock(1), sender="user", receiver="battery")
        assert await asked == Docked(2)


@pytest.mark.promise("BS-5")
async def test_a_second_loop_of_the_same_type_may_be_asked_back() -> None:
    """Two tasks that take the same requests are two loops; with both busy it is refused."""

    class Twice(esair.Behavior):
        orders = esair.takes(Dock)
        depth = 1

        async def run(self) -> None:
            await asyncio.gather(self.take(), self.take())

        async def take(self) -> None:
            async for request in self.orders:
                async with request:
                    if request.bay >= self.depth:
                        request.answer(Docked(request.bay))
                        continue
                    try:
                        request.answer(await self.ask("twice", Dock(request.bay + 1)))
                    except esair.CircularRequestError as error:
                        request.refuse("; ".join(error.path))

    worker = Twice()
    async with esair.Robot(behaviors=[worker]) as robot:
        ask = robot.behaviors.ask
        assert await ask(Dock(0), sender="user", receiver="twice") == Docked(1)
        worker.depth = 2
        with pytest.raises(esair.BehaviorFailedError, match="twice; twice"):
            await ask(Dock(0), sender="user", receiver="twice", timeout=1.0)


@pytest.mark.promise("BS-5")
async def test_one_that_waits_for_an_answer_cannot_begin_a_loop() -> None:
    """Its only task waits for the one that asks it: nobody would ever answer."""
    told: list[Any] = []

    class First(esair.Behavior):
        orders = esair.takes(Dock)

        async def run(self) -> None:
            told.append(await self.ask("second", Charge(1.0)))

    class Second(esair.Behavior):
        @esair.answers
        async def charge(self, request: Charge) -> float:
            try:
                await self.ask("first", Dock(1))
            except esair.CircularRequestError as error:
                told.append(error.path)
            return 5.0

    async with esair.Robot(behaviors=[Second(), First()]):
        await asyncio.sleep(0.1)
        assert told == [("first", "second", "first"), 5.0]


@pytest.mark.promise("BS-5")
@pytest.mark.parametrize("child", [False, True])
async def test_one_that_asks_itself_needs_somebody_free(child: bool) -> None:
    """Its only task would wait for itself; a task of its own may take the request."""
    told: list[Any] = []

    class Itself(esair.Behavior):
        orders = esair.takes(Dock)

        async def run(self) -> None:
            taking = asyncio.ensure_future(self.take()) if child else None
            try:
                told.append(await self.ask("itself", Dock(1)))
            except esair.CircularRequestError as error:
                told.append(error.path)
            if taking is not None:
                taking.cancel()

        async def take(self) -> None:
            async for request in self.orders:
                request.answer(Docked(request.bay))

    async with esair.Robot(behaviors=[Itself()]) as robot:
        await asyncio.sleep(0.1)
        assert told == ([Docked(1)] if child else [("itself", "itself")])
        last = robot.behaviors.outcomes()[-1]
        assert last.outcome is (Outcome.ANSWERED if child else Outcome.REFUSED)


@pytest.mark.promise("BS-11")
async def test_who_enters_a_withdrawn_request_is_cancelled_in_its_block() -> None:
    """Taken from the queue, but not begun with, when its asker went."""
    seen: list[str] = []

    class Late(Docking):
        async def run(self) -> None:
            async for request in self.orders:
                await asyncio.sleep(1.0)
                async with request:
                    seen.append("begun")
                    await asyncio.sleep(1.0)
                    seen.append("done")
                seen.append("on")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Late(name="docking")]):
        asking = await soon(a.ask("docking", Dock(1)))
        await asyncio.sleep(0.5)
        asking.cancel()
        await asyncio.sleep(2.0)
        assert seen == ["begun", "on"]


@pytest.mark.promise("BS-11")
async def test_who_ends_its_own_asker_and_leaves_at_once_is_not_cancelled() -> None:
    """It has not waited for anything since."""
    seen: list[int] = []

    class Mutiny(Docking):
        captain: asyncio.Task[Any]

        async def run(self) -> None:
            async for request in self.orders:
                async with request:
                    await robot.behaviors.remove("a")
                task = asyncio.current_task()
                assert task is not None
                seen.append(task.cancelling())
                await asyncio.sleep(0.1)
                seen.append(request.bay)

    a, worker = Idle(name="a"), Mutiny(name="docking")
    async with esair.Robot(behaviors=[a, worker]) as robot:
        asking = await soon(a.ask("docking", Dock(1)))
        await asyncio.gather(asking, return_exceptions=True)
        await asyncio.sleep(2.0)
        assert seen == [0, 1]


@pytest.mark.promise("BS-8")
@pytest.mark.parametrize("fails", [True, False])
async def test_a_method_that_fails_when_nobody_waits_says_so_in_the_log(
    fails: bool, caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever asked has gone; that it was cancelled for that is no failure."""

    class Stubborn(esair.Behavior):
        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            try:
                await asyncio.sleep(1.0)
            except asyncio.CancelledError:
                if fails:
                    raise RuntimeError("the gate jams") from None
                raise
            return Docked(1)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Stubborn(name="docking")]):
        with pytest.raises(esair.BehaviorUnavailableError):
            await a.ask("docking", Dock(1), timeout=0.5)
        await asyncio.sleep(0.1)
    told = [r.getMessage() for r in caplog.records if "nobody waited" in r.getMessage()]
    assert len(told) == fails
    assert all("the gate jams" in each for each in told)


@pytest.mark.promise("BS-5")
async def test_what_outlives_its_request_waits_for_nobody() -> None:
    """A child task that goes on after the answer may ask the asker."""
    told: list[Any] = []

    class Peer(esair.Behavior):
        other = ""

        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            if request.bay:
                self.later = asyncio.ensure_future(self.back())
                await asyncio.sleep(0)
            return Docked(request.bay)

        async def back(self) -> None:
            await asyncio.sleep(1.0)
            told.append(await self.ask(self.other, Dock(0)))

    a, b = Peer(name="a"), Peer(name="b")
    a.other = b.other = "a"
    async with esair.Robot(behaviors=[a, b]) as robot:
        await robot.behaviors.ask(Dock(1), sender="user", receiver="a")
        await asyncio.sleep(2.0)
        assert told == [Docked(0)]


@pytest.mark.promise("BS-8")
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ({"orders": esair.takes(int)}, "derived from esair.Request"),  # type: ignore[type-var]
        ({"orders": esair.takes(Dock, queue=0)}, "queue of 1 or more"),
        ({"orders": esair.takes(Dock, newest=1)}, "newest"),  # type: ignore[arg-type]
        ({"one": esair.takes(Dock), "two": esair.takes(Dock)}, "taken by 'one'"),
    ],
)
async def test_mistakes_in_what_is_taken_stop_the_start(
    body: dict[str, Any], message: str
) -> None:
    """Each is named with behavior and field."""
    wrong = type("Wrong", (esair.Behavior,), body)
    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(behaviors=[wrong()]):
            pass
    (error,) = caught.value.exceptions
    assert isinstance(error, esair.ConfigError)
    assert error.component == "wrong"
    assert message in str(error)


@pytest.mark.promise("BS-8")
async def test_mistakes_in_methods_stop_the_start() -> None:
    """Type checkers cannot compare what a method returns with its request's answer."""

    class Wrong(esair.Behavior):
        @esair.answers
        async def dock(self, request: Dock) -> str:
            return ""

        @esair.answers  # type: ignore[type-var]
        async def number(self, request: int) -> int:
            return 1

    with pytest.raises(ExceptionGroup) as caught:
        async with esair.Robot(behaviors=[Wrong()]):
            pass
    first, second = map(str, caught.value.exceptions)
    assert "wrong: dock: it returns str, but Dock is answered with Docked" in first
    assert "wrong: number: expected one parameter" in second


@pytest.mark.promise("BS-8")
def test_names_of_a_request_are_its_own() -> None:
    """A field that would hide what its taker needs is refused where it is written."""
    with pytest.raises(esair.ConfigError, match="sender"):

        @attrs.frozen
        class Wrong(esair.Request[None]):
            sender: str  # type: ignore[assignment]


@pytest.mark.promise("BS-8")
async def test_a_request_may_be_handed_on() -> None:
    """What was taken from one may be asked of another; each has an outcome of its own."""

    class Middle(esair.Behavior):
        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            return await self.ask("docking", request)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Middle(), Docking()]) as robot:
        assert await a.ask("middle", Dock(4)) == Docked(4)
        assert outcomes(robot) == [Outcome.ANSWERED] * 2


@pytest.mark.promise("BS-7", "BS-10")
@pytest.mark.parametrize("ends", ["goes on", "crashes"])
async def test_nothing_is_kept_of_what_is_over(ends: str) -> None:
    """A loop without blocks, and a run that ends, leave no request behind."""

    class Bare(Docking):
        async def run(self) -> None:
            async for request in self.orders:
                request.answer(Docked(request.bay))
                if ends == "crashes":
                    raise RuntimeError("told to")

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Bare(name="docking")]) as robot:
        (queue,) = robot._behaviors.members["docking"].mail.queues.values()
        for number in range(3):
            await a.ask("docking", Dock(number))
        await asyncio.sleep(1.0)
        assert len(queue.working) <= (1 if ends == "goes on" else 0)
        assert not queue.count


@pytest.mark.promise("BS-9")
async def test_nobody_works_on_a_request_whose_block_was_left() -> None:
    """Also if its loop was left with it: one loop for each request, again and again."""

    class Once(Docking):
        async def run(self) -> None:
            while True:
                async for request in self.orders:
                    async with request:
                        request.answer(Docked(request.bay))
                    break

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Once(name="docking")]) as robot:
        for number in range(3):
            await a.ask("docking", Dock(number))
        assert robot.behaviors.query("docking").working == 0


@pytest.mark.promise("BS-5")
async def test_a_request_within_a_request_is_part_of_the_chain() -> None:
    """Who has served one within another serves the outer one still."""
    told: list[Any] = []

    class Outer(esair.Behavior):
        inner = esair.takes(Charge)

        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            async for charge in self.inner:
                async with charge:
                    charge.answer(1.0)
                break
            try:
                await self.ask("outer", Dock(9), timeout=1.0)
            except esair.CircularRequestError as error:
                told.append(error.path)
            return Docked(1)

    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Outer()]):
        dock = await soon(a.ask("outer", Dock(1)))
        await a.ask("outer", Charge(1.0))
        assert await dock == Docked(1)
        assert told == [("outer", "outer")]


@pytest.mark.promise("TURN-5")
async def test_the_journal_has_every_request_and_its_outcome() -> None:
    """Asked once, answered once, also where the answer is an error or nothing."""
    heard: list[Any] = []
    a = Idle(name="a")
    async with esair.Robot(behaviors=[a, Docking()]) as robot:
        robot.journal.listen(heard.append)
        await a.ask("docking", Dock(2))
        with pytest.raises(TimeoutError):
            await a.ask("docking", Dock(3), timeout=0.1)
        await asyncio.sleep(0.1)

    told = [
        (event.kind, event.component, event.peer, event.value, event.text)
        for event in heard
        if event.kind in {Kind.ASKED, Kind.ANSWERED}
    ]
    assert told[:3] == [
        (Kind.ASKED, "docking", "a", Dock(2), ""),
        (Kind.ANSWERED, "docking", "a", Docked(2), "answered"),
        (Kind.ASKED, "docking", "a", Dock(3), ""),
    ]
    assert isinstance(told[3][3], esair.BehaviorUnavailableError)
    assert len(told) == 4


@pytest.mark.promise("BS-7", "BS-11")
async def test_who_gives_up_waiting_for_a_request_leaves_nothing() -> None:
    """However often it looks whether there is one."""

    class Glance(Docking):
        async def run(self) -> None:
            for _ in range(50):
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(0.01):
                        async for _ in self.orders:
                            pytest.fail("nobody has asked")
            await asyncio.sleep(1000.0)

    async with esair.Robot(behaviors=[Glance(name="docking")]) as robot:
        await asyncio.sleep(1.0)
        (queue,) = robot._behaviors.members["docking"].mail.queues.values()
        assert queue._takers == []


@pytest.mark.promise("BS-8")
@pytest.mark.parametrize("how", ["method", "loop"])
async def test_an_answer_of_a_wrong_type_is_the_workers_mistake(how: str) -> None:
    """It is checked like a reading: its asker never gets it as what it is typed."""

    class Wrong(Methods):
        @esair.answers
        async def dock(self, request: Dock) -> Docked:
            return 3  # type: ignore[return-value]

    class Loop(Docking):
        async def run(self) -> None:
            async for request in self.orders:
                async with request:
                    request.answer(3)  # type: ignore[arg-type]

    a = Idle(name="a")
    worker = Wrong(name="b") if how == "method" else Loop(name="b")
    async with esair.Robot(behaviors=[a, worker]):
        with pytest.raises(esair.BehaviorFailedError, match="expected Docked, not 3"):
            await a.ask("b", Dock(1), timeout=5.0)


@pytest.mark.promise("BS-8")
@pytest.mark.parametrize("given_up", [False, True])
async def test_a_request_that_did_not_reach_who_took_it_is_the_first_again(
    given_up: bool,
) -> None:
    """Unless nobody waits for its answer any more."""

    class Taker(Idle):
        orders = esair.takes(Dock)

    taker = Taker(name="taker")
    a, b = Idle(name="a"), Idle(name="b")
    async with esair.Robot(behaviors=[a, b, taker]):
        asks = [await soon(each.ask("taker", Dock(n))) for n, each in enumerate((a, b))]
        loop = aiter(taker.orders)
        assert (await anext(loop)).bay == 0
        if given_up:
            asks[0].cancel()
            await asyncio.wait({asks[0]})
        loop.put_back()
        bays = []
        for _ in range(2 - given_up):
            request = await anext(loop)
            bays.append(request.bay)
            request.answer(Docked(request.bay))
        assert bays == [0, 1][given_up:]
        assert await asks[1] == Docked(1)


@pytest.mark.promise("BS-11")
async def test_a_worker_that_went_on_when_it_was_cancelled_loses_one_request_only() -> (
    None
):
    """What a withdrawal cancels is the body, whatever the worker was told before."""

    class Went(Docking):
        async def run(self) -> None:
            task = asyncio.current_task()
            assert task is not None
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.sleep(0)
            await super().run()

    docking, captain = Went(name="docking"), Idle(name="captain")
    async with esair.Robot(behaviors=[docking, captain]) as robot:
        with pytest.raises(esair.BehaviorUnavailableError):
            await captain.ask("docking", Dock(1), timeout=0.5)
        assert await captain.ask("docking", Dock(2), timeout=5.0) == Docked(2)
        assert docking.cut == [1]
        assert robot.behaviors.query("docking").restarts == 0
