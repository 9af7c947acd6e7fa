"""Traps of python-can: shown as they are, and absent through `CanBus`.

Each pair of tests is one trap: first the bare package, then the same fault through the
bus. When the first of a pair fails, the package has got better.
"""

from __future__ import annotations

import asyncio
import errno
import itertools
import os
import socket
import threading
import time
from typing import Any

import can
import pytest
from can.interfaces.socketcan import SocketcanBus

from esair.buses import CanBus
from esair.exceptions import DeviceFaultError, DeviceLostError

pytestmark = pytest.mark.real_clock

PATIENCE = 10.0


class Down(can.BusABC):
    """An interface that is read by a thread, and goes down."""

    channel_info = "down"

    def __init__(self, channel: Any = None, **options: Any) -> None:
        super().__init__(channel)
        self.fail = threading.Event()

    def _recv_internal(self, timeout: float | None) -> tuple[None, bool]:
        if self.fail.wait(timeout):
            raise can.CanOperationError("network is down", errno.ENETDOWN)
        return None, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("network is down", errno.ENETDOWN)


class Socket(socket.socket):
    """A socket of SocketCAN that is readable for ever, as after its interface left."""

    reads = 0
    sends = 0

    def recv(self, *arguments: Any) -> bytes:
        self.reads += 1
        raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))

    def recvmsg(self, *arguments: Any) -> Any:
        self.recv()

    def send(self, *arguments: Any) -> int:
        self.sends += 1
        raise OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))


class Node(SocketcanBus):
    """python-can's own bus, on a socket of ours."""

    def __init__(self, channel: Any = None, **options: Any) -> None:
        near, self.far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket = Socket(fileno=near.detach())
        self.channel = self.channel_info = "pair0"
        self._bcm_sockets = {}
        self._periodic_tasks = []
        self._is_shutdown = False
        self._is_filtered = True

    def shutdown(self) -> None:
        super().shutdown()
        self.far.close()


@pytest.fixture
def stray() -> list[Any]:
    """What reaches the exception handler of the event loop."""
    return []


def catch(stray: list[Any]) -> None:
    asyncio.get_running_loop().set_exception_handler(
        lambda _loop, context: stray.append(context["exception"])
    )


def raise_descriptor(node: Node, high: int, kind: type[socket.socket] = Socket) -> None:
    """Give the socket of a node a high number, as in a process with many files."""
    try:
        os.dup2(node.socket.fileno(), high)
    except OSError:
        node.shutdown()
        pytest.skip("a process may not have so many descriptors here")
    node.socket.close()
    node.socket = kind(fileno=high)


async def gone(waiting: asyncio.Future[Any]) -> None:
    waiting.cancel()
    await asyncio.wait({waiting})


@pytest.mark.fault("C06")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
async def test_python_can_waits_for_ever_when_its_thread_dies() -> None:
    """The error ends the thread of the notifier; its reader is told nothing."""
    node = Down()
    reader = can.AsyncBufferedReader()
    notifier = can.Notifier(
        node, [reader], timeout=0.1, loop=asyncio.get_running_loop()
    )
    (thread,) = notifier._readers
    waiting = asyncio.ensure_future(reader.get_message())

    node.fail.set()
    await asyncio.to_thread(thread.join, PATIENCE)
    await asyncio.sleep(0.2)

    assert not thread.is_alive()
    assert not waiting.done()
    await gone(waiting)
    notifier.stop()
    node.shutdown()


@pytest.mark.fault("C06")
async def test_here_a_thread_that_dies_is_a_loss(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Who waits has the error at once."""
    node = Down()
    monkeypatch.setattr(can, "Bus", lambda channel, interface: node)
    bus = CanBus(name="drive", interface="down", channel="x")
    await bus.open()
    inbox = bus.frames(1)

    node.fail.set()

    with pytest.raises(DeviceLostError, match="network is down"):
        await inbox.take(timeout=PATIENCE)
    await bus.close()


@pytest.mark.fault("C01")
async def test_python_can_storms_when_its_descriptor_fails(stray: list[Any]) -> None:
    """The same error again and again into the loop; its reader is told nothing."""
    catch(stray)
    node = Node()
    reader = can.AsyncBufferedReader()
    notifier = can.Notifier(node, [reader], loop=asyncio.get_running_loop())
    waiting = asyncio.ensure_future(reader.get_message())

    node.far.send(bytes(16))
    async with asyncio.timeout(PATIENCE):
        while len(stray) < 100:  # noqa: ASYNC110 - the exception handler counts
            await asyncio.sleep(0.01)

    assert not waiting.done()
    await gone(waiting)
    notifier.stop()
    node.shutdown()


@pytest.mark.fault("C01")
async def test_here_a_descriptor_that_fails_is_one_loss(
    stray: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is read once and watched no more."""
    catch(stray)
    node = Node()
    monkeypatch.setattr(can, "Bus", lambda channel, interface: node)
    bus = CanBus(name="drive", interface="pair", channel="x")
    told: list[BaseException] = []
    bus.on_lost(told.append)
    await bus.open()
    inbox = bus.frames(1)

    node.far.send(bytes(16))
    with pytest.raises(DeviceLostError, match="down"):
        await inbox.take(timeout=PATIENCE)
    await asyncio.sleep(0.1)

    assert (node.socket.reads, len(told), stray) == (1, 1, [])
    await bus.close()


@pytest.mark.long
async def test_python_can_keeps_the_loop_when_it_is_stopped() -> None:
    """Its stop waits for a thread that waits for a frame."""
    channel = f"stop-{os.getpid()}"
    node = can.Bus(channel, interface="virtual")
    notifier = can.Notifier(node, [], loop=asyncio.get_running_loop())
    await asyncio.sleep(0.05)

    begin = time.monotonic()
    notifier.stop()  # no await: nothing else runs meanwhile

    assert time.monotonic() - begin > 0.3
    node.shutdown()


async def test_here_a_close_keeps_nobody() -> None:
    """The loop turns while the thread ends."""
    bus = CanBus(name="drive", interface="virtual", channel=f"stop-{os.getpid()}")
    await bus.open()
    loop = asyncio.get_running_loop()
    turns = [loop.time()]

    async def turn() -> None:
        while True:
            await asyncio.sleep(0.005)
            turns.append(loop.time())

    turning = asyncio.create_task(turn())
    await asyncio.sleep(0.05)
    await bus.close()
    turning.cancel()
    await asyncio.wait({turning})

    assert max(b - a for a, b in itertools.pairwise(turns)) < 0.25


@pytest.mark.fault("C04")
async def test_python_can_gives_up_at_once_when_the_queue_is_full() -> None:
    """A time-out does not help: the socket is writable, the queue behind it is full."""
    node = Node()
    message = can.Message(arbitration_id=1)

    begin = time.monotonic()
    with pytest.raises(can.CanOperationError) as caught:
        node.send(message, timeout=PATIENCE)

    assert caught.value.error_code == errno.ENOBUFS
    assert time.monotonic() - begin < PATIENCE / 2
    assert node.socket.sends == 1
    node.shutdown()


@pytest.mark.fault("C04")
async def test_here_a_full_queue_is_tried_again_until_the_deadline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With growing pauses, and the loop goes on."""
    node = Node()
    monkeypatch.setattr(can, "Bus", lambda channel, interface: node)
    bus = CanBus(name="drive", interface="pair", channel="x")
    await bus.open()
    loop = asyncio.get_running_loop()
    begin = loop.time()

    with pytest.raises(DeviceFaultError, match="acknowledges"):
        await bus.send(1, b"", timeout=0.3)

    assert loop.time() - begin >= 0.3
    assert 3 < node.socket.sends < 40
    await bus.close()


async def test_python_can_fails_on_a_descriptor_above_1023() -> None:
    """It uses select() for each frame; then it is deaf, and mad."""
    node = Node()
    raise_descriptor(node, 1500)

    with pytest.raises(ValueError, match="out of range"):
        node.recv(timeout=0)
    with pytest.raises(ValueError, match="out of range"):
        node.send(can.Message(arbitration_id=1))
    node.shutdown()


async def test_here_a_descriptor_above_1023_is_as_good_as_any(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The event loop watches it, and no select() is called."""
    node = Node()
    raise_descriptor(node, 1501, kind=socket.socket)
    far = node.far
    monkeypatch.setattr(can, "Bus", lambda channel, interface: node)
    bus = CanBus(name="drive", interface="pair", channel="x")
    await bus.open()
    inbox = bus.frames(1)

    far.send((1).to_bytes(4, "little") + bytes((2, 0, 0, 0)) + b"in".ljust(8, b"\0"))
    await bus.send(2, b"out")

    assert (await inbox.take(timeout=PATIENCE)).data == b"in"
    assert far.recv(16)[8:11] == b"out"
    await bus.close()
