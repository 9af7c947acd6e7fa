"""A board as a part of a robot: its end of the serial line to a computer.

Messages are stuffed by COBS and end with a checksum (CRC 32) and a zero. Both sides send
beats. What the computer writes has the lowest priority of all: the reactions on the board
outrank it. When its beats stay away, whatever it moved is safe at once. Each beat has
`VERSION`: a board and a computer of other versions only tell it to each other.

A beat of the computer answers one of the board, and is as old as that: what waited while
the board was held up comes too late to move anything. Each command has its answer.

A step sends one message at most, and takes one at most: the computer sends none sooner
than the next step, but for its first. All numbers are little-endian::

    board to computer
    b VERSION flags cause days:H now_ms:I [late:I refused:I faults:I damaged:H lost:H
      [fault]]                         how it is; flags: 1 armed, 2 floats are doubles;
                                       the counts when they change, and each second
    s (index value)...                 readings; `x` for a sensor that gives none, or one
                                       that no message takes
    a (place what)...                  what came of commands: `T` done, `w` and a value done
                                       so far, or who is against it, and how: `h`, `b`, `g`
                                       and a name, or a letter alone
    n rate:I free:I sensors "," ... ";" actuators
                                       steps in 1000 s, names in the order of indices
    computer to board
    h VERSION flags time:H             answers a beat, of now_ms / 16; 1: tell the names,
                                       2: arm, 4: disarm
    w (place value)...                 commands, which count after a beat in time; the place
                                       is the index, and a number in the three upper bits
    r (index interval:H)...            send these sensors so often, in milliseconds
    q                                  end, safe, and make room

A value is `f` or `d` and a float, `i` or `q` and a whole number, `T`, `F`, `s` and a
text, `r` and a row of values, `R` and a row of floats, or `j` and JSON.
"""

# ruff: noqa: SLF001
# The moments of a loop that never grow are its own.

import struct
from binascii import crc32

from esair.boards.line import PIECE, Line, take_ctrl_c
from esair.boards.start import CAUSES
from esair.minimal import Loop, Reaction, Sensor, reads, writes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

const = int  # MicroPython's compiler knows the word, and puts the number in its place

VERSION = 4

HOST = "<host>"
"""What the computer is called here; no part of a robot can have such a name."""

PRIORITY = -1000
"""Of what the computer writes."""

BEAT_MS = const(100)
SILENCE_MS = const(350)
"""So long after the last of its beats that the computer has answered it counts as gone."""

LONGEST = const(512 + 96)
"""Bytes of a message; what is longer is left out, or thrown away."""

AT_ONCE = 96
"""Bytes that are read in one step: more of them wait, and no step is late for them."""

DAY_MS = const(1 << 28)
"""What a loop and a beat count as days."""

# All times but those of this module go back by a day after a day.
_MASK = const(0xFFFFFFF)
_HALF = const(0x8000000)

_WHOLE = const(0x2144DF1C)  # the checksum of a message and its checksum

REFUSAL = b"B\0[%d, 0]" % VERSION
"""A beat as a computer of version 1 reads it."""

FLOAT = "d" if 1.0 + 2.0**-30 != 1.0 else "f"
"""How a float goes over the line: as the board has them."""

_FORMS = {ord(each): "<" + each for each in "fdiq"}
_PAIRS = {ord(each): "<2" + each for each in "fd"}
_SIZES = {ord(each): 1 + struct.calcsize("<" + each) for each in "fdiq"}


def packed(buffer: bytearray, at: int, value: "Any", form: str = FLOAT) -> int:
    """Write a value at a place of a buffer; return where the next one begins."""
    if value is True or value is False:
        buffer[at] = 84 if value else 70  # T, F
        return at + 1
    kind = type(value)
    if kind is float:
        buffer[at] = ord(form)
        struct.pack_into("<" + form, buffer, at + 1, value)
        return at + (5 if form == "f" else 9)
    if kind is int:
        if -0x80000000 <= value < 0x80000000:
            struct.pack_into("<Bi", buffer, at, 105, value)
            return at + 5
        struct.pack_into("<Bq", buffer, at, 113, value)
        return at + 9
    if isinstance(value, (tuple, list)):
        floats = all(type(each) is float for each in value)
        struct.pack_into("<BH", buffer, at, 82 if floats else 114, len(value))
        at += 3
        if floats:
            buffer[at] = ord(form)
            at += 1
        for each in value:
            if floats:
                struct.pack_into("<" + form, buffer, at, each)
                at += 4 if form == "f" else 8
            else:
                at = packed(buffer, at, each, form)
        return at
    letter, text = 115, value
    if kind is not str:
        import json

        letter, text = 106, json.dumps(value)
    data = text.encode()
    struct.pack_into("<BH", buffer, at, letter, len(data))
    for each in data:
        buffer[at + 3] = each
        at += 1
    return at + 3


def unpacked(data: "Any", at: int) -> "tuple[Any, int]":
    """Return the value at a place of some bytes, and where the next one begins."""
    form: Any
    letter = data[at]
    if letter == 82:  # R: first, as it is what takes longest
        count, letter = data[at + 1] | data[at + 2] << 8, data[at + 3]
        form = _PAIRS[letter] if count == 2 else "<%d%s" % (count, chr(letter))
        end = at + 4 + count * (_SIZES[letter] - 1)
        return struct.unpack_from(form, data, at + 4), end
    form = _FORMS.get(letter)
    if form:
        return struct.unpack_from(form, data, at + 1)[0], at + _SIZES[letter]
    at += 1
    if letter == 84 or letter == 70:  # T, F
        return letter == 84, at
    count = data[at] | data[at + 1] << 8
    at += 2
    if letter == 114:  # r
        found = []
        for _ in range(count):
            value, at = unpacked(data, at)
            found.append(value)
        return tuple(found), at
    text = bytes(data[at : at + count]).decode()
    if letter == 106:  # j
        import json

        return json.loads(text), at + count
    if letter != 115:  # s
        raise ValueError("no value")
    return text, at + count


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

    host: "Any" = reads(int, name=HOST, max_age=SILENCE_MS / 1000)
    actuator: "Any" = writes(priority=PRIORITY)
    rate = 1000  # each step: only beats are news of the host

    def __init__(self, actuator: str, seconds: float) -> None:
        Reaction.__init__(self, HOST + " " + actuator)
        self.target = actuator
        self.good_ms: int = int(min(seconds * 1000, _HALF))
        self.command: Any = None
        self.ends: int = 0
        self.place: int = 0  # in its message, for the answer
        self.came: int = -1  # when the command came whose outcome was not told yet
        self.output: Any = None

    def react(self, host: int) -> "Any":
        """Go on with what the computer has written last, while it is good."""
        return self.command


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
        loop: What runs; it has a sensor `Host` of the name `HOST`, and the reactions of
            `from_host`.
        orders: Those reactions.
        cause: Why the board has started.
        arms: Whether the computer says when actuators may move.
        line: The serial line.
    """

    def __init__(
        self,
        loop: Loop,
        orders: "list[FromHost]",
        cause: str,
        arms: bool,
        line: Line,
    ) -> None:
        self.loop = loop
        self.orders = orders
        self.cause: int = CAUSES.index(cause) if cause in CAUSES else 255
        self.arms = arms
        self.line = line
        take_ctrl_c(-1)  # a byte 3 in a message is none
        self.damaged: int = 0
        """How many messages were damaged, too long, or made no sense."""
        self.version: int = 0
        """That of the computer; 0 before its first beat."""
        self.host: Any = loop.inputs[HOST]
        self.host.due = False  # it is never read
        self.host.value = 0
        self.sensors: list[Any] = [
            each for each in loop.inputs.values() if each is not self.host
        ]
        # What the computer asks for, in turns: index, interval, when it is due, the time
        # of the reading that was told, sensor.
        self.asked: list[Any] = []
        self.ends: int = -1  # then the first command is no longer good; -1: none is
        self.beat: int = 0
        self.rest: int = 0  # until then there is nothing to tell
        self.beats: int = 9  # the tenth tells all
        self.faults: int = 0
        self.counts: int = 0
        self.answer: "Any" = None  # what is to be told next
        self.came: int = -1  # when the last command came that was not answered yet
        self.waits: int = 0  # for how many steps it, or one before, has waited
        for order in orders:
            order.output = loop.outputs[order.target]
        self.packet: bytearray = bytearray(LONGEST - 4)
        self.message: bytearray = bytearray(LONGEST)
        self.view: memoryview[int] = memoryview(self.message)
        self.sent: memoryview[int] = memoryview(self.packet)
        self.used: int = 0
        self.free: int = _free()  # once: to count takes longer than a step

    def __call__(self) -> None:
        """Do what is due after a step; what fails is a fault, and stops no reflex."""
        try:
            now = self.loop._ms
            if self.ends >= 0 and now - self.ends & _MASK < _HALF:
                self._end()
            for _ in self.line.came(0):
                self._take()
                break
            if (self.answer is not None or self.came >= 0) and self._reply(now):
                return
            if not 0 < self.rest - now <= BEAT_MS:
                self._tell(now)
        except Exception as error:
            self.loop.note("link", error)

    def _end(self) -> None:
        """Want no more what was good until now."""
        now, self.ends = self.loop._ms, -1
        for order in self.orders:
            if order.command is not None:
                if now - order.ends & _MASK < _HALF:
                    order.command = None
                elif (
                    self.ends < 0 or order.ends - now & _MASK < self.ends - now & _MASK
                ):
                    self.ends = order.ends

    def _reply(self, now: int) -> bool:
        """Send what is to be told, or an answer that is due; tell whether it was sent."""
        if self.line.used:  # there may be no room
            return False
        if self.answer is not None:
            data, self.answer = self.answer, None
            self.packet[: len(data)] = data
            self._send(len(data))
            return True
        # Others have their turn first, and what goes on coming is answered in one.
        self.waits += 1
        if self.waits < 2 or (self.came == now and self.waits < 4):
            return False
        self._answer(now)
        return True

    def _tell(self, now: int) -> None:
        """Send a beat, or the readings that are asked for, in one message."""
        ahead = self.beat - now
        if ahead <= 0 or ahead > BEAT_MS:
            self.beat = now + BEAT_MS
            self._beat(now)
            return
        if self.line.used:  # what waits behind other messages is no news
            return
        rest = ahead
        # One that came in a step of a beat, or of an answer, goes in a later one.
        packet, at, fresh = self.packet, 1, now - 12000000 // self.loop.every
        for turn in self.asked:
            i, gap, due, told, node = turn
            ahead = due - now
            if not 0 < ahead <= gap:
                if fresh <= node._ms != told:
                    try:
                        packet[at] = i
                        at = packed(packet, at + 1, node.value)
                    except Exception as error:
                        rest = 0
                        self._cut(turn, at, error)
                        break
                    turn[3] = node._ms
                    ahead += gap
                    if not 0 < ahead <= gap:
                        ahead = gap
                    turn[2] = now + ahead
                else:
                    ahead = 0
            if ahead < rest:
                rest = ahead
        self.rest = now + rest
        if at > 1:
            packet[0] = 115  # s
            self._send(at)

    def _cut(self, turn: "Any", at: int, error: Exception) -> None:
        """Let a reading that finds no room be the next one, or leave it out alone."""
        if at > 1:
            place = self.asked.index(turn)
            self.asked = self.asked[place:] + self.asked[:place]
        else:
            i, gap, _, _, node = turn
            turn[2:4] = self.loop._ms + gap, node._ms
            self.answer = bytes([115, i, 120])  # s, x
            self.loop.note("link of " + node.name, error)

    def _answer(self, now: int) -> None:
        """Say what came of the commands that a step has had by now."""
        packet, at = self.packet, 1
        self.came, self.waits = -1, 0
        for order in self.orders:
            came = order.came
            if came < 0:
                continue
            if came == now or at > LONGEST - 80:  # the rest goes in a message more
                self.came = came
                continue
            order.came = -1
            packet[at] = order.place
            told = order.output.last
            if told is not None and told == order.command:
                packet[at + 1] = 84  # T
                at += 2
            else:
                at = self._outcome(order, at + 1)
        packet[0] = 97  # a
        self._send(at)

    def _outcome(self, order: FromHost, at: int) -> int:
        """Write what came of a command; return where the next one begins."""
        packet, output, name, how = self.packet, order.output, None, 102  # f
        writer = output.writer
        told = output.safe if output.last is None else output.last
        if order.command is None:
            how = 108  # l
        elif not output.bad and told == order.command:
            how = 84  # T
        elif writer:
            name, how = writer.task, 104  # h
            if name.reaction is order:
                packet[at] = 119  # w
                return packed(packet, at + 1, told)
        elif not self.loop.armed:
            how = 110  # n
        elif not output.bad:
            for port in output.guards:
                name, how = port.task, 103  # g
            for port in output.ports:
                if port.task.blind and port.bar >= PRIORITY:
                    name, how = port.task, 98  # b
                    if name.reaction is order:
                        name, how = None, 120  # x
                    break
        packet[at] = how
        return at + 1 if name is None else packed(packet, at + 1, name.name)

    def _beat(self, now: int) -> None:
        loop, packet, lost = self.loop, self.packet, self.line.lost
        struct.pack_into(
            "<BBBBHI",
            packet,
            0,
            98,  # b
            VERSION,
            (1 if loop.armed else 0) + (2 if FLOAT == "d" else 0),
            self.cause,
            loop._days & 0xFFFF,
            now,
        )
        at = 10
        self.beats += 1
        counts = loop.late + loop.refused + loop.faults + self.damaged + lost
        if self.beats >= 10 or counts != self.counts:
            struct.pack_into(
                "<IIIHH",
                packet,
                at,
                loop.late & 0xFFFFFFFF,
                loop.refused & 0xFFFFFFFF,
                loop.faults & 0xFFFFFFFF,
                self.damaged & 0xFFFF,
                lost & 0xFFFF,
            )
            at = 26
            if loop.fault and (loop.faults != self.faults or self.beats >= 10):
                for each in ("%s: %r" % loop.fault).encode()[:80]:
                    packet[at] = each
                    at += 1
            self.beats %= 10
            self.counts, self.faults = counts, loop.faults
        self._send(at)
        if now - self.host._ms > SILENCE_MS:
            self.asked = []  # nobody reads
        gone = b""
        for i, _, _, _, node in self.asked:
            if now - max(0, node._ms) > 3000000 // node.pace:
                gone += bytes([i, 120])  # x
        if gone:
            self.answer = b"s" + gone

    def _send(self, count: int) -> None:
        """Give the first bytes of the packet to the line, with checksum and stuffing."""
        line, data = self.line, self.sent[:count]
        size = count + 6 + (count + 4) // 254
        size += -size % PIECE
        if not line.has_room(size):
            return
        out, code = line.buffer, line.used
        line.used = code + size
        end = code + 1 + count
        out[code + 1 : end] = data
        struct.pack_into("<I", out, end, crc32(data))
        end += 4
        at = code
        while at < end:
            at = out.find(b"\0", code + 1, end)
            if at < 0:
                at = end
            if at - code > 254:  # a code that stands for no zero
                at = code + 255
                out[at + 1 : end + 1] = out[at:end]
                end += 1
            out[code] = at - code
            code = at
        end = line.used
        while at < end:
            out[at] = 0
            at += 1

    def _take(self) -> None:
        """Take what the line has brought, one message at most; more if they are late."""
        line, message = self.line, self.message
        came, read, one = line.came, line.read, line.one
        used = min(self.used, LONGEST - AT_ONCE)  # what is longer is none
        for _ in range(AT_ONCE):
            if not read(one):
                break
            byte = one[0]
            if byte:
                message[used] = byte
                used += 1
            elif used:
                self.used = 0
                try:
                    if not self._obey(used):
                        self.damaged += 1
                except Exception:  # what is no message of this version
                    self.damaged += 1
                used = 0
                if self.loop._ms - self.host._ms <= SILENCE_MS:
                    return
            for _ in came(0):
                break
            else:
                break
        self.used = used

    def _obey(self, used: int) -> bool:
        """Do what a message says, which is stuffed yet; tell whether it was one."""
        message = self.message
        at = 0
        while at < used:
            code = message[at]
            message[at] = 0  # that is what it stands for
            at += code
            while code == 255 and at < used:  # but here for nothing
                code = message[at]
                used -= 1
                message[at:used] = message[at + 1 : used + 1]
                at += code - 1
        end = used - 4
        if at != used or end < 2 or crc32(self.view[1:used]) != _WHOLE:
            return False
        kind = message[1]
        if kind == 119 and self.version == VERSION:  # w
            at, now = 2, self.loop._ms
            alone = now - self.host._ms > SILENCE_MS
            self.came = now
            while at < end:
                place = message[at]
                order = self.orders[place & 31]
                value, at = unpacked(message, at + 1)
                if at > end:
                    return False  # it says more than it has
                kind = order.output.type
                if kind is not value.__class__ and isinstance(value, tuple):
                    value = kind(*value)
                order.place, order.came = place, now
                if alone:
                    order.command = None
                else:
                    order.command, good = value, order.good_ms
                    order.ends = now + good
                    if self.ends < 0 or good < self.ends - now & _MASK:
                        self.ends = order.ends
        elif kind == 104 and end >= 4:  # h
            self.version = message[2]
            if self.version == VERSION:
                if end != 6:
                    return False
                self._beaten(message[3], message[4] | message[5] << 8)
        elif kind == 113 or kind == 81:  # q, or Q of version 1
            take_ctrl_c(3)
            raise KeyboardInterrupt  # it ends as by Ctrl-C, with safe commands
        elif kind == 66:  # B, of version 1
            self.version, self.answer = 1, REFUSAL
        elif kind == 114 and end % 3 == 2 and self.version == VERSION:  # r
            for at in range(2, end, 3):
                i = message[at]
                for turn in self.asked:
                    if turn[0] == i:
                        break
                else:
                    turn = [i, 0, 0, -1, self.sensors[i]]
                    self.asked.append(turn)
                turn[1] = message[at + 1] | message[at + 2] << 8
            self.rest = 0
        else:
            return False
        return True

    def _beaten(self, flags: int, answered: int) -> None:
        now, host = self.loop._ms, self.host
        age = ((now >> 4) - answered & 0xFFFF) << 4  # in steps of 16 ms
        if age <= SILENCE_MS:
            if now - host._ms > SILENCE_MS:
                for order in self.orders:  # it was gone: what it wanted then is old
                    order.command = None
            host.value = host.value + 1 & 0xFFFF
            host._ms = now - age
            if flags & 1:
                self._name()
        elif not flags & 4:
            return
        if flags & 6 and self.arms and self.loop.armed != bool(flags & 2):
            self.loop.arm(bool(flags & 2))

    def _name(self) -> None:
        self.beats = 9
        names = ",".join([each.name for each in self.sensors])
        names += ";" + ",".join([each.target for each in self.orders])
        self.answer = (
            b"n" + struct.pack("<II", self.loop.every, self.free) + names.encode()
        )


def _free() -> int:
    """Return the bytes of memory that are free; 0 where nobody knows."""
    import gc

    return gc.mem_free() if hasattr(gc, "mem_free") else 0
