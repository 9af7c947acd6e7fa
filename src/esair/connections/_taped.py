"""Driver calls of a run that is recorded, and of its replay, which calls no driver."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from esair.connections._call import Call, End
from esair.connections._driver import Guard, Method
from esair.loop import First, Player, TapeWriter

if TYPE_CHECKING:
    from esair.connections._calls import Calls


def begin_taped(
    calls: Calls,
    tape: TapeWriter | Player,
    kind: str,
    method: Method,
    args: tuple[Any, ...],
    limit: float | None,
    guard: Guard | None,
) -> Any:
    """Begin a call and keep what comes of it, or take that from the tape.

    Returns:
        What the driver returned; or a `Call`, which waits.

    Raises:
        Exception: Whatever the driver raises, or has raised.
    """
    if getattr(calls.driver.resource, "is_computed", False):  # it is no device
        return calls.begin_untaped(kind, method, args, limit, guard)
    tag = ("call", calls.resource, kind)
    if isinstance(tape, Player):
        number, first = tape.first(tag)
        if first.error is not None:
            raise first.error
        if not first.waits:
            return first.value
        call = calls.track(kind, args, limit)
        tape.expect(tag, number, lambda end: calls.ended(call, End(*end)))
        return call
    try:
        value = calls.begin_untaped(kind, method, args, limit, guard)
    except Exception as error:
        tape.first(tag, First(waits=False, value=None, error=error))
        raise
    if type(value) is not Call:
        tape.first(tag, First(waits=False, value=value, error=None))
        return value
    number = tape.first(tag, First(waits=True, value=None, error=None))
    value.taped = lambda end: tape.arrived(tag, tuple(end), number=number)
    return value
