"""Writes the files of a robot in C: the robot, a main for tests, and a sketch."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import attrs

from esair.config import ConfigFileError, load, searched_first
from esair.exceptions import ConfigError
from esair.firmware._fit import fitting_parts, loop_mistakes, rate_of
from esair.firmware.c._types import BOOL, INT, REAL, RefusedError, Type
from esair.firmware.c._wiring import Program, Wiring
from esair.values import check_choice

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
    if arm not in {"host", "always"} and not (
        arm.startswith("pin:") and arm[4:].isdigit()
    ):
        misfit("", f"arm={arm!r}: expected host, always, or pin: and a number")
    if watchdog is not None and not max(1 / steps, 0.015) <= watchdog <= 8:
        misfit(
            "",
            f"a watchdog of {watchdog} s: an AVR takes from one step, 1/rate, to 8 s",
        )
    if found:
        raise ExceptionGroup(f"{path} does not fit into ESAIR MIN", found)
    keys = {id(part.made): part.key for part in parts}

    def refuse(part: Any, error: RefusedError) -> None:
        where = f"{error.file}, line {error.line}: " if error.line else ""
        misfit(keys.get(id(part), ""), f"{where}{error.reason}")

    of_kind = {
        kind: [part.made for part in parts if part.kind == kind]
        for kind in ("behavior", "sensor", "actuator")
    }
    with searched_first(path.parent):
        program = Wiring(
            of_kind["behavior"],
            of_kind["sensor"],
            of_kind["actuator"],
            steps,
            arm == "always",
            refuse,
        ).program()
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
        raise ConfigError(
            "esair min build", "out", f"{error.filename or folder}: {error.strerror}"
        ) from error
    sizes = {name: len(text.encode()) for name, text in files.items()}
    return Translated(folder, sizes, steps, program.has_floats)


def header(program: Program, target: str) -> str:
    """Return ``robot.h``."""
    floats = (
        inspect.cleandoc("""
        #ifdef ROBOT_FLOAT
        typedef float real;
        #else
        typedef double real;
        #endif
    """)
        if program.has_floats
        else ""
    )
    if floats and target == "avr":
        floats = f"#ifndef ROBOT_FLOAT\n#define ROBOT_FLOAT\n#endif\n{floats}"
    reads = [
        f"bool read_{name}({kind.c} *value);" for name, kind in program.sensors.items()
    ]
    writes = [
        f"bool write_{name}({kind.c} command);"
        for name, kind in program.actuators.items()
    ]
    parts = [
        *(f"ROBOT_SENSOR_{name.upper()}" for name in program.sensors),
        *(f"ROBOT_ACTUATOR_{name.upper()}" for name in program.actuators),
        *(f"ROBOT_REACTION_{name.upper()}" for name in program.reactions),
    ]
    return _HEADER.format(
        floats=floats,
        types="\n".join(program.types.lines),
        reads="\n".join(reads),
        writes="\n".join(writes),
        parts=",\n    ".join(parts),
    )


def sketch(program: Program, watchdog: float | None, arm: str) -> str:
    """Return ``robot.ino``."""
    lines = []
    for name, kind in program.sensors.items():
        lines += [
            f"bool read_{name}({kind.c} *value)",
            "{",
            "    (void)value; // put the reading there, and return true",
            "    return false;",
            "}",
            "",
        ]
    for name, kind in program.actuators.items():
        lines += [
            f"bool write_{name}({kind.c} command)",
            "{",
            "    (void)command; // put it out, and return true",
            "    return false;",
            "}",
            "",
        ]
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
        steps = (15, 30, 60, 120, 250, 500, 1000, 2000, 4000, 8000)
        longest = max(each for each in steps if each <= watchdog * 1000)
        name = f"{longest}MS" if longest < 1000 else f"{longest // 1000}S"
        include = "#include <avr/wdt.h>\n"
        setup += f"    wdt_enable(WDTO_{name});\n"
        each += "    wdt_reset();\n"
    return _SKETCH.format(
        include=include, parts="\n".join(lines), setup=setup, each=each
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
            *(f"    {each}" for each in _printed(kind, "command")),
            '    printf("\\n");',
            "    return true;",
            "}",
            "",
        ]
    read = []
    for name, kind in program.sensors.items():
        read += [f"next_{name}.some = whole();", f"if (next_{name}.some) {{"]
        read += [*(f"    {each}" for each in _scanned(kind, f"next_{name}.value")), "}"]
    read += [f"takes_{name} = whole();" for name in program.actuators]
    number = (
        "static inline real number(void) "
        '{ double x = 0; got += scanf("%lf", &x); return (real)x; }'
    )
    return _MAIN.format(
        number=number if program.has_floats else "",
        parts="\n".join(lines),
        read="\n".join(f"    {each}" for each in read),
    )


def _scanned(kind: Type, place: str) -> list[str]:
    if kind.fields:
        return [
            line
            for n, each in enumerate(kind.fields)
            for line in _scanned(each, place + kind.field(n))
        ]
    return [
        f"{place} = {'number()' if kind is REAL else 'whole()'}{' != 0' * (kind is BOOL)};"
    ]


def _printed(kind: Type, value: str) -> list[str]:
    if kind.fields:
        return [
            line
            for n, each in enumerate(kind.fields)
            for line in _printed(each, value + kind.field(n))
        ]
    if kind is INT:
        return [f'printf(" %ld", (long){value});']
    return [
        f'printf(" %a", (double){value});'
        if kind is REAL
        else f'printf(" %d", {value});'
    ]


_HEADER: Final = """\
#ifndef ROBOT_H
#define ROBOT_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {{
#endif

{floats}
{types}

/* To be written by you. Return false if there is no reading, or it was not taken. */
{reads}
{writes}

enum {{ /* the parts */
    {parts}
}};

typedef struct {{
    uint32_t steps;   /* how many were made */
    uint32_t late;    /* how many were left out */
    uint32_t refused; /* commands that met a higher priority, a blind reaction or a guard */
    uint32_t faults;  /* of parts: no reading, not taken, an error of a reaction */
    uint8_t fault;    /* the part of the last one */
    bool armed;       /* whether actuators may move */
}} robot_state;

extern robot_state robot;

void robot_open(void);            /* first: each actuator gets its safe command */
void robot_step(void);            /* read, decide, write */
uint32_t robot_wait(uint32_t ms); /* since robot_open; how many until the next step */
void robot_skip(uint32_t steps);  /* leave out steps that come too late */
void robot_arm(bool armed);       /* let actuators move from the next step on, or not */
bool robot_reset(uint8_t part);   /* let a guard that has latched decide again */
void robot_close(void);           /* last: the safe commands */

#ifdef __cplusplus
}}
#endif
#endif
"""

_SKETCH: Final = """\
#include "robot.h"
{include}
{parts}
static uint32_t begun;

void setup()
{{
{setup}    robot_open();
    begun = millis();
}}

void loop()
{{
{each}    robot_step();
    delay(robot_wait(millis() - begun));
}}
"""

_MAIN: Final = """\
/* For tests: each line of the input is `s`, a step, then for each sensor 1 and its numbers or
   0 if it fails, and for each actuator whether it takes commands; `k N`, skip; `a 0`, `a 1`,
   arm; `r PART`, reset a guard; `c`, close; `o`, open. */
#include <stdio.h>
#include "robot/robot.h"

static int got;
static inline int32_t whole(void) {{ long x = 0; got += scanf("%ld", &x); return (int32_t)x; }}
{number}

{parts}
static void read_line(void)
{{
{read}
}}

int main(void)
{{
    char what;
    robot_open();
    while (scanf(" %c", &what) == 1) {{
        if (what == 's') {{
            read_line();
            robot_step();
            printf("= %lu %lu %lu\\n", (unsigned long)robot.steps, (unsigned long)robot.faults,
                   (unsigned long)robot.refused);
        }} else if (what == 'k') robot_skip((uint32_t)whole());
        else if (what == 'a') robot_arm(whole() != 0);
        else if (what == 'r') printf("reset %d\\n", robot_reset((uint8_t)whole()));
        else if (what == 'c') robot_close();
        else if (what == 'o') robot_open();
    }}
    robot_close();
    return got < 0;
}}
"""
