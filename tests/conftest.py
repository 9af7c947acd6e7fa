"""What every test of esair itself gets."""

from __future__ import annotations

import collections
import compileall
import contextlib
import importlib.abc
import importlib.util
import inspect
import os
import shutil
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from tests import patience
from tests.leaks import OwnLeaks

import esair
from esair.testing import ActuatorContract, SensorContract
from esair.testing.plugin import uses_kit

pytest_plugins = ["pytester"]


def pytest_configure(config: pytest.Config) -> None:
    """Describe the markers that tie a test to the contract or the fault catalogue."""
    config.addinivalue_line("markers", "promise(*ids): proves promises of the contract")
    config.addinivalue_line(
        "markers", "fault(*ids): proves the right behavior on faults"
    )
    config.addinivalue_line("markers", "xdist_group(name): kept on one worker")
    config.addinivalue_line("markers", "long: too long for every run (--esair-long)")
    config.addinivalue_line("markers", "longer: does more with --esair-long")
    config.addinivalue_line("markers", "soak: too long for that too (--esair-soak)")
    options = "--esair-long", "--esair-soak"
    patience.measures = any(map(config.getoption, options))
    has_compiled = not sys.dont_write_bytecode
    sys.dont_write_bytecode = False  # of this process; its children read their own
    import hypothesis  # pytest rewrites it: not in each worker

    # The same examples in every run; --esair-soak looks for new ones.
    hypothesis.settings.register_profile(
        "same",
        derandomize=True,
        deadline=None,
        max_examples=100 if config.getoption("--esair-long") else 25,
    )
    if not config.getoption("--esair-soak"):
        hypothesis.settings.load_profile("same")
    _let_children_hear_signals()
    # The control sockets of the robots in the tests, of children too.
    sockets = os.environ["XDG_RUNTIME_DIR"] = tempfile.mkdtemp(prefix="esair-sockets-")
    config.add_cleanup(lambda: shutil.rmtree(sockets, ignore_errors=True))
    if not has_compiled and not hasattr(config, "workerinput"):
        # Each of hundreds of children would compile the package anew.
        compileall.compile_dir(Path(esair.__file__).parent, quiet=2)
    _keep_what_is_rewritten(config)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Look for what only the tests of esair itself can leave behind."""
    # Not above: older pytests want to rewrite a plugin before anybody imports it.
    from esair.testing import _asyncio_plugin

    plugins = session.config.pluginmanager
    terminal = plugins.getplugin("terminalreporter")
    if terminal is not None and not hasattr(session.config, "workerinput"):
        plugins.register(Namer(terminal))
    _asyncio_plugin.Leaks = OwnLeaks  # type: ignore[misc, assignment]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Leave what is long to its own run; keep what a file does in real time together.

    Most of what needs real time waits: for a process to start, for a time-out. It runs
    on one worker, one test after the other, and those of other files meanwhile.
    """
    for item in items:
        waits = inspect.iscoroutinefunction(getattr(item, "obj", None))
        if waits and not uses_kit(item):
            told = f"{item.nodeid}: mark it virtual_clock or real_clock"
            raise pytest.UsageError(told)
        where = getattr(item, "callspec", None)
        if where is not None and where.params.get("place") == "process":
            item.add_marker("long")  # each has a process to start
    if not config.getoption("--esair-soak"):
        for item in items:
            if item.get_closest_marker("soak") is not None:
                item.add_marker(pytest.mark.skip(reason="hours: --esair-soak"))
    if config.getoption("--esair-long"):
        config.hook.pytest_deselected(items=[i for i in items if not _is_longer(i)])
        items[:] = [item for item in items if _is_longer(item)]
    elif not config.getoption("--esair-soak"):
        too_long = pytest.mark.skip(reason="too long for every run: --esair-long")
        for item in items:
            if item.get_closest_marker("long") is not None:
                item.add_marker(too_long)
    for item in items:
        if item.get_closest_marker("real_clock") is not None:
            item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))


def _is_longer(item: pytest.Item) -> bool:
    """Whether --esair-long does more of it than every run does."""
    return any(
        item.get_closest_marker(marker) is not None for marker in ("long", "longer")
    ) or getattr(getattr(item, "obj", None), "is_hypothesis_test", False)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    """Have no driver of esair skip a test of its contract: what holds is said there."""
    report = yield
    suite = getattr(item, "cls", None)
    is_ours = isinstance(suite, type) and issubclass(
        suite, ActuatorContract | SensorContract
    )
    is_late = "too long for every run" in str(report.longrepr)
    if (
        report.skipped
        and is_ours
        and not is_late
        and item.path.parent.name == "drivers"
    ):
        report.outcome = "failed"
        report.longrepr = f"a driver skips its contract: {report.longrepr}"
    return report


class Namer:
    """Names each failure as it happens, not when all is over."""

    def __init__(self, terminal: Any) -> None:
        self.terminal = terminal

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            when = "" if report.when == "call" else f", in its {report.when}"
            self.terminal.write(f"\nFAILED {report.nodeid}{when}\n", red=True)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say in a few lines what was skipped, and why: the most of it first."""
    reasons: collections.Counter[str] = collections.Counter()
    for report in terminalreporter.stats.get("skipped", []):
        where = report.longrepr
        reason = where[2] if isinstance(where, tuple) else str(where)
        reasons[reason.removeprefix("Skipped: ")] += 1
    if not reasons:
        return
    terminalreporter.section(f"{reasons.total()} skipped")
    for reason, number in reasons.most_common():
        terminalreporter.write_line(f"{number:4} {reason}")


def _keep_what_is_rewritten(config: pytest.Config) -> None:
    """Rewrite the assertions of each file once, and not once in each worker.

    A worker begins with its own share, so that it finds most of the others' done when
    it collects.
    """
    worker = getattr(config, "workerinput", None)
    rewriting = config.pluginmanager.rewrite_hook
    if worker is None or not isinstance(rewriting, importlib.abc.Loader):
        return
    number, workers = int(worker["workerid"][2:]), worker["workercount"]
    for path in sorted(Path(__file__).parent.rglob("test_*.py"))[number::workers]:
        spec = importlib.util.spec_from_file_location(path.stem, path, loader=rewriting)
        assert spec is not None
        module = importlib.util.module_from_spec(spec)
        module.__builtins__ = {}  # it ends at its first import: only its code is wanted
        with contextlib.suppress(Exception):  # a mistake shows when it is collected
            rewriting.exec_module(module)


def _let_children_hear_signals() -> None:
    """Undo what nohup and ``&`` do: a signal that is ignored stays so in a child.

    One with a handler is reset when a program begins: Python's own for an interrupt.
    """
    handlers = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGHUP: lambda *_: None,
    }
    for number, handler in handlers.items():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options for long runs."""
    parser.addoption(
        "--esair-soak", action="store_true", help="many more random examples"
    )
    parser.addoption(
        "--esair-long",
        action="store_true",
        help="just what is too long for every run; minutes",
    )
