"""Operations of a resource: home, calibrate, zero, clear a fault."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import Any

import pytest

import esair
from esair import Access
from esair.journal import Event, Kind
from esair.plan import Plan, examine

pytestmark = [pytest.mark.virtual_clock, pytest.mark.promise("RS-7")]


class Lift(esair.Actuator[float]):
    """Notes what its driver does, in order; a home takes a second."""

    safe = 0.0
    limits = (-1.0, 1.0)

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.did: list[Any] = []

    async def write(self, command: float) -> None:
        self.did.append(command)

    @esair.operation(deadline=2.0)
    async def home(self, speed: float = 0.1, *, seconds: float = 1.0) -> float:
        """Find the lower end."""
        self.did.append(f"home {speed}")
        try:
            await asyncio.sleep(seconds)
        except asyncio.CancelledError:
            self.did.append("home ended")
            raise
        self.did.append("home done")
        return 0.25

    @esair.operation
    def zero(self) -> None:
        """Take this place for zero."""
        self.did.append("zero")

    @esair.operation
    async def clear_fault(self, code: int) -> None:
        raise RuntimeError(f"fault {code} stays")


class Scale(esair.Sensor[float]):
    """Is asked for its weight while it is not tared."""

    rate = esair.setting(50.0, unit="Hz")
    deadline = 2.0
    tared = 0
    alive = 0

    async def read(self) -> float:
        return await self._alone(0.01, 1.0)

    async def _alone(self, seconds: float, value: float) -> float:
        assert self.alive == 0, "the device has one call at a time"
        self.alive += 1
        try:
            await asyncio.sleep(seconds)
        finally:
            self.alive -= 1
        return value

    @esair.operation
    async def tare(self) -> float:
        """Take this weight for nothing."""
        self.tared += 1
        return await self._alone(0.5, 3.0)


def now() -> float:
    return asyncio.get_running_loop().time()


class User(esair.Behavior):
    """Has the right to configure, and does what the test says."""

    lift = esair.writes(float, configure=True)


ALL = Access.WRITE | Access.CONFIGURE


async def right(robot: esair.Robot, name: str = "lift", who: str = "me") -> Any:
    """Register somebody with the right to configure."""
    return await robot.resources.register(who, name, ALL)


def made(lift: Any, *more: Any) -> esair.Robot:
    """Make a robot in which anybody may do anything with the lift."""
    policy = esair.Policy(lift.name, allow={"*": ALL})
    return esair.Robot(resources=[lift, *more], policies=[policy])


async def test_an_operation_is_called_through_a_port() -> None:
    """It has its parameters, and its caller what it returns; all can see what there is."""
    lift, user = Lift(), User()
    async with esair.Robot(resources=[lift], behaviors=[user]):
        port: Any = user.lift
        assert await port.operate("home", speed=0.5) == 0.25
        assert "home 0.5" in lift.did
        assert sorted(port.operations) == ["clear_fault", "home", "zero"]
        assert str(lift.operations["home"]) == (
            "home(speed: float = 0.1, seconds: float = 1.0)"
        )
        assert lift.operations["home"].doc == "Find the lower end."


@pytest.mark.real_clock
async def test_a_thread_waits_for_its_operation() -> None:
    """A behavior with a plain run has the blocking form, also of a blocking driver."""
    lift = Lift()
    done = threading.Event()
    result: list[Any] = []

    class Threaded(esair.ThreadBehavior):
        lift = esair.writes(float, configure=True)

        def run(self) -> None:
            result.append(self.lift.operate("home", speed=1, seconds=0.01))
            result.append(self.lift.operate("zero"))
            result.append(sorted(self.lift.operations))
            done.set()

    async with esair.Robot(resources=[lift], behaviors=[Threaded()]):
        assert await asyncio.to_thread(done.wait, 5.0)
    assert result == [0.25, None, ["clear_fault", "home", "zero"]]
    assert "home 1.0" in lift.did


@pytest.mark.parametrize(
    ("name", "given", "told"),
    [
        ("home", {"speed": "fast"}, "speed: expected float, not 'fast'"),
        ("home", {"speed": float("nan")}, "finite"),
        ("home", {"spede": 1.0}, "did you mean 'speed'"),
        ("clear_fault", {}, "code: it is missing"),
        ("clear_fault", {"code": 1.5}, "code: expected int, not 1.5"),
        ("clear_fault", {"code": True}, "code: expected int, not True"),
    ],
)
async def test_parameters_are_checked_before_anything_is_done(
    name: str, given: dict[str, Any], told: str
) -> None:
    """The device hears nothing of a wrong call."""
    lift = Lift()
    async with made(lift) as robot:
        before = list(lift.did)
        with pytest.raises(esair.BadValueError, match=told):
            await robot.resources.operate(await right(robot), name, **given)
        assert lift.did == before


async def test_who_may_not_configure_may_not_operate() -> None:
    """Nor with a right that is void, nor what the class does not offer."""
    lift = Lift()
    async with made(lift) as robot:
        writes = await robot.resources.register("pilot", "lift", Access.WRITE)
        with pytest.raises(esair.AccessDeniedError, match="CONFIGURE"):
            await robot.resources.operate(writes, "zero")
        mine = await right(robot)
        with pytest.raises(esair.UnknownNameError, match="home"):
            await robot.resources.operate(mine, "hom")
        with pytest.raises(esair.UnknownNameError):
            await robot.resources.operate(mine, "write")
        robot.resources.revoke(mine)
        with pytest.raises(esair.NotRegisteredError):
            await robot.resources.operate(mine, "zero")
        assert "zero" not in lift.did


async def test_nothing_comes_between_and_what_moved_is_made_safe_first() -> None:
    """A write of the same behavior waits; another's is refused while it is homed."""
    lift = Lift()
    async with made(lift) as robot:
        mine = await right(robot)
        await robot.actuators.write(mine, 0.7)
        lift.did.clear()
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        await asyncio.sleep(0.1)
        other = await robot.resources.register("other", "lift", Access.WRITE)
        refused: Any = await robot.actuators.write(other, 1.0)
        assert not refused
        assert refused.holder == "me"
        write = asyncio.ensure_future(robot.actuators.write(mine, 0.3))
        await home
        assert await write
        assert lift.did == [0.0, "home 0.1", "home done", 0.0, 0.3]


async def test_who_does_not_hold_the_actuator_does_not_operate_it() -> None:
    """As a write would be refused, with the rule."""
    lift = Lift()
    async with made(lift) as robot:
        pilot = await robot.resources.register("pilot", "lift", ALL, priority=5)
        await robot.actuators.write(pilot, 0.7)
        with pytest.raises(esair.AccessDeniedError, match="priority 5 of 'pilot'"):
            await robot.resources.operate(await right(robot), "home")
        assert "home 0.1" not in lift.did


@pytest.mark.promise("AC-2")
@pytest.mark.parametrize("command", [0.0, -0.2])
async def test_a_write_of_a_higher_priority_ends_an_operation(command: float) -> None:
    """To stop or to back off: it is safe first, and who asked is told who was above."""
    lift = Lift()
    async with made(lift) as robot:
        home = asyncio.ensure_future(
            robot.resources.operate(await right(robot), "home")
        )
        brake = await robot.resources.register("brake", "lift", ALL, priority=50)
        await asyncio.sleep(0.3)
        asked = now()
        written = await robot.actuators.write(brake, command)
        with pytest.raises(esair.AccessDeniedError, match="priority 50 of 'brake'"):
            await home
        assert written
        assert now() == asked
        assert lift.did == [0.0, "home 0.1", "home ended", 0.0, command]


@pytest.mark.promise("AC-2")
async def test_none_begins_where_the_device_refuses_to_be_safe_before() -> None:
    """Its owner elsewhere may move it: who asks is told why, and may when it is safe."""

    class Owned(Lift):
        owned = False

        async def write(self, command: float) -> Any:
            await super().write(command)
            if self.owned:
                return esair.Refused("reflex", 9, "a reflex has it", now(), None)
            return None

    lift = Owned(name="lift")
    async with made(lift) as robot:
        mine = await right(robot)
        assert await robot.actuators.write(mine, 0.7)
        lift.owned = True
        with pytest.raises(esair.AccessDeniedError, match="a reflex has it"):
            await robot.resources.operate(mine, "home")
        assert lift.did == [0.0, 0.7, 0.0]
        lift.owned = False
        await asyncio.sleep(0.4)
        await robot.resources.operate(mine, "home")
        assert lift.did[:6] == [0.0, 0.7, 0.0, 0.0, "home 0.1", "home done"]


@pytest.mark.promise("AC-2")
async def test_none_begins_before_a_write_of_a_higher_priority_that_waits() -> None:
    """The device is busy with an earlier command; who is above comes first."""

    class Slow(Lift):
        async def write(self, command: float) -> None:
            self.did.append(command)
            await asyncio.sleep(0.05)

    lift = Slow(name="lift")
    async with made(lift) as robot:
        mine = await right(robot)
        brake = await robot.resources.register("brake", "lift", ALL, priority=50)
        moving = asyncio.ensure_future(robot.actuators.write(mine, 0.7))
        await asyncio.sleep(0.01)
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        braking = asyncio.ensure_future(robot.actuators.write(brake, -0.2))
        with pytest.raises(esair.AccessDeniedError, match="priority 50 of 'brake'"):
            await home
        assert await moving
        assert await braking
        assert "home 0.1" not in lift.did


async def test_a_sensor_is_not_read_while_it_is_tared() -> None:
    """The polls go on afterwards; two who ask have their turns."""
    scale = Scale()
    async with esair.Robot(
        resources=[scale],
        policies=[esair.Policy("scale", allow={"*": Access.READ | Access.CONFIGURE})],
    ) as robot:
        rights = [
            await robot.resources.register(who, "scale", Access.READ | Access.CONFIGURE)
            for who in ("a", "b")
        ]
        reading = asyncio.ensure_future(robot.sensors.read(rights[0], fresh=True))
        tares = [robot.resources.operate(each, "tare") for each in rights]
        assert await asyncio.gather(*tares) == [3.0, 3.0]
        await reading
        assert scale.tared == 2
        assert (await robot.sensors.read(rights[1], fresh=True)).value == 1.0


async def test_a_halt_ends_an_operation_and_lets_none_begin() -> None:
    """`HaltedError` at the caller; the safe command is the last thing on the wire."""
    lift = Lift()
    async with made(lift) as robot:
        mine = await right(robot)
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        await asyncio.sleep(0.2)
        await robot.halt("enough")
        with pytest.raises(esair.HaltedError, match="enough"):
            await home
        assert lift.did.index("home ended") < len(lift.did) - 1
        assert lift.did[-1] == 0.0
        before = list(lift.did)
        with pytest.raises(esair.HaltedError, match="enough"):
            await robot.resources.operate(mine, "zero")
        assert lift.did == before
        robot.resume()
        assert await robot.resources.operate(mine, "home") == 0.25


@pytest.mark.parametrize("way", ["cancelled", "revoked", "removed", "stopped"])
async def test_an_operation_ends_with_whoever_asked_and_with_its_device(
    way: str,
) -> None:
    """It does not go on when nobody is there any more; the device is safe then."""
    lift = Lift()
    async with made(lift) as robot:
        mine = await right(robot)
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        await asyncio.sleep(0.2)
        if way == "cancelled":
            home.cancel()
        elif way == "revoked":
            robot.resources.revoke(mine)
        elif way == "removed":
            await robot.resources.remove("lift")
        else:
            await robot.stop("that is all")
        errors = {
            "cancelled": asyncio.CancelledError,
            "revoked": esair.NotRegisteredError,
            "removed": esair.EsairError,
            "stopped": esair.StoppingError,
        }
        with pytest.raises(errors[way]):
            await home
        await asyncio.sleep(0.1)
        assert "home ended" in lift.did
        assert "home done" not in lift.did
        assert lift.did[-1] == 0.0


@pytest.mark.promise("CALL-3")
@pytest.mark.parametrize("what", ["operate", "configure"])
async def test_nothing_comes_in_while_one_that_was_given_up_still_ends(
    what: str,
) -> None:
    """The device is its own until its driver has stopped; then safe comes first."""

    class Careful(Lift):
        speed = esair.setting(1.0)

        async def apply(self, **changes: Any) -> None:
            self.did.append(changes)

        @esair.operation(deadline=3.0)
        async def seek(self) -> None:
            self.did.append("seek")
            try:
                await asyncio.sleep(1.0)
            finally:
                await asyncio.sleep(0.1)  # its motor has to answer
                self.did.append("seek ended")

    lift = Careful(name="lift")
    async with made(lift) as robot:
        mine = await right(robot)
        lift.did.clear()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await robot.resources.operate(mine, "seek")
        if what == "operate":
            await robot.resources.operate(mine, "seek")
            after: list[Any] = [0.0, "seek", "seek ended", 0.0]
        else:
            await robot.resources.configure(mine, speed=2.0)
            after = [0.0, {"speed": 2.0}]
        await asyncio.sleep(0.1)
        assert lift.did == ["seek", "seek ended", *after]


async def test_one_that_does_not_end_is_made_safe_when_its_asker_has_gone() -> None:
    """Its driver ignores the cancellation: the safe command is sent beside it."""

    class Stubborn(Lift):
        deadline = 0.2

        @esair.operation(deadline=3.0)
        async def seek(self) -> None:
            until = now() + 1.5
            while now() < until:
                with contextlib.suppress(asyncio.CancelledError):
                    await asyncio.sleep(until - now())
            self.did.append("seek ended")

    lift = Stubborn(name="lift")
    async with made(lift) as robot:
        mine = await right(robot)
        lift.did.clear()
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await robot.resources.operate(mine, "seek")
        await asyncio.sleep(0.3)
        assert lift.did == [0.0]
        assert await robot.actuators.write(mine, 0.5)
        assert lift.did == [0.0, "seek ended", 0.0, 0.5]


@pytest.mark.parametrize("way", ["cancelled", "revoked", "halted", "lost", "late"])
async def test_one_that_waits_for_the_device_ends_without_having_begun(
    way: str,
) -> None:
    """As one that runs does, and with the same errors; it is told once."""

    class Slow(Lift):
        deadline = 5.0

        async def write(self, command: float) -> None:
            self.did.append(command)
            await asyncio.sleep(3.0 if command else 0.0)

    lift = Slow(name="lift")
    events: list[Event] = []
    async with made(lift) as robot:
        robot.journal.listen(events.append)
        mine = await right(robot)
        pilot = await robot.resources.register("me", "lift", Access.WRITE)
        moving = asyncio.ensure_future(robot.actuators.write(pilot, 0.7))
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        await asyncio.sleep(0.2)
        asked = now()
        if way == "cancelled":
            home.cancel()
        elif way == "revoked":
            robot.resources.revoke(mine)
        elif way == "halted":
            await robot.halt("enough")
        elif way == "lost":
            lift.report_lost(esair.DeviceLostError("lift", "its plug is out"))
        error = {
            "cancelled": asyncio.CancelledError,
            "revoked": esair.NotRegisteredError,
            "halted": esair.HaltedError,
            "lost": esair.DeviceLostError,
            "late": esair.DriverStuckError,
        }[way]
        with pytest.raises(error):
            await home
        assert now() - asked == pytest.approx({"late": 1.8, "halted": 2.8}.get(way, 0))
        told = [each.text for each in events if each.kind is Kind.OPERATED]
        assert [each.partition(":")[0] for each in told] == (
            [] if way == "cancelled" else ["home"]
        )
        await asyncio.gather(moving, return_exceptions=True)
        await asyncio.sleep(2.0)
        assert "home 0.1" not in lift.did
        robot.resume()
        again = await right(robot)
        assert await robot.resources.operate(again, "zero") is None


async def test_a_device_that_goes_in_an_operation_is_lost() -> None:
    """Whether its driver finds out by itself, or somebody tells; and it comes back."""
    events: list[Event] = []

    class Loose(Lift):
        @esair.operation
        async def shake(self) -> None:
            raise esair.DeviceLostError("lift", "it fell off")

    lift = Loose(name="lift")
    async with made(lift) as robot:
        robot.journal.listen(events.append)
        mine = await right(robot)
        with pytest.raises(esair.DeviceLostError, match="fell off"):
            await robot.resources.operate(mine, "shake")
        await asyncio.sleep(1.0)
        assert robot.resources.query("lift").losses == 1
        asked = [
            asyncio.ensure_future(robot.resources.operate(mine, "home"))
            for _ in range(2)
        ]
        await asyncio.sleep(0.2)
        lift.report_lost(esair.DeviceLostError("lift", "its plug is out"))
        for each in asked:
            with pytest.raises(esair.DeviceLostError, match="plug is out"):
                await each
        await asyncio.sleep(1.0)
        assert lift.did.count("home 0.1") == 1
        assert await robot.resources.operate(mine, "home") == 0.25
        await asyncio.sleep(0.01)
    told = [each.text for each in events if each.kind is Kind.OPERATED]
    assert [each.partition(":")[0] for each in told] == ["shake"] + 3 * ["home"]


async def test_a_right_that_ends_while_another_operation_runs_begins_none() -> None:
    """The turn comes too late for it."""
    lift = Lift()
    async with made(lift) as robot:
        mine, other = await right(robot), await right(robot, who="other")
        first = asyncio.ensure_future(
            robot.resources.operate(mine, "home", seconds=0.5)
        )
        second = asyncio.ensure_future(robot.resources.operate(other, "zero"))
        await asyncio.sleep(0.2)
        robot.resources.revoke(other)
        with pytest.raises(esair.NotRegisteredError):
            await second
        assert await first == 0.25
        assert "zero" not in lift.did


async def test_a_device_at_work_was_told_the_operation() -> None:
    """By its name, with what it was called with; not by an earlier command."""
    lift = Lift()
    async with made(lift) as robot:
        mine = await right(robot)
        home = asyncio.ensure_future(robot.resources.operate(mine, "home", speed=0.5))
        await asyncio.sleep(0.2)
        told = robot.actuators.channels["lift"].told()
        assert repr(told.command) == "<operation home(speed=0.5)>"
        assert (told.safe, told.answered) == (False, False)
        await home


@pytest.mark.promise("PRO-2")
async def test_one_that_would_move_has_no_operation_while_its_own_reaction_is_blind(
    fake_sensor: Any,
) -> None:
    """Of those who are not above it."""

    class Brake(esair.Reaction):
        door = esair.reads(bool)
        lift = esair.writes(float, priority=5)

        def react(self, door: bool) -> float | None:
            return None if door else 0.0

    lift, door = Lift(), fake_sensor("door", True)
    robot = esair.Robot(
        resources=[lift, door],
        behaviors=[Brake()],
        policies=[esair.Policy("lift", allow={"*": ALL})],
    )
    async with robot:
        low = await robot.resources.register("low", "lift", ALL, priority=5)
        high = await robot.resources.register("high", "lift", ALL, priority=6)
        await robot.resources.operate(low, "zero")
        door.unplug()
        await asyncio.sleep(0.1)
        with pytest.raises(esair.AccessDeniedError, match="brake is blind"):
            await robot.resources.operate(low, "zero")
        await robot.resources.operate(high, "zero")
        assert lift.did.count("zero") == 2


async def test_an_operation_has_a_deadline_and_the_others_their_turn() -> None:
    """The device is free again when the call has ended."""
    lift = Lift()
    async with made(lift) as robot:
        mine = await right(robot)
        await asyncio.sleep(5.0)
        with pytest.raises(esair.DriverStuckError, match=r"operate home.*2 s"):
            await robot.resources.operate(mine, "home", seconds=60.0)
        assert asyncio.get_running_loop().time() == pytest.approx(7.0)
        await asyncio.sleep(0.05)
        assert lift.did[-2:] == ["home ended", 0.0]
        assert await robot.actuators.write(mine, 0.5)


async def test_an_operation_that_times_out_by_itself_names_its_deadline() -> None:
    """What the driver says of its own time is the cause of it."""

    class Impatient(Lift):
        @esair.operation(deadline=3.0)
        async def tare(self) -> None:
            raise TimeoutError("the load cell does not settle")

    async with made(Impatient(name="lift")) as robot:
        mine = await right(robot)
        with pytest.raises(esair.DriverStuckError, match=r"tare.* 3 s") as caught:
            await robot.resources.operate(mine, "tare")
        assert "does not settle" in str(caught.value.__cause__)


async def test_an_operation_that_fails_says_so_once() -> None:
    """The journal has one event for each, with who asked and what came of it."""
    lift = Lift()
    events: list[Event] = []
    async with made(lift) as robot:
        robot.journal.listen(events.append)
        mine = await right(robot)
        with pytest.raises(esair.DeviceFaultError, match="fault 7 stays"):
            await robot.resources.operate(mine, "clear_fault", code=7)
        await robot.resources.operate(mine, "home")
        await asyncio.sleep(0.01)
    failed, went_well = [each for each in events if each.kind is Kind.OPERATED]
    assert (failed.component, failed.peer) == ("lift", "me")
    assert failed.text.startswith("clear_fault: ")
    assert "fault 7 stays" in failed.text
    assert isinstance(failed.value, esair.DeviceFaultError)
    assert (went_well.component, went_well.peer) == ("lift", "me")
    assert (went_well.text, went_well.value) == ("home", 0.25)


async def test_operations_that_wait_are_bounded() -> None:
    """The seventeenth is told so at once; the others have one outcome each."""
    lift = Lift()
    async with made(lift) as robot:
        mine = await right(robot)
        asked = [
            asyncio.ensure_future(robot.resources.operate(mine, "home"))
            for _ in range(17)
        ]
        with pytest.raises(esair.BusyError):
            await asked[-1]
        outcomes = await asyncio.gather(*asked[:-1], return_exceptions=True)
        done = [each for each in outcomes if each == 0.25]
        late = [each for each in outcomes if isinstance(each, esair.DriverStuckError)]
        # One that ends in the moment of its deadline is in time.
        assert len(done) == 2
        assert len(late) == 14
        assert robot.journal.counts()["resources"]["turned_away"] == 1


async def test_operations_that_are_over_count_no_more() -> None:
    """However many there were: the bound is for those of one time."""
    lift = Lift()
    async with made(lift) as robot:
        mine = await right(robot)
        for _ in range(40):
            await robot.resources.operate(mine, "zero")
        assert lift.did.count("zero") == 40


async def test_a_blind_guard_ends_an_operation(fake_sensor: Any) -> None:
    """An operation may move: who cannot see lets none begin, and none go on."""
    door = fake_sensor("door", True)

    class Fence(esair.Reaction):
        door = esair.reads(bool)
        lift = esair.guards(float)

        def react(self, door: bool, lift: float) -> float | None:
            return lift if door else None

    lift = Lift()
    robot = esair.Robot(
        resources=[lift, door],
        behaviors=[Fence()],
        policies=[esair.Policy("lift", allow={"*": ALL | Access.GUARD})],
    )
    async with robot:
        mine = await right(robot)
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        await asyncio.sleep(0.2)
        assert lift.did[-1] == "home 0.1"
        door.unplug()
        with pytest.raises(esair.AccessDeniedError, match="fence is blind") as ended:
            await home
        assert ended.value.behavior == mine.behavior
        assert lift.did[-1] == 0.0
        with pytest.raises(esair.AccessDeniedError, match="fence is blind"):
            await robot.resources.operate(mine, "home")


class Fence(esair.Reaction):
    """Lets nothing pass while the door is open."""

    door = esair.reads(bool)
    lift = esair.guards(float)

    def react(self, door: bool, lift: float) -> float | None:
        return None if door else lift


class Latch(Fence):
    lift = esair.guards(float, latch=True)


class Low(Fence):
    """Computes with the place, too."""

    def react(self, door: bool, lift: float) -> float | None:
        return None if door else min(lift, 0.8)


def fenced(lift: Any, door: Any, guard: esair.Reaction) -> esair.Robot:
    policy = esair.Policy("lift", allow={"*": ALL | Access.GUARD})
    return esair.Robot(resources=[lift, door], behaviors=[guard], policies=[policy])


@pytest.mark.promise("PRO-5")
@pytest.mark.parametrize("written", [False, True])
async def test_a_guard_is_asked_anew_when_an_operation_begins(
    written: bool, fake_sensor: Any
) -> None:
    """Whether or not somebody has written; a refusal of long ago counts no more."""
    lift, door = Lift(), fake_sensor("door", True)
    async with fenced(lift, door, Fence()) as robot:
        mine = await right(robot)
        if written:
            assert not await robot.actuators.write(mine, 0.5)
        with pytest.raises(esair.AccessDeniedError, match="fence guards lift"):
            await robot.resources.operate(mine, "home")
        assert "home 0.1" not in lift.did
        door.feed(False)
        await asyncio.sleep(0.1)
        assert await robot.resources.operate(mine, "home") == 0.25


@pytest.mark.promise("PRO-5")
@pytest.mark.parametrize("guard", [Fence, Latch])
async def test_a_guard_that_lets_nothing_pass_any_more_ends_an_operation(
    guard: type[esair.Reaction], fake_sensor: Any
) -> None:
    """At its next reading; one that latches stays shut afterwards."""
    lift, door = Lift(), fake_sensor("door", False)
    async with fenced(lift, door, guard(name="fence")) as robot:
        mine = await right(robot)
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        await asyncio.sleep(0.2)
        door.feed(True)
        with pytest.raises(esair.AccessDeniedError, match="fence"):
            await home
        assert lift.did[-2:] == ["home ended", 0.0]
        door.feed(False)
        await asyncio.sleep(0.1)
        if guard is Latch:
            with pytest.raises(esair.AccessDeniedError, match="latched"):
                await robot.resources.operate(mine, "home")
        else:
            await robot.resources.operate(mine, "home")


@pytest.mark.promise("PRO-9")
async def test_a_guard_that_goes_blind_amid_an_operation_latches(
    fake_sensor: Any,
) -> None:
    """Something has moved while it could not see."""
    lift, door = Lift(), fake_sensor("door", False)
    async with fenced(lift, door, Latch()) as robot:
        mine = await right(robot)
        home = asyncio.ensure_future(robot.resources.operate(mine, "home"))
        await asyncio.sleep(0.2)
        door.unplug()
        with pytest.raises(esair.AccessDeniedError, match="latch is latched"):
            await home


@pytest.mark.promise("ROB-4")
async def test_none_begins_after_a_guard_that_was_asked_has_halted_the_robot(
    fake_sensor: Any,
) -> None:
    """However it answers."""

    class Halts(Fence):
        def react(self, door: bool, lift: float) -> float | None:
            if door:
                robot.halt("the door is open")
            return lift

    lift, door = Lift(), fake_sensor("door", True)
    async with fenced(lift, door, Halts()) as robot:
        mine = await right(robot)
        with pytest.raises(esair.HaltedError, match="the door is open"):
            await robot.resources.operate(mine, "home")
        assert "home 0.1" not in lift.did


async def test_a_guard_of_places_is_asked_with_that_where_the_device_stays(
    fake_sensor: Any,
) -> None:
    """Of what was never written: it can compare that, as it can any command."""

    class Servo(Lift):
        safe: Any = esair.HOLD

        async def write(self, command: Any) -> float:  # type: ignore[override]
            await super().write(command)
            return 0.5

    servo, door = Servo(name="lift"), fake_sensor("door", True)
    async with fenced(servo, door, Low()) as robot:
        mine = await right(robot)
        with pytest.raises(esair.AccessDeniedError, match="low guards lift"):
            await robot.resources.operate(mine, "home")
        door.feed(False)
        await asyncio.sleep(0.1)
        assert await robot.resources.operate(mine, "home") == 0.25


@pytest.mark.promise("PRO-5")
@pytest.mark.parametrize("guard", [Fence, Low])
async def test_a_place_that_nobody_knows_crashes_no_guard(
    guard: type[esair.Reaction], fake_sensor: Any
) -> None:
    """It is asked with `HOLD`; who computes with that has not let it pass."""

    class Silent(Lift):
        safe: Any = esair.HOLD

    lift, door = Silent(name="lift"), fake_sensor("door", True)
    async with fenced(lift, door, guard(name="fence")) as robot:
        mine = await right(robot)
        with pytest.raises(esair.AccessDeniedError, match="fence guards lift"):
            await robot.resources.operate(mine, "home")
        door.feed(False)
        await asyncio.sleep(0.1)
        if guard is Low:
            with pytest.raises(esair.AccessDeniedError, match="fence guards lift"):
                await robot.resources.operate(mine, "home")
            await robot.actuators.write(mine, 0.5)
        assert await robot.resources.operate(mine, "home") == 0.25


def test_the_rulebook_finds_what_is_declared_wrongly() -> None:
    """All mistakes at once, before anything starts."""

    class Wrong(Lift):
        @esair.operation
        async def park(self, place, *rest: int) -> None:  # type: ignore[no-untyped-def]
            """Neither typed, nor by name."""

        @esair.operation(deadline=-1.0)
        async def aim(self, angle: float = "north") -> None:  # type: ignore[assignment]
            """A default of another type."""

        @esair.operation
        async def close(self) -> None:
            """esair calls it."""

        @esair.operation(deadline=9.0)
        def grind(self) -> None:
            """Blocks."""

    found = examine(Plan(resources=[Wrong(name="lift")], behaviors=[]))
    told = {f"{each.field}: {each.text}" for each in found}
    for part in (
        "park: its parameter 'place' has no type",
        "park: its parameter 'rest' cannot be given by name",
        "aim: the default of 'angle': expected float, not 'north'",
        "aim: deadline: expected seconds > 0, not -1.0",
        "close: a method that esair calls by itself is no operation",
        "grind: it blocks its thread for up to 9 s",
    ):
        assert any(each.startswith(part) for each in told), (part, told)


def test_what_blocks_as_long_as_a_command_is_no_mistake() -> None:
    """A safe command waits no longer than for another command."""

    class Grinds(Lift):
        deadline = 3.0

        @esair.operation(deadline=3.0)
        def grind(self) -> None:
            """Blocks."""

    found = examine(Plan(resources=[Grinds(name="lift")], behaviors=[]))
    assert [each.text for each in found if each.rule == "time"] == []


@pytest.mark.promise("SUP-2")
async def test_what_is_about_to_go_begins_with_nothing() -> None:
    """It is made safe first, which may take a while; the error says why."""

    class Heavy(Lift):
        async def write(self, command: float) -> None:
            if len(self.did) > 0:
                await asyncio.sleep(0.3)
            await super().write(command)

    lift = Heavy(name="lift")
    user: Any = esair.Behavior(writes={"lift": esair.writes(float, configure=True)})
    async with esair.Robot(resources=[lift], behaviors=[user]) as robot:
        await user.lift.write(0.5)
        replacing = asyncio.ensure_future(robot.resources.replace("lift", Lift()))
        await asyncio.sleep(0.05)
        with pytest.raises(esair.AccessDeniedError, match="is being replaced"):
            await user.lift.operate("home")
        await replacing
        assert lift.did == [0.0, 0.5, 0.0]


@pytest.mark.promise("SUP-5")
async def test_those_that_wait_hear_at_once_that_the_device_was_replaced() -> None:
    """All of them, not the first alone."""
    async with made(Lift()) as robot:
        mine = await right(robot)
        work = [robot.resources.operate(mine, "home") for _ in range(4)]
        waiting = [asyncio.ensure_future(each) for each in work]
        await asyncio.sleep(0.1)
        await robot.resources.replace("lift", Lift())
        async with asyncio.timeout(0.1):
            told = await asyncio.gather(*waiting, return_exceptions=True)

    assert [type(each) for each in told[2:]] == [esair.DeviceLostError] * 2


@pytest.mark.promise("PRO-12")
async def test_one_that_a_higher_priority_ends_goes_to_no_safe_place() -> None:
    """It stays where it is, until what was written is sent."""

    class Far(Lift):
        safe_moves = True

    lift = Far(name="lift")
    low: Any = esair.Behavior(
        name="low", writes={"lift": esair.writes(float, configure=True)}
    )
    high: Any = esair.Behavior(
        name="high", writes={"lift": esair.writes(float, priority=5)}
    )
    async with esair.Robot(resources=[lift], behaviors=[low, high]):
        homing = asyncio.ensure_future(low.lift.operate("home"))
        await asyncio.sleep(0.1)
        began = len(lift.did)
        assert await high.lift.write(0.5)
        assert lift.did[began:] == ["home ended", esair.HOLD, 0.5]
        with pytest.raises(esair.AccessDeniedError):
            await homing


@pytest.mark.promise("PRO-12")
async def test_what_moves_goes_to_no_safe_place_before_one() -> None:
    """It stays where it is, and the operation begins there."""

    class Far(Lift):
        safe_moves = True

    lift, user = Far(name="lift"), User()
    async with esair.Robot(resources=[lift], behaviors=[user]):
        assert await user.lift.write(0.5)
        began = len(lift.did)
        await user.lift.operate("zero")
        assert lift.did[began : began + 2] == [esair.HOLD, "zero"]
