"""Whether a command may leave: the verdict over all combinations of what decides it."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

import esair
from esair.connections import Halt, Protection, Registration, Terms
from esair.connections._gate import BeingReplacedError, Gate, Hold, explain, verdict
from esair.messages import Access, Refused, ResourceState

pytestmark = pytest.mark.promise("AC-3", "PRO-6", "PRO-2")

NOW = 100.0
ASKED = 7  # halts when the command was asked for
OWN = "writer"  # whose command it is


def right(behavior: str, priority: int, *, usable: bool = True) -> Registration:
    access = Access.WRITE if usable else Access.CONFIGURE
    return Registration(1, Terms(behavior, "wheels", access, priority))


def hold(component: str, priority: int) -> Protection:
    entry = Protection(component, "wheels", priority)
    entry.since = 1.0
    return entry


class Device:
    """What the gate looks at, without a driver."""

    def __init__(self) -> None:
        self.name = "wheels"
        self.state = ResourceState.READY
        self.error: esair.EsairError | None = None
        self.registrations: Any = SimpleNamespace(
            halt=None,
            refusal=lambda it: esair.NotRegisteredError(it.behavior, "wheels"),
        )

    def absence(self) -> esair.EsairError:
        return self.error or esair.DeviceLostError("wheels")


def gates() -> Iterator[tuple[Gate, list[str]]]:
    """Yield each gate that may be shut, with why, the first reason first."""
    errors: Sequence[tuple[str, Any]] = [
        ("", None),
        ("replaced", BeingReplacedError("wheels", "another one comes")),
        ("absent", esair.DeviceLostError("wheels")),
    ]
    for latched, halted, asked, (why, error), ready in itertools.product(
        (False, True), (False, True), (False, True), errors, (True, False)
    ):
        device: Any = Device()
        gate = Gate(device)
        gate.latched, gate.halts = latched, ASKED + asked
        device.registrations.halt = Halt("look", 1.0) if halted else None
        device.state = ResourceState.READY if ready else ResourceState.LOST
        device.error = error
        reasons = [
            *(["stopping"] if latched else []),
            *(["halt"] if halted else []),
            *(["before"] if asked else []),
            *([why] if why else []),
            *([] if ready else ["absent"]),
        ]
        yield gate, reasons


def said(found: Any) -> str:
    """Name what the verdict has returned."""
    if found is None:
        return ""
    if isinstance(found, Refused):
        assert not found  # false in a condition: it is compared with None
        if found.holder == "halt":
            return "halt" if found.rule == "look" else "before"
        return "replaced" if found.holder == "user" else f"held by {found.holder}"
    return {
        esair.StoppingError: "stopping",
        esair.NotRegisteredError: "void",
        esair.DeviceLostError: "absent",
    }[type(found)]


HOLDS = [hold(name, p) for name in (OWN, "other") for p in (3, 5, 7)]
"""Blind holds, one's own and others', below, at and above the priority of the command."""


def combinations() -> list[tuple[Protection, ...]]:
    """Return none, each, all pairs and all triples of holds, the highest first."""
    found = [
        each
        for size in range(4)
        for each in itertools.combinations_with_replacement(HOLDS, size)
    ]
    return [tuple(sorted(each, key=lambda it: -it.priority)) for each in found]


def holders() -> Iterator[tuple[Hold, Registration, str]]:
    """Yield each way to be held, the right of who writes, and who keeps it away."""
    mine = right(OWN, 5)
    none = Hold()
    yield none, mine, ""
    for other, keeps in (
        (mine, False),
        (right(OWN, 9), False),  # another right of the same behavior
        (right("other", 3), False),
        (right("other", 5), True),
        (right("other", 9), True),
    ):
        for over in (False, True):
            held = Hold()
            held.holder = held.writer = other
            held.begun, held.seconds = NOW - 1.0, 1.0 if over else 2.0
            yield held, mine, other.behavior if keeps and not over else ""


def test_what_shuts_the_gate_comes_in_one_order() -> None:
    """A void right, the stop, the halt, a halt since, a replacement, an absence."""
    held = Hold()
    held.holder, held.begun, held.seconds = right("other", 9), NOW, 1.0
    count = 0
    for (gate, reasons), blind, usable, operates, stands in itertools.product(
        gates(), (False, True), (True, False), (True, False), (True, False)
    ):
        gate = copy.copy(gate)
        gate.holds = (HOLDS[-1],) if blind else ()
        by = None if stands else right(OWN, 5, usable=usable)
        expected = list(reasons)
        if by is not None:
            if not (usable or operates):
                expected.insert(0, "void")
            expected.append("held by other")
        terms = {"operates": True} if operates else {}
        found = verdict(gate, held, by, NOW, ASKED, **terms)
        assert said(found) == (expected[0] if expected else ""), expected
        if asked_now := [each for each in expected if each != "before"]:
            found = verdict(gate, held, by, NOW, **terms)
            assert said(found) == asked_now[0]
        count += 1
    assert count == 48 * 16


@pytest.mark.parametrize("operates", [False, True])
def test_each_blind_hold_is_asked_and_then_the_holder(operates: bool) -> None:
    """All single ones, pairs and triples, one's own too; what is still passes them."""
    gate = Gate(Device())  # type: ignore[arg-type]
    for holds, (held, mine, keeper), is_still in itertools.product(
        combinations(), list(holders()), (False, True)
    ):
        gate.holds = holds
        against = [each for each in holds if each.priority >= mine.priority]
        expected = f"held by {keeper}" if keeper else ""
        if against and not is_still:
            expected = f"held by {against[0].component}"
        found = verdict(gate, held, mine, NOW, operates=operates, is_still=is_still)
        assert said(found) == expected, (holds, held.holder, is_still)
        if against and not is_still:
            assert isinstance(found, Refused)
            assert (found.priority, found.until) == (against[0].priority, None)


def test_a_verdict_changes_nothing_and_a_plain_gate_has_none() -> None:
    """The shortcut of a write is right: a plain gate leaves the right and the holder."""
    for gate, _reasons in gates():
        for holds in ((), (HOLDS[0],)):
            gate.holds = holds
            before = {name: getattr(gate, name) for name in gate.__slots__}
            found = verdict(gate, Hold(), right(OWN, 2), NOW)
            assert gate.is_plain is (found is None)
            assert before == {name: getattr(gate, name) for name in gate.__slots__}


@pytest.mark.parametrize("change", ["halts", "fence", "right"])
def test_a_ticket_is_void_once_anything_has_shut_the_gate(change: str) -> None:
    """A thread that is about to call the driver asks it at the last moment."""
    gate = Gate(Device())  # type: ignore[arg-type]
    mine = right(OWN, 5)
    may, stands = gate.ticket(mine), gate.ticket(None)
    assert may()
    assert stands()
    if change == "right":
        mine.end(None)
    else:
        setattr(gate, change, getattr(gate, change) + 1)
    assert not may()
    assert stands() is (change == "right")


def test_who_is_told_to_hold_it_is_who_keeps_commands_away() -> None:
    """A blind hold before a holder of its own priority, a holder above it before that."""
    for priority, by in ((4, "other"), (5, "other"), (6, OWN)):
        device: Any = Device()
        gate, held = Gate(device), Hold()
        gate.holds = (hold("other", 5),)
        held.holder, held.begun, held.seconds = right(OWN, priority), NOW, 1.0
        assert explain(gate, held, NOW, None, is_safe=False).holder == by


def test_a_thread_may_begin_until_the_moment_when_its_command_expires(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Unless the gate was shut meanwhile, or the right has ended."""
    device: Any = Device()
    device.loop = object()
    clocks = {device.loop: lambda: NOW}
    monkeypatch.setattr("esair.connections._gate.clock_beside", clocks.__getitem__)
    gate = Gate(device)
    for expires, may in (
        (None, True),
        (NOW + 0.5, True),
        (NOW, True),
        (NOW - 0.5, False),
    ):
        assert gate.ticket(None, expires)() is may
    mine = right(OWN, 5)
    for change in ("halts", "fence"):
        ticket = gate.ticket(mine)
        assert ticket()
        setattr(gate, change, getattr(gate, change) + 1)
        assert not ticket()
    ticket = gate.ticket(mine)
    mine.end(None)
    assert not ticket()
