"""What every test of esair itself gets."""

from __future__ import annotations

import os
import signal
import tempfile

import hypothesis
import pytest

pytest_plugins = ["pytester"]


def pytest_configure(config: pytest.Config) -> None:
    """Describe the markers that tie a test to the contract or the fault catalogue."""
    config.addinivalue_line("markers", "promise(*ids): proves promises of the contract")
    config.addinivalue_line(
        "markers", "fault(*ids): proves the right behavior on faults"
    )
    # The same examples in every run; --esair-soak looks for new ones.
    hypothesis.settings.register_profile("same", derandomize=True, deadline=None)
    if not config.getoption("--esair-soak"):
        hypothesis.settings.load_profile("same")
    _let_children_hear_signals()
    # The control sockets of the robots in the tests, of children too.
    os.environ["XDG_RUNTIME_DIR"] = tempfile.mkdtemp(prefix="esair-sockets-")


def _let_children_hear_signals() -> None:
    """Undo what nohup and ``&`` do: a signal that is ignored stays so in a child.

    One with a handler, even one that does nothing, is reset when a program begins.
    """
    for number in (signal.SIGINT, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, lambda *_: None)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for long runs of the random tests."""
    parser.addoption(
        "--esair-soak", action="store_true", help="many more random examples"
    )
