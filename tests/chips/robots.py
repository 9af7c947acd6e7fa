"""A robot in MIN and in C, on the same journal: what its actuators were told."""

import importlib.util
import math
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import attrs

from esair.firmware.c import _build
from esair.firmware.c._wiring import Wiring
from esair.minimal import Loop

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-fno-builtin"]
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


class Given:
    """A sensor that gives what the line of the journal says."""

    rate: float | None = None

    def __init__(self, name: str, example: Any, rate: float | None = None) -> None:
        self.name, self.example, self.rate = name, example, rate
        self.value: Any = None

    def read(self) -> Any:
        if self.value is None:
            raise OSError(5)
        return self.value


class Told:
    """An actuator that writes down what it is told, when it takes it."""

    clamp = False
    limits: Any = None

    def __init__(self, name: str, safe: Any, timeout: float = 0.2) -> None:
        self.name, self.safe, self.command_timeout = name, safe, timeout
        self.takes = True
        self.told: list[Any] = []

    def write(self, command: Any) -> None:
        if not self.takes:
            raise OSError(5)
        self.told.append((self.name, flat(command, self.safe)))


@attrs.define
class Robot:
    """What is wired; the reactions are those of MIN."""

    reactions: list[Any]
    sensors: list[Given]
    actuators: list[Told]
    rate: float = 50


def flat(value: Any, like: Any) -> list[Any]:
    """Return the numbers of a command in the types of its actuator, bits of floats."""
    if isinstance(like, tuple):
        return [one for a, b in zip(value, like, strict=True) for one in flat(a, b)]
    if isinstance(like, float):
        return [struct.pack("d", float(value))]
    return [value]


def numbers(value: Any) -> str:
    if isinstance(value, tuple):
        return " ".join(map(numbers, value))
    return (
        float(value).hex()
        if isinstance(value, float) and math.isfinite(value)
        else (str(value) if isinstance(value, float) else str(int(value)))
    )


def in_c(robot: Robot, folder: Path, *more: str, target: str = "c") -> Path:
    """Translate a robot and compile it with its main; return the program."""
    refused: list[Any] = []
    wiring = Wiring(
        robot.reactions,
        robot.sensors,
        robot.actuators,
        robot.rate,
        True,
        lambda part, error: refused.append((error.line, error.reason)),
    )
    program = wiring.program()
    assert refused == [], refused
    (folder / "robot").mkdir(parents=True, exist_ok=True)
    (folder / "robot" / "robot.c").write_text(program.source)
    (folder / "robot" / "robot.h").write_text(_build.header(program, target))
    (folder / "main.c").write_text(_build.main(program))
    files = [folder / "main.c", folder / "robot" / "robot.c"]
    done = subprocess.run(
        ["gcc", *FLAGS, *more, *files, "-o", folder / "robot.out", "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[:3000]
    return folder / "robot.out"


def lines_of(robot: Robot, journal: list[Any]) -> str:
    """Write a journal as the main of C reads it."""
    text = []
    for line in journal:
        if isinstance(line, str):
            text.append(line)
            continue
        given, takes = line
        each = ["0" if value is None else f"1 {numbers(value)}" for value in given]
        text.append(" ".join(["s", *each, *(str(int(t)) for t in takes)]))
    return "\n".join([*text, ""])


def run_c(robot: Robot, program: Path, journal: list[Any]) -> list[Any]:
    """Play a journal; return what was told, with the counts after each step."""
    done = subprocess.run(
        [program],
        input=lines_of(robot, journal),
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr[:3000]
    return parsed(robot, done.stdout)


def parsed(robot: Robot, printed: str) -> list[Any]:
    safe = {each.name: each.safe for each in robot.actuators}
    found: list[Any] = []
    for line in printed.splitlines():
        name, *words = line.split()
        if name in safe:
            value = [
                float.fromhex(w) if "x" in w or "n" in w else int(w) for w in words
            ]
            like = safe[name] if isinstance(safe[name], tuple) else (safe[name],)
            found.append((name, flat(tuple(value), like)))
        elif name == "=":
            found.append(tuple(map(int, words)))
        else:
            found.append(line)
    return together(found)


def together(told: list[Any]) -> list[Any]:
    """Put what each actuator was told in a step together: their order is nobody's promise."""
    found: list[Any] = []
    step: list[Any] = []
    for each in told:
        if len(each) == 2:
            step.append(each)
        else:
            found += [*sorted(step, key=lambda one: one[0]), each]
            step = []
    return found + sorted(step, key=lambda one: one[0])


def run_min(robot: Robot, journal: list[Any]) -> list[Any]:
    """Play a journal in MIN; return what was told, with the counts after each step."""
    told: list[Any] = []
    for each in robot.actuators:
        each.told, each.takes = told, True
    loop = Loop(robot.reactions, robot.sensors, robot.actuators, robot.rate)
    loop.note = quiet(loop)  # type: ignore[method-assign]
    loop.open()
    for line in journal:
        if isinstance(line, str):
            order, _, number = line.partition(" ")
            if order == "k":
                loop.skip(int(number))
            elif order == "a":
                loop.arm(number == "1")
            continue
        for sensor, value in zip(robot.sensors, line[0], strict=True):
            sensor.value = value
        for actuator, takes in zip(robot.actuators, line[1], strict=True):
            actuator.takes = takes
        loop.step()
        told.append((loop.steps, loop.faults, loop.refused))
    loop.close()
    return together(told)


def quiet(loop: Loop) -> Any:
    def note(name: str, fault: BaseException) -> None:
        loop.faults += 1
        loop.fault = (name, fault)

    return note


def imported(text: str, path: Path) -> Any:
    """Write a module and import it."""
    path.write_text(text)
    name = f"chips_{path.stem}_{abs(hash(path))}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
