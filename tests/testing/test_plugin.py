"""The pytest plugin, in projects of its users."""

from __future__ import annotations

import asyncio
import sys
import threading
import time

import pytest

from esair.testing import Leaks

SCOPES = ["function", "class", "module", "package", "session"]


@pytest.fixture
def outcomes(pytester: pytest.Pytester):
    """Run the tests of a file as a project of its own; return how they ended."""

    def run(source: str, *options: str) -> dict[str, int]:
        pytester.makepyfile(
            "import asyncio, os, threading, time\nimport esair, pytest\n" + source
        )
        result = pytester.runpytest_inprocess(
            "-p",
            "no:cacheprovider",
            "--strict-markers",
            "-o",
            "asyncio_mode=auto",
            "-o",
            "asyncio_default_fixture_loop_scope=function",
            *options,
        )
        return result.parseoutcomes()

    return run


@pytest.mark.parametrize(
    "head",
    [
        "async def test_it(fake_sensor):",
        "async def test_it(fake_actuator):",
        "async def test_it(fake_serial):",
        "async def test_it(fake_can):",
        "async def test_it(fake_i2c):",
        "@pytest.mark.virtual_clock\nasync def test_it():",
    ],
)
def test_who_uses_the_kit_runs_on_a_virtual_clock(outcomes, head) -> None:
    """A day passes at once, in the time of the loop."""
    source = f"""
{head}
    loop, began = asyncio.get_running_loop(), time.monotonic()
    before = loop.time()
    await asyncio.sleep(86400.0)
    assert loop.time() - before == pytest.approx(86400.0)
    assert time.monotonic() - began < 60.0
"""
    assert outcomes(source)["passed"] == 1


@pytest.mark.parametrize(
    "head",
    [
        "@pytest.mark.real_clock\nasync def test_it(fake_sensor):",
        "@pytest.mark.real_clock\n@pytest.mark.virtual_clock\nasync def test_it():",
        "async def test_it():",
    ],
)
def test_others_run_in_real_time(outcomes, head) -> None:
    """Those that say so, and those that have nothing to do with the kit."""
    source = f"""
{head}
    began = time.monotonic()
    await asyncio.sleep(0.05)
    assert time.monotonic() - began > 0.04
"""
    assert outcomes(source)["passed"] == 1


ANYIO = """
@pytest.fixture
def anyio_backend():
    return "asyncio"

@pytest.mark.anyio
"""


@pytest.mark.parametrize(
    ("head", "mode"), [(ANYIO, "strict"), (ANYIO, "auto"), ("", "strict")]
)
def test_who_would_not_run_on_the_virtual_clock_fails(outcomes, head, mode) -> None:
    """anyio's plugin has the real clock; in the mode strict nothing runs the last one."""
    source = head + "async def test_it(fake_sensor):\n    pass\n"

    assert outcomes(source, "-o", f"asyncio_mode={mode}") == {"errors": 1}


def test_a_plain_test_is_told_that_it_has_no_virtual_clock(outcomes, capsys) -> None:
    """It would wait in real time; beside asynchronous ones in a class it may stand."""
    plain = "@pytest.mark.virtual_clock\ndef test_it():\n    pass\n"
    assert outcomes(plain) == {"errors": 1}
    assert "only async def runs" in capsys.readouterr().out

    module = "pytestmark = pytest.mark.virtual_clock\ndef test_it():\n    pass\n"
    assert outcomes(module) == {"passed": 1}


CASE = """
import unittest

class TestIt(unittest.IsolatedAsyncioTestCase):
    @pytest.fixture(autouse=True)
    def devices(self, fake_sensor):
        self.sonar = fake_sensor("sonar", 1.0)

    async def test_it(self):
        assert self.sonar.name == "sonar"
"""


def test_a_case_of_unittest_is_told_what_to_write(outcomes, capsys) -> None:
    """pytest-asyncio does not run it, whatever its mode."""
    assert outcomes(CASE) == {"errors": 1}
    assert "a plain class" in capsys.readouterr().out


def test_a_case_of_unittest_may_have_the_real_clock(outcomes) -> None:
    """It has a loop of its own."""
    source = CASE.replace("class TestIt", "@pytest.mark.real_clock\nclass TestIt")

    assert outcomes(source) == {"passed": 1}


LEAKS = {
    "task": "asyncio.get_running_loop().create_task(asyncio.sleep(1e6))",
    "thread": "threading.Thread(target=OVER.wait).start()",
    "descriptor": "OPEN.append(os.open(os.devnull, os.O_RDONLY))",
}


@pytest.mark.parametrize(
    ("what", "scope"),
    [("task", scope) for scope in SCOPES]
    + [
        pytest.param(what, scope, marks=pytest.mark.long)  # it is given seconds to end
        for what in ("thread", "descriptor")
        for scope in SCOPES[::4]
    ],
)
def test_what_a_test_leaves_behind_fails_it(outcomes, what, scope) -> None:
    """Its neighbors, which clean up, pass; also where they share an event loop."""
    source = f"""
pytestmark = pytest.mark.asyncio(loop_scope={scope!r})
OVER, OPEN = threading.Event(), []

def teardown_module():
    OVER.set()
    for number in OPEN:
        os.close(number)

async def clean(fake_sensor):
    async with esair.Robot(resources=[fake_sensor("sonar", 1.0)]):
        await asyncio.sleep(1.0)

class TestIt:
    async def test_before(self, fake_sensor):
        await clean(fake_sensor)

    async def test_leaks(self, fake_sensor):
        {LEAKS[what]}

    async def test_after(self, fake_sensor):
        await clean(fake_sensor)
"""
    assert outcomes(source, "-rE") == {"passed": 3, "errors": 1}


@pytest.mark.parametrize("shared", SCOPES[1:])
def test_what_tests_share_is_no_leak_of_the_first_one(outcomes, shared) -> None:
    """It is made for the first one, and is there until the last one has ended."""
    source = f"""
@pytest.fixture(scope={shared!r})
def file():
    number = os.open(os.devnull, os.O_RDONLY)
    yield number
    os.close(number)

class TestIt:
    async def test_one(self, fake_sensor, file):
        pass

    async def test_two(self, fake_sensor, file):
        pass
"""
    assert outcomes(source) == {"passed": 2}


def test_the_default_scope_of_the_project_counts(outcomes) -> None:
    """A loop that all tests share is not what the first one left behind."""
    source = """
async def test_one(fake_sensor):
    pass

async def test_two(fake_sensor):
    pass
"""
    shared = ("-o", "asyncio_default_test_loop_scope=session")

    assert outcomes(source, *shared) == {"passed": 2}


ORDER = """
{marker}
async def test_it(fake_sensor):
    order = []

    async def note(number):
        for _ in range(3):
            order.append(number)
            await asyncio.sleep(0)

    await asyncio.gather(*(note(number) for number in range(5)))
    with open("order.txt", "a") as file:
        print(order, file=file)
"""


def orders(outcomes, pytester: pytest.Pytester, marker: str, *seeds: int) -> list[str]:
    for seed in seeds:
        assert outcomes(ORDER.format(marker=marker), f"--esair-seed={seed}")
    return (pytester.path / "order.txt").read_text().splitlines()


def test_a_seed_repeats_an_order_of_tasks(outcomes, pytester) -> None:
    """0 keeps the order in which they are ready; each other seed has its own."""
    plain, one, again, two = orders(outcomes, pytester, "", 0, 1, 1, 2)

    assert plain == str([number for _ in range(3) for number in range(5)])
    assert one == again
    assert len({plain, one, two}) == 3


def test_the_seed_of_a_marker_counts_more(outcomes, pytester) -> None:
    """So one test can keep the order in which it once failed."""
    marker = "@pytest.mark.virtual_clock(seed=1)"
    one, two = orders(outcomes, pytester, marker, 0, 2)

    assert one == two


def test_pytest_works_without_pytest_asyncio(pytester, monkeypatch) -> None:
    """Who installs esair and pytest alone can run plain tests, with the fixtures."""
    pytester.makepyfile(
        "def test_it(fake_sensor):\n    assert fake_sensor('sonar', 1.0).name == 'sonar'\n"
    )
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    result = pytester.run(
        sys.executable,
        "-c",
        "import sys; sys.modules['pytest_asyncio'] = None; import pytest; "
        "sys.exit(pytest.main(['-p', 'esair.testing.plugin', '-p', 'no:cacheprovider']))",
    )
    assert result.ret == 0
    result.assert_outcomes(passed=1)


def test_pytest_asyncio_that_is_switched_off_is_as_one_that_is_not_there(
    outcomes,
) -> None:
    """Plain tests run; one for the virtual clock fails, and never runs on another."""
    source = """
def test_plain(fake_sensor):
    assert fake_sensor("sonar", 1.0).name == "sonar"

async def test_it(fake_sensor):
    pass
"""
    unknown_ini = ("-W", "ignore::pytest.PytestConfigWarning")
    found = outcomes(source, "-p", "no:asyncio", *unknown_ini)

    assert found == {"passed": 1, "errors": 1}


@pytest.mark.real_clock
async def test_what_a_thread_begins_at_its_end_may_end_too() -> None:
    """It told the loop of its end; the task that came of it needs some turns."""
    leaks, loop = Leaks(), asyncio.get_running_loop()
    begun: list[asyncio.Task[None]] = []

    async def take_turns() -> None:
        for _ in range(5):
            await asyncio.sleep(0)

    def begin() -> None:
        begun.append(loop.create_task(take_turns()))

    def ends_late() -> None:
        time.sleep(0.05)
        loop.call_soon_threadsafe(begin)

    threading.Thread(target=ends_late).start()

    assert await leaks.check() == []
    assert begun[0].done()


@pytest.mark.real_clock
async def test_a_file_that_a_thread_reads_just_now_is_no_leak():
    """One from before the test, which writes a stack into the log, for example."""
    opened, go = threading.Event(), threading.Event()

    def read_slowly() -> None:
        go.wait()
        with open(__file__, encoding="utf-8"):
            opened.set()
            time.sleep(0.05)

    reader = threading.Thread(target=read_slowly)
    reader.start()
    leaks = Leaks()
    go.set()
    opened.wait()
    assert await leaks.check() == []
    reader.join()


@pytest.mark.virtual_clock
async def test_a_thread_that_is_just_being_started_is_waited_for():
    """Python lists it before it can be joined."""
    go = threading.Event()

    class Starting(threading.Thread):
        """Cannot be joined when that is tried for the first time."""

        asked = 0

        def join(self, timeout: float | None = None) -> None:
            self.asked += 1
            if self.asked == 1:
                raise RuntimeError("cannot join thread before it is started")
            go.set()
            super().join(timeout)

    leaks = Leaks()
    Starting(target=go.wait).start()
    assert await leaks.check() == []
