"""How a board starts and stays well: arming, watchdog, reset cause, brown-outs, words.

``main.py`` makes one `Start` and hands it to the loop, which calls it after each step.
"""

# ruff: noqa: SLF001
# The moments of a loop that never grow are its own.

from esair.boards.line import Line
from esair.minimal import Loop

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

ROOM = "esair.room"
"""The file that keeps the program, and its watchdog, off at the next start."""

STARTS = "esair.starts"
"""The file with a byte for each quick start; `esair min deploy` puts a starter on a
board that counts them, and goes to the prompt after three."""

QUICK_MS = 10000
"""After so long a start was none of them."""

LATEST_MS = 60000
"""Until then that is written down only while nothing moves: flash memory takes a while."""

CAUSES = ("power-on", "hard reset", "watchdog", "deep sleep", "soft reset", "start")

_CAUSES = ("PWRON_RESET", "HARD_RESET", "WDT_RESET", "DEEPSLEEP_RESET", "SOFT_RESET")


def reset_cause() -> str:
    """Return why the board has started, as ``"power-on"`` or ``"watchdog"``."""
    import machine

    if not hasattr(machine, "reset_cause"):
        return "start"
    cause = machine.reset_cause()
    for name, word in zip(_CAUSES, CAUSES):
        if getattr(machine, name, None) == cause:
            return word
    return "cause %d" % cause


class Start:
    """Called after each step: feeds the watchdog, arms the loop, looks after parts.

    At its first call it says that the board is ready, and why it has started. On a
    serial line without a link it takes words: ``who`` asks how it is; ``room`` ends the
    program, safe, for `esair min deploy`; ``arm`` and ``disarm``, if the host arms it.

    Args:
        loop: What runs; made with ``armed=False`` unless it is armed always.
        arm: ``"always"``, the number of a pin with a switch to ground, or ``"host"``.
        watchdog: The time-out of the hardware watchdog, in milliseconds; 0 for none.
            It runs from the first step on.
        parts: The devices. One that has a method ``is_set_up`` is asked once a second,
            and set up again, made safe, when it says no: its supply had failed.
        link: `esair.boards.link.Link`, if the host speaks by that; it then arms by it.
        orders: What that does at the actuators, as `from_host` has returned it.
    """

    def __init__(
        self,
        loop: Loop,
        arm: "str | int" = "always",
        watchdog: int = 0,
        parts: "tuple[Any, ...]" = (),
        link: "Any" = None,
        orders: "Any" = (),
    ) -> None:
        self.loop = loop
        self.arm = arm
        self.parts: list[Any] = [each for each in parts if hasattr(each, "is_set_up")]
        self.word: bytes = b""
        self.pin: "Any" = None
        self.armed: bool = arm == "always"
        self.second: int = -1
        self.count: bool = True
        self.repaired: int = 0
        """How many times a part was set up again."""
        self.cause: str = reset_cause()
        self.watchdog = watchdog
        self.feed: "Any" = None
        loop.arm(self.armed)
        self.line: Line = Line(8000000 // loop.every)
        # Given, not imported here: a board without a link has no file of it.
        self.link: Any = link and link(
            loop, orders, self.cause, arm == "host", self.line
        )
        loop.say = self.line.say
        if link:  # a fault travels in the beat
            loop.say = str
        if type(arm) is int:
            from machine import Pin

            self.pin = Pin(arm, Pin.IN, Pin.PULL_UP)

    def _tell(self) -> None:
        how = "armed" if self.armed else "not armed: it waits for the host"
        if self.pin is not None:
            how = "armed by pin %s" % self.arm
        self.loop.say("esair: ready, %s, %s" % (self.cause, how))

    def __call__(self) -> None:
        """Do what is due after a step; none of it waits."""
        if self.feed is not None:
            self.feed()
        if self.pin is not None:
            self._arm(not self.pin.value())
        if self.link is not None:
            self.link()
        else:
            self._listen()
        if self.loop._ms // 1000 != self.second:
            if self.second < 0:
                self._begin()
            self.second = self.loop._ms // 1000
            self._look_after()
        self.line.flush()

    def _begin(self) -> None:
        self._tell()
        if self.watchdog:
            from machine import WDT

            self.feed = WDT(timeout=self.watchdog).feed

    def _arm(self, armed: bool) -> None:
        if armed != self.armed:
            self.armed = armed
            self.loop.arm(armed)
            self.loop.say("esair: armed" if armed else "esair: disarmed")

    def _look_after(self) -> None:
        now = self.loop._ms
        if self.count and now >= QUICK_MS and (now >= LATEST_MS or not self._moves()):
            self.count = False
            forget_starts()
        for part in self.parts:
            try:
                if not part.is_set_up():
                    part.open()
                    self.repaired += 1
                    if part.name in self.loop.outputs:
                        self.loop.outputs[part.name].tell()
                    self.loop.say("esair: %s: set up again" % part.name)
            except Exception as error:
                self.loop.note(part.name, error)

    def _moves(self) -> bool:
        return any(each.writer for each in self.loop.outputs.values())

    def _listen(self) -> None:
        """Take what the serial line has brought, without waiting; of a flood, some."""
        for _ in range(64):
            byte = self.line.byte()  # it may be no text
            if byte < 0:
                return
            if byte != 10 and byte != 13:
                self.word = (self.word + bytes([byte]))[-16:]
                continue
            word, self.word = self.word.strip(), b""
            if word == b"who":
                self._tell()
            elif word == b"room":
                raise KeyboardInterrupt  # it ends as by Ctrl-C, with safe commands
            elif word in (b"arm", b"disarm") and self.arm == "host":
                self._arm(word == b"arm")


def forget_starts() -> None:
    """Let the starts up to now be none of the quick ones."""
    import os

    try:
        os.remove(STARTS)
    except OSError:  # it was not started by that
        return
