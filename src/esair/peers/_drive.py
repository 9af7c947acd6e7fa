"""A topic of ROS that moves an actuator: by registration and priority, as any behavior."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from esair.actions import Behavior, reads, writes
from esair.buses.peer import SILENCE
from esair.exceptions import BadValueError, DeviceLostError, StaleReadingError
from esair.loop import now
from esair.values import check_party

_log = logging.getLogger("esair")


class Drive(Behavior):
    """Writes to an actuator what comes by a topic; ``why`` tells ``ros:/cmd_vel``.

    A command that came longer ago than the actuator's ``command_timeout``, or than a
    second, is not written: the robot, or its side in ROS, was held up. How long ROS has
    kept it nobody knows. One
    beyond the limits is not written either; the first of them is a line in the log.

    Args:
        topic: The topic, ``/cmd_vel``.
        sensor: The sensor that hears it.
        actuator: What it moves.
        priority: With which priority.
        bus: The name of the bus to ROS.

    Attributes:
        refused: How many commands were too old, or beyond the limits.
    """

    def __init__(
        self,
        *,
        topic: str,
        sensor: str,
        actuator: str,
        priority: int = 0,
        bus: str = "ros",
    ) -> None:
        super().__init__(
            reads={"heard": reads(Any, name=sensor, max_age=SILENCE)},
            writes={
                "moved": writes(Any, name=actuator, priority=priority, blind="release")
            },
        )
        self._name = check_party("behavior", f"{bus}:{topic}")
        self.refused: int = 0

    async def run(self) -> None:
        """Write each command that is fresh."""
        heard: Any = getattr(self, "heard")  # noqa: B009 - declared by __init__
        moved: Any = getattr(self, "moved")  # noqa: B009
        told = False
        while True:
            try:
                async for _ in heard:
                    command = heard.newest
                    if now() - command.time <= moved.command_timeout:
                        await moved.write(command.value)
                    else:
                        self.refused += 1
            except BadValueError as error:  # whoever publishes it is told nothing
                self.refused += 1
                if not told:
                    told = True
                    _log.warning("%s: %s", self.name, error)
            except (DeviceLostError, StaleReadingError):
                await asyncio.sleep(0.02)
