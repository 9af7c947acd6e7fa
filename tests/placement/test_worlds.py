"""Random robots do the same as tasks alone and with some of them in processes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.placement.worlds import WideWorld, World, first_difference, lived

from esair.placement._nursery import Nursery

pytestmark = [pytest.mark.promise("PLC-7"), pytest.mark.xdist_group("placement")]

EACH_TIME, LONG, SOAK = 3, 50, 1000
AT_ONCE = 25
"""How many worlds one test compares."""

TIES = {27, 1250, 1259, 1285, 1362, 1383, 1410, 1424, 1521, 1686, 1692, 1782, 1934}
"""Worlds that differ: two things fall on one moment in them, and take effect in the order in
which they come. What a process has to say comes some turns of the loop later: a reading goes
to two reactions that move one wheel, or to one and the guard of its wheel; two ask for a new
reading, or one asks who is being removed; two acts of the user end at once; a timer rings within
a microsecond of a reading."""


WIDE_TIES: set[int] = set()

KINDS = pytest.mark.parametrize("kind", [World, WideWorld])


@pytest.fixture(scope="module", autouse=True)
def _nursery() -> Iterator[None]:
    """Have one process that makes the children of all worlds."""
    nursery = Nursery.hold()
    yield
    nursery.let_go()


def differing(kind: type[World], seeds: range) -> dict[int, str]:
    """Let each world live twice, but for ties; return where those differ that do."""
    found = {}
    for seed in sorted({*seeds} - (TIES if kind is World else WIDE_TIES)):
        one, other = (lived(kind(seed, placed=each)) for each in (False, True))
        assert len(one) > 10
        if told := first_difference(one, other):
            found[seed] = f"{told}; in processes: {kind(seed, placed=True).places}"
    return found


@KINDS
def test_some_worlds_are_equal(kind: type[World]) -> None:
    """Commands, outcomes and moments, whoever of them has a process."""
    assert differing(kind, range(EACH_TIME)) == {}


@KINDS
@pytest.mark.parametrize(
    "begin",
    [
        *(
            pytest.param(begin, marks=pytest.mark.long)
            for begin in range(EACH_TIME, EACH_TIME + LONG, AT_ONCE)
        ),
        *(
            pytest.param(begin, marks=pytest.mark.soak)
            for begin in range(1000, 1000 + SOAK, AT_ONCE)
        ),
    ],
)
def test_many_worlds_are_equal(kind: type[World], begin: int) -> None:
    """As above; a thousand in the soak."""
    assert differing(kind, range(begin, begin + AT_ONCE)) == {}
