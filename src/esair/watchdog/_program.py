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
STOP_WITHIN, SEND_WITHIN, TRIES, VAIN = 0.02, 0.5, 50, 3
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
        self.descriptor, own = descriptors[0], self.wire != "serial"
        # The same of all devices on one line.
        self.place: object = self if own else os.fstat(self.descriptor)[1:3]

    def begin(self, devices: "list[Device]") -> None:
        """Throw away the motion that still waits in the kernel."""
        self.left, self.due = self.frames, time.monotonic() + self.gap
        self.line = [each for each in devices if each.place == self.place]
        # Of two devices, one may answer before the other is told.
        self.silence = max(each.gap for each in self.line) * min(len(self.line), 2)
        with contextlib.suppress(Exception):  # a pipe has no such queue
            os.set_blocking(self.descriptor, False)  # the robot's, too: not before
            termios.tcflush(self.descriptor, termios.TCOFLUSH)
            termios.tcflow(self.descriptor, termios.TCOON)

    def is_left(self) -> bool:
        """Send what goes out now; tell whether something is left."""
        try:
            while self.left and time.monotonic() >= self.due:
                rest = self.left[0][self.write(self.left[0]) :]
                self.left = [rest, *self.left[1:]] if rest else self.left[1:]
                for each in self.line:  # a frame that was cut is to be whole first
                    each.due = time.monotonic() + (
                        SEND_WITHIN * (each is not self) if rest else self.silence
                    )
        except Exception as error:  # the others are to be made safe all the same
            self.error = str(error)
        return bool(self.left) and time.monotonic() - self.due < SEND_WITHIN

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
        self.page = mmap.mmap(page, 0)
        self.numbers = memoryview(self.page).cast("Q")
        self.devices: dict[int, Device] = {}
        self.poll = select.poll()
        self.poll.register(self.channel, select.POLLIN)
        self.poll.register(self.pidfd, select.POLLIN)

    def watch(self) -> str:
        """Return why the robot has to be made safe; empty after its good-bye."""
        beats, since, asked, looks = self.numbers[BEATS], time.monotonic(), False, 0
        while self.numbers[OVER] != self.pid:  # no fork of it has that number
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
                looks = self.numbers[LOOKS]
            # Time alone says nothing: both may have been paused until now.
            elif now - since >= self.limit and self.numbers[LOOKS] - looks > VAIN:
                return f"no turn for {now - since:.3f} s{self.culprit()}"
            elif not asked and now - since >= self.limit / 2:
                asked = True
                with contextlib.suppress(OSError):  # nothing is told, then
                    os.ftruncate(self.stack, 0)
                    os.lseek(self.stack, 0, os.SEEK_SET)
                    signal.pidfd_send_signal(self.pidfd, TELL_STACK)
        return (
            ""
            if self.numbers[OVER] == self.pid
            else self.last_look(STOP_WITHIN, "its robot is gone, its process is not")
        )

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
        main = told.rpartition("hread 0x")[2].splitlines()  # the oldest comes last
        frames = [line.strip() for line in main if line.startswith("  File ")]
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
                device = Device(told, descriptors)
            except Exception as error:
                for each in descriptors:
                    os.close(each)
                self.tell("refused", told["place"], str(error))
                return True
            self.devices[told["place"]] = device
            self.poll.register(device.descriptor, 0)  # hang-up and error alone
        self.tell("done", told["place"])
        return True

    def drop(self, place: int) -> None:
        if place in self.devices:
            device = self.devices.pop(place)
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
            device.begin(waiting)
        while waiting := [device for device in waiting if device.is_left()]:
            # All of them before any is told again.
            waiting.sort(key=lambda device: len(device.frames) - len(device.left))
            time.sleep(0.001)
        took = time.monotonic() - began
        with contextlib.suppress(OSError):  # it is dead
            if self.policy == "kill":
                signal.pidfd_send_signal(self.pidfd, signal.SIGKILL)
        told = ", ".join(
            f"{device.name} {f'NOT SAFE ({device.error})' if device.left else 'safe'}"
            for device in self.devices.values()
        )
        line = (
            f"esair watchdog: {why}: {told or 'nothing is watched'}, "
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
