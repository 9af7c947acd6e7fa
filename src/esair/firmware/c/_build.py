"""Writes the files of a robot in C: the robot, a main for tests, and a sketch."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import attrs

from esair.config import ConfigFileError, load, searched_first
from esair.exceptions import ConfigError
from esair.firmware._fit import fitting_parts, loop_mistakes, rate_of
from esair.firmware.c._scope import BOOL, INT, REAL, RefusedError, Type
from esair.firmware.c._wiring import Program, Wiring, filled
from esair.values import check_choice

_REAL: Final = """\
#ifdef ROBOT_FLOAT
typedef float real;
#else
typedef double real;
#endif"""
_STUB: Final = """{{
    (void){0}; // {1}, and return true
    return false;
}}
"""

TARGETS: Final = ("c", "avr")
"""What C is written for: a computer or a larger chip, with double floats, or an AVR."""


@attrs.frozen
class Translated:
    """What was written.

    Attributes:
        folder: Where.
        files: Each file, and its size in bytes.
        rate: Steps per second.
        has_floats: Whether anything of it counts with floats.
    """

    folder: Path
    files: Mapping[str, int]
    rate: float
    has_floats: bool


def build(
    path: Path,
    folder: Path,
    *,
    target: str = "c",
    rate: float | None = None,
    watchdog: float | None = None,
    arm: str = "host",
) -> Translated:
    """Write the robot of a file as C99.

    Args:
        path: The configuration of the robot.
        folder: Where the files go. It may exist; files of the same names are replaced.
        target: One of `TARGETS`; floats are single for ``"avr"``.
        rate: Steps per second; the highest rate of a part, or 50, unless given.
        watchdog: The time-out of an AVR's watchdog in the sketch, in seconds.
        arm: When actuators may move: ``"always"``, ``"pin:NUMBER"`` while that pin is low,
            or ``"host"`` when somebody calls ``robot_arm(true)``.

    Raises:
        ExceptionGroup: Something does not fit or cannot be translated: a `ConfigError` for
            each, with file, line and the way to write it. Nothing was written then.
        ConfigError: There is no such target, or the folder cannot be written.
    """
    check_choice("esair min build", "board", target, TARGETS)
    described = load(path)
    found: list[ConfigFileError] = []

    def misfit(key: str, reason: str) -> None:
        error = ConfigFileError(str(path), None, key, reason)
        if str(error) not in map(str, found):
            found.append(error)

    parts = fitting_parts(path, described, misfit)
    steps = rate if rate is not None else rate_of(parts)
    loop_mistakes(parts, steps, misfit)
    if not re.fullmatch("host|always|pin:[0-9]+", arm):
        misfit("", f"arm={arm!r}: expected host, always, or pin: and a number")
    if watchdog is not None and (watchdog > 8 or _time_out(watchdog) * steps <= 1000):
        told = "an AVR has 0.015, 0.03, 0.06, 0.12, 0.25, 0.5, 1, 2, 4 and 8: take one"
        misfit("", f"a watchdog of {watchdog} s: {told} longer than a step, 1/rate")
    if found:
        raise ExceptionGroup(f"{path} does not fit into ESAIR MIN", found)
    keys = {id(part.made): part.key for part in parts}

    def refuse(part: Any, error: RefusedError) -> None:
        where = f"{error.file}, line {error.line}: " if error.line else ""
        misfit(keys.get(id(part), ""), f"{where}{error.reason}")

    reactions, sensors, actuators = (
        [part.made for part in parts if part.kind == kind]
        for kind in ("behavior", "sensor", "actuator")
    )
    with searched_first(path.parent):
        wiring = Wiring(reactions, sensors, actuators, steps, arm == "always", refuse)
        program = wiring.program()
    if found:
        raise ExceptionGroup(f"{path} cannot be translated to C", found)
    first = f"/* Made by `esair min build` from {path.name}: change that, and make it anew. */\n"
    files = {
        "robot/robot.c": first + program.source,
        "robot/robot.h": first + header(program, target),
        "robot/robot.ino": first + sketch(program, watchdog, arm),
        "main.c": first + main(program),
    }
    try:
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        told = f"{error.filename or folder}: {error.strerror}"
        raise ConfigError("esair min build", "out", told) from error
    sizes = {name: len(text.encode()) for name, text in files.items()}
    return Translated(folder, sizes, steps, program.has_floats)


def _time_out(watchdog: float) -> int:
    """Return what an AVR has of at most so many seconds, in milliseconds."""
    steps = (15, 30, 60, 120, 250, 500, 1000, 2000, 4000, 8000)
    return max((each for each in steps if each <= watchdog * 1000), default=0)


def header(program: Program, target: str) -> str:
    floats = _REAL if program.has_floats else ""
    if floats and target == "avr":
        floats = "#ifndef ROBOT_FLOAT\n#define ROBOT_FLOAT\n#endif\n" + floats
    return filled(
        "robot.h",
        floats=floats,
        types="\n".join(program.types.lines),
        heads="\n".join(f"{each};" for each in _heads(program)),
        parts=",\n    ".join([*program.parts, "ROBOT_PARTS"]),
    )


def _heads(program: Program) -> list[str]:
    reads = [f"bool read_{n}({t.c} *value)" for n, t in program.sensors.items()]
    return reads + [
        f"bool write_{n}({t.c} command)" for n, t in program.actuators.items()
    ]


def sketch(program: Program, watchdog: float | None, arm: str) -> str:
    lines = []
    for head in _heads(program):
        what = ("value", "put the reading there")
        what = what if "*value" in head else ("command", "put it out")
        lines.append(f"{head}\n{_STUB.format(*what)}")
    setup, each = "", ""
    if arm.startswith("pin:"):
        setup = f"    pinMode({arm[4:]}, INPUT_PULLUP);\n"
        each = f"    bool armed = digitalRead({arm[4:]}) == LOW;\n"
        each += "    if (armed != robot.armed) robot_arm(armed);\n"
    elif arm == "host":
        setup = "    Serial.begin(115200); // a: armed, d: disarmed\n"
        each = "    int order = Serial.read();\n"
        each += "    if (order == 'a' || order == 'd') robot_arm(order == 'a');\n"
    include = ""
    if watchdog is not None:
        longest = _time_out(watchdog)
        name = f"{longest}MS" if longest < 1000 else f"{longest // 1000}S"
        include = "#include <avr/wdt.h>\n"
        setup += f"    wdt_enable(WDTO_{name});\n"
        each += "    wdt_reset();\n"
    return filled(
        "sketch.ino", include=include, parts="\n".join(lines), setup=setup, each=each
    )


def main(program: Program) -> str:
    """Return ``main.c``: it plays what its standard input says."""
    lines = []
    for name, kind in program.sensors.items():
        lines += [
            f"static struct {{ int some; {kind.c} value; }} next_{name};",
            f"bool read_{name}({kind.c} *value) "
            f"{{ *value = next_{name}.value; return next_{name}.some != 0; }}",
            "",
        ]
    for name, kind in program.actuators.items():
        lines += [
            f"static int takes_{name} = 1;",
            f"bool write_{name}({kind.c} command)",
            "{",
            f"    if (takes_{name} == 0) return false;",
            f'    printf("{name}");',
            *(f"    printf({_PRINTED[t]}{x});" for t, x in _leaves(kind, "command")),
            '    printf("\\n");',
            "    return true;",
            "}",
            "",
        ]
    read = []
    for name, kind in program.sensors.items():
        read += [f"next_{name}.some = whole();", f"if (next_{name}.some) {{"]
        leaves = _leaves(kind, f"next_{name}.value")
        read += [*(f"    {place} = {_SCANNED[t]};" for t, place in leaves), "}"]
    read += [f"takes_{name} = whole();" for name in program.actuators]
    number = (
        "static inline real number(void) "
        '{ double x = 0; got += scanf("%lf", &x); return (real)x; }'
    )
    return filled(
        "main.c",
        number=number if program.has_floats else "",
        parts="\n".join(lines),
        read="\n".join(f"    {each}" for each in read),
    )


def _leaves(kind: Type, place: str) -> list[tuple[Type, str]]:
    """Return each number of a value, and how C names it."""
    if not kind.fields:
        return [(kind, place)]
    fields = enumerate(kind.fields)
    return [leaf for n, t in fields for leaf in _leaves(t, place + kind.field(n))]


_SCANNED: Final = {INT: "whole()", BOOL: "whole() != 0", REAL: "number()"}
_PRINTED: Final = {INT: '" %ld", (long)', BOOL: '" %d", ', REAL: '" %a", (double)'}
