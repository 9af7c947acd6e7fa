"""An operation of a resource: asked for, checked, and given its turn."""

from __future__ import annotations

import asyncio
from typing import Any

from esair.connections import Registration
from esair.exceptions import BusyError, DeviceLostError, DriverStuckError
from esair.resources import operation_of
from esair.supervisors._resource_life import ResourceLife

WAITING_LIMIT = 16
"""How many operations of one resource may wait or run; more are refused."""


async def operate(
    life: ResourceLife,
    registration: Registration,
    name: str,
    parameters: dict[str, Any],
) -> Any:
    """Call an operation of a resource; everything is checked before anything is done.

    It has the device for itself: no change of settings, no opening, no other call.
    """
    resource = life.resource
    operation = operation_of(resource, name)
    checked = operation.check(resource.name, parameters)
    limit = operation.deadline or resource.deadline
    until = asyncio.get_running_loop().time() + limit
    if life.operations >= WAITING_LIMIT:
        raise BusyError(resource.name, "number of operations", WAITING_LIMIT)
    life.operations += 1
    try:
        try:
            async with asyncio.timeout_at(until):
                await life.configuring.acquire()
        except TimeoutError as error:
            what = f"operate {name}, which waited for its turn,"
            raise DriverStuckError(resource.name, what, limit) from error
        try:
            if life.is_over:
                raise DeviceLostError(resource.name, "it was replaced")
            return await life.channel.operations.run(
                registration, name, checked, until, limit
            )
        finally:
            life.configuring.release()
    finally:
        life.operations -= 1
