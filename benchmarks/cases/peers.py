"""Peers on the other end of a wire, each in a process of its own.

They cost the measured process nothing, and are the same for everybody measured.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pty
import select
import socket
import struct
import time
import tty
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus

FRAME = struct.Struct("=IB3x8s")
"""A CAN frame as SocketCAN has it: id, length, data."""

_FORK = multiprocessing.get_context("fork")


@contextlib.contextmanager
def echo_terminal() -> Iterator[str]:
    """A pseudo-terminal that gives back what it gets; yields its path."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    process = _FORK.Process(target=_echo, args=(master,), daemon=True)
    process.start()
    try:
        yield os.ttyname(slave)
    finally:
        process.kill()
        process.join()
        os.close(master)
        os.close(slave)


def _echo(master: int) -> None:
    while True:
        os.write(master, os.read(master, 4096))


class PairBus(SocketcanBus):
    """python-can's ``socketcan`` on one end of a pair of sockets.

    It stands for the kernel's CAN where there is none: the same class, the same frames,
    the same system calls; only the way in and out of the kernel is another.
    """

    ends: dict[str, socket.socket] = {}  # noqa: RUF012 - found by the name of the channel

    def __init__(self, channel: str, **_options: Any) -> None:
        self.socket = self.ends[channel].dup()
        self.channel = self.channel_info = channel
        self._bcm_sockets: dict[str, socket.socket] = {}
        self._periodic_tasks = []
        self._filters = None
        self._is_filtered = False
        self._is_shutdown = False

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """What SocketcanBus does, without the time stamp that a pair has not."""
        ready, _, _ = select.select([self.socket], [], [], timeout)
        if not ready:
            return None, False
        packed, _, _, _ = self.socket.recvmsg(FRAME.size, 64)
        number, length, data = FRAME.unpack(packed)
        message = can.Message(
            timestamp=time.time(),
            arbitration_id=number,
            is_extended_id=False,
            dlc=length,
            data=data[:length],
        )
        return message, False


_Bus = can.Bus


def _open(channel: str, interface: str, **options: Any) -> can.BusABC:
    if interface == "pair":
        return PairBus(channel, **options)
    return _Bus(channel, interface=interface, **options)


can.Bus = _open  # type: ignore[assignment]  # only packages can add an interface


@contextlib.contextmanager
def can_peer(serve: Any, *arguments: Any) -> Iterator[tuple[str, Connection]]:
    """A process on the other end of a bus; yields the channel and a pipe to it."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    near.setblocking(False)
    mine, theirs = _FORK.Pipe()
    process = _FORK.Process(target=serve, args=(far, theirs, *arguments), daemon=True)
    process.start()
    channel = f"pair{near.fileno()}"
    PairBus.ends[channel] = near
    try:
        yield channel, mine
    finally:
        process.kill()
        process.join()
        del PairBus.ends[channel]
        near.close()
        far.close()
        mine.close()
        theirs.close()


def answer(far: socket.socket, _pipe: Connection) -> None:
    """Answer each frame with another one."""
    reply = FRAME.pack(0x181, 8, bytes(8))
    while True:
        far.recv(16)
        far.send(reply)


def flood(far: socket.socket, pipe: Connection) -> None:
    """Send as many frames as the pipe says, as fast as they are taken."""
    while True:
        count = pipe.recv()
        for number in range(count):
            far.send(FRAME.pack(0x181, 8, number.to_bytes(8, "little")))


def ask_and_time(far: socket.socket, pipe: Connection) -> None:
    """Send frames at some distance and measure how long each answer takes."""
    while True:
        count, pause = pipe.recv()
        took = []
        for number in range(count):
            time.sleep(pause)
            begin = time.perf_counter()
            far.send(FRAME.pack(0x181, 8, number.to_bytes(8, "little")))
            while True:  # a repeated or a safe command is no answer
                _, _, data = FRAME.unpack(far.recv(16))
                if int.from_bytes(data, "little") == number:
                    break
            took.append(time.perf_counter() - begin)
        pipe.send(took)
