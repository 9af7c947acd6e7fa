"""What sensors and actuators have in common on their way to the connection."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, NamedTuple

from esair.connections._call import Call, given_up
from esair.connections._calls import Calls
from esair.connections._driver import Driver
from esair.connections._operations import Operating, Operations
from esair.connections._registrations import Registrations
from esair.exceptions import DeviceLostError, EsairError, ResourceRemovedError
from esair.loop import clock_of
from esair.messages import ResourceState
from esair.resources import Resource


class OfRobot(NamedTuple):
    """What a device needs of its robot."""

    registrations: Registrations
    on_error: Callable[[Exception], None]  # told what its calls meet
    left: set[Call]  # gets each abandoned call while it is alive


class Device:
    """One device: its driver, the calls of that, and its state."""

    # Slots: a thousand of these are touched a hundred times a second.
    __slots__ = (
        "_journal",
        "_left",
        "_loop",
        "_on_error",
        "calls",
        "driver",
        "error",
        "name",
        "operations",
        "registrations",
        "state",
        "time",
    )

    # Of those that know what it is for.
    configured: Callable[[], None]
    down: Callable[[ResourceState, EsairError], None]
    operated: Callable[[Call | None], None]
    operating: Callable[[Operating, Call], None]
    ready_for: Callable[[Operating], bool]
    _late: Callable[[Call], None]

    def __init__(self, resource: Resource, robot: OfRobot) -> None:
        self.name = resource.name
        self.state = ResourceState.CLOSED
        self.error: EsairError | None = None
        self.registrations, self._on_error, self._left = robot
        self._journal = self.registrations.journal
        self._loop = loop = asyncio.get_running_loop()
        self.time = clock_of(loop)
        self.operations = Operations(self, loop, self._on_error)
        self.attach(resource)

    def attach(self, resource: Any) -> None:
        """Ask or write this one from now on; it is not ready yet."""
        self.driver = Driver(resource)
        self.calls = Calls(
            self.driver,
            self._loop,
            on_late=self._late,
            on_stuck=lambda call: self._on_error(given_up(call)),
            left=self._left,
        )
        self.configured()

    def absence(self) -> EsairError:
        """Return what whoever needs the device gets while it is not ready."""
        error = self.error or DeviceLostError(self.name, f"it is {self.state.value}")
        # Anew: else each who asks would leave its frames in the traceback.
        return error.with_traceback(None)

    def removed(self) -> None:
        """The user took the device away."""
        self.down(ResourceState.REMOVED, ResourceRemovedError(self.name))
