"""Who waits for whom: a request that would wait for itself is refused at once.

It follows the requests that an answer waits for. Two behaviors that ask each other
wait for nobody as long as one of them has somebody free to answer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from esair.supervisors._requests import Request, chain

if TYPE_CHECKING:
    from esair.supervisors._mailbox import Mailbox


def circle_of_ask(
    order: Request, busy: Sequence[Request | None], member: Mailbox
) -> list[str]:
    links = list(chain())
    peer = order.peer
    if busy:
        if all(any(each is link for link in links) for each in busy):
            return _path(links, peer)
        return []
    # Nobody takes such requests now: can anybody begin to?
    waits = [link.task for link in links if link.asker == peer]
    if order.asker == peer:
        waits.append(order.task)
    if not waits or not _all_wait(member, waits):
        return []
    return _path(links, peer)


def circle_of_get(
    asker: str,
    giver: str,
    members: Mapping[str, Mailbox],
    pending: Mapping[str, Iterable[Request]],
) -> list[str]:
    if asker == giver:
        return [asker, asker]
    links = list(chain())
    trail = [(giver, [asker, giver])]
    seen = {giver}
    while trail:
        name, path = trail.pop()
        member = members.get(name)
        if member is not None and member.serves in links:
            return _path(links, giver) if name == giver else [*path, asker]
        for request in _waits(member, _gets(pending, name)):
            other = request.peer
            if other == asker:
                if _is_stuck(members.get(asker), _gets(pending, asker), links):
                    return [*path, asker]
            elif other not in seen:
                seen.add(other)
                trail.append((other, [*path, other]))
    return []


def _gets(pending: Mapping[str, Iterable[Request]], asker: str) -> list[Request]:
    return [request for request in pending.get(asker, ()) if request.kind == "get"]


def _waits(member: Mailbox | None, gets: list[Request]) -> list[Request]:
    """Return the gets that the next answer of a behavior waits for."""
    if member is None:
        return gets
    if member.can_provide:
        serves = member.serves
        return [r for r in gets if serves is not None and r.parent is serves]
    tasks = [request.task for request in gets]
    return gets if gets and _all_wait(member, tasks) else []


def _is_stuck(
    member: Mailbox | None, gets: list[Request], links: list[Request]
) -> bool:
    """Tell whether the one that asks now has nobody else who would answer."""
    if member is None:
        return True
    if member.can_provide:
        return member.serves is not None and member.serves in links
    tasks = [request.task for request in gets]
    return _all_wait(member, [*tasks, asyncio.current_task()])


def _all_wait(member: Mailbox, waits: list[asyncio.Task[Any] | None]) -> bool:
    """Tell whether nobody of a behavior is left who does not wait."""
    living = set(member.owner.living())
    if any(task not in living for task in waits):
        return True  # somebody else acts in its name: what is known are the requests
    threads = member.owner.threads
    if threads and len(waits) >= len(threads):
        living.difference_update(member.carriers)
    return living.issubset(waits)


def _path(links: list[Request], peer: str) -> list[str]:
    """Return the names on the circle, in the order in which they wait."""
    names = [peer]
    for link in links:
        if link.peer == peer:
            break
        names.append(link.peer)
        if link.asker == peer:
            break
    return [peer, *reversed(names[1:]), peer]
