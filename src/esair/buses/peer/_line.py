"""The ways to one endpoint: new ones are opened while its peer is silent."""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import threading
from collections.abc import Callable, Iterable
from typing import Any, Final, Protocol

_STANDING: Final = 2  # ways where all is well
_FRESH: Final = 5  # how many are opened at once where it can be reached again
_MOST: Final = 22  # ways at a time, if there are cuts all the time
_RESTLESS: Final = 0.5  # so long after a silence everything is said on all ways
_CLOSED: Final = 10.0  # so long after it those are given up that were not heard since
_HELD: Final = 1.0  # how long a knock is held that connects
_RESOLVED: Final = 200  # knocks after which a name is resolved again

PAUSE: Final = 0.05
"""How long after each other knocks begin, in seconds."""


class Way(Protocol):
    """One connection to an endpoint; `heard` tells when something has come by it."""

    heard: float

    def hear(self, wanted: bool, /) -> None:
        """Hear what comes by it, or no more."""

    def close(self) -> None:
        """End it; may take a while."""


def close_all(ways: Iterable[Way]) -> list[threading.Thread]:
    """Close each at once: one that tries to connect waits until its try is over."""
    closing = [threading.Thread(target=each.close, daemon=True) for each in ways]
    for thread in closing:
        thread.start()
    return closing


def pause(lines: Iterable[Line]) -> None:
    """Wait for a while, or until a knock of one of them has an answer."""
    answers = select.poll()
    for knock in (knock for line in lines for knock in line.knocks):
        answers.register(knock, select.POLLOUT)
    answers.poll(1000.0 * PAUSE)


class Knock:
    """A bare connection, to see whether an endpoint can be reached."""

    def __init__(self, family: int, address: Any) -> None:
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._begun = self._socket.connect_ex(address) in {0, errno.EINPROGRESS}
        self.close, self.fileno = self._socket.close, self._socket.fileno

    def answer(self) -> bool | None:
        """Tell whether it is connected; None if that is not known yet."""
        error = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error or not self._begun:  # it was refused, or there is no way at all
            return False
        with contextlib.suppress(OSError):
            return bool(self._socket.getpeername())
        return None


class Line:
    """The ways to one endpoint.

    While its peer is silent it is knocked there, with bare connections in quick succession:
    one whose first packet is lost, or was sent in a cut, holds nobody up. When one connects
    after a while in which none did, several ways are opened at once. Those from before stay:
    the peer may just have been stopped. Where all is well again two are kept in the end.

    Args:
        host: Where it is.
        port: Its port.
        timeout: How long a knock may take, in seconds.
        make: Opens a way.

    Attributes:
        ways: Those that are open.
        best: By which the newest was heard first.
        peers: Who was heard there.
        silent: Whether one of them is not heard now.
        restless: Whether one of them was not heard a short time ago.
    """

    def __init__(
        self, host: str, port: int, timeout: float, make: Callable[[Line], Way]
    ) -> None:
        self.ways: tuple[Way, ...] = ()
        self.best: Way | None = None
        self.peers: set[str] = set()
        self.silent = self.restless = False
        self._host, self._port, self._timeout, self._make = host, port, timeout, make
        self._places: list[tuple[int, Any]] = []
        self._tries = 0
        self._knocks: list[tuple[float, Knock]] = []
        self._is_up = False
        self._held_until = self._silent_at = self._next = 0.0

    def leads_to(self, peer: str) -> bool:
        """Tell whether it may be there."""
        return not self.peers or peer in self.peers

    @property
    def knocks(self) -> list[Knock]:
        """Those that wait for an answer."""
        return [] if self._held_until else [knock for _, knock in self._knocks]

    def step(self, now: float) -> bool:
        """Do what is to be done now, on a thread; tell whether there is more."""
        if self.silent:
            self.restless, self._silent_at = True, now
            if now >= self._held_until:
                self._look(now)
        else:
            self._is_up = False
            self._forget()
            self.restless = now - self._silent_at < _RESTLESS
        if self.restless:
            for way in self.ways:
                way.hear(True)
            return True
        ways, is_soon = self._in_order(), now - self._silent_at < _CLOSED
        for way in ways[1:_STANDING]:
            way.hear(False)
        # To close one holds threads of zenoh up until TCP has sent there what was lost.
        broken = [
            each
            for each in ways[_STANDING:]
            if is_soon and each.heard < self._silent_at
        ]
        self._keep([*ways[:_STANDING], *broken])
        return bool(broken)

    def end(self) -> tuple[Way, ...]:
        """Forget all ways; return them, to be closed."""
        self._forget()
        ways, self.ways = self.ways, ()
        return ways

    def _look(self, now: float) -> None:
        if self._held_until:
            self._forget()
        for begun, knock in tuple(self._knocks):
            answer = knock.answer()
            if answer:
                self._held_until = now + _HELD
                if not self._is_up:
                    self._keep(self._in_order()[: _MOST - _FRESH])
                    for _ in range(_FRESH):
                        self.ways += (self._make(self),)
                    self._is_up = True
                return
            if answer is False or now - begun > self._timeout:
                self._is_up = False
                self._knocks.remove((begun, knock))
                knock.close()
        if now < self._next:
            return
        self._next = now + 0.9 * PAUSE
        with contextlib.suppress(OSError):  # no such name, no more sockets
            self._tries += 1
            if not self._places or self._tries % _RESOLVED == 0:
                kind = socket.SOCK_STREAM
                found = socket.getaddrinfo(self._host, self._port, type=kind)
                self._places = [(each[0], each[4]) for each in found]
            place = self._places[self._tries % len(self._places)]
            self._knocks.append((now, Knock(*place)))

    def _forget(self) -> None:
        """Close all knocks; who was let in by one may need a while for that."""
        for _, knock in self._knocks:
            knock.close()
        self._knocks.clear()
        self._held_until = 0.0

    def _in_order(self) -> list[Way]:
        return sorted(self.ways, key=lambda way: (way is not self.best, -way.heard))

    def _keep(self, ways: list[Way]) -> None:
        over = [each for each in self.ways if each not in ways]
        self.ways = tuple(ways)
        close_all(over)
