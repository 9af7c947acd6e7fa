"""A robot on an ATmega328P: compiled by avr-gcc, run by simavr."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

from tests.chips import robots

from esair.firmware.c import _build
from esair.firmware.c._wiring import Wiring

CHIP = "-mmcu=atmega328p"
FLAGS = [
    "-std=gnu99",
    "-Os",
    "-DF_CPU=16000000UL",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Werror",
]
FLAGS += ["-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections", CHIP]

UART = """
#include <avr/io.h>
#include <avr/interrupt.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#include <stdio.h>
#include "robot.h"

static int put(char c, FILE *f)
{
    (void)f;
    while (!(UCSR0A & (1 << UDRE0))) {}
    UDR0 = (uint8_t)c;
    return 0;
}
static FILE line = FDEV_SETUP_STREAM(put, NULL, _FDEV_SETUP_WRITE);
static inline void begin(void)
{
    UCSR0B = 1 << TXEN0;
    stdout = &line;
    TCCR1B = 1; /* counts cycles */
}
static inline void end(void)
{
    cli();
    sleep_enable();
    sleep_cpu();
}
"""


def why_not() -> str | None:
    """Say what is missing; None if nothing is."""
    missing = [each for each in ("avr-gcc", "simavr") if not shutil.which(each)]
    if missing:
        return f"needs {' and '.join(missing)} (Debian: gcc-avr avr-libc simavr)"
    return None


def compiled(folder: Path, main: str) -> Path:
    """Compile ``robot.c`` of a folder with a main."""
    (folder / "avr.c").write_text(UART + main)
    program = folder / "robot.elf"
    done = subprocess.run(
        ["avr-gcc", *FLAGS, folder / "avr.c", folder / "robot.c", "-o", program, "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[:3000]
    return program


def sizes(program: Path) -> tuple[int, int]:
    """Return the bytes of flash and of RAM, without the stack."""
    done = subprocess.run(
        ["avr-size", program], capture_output=True, text=True, check=True
    )
    text, data, bss = map(int, done.stdout.splitlines()[1].split()[:3])
    return text + data, data + bss


def printed(program: Path) -> list[str]:
    """Run a program until it sleeps; return the lines that it has sent."""
    done = subprocess.run(
        ["simavr", "-m", "atmega328p", "-f", "16000000", program],
        capture_output=True,
        check=False,
        timeout=120,
    )
    text = (done.stdout + done.stderr).decode(errors="replace")
    text = re.sub(r"\x1b\[[0-9;]*m", "", text)
    return [each.rstrip(".\r") for each in text.splitlines() if each[:1] in "=>"]


def run(robot: robots.Robot, journal: list[Any], folder: Path) -> list[Any]:
    """Play a journal of floats; return what was told, as the C of a computer does."""
    refused: list[Any] = []
    program = Wiring(
        robot.reactions,
        robot.sensors,
        robot.actuators,
        robot.rate,
        True,
        lambda part, error: refused.append((error.line, error.reason)),
    ).program()
    assert refused == []
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.c").write_text(program.source)
    (folder / "robot.h").write_text(_build.header(program, "avr"))
    rows = ", ".join(
        "{" + ", ".join("NAN" if v is None else repr(v) for v in line[0]) + "}"
        for line in journal
    )
    main = [
        "#include <math.h>",
        f"static const float journal[{len(journal)}][{len(robot.sensors)}] PROGMEM = {{{rows}}};",
        "static int16_t step;",
    ]
    for number, sensor in enumerate(robot.sensors):
        main.append(
            f"bool read_{sensor.name}(real *value) {{ *value = pgm_read_float("
            f"&journal[step][{number}]); return !isnan(*value); }}"
        )
    main.append(
        "static inline uint32_t bits(real x) { union { real x; uint32_t n; } u = {x}; return u.n; }"
    )
    for actuator in robot.actuators:
        name, safe = actuator.name, actuator.safe
        kind = program.actuators[name]
        parts = [f"command{kind.field(n)}" for n in range(len(kind.fields))] or [
            "command"
        ]
        shown = " ".join(
            "%lx" if isinstance(robots_first(safe), float) else "%ld" for _ in parts
        )
        values = ", ".join(
            f"bits({each})"
            if isinstance(robots_first(safe), float)
            else f"(long){each}"
            for each in parts
        )
        main.append(
            f'bool write_{name}({kind.c} command) {{ printf("> {name} {shown}\\n", {values}); '
            "return true; }"
        )
    main.append(
        "int main(void) { begin(); robot_open(); "
        f"for (step = 0; step < {len(journal)}; step++) {{ robot_step(); "
        'printf("= %lu %lu %lu\\n", robot.steps, robot.faults, robot.refused); } '
        "robot_close(); end(); }"
    )
    lines = printed(compiled(folder, "\n".join(main)))
    return robots.parsed(robot, "\n".join(as_computer(each, robot) for each in lines))


def robots_first(safe: Any) -> Any:
    return safe[0] if isinstance(safe, tuple) else safe


def as_computer(line: str, robot: robots.Robot) -> str:
    """Write a line of the chip as the main of C does."""
    if line[0] == "=":
        return line
    _, name, *words = line.split()
    safe = next(each.safe for each in robot.actuators if each.name == name)
    if isinstance(robots_first(safe), float):
        words = [
            struct.unpack("f", int(w, 16).to_bytes(4, "little"))[0].hex() for w in words
        ]
    return " ".join([name, *words])
