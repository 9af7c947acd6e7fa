"""Runs a robot on a recording: its own code, the recorded world."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import attrs

from esair.codec import kinds_of
from esair.exceptions import RecordingBrokenError, describe
from esair.loop import Player, TurnLoop, run_and_end
from esair.messages import is_placed
from esair.recording import GIVEN, Kept, chunks_of, facts_of
from esair.replay._compare import Comparison, Divergence
from esair.standard import (
    FORMAT,
    Robot,
    components_of,
    prepare_replay,
    run_to_its_end,
)

AGES = 1e9
"""A time that no run takes, in seconds."""


@attrs.frozen
class Outcome:
    """What came of a replay.

    Attributes:
        equal: How many events were equal, from the first one on.
        divergence: The first that was not; None if all were.
        turns: How many turns were repeated.
        seconds: How long the run took that was recorded.
        took: How long the replay took, in seconds.
        short: Why it was not compared to the end of the recording; empty if it was.
        late: Whose own thread or process was waited for in vain; empty if nobody's.
    """

    equal: int
    divergence: Divergence | None
    turns: int
    seconds: float
    took: float
    short: str = ""
    late: str = ""


class Replay:
    """A recording that can be repeated.

    Args:
        path: The recording.

    Attributes:
        file: The name of the robot.toml that the robot was made of; empty if of none.
        digest: SHA-256 of that file, in hexadecimal.
        is_simulated: Whether the robot was simulated.

    Raises:
        RecordingBrokenError: It cannot be repeated, and why.
        OSError: It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        facts = facts_of(path)
        if "replay" not in facts:
            told = "it has no turns: it is cut before the first, or of an earlier esair"
            raise RecordingBrokenError(str(path), told)
        self.facts = facts
        self.about: dict[str, str] = facts["replay"]
        if self.about.get("format") != FORMAT:
            raise RecordingBrokenError(
                str(path),
                "its turns were kept by another version of esair: it is not read",
            )
        try:
            self.seed: int = int(facts["robot"]["seed"])
            exact, why = self.about["exact"], self.about["why"]
            self.file: str = self.about["file"]
            self.digest: str = self.about["sha256"]
            self.is_simulated: bool = self.about["simulated"] == "yes"
            self._has_seat = self.about["seat"] == "yes"
            lasts = self.about["duration"]
            self._duration = number_of(lasts) if lasts else None
            placed = json.loads(self.about.get("placed", "null"))
            self._placed: set[str] | None = placed and {*map(str, placed)}
        except (KeyError, ValueError, TypeError, RecursionError) as error:
            raise RecordingBrokenError(
                str(path), f"what it tells about itself is damaged: {describe(error)}"
            ) from error
        if exact != "yes":
            raise RecordingBrokenError(str(path), f"it is not exact: {why}")

    @property
    def program(self) -> str:
        """The program that made the robot, if no file did."""
        return str(self.about.get("program", ""))

    @property
    def is_virtual(self) -> bool:
        """Whether its time was virtual: then all of it happens again, devices too."""
        return bool(self.about.get("clock") == "virtual")

    @property
    def script(self) -> str:
        """What ran the robot, if not `esair.run` alone: ``"demo"``; empty if nothing."""
        return str(self.about.get("script", ""))

    @property
    def options(self) -> dict[str, float]:
        """The numbers that the script was run with, by name.

        Raises:
            RecordingBrokenError: They are none.
        """
        try:
            told = json.loads(self.about["options"])
            return {str(name): number_of(value) for name, value in told.items()}
        except (KeyError, ValueError, TypeError, AttributeError, RecursionError):
            told = "what it tells about itself is damaged: options"
            raise RecordingBrokenError(str(self.path), told) from None

    def _place(self, robot: Robot) -> None:
        """Have components live where they did: a switch may have said so for that run."""
        if self._placed is None:
            return  # an earlier esair has kept none of it
        for each in (*robot.plan.resources, *robot.plan.behaviors):
            if is_placed(each) is not (each.name in self._placed):
                each.placement = "process" if each.name in self._placed else "task"

    def run(
        self,
        robot: Robot,
        script: Callable[[Robot], Coroutine[Any, Any, None]] | None = None,
        loop: asyncio.AbstractEventLoop | None = None,
    ) -> Outcome:
        """Repeat the run with a robot that was made as the recorded one.

        No driver is called, and it returns at the first difference.

        Args:
            robot: The robot, not started.
            script: A coroutine function that runs it, as the recorded one was run;
                `esair.run` unless given.
            loop: One with virtual time, on which all happens again, the devices too;
                one that plays what was recorded unless given.

        Raises:
            RecordingBrokenError: What was recorded cannot be read.
            ExceptionGroup: The robot cannot start; every mistake is named.
        """
        kept: Kept | None = None
        player: Player | None = None
        has_end = "end" in self.facts
        chunks = chunks_of(self.path)
        if loop is None:
            kinds = kinds_of(lambda: components_of(robot), GIVEN)
            kept = Kept(self.path, chunks, kinds, whole=has_end)
            player = Player(kept, read=kept.read)
            if player.error is not None:
                raise player.error
            loop = TurnLoop(player=player)
        refused: list[BaseException] = []
        task: asyncio.Task[None]

        def diverged() -> None:
            loop.call_soon(over if player is None else player.end)

        is_over = False

        def over() -> None:
            nonlocal is_over
            is_over = True
            comparison.end()
            task.cancel()

        comparison = Comparison(
            self.path,
            whole=has_end and not self._dropped,
            kept=kept,
            player=player,
            diverged=diverged,
        )
        self._place(robot)
        prepare_replay(robot, self.seed, has_seat=self._has_seat)
        listener = robot.journal.listen(comparison.hear, backlog=1 << 20)
        listener.is_waited_for = True  # what it was not told yet would be missed

        async def run() -> None:
            try:
                if script is None:
                    await run_to_its_end(robot, self._duration)
                else:
                    await script(robot)
            except BaseException as error:
                # The end of the recorded run, which a signal may have brought; or the
                # robot of today cannot start.
                if not (comparison.equal or comparison.divergence or is_over):
                    refused.append(error)

        async def main() -> None:
            nonlocal task
            task = asyncio.ensure_future(run())
            if player is not None:
                player.on_over = over
            await asyncio.wait({task})
            comparison.end()

        began = time.monotonic()
        try:
            run_and_end(main(), lambda: loop)
        finally:
            comparison.close()
            chunks.close()
        for error in refused:
            raise error
        if (
            player is not None
            and player.error is not None
            and not comparison.divergence
        ):
            raise player.error
        span, lost = comparison.span, comparison.lost or self._dropped
        short = (kept and kept.spoiled) or ""
        if not short and lost:
            short = f"{lost} events were not recorded"
        if not short and not has_end:
            short = "it has no end: what came last may be missing"
        return Outcome(
            equal=comparison.equal,
            divergence=comparison.divergence,
            turns=span.turns,
            seconds=span.moment - span.began,
            took=time.monotonic() - began,
            short=short,
            late="" if player is None else player.late,
        )

    @property
    def _dropped(self) -> int:
        """How many events the recorder says that it has dropped."""
        told = self.facts.get("end", {}).get("dropped", "")
        return int(told) if told.isdecimal() and len(told) < 20 else 0


def number_of(told: Any) -> float:
    """Return a number that a recording tells: finite, and not of ages."""
    number = float(told) if isinstance(told, str) else told
    if type(number) not in {int, float} or not abs(number) < AGES:
        raise ValueError(f"expected a number, not {told!r:.40}")
    return number
