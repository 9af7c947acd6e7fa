"""CAN buses, whatever package or wire is behind them."""

from __future__ import annotations

import asyncio
import contextlib
import errno
from collections.abc import Callable, Hashable
from typing import Any, Final, Literal

from esair.buses._bus import Bus, BusStats, Wire, listen
from esair.buses._inbox import Inbox, within
from esair.buses.can._frame import (
    EXTENDED,
    CanState,
    ErrorFrame,
    Filter,
    Frame,
    FrameInbox,
    FrameKind,
    FrameLink,
    Ids,
    check_data,
    decode_error,
    filters_of,
    key_of,
)
from esair.exceptions import (
    BusyError,
    ConfigError,
    DeviceFaultError,
    DeviceLostError,
    DriverStuckError,
    EsairError,
    describe,
)
from esair.loop import Turns, Urgency, urgency, wake
from esair.values import check_choice, check_duration
from esair.watchdog import Outlet

ROUTES_LIMIT: Final = 4096
"""Of how many ids it is remembered who listens to them."""


class Routes(dict[int, tuple[FrameInbox, ...]]):
    """The inboxes of each id that came; found when it comes for the first time."""

    def __init__(self) -> None:
        super().__init__()
        self._filters: dict[FrameInbox, tuple[Filter, ...]] = {}

    def __missing__(self, key: int) -> tuple[FrameInbox, ...]:
        if len(self) >= ROUTES_LIMIT:
            self.clear()
        found = self[key] = tuple(
            inbox
            for inbox, filters in self._filters.items()
            if any(key & mask == wanted for wanted, mask in filters)
        )
        return found

    @property
    def filters(self) -> frozenset[Filter]:
        """All ids that somebody listens to."""
        return frozenset(each for some in self._filters.values() for each in some)

    def add(self, inbox: FrameInbox, filters: tuple[Filter, ...]) -> None:
        """Let an inbox have the frames with some ids."""
        self._filters[inbox] = filters
        self.clear()

    def remove(self, inbox: FrameInbox) -> None:
        """Let an inbox have nothing more."""
        self._filters.pop(inbox, None)
        self.clear()

    def fail(self, error: Exception) -> None:
        """Forget all inboxes, and let them raise an error."""
        inboxes, self._filters = tuple(self._filters), {}
        self.clear()
        for inbox in inboxes:
            inbox.fail(error)


RETRY_PERIOD = 0.001
"""The first pause before a frame is offered again to a full queue, in seconds."""

LONGEST_RETRY_PERIOD = 0.02
"""The longest pause before a frame is offered again, in seconds."""

WAITING_LIMIT = 256
"""How many frames may wait for room."""


class Outbox:
    """Frames on their way to the controller; those with one id keep their order.

    If there is no room the most urgent one is offered again, the others behind it.
    """

    def __init__(self, name: str, stats: BusStats) -> None:
        self.link: FrameLink | None = None
        """The node that takes them; what waits for room for another one is lost."""
        self._name = name
        self._stats = stats
        self._line: list[_Waiting] = []
        self._turns = Turns()

    @property
    def waiting(self) -> int:
        """How many are on their way."""
        return len(self._line)

    async def send(
        self, key: int, frame: Frame, seconds: float, replaces: Hashable | None
    ) -> bool:
        """Offer a frame until there is room; tells whether there was in time."""
        link = self.link
        assert link is not None
        mine, line = _Waiting(key, replaces, urgency.get()), self._line
        for older in line if replaces is not None else ():
            if (older.key, older.replaces) == (key, replaces):
                older.is_obsolete = True
                wake(older.woken)
        is_first = not line  # hot
        line.append(mine)
        try:
            if (is_first or self._first() is mine) and await link.send(frame, seconds):
                return True
            return await self._again(link, frame, seconds, mine)
        finally:
            line.remove(mine)
            if line:
                wake(self._first().woken)

    def _first(self) -> _Waiting:
        """Return the most urgent one of those that are the first with their ids."""
        firsts = {each.key: each for each in reversed(self._line)}
        return min(reversed(firsts.values()), key=self._turns.rank)

    async def _again(
        self, link: FrameLink, frame: Frame, seconds: float, mine: _Waiting
    ) -> bool:
        if not self._turns.has_room(len(self._line) - 1, WAITING_LIMIT, mine.urgency):
            raise BusyError(
                f"bus {self._name}", "number of waiting frames", WAITING_LIMIT
            )
        loop = asyncio.get_running_loop()
        give_up = loop.time() + seconds
        pause = RETRY_PERIOD
        while (left := give_up - loop.time()) > 0:
            if mine.is_obsolete:
                raise BusyError(
                    f"bus {self._name}", f"frames waiting with id {frame.id:#x}", 1
                )
            first = self._first()
            if first is not mine:
                wake(first.woken)  # it may be the first since this moment
            mine.woken = loop.create_future()
            with contextlib.suppress(TimeoutError):
                await within(mine.woken, min(pause, left) if first is mine else left)
            if self.link is not link:
                raise DeviceLostError(
                    self._name, "the bus was lost while a frame waited"
                )
            left = give_up - loop.time()
            if mine.is_obsolete or self._first() is not mine or left <= 0:
                continue
            pause = min(2 * pause, LONGEST_RETRY_PERIOD)
            self._stats.retries += 1
            if await link.send(frame, max(RETRY_PERIOD, left)):
                self._turns.taken(mine)
                return True
        return False


class _Waiting:
    """A frame on its way, until it is sent or a newer one makes it obsolete."""

    is_obsolete = False
    woken: asyncio.Future[None] | None = None

    def __init__(self, key: int, replaces: Hashable | None, urgent: Urgency) -> None:
        self.key = key
        self.replaces = replaces
        self.urgency = urgent


_DATA = FrameKind.DATA


class CanBus(Bus):
    """A CAN bus, and who listens to which frames on it.

    Reading never misses that the bus is gone: whatever ends it reaches everybody
    on the bus as one loss. Sending never blocks the event loop: a frame that the
    controller's queue has no room for is offered again until its deadline; frames with
    one id leave in their order, and a newer one takes the place of one that waits only
    where its sender says so. Whatever happens to a frame, its sender is told.

    Only frames that somebody listens to reach this process, where the interface can
    choose (SocketCAN); the others cost nothing and are not counted.

    A controller that goes bus-off is a loss, and one that has been restarted is too,
    whoever did that (``restart-ms``): what is on the bus must be opened again, and gets
    no command but a fresh one. There is no way to have the kernel or python-can repeat
    a frame by itself: it would keep the last motion alive while this process hangs.

    Args:
        name: The name of the bus.
        interface: What python-can calls it, such as ``socketcan`` or ``virtual``.
        channel: Which of them, such as ``can0``.
        send_timeout: How long a frame may wait for room unless it says otherwise,
            in seconds.
        fd: Whether frames may have up to 64 bytes, which the interface must be set
            up for.
        bitrate_switch: Whether the data of frames with more than 8 bytes are sent at the
            data bit rate that the interface is set up with; needs ``fd``.
        lost_when: At which state of the controller the bus counts as lost. Short of
            bus-off it works on; `on_state` tells.
        wire: What is opened instead of an interface, such as a bus in memory.
        **options: Further options of ``can.Bus``, such as ``bitrate=500_000``. An
            interface of the kernel has its bit rate already: another one is refused.
    """

    def __init__(
        self,
        *,
        name: str,
        interface: str = "socketcan",
        channel: str = "",
        send_timeout: float = 0.1,
        fd: bool = False,
        bitrate_switch: bool = False,
        lost_when: Literal["warning", "passive", "bus_off"] = "bus_off",
        wire: Wire | None = None,
        **options: Any,
    ) -> None:
        super().__init__(name=name, wire=wire)
        if not channel and wire is None:
            raise ConfigError(
                name, "channel", "expected the name of a channel, such as 'can0'"
            )
        if bitrate_switch and not fd:
            raise ConfigError(name, "bitrate_switch", "only CAN FD has it: fd=True")
        self.interface = interface
        self.channel = channel
        self.send_timeout = send_timeout
        self.fd = fd
        self.bitrate_switch = bitrate_switch
        check_choice(name, "lost_when", lost_when, ("warning", "passive", "bus_off"))
        self._lost_when = CanState[lost_when.upper()]
        self._state = CanState.ACTIVE
        self._on_state: list[Callable[[CanState], None]] = []
        self._options = options
        self._of_kernel = wire is None and interface == "socketcan"
        if self._of_kernel:
            self._presence = self._look
        self._epoch = 0
        self._lost_in_opening: Exception | None = None
        self._routes = Routes()
        self._outbox = Outbox(name, self.stats)
        self._unacknowledged = False

    @property
    def outlet(self) -> Outlet | None:
        """A socket of the watchdog's own, on an interface of the kernel."""
        if not (self._of_kernel and self.is_open):
            return None
        return Outlet("can", {"channel": self.channel})

    @property
    def state(self) -> CanState:
        """The state of the controller, as it was told last."""
        return self._state

    @property
    def waiting(self) -> int:
        """How many frames are on their way to the controller."""
        return self._outbox.waiting

    def on_state(self, listener: Callable[[CanState], None]) -> Callable[[], None]:
        """Call a function when the controller enters another state; returns how to stop."""
        return listen(self._on_state, listener)

    def frames(
        self,
        *ids: Ids,
        extended: bool = False,
        length: int | None = None,
        limit: int = 16,
        newest: bool = False,
    ) -> Inbox[Frame]:
        """Listen to the data frames with some ids.

        Args:
            *ids: Arbitration ids: one, ``range(0x580, 0x600)``,
                ``Mask(0x180, 0x780)``, or ``ALL``.
            extended: Whether these are ids of 29 bits; a standard id with the same
                number is another one.
            length: How many bytes they must have; others are counted as bad frames.
            limit: How many are kept until they are taken; then the newest win.
            newest: Whether to keep only the newest frame of each id, instead; of ids
                that are not listed, those of ``limit`` ids.

        Raises:
            DeviceLostError: The bus is not open.
            BadValueError: There is no id, or one that is none.
        """
        self._connected()
        filters = filters_of(self.name, ids, extended=extended)
        if newest and all(each.is_exact for each in filters):
            limit = len(filters)
        inbox = FrameInbox(
            limit, self._forget, stats=self.stats, length=length, newest=newest
        )
        self._routes.add(inbox, filters)
        self._choose()
        return inbox

    async def send(
        self,
        id: int,  # noqa: A002 - what everybody calls it
        data: bytes,
        *,
        extended: bool = False,
        replaces: Hashable | None = None,
        timeout: float | None = None,
    ) -> None:
        """Send a frame: hand it to the controller, which sends it when the bus is free.

        Args:
            id: The arbitration id.
            data: Its 0 to 8 bytes; up to 64 with CAN FD.
            extended: Whether the id has 29 bits.
            replaces: True if a frame with this id that still waits for room is obsolete
                by it. Another value than True: only one that was sent with the same
                value, such as what a multiplexed command is about.
            timeout: How long to wait for room, in seconds; ``send_timeout`` if None.

        Raises:
            BadValueError: The id or the data are not those of a frame.
            DeviceLostError: The bus is gone.
            BusyError: A newer frame replaced it, or too many frames wait;
                this one was not sent.
            DeviceFaultError: There was no room in time, and no other node acknowledges;
                it was not sent. Or the interface does not take such a frame.
            DriverStuckError: There was no room in time; it was not sent.
        """
        link = self._connected()
        key = key_of(self.name, id, extended=extended)
        if type(data) is not bytes or len(data) > 8:
            data = check_data(self.name, data, fd=self.fd)
        frame = Frame(id, data, extended)
        seconds = self.send_timeout
        if timeout is not None:
            seconds = check_duration(self.name, "timeout", timeout)
        heard = self.stats.received
        try:
            if not await self._outbox.send(key, frame, seconds, replaces):
                raise self._no_room(seconds, heard)
        except EsairError as error:
            if isinstance(error, BusyError):
                self.stats.refused += 1
            elif isinstance(error, DeviceFaultError | DriverStuckError):
                self.failed(error)
            raise
        except OSError as error:
            loss = self.loss(error)
            if self._outbox.link is link:
                self._gone(self._epoch, loss)
            raise loss from error
        self.stats.sent += 1

    def _no_room(self, seconds: float, heard: int) -> EsairError:
        self.stats.discarded += 1
        if self._unacknowledged:
            return self._silent(
                f"no other node acknowledges, for {seconds:g} s: is one on the bus, "
                "switched on, with the same bit rate?"
            )
        if self.stats.received == heard:
            return self._silent(
                f"no frame was sent for {seconds:g} s, and none came: no other node "
                "acknowledges; is one on the bus, switched on, with the same bit rate?"
            )
        return DriverStuckError(self.name, "send", seconds)

    def _silent(self, detail: str) -> DeviceFaultError:
        fault = DeviceFaultError(self.name, detail)
        fault.errno = errno.ETIMEDOUT  # nobody has said anything wrong
        return fault

    def _connected(self) -> FrameLink:
        if not self.is_open or self._outbox.link is None:
            raise DeviceLostError(self.name, "the bus is not open")
        return self._outbox.link

    def _forget(self, inbox: Inbox[Frame]) -> None:
        assert isinstance(inbox, FrameInbox)
        self._routes.remove(inbox)
        self._choose()

    def _choose(self) -> None:
        if not self.is_open or self._outbox.link is None:
            return
        try:
            self._outbox.link.listen(self._routes.filters)
        except OSError as error:
            self._gone(self._epoch, error)

    async def _open(self) -> None:
        self._epoch += 1
        epoch = self._epoch
        self._lost_in_opening = None
        self._unacknowledged = False
        try:
            link = await self._reach(lambda error: self._gone(epoch, error))
        except EsairError:
            raise
        except OSError as error:
            where = f"{self.interface} {self.channel}".strip()
            detail = f"{where} cannot be opened: {describe(error)}"
            raise DeviceLostError(self.name, detail) from error
        lost = self._lost_in_opening
        if lost is None and link.state >= self._lost_when:
            lost = self._in_bad_state(link.state)
        if lost is not None:
            self._epoch += 1
            await link.close()
            raise lost
        self._outbox.link = link
        self._enter(link.state)

    async def _reach(self, gone: Callable[[Exception], None]) -> FrameLink:
        link: FrameLink
        if self._wire is not None:
            link = await (await self._far_end(self._wire)).open(self._received, gone)
            return link
        from esair.buses.can._python_can import python_can

        opener = python_can(
            self.interface,
            self.channel,
            executor=self.executor,
            stats=self.stats,
            fd=self.fd,
            bitrate_switch=self.bitrate_switch,
            **self._options,
        )
        return await opener(self._received, gone)

    async def _close(self) -> None:
        self._epoch += 1
        link, self._outbox.link = self._outbox.link, None
        self._routes.fail(DeviceLostError(self.name, "the bus was closed"))
        if link is not None:
            await link.close()

    def _received(self, frame: Frame) -> None:
        inboxes = self._routes[frame.id | EXTENDED if frame.extended else frame.id]
        if frame.kind is FrameKind.ERROR:
            self._heed(decode_error(frame.id, frame.data))
            return
        stats = self.stats
        stats.received += 1
        self._unacknowledged = False
        if frame.kind is _DATA:
            for inbox in inboxes:
                inbox.offer(frame)
        elif inboxes:  # a remote frame where data are expected
            stats.bad_frames += 1
        stats.unheard += not inboxes

    def _heed(self, error: ErrorFrame) -> None:
        stats = self.stats
        stats.errors += 1
        stats.last_error = error.text
        if error.overflow:
            stats.dropped += 1
        if error.unacknowledged:
            self._unacknowledged = True
        if error.state is None:
            return
        self._enter(error.state)
        if error.restarted:
            self._gone(self._epoch, DeviceLostError(self.name, error.text))
        elif error.state >= self._lost_when:
            self._gone(self._epoch, self._in_bad_state(error.state))

    def _enter(self, state: CanState) -> None:
        if state is self._state:
            return
        self._state = state
        self._tell(self._on_state, state)

    def _in_bad_state(self, state: CanState) -> DeviceLostError:
        told = f"the controller is error-{state.name.lower()}, as lost_when says"
        if state is CanState.BUS_OFF:
            told = "the controller is bus-off: it must be started again"
            if self._of_kernel:
                set_up = f"ip link set {self.channel}"
                told += f" ({set_up} down; {set_up} up)"
        return DeviceLostError(self.name, told)

    def _gone(self, epoch: int, error: Exception) -> None:
        if epoch != self._epoch:
            return
        loss = self.loss(error)
        if not self.is_open:
            self._lost_in_opening = self._lost_in_opening or loss
            return
        self._epoch += 1
        self._routes.fail(loss)
        self.lost(loss)

    def _look(self) -> Hashable | None:
        from esair.buses.can._interfaces import is_there

        return is_there(self.channel)
