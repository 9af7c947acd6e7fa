"""How a board starts and stays well: arming, watchdog, reset cause, brown-outs.

``main.py`` makes one `Start` and hands it to the loop, which calls it after each step.
"""

import sys

from esair.minimal import Loop

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_CAUSES = ("PWRON_RESET", "HARD_RESET", "WDT_RESET", "DEEPSLEEP_RESET", "SOFT_RESET")


def reset_cause() -> str:
    """Return why the board has started, as ``"power-on"`` or ``"watchdog"``."""
    import machine

    words = ("power-on", "hard reset", "watchdog", "deep sleep", "soft reset")
    if not hasattr(machine, "reset_cause"):
        return "start"
    cause = machine.reset_cause()
    for name, word in zip(_CAUSES, words):
        if getattr(machine, name, None) == cause:
            return word
    return "cause %d" % cause


class Start:
    """Called after each step: feeds the watchdog, arms the loop, looks after parts.

    Args:
        loop: What runs; made with ``armed=False`` unless it is armed always.
        arm: ``"always"``, the number of a pin with a switch to ground, or ``"host"``:
            a line ``arm`` or ``disarm`` on the serial line; ``who`` asks how it is.
        watchdog: The time-out of the hardware watchdog, in milliseconds; 0 for none.
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
        self.parts = [each for each in parts if hasattr(each, "is_set_up")]
        self.line = b""
        self.pin: "Any" = None
        self.armed = arm == "always"
        self.second = 0
        self.repaired = 0
        """How many times a part was set up again."""
        self.cause = reset_cause()
        self.feed: "Any" = None
        loop.arm(self.armed)
        self.poll: "Any" = None
        # Given, not imported here: a board without a link has no file of it.
        self.link = link and link(loop, orders, self.cause, arm == "host")
        if arm == "host":
            if link is None:
                self.poll = _polled_stdin()
        elif not self.armed:
            from machine import Pin

            self.pin = Pin(arm, Pin.IN, Pin.PULL_UP)
        self._tell()
        if watchdog:
            from machine import WDT

            self.feed = WDT(timeout=watchdog).feed

    def _tell(self) -> None:
        print("esair: ready, %s, %s" % (self.cause, self._waits()))

    def _waits(self) -> str:
        if self.arm == "always":
            return "armed"
        if self.pin is not None:
            return "armed by pin %s" % self.arm
        return "not armed: it waits for the host"

    def __call__(self) -> None:
        """Do what is due after a step."""
        if self.feed is not None:
            self.feed()
        if self.pin is not None:
            self._arm(not self.pin.value())
        elif self.poll is not None:
            self._listen()
        if self.link is not None:
            self.link()
        if self.loop.now_ms // 1000 != self.second:
            self.second = self.loop.now_ms // 1000
            self._look_after()

    def _arm(self, armed: bool) -> None:
        if armed != self.armed:
            self.armed = armed
            self.loop.arm(armed)
            print("esair: armed" if armed else "esair: disarmed")

    def _look_after(self) -> None:
        for part in self.parts:
            try:
                if not part.is_set_up():
                    part.open()
                    self.repaired += 1
                    if part.name in self.loop.outputs:
                        self.loop.outputs[part.name].tell()
                    print("esair: %s: set up again" % part.name)
            except Exception as error:
                self.loop.note(part.name, error)

    def _listen(self) -> None:
        """Take what the serial line has brought, without waiting; of a flood, some."""
        for _ in range(64):
            byte = self.poll(0) and sys.stdin.buffer.read(1)  # it may be no text
            if not byte:
                return
            if byte not in b"\r\n":
                self.line = (self.line + byte)[-16:]
                continue
            word, self.line = self.line.strip(), b""
            if word in (b"arm", b"disarm"):
                self._arm(word == b"arm")
            elif word == b"who":
                self._tell()


def _polled_stdin() -> "Any":
    import select

    poll = select.poll()
    poll.register(sys.stdin, select.POLLIN)
    return poll.poll
