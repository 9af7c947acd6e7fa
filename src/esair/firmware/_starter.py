"""The file that a board starts: it runs what is in one of two folders, or the prompt."""

from __future__ import annotations

from typing import Final

from esair.boards.start import ROOM, STARTS

SLOTS: Final = ("esair-a", "esair-b")
"""Where programs are: one runs while the other is written."""

MARK: Final = "# Put here by `esair min deploy`"

AT_PROMPT: Final = "prompt"
"""What ``_esair`` is at a prompt that no watchdog runs at."""


def starter(slot: str) -> str:
    """Return the text of a board's ``main.py``.

    It is the pointer to the program: when it is replaced, which is one act of the file
    system, the other program is what runs.
    """
    return _TEXT.format(
        mark=MARK, slot=slot, room=ROOM, starts=STARTS, prompt=AT_PROMPT
    )


_TEXT = """{mark}: it starts the program in {slot}.
import os
import sys
import time

import machine


def _forgotten(name):
    try:
        os.remove(name)
    except OSError:
        pass


def _start():
    there = os.listdir()
    quick = os.stat("{starts}")[6] if "{starts}" in there else 0
    if "{room}" in there or quick > 2:
        _forgotten("{starts}")
        _forgotten("{room}")
        print("esair: prompt, " + ("three quick starts" if quick > 2 else "room is made"))
        return "{prompt}"
    try:
        with open("{starts}", "a") as file:
            file.write("x")
    except OSError:  # no room: what runs without a count is better than nothing
        pass
    # Nothing beside the program's own folder can be a part of it.
    others = [each for each in sys.path if each not in ("", os.getcwd())]
    sys.path[:] = ["{slot}"] + others
    try:
        import main
        return "ended"
    except KeyboardInterrupt:
        print("esair: stopped")
        open("{room}", "w").close()
    except Exception as error:
        sys.print_exception(error)
        print("esair: ended by an error, starts again")
        time.sleep(1)
    machine.reset()  # a watchdog cannot be stopped otherwise


_esair = "started"
_esair = _start()
"""
