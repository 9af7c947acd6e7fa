"""The watchdog's own program: it makes a robot safe whose process died or hangs.

Run as ``python -I -S FILE CHANNEL PIDFD PAGE STACK PID LIMIT POLICY``. It imports nothing
of esair and knows no command but safe: what it sends was handed to it as bytes before. It
writes only while the robot's process is stopped or dead.
"""

import contextlib
import ctypes
import fcntl
import json
import mmap
import os
import select
import signal
import socket
import struct
import sys
import termios
import time
from typing import Any

BEATS, MOVING, LATCH, LOOKS, OVER = range(5)
TELL_STACK, PR_SET_PDEATHSIG = signal.SIGRTMAX, 1
STOP_WITHIN, SEND_WITHIN, TRIES = 0.02, 0.5, 50
I2C_TIMEOUT, I2C_RDWR, GPIO_SET_VALUES = 0x0702, 0x0707, 0xC010B40F


class Device:
    def __init__(self, told: dict[str, Any], descriptors: list[int]) -> None:
        self.name, self.wire, self.target = told["name"], told["wire"], told["target"]
        self.frames = [bytes.fromhex(frame) for frame in told["frames"]]
        self.left, self.error, self.gap = self.frames, "", told.get("gap", 0.0)
        if self.wire == "can":
            can = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
            can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            can.bind((self.target["channel"],))
            descriptors.append(can.detach())
        elif self.wire == "i2c":
            descriptors.append(os.open(self.target["path"], os.O_RDWR | os.O_CLOEXEC))
            fcntl.ioctl(descriptors[0], I2C_TIMEOUT, 2)  # 20 ms
        if not descriptors:
            raise OSError("its descriptor did not arrive: too many are open")
        self.descriptor = descriptors[0]
        self.place = os.fstat(self.descriptor)[1:3]  # the file, and on which disk it is

    def begin(self, line: list["Device"]) -> None:
        """Throw away the motion that still waits in the kernel.

        The first on a line knows when it is free. Of two, one may answer before the other
        is told.
        """
        self.left, self.line, self.cut = self.frames, line, False
        self.pause = max(each.gap for each in line) * min(len(line), 2)
        self.due = time.monotonic() + self.pause
        with contextlib.suppress(Exception):  # a pipe has no such queue
            os.set_blocking(self.descriptor, False)  # the robot's, too: not before
            termios.tcflush(self.descriptor, termios.TCOFLUSH)
            termios.tcflow(self.descriptor, termios.TCOON)

    def is_left(self) -> bool:
        """Send what goes out now; tell whether something is left."""
        try:
            while (
                self.left
                and time.monotonic() >= self.line[0].due
                and not any(each.cut for each in self.line if each is not self)
            ):
                rest = self.left[0][self.write(self.left[0]) :]
                self.left = [rest, *self.left[1:]] if rest else self.left[1:]
                self.cut = bool(rest)
                self.line[0].due = time.monotonic() + self.pause * (not rest)
        except Exception as error:  # the others are to be made safe all the same
            self.error = str(error)
        return bool(self.left)

    def write(self, frame: bytes) -> int:
        if self.wire == "gpio":
            fcntl.ioctl(self.descriptor, GPIO_SET_VALUES, frame)
        elif self.wire == "i2c":
            data = ctypes.create_string_buffer(frame, len(frame))
            place, size = ctypes.addressof(data), len(frame)
            message = struct.pack("@HHHP", self.target["address"], 0, size, place)
            held = ctypes.create_string_buffer(message, len(message))
            request = struct.pack("@PI4x", ctypes.addressof(held), 1)
            fcntl.ioctl(self.descriptor, I2C_RDWR, request)
        else:
            return os.write(self.descriptor, frame)
        return len(frame)


class Watchdog:
    def __init__(self, arguments: list[str]) -> None:
        channel, self.pidfd, page, self.stack, self.pid = map(int, arguments[:5])
        self.limit, self.policy = float(arguments[5]), arguments[6]
        self.channel = socket.socket(fileno=channel)
        self.numbers = memoryview(mmap.mmap(page, 0)).cast("Q")
        self.devices: dict[int, Device] = {}
        self.poll = select.poll()
        self.poll.register(self.channel, select.POLLIN)
        self.poll.register(self.pidfd, select.POLLIN)

    def watch(self) -> str:
        """Return why the robot has to be made safe; empty after its good-bye."""
        beats, since, asked = self.numbers[BEATS], time.monotonic(), False
        while not self.is_over:
            self.numbers[LOOKS] += 1
            events = dict(self.poll.poll(min(self.limit, 1e4) * 100))  # a tenth, in ms
            if self.pidfd in events or (
                self.channel.fileno() in events and not self.hears()
            ):
                break
            for place, device in tuple(self.devices.items()):
                if device.descriptor in events:  # gone: its number must become free
                    self.drop(place)
                    self.tell("hung up", place)
            now = time.monotonic()
            if self.numbers[BEATS] != beats or not self.numbers[MOVING]:
                beats, since, asked = self.numbers[BEATS], now, False
            elif now - since >= self.limit:
                return f"no turn for {now - since:.3f} s{self.culprit()}"
            elif not asked and now - since >= self.limit / 2:
                asked = True
                with contextlib.suppress(OSError):  # nothing is told, then
                    os.ftruncate(self.stack, 0)
                    os.lseek(self.stack, 0, os.SEEK_SET)
                    signal.pidfd_send_signal(self.pidfd, TELL_STACK)
        return (
            ""
            if self.is_over
            else self.last_look(STOP_WITHIN, "its robot is gone, its process is not")
        )

    @property
    def is_over(self) -> bool:
        """Whether the robot itself, and no fork of it, has said good-bye."""
        return bool(self.numbers[OVER] == self.pid)

    def last_look(self, within: float, why: str = "") -> str:
        """Return why a robot has to be made safe to which nobody listens any more."""
        beats = self.numbers[BEATS]
        if select.select([self.pidfd], [], [], within)[0]:
            return "its process died"
        stuck = self.numbers[MOVING] and self.numbers[BEATS] == beats
        return why or ("no turn" if stuck else "")

    def culprit(self) -> str:
        """Return who holds the process: the code next to it that is not a library's."""
        told = os.pread(self.stack, 65536, 0).decode(errors="replace")
        main = told.rpartition("hread 0x")[2]  # the oldest comes last
        frames = [each.strip() for each in main.splitlines() if each[:7] == "  File "]
        libraries = os.path.dirname(os.__file__), os.path.dirname(__file__)[:-8]
        own = [each for each in frames if not each[6:].startswith(libraries)]
        return "".join(f", in {frame}" for frame in (own or frames)[:1])

    def hears(self) -> bool:
        """Do what the robot asks for, and answer; tells whether it is still there."""
        data, descriptors = b"", list[int]()
        with contextlib.suppress(ConnectionResetError):  # it has left answers unread
            data, descriptors, *_ = socket.recv_fds(self.channel, 1 << 20, 1)
        if not data:
            return False
        told = json.loads(data)
        if told["op"] == "drop":
            self.drop(told.get("of", 0))
        else:
            try:
                device = self.devices[told["place"]] = Device(told, descriptors)
            except Exception as error:
                for each in descriptors:
                    os.close(each)
                self.tell("refused", told["place"], str(error))
                return True
            self.poll.register(device.descriptor, 0)  # hang-up and error alone
        self.tell("done", told["place"])
        return True

    def drop(self, place: int) -> None:
        if device := self.devices.pop(place, None):
            self.poll.unregister(device.descriptor)
            os.close(device.descriptor)

    def tell(self, what: str, place: int, why: str = "") -> None:
        with contextlib.suppress(OSError):  # it is dead; or stuck, and hears nothing
            self.channel.send(
                json.dumps([what, place, why]).encode(), socket.MSG_DONTWAIT
            )

    def is_still(self) -> bool:
        """Whether no thread of the process runs any more."""
        states = b""
        with contextlib.suppress(
            Exception
        ):  # hidden from us; or a thread has just ended
            for task in os.listdir(tasks := f"/proc/{self.pid}/task"):
                with open(f"{tasks}/{task}/stat", "rb") as file:
                    states += file.read().rpartition(b")")[2].split()[0]
            return set(states) <= set(b"TtZX")
        return bool(select.select([self.pidfd], [], [], 0)[0])

    def act(self, why: str) -> None:
        """Stop the process, make every device safe, end the process, and say so."""
        began = time.monotonic()
        self.numbers[LATCH] = 1
        with contextlib.suppress(OSError):  # it is dead
            signal.pidfd_send_signal(self.pidfd, signal.SIGSTOP)
        while not self.is_still() and time.monotonic() - began < STOP_WITHIN:
            time.sleep(0.0001)  # what it still writes must not come after safe
        waiting = list(self.devices.values())
        for device in waiting:
            device.begin([each for each in waiting if each.place == device.place])
        while waiting := [device for device in waiting if device.is_left()]:
            last = max(line.due for line in lines.values())  # or what is sent next
            if time.monotonic() - last > SEND_WITHIN:
                break
            # All of them before any is told again.
            waiting.sort(key=lambda device: len(device.frames) - len(device.left))
            time.sleep(0.001)
        took = time.monotonic() - began
        with contextlib.suppress(OSError):  # it is dead
            if self.policy == "kill":
                signal.pidfd_send_signal(self.pidfd, signal.SIGKILL)
        told = [
            f"{device.name} {f'NOT SAFE ({device.error})' if device.left else 'safe'}"
            for device in self.devices.values()
        ]
        line = (
            f"esair watchdog: {why}: {', '.join(told) or 'nothing is watched'}, "
            f"after {took * 1000:.1f} ms\n"
        ).encode()
        with contextlib.suppress(OSError):  # who reads it may have gone, or be stuck
            while line and select.select([], [2], [], SEND_WITHIN)[1]:
                line = line[os.write(2, line[: select.PIPE_BUF]) :]


if __name__ == "__main__":
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(each, signal.SIG_IGN)
    for _ in range(3):  # or a device could get the number that the last line goes to
        os.open(os.devnull, os.O_RDWR)
    # One that was stopped goes on when its robot dies: there is nobody else then.
    with contextlib.suppress(Exception):
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGCONT, 0, 0, 0)
    dog = Watchdog(sys.argv[1:])
    try:
        reason = dog.watch()
    except Exception:
        if not (reason := dog.last_look(dog.limit)):
            raise  # a robot that lives hears of it, and makes itself safe
    for _ in range(TRIES if reason else 0):  # all of it may be done once more
        with contextlib.suppress(Exception):  # memory may be there a moment later
            dog.act(reason)
            break
        time.sleep(0.001)
