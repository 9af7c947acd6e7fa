"""Runs of the random robots in real time, kept, and replayed in another process.

``python -m tests.turn.recorded record 5 FILE 1.0`` keeps a run of a second, ``replay``
repeats it, ``changed`` does so with one behavior that decides otherwise. They print what
the robot decided: turn, kind, component, peer and value of each event.
"""

from __future__ import annotations

import asyncio
import json
import pickle
import sys
from pathlib import Path
from typing import Any

from tests.turn import worlds

from esair.journal import Kind
from esair.loop import Player, TapeWriter, TurnLoop

COMPARED = {
    Kind.READING,
    Kind.COMMAND,
    Kind.REFUSED,
    Kind.SENT,
    Kind.APPLIED,
    Kind.UNANSWERED,
    Kind.SAFE,
    Kind.CRASHED,
}


def play(seed: int, seconds: float, loop: TurnLoop, tape: list[Any]) -> list[str]:
    """Run the robot of a seed, or repeat it; return what was decided."""
    events: list[Any] = []
    told: worlds.Told = {}

    async def main() -> None:
        robot, motors = worlds.make(seed, told)
        for motor in motors:
            motor.start(loop)
        robot.journal.listen(events.append)
        if loop.player is None:
            loop.keep(TapeWriter(tape.append))
        else:
            loop.play()
        async with robot:
            await asyncio.sleep(seconds)
        loop.keep(None)

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        runner.run(main())
    moments = [item for item in tape if type(item) is float]
    turns = {moment: turn for turn, moment in enumerate(moments)}
    return [
        json.dumps(
            [
                turns.get(event.time, "?"),
                event.kind.name,
                event.component,
                event.peer,
                repr(getattr(event.value, "value", event.value)),
            ]
        )
        for event in events
        if event.kind in COMPARED
    ]


def forbid_drivers() -> None:
    """A replay calls no driver."""

    def never(*_: object) -> Any:
        raise AssertionError("a driver was called")

    for owner, method in (
        (worlds.Values, "__next__"),
        (worlds.Motor, "land"),
        (worlds.Motor, "write"),
        (worlds.ThreadedMotor, "write"),
    ):
        setattr(owner, method, never)


def main(what: str, seed: int, file: Path, seconds: float) -> None:
    """Record a run, or replay it."""
    if what == "changed":
        worlds.CHANGED = "b1"
    if what == "record":
        tape: list[Any] = []
        lines = play(seed, seconds, TurnLoop(), tape)
        file.write_bytes(pickle.dumps(tape))
    else:
        forbid_drivers()
        tape = pickle.loads(file.read_bytes())
        lines = play(seed, seconds, TurnLoop(player=Player(tape)), tape)
    print("\n".join(lines))  # noqa: T201 - that is its purpose


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), float(sys.argv[4]))
