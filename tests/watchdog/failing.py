"""The watchdog's program, of which one line fails once: ``FAILS=FUNCTION:LINE``.

It is the line of that number of those that the function executes.
"""

import os
import sys
from types import FrameType
from typing import Any

PROGRAM = os.environ["PROGRAM"]
name, _, number = os.environ["FAILS"].partition(":")
left = int(number)


def look(frame: FrameType, event: str, _argument: object) -> Any:
    global left
    if (frame.f_code.co_filename, frame.f_code.co_name) == (PROGRAM, name):
        left -= event == "line"
        if event == "line" and left == 0:
            raise MemoryError
    return look


with open(PROGRAM, encoding="utf-8") as file:
    program = compile(file.read(), PROGRAM, "exec")
sys.settrace(look)
exec(program, {"__name__": "__main__", "__file__": PROGRAM})
