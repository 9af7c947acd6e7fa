"""Ctrl-C at any moment stops the wheels: the real program, in real time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from esair.drivers.wheel_motor import LEFT, RIGHT, command_id, decode_command

pytestmark = [pytest.mark.real_clock, pytest.mark.long]

SIDES = {command_id(LEFT): LEFT, command_id(RIGHT): RIGHT}


def commands(record: Path) -> list[tuple[int, bool]]:
    """Return side and whether it moves, of each command that was on the bus."""
    found = []
    for line in record.read_text("ascii").splitlines():
        number, _, data = line.split(" ")[-1].partition("#")
        side = SIDES.get(int(number, 16))
        if side is not None:
            command = decode_command(side, bytes.fromhex(data))
            found.append((side, command.enable and command.speed != 0))
    return found


@pytest.mark.promise("ROB-2", "AC-4")
@pytest.mark.parametrize(
    ("number", "code", "moving"),
    [
        pytest.param(signal.SIGINT, 130, 5, id="ctrl-c-while-it-drives"),
        pytest.param(signal.SIGINT, 130, 0, id="ctrl-c-before-it-drives"),
        pytest.param(signal.SIGTERM, 143, 5, id="sigterm-while-it-drives"),
    ],
)
def test_a_signal_stops_the_wheels(
    tmp_path: Path, number: int, code: int, moving: int
) -> None:
    """Each wheel's last command is the stop; the exit code tells of the signal."""
    record = tmp_path / "can.log"
    program = (
        "import sys; from pathlib import Path; from esair.demo import demo; "
        f"file = open({str(record)!r}, 'w', buffering=1, encoding='ascii'); "
        "sys.exit(demo(fast=False, seed=0, duration=36.0, "
        f"out=Path({str(tmp_path / 'd.png')!r}), on_frame=lambda time, frame: "
        "print(f'{time:.6f} {frame.id:03X}#{frame.data.hex()}', file=file)))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
    )
    try:
        give_up = time.monotonic() + 30
        while time.monotonic() < give_up:
            time.sleep(0.02)
            if record.exists() and (lines := record.read_text("ascii")):
                complete = lines[: lines.rfind("\n") + 1]
                (tmp_path / "part.log").write_text(complete, "ascii")
                seen = commands(tmp_path / "part.log")
                if sum(moves for _, moves in seen) >= moving and seen:
                    break
        begin = time.monotonic()
        process.send_signal(number)
        output, _ = process.communicate(timeout=60)
        took = time.monotonic() - begin
    finally:
        process.kill()
        process.wait()

    assert process.returncode == code, output.decode()
    assert took < 3.0
    told = commands(record)
    last = dict(told)
    assert last == {LEFT: False, RIGHT: False}
    assert any(moves for _, moves in told) == (moving > 0)
    if number == signal.SIGINT:
        assert b"safe Twist(linear=0.0, angular=0.0): answered" in output
