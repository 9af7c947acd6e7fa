"""A board as a part of a robot: its end of the serial line to a computer.

Messages are stuffed by COBS between zeros, and end with a checksum (CRC 32). Both sides
send beats. What the computer writes has the lowest priority of all: the reactions on the
board outrank it. When its beats stay away, whatever it moved is safe at once. `VERSION` is
the first number of each beat: sides of different versions only tell it to each other.
"""

import json
import sys
from binascii import crc32

from esair.minimal import Loop, Reaction, Sensor, reads, writes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

VERSION = 1

PRIORITY = -1000
"""Of what the computer writes."""

BEAT_MS = 100
SILENCE = 0.35
"""After so many seconds without a beat of the computer it counts as gone."""

LONGEST = 512
"""Bytes of a message; what is longer is thrown away."""

AT_ONCE = 512
"""Bytes that are read in one step: more of them wait, and no step is late for them."""


def stuffed(payload: bytes) -> bytes:
    """Return a message with its checksum, stuffed so that only its ends are zero."""
    data = payload + (crc32(payload) & 0xFFFFFFFF).to_bytes(4, "little")
    found = bytearray(b"\0")
    for piece in data.split(b"\0"):
        while len(piece) >= 254:
            found.append(255)
            found += piece[:254]
            piece = piece[254:]
        found.append(len(piece) + 1)
        found += piece
    found.append(0)
    return bytes(found)


def unstuffed(data: bytes) -> "bytes | None":
    """Return the payload of what was between two zeros; None if it is damaged."""
    found = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        if code == 0 or at + code > len(data):
            return None
        found += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            found.append(0)
    payload = bytes(found[:-4])
    if len(found) < 5 or bytes(found[-4:]) != crc32(payload).to_bytes(4, "little"):
        return None
    return payload


class Host(Sensor):
    """How many beats of the computer have come."""

    def read(self) -> int:
        """Never called: `Link` says when there is something new."""
        raise OSError("the link gives its readings")


class FromHost(Reaction):
    """Does at one actuator what the computer wants.

    Args:
        actuator: Its name.
        seconds: How long a command is good, the actuator's command timeout.
    """

    host = reads(int, max_age=SILENCE)
    actuator = writes(priority=PRIORITY)
    rate = 1000  # each step: only beats are news of the host

    def __init__(self, actuator: str, seconds: float) -> None:
        Reaction.__init__(self, "host_" + actuator)
        self.target = actuator
        self.good_ms = int(seconds * 1000)
        self.command: Any = None
        self.until = 0

    def take(self, command: "Any", now: int) -> None:
        """Want what the computer has written last; None to give it back."""
        self.command = command
        self.until = now + self.good_ms

    def react(self, host: int) -> "Any":
        """Go on with it while it is good."""
        return self.command if self.now_ms < self.until else None


def from_host(actuators: "tuple[Any, ...]") -> "list[FromHost]":
    """Return a reaction for each actuator, which does what the computer wants."""
    found = []
    for each in actuators:
        # A class for each: a declaration names one actuator.
        port = writes(name=each.name, priority=PRIORITY)
        kind = type("FromHost", (FromHost,), {"actuator": port})
        found.append(kind(each.name, each.command_timeout))
    return found


class Link:
    """Called after each step: takes what the computer says, and tells it the news.

    Args:
        loop: What runs; it has a sensor `Host`, and the reactions of `from_host`.
        orders: Those reactions.
        cause: Why the board has started.
        arms: Whether the computer says when actuators may move.
        read: Gives the bytes that have come, at most so many, without waiting; those
            of the standard input unless given.
        write: Sends bytes; to the standard output unless given.
    """

    def __init__(
        self,
        loop: Loop,
        orders: "list[FromHost]",
        cause: str,
        arms: bool = True,
        read: "Any" = None,
        write: "Any" = None,
    ) -> None:
        self.loop = loop
        self.orders = {each.target: each for each in orders}
        self.cause = cause
        self.arms = arms
        self.read = read or _standard_input()
        self.write = write or _standard_output()
        self.waiting = b""
        self.damaged = 0
        """How many messages were damaged, too long, or made no sense."""
        self.version = 0
        """That of the computer; 0 before its first beat."""
        self.next_beat = 0
        self.told: dict[str, int] = {}
        self.host: Any = loop.inputs["host"]
        self.host.due = False  # it is never read
        self.host.value = 0

    def __call__(self) -> None:
        """Do what is due after a step; what fails is a fault, and stops no reflex."""
        try:
            data = self.read(AT_ONCE)
            if data:
                self._take(data)
            self._tell()
        except Exception as error:
            self.loop.note("link", error)

    def _tell(self) -> None:
        now = self.loop.now_ms
        beats = now >= self.next_beat
        for name, node in self.loop.inputs.items():
            if node is self.host:
                continue
            age = now - max(0, node.time)
            if node.time >= 0 and node.time != self.told.get(name):
                self.told[name] = node.time
                self._send("S" + name, [age, node.value])
            elif beats and age > 3000000 // node.pace:
                self.told.pop(name, None)
                self._send("S" + name, [])  # it fails: after three periods, as here
        if beats:
            self.next_beat = now + BEAT_MS
            self._beat()

    def _take(self, data: bytes) -> None:
        pieces = (self.waiting + data).split(b"\0")
        self.waiting = pieces.pop()[: LONGEST + 1]
        for whole in pieces:
            if not whole:
                continue
            payload = unstuffed(whole) if len(whole) <= LONGEST else None
            try:
                if payload is None or not self._obey(payload):
                    self.damaged += 1
            except Exception:  # what is no message of this version
                self.damaged += 1

    def _obey(self, payload: bytes) -> bool:
        kind, name = payload[:1], ""
        body = payload[1:]
        if kind == b"W":
            first, body = body.split(b"\0", 1)
            name = first.decode()
        value = json.loads(body)
        now = self.loop.now_ms
        if kind == b"B":
            self.version = value if type(value) is int else 0
            if self.version == VERSION:
                self.host.value += 1
                self.host.time = now
        elif self.version != VERSION:
            return False
        elif kind == b"Q":
            _take_ctrl_c(3)
            raise KeyboardInterrupt  # it ends as by Ctrl-C, with safe commands
        elif kind == b"A" and self.arms:
            self.loop.arm(bool(value))
        elif kind == b"W" and name in self.orders:
            if isinstance(value, list):
                value = _like(self.loop.outputs[name].safe, value)
            self.orders[name].take(value, now)
        else:
            return False
        return True

    def _beat(self) -> None:
        loop = self.loop
        fault = "" if loop.fault is None else "%s: %r" % loop.fault
        state: "list[Any]" = [VERSION, loop.now_ms, loop.steps, loop.late]
        state += [loop.refused, loop.faults, fault, _free(), self.cause]
        state += [loop.armed, self.damaged, list(self.told), list(self.orders)]
        self._send("B", state)

    def _send(self, kind: str, value: "Any") -> None:
        self.write(stuffed(kind.encode() + b"\0" + json.dumps(value).encode()))


def _like(safe: "Any", values: "list[Any]") -> "Any":
    """Return a list of the wire as the tuple that an actuator takes."""
    if type(safe) is tuple:
        return tuple(values)
    return type(safe)(*values)


def _free() -> int:
    """Return the bytes of memory that are free; 0 where nobody knows."""
    import gc

    return gc.mem_free() if hasattr(gc, "mem_free") else 0


def _take_ctrl_c(byte: int) -> None:
    """Let a byte be Ctrl-C; -1 for none."""
    try:
        import micropython

        micropython.kbd_intr(byte)  # type: ignore[attr-defined]
    except (ImportError, AttributeError):
        pass


def _standard_input() -> "Any":
    import select

    poll = select.poll()
    poll.register(sys.stdin, select.POLLIN)
    _take_ctrl_c(-1)  # a byte 3 in a message is none
    stdin = sys.stdin.buffer

    def read(most: int) -> bytes:
        found = bytearray()
        while len(found) < most and poll.poll(0):
            byte = stdin.read(1)
            if not byte:
                break
            found += byte
        return bytes(found)

    return read


def _standard_output() -> "Any":
    import select

    poll = select.poll()
    poll.register(sys.stdout, select.POLLOUT)
    told = [False]  # whether this port tells when it takes something

    def write(data: bytes) -> None:
        # A computer that reads no more would hold up each step, on USB by half a second.
        for at in range(0, len(data), 64):
            if poll.poll(0):
                told[0] = True
            elif told[0]:
                return
            sys.stdout.buffer.write(data[at : at + 64])

    return write
