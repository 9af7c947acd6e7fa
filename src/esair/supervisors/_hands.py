"""What a behavior has in its hands while it runs: its supervisor, ports, requests."""

from __future__ import annotations

import types
from collections.abc import Mapping
from typing import Any

from esair.actions import (
    Behavior,
    Reaction,
    RequestPort,
    Takes,
    ThreadBehavior,
    blocking,
)
from esair.loop import Portal
from esair.supervisors._grants import Grants
from esair.supervisors._request_queue import RequestQueue

_METHODS = (
    "put",
    "get",
    "ask",
    "receive",
    "receive_from",
    "offer",
    "perform",
    "register",
    "stop_robot",
)
"""What a plain behavior calls in its thread, and others await."""


def fill(
    behavior: Behavior,
    host: Any,
    grants: Grants,
    queues: Mapping[Any, RequestQueue],
    portal: Portal | None,
) -> None:
    """Give a behavior what it declares; with a portal all of it waits, in its thread."""
    behavior._host = host  # noqa: SLF001 - the behavior's own supervisor
    if portal is not None and not isinstance(behavior, ThreadBehavior):
        for name in _METHODS:
            method = getattr(ThreadBehavior, name)
            behavior.__dict__[name] = types.MethodType(method, behavior)
    for attribute, need in behavior.needs.items():
        port: Any = grants.declare(attribute, need)
        behavior.__dict__[attribute] = blocking(port, portal) if portal else port
    for attribute, each in behavior.takes.items():
        if isinstance(each, Takes):
            requests: Any = RequestPort(queues[each.type])
            behavior.__dict__[attribute] = (
                requests.blocking(portal) if portal else requests
            )


def empty(behavior: Behavior | Reaction, host: Any, portal: Portal | None) -> None:
    """Take a behavior its supervisor, if it has not another one by now."""
    if isinstance(behavior, Reaction) or behavior._host is not host:  # noqa: SLF001 - the behavior's own supervisor
        return
    behavior._host = None  # noqa: SLF001 - the behavior's own supervisor
    if portal is not None:
        for method in _METHODS:
            behavior.__dict__.pop(method, None)
