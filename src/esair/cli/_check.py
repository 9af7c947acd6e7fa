"""``esair check``: what is wrong with a robot, before it moves."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import attrs
from rich import box
from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from esair.cli._errors import counted, heeded
from esair.cli._options import AsJson
from esair.config import FoundInFile, Report, check_together, tables_of
from esair.loop import check_priority, refusal
from esair.plan import KEEPS_ON, UNWATCHED

_STYLES = {"error": "bold red", "warning": "yellow"}


def check(
    robot: str, /, *peers: str, as_json: AsJson = False, strict: bool = False
) -> int:
    """Find every mistake of a robot at once; no device is opened.

    Exit code: 0 no errors, 1 errors found, 2 the file or module cannot be read.

    Args:
        robot: A robot.toml; or the robot of a module: module:robot, file.py:robot. The
            name may be that of a function that returns the robot.
        peers: The files of robots that it uses, or that use it: what one wants and
            another one does not share is a mistake, too. With --json a list is printed.
        strict: Count warnings as errors.
    """
    reports = check_together([robot, *peers])
    console = Console(highlight=False)
    with heeded(console):
        if as_json:
            told = [to_json(report) for report in reports]
            found = json.dumps(told if peers else told[0], indent=2)
            console.out(found, highlight=False)
        else:
            for each, report in zip((robot, *peers), reports, strict=True):
                _print(console, each, report)
    return int(any(each.errors or (strict and each.warnings) for each in reports))


def _print(console: Console, robot: str, report: Report) -> None:
    if report.findings:
        console.print(_findings(report.findings))
    unmade = any(found.rule == "configuration" for found in report.findings)
    if report.actuators and not unmade:  # else a guard may be what is missing
        console.print(_actuators(report))
    if report.failures and not unmade:
        console.print(_failures(report))
    for told in (*_of_boards(robot, report), *_of_real_time(robot, report)):
        console.print(Text(told), soft_wrap=True)
    console.print(_summary(report), soft_wrap=True)


def _of_boards(robot: str, report: Report) -> Iterable[str]:
    """Return what is to be said of the boards of a file that has no errors."""
    if report.errors or not robot.endswith(".toml") or "board" not in tables_of(robot):
        return ()
    from esair.firmware import uneven_on_boards

    return uneven_on_boards(Path(robot))


def _of_real_time(robot: str, report: Report) -> Iterable[str]:
    """Say whether this computer gives the real time that a file asks for."""
    if report.errors or not robot.endswith(".toml"):
        return
    asked = tables_of(robot).get("robot", {}).get("realtime", False)
    priority = check_priority("[robot]", asked)
    if priority is not None:
        refused = refusal(priority)
        given = f"given here, with priority {priority} and locked memory"
        yield f"real time: {f'not given here: {refused}' if refused else given}"


def to_json(report: Report) -> dict[str, Any]:
    """Return a report as ``esair check --json`` prints it.

    The schema, where ``schema`` grows when a key changes its meaning or goes (keys
    may be added)::

        schema           1
        file             string: the file or module, as it was named
        digest           string: SHA-256 of the file, in hexadecimal; "" for a module
        ok               boolean: there are no errors
        errors           integer: how many
        warnings         integer: how many
        with_simulation  boolean: the sim tables were checked too
        findings         list of
            severity         "error" | "warning"
            rule             "configuration" | "declaration" | "name" | "claim" |
                             "need" | "denied" | "rights" | "time" | "silent" |
                             "protect" | "starve" | "unused" | "port" | "peer" |
                             "package"
            key              string: dotted path in the file; "" for the whole
            line             integer, from 1 | null
            message          string
            only_simulated   boolean: it holds for esair sim only
        actuators        list of
            name             string
            driver           string: module:Class
            safe             string: the safe command, in Python's words | null
            command_timeout  number: seconds | null
            writers          list of {behavior, kind: "behavior" | "reaction",
                             priority: integer, when_blind: string}, highest
                             priority first
            guards           list of {reaction, priority: integer, when_blind:
                             string, latch: boolean}, first asked first
            sent_by          string: who sends the safe command, and when
            own_timeout      number: seconds | null
            when_the_process_dies   string
            when_the_host_dies   string
        failures         object: for each behavior, what happens when it fails again and
                         again, in words
    """
    return {
        "schema": 1,
        "file": report.file,
        "digest": report.digest,
        "ok": not report.errors,
        "errors": report.errors,
        "warnings": report.warnings,
        "with_simulation": report.with_simulation,
        "findings": [attrs.asdict(finding) for finding in report.findings],
        "actuators": [attrs.asdict(actuator) for actuator in report.actuators],
        "failures": dict(report.failures),
    }


def _findings(findings: tuple[FoundInFile, ...]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title_justify="left")
    table.add_column("line", justify="right", style="dim")
    table.add_column("where", style="cyan", overflow="fold")
    table.add_column("what", overflow="fold", ratio=1)
    for finding in findings:
        what = Text()
        what.append(f"{finding.severity}: ", _STYLES[finding.severity])
        what.append("in the simulation: " if finding.only_simulated else "", "italic")
        what.append(finding.message)
        line = "" if finding.line is None else str(finding.line)
        table.add_row(line, Text(finding.key or "the robot"), what)
    return table


def _in_panel(title: str) -> tuple[Panel, Table]:
    """Return a panel, and the table in it: what, and which."""
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column("what", style="dim", no_wrap=True)
    table.add_column("which", overflow="fold", ratio=1)
    return Panel(table, title=title, title_align="left"), table


def _actuators(report: Report) -> Panel:
    panel, table = _in_panel("How each actuator is made safe")
    for number, actuator in enumerate(report.actuators):
        if number:
            table.add_row()
        table.add_row(Text("actuator"), Text(actuator.name, "bold"))
        for writer in actuator.writers:
            who = f"{writer.behavior} ({writer.priority}); blind: {writer.when_blind}"
            table.add_row("written by (priority)", Text(who))
        if not actuator.writers:
            table.add_row("written by", Text("nobody"))
        for guard in actuator.guards:
            who = f"{guard.reaction}; blind: {guard.when_blind}"
            table.add_row("guarded by", Text(who))
        if not actuator.guards:
            table.add_row("guarded by", Text("nobody"))
        style = "bold red" if actuator.safe is None else "green"
        table.add_row("safe command", Text(actuator.safe or "none", style))
        table.add_row("who sends it", Text(actuator.sent_by))
        told = actuator.when_the_process_dies
        style = "red" if told.startswith(UNWATCHED) else ""
        table.add_row("when this process dies", Text(told, style))
        style = "red" if actuator.when_the_host_dies == KEEPS_ON else ""
        table.add_row(
            "when this computer dies", Text(actuator.when_the_host_dies, style)
        )
    return panel


def _failures(report: Report) -> Panel:
    panel, table = _in_panel("What a failure means")
    for name, told in report.failures.items():
        table.add_row(Text(name), Text(told))
    return panel


def _summary(report: Report) -> Text:
    style = (
        "bold red" if report.errors else "yellow" if report.warnings else "bold green"
    )
    text = Text(f"{report.file}: ", "bold")
    text.append(
        f"{counted(report.errors, 'error')}, {counted(report.warnings, 'warning')}",
        style,
    )
    if report.with_simulation:
        text.append("; real and simulated", "dim")
    return text
