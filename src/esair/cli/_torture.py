"""``esair torture``: everything that can go wrong, done to a robot that is not there."""

from __future__ import annotations

import json
import secrets
import sys
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from esair.cli._errors import CANNOT_USE, heeded, tell, wrong_seconds
from esair.cli._options import AsJson, Seconds

FOUND = 1  # The exit code if something was found


def torture(
    robot: str,
    /,
    *,
    seconds: Seconds = None,
    faults: int | None = None,
    seed: int | None = None,
    own: Annotated[bool, Parameter(name="--own-devices")] = False,
    out: Path | None = None,
    as_json: AsJson = False,
) -> int:
    """Do to a robot whatever can go wrong; does it stay safe?

    It runs on a virtual clock, on the sim tables of its file or on stand-ins: no
    hardware is touched. What is found is shrunk to a short story and written as a test.

    Exit code: 0 nothing was found, 1 something was, 2 the robot cannot be used.

    Args:
        robot: A robot.toml; or the robot of a module: module:robot, file.py:robot. The
            name may be that of a function that returns the robot.
        seconds: How long to go on, in seconds of real time; 60 unless given.
        faults: How many faults to try instead, however long that takes: with the same
            seed the same on each computer.
        seed: The same number does the same; a new one unless given.
        own: The devices of a module's robot are simulations themselves: use them, not
            stand-ins.
        out: The folder for the tests; tests/ beside the robot unless given.
    """
    from esair.torture import Report, Target, write_test
    from esair.torture import torture as run

    if seconds is None and faults is None:
        seconds = 60.0
    if wrong_seconds(seconds):
        return CANNOT_USE
    if faults is not None and faults < 1:
        tell(f"--faults: expected a number > 0, not {faults}")
        return CANNOT_USE
    if seed is None:
        seed = secrets.randbelow(2**31)
    sys.path.insert(0, str(_folder(robot)))  # modules imported while it runs
    target = Target.of(robot, own=own)
    folder = out or _folder(robot) / "tests"
    console = Console(stderr=True, highlight=False)
    with Progress(
        TextColumn(f"{target.name}, seed {seed}"),
        BarColumn(),
        TextColumn("{task.fields[faults]} faults, {task.fields[found]} found"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    ) as progress:
        bar = progress.add_task("", total=seconds or faults, faults=0, found=0)

        def told(report: Report) -> None:
            progress.update(
                bar,
                completed=report.faults if seconds is None else report.seconds,
                faults=report.faults,
                found=len(report.findings),
            )

        report = run(target, seed=seed, seconds=seconds, faults=faults, told=told)
    files = [
        write_test(target, each.violation, each.story, seed, folder)
        for each in report.findings
    ]
    shown = Console(highlight=False)
    with heeded(shown):
        if as_json:
            told_as = json.dumps(to_json(target.name, report, files), indent=2)
            shown.out(told_as, highlight=False)
        else:
            _show(shown, target.name, report, files)
    return FOUND if report.findings else 0


def to_json(robot: str, report: Any, files: list[Path]) -> dict[str, Any]:
    """Return a report as ``esair torture --json`` prints it.

    The schema, where ``schema`` grows when a key changes its meaning or goes (keys
    may be added)::

        schema      1
        robot       string: as it was named
        seed        integer
        ok          boolean: nothing was found
        seconds     number: how long it took
        stories     integer
        faults      integer: of all kinds
        kinds       list of {kind: string, group: "device" | "behavior" | "user" |
                    "computer", faults: integer, survived: integer,
                    slowest_to_safe: number, in seconds | null}
        findings    list of {rule: string, component: string, text: string,
                    at: number, steps: list of string, test: string: the file}
        speechless  object: the sensors whose stand-ins had nothing to say, and why
    """
    from esair.torture import KINDS

    return {
        "schema": 1,
        "robot": robot,
        "seed": report.seed,
        "ok": not report.findings,
        "seconds": round(report.seconds, 3),
        "stories": report.stories,
        "faults": report.faults,
        "kinds": [
            {
                "kind": name,
                "group": kind.group,
                "faults": report.done[name],
                "survived": report.survived[name],
                "slowest_to_safe": None
                if (slowest := report.slowest.get(name)) is None
                else round(slowest, 6),
            }
            for name, kind in KINDS.items()
            if report.done[name]
        ],
        "findings": [
            {
                "rule": each.violation.rule,
                "component": each.violation.component,
                "text": each.violation.text,
                "at": each.violation.at,
                "steps": [step.source() for step in each.story.steps],
                "test": str(file),
            }
            for each, file in zip(report.findings, files, strict=True)
        ],
        "speechless": report.speechless,
    }


def _show(console: Console, robot: str, report: Any, files: list[Path]) -> None:
    shown = to_json(robot, report, files)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("what was done")
    table.add_column("to", style="dim")
    table.add_column("times", justify="right")
    table.add_column("survived", justify="right")
    table.add_column("slowest to safe", justify="right")
    for each in shown["kinds"]:
        slowest = each["slowest_to_safe"]
        survived = "all" if each["survived"] == each["faults"] else each["survived"]
        table.add_row(
            each["kind"],
            each["group"],
            str(each["faults"]),
            Text(str(survived), "green" if survived == "all" else "bold red"),
            "" if slowest is None else f"{slowest:.3f} s",
        )
    console.print(table)
    for each in shown["findings"]:
        console.print(Text(f"{each['component']}: {each['text']}", "bold red"))
        for step in each["steps"]:
            console.print(Text(f"    {step}"), soft_wrap=True)
        console.print(Text(f"    pytest {each['test']}", "cyan"), soft_wrap=True)
    for name, why in report.speechless.items():
        told = f"{name}: nobody knows how to make a value ({why}), so it said nothing"
        console.print(Text(f"{told}; --own-devices uses its own", "yellow"))
    per_minute = report.faults / max(report.seconds, 1e-9) * 60
    text = Text(f"{robot}, seed {report.seed}: ", "bold")
    text.append(
        f"{len(files)} found" if files else "nothing found",
        "bold red" if files else "bold green",
    )
    text.append(
        f"; {report.faults:,} faults in {report.stories:,} stories, "
        f"{per_minute:,.0f} a minute",
        "dim",
    )
    console.print(text, soft_wrap=not console.is_terminal)


def _folder(robot: str) -> Path:
    """Return the folder of a robot: of its file, else this one."""
    where = Path(robot if Path(robot).exists() else robot.rpartition(":")[0])
    return where.resolve().parent if where.is_file() else Path.cwd()
