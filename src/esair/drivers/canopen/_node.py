"""The life of a node: met, started, watched by its heartbeat, left."""

from __future__ import annotations

import asyncio
import collections
import concurrent.futures
import contextlib
import logging
import struct
import threading
from collections.abc import Callable
from typing import Any, Final, NamedTuple, Required, TypedDict, TypeVar

from esair.buses import CanBus, Exchanges, Frame
from esair.drivers._on_bus import ended, shared
from esair.exceptions import (
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
)
from esair.loading import of_extra
from esair.loop import Deadlines, Executor
from esair.resources import Resource
from esair.values import check_seconds, check_whole
from esair.watchdog import can_frame

with of_extra("canopen"):
    import canopen
    from canopen.emcy import EMCY_STRUCT, EmcyError
    from canopen.nmt import NmtError
    from canopen.objectdictionary import ObjectDictionary
    from canopen.sdo.client import SdoClient
    from canopen.sdo.constants import ABORT_TIMED_OUT, RESPONSE_ABORTED
    from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

ABSENT: Final = frozenset({ABORT_TIMED_OUT, 0x060A0023})
"""Aborts of a gateway that has not reached the node: timed out, no connection left."""

LATE_LIMIT: Final = 0.3
"""How long after its request was given up an answer may still come, in seconds."""

LOOP_TIMEOUT: Final = 1.0
"""How much longer the thread waits for the event loop to answer, in seconds."""


class RemoteNode(canopen.RemoteNode):
    """A node as the package sees it, with requests that go by `Exchanges`."""

    def __init__(
        self, number: int, dictionary: Any, bus: CanBus, exchanges: Exchanges
    ) -> None:
        self._bus = bus
        self._exchanges = exchanges
        super().__init__(number, dictionary)

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> SdoClient:
        """Make a client; the package has but the default one made."""
        make: Any = _Client  # the package is typed in part
        client: _Client = make(rx_cobid, tx_cobid, self.object_dictionary)
        client.take_over(self._bus, self._exchanges)
        self.sdo_channels.append(client)
        return client


class _Client(SdoClient):
    def take_over(self, bus: CanBus, exchanges: Exchanges) -> None:
        self._bus = bus
        self._exchanges = exchanges
        self._loop = asyncio.get_running_loop()

    def request_response(self, sdo_request: Any) -> bytes:
        """Send a request and return its answer, in the thread; never a late one."""
        sent = threading.Event()
        asking = asyncio.run_coroutine_threadsafe(
            self._ask(bytes(sdo_request), sent), self._loop
        )
        sent.wait(LATE_LIMIT + LOOP_TIMEOUT)
        try:
            response = asking.result(self.RESPONSE_TIMEOUT)
        except DriverStuckError:
            raise
        except (TimeoutError, concurrent.futures.CancelledError):
            asking.cancel()
            self.abort(ABORT_TIMED_OUT)  # type: ignore[no-untyped-call]
            raise SdoCommunicationError("No SDO response received") from None
        if response[0] == RESPONSE_ABORTED:
            abort = SdoAbortedError(struct.unpack_from("<L", response, 4)[0])
            if abort.code in ABSENT:
                raise SdoCommunicationError(f"a gateway says: {abort}")
            raise abort
        return response

    async def _ask(self, request: bytes, sent: threading.Event) -> bytes:
        async def send(_left: float) -> None:
            await self._bus.send(self.rx_cobid, request)
            sent.set()

        seconds = self.RESPONSE_TIMEOUT + LATE_LIMIT + LOOP_TIMEOUT
        try:
            return await self._exchanges.ask(
                send,
                *_answers(request),
                timeout=seconds,
                patience=self.RESPONSE_TIMEOUT,
            )
        finally:
            sent.set()


def _answers(request: bytes) -> list[bytes]:
    """Return what an answer begins with; a tool on the bus asks the node, too."""
    kinds = {1: range(0x60, 0x61), 2: range(0x40, 0x50)}.get(request[0] >> 5)
    if kinds is None:  # a piece of a long object, which has no place
        return []
    heads = (bytes((kind,)) for kind in (*kinds, RESPONSE_ABORTED))
    return [head + place for head in heads for place in (request[1:4], bytes(3))]


T = TypeVar("T")

_log = logging.getLogger("esair")

SEND_TIMEOUT = 0.2
"""How long one frame may wait for room on the bus, in seconds."""

HEARTBEATS_MISSED = 2.5
"""After how many heartbeat periods of silence a node is lost."""

DEVICE_TYPE, HEARTBEAT_TIME, IDENTITY = 0x1000, 0x1017, 0x1018
_BOOT_UP, _OPERATIONAL = 0, 5


class Emergency(NamedTuple):
    """What a node says in an emergency message.

    Attributes:
        code: The error code of the standard; 0 if an error is over.
        register: Its error register, which says what all errors are about, a bit each.
        data: Five bytes of the maker's.
    """

    code: int
    register: int
    data: bytes

    def __str__(self) -> str:
        said = EmcyError(self.code, self.register, self.data, 0.0).get_desc()
        return (
            f"emergency {self.code:#06x} ({said}), register {self.register:#04x}, "
            f"data {self.data.hex()}"
        )


class CanopenNetwork(canopen.Network):
    """The network of the package canopen, on a `CanBus` of esair.

    Its own methods are for one thread, `executor`, which may wait; what comes in is told
    by the event loop.

    Args:
        bus: The bus, which is open.
    """

    def __init__(self, bus: CanBus) -> None:
        super().__init__()
        self.executor: Executor = Executor(f"{bus.name}_canopen")
        self._can = bus
        self._loop = asyncio.get_running_loop()

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame from the executor.

        Raises:
            DeviceLostError: The bus is gone.
            DriverStuckError: There was no room in time.
        """
        if remote:
            raise DeviceFaultError("canopen", "remote frames are not sent")
        sending = asyncio.run_coroutine_threadsafe(
            self._can.send(
                can_id, bytes(data), extended=can_id > 0x7FF, timeout=SEND_TIMEOUT
            ),
            self._loop,
        )
        try:
            sending.result(SEND_TIMEOUT + LOOP_TIMEOUT)
        except TimeoutError as error:
            sending.cancel()
            if isinstance(error, DriverStuckError):
                raise
            raise DriverStuckError(
                self._can.name, "send", SEND_TIMEOUT + LOOP_TIMEOUT
            ) from None

    def send_periodic(self, *_: Any, **__: Any) -> Any:
        """Refuse: what repeats by itself would go on when the robot hangs."""
        raise DeviceFaultError("canopen", "nothing is sent periodically")


def sdo_frames(node: int, index: int, subindex: int, data: bytes) -> list[bytes]:
    """Return an abort of a transfer that was cut, and a write of up to four bytes."""
    place = struct.pack("<HB", index, subindex)
    abort = struct.pack("<B3sI", 0x80, place, 0x08000000)
    write = struct.pack("<B3s4s", 0x23 | (4 - len(data)) << 2, place, data)
    return [can_frame(0x600 + node, abort), can_frame(0x600 + node, write)]


class Node:
    """One node on a bus, open while at least one device uses it."""

    def __init__(self, bus: CanBus, number: int) -> None:
        self.bus = bus
        self.number = number
        self.users: set[OnNode] = set()
        self.usable = True
        """Whether devices may still join it; a new one is made otherwise."""
        # Those of the former opening, if there was one: what is owed is owed still.
        self.exchanges = shared(bus, Exchanges).setdefault(
            number, Exchanges(bus, late_limit=LATE_LIMIT)
        )
        self.opening = asyncio.Lock()
        self._identities: set[tuple[int | None, int | None]] = set()
        """The vendors and products of files with which it was compared."""
        self.is_mapped = False
        """Whether a drive has set up what its PDOs have."""
        self._is_open = False
        self.remote: Any = None
        self.network: CanopenNetwork | None = None
        self._pump: asyncio.Task[None] | None = None
        loop = asyncio.get_running_loop()
        self._watch = Deadlines.beside(loop).idle(self._is_silent)
        self._period = 0.0
        """From one heartbeat to the next, in seconds; 0 if there are none."""
        self._emergency: Emergency | None = None

    @property
    def is_running(self) -> bool:
        """Whether it is open, and neither silent nor started anew."""
        return self._is_open and self.usable

    async def open(self, device: OnNode) -> None:
        """Find the node, compare its identity, start it safely, and watch its heartbeat."""
        async with self.opening:
            if self._is_open:
                await self.call(device, self._identify, device.dictionary)
                wanted = device.heartbeat
                if wanted is not None and not 0 < self._period <= wanted:
                    self._period = await self.call(device, self._set_heartbeat, wanted)
                    self._arm_watch()
                return
            if not self.usable:
                raise DeviceLostError(device.name, f"node {self.number} is not there")
            self.network = CanopenNetwork(self.bus)
            self.remote = RemoteNode(
                self.number, device.dictionary, self.bus, self.exchanges
            )
            self.network.add_node(self.remote)
            self._inbox = self.bus.frames(
                *(base + self.number for base in (0x80, 0x580, 0x700)), limit=64
            )
            self._pump = asyncio.get_running_loop().create_task(
                self._take(self._inbox), name=f"{self.bus.name} node {self.number}"
            )
            try:
                self._period = await self.call(
                    device, self._begin, device.dictionary, device.heartbeat
                )
                await self.call(device, self._start, tuple(self.users))
                if not self.usable:
                    raise DeviceLostError(
                        device.name, f"node {self.number} has started anew meanwhile"
                    )
            except BaseException:
                self.usable = False
                raise
            self._is_open = True
            self._arm_watch()

    async def leave(self, device: OnNode) -> None:
        """Forget a device; the last one ends the thread and all listening."""
        self.users.discard(device)
        if self.users:
            return
        self.usable = False
        nodes = shared(self.bus, Node)
        if nodes.get(self.number) is self:
            del nodes[self.number]
        self._watch.cancel()
        await ended(self._pump)
        if self.network is not None:
            if self.remote is not None:
                self.remote.remove_network()
            await self.network.executor.join(timeout=1.0)

    async def call(
        self,
        device: OnNode,
        function: Callable[..., T],
        *args: Any,
        guard: Callable[[], bool] | None = None,
    ) -> T:
        """Call a function that waits for the node, in the thread of its network."""
        assert self.network is not None
        await self.exchanges.silence()  # here: the thread has a time for its answer

        def timed() -> T:  # there: another device's call may come before
            self.remote.sdo.RESPONSE_TIMEOUT = device.sdo_timeout
            return function(*args)

        try:
            return await self.network.executor.call(
                timed, timeout=device.deadline, guard=guard
            )
        except SdoAbortedError as error:
            raise DeviceFaultError(device.name, f"SDO abort: {error}") from error
        except (SdoCommunicationError, NmtError) as error:
            detail = f"node {self.number} does not answer: {error}"
            raise DeviceLostError(device.name, detail) from error

    def _begin(self, dictionary: ObjectDictionary, heartbeat: float | None) -> float:
        """Meet the node, in the thread; returns its heartbeat period in seconds."""
        self.remote.sdo.upload(DEVICE_TYPE, 0)
        self.remote.nmt.add_heartbeat_callback(self._beat)
        self._identify(dictionary)
        return self._set_heartbeat(heartbeat)

    def _identify(self, dictionary: ObjectDictionary) -> None:
        """Compare it with the file of a device, in the thread."""
        told = dictionary.device_information
        identity = told.vendor_number, told.product_number
        for subindex, wanted in enumerate(identity, 1):
            if wanted and identity not in self._identities:
                what = "vendor" if subindex == 1 else "product"
                answer = self.remote.sdo.upload(IDENTITY, subindex)
                found = int.from_bytes(answer, "little")
                if found != wanted:
                    raise DeviceFaultError(
                        f"node {self.number}",
                        f"its {what} is {found:#x} instead of {wanted:#x}: "
                        "another device, or another EDS file",
                    )
        self._identities.add(identity)

    def _set_heartbeat(self, heartbeat: float | None) -> float:
        """Have it beat, in the thread; returns its heartbeat period in seconds."""
        sdo = self.remote.sdo
        if heartbeat is not None:
            milliseconds = round(heartbeat * 1000)
            sdo.download(HEARTBEAT_TIME, 0, milliseconds.to_bytes(2, "little"))
        try:
            return int.from_bytes(sdo.upload(HEARTBEAT_TIME, 0), "little") / 1000
        except SdoAbortedError:
            return 0.0  # a node without a heartbeat: its loss shows when it is asked

    def _start(self, users: tuple[OnNode, ...]) -> None:
        """Have it obey what it was told: that is what is safe; in the thread."""
        for user in users:
            # It may take it once it runs; whose file is another's hears of it later.
            with contextlib.suppress(SdoAbortedError, DeviceFaultError):
                self._identify(user.dictionary)
                user.make_ready(self.remote)
        self.remote.nmt.state = "OPERATIONAL"

    async def _take(self, inbox: Any) -> None:
        assert self.network is not None
        with inbox:
            try:
                async for frame in inbox:
                    self._hear(frame)
            except ConnectionError as error:
                self.exchanges.fail(error)

    def _hear(self, frame: Frame) -> None:
        if frame.id == 0x580 + self.number:
            if len(frame.data) == 8:
                self.exchanges.offer(frame.data)
            return
        # Frames with wrong lengths must not end the listening.
        with contextlib.suppress(struct.error, IndexError, KeyError):
            if frame.id == 0x80 + self.number:
                self._heed(Emergency(*EMCY_STRUCT.unpack(frame.data)))
            else:
                assert self.network is not None
                self.network.notify(frame.id, bytearray(frame.data), frame.time)

    def _heed(self, emergency: Emergency) -> None:
        if emergency != self._emergency:  # not each of a flood
            _log.warning("%s: node %d: %s", self.bus.name, self.number, emergency)
        self._emergency = emergency
        for device in tuple(self.users):
            device.heed(emergency)

    def _beat(self, state: int) -> None:
        if state == _BOOT_UP:
            self.exchanges.clear()
            self._lost("it has started anew")
        elif state != _OPERATIONAL and self._is_open:
            self._lost(f"it does not run any more: its NMT state is {state}")
        else:
            self._arm_watch()

    def _arm_watch(self) -> None:
        self._watch.cancel()
        if self._period > 0.0 and self.usable:
            patience = HEARTBEATS_MISSED * self._period
            self._watch.start(asyncio.get_running_loop().time() + patience)

    def _is_silent(self) -> None:
        if self._inbox:  # this computer was held up, and has not looked yet
            self._arm_watch()
        else:
            self._lost(f"no heartbeat for {HEARTBEATS_MISSED * self._period:g} s")

    def _lost(self, why: str) -> None:
        self.usable = False
        for device in tuple(self.users):
            device.report_lost(
                DeviceLostError(device.name, f"node {self.number}: {why}")
            )


class NodeSettings(TypedDict, total=False):
    node: Required[int]
    heartbeat: float | None
    sdo_timeout: float


class OnNode(Resource):
    """What the devices on a node have in common: they share its opening."""

    dictionary: ObjectDictionary
    """The objects of the node."""

    emergencies: collections.deque[Emergency]
    """What the node has told in emergency messages, the newest last; 16 are kept."""

    bus: CanBus
    deadline: float = 2.0

    def __init__(
        self,
        *,
        node: int,
        heartbeat: float | None = None,
        sdo_timeout: float = 0.3,
        **settings: Any,
    ) -> None:
        super().__init__(**settings)
        self.node: int = check_whole(self.name, "node", node, 1, 127)
        self.heartbeat = heartbeat
        if heartbeat is not None and not 0.001 <= heartbeat <= 65.0:
            raise ConfigError(
                self.name, "heartbeat", f"expected 0.001 to 65 s, not {heartbeat!r}"
            )
        self.sdo_timeout: float = check_seconds(self.name, "sdo_timeout", sdo_timeout)
        self.emergencies = collections.deque(maxlen=16)
        self._link: Node | None = None

    async def open(self) -> None:
        """Open the node."""
        await self.close()
        nodes = shared(self.bus, Node)
        link = nodes.get(self.node)
        if link is None or not link.usable:
            link = nodes[self.node] = Node(self.bus, self.node)
        link.users.add(self)
        self._link = link
        await link.open(self)

    async def close(self) -> None:
        """Leave the node."""
        link, self._link = self._link, None
        if link is not None:
            await link.leave(self)

    async def is_set_up(self) -> bool:
        """Tell whether the node still runs, as far as its heartbeat shows it."""
        return self._link is not None and self._link.is_running

    def heed(self, emergency: Emergency) -> None:
        """Be told what the node says in an emergency message."""
        self.emergencies.append(emergency)

    def heed_mapping(self) -> None:
        """Be told that the PDOs of the node are set up anew."""

    def make_ready(self, remote: Any) -> None:
        """Tell the node what must be there before it is started, in its thread."""

    def _connected(self) -> Node:
        if self._link is None or self._link.remote is None:
            raise DeviceLostError(self.name, f"node {self.node} is not open")
        return self._link

    @property
    def _remote(self) -> Any:
        """The node as the package canopen has it."""
        return self._connected().remote

    async def _call(
        self,
        function: Callable[..., T],
        *args: Any,
        guard: Callable[[], bool] | None = None,
    ) -> T:
        return await self._connected().call(self, function, *args, guard=guard)
