"""What the tests of the network have in common."""

from __future__ import annotations

import functools
import json
import os
import threading

import pytest
from tests.net.parts import free_port

from esair.buses.peer import Network
from esair.buses.peer._zenoh import _THREADS


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Let zenoh have its threads before it is looked at what a test leaves behind."""
    if item.path.stem in {"test_zenoh", "test_config", "test_lever"}:
        speak_once()


@functools.cache
def speak_once() -> None:
    """Zenoh keeps its threads for ever, once two sessions have spoken with each other."""
    import zenoh

    os.environ.setdefault("ZENOH_RUNTIME", f"({_THREADS})")  # as a robot does
    end, sessions = f"tcp/127.0.0.1:{free_port()}", []
    for network in (
        Network(me="one", peers=["other"], listen=[end]),
        Network(me="other", peers=["one"], connect=[end]),
    ):
        config = zenoh.Config()
        ends = {"listen": network.listen, "connect": network.connect}
        for key, value in network.settings(**ends).items():
            config.insert_json5(key, json.dumps(value))
        sessions.append(zenoh.open(config))
    heard = threading.Event()
    subscriber = sessions[0].declare_subscriber("warm", lambda _: heard.set())
    while not heard.wait(0.02):
        sessions[1].put("warm", b"")
    subscriber.undeclare()
    for session in sessions:
        session.close()
