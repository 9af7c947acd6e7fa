"""The watchdog's own program: it makes a robot safe whose process died or hangs.

Run as ``python -I -S FILE CHANNEL PIDFD PAGE STACK PID LIMIT POLICY``. It imports nothing
of esair and knows no command but safe: what it sends was handed to it as bytes before. It
writes only while the robot's process is stopped or dead.
"""

import contextlib
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

BEATS, MOVING, LATCH, LOOKS = range(4)
TELL_STACK = signal.SIGRTMAX
STOP_WITHIN, SEND_WITHIN = 0.02, 0.5
I2C_TIMEOUT, I2C_RDWR, GPIO_SET_VALUES = 0x0702, 0x0707, 0xC010B40F


class Device:
    """One actuator: its wire, and the bytes that make it safe."""

    def __init__(self, told: dict[str, Any], descriptors: list[int]) -> None:
        self.name, self.wire, self.target = told["name"], told["wire"], told["target"]
        self.frames = [bytes.fromhex(frame) for frame in told["frames"]]
        self.left, self.error = self.frames, ""
        if self.wire == "can":
            can = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
            can.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            can.bind((self.target["channel"],))
            descriptors = [can.detach()]
        elif self.wire == "i2c":
            descriptors = [os.open(self.target["path"], os.O_RDWR | os.O_CLOEXEC)]
            fcntl.ioctl(descriptors[0], I2C_TIMEOUT, 2)  # 20 ms
        if not descriptors:
            raise OSError("its descriptor did not arrive: too many are open")
        self.descriptor = descriptors[0]
        os.set_blocking(self.descriptor, False)

    def begin(self) -> None:
        """Throw away the motion that still waits in the kernel."""
        self.left = list(self.frames)
        with contextlib.suppress(termios.error):  # a pipe has no such queue
            termios.tcflush(self.descriptor, termios.TCOFLUSH)
            termios.tcflow(self.descriptor, termios.TCOON)

    def is_left(self) -> bool:
        """Send what goes out now; tell whether something is left."""
        try:
            while self.left:
                rest = self.left[0][self.write(self.left[0]) :]
                self.left = [rest, *self.left[1:]] if rest else self.left[1:]
        except OSError as error:
            self.error = str(error)
        return bool(self.left)

    def write(self, frame: bytes) -> int:
        """Write a frame; return how much of it has gone."""
        if self.wire == "gpio":
            fcntl.ioctl(self.descriptor, GPIO_SET_VALUES, frame)
        elif self.wire == "i2c":
            import ctypes  # where there is such a device

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
    """Watches one process."""

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
        """Return why the robot has to be made safe; empty after a good-bye."""
        beats, since, asked = self.numbers[BEATS], time.monotonic(), False
        while True:
            self.numbers[LOOKS] += 1
            events = dict(self.poll.poll(self.limit * 100))  # a tenth of it, in ms
            if self.pidfd in events:
                return "its process died"
            if self.channel.fileno() in events and self.hears_good_bye():
                return ""
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
                os.ftruncate(self.stack, 0)
                os.lseek(self.stack, 0, os.SEEK_SET)
                with contextlib.suppress(OSError):  # it is dead
                    signal.pidfd_send_signal(self.pidfd, TELL_STACK)

    def culprit(self) -> str:
        """Return who holds the process: the code next to it that is not a library's."""
        told = os.pread(self.stack, 65536, 0).decode(errors="replace")
        main = told.rpartition("hread 0x")[2].splitlines()  # the oldest comes last
        frames = [line.strip() for line in main if line.startswith("  File ")]
        libraries = os.path.dirname(os.__file__), os.path.dirname(__file__)[:-8]
        own = [each for each in frames if not each[6:].startswith(libraries)]
        return "".join(f", in {frame}" for frame in (own or frames)[:1])

    def hears_good_bye(self) -> bool:
        """Do what the robot asks for, and answer."""
        data, descriptors = b"", list[int]()
        with contextlib.suppress(OSError):  # it died before it heard an answer
            data, descriptors, *_ = socket.recv_fds(self.channel, 65536, 1)
        if not data:
            self.poll.unregister(self.channel)  # the pidfd tells whether it died
            return False
        told = json.loads(data)
        if told["op"] == "arm":
            try:
                device = self.devices[told["place"]] = Device(told, descriptors)
            except OSError as error:
                self.tell("refused", told["place"], str(error))
                return False
            self.poll.register(device.descriptor, 0)  # hang-up and error alone
        elif told["op"] == "drop":
            self.drop(told["place"])
        if told["op"] != "bye":
            self.tell("done", told["place"])
        return bool(told["op"] == "bye")

    def drop(self, place: int) -> None:
        """Watch a device no more."""
        if place in self.devices:
            device = self.devices.pop(place)
            self.poll.unregister(device.descriptor)
            os.close(device.descriptor)

    def tell(self, what: str, place: int, why: str = "") -> None:
        """Answer the robot."""
        with contextlib.suppress(OSError):  # the pidfd tells whether it died
            self.channel.send(json.dumps([what, place, why]).encode())

    def act(self, why: str) -> None:
        """Stop the process, make every device safe, end the process, and say so."""
        began = time.monotonic()
        self.numbers[LATCH] = 1
        with contextlib.suppress(OSError):  # it is dead
            signal.pidfd_send_signal(self.pidfd, signal.SIGSTOP)
            stat, state = f"/proc/{self.pid}/stat", b"R"
            while state not in b"TtZX" and time.monotonic() - began < STOP_WITHIN:
                with open(stat, "rb") as file:  # nothing of its comes after this
                    state = file.read().rpartition(b")")[2].split()[0]
        for device in self.devices.values():
            device.begin()
        waiting = list(self.devices.values())  # all of them before any is tried again
        while waiting := [device for device in waiting if device.is_left()]:
            if time.monotonic() - began > SEND_WITHIN:
                break
            time.sleep(0.001)
        took = (time.monotonic() - began) * 1000
        with contextlib.suppress(OSError):  # it is dead
            if self.policy == "kill":
                signal.pidfd_send_signal(self.pidfd, signal.SIGKILL)
        told = [
            f"{device.name} {f'NOT SAFE ({device.error})' if device.left else 'safe'}"
            for device in self.devices.values()
        ]
        told_all = ", ".join(told) or "nothing is watched"
        line = f"esair watchdog: {why}: {told_all}, after {took:.1f} ms\n"
        os.write(2, line.encode())


if __name__ == "__main__":
    for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(each, signal.SIG_IGN)
    dog = Watchdog(sys.argv[1:])
    if reason := dog.watch():
        dog.act(reason)
