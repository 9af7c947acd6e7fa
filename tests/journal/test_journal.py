"""The journal: one order of events, listeners that harm nobody, all counters."""

import asyncio
import logging
import subprocess
import sys
import threading
import time
from collections.abc import Callable

import pytest

import esair
from esair.journal import BACKLOG, SLICE, Event, Journal, Kind

pytestmark = [pytest.mark.promise("TURN-5"), pytest.mark.virtual_clock]


class Wander(esair.Behavior):
    """Drives on."""

    wheels = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.05):
            await self.wheels.write(0.3)


class Greet(esair.Behavior):
    """Hands something to another behavior."""

    async def run(self) -> None:
        await self.put("guest", "hello")


class Guest(esair.Behavior):
    """Takes what it is given."""

    async def run(self) -> None:
        await self.receive()
        await asyncio.Event().wait()


def of(events: list[Event], kind: Kind) -> list[Event]:
    return [event for event in events if event.kind is kind]


async def test_a_command_is_told_from_asking_to_applied(fake_actuator):
    """Asked, sent and applied are three events of one write, in this order."""
    events: list[Event] = []
    wheels = fake_actuator("wheels", safe=0.0)
    robot = esair.Robot(resources=[wheels], behaviors=[Wander()])
    robot.journal.listen(events.append)
    async with robot:
        await wheels.until(0.3, timeout=1.0)
        await asyncio.sleep(0.0)
    about = [event.kind for event in events if event.peer == "wander"]
    first = about.index(Kind.COMMAND)
    assert about[first : first + 3] == [Kind.COMMAND, Kind.SENT, Kind.APPLIED]
    assert of(events, Kind.SENT)[0].value == 0.3


async def test_what_a_device_does_not_take_is_told(fake_actuator):
    """Which command it was, and what went wrong."""
    wheels = fake_actuator("wheels", safe=0.0)
    robot = esair.Robot(resources=[wheels], behaviors=[Wander()])
    events: list[Event] = []
    robot.journal.listen(events.append)
    async with robot:
        wheels.fail(ValueError("brown-out"), times=1)
        await asyncio.sleep(0.1)
    (told,) = of(events, Kind.UNANSWERED)
    assert (told.component, told.value) == ("wheels", 0.3)
    assert "brown-out" in told.text


async def test_who_comes_and_who_goes_is_told(fake_sensor):
    """Behaviors, reactions and resources; what could not be added never came."""

    class Bad(Guest):
        async def setup(self):
            raise RuntimeError("no")

    robot = esair.Robot()
    events: list[Event] = []
    robot.journal.listen(events.append, kinds=[Kind.ADDED, Kind.REMOVED])
    async with robot:
        await robot.behaviors.add(Guest())
        with pytest.raises(esair.BehaviorFailedError):
            await robot.behaviors.add(Bad())
        await robot.resources.add(fake_sensor("eye", 1.0))
        await robot.resources.remove("eye")
        await robot.behaviors.remove("guest")
    assert [(event.kind, event.component, event.peer) for event in events] == [
        (Kind.ADDED, "guest", "behavior"),
        (Kind.ADDED, "eye", "resource"),
        (Kind.REMOVED, "eye", "resource"),
        (Kind.REMOVED, "guest", "behavior"),
    ]


async def test_the_loser_of_a_turn_is_told_with_what_it_wanted(
    fake_sensor, fake_actuator
):
    """Asked and refused, though its command came to nobody's desk."""

    class Left(esair.Reaction):
        eye = esair.reads(float)
        wheels = esair.writes(float, priority=5)
        way = 1.0

        def react(self, eye):
            return self.way * eye

    class Right(Left):
        wheels = esair.writes(float, priority=6)
        way = -1.0

    eye = fake_sensor("eye", 1.0)
    wheels = fake_actuator("wheels", safe=0.0)
    left, right = Left(), Right()
    robot = esair.Robot(resources=[eye, wheels], behaviors=[left, right])
    events: list[Event] = []
    robot.journal.listen(events.append)
    async with robot:
        await wheels.until(-1.0, timeout=1.0)
    asked = [(event.peer, event.value) for event in of(events, Kind.COMMAND)]
    assert sorted(asked) == [("left", 1.0), ("right", -1.0)]
    assert [event.peer for event in of(events, Kind.REFUSED)] == ["left"]


async def test_the_numbers_have_no_gaps(fake_sensor, fake_actuator):
    """Every event has the next number, and time never goes back."""
    events: list[Event] = []
    robot = esair.Robot(
        resources=[fake_sensor("sonar", 1.0), fake_actuator("wheels", safe=0.0)],
        behaviors=[Wander()],
    )
    robot.journal.listen(events.append)
    async with robot:
        await asyncio.sleep(0.5)
    assert [event.number for event in events] == list(range(1, len(events) + 1))
    assert [event.time for event in events] == sorted(event.time for event in events)


async def test_the_safe_command_is_the_last_word(fake_actuator):
    """The stop is in the journal: safe is the last thing told of the actuator."""
    events: list[Event] = []
    robot = esair.Robot(
        resources=[fake_actuator("wheels", safe=0.0)], behaviors=[Wander()]
    )
    robot.journal.listen(events.append)
    async with robot:
        await asyncio.sleep(0.2)
    told = [e for e in events if e.component == "wheels" and e.kind in {"sent", "safe"}]
    assert told[-1].kind is Kind.SAFE


async def test_a_loss_and_a_return_are_told(fake_sensor):
    """A device that goes and comes back is a DOWN and an UP."""
    events: list[Event] = []
    sonar = fake_sensor("sonar", 1.0)
    robot = esair.Robot(resources=[sonar])
    robot.journal.listen(events.append, kinds=[Kind.UP, Kind.DOWN])
    async with robot:
        sonar.unplug()
        await asyncio.sleep(1.0)
        sonar.plug()
        await asyncio.sleep(1.0)
    kinds = [event.kind for event in events if event.component == "sonar"]
    assert kinds == [Kind.UP, Kind.DOWN, Kind.UP]


async def test_data_between_behaviors_is_told():
    """A put that was delivered names both and the data."""
    events: list[Event] = []
    robot = esair.Robot(behaviors=[Guest(), Greet()])
    robot.journal.listen(events.append, kinds=[Kind.PUT])
    async with robot:
        await asyncio.sleep(0.1)
    assert [event[3:6] for event in events] == [("guest", "greet", "hello")]


@pytest.mark.parametrize(
    "error",
    [ValueError("no"), asyncio.CancelledError(), SystemExit(3), GeneratorExit()],
)
async def test_a_listener_that_raises_is_ended_with_a_line(
    fake_actuator, caplog, error
):
    """It hears nothing more; the robot and the other listeners go on."""
    heard: list[Event] = []

    def broken(event: Event) -> None:
        raise error

    wheels = fake_actuator("wheels", safe=0.0)
    robot = esair.Robot(resources=[wheels], behaviors=[Wander()])
    robot.journal.listen(broken)
    robot.journal.listen(heard.append)
    with caplog.at_level(logging.ERROR, "esair"):
        async with robot:
            await wheels.until(0.3, timeout=1.0)
            await asyncio.sleep(0.5)
    assert sum("a listener raised" in line for line in caplog.messages) == 1
    assert len(of(heard, Kind.SENT)) > 5
    assert robot.journal.counts()["journal"]["ended"] == 1


async def test_what_a_listener_misses_is_counted():
    """With a backlog of three, of ten events in one turn the newest three are told."""
    journal, heard = Journal(), list[int]()
    listener = journal.listen(lambda event: heard.append(event.value), backlog=3)
    journal.start(asyncio.get_running_loop())
    for number in range(10):
        journal.publish(Kind.READING, "sonar", "", number)
    await asyncio.sleep(0)
    assert heard == [7, 8, 9]
    assert listener.dropped == 7
    assert journal.counts()["journal"]["dropped"] == 7


async def test_a_listener_never_runs_inside_the_effect():
    """It is called at the end of the turn, when the step that told is over."""
    journal, order = Journal(), list[str]()
    journal.listen(lambda event: order.append("told"))
    journal.start(asyncio.get_running_loop())
    journal.publish(Kind.SENT, "wheels")
    order.append("step over")
    await asyncio.sleep(0)
    assert order == ["step over", "told"]


async def test_a_listener_that_was_stopped_hears_nothing():
    """Neither what waits nor what comes."""
    journal, heard = Journal(), list[Event]()
    listener = journal.listen(heard.append)
    journal.start(asyncio.get_running_loop())
    journal.publish(Kind.SENT, "wheels")
    listener.stop()
    journal.publish(Kind.SENT, "wheels")
    await asyncio.sleep(0)
    assert heard == []
    assert not journal.heard.sent


async def test_a_listener_without_end_does_not_keep_the_end_waiting():
    """What it has not heard in time is dropped, and counted."""
    journal = Journal()
    heard: list[Event] = []

    def slow(event: Event) -> None:
        heard.append(event)
        journal.publish(Kind.LOG, "more", "of it")

    listener = journal.listen(slow)
    journal.publish(Kind.LOG, "the", "first")
    journal.close()
    assert heard
    assert listener.dropped == 1
    assert not listener.waiting


async def test_a_slow_listener_gives_way():
    """After its share of a turn the others are served, and it goes on in the next."""
    journal, order = Journal(), list[str]()

    def slow(event: Event) -> None:
        order.append("slow")
        end = time.perf_counter() + 1.5 * SLICE
        while time.perf_counter() < end:
            pass

    journal.listen(slow)
    journal.listen(lambda event: order.append("quick"))
    journal.start(asyncio.get_running_loop())
    for _ in range(2):
        journal.publish(Kind.SENT, "wheels")
    for _ in range(9):
        await asyncio.sleep(0)
    # Where the computer is busy the quick one may have had its share after its first.
    assert order[:2] == ["slow", "quick"]
    assert sorted(order) == ["quick", "quick", "slow", "slow"]


async def test_a_resident_acts_in_the_same_step():
    """What supervisors need of each other belongs to the effect itself."""
    journal, order = Journal(), list[str]()
    journal.attach(Kind.UP, lambda event: order.append(event.component))
    journal.publish(Kind.UP, "sonar")
    assert order == ["sonar"]


async def test_a_cause_is_heard_before_what_residents_do_about_it():
    """Listeners hear the events in the order of their numbers."""
    journal, heard = Journal(), list[Event]()
    journal.start(asyncio.get_running_loop())
    journal.listen(heard.append)
    journal.attach(Kind.UP, lambda _: journal.publish(Kind.RESTARTED, "explore"))
    journal.publish(Kind.UP, "wheels")
    await asyncio.sleep(0)
    assert [(event.number, event.component) for event in heard] == [
        (1, "wheels"),
        (2, "explore"),
    ]


async def test_lines_of_the_log_are_events():
    """Also those that another thread writes."""
    events: list[Event] = []
    robot = esair.Robot(name="rover")
    robot.journal.listen(events.append, kinds=[Kind.LOG])
    log = logging.getLogger("esair.test")
    async with robot:
        log.warning("from the %s", "loop")
        await asyncio.to_thread(log.warning, "from a thread")
        await asyncio.sleep(0.1)
    assert [event.text for event in events[:2]] == ["from the loop", "from a thread"]


class Stuck(logging.Handler):
    """Takes one line, and has not done so before it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.goes_on = threading.Event()
        self.threads = set[str]()

    def emit(self, record: logging.LogRecord) -> None:
        self.threads.add(threading.current_thread().name)
        assert self.goes_on.wait(30.0)


@pytest.mark.real_clock
@pytest.mark.fault("O15")
async def test_a_handler_that_hangs_holds_up_nobody():
    """What it would have to keep is bounded, and what it missed is counted."""
    robot, stuck = esair.Robot(name="rover"), Stuck()
    log = logging.getLogger("esair")
    log.addHandler(stuck)
    try:
        async with robot:
            for number in range(1500):
                log.warning("line %d", number)
            dropped = robot.journal.counts()["log"]["dropped"]
            stuck.goes_on.set()
    finally:
        stuck.goes_on.set()
        log.removeHandler(stuck)
    assert stuck.threads == {"esair-log"}
    assert 499 <= dropped <= 510  # the robot says something itself


async def test_what_a_listener_logs_is_told_to_no_listener(caplog):
    """Else each line would be the cause of the next; it is in the log all the same."""
    log, heard = logging.getLogger("esair.test"), list[str]()
    robot = esair.Robot(name="rover")

    def echo(event: Event) -> None:
        heard.append(event.text)
        if len(heard) < 100:
            log.warning("heard %s", event.text)

    robot.journal.listen(echo, kinds=[Kind.LOG])
    async with robot:
        log.warning("one")
        await asyncio.sleep(0.1)
        log.warning("two")
        await asyncio.sleep(0.1)
        assert heard == ["one", "two"]
    assert "heard two" in caplog.messages


async def test_counts_name_every_component(fake_sensor, fake_actuator):
    """Counters of sensors, actuators, behaviors and the journal are in one place."""
    wheels = fake_actuator("wheels", safe=0.0)
    robot = esair.Robot(
        resources=[fake_sensor("sonar", 1.0), wheels], behaviors=[Wander()]
    )
    async with robot:
        await wheels.until(0.3, timeout=1.0)
        counts = robot.journal.counts()
    assert counts["wheels"]["writes"] >= 1
    assert counts["sonar"]["losses"] == 0
    assert counts["wander"]["restarts"] == 0
    assert set(counts) >= {"behaviors", "journal"}


def test_supervisors_have_no_slot_to_overwrite():
    """A user who assigns something cuts no supervisor off from the other."""
    robot = esair.Robot()
    slots = [
        f"{type(each).__name__}.{name}"
        for each in (robot, robot.resources, robot.behaviors)
        for name in vars(each)
        if name.startswith("on_")
    ]
    assert slots == []


@pytest.mark.parametrize("heard", [False, True])
async def test_a_warning_is_printed_unless_somebody_else_hears_it(
    fake_sensor, capsys, monkeypatch, heard
):
    """As Python does: a script without a set-up of logging is not silent."""
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [logging.NullHandler()] if heard else [])
    async with esair.Robot(resources=[fake_sensor("sonar", 1.0)]):
        logging.getLogger("esair").warning("sonar is lost")
        logging.getLogger("esair").info("sonar is back")

    assert capsys.readouterr().err == ("" if heard else "sonar is lost\n")


@pytest.mark.promise("ROB-5")
def test_a_loop_closed_under_a_robot_harms_no_other() -> None:
    """Its journal hears the log no more; who writes to the log does not notice.

    In a process of its own: a robot that is not stopped keeps what it has of the process.
    """
    program = """
import asyncio, logging
import esair
from esair.journal import Kind

robot = esair.Robot()
robot.journal.listen(lambda event: None, kinds=[Kind.LOG])
loop = asyncio.new_event_loop()
loop.run_until_complete(robot.__aenter__())
loop.close()
logging.getLogger("esair").warning("of another robot")
"""
    command = [sys.executable, "-c", program]
    child = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert child.returncode == 0, child.stderr
    assert "of another robot" in child.stderr


def test_only_a_plain_function_can_listen() -> None:
    """What nobody could call, or would have to be awaited, is told at once."""

    async def later(event: Event) -> None: ...

    for wrong in (None, "print", later):
        with pytest.raises(esair.ConfigError, match="a plain function"):
            Journal().listen(wrong)  # type: ignore[arg-type]


def test_a_kind_that_there_is_not_is_told_with_what_was_meant() -> None:
    """A name is typed as well as the kind itself."""
    with pytest.raises(esair.ConfigError, match="did you mean 'refused'"):
        Journal().listen(print, kinds=["refusd"])  # type: ignore[list-item]


async def test_a_kind_is_heard_while_anybody_listens_to_it():
    """What tells much looks there first; each kind by itself."""
    journal = Journal()

    def heard() -> set[str]:
        return {k for k in type(journal.heard).__slots__ if getattr(journal.heard, k)}

    assert heard() == set()
    some = journal.listen(lambda _: None, kinds=[Kind.SENT, Kind.PUT, Kind.UP])
    journal.listen(lambda _: None, kinds=[Kind.SENT])
    assert heard() == {"sent", "put"}
    some.stop()
    assert heard() == {"sent"}
    journal.listen(lambda _: None)
    assert heard() == {*type(journal.heard).__slots__} <= {*Kind}


async def test_one_that_comes_in_a_turn_hears_what_comes_after():
    """And one that goes hears nothing; others hear all, in order."""
    journal, first, second = Journal(), list[int](), list[int]()
    journal.start(asyncio.get_running_loop())
    journal.listen(lambda event: first.append(event.number))
    journal.publish(Kind.SENT, "wheels")
    late = journal.listen(lambda event: second.append(event.number))
    journal.publish(Kind.SENT, "wheels")
    await asyncio.sleep(0)
    late.stop()
    journal.publish(Kind.SENT, "wheels")
    await asyncio.sleep(0)
    assert (first, second) == ([1, 2, 3], [2])


async def test_what_waits_is_bounded_within_a_turn_too():
    """More events than the backlog in one turn: the newest stay, the rest is counted."""
    journal, heard = Journal(), list[int]()
    listener = journal.listen(lambda event: heard.append(event.number))
    journal.start(asyncio.get_running_loop())
    most = 0
    for _ in range(3 * BACKLOG):
        journal.publish(Kind.SENT, "wheels")
        most = max(most, len(journal._made))
    assert most <= BACKLOG + 1
    await asyncio.sleep(0.3)
    assert heard[-1] == 3 * BACKLOG
    assert listener.heard == len(heard) == BACKLOG
    assert listener.dropped == 2 * BACKLOG


async def test_a_listener_knows_how_much_it_was_told():
    """Of its kinds alone; what waits, and what was dropped, is not told."""
    journal, heard = Journal(), list[int]()
    listener = journal.listen(
        lambda event: heard.append(event.number), kinds=[Kind.SENT], backlog=3
    )
    journal.start(asyncio.get_running_loop())
    for kind in (Kind.SENT, Kind.PUT, Kind.SENT):
        journal.publish(kind, "wheels")
    journal.counts()  # it has them from now on
    assert (listener.heard, listener.given) == (0, 2)
    await asyncio.sleep(0)
    assert (listener.heard, heard) == (2, [1, 3])
    for _ in range(5):
        journal.publish(Kind.SENT, "wheels")
    journal.counts()
    assert (listener.heard, listener.dropped) == (2, 2)
    listener.stop()
    assert (listener.heard, heard) == (2, [1, 3])


async def test_what_was_dropped_is_the_sum_of_all():
    """Of those that listen, and of those that have left; each once."""
    journal = Journal()
    journal.start(asyncio.get_running_loop())
    first, second = (journal.listen(lambda _: None, backlog=n) for n in (3, 8))
    for _ in range(10):
        journal.publish(Kind.SENT, "wheels")
    assert journal.counts()["journal"] == {"events": 10, "dropped": 9, "ended": 0}
    first.stop()
    first.stop()
    assert journal.counts()["journal"]["dropped"] == 9
    assert second.dropped == 2


async def test_each_resident_of_a_kind_acts():
    """In the order in which they came, with the event; of another kind none does."""
    journal, order = Journal(), list[tuple[str, int, str]]()

    def told(name: str) -> Callable[[Event], None]:
        return lambda event: order.append((name, event.number, event.component))

    journal.attach(Kind.SENT, told("first"))
    journal.attach(Kind.SENT, told("second"))
    journal.publish(Kind.PUT, "guest")
    journal.publish(Kind.SENT, "wheels")
    assert order == [("first", 2, "wheels"), ("second", 2, "wheels")]
