"""Whose code is interrupted when a loop does not hear that it should end."""

from __future__ import annotations

import json
import sys
from types import FrameType
from typing import Any

import pytest

from esair.loop._overseer import LoopHeldError, break_out

pytestmark = pytest.mark.virtual_clock


def a_library_called_by(module: str) -> FrameType:
    """The frame of a function of the standard library that code of a module has called."""
    seen: list[FrameType | None] = []

    def see(_value: object) -> str:
        seen.append(sys._getframe(1))
        return ""

    code: dict[str, Any] = {"__name__": module, "see": see, "json": json}
    exec("def call(): json.dumps(object(), default=see)", code)
    code["call"]()
    (frame,) = seen
    assert frame is not None
    assert frame.f_globals["__name__"] == "json.encoder"
    return frame


@pytest.mark.promise("ROB-6")
async def test_what_a_library_does_for_the_robot_is_spared() -> None:
    """A stop that has to import or log something on a slow computer is not broken."""
    own = a_library_called_by("esair.standard._robot")

    break_out(own, forced=False)
    with pytest.raises(LoopHeldError):
        break_out(own, forced=True)


@pytest.mark.promise("ROB-6")
async def test_the_loop_itself_is_never_interrupted() -> None:
    """A computer that is busy lets it wait, and it holds nothing."""
    frame: FrameType | None = sys._getframe()
    while frame is not None and frame.f_code.co_name != "run_forever":
        frame = frame.f_back

    break_out(frame, forced=True)


@pytest.mark.promise("ROB-6")
async def test_what_a_library_does_for_the_user_is_interrupted() -> None:
    """Who has called it holds the loop."""
    with pytest.raises(LoopHeldError):
        break_out(a_library_called_by("my_robot"), forced=False)
