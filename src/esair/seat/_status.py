"""What a robot is doing, in one picture: what ``top`` and the page show."""

from __future__ import annotations

import collections
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from esair.actions import Reaction
from esair.buses import Bus
from esair.connections import HALT
from esair.exceptions import describe, in_short
from esair.loop import clock_of
from esair.messages import ResourceState, Why
from esair.recording import plain
from esair.resources import HIDDEN, Resource, operations_of, settings_of
from esair.seat._values import numbers_of, short

if TYPE_CHECKING:
    import asyncio

    from esair.standard import Robot

WINDOW = 2.0  # Over how many seconds a rate is the mean
AGAIN = 0.1  # How soon after one picture the next is another one, in seconds


class Status:
    """Takes pictures of a robot; costs nothing while nobody looks."""

    def __init__(self, robot: Robot, loop: asyncio.AbstractEventLoop) -> None:
        self._robot = robot
        self._time = clock_of(loop)
        self._begun = self._time()
        self._counted: collections.deque[tuple[float, dict[str, int]]] = (
            collections.deque(maxlen=64)
        )
        self._newest: dict[str, Any] | None = None
        self._operations: dict[type[Resource], list[dict[str, Any]]] = {}
        self._taken = 0.0

    def picture(self) -> dict[str, Any]:
        """Return what the robot is doing; many who look at a time share a picture."""
        now = self._time()
        if self._newest is not None and now < self._taken + AGAIN:
            return self._newest
        robot = self._robot
        counts = robot.journal.counts()
        done = {
            f"r {name}": counts.get(name, {}).get("readings", 0)
            + counts.get(name, {}).get("writes", 0)
            for name in robot.resources.names()
        }
        done |= {
            f"b {name}": counts.get(name, {}).get("steps", 0)
            for name in robot.behaviors.names()
        }
        rates = self._rates(done, now)
        self._taken = now
        self._newest = {
            "robot": robot.name,
            "time": now,
            "up": now - self._begun,
            "halted": robot.halted,
            "mode": robot.behaviors.mode,
            "modes": list(robot.behaviors.modes.table),
            "resources": self._resources(counts, rates, now),
            "behaviors": self._behaviors(counts, rates),
        }
        return self._newest

    def _resources(
        self,
        counts: Mapping[str, Mapping[str, int]],
        rates: Mapping[str, float],
        now: float,
    ) -> list[dict[str, Any]]:
        robot, found = self._robot, []
        for name in sorted(robot.resources.names()):
            status, counted = robot.resources.query(name), counts.get(name, {})
            resource = robot.resources.get(name)
            # A driver may call something else its bus: a file, whose name is a path.
            bus = resource.bus if isinstance(resource.bus, Bus) else None
            if type(resource) not in self._operations:
                self._operations[type(resource)] = _operations(type(resource))
            row: dict[str, Any] = {
                "name": name,
                "kind": "sensor",
                "state": status.state.value,
                "error": "" if status.error is None else in_short(status.error)[:400],
                "rate": rates.get(f"r {name}"),
                "age": None,
                "late": counted.get("late", 0) + counted.get("missed", 0),
                "placement": status.placement,
                "pid": status.pid,
                "losses": status.losses,
                "faults": status.faults,
                "refusals": counted.get("refusals", 0) + counted.get("bad", 0),
                "bus": None if bus is None else bus.name,
                "medium": None if bus is None else type(bus).__name__,
                "settings": settings(resource),
                "operations": self._operations[type(resource)],
                "numbers": {},
            }
            sensor = robot.sensors.channels.get(name)
            if sensor is not None and sensor.newest is not None:
                row["age"] = max(now - sensor.newest.time, 0.0)
                row["value"] = short(sensor.newest.value)
                row["numbers"] = numbers_of(sensor.newest.value)
            if name in robot.actuators.channels:
                why = robot.resources.why(name)
                row |= {
                    "kind": "actuator",
                    "holder": why.holder,
                    "priority": why.priority,
                    "rule": why.rule,
                    "stands": _why_it_stands(why),
                    "frees": why.frees,
                    "age": None if why.since is None else max(now - why.since, 0.0),
                    "value": short(why.last),
                    "numbers": numbers_of(why.last),
                    "writers": list(why.writers),
                    "guards": list(why.guards),
                }
                if status.state is not ResourceState.READY:
                    row["holder"] = None
            found.append(row)
        return found

    def _behaviors(
        self, counts: Mapping[str, Mapping[str, int]], rates: Mapping[str, float]
    ) -> list[dict[str, Any]]:
        behaviors, found = self._robot.behaviors, []
        for name in sorted(behaviors.names()):
            status = behaviors.query(name)
            reacts = isinstance(behaviors.action(name), Reaction)
            kind = "reaction" if reacts else "behavior"
            error = "" if status.error is None else describe(status.error)
            found.append(
                {
                    "name": name,
                    "kind": kind,
                    "state": status.state.value,
                    "detail": status.detail,
                    "error": error[:400],
                    "rate": rates.get(f"b {name}") if reacts else None,
                    "late": status.late + status.overruns,
                    "placement": status.placement,
                    "pid": status.pid,
                    "restarts": status.restarts,
                    "waiting": status.waiting,
                    "refusals": counts.get(name, {}).get("refused", 0),
                }
            )
        return found

    def _rates(self, counted: dict[str, int], now: float) -> dict[str, float]:
        """Return how many of each there were in a second, over the last few."""
        past = self._counted
        while past and past[0][0] < now - WINDOW:
            past.popleft()
        past.append((now, counted))
        then, before = past[0]
        if now - then < AGAIN:
            return {}
        return {
            name: max(number - before[name], 0) / (now - then)
            for name, number in counted.items()
            if name in before
        }


def _why_it_stands(why: Why) -> str:
    """Return what keeps an actuator safe, a halt or who is blind; empty if nothing."""
    if why.holder == HALT:
        return f"halted: {why.rule}"
    return why.rule if why.holder is not None and why.until is None else ""


def _operations(resource: type[Resource]) -> list[dict[str, Any]]:
    """Return the operations of a class of resources, and what they take."""
    return [
        {
            "name": name,
            "doc": each.doc,
            "parameters": [
                {
                    "name": taken.name,
                    "type": getattr(taken.type, "__name__", str(taken.type)),
                    "required": taken.required,
                    "default": plain(taken.default),
                }
                for taken in each.parameters
            ],
        }
        for name, each in operations_of(resource).items()
    ]


def settings(resource: Resource) -> list[dict[str, Any]]:
    """Return the settings of a resource with unit and limits."""
    return [
        {
            "name": name,
            "value": HIDDEN if each.secret else plain(getattr(resource, name)),
            "unit": each.unit,
            "min": _limit(each.min),
            "max": _limit(each.max),
            "choices": None if each.choices is None else plain(list(each.choices)),
            "type": each.type.__name__,
            "doc": each.doc,
        }
        for name, each in settings_of(type(resource)).items()
    ]


def _limit(limit: float | None) -> float | None:
    """Return a limit as JSON has it: one that is infinite is none."""
    return None if limit is None or math.isinf(limit) else plain(limit)
