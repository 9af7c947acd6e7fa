"""P11: what importing esair costs."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.harness import Row, ms, repeated
from esair import minimal

PACKAGES = "import asyncio, anyio, attrs"

FORBIDDEN = ("serial", "serial_asyncio", "can", "smbus2", "cyclopts", "rich", "pytest")

ALONE = f"import sys; sys.path.insert(0, {str(Path(minimal.__file__).parent)!r}); "


async def rows() -> list[Row]:
    return _rows()


def _rows() -> list[Row]:
    found = []
    for case, mine, other, goal in (
        ("P11 import esair", "import esair", PACKAGES, 1.2),
        (
            "P11 the same, and use a name of it",
            "import esair; esair.Robot",
            PACKAGES,
            1.5,
        ),
        ("P11 minimal.py alone, to a bare start", f"{ALONE}import minimal", "", 1.3),
    ):
        ratios, mines, others = [], [], []
        with tempfile.TemporaryDirectory() as cache:
            # Both sides import compiled modules, whatever the environment says.
            environment = {**os.environ, "PYTHONPYCACHEPREFIX": cache}
            environment.pop("PYTHONDONTWRITEBYTECODE", None)
            _run(mine, environment)
            for _ in repeated(15):
                a, b = _run(mine, environment), _run(other, environment)
                mines.append(a)
                others.append(b)
                ratios.append(a / b)
        ratio = statistics.median(ratios)
        found.append(
            Row(
                case,
                ms(statistics.median(mines)),
                ms(statistics.median(others)),
                ratio,
                goal,
            )
        )
    loaded = subprocess.run(
        [
            sys.executable,
            "-c",
            "import esair, sys; esair.Robot; "
            f"print(*[n for n in {FORBIDDEN!r} if n in sys.modules])",
        ],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    found.append(
        Row(
            "P11 bus and CLI packages that it loads",
            ", ".join(loaded) or "none",
            "none",
            float(len(loaded)),
            0.0,
        )
    )
    return found


def _run(code: str, environment: dict[str, str]) -> float:
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    return time.perf_counter() - begin
