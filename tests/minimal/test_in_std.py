"""What was written for MIN in a robot of STD."""

import asyncio
import textwrap
import threading

import hypothesis
import pytest
from hypothesis import strategies as st
from tests.minimal import rules

import esair
from esair import minimal
from esair.testing import FakeActuator, FakeSensor
from esair.values import snake_case

pytestmark = pytest.mark.promise("MIN-2")


class Slow(rules.Go):
    rate = 20.0


@pytest.mark.virtual_clock
async def test_plain_devices_run_on_worker_threads() -> None:
    """They are opened, read, written, made safe, and closed."""
    sonar, motor = rules.Sonar(0.5), rules.Motor()

    async with esair.Robot(resources=[sonar, motor], behaviors=[rules.Go()]) as robot:
        await asyncio.sleep(0.45)
        assert motor.state == "open"
        assert robot.behaviors.query("go").state is esair.BehaviorState.RUNNING

    assert motor.told[0] == motor.told[-1] == 0.0
    assert (
        3 <= motor.told.count(0.5) <= 6
    )  # ten times a second, unless it says otherwise
    assert motor.state == "closed"


async def test_a_reaction_of_min_beside_one_of_std(fake_sensor, fake_actuator) -> None:
    """Priorities decide, whatever they were written for."""

    class Low(esair.Reaction):
        sonar = esair.reads(float)
        motor = esair.writes(float, priority=-1)

        def react(self, sonar: float) -> float:
            return 0.125

    sonar = fake_sensor("sonar", rate=20.0)
    motor = fake_actuator("motor", safe=0.0)

    async with esair.Robot(resources=[sonar, motor], behaviors=[rules.Go(), Low()]):
        await asyncio.sleep(0.1)
        sonar.feed(0.5)
        await motor.until(0.5, timeout=1.0)
        sonar.feed(-1.0)
        await motor.until(0.125, timeout=1.0)


async def test_it_is_parked_while_its_sensor_is_away(
    fake_sensor, fake_actuator
) -> None:
    """A lost sensor parks it, as any reaction."""
    sonar: FakeSensor[float] = fake_sensor("sonar", 0.5, rate=20.0)
    motor: FakeActuator[float] = fake_actuator("motor", safe=0.0)

    async with esair.Robot(resources=[sonar, motor], behaviors=[Slow("go")]) as robot:
        await motor.until(0.5, timeout=1.0)
        sonar.unplug()
        await motor.until(0.0, timeout=1.0)
        assert robot.behaviors.query("go").state is esair.BehaviorState.PARKED


async def test_a_behavior_performs_one(fake_sensor, fake_actuator) -> None:
    """A reaction of MIN is a step of a behavior."""

    class Captain(esair.Behavior):
        sonar = esair.reads(float)
        motor = esair.writes(float)
        done = False

        async def run(self) -> None:
            self.done = await self.perform(
                rules.Go(), until=lambda sonar: sonar > 0.7, timeout=5.0
            )

    sonar = fake_sensor("sonar", 0.5, rate=20.0)
    motor = fake_actuator("motor", safe=0.0)
    captain = Captain()

    async with esair.Robot(resources=[sonar, motor], behaviors=[captain]) as robot:
        await motor.until(0.5, timeout=1.0)
        sonar.feed(0.75)
        await asyncio.wait_for(robot.ended(), 2.0)

    assert captain.done


@pytest.mark.virtual_clock
async def test_mistakes_are_named_as_in_std() -> None:
    """A wrong wiring stops the robot from starting."""

    class NoSafe(minimal.Actuator):
        def write(self, command: float) -> None: ...

    robot = esair.Robot(resources=[NoSafe()], behaviors=[rules.Go()])

    with pytest.raises(ExceptionGroup) as caught:
        await robot.__aenter__()
    text = " ".join(str(error) for error in caught.value.exceptions)
    assert "no_safe: safe: an actuator must declare its safe command" in text
    assert "'sonar'" in text


@pytest.mark.virtual_clock
async def test_methods_that_are_missing_are_named_at_the_start() -> None:
    """A class that forgot its one method does not get into a robot."""

    class Still(minimal.Actuator):
        safe = 0.0

    class Thoughtless(minimal.Reaction):
        mute = minimal.reads()
        still = minimal.writes()

    robot = esair.Robot(
        resources=[minimal.Sensor("mute"), Still()], behaviors=[Thoughtless()]
    )

    with pytest.raises(ExceptionGroup) as caught:
        await robot.__aenter__()
    assert [str(error) for error in caught.value.exceptions] == [
        "mute: read: a sensor must have a read or stream method",
        "still: write: an actuator must have a write method",
        "thoughtless: react: a reaction must have a react method",
    ]


@hypothesis.given(st.from_regex(r"[A-Z]+([a-z0-9]|_?[A-Z]){0,12}", fullmatch=True))
def test_names_are_the_same_in_both(name) -> None:
    """The class name in snake case is the same name on a computer and on a board."""
    part = type(name, (minimal.Sensor,), {"read": lambda self: 1})()
    minimal.Loop([], [part], [])

    assert part.name == snake_case(name)


@pytest.mark.virtual_clock
async def test_they_are_added_replaced_and_removed_at_run_time() -> None:
    """The supervisors take them as they take components of STD."""

    class Back(rules.Go):
        def react(self, sonar):
            return -sonar

    motor, other = rules.Motor(), rules.Motor()

    async with esair.Robot() as robot:
        await robot.resources.add(rules.Sonar(0.5))
        await robot.resources.add(motor)
        await robot.behaviors.add(rules.Go())
        await asyncio.sleep(0.2)
        assert motor.told[-1] == 0.5
        await robot.behaviors.replace("go", Back())
        await asyncio.sleep(0.2)
        assert motor.told[-1] == -0.5
        await robot.resources.replace("motor", other)
        await asyncio.sleep(0.2)
        assert motor.told[-1] == 0.0
        assert other.told[-1] == -0.5
        await robot.behaviors.remove("go")
        assert other.told[-1] == 0.0
        assert [motor.state, other.state] == ["closed", "open"]


@pytest.mark.virtual_clock
async def test_a_class_may_say_what_only_std_asks() -> None:
    """As attributes: how often it restarts, how many faults are too many."""

    class Once(rules.Go):
        restart = esair.Restart(max=0)

        def react(self, sonar):
            raise ValueError("a mistake of the user")

    class Fragile(rules.Sonar):
        fault_limit = 1
        deadline = 0.25

    sonar = Fragile(0.5)
    sonar.name = "sonar"

    async with esair.Robot(
        resources=[sonar, rules.Motor()], behaviors=[Once(), rules.Go()]
    ) as robot:
        await asyncio.sleep(0.5)
        assert robot.behaviors.query("once").state is esair.BehaviorState.FAILED
        assert robot.behaviors.query("once").restarts == 0
        sonar.values = [OSError(5)]
        await asyncio.sleep(0.05)  # between two polls
        assert robot.resources.query("sonar").losses == 1


@pytest.mark.virtual_clock
async def test_limits_that_a_sensor_of_min_declares_are_kept() -> None:
    """As those of one of STD: what is beyond them reaches no reaction."""

    class Near(rules.Sonar):
        limits = (0.0, 4.0)

    sonar, motor = Near(100.0), rules.Motor()
    sonar.name = "sonar"
    async with esair.Robot(resources=[sonar, motor], behaviors=[rules.Go()]):
        await asyncio.sleep(0.5)
    assert set(motor.told) == {0.0}


@pytest.mark.virtual_clock
async def test_a_sensor_that_cannot_be_opened_comes_when_it_comes() -> None:
    """What its ``open`` raises makes it lost, and it is tried again."""

    class Late(rules.Sonar):
        tries = 0

        def open(self):
            self.tries += 1
            if self.tries < 3:
                raise OSError(5, "not there yet")

    sonar, motor = Late(0.5), rules.Motor()
    sonar.name = "sonar"

    async with esair.Robot(resources=[sonar, motor], behaviors=[rules.Go()]) as robot:
        assert robot.resources.query("sonar").state is esair.ResourceState.LOST
        await asyncio.sleep(10.0)
        assert robot.resources.query("sonar").state is esair.ResourceState.READY
        assert motor.told[-1] == 0.5


@pytest.mark.real_clock
async def test_a_read_that_hangs_holds_nothing_up() -> None:
    """It hangs on its own thread; removing the sensor and the stop return in time."""
    go_on = threading.Event()

    class Stuck(rules.Sonar):
        deadline = 0.05

        def read(self):
            go_on.wait(30.0)
            return 0.5

    sonar = Stuck()
    sonar.name = "sonar"
    motor = rules.Motor()
    try:
        async with asyncio.timeout(10.0):
            robot = esair.Robot(
                resources=[sonar, motor], behaviors=[rules.Go()], grace=0.1
            )
            async with robot:
                await asyncio.sleep(0.1)
                await robot.resources.remove("sonar")
                await robot.behaviors.add(esair.Behavior(name="alive"))
    finally:
        go_on.set()

    assert set(motor.told) == {0.0}


def test_reactions_of_std_run_in_min() -> None:
    """The other way round: what imports esair, with plain devices."""

    class Avoid(esair.Reaction):
        sonar = esair.reads(float, max_age=0.5)
        wheels = esair.writes(float, priority=10)

        def react(self, sonar: float) -> float | None:
            return 0.25 if sonar < 0.4 else None

    class Sonar(esair.Sensor[float]):
        rate = 50.0

        def read(self) -> float:
            return 0.25

    class Wheels(esair.Actuator[float]):
        safe = 0.0

        def write(self, command: float) -> None:
            told.append(command)

    told: list[float] = []
    loop = minimal.Loop([Avoid()], [Sonar()], [Wheels()], rate=50)
    loop.step()

    assert told == [0.0, 0.25]


@pytest.mark.promise("PRO-1")
def test_a_reaction_of_std_that_is_blind_in_min_holds_as_in_std() -> None:
    """What it has not said of that means the same: lower priorities are refused."""

    class Avoid(esair.Reaction):
        motor = esair.writes(float, priority=10)
        sonar = esair.reads(float)

        def react(self, sonar: float) -> float | None:
            return None

    class Drive(minimal.Reaction):
        motor = minimal.writes(float)
        rate = 50

        def react(self) -> float:
            return 0.5

    sonar, motor = rules.Sonar(0.5), rules.Motor()
    loop = minimal.Loop([Avoid(), Drive()], [sonar], [motor], rate=50)
    loop.step()
    assert motor.told[-1] == 0.5
    sonar.values = [OSError("unplugged")]
    for _ in range(200):
        loop.step()

    assert motor.told[-1] == 0.0


@pytest.mark.virtual_clock
async def test_a_file_names_them(tmp_path) -> None:
    """robot.toml takes classes of MIN, their keywords and their attributes."""
    (tmp_path / "parts_of_min.py").write_text(
        textwrap.dedent(
            """
            from esair.minimal import Actuator, Reaction, Sensor, reads, writes

            class Sonar(Sensor):
                def __init__(self, pin, name=None):
                    Sensor.__init__(self, name)
                    self.pin = pin

                def read(self):
                    return 0.1

            class Motor(Actuator):
                safe = 0.0

                def write(self, command):
                    pass

            class Go(Reaction):
                near = 0.5
                sonar = reads(float, max_age=0.5)
                motor = writes(float)

                def react(self, sonar):
                    return 0.25 if sonar < self.near else None
            """
        )
    )
    (tmp_path / "robot.toml").write_text(
        textwrap.dedent(
            """
            [sensor.sonar]
            driver = "parts_of_min:Sonar"
            pin = 3
            rate = 20

            [actuator.motor]
            driver = "parts_of_min:Motor"
            command_timeout = 0.5

            [behavior.go]
            driver = "parts_of_min:Go"
            near = 0.2
            """
        )
    )
    robot = esair.Robot.from_config(tmp_path / "robot.toml")

    async with robot:
        await asyncio.sleep(0.3)
        sonar = robot.resources.get("sonar")
        assert sonar.device.pin == 3
        assert sonar.settings["rate"] == 20.0
        assert robot.resources.get("motor").command_timeout == 0.5
        assert robot.resources.why("motor").holder == "go"


@pytest.mark.promise("MIN-3")
@pytest.mark.virtual_clock
async def test_a_guard_of_min_guards_in_std(fake_sensor, fake_actuator) -> None:
    """What it lets pass, and what while it is blind."""

    class Half(minimal.Reaction):
        eye = minimal.reads(float, max_age=0.2)
        motor = minimal.guards(float)

        def react(self, eye, motor):
            return motor / 2

        def blind(self, motor):
            return motor / 8

    eye: FakeSensor[float] = fake_sensor("eye", 1.0, rate=20.0)
    sonar: FakeSensor[float] = fake_sensor("sonar", 1.0, rate=20.0)
    motor: FakeActuator[float] = fake_actuator("motor", safe=0.0)

    async with esair.Robot(
        resources=[eye, sonar, motor], behaviors=[Half(), rules.Go()]
    ):
        await motor.until(0.5, timeout=1.0)
        eye.unplug()
        await motor.until(0.125, timeout=1.0)
