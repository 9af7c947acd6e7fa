"""A behavior of another robot: it is asked like one of this robot."""

from __future__ import annotations

import asyncio
import itertools
import weakref
from collections.abc import Iterable
from functools import partial
from typing import Any, Final

from esair.actions import Behavior, Request, answer_type, declared_requests, takes
from esair.buses.peer import PeerBus
from esair.codec import CodecError, decode, encode
from esair.exceptions import (
    BehaviorFailedError,
    BehaviorRemovedError,
    DeviceLostError,
    EsairError,
    OutcomeUnknownError,
    describe,
)
from esair.loop import News, outside
from esair.values import fits, type_name

made_for: weakref.WeakKeyDictionary[asyncio.Task[Any], tuple[int, ...]] = (
    weakref.WeakKeyDictionary()
)
"""The numbers of the asks of other robots that wait for a task, the nearest first."""

NEAREST: Final = 16
"""How many of them are told to the next robot."""


class PeerBehavior(Behavior):
    """Stands here for a behavior of a peer; `peer_behavior` makes one.

    Each request has one outcome. One whose answer is lost with the peer ends as
    `OutcomeUnknownError`, never as failed; one that was not sent is refused.
    """

    bus: PeerBus
    remote: str
    doing_there: str
    """What is said of it when there was no answer in time."""
    asked_alone: Final = "put and get do not cross to another robot: ask it"

    async def setup(self) -> None:
        """Let the progress cross."""
        self._working: dict[int, Request[Any]] = {}
        self._numbers = itertools.count()
        loop = asyncio.get_running_loop()
        self._told = News(loop, ("peer", self.name, "progress"), self._hear)
        self._numbered = News(loop, ("peer", self.name, "asks"), self._number)

    async def run(self) -> None:
        """Hand each request on, those of one class one after the other."""
        async with asyncio.TaskGroup() as tasks:
            for attribute in declared_requests(type(self)):
                tasks.create_task(self._serve(getattr(self, attribute)))

    async def _serve(self, requests: Any) -> None:
        async for request in requests:
            number = next(self._numbers)
            self._working[number] = request
            try:
                async with request:
                    await self._hand_on(number, request)
            except EsairError:
                pass  # the asker has it
            finally:
                del self._working[number]

    def _number(self, number: int, asked: int) -> None:
        if number in self._working:
            order: Any = self._working[number]._order  # noqa: SLF001
            order.crossed = asked

    async def _hand_on(self, number: int, request: Request[Any]) -> None:
        tag = "peer", self.name, "ask"
        causes = _causes(request)
        how, data = await outside(tag, partial(self._ask, number, request.data, causes))
        try:
            value = decode(data, self.bus.kinds)
        except CodecError as error:
            how, value = "lost", describe(error)
        if how == "answered":
            wanted = answer_type(type(request.data))
            if not fits(value, wanted):
                told = f"it answered {value!r:.80}, not {type_name(wanted)}"
                raise BehaviorFailedError(self.name, told)
            request.answer(value)
        elif how == "declined":
            request.refuse(str(value))
        elif how == "failed":
            raise BehaviorFailedError(self.name, str(value))
        elif how == "removed":
            raise BehaviorRemovedError(self.name)
        else:
            raise OutcomeUnknownError(self.name, str(value))

    async def _ask(
        self, number: int, request: object, causes: tuple[int, ...]
    ) -> tuple[str, bytes]:
        """Ask over the network; what comes of it is plain, and kept in a recording."""
        bus = self.bus

        def progress(value: Any) -> None:
            self._told.tell(number, encode(value, bus.kinds))

        def numbered(asked: int) -> None:
            self._numbered.tell(number, asked)
            if causes:
                bus.say("because", asked, causes if causes[1:] else causes[0])

        how, value = "declined", f"{bus.name!r} is not there"
        try:
            if bus.is_open:
                how, value = await bus.request(
                    *("ask", self.remote, request), progress=progress, numbered=numbered
                )
        except DeviceLostError as error:
            how, value = "lost", error.detail
        except EsairError as error:  # it was not sent
            how, value = "declined", describe(error)
        return how, encode(value, bus.kinds)

    def _hear(self, number: int, data: bytes) -> None:
        if number in self._working:
            self._working[number].progress(decode(data, self.bus.kinds))


def _causes(request: Request[Any]) -> tuple[int, ...]:
    """Return the asks of other robots that a request is made for."""
    order: Any = request._order  # noqa: SLF001
    while order is not None and not order.over:
        if order.task in made_for:
            return made_for[order.task]
        order = order.parent
    return ()


def peer_behavior(
    name: str, bus: PeerBus, requests: Iterable[type[Request[Any]]], *, remote: str = ""
) -> PeerBehavior:
    """Return what stands here for a behavior of a peer.

    Args:
        name: Its name here.
        bus: The bus to the peer.
        requests: What it takes, as its class declares it there.
        remote: Its name there; the same unless given.
    """
    ports: dict[str, Any] = {}
    for number, kind in enumerate(requests):
        ports[f"requests_{number}"] = takes(kind)
        bus.declare(kind)
        bus.declare(answer_type(kind))
    made: PeerBehavior = type("PeerBehavior", (PeerBehavior,), ports)(name=name)
    made.bus = bus
    made.remote = remote or name
    made.doing_there = f"at {bus.name}: busy, resting or restarting there"
    return made
