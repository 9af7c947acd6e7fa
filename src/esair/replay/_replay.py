"""Runs a robot on a recording: its own code, the recorded world."""

from __future__ import annotations

import asyncio
import importlib
import json
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import attrs

from esair.exceptions import RecordingBrokenError, describe
from esair.loop import Player, TurnLoop, run_and_end
from esair.recording import contents_of, turns_of
from esair.replay._compare import Comparison, Divergence
from esair.standard import FORMAT, Robot, prepare_replay, run_to_its_end


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
    """

    equal: int
    divergence: Divergence | None
    turns: int
    seconds: float
    took: float
    short: str = ""


class Replay:
    """A recording that can be repeated.

    Args:
        path: The recording.

    Attributes:
        file: The robot.toml that the robot was made of; None if of none.
        is_simulated: Whether the robot was simulated.

    Raises:
        RecordingBrokenError: It cannot be repeated, and why.
        OSError: It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        contents = contents_of(path)
        facts = contents.facts
        if "replay" not in facts:
            raise RecordingBrokenError(
                str(path), "it was made by an earlier esair, which kept no turns"
            )
        self.facts = facts
        self.about = facts["replay"]
        if self.about.get("format") != FORMAT:
            raise RecordingBrokenError(
                str(path), "its turns were kept by another version of esair"
            )
        try:
            self.seed = int(facts["robot"]["seed"])
            exact, why = self.about["exact"], self.about["why"]
            self.file = Path(self.about["file"]) if self.about["file"] else None
            self.is_simulated = self.about["simulated"] == "yes"
            self._has_seat = self.about["seat"] == "yes"
            lasts = self.about["duration"]
            self._duration = float(lasts) if lasts else None
        except (KeyError, ValueError) as error:
            raise RecordingBrokenError(
                str(path), f"what it tells about itself is damaged: {describe(error)}"
            ) from error
        if exact != "yes":
            raise RecordingBrokenError(str(path), f"it is not exact: {why}")
        self._contents = contents

    @property
    def program(self) -> str:
        """The program that made the robot, if no file did."""
        return str(self.about.get("program", ""))

    @property
    def is_virtual(self) -> bool:
        """Whether its time was virtual: then all of it happens again, devices too."""
        return bool(self.about.get("clock") == "virtual")

    def run_script(self) -> Outcome | None:
        """Repeat a run that was not one of `esair.run` alone; None if it was."""
        name = self.about.get("script", "")
        if not name:
            return None
        module, _, function = name.partition(":")
        if module.partition(".")[0] != "esair":
            raise RecordingBrokenError(
                str(self.path), f"it wants to be repeated by {name!r:.80}"
            )
        repeat = getattr(importlib.import_module(module), function)
        outcome: Outcome = repeat(self, **json.loads(self.about["options"]))
        return outcome

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
        spoiled, player = "", None
        # When something has happened.
        moments = sorted({event.time for event in self._contents.events}) or [0.0]
        if loop is None:
            kept = turns_of(self.path, self._contents.turns, _modules_of(robot))
            spoiled = kept.spoiled or ""
            player = Player(kept.items)
            moments = player.moments
            loop = TurnLoop(player=player)
        found: list[Divergence] = []
        refused: list[BaseException] = []
        task: asyncio.Task[None]

        def diverged(divergence: Divergence) -> None:
            found.append(divergence)
            loop.call_soon(over if player is None else player.end)

        def over() -> None:
            comparison.end()
            task.cancel()

        comparison = Comparison(
            self._contents.events,
            moments,
            whole="end" in self.facts and not spoiled,
            diverged=diverged,
        )
        prepare_replay(robot, self.seed, has_seat=self._has_seat)
        robot.journal.listen(comparison.hear, backlog=1 << 20)

        async def run() -> None:
            try:
                if script is None:
                    await run_to_its_end(robot, self._duration)
                else:
                    await script(robot)
            except BaseException as error:
                # The end of the recorded run, which a signal may have brought; or the
                # robot of today cannot start.
                if not comparison.equal and not found:
                    refused.append(error)

        async def main() -> None:
            nonlocal task
            task = asyncio.ensure_future(run())
            if player is not None:
                player.on_over = over
            await asyncio.wait({task})
            comparison.end()

        began = time.monotonic()
        run_and_end(main(), lambda: loop)
        for error in refused:
            raise error
        lost = comparison.lost
        return Outcome(
            equal=comparison.equal,
            divergence=found[0] if found else None,
            turns=min(getattr(loop, "turn", len(moments)), len(moments)),
            seconds=moments[-1] - moments[0],
            took=time.monotonic() - began,
            short=spoiled or (f"{lost} events were not recorded" if lost else ""),
        )


def _modules_of(robot: Robot) -> list[str]:
    """Return the modules of a robot's components: one may have been the program."""
    parts: list[Any] = [*robot.plan.resources, *robot.plan.behaviors]
    parts = [getattr(each, "reaction", each) for each in parts]
    return list(dict.fromkeys(type(each).__module__ for each in parts))
