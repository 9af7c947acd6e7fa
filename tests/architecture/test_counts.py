"""The gate on what hot paths cost: it repeats to the digit, and a change shows."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from pathlib import Path

import attrs
import pytest
from benchmarks import counts
from benchmarks.counts import ACCEPT, Count, changed

from esair.testing import VirtualLoop

KEPT = {"P3 read": Count(100.0, 10.0), "P4 write": Count(300.0, 8.0)}


@pytest.mark.parametrize(
    ("codes", "calls", "told"),
    [
        (100.0, 10.0, []),
        (102.0, 10.2, []),
        (98.0, 10.0, []),
        (102.01, 10.0, ["P3 read: 102.01 codes, accepted 100, +2.0%"]),
        (90.0, 10.0, ["P3 read: 90 codes, accepted 100, -10.0%"]),
        (100.0, 11.0, ["P3 read: 11 calls, accepted 10, +10.0%"]),
    ],
)
def test_more_than_two_percent_is_told(
    codes: float, calls: float, told: list[str]
) -> None:
    """In either direction: what was won is kept, too."""
    assert list(changed(KEPT, KEPT | {"P3 read": Count(codes, calls)})) == told


def test_a_row_that_comes_or_goes_is_told() -> None:
    assert list(changed(KEPT, {"P3 read": KEPT["P3 read"]})) == ["P4 write: gone"]
    assert list(changed({}, {"P4 write": KEPT["P4 write"]})) == ["P4 write: new"]


@pytest.mark.long
def test_one_more_call_shows_and_the_rest_repeats() -> None:
    """What is counted is what the interpreter executes, to the digit."""

    async def plain() -> None:
        await asyncio.sleep(0)

    async def more() -> None:
        await asyncio.sleep(0)
        json.JSONEncoder().encode("a")

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        first = runner.run(counts.repeated(plain, 5))
        again = runner.run(counts.repeated(plain, 5))
        other = runner.run(counts.repeated(more, 5))
    assert first == again
    assert other.codes > first.codes + 20
    assert other.calls > first.calls + 1


@pytest.mark.long
def test_a_change_fails_with_its_numbers_and_the_command_that_accepts_it(
    tmp_path: Path,
) -> None:
    """As CI runs it, on two quick rows; accepted, it passes."""
    kept = tmp_path / "counts.json"
    program = (
        "import pathlib, sys\n"
        "from benchmarks import counts\n"
        f"counts.KEPT = pathlib.Path({str(kept)!r})\n"
        "counts.ROWS = (counts.put_and_get,)\n"
        "counts.main()\n"
    )

    def gate(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", program, *words],
            env={"PYTHONHASHSEED": "0"},
            capture_output=True,
            text=True,
            check=False,
            cwd=Path(counts.__file__).parents[1],
        )

    kept.write_text("{}")
    assert "nothing is accepted" in gate().stdout
    assert gate("--accept").returncode == 0
    assert gate().returncode == 0
    table = json.loads(kept.read_text())
    (version,) = table
    case = "P1 put, the receiver is ready"
    was = Count(**table[version][case])
    table[version][case] = attrs.asdict(attrs.evolve(was, codes=was.codes * 0.97))
    kept.write_text(json.dumps(table))
    refused = gate()
    assert refused.returncode == 1
    assert f"{case}: {was.codes:g} codes, accepted" in refused.stderr
    assert ACCEPT in refused.stderr


@pytest.mark.long
def test_benchmarks_measure_the_loop_that_ships() -> None:
    """Unless another one is asked for; the table says which."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--smoke", "--only", "P18"],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(counts.__file__).parents[1],
    )
    assert "loop: esair" in done.stdout
