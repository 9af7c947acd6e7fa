"""Which ids somebody listens to: data, so that the kernel can choose by them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple, TypeAlias

from esair.exceptions import BadValueError

EXTENDED: Final = 0x8000_0000
"""The bit that tells an extended id from a standard one with the same number."""

_NUMBER: Final = 0x1FFF_FFFF
_STANDARD: Final = 0x7FF


class Mask(NamedTuple):
    """The ids that are the same as one in some bits.

    Attributes:
        id: The id.
        mask: The bits that count.
    """

    id: int
    mask: int


ALL: Final = Mask(0, 0)
"""Every id, standard and extended."""

Ids: TypeAlias = int | range | Mask
"""One id, the ids of a range, or those that a mask says."""


class Filter(NamedTuple):
    """Ids as the kernel chooses by them: those whose bits in a mask are the key's.

    Attributes:
        key: An id; an extended one has the bit `EXTENDED` set.
        mask: The bits that count.
    """

    key: int
    mask: int

    @property
    def is_exact(self) -> bool:
        """Whether it is one id."""
        return self.mask == _exact(self.key)


def key_of(owner: str, number: int, *, extended: bool) -> int:
    """Return the id as listeners are kept by."""
    if isinstance(number, int) and 0 <= number < (0x2000_0000 if extended else 0x800):
        return number | EXTENDED if extended else number
    kind = "an extended CAN id below 2**29" if extended else "a CAN id below 2**11"
    raise BadValueError(
        owner, "id", f"expected {kind}, not {number!r:.80} (or extended={not extended})"
    )


def filters_of(
    owner: str, ids: tuple[Ids, ...], *, extended: bool
) -> tuple[Filter, ...]:
    """Return what the kernel chooses ids by."""
    found: dict[Filter, None] = {}
    for each in ids:
        found.update(dict.fromkeys(_filters(owner, each, extended)))
    if not found:
        raise BadValueError(owner, "ids", "expected at least one id to listen to")
    return tuple(found)


def _filters(owner: str, ids: Ids, extended: bool) -> Iterator[Filter]:
    flag = EXTENDED if extended else 0
    if ids is ALL:
        yield Filter(0, 0)
    elif isinstance(ids, Mask):
        key = key_of(owner, ids.id, extended=extended)
        mask = key_of(owner, ids.mask, extended=extended) | EXTENDED
        yield Filter(key & mask, mask)
    elif isinstance(ids, range):
        if ids.step != 1 or not ids:
            raise BadValueError(
                owner, "ids", f"expected ids one after the other, not {ids!r:.80}"
            )
        first = key_of(owner, ids[0], extended=extended) & _NUMBER
        last = key_of(owner, ids[-1], extended=extended) & _NUMBER
        while first <= last:  # blocks of 2**n ids that begin at their multiples
            size = first & -first or EXTENDED
            while first + size - 1 > last:
                size >>= 1
            mask = _exact(flag) & ~(size - 1)
            yield Filter(first | flag, mask)
            first += size
    else:
        key = key_of(owner, ids, extended=extended)
        yield Filter(key, _exact(key))


def _exact(key: int) -> int:
    return EXTENDED | (_NUMBER if key & EXTENDED else _STANDARD)
