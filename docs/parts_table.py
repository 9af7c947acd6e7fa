"""Writes the table of parts of the drivers page from the code: what people search by.

``python -m docs.parts_table`` writes it anew; a test says when it has to. Nothing of it is
kept by hand: what a part is says the first line of its module, on which bus the annotation
``bus:``, which package the extra that it asks for.
"""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/reference/drivers.md"
DRIVERS = ROOT / "src/esair/drivers"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]
BLOCK = re.compile(r"<!-- parts -->\n.*?<!-- end of parts -->\n", re.S)

BUS = re.compile(r"^    bus: (\w+(?: \| \w+)?)$", re.M)

BUSES = {
    "SerialBus": "serial",
    "CanBus": "CAN",
    "I2CBus": "I²C",
    "I2CBus | SpiBus": "I²C, SPI",
    "MqttBus": "MQTT",
    "ServoBus": "its own",
}
"""What the annotation of a driver's bus is called."""

HEAD = [
    "| what it measures or moves | driver, class or chip | library | bus | on hardware |",
    "|---|---|---|---|---|",
]
NOT_TRIED = "no"
"""No part has been tried on hardware yet; a row that has says so here."""


def rows() -> Iterator[tuple[str, str, str, str]]:
    """Yield what each part is, what it is called, its library and its bus."""
    for name, module in sorted(PROJECT["entry-points"]["esair.drivers"].items()):
        place = DRIVERS / module.removeprefix("esair.drivers.").replace(".", "/")
        files = [place.with_suffix(".py"), *sorted(place.glob("[!f]*.py"))]
        files = [file for file in files if file.is_file()]
        first = next(
            file for file in files if file.name in {"__init__.py", place.name + ".py"}
        )
        source = "".join(file.read_text(encoding="utf-8") for file in files)
        doc = ast.get_docstring(ast.parse(first.read_text(encoding="utf-8"))) or ""
        what = doc.partition("\n")[0].rstrip(".").replace("``", "`")
        if place.parent != DRIVERS:  # a part of the package beside it
            files += place.parent.glob("_[a-z]*.py")
        if "drivers._on_chip" in source:
            files.append(DRIVERS / "_on_chip.py")
        kinds = BUS.findall("".join(file.read_text("utf-8") for file in files))
        bus = ", ".join(dict.fromkeys(BUSES[kind] for kind in kinds)) or "none"
        yield what, f"`{name}`", library_of(source), bus
    yield from of_gpiozero()
    yield from of_circuitpython()


def library_of(source: str) -> str:
    """Return the packages of the extra that a driver asks for."""
    extras = re.findall(r'of_extra\("(\w+)"\)|\'esair\[(\w+)\]\'', source)
    names = dict.fromkeys(one or other for one, other in extras)
    packages = [
        each for name in names for each in PROJECT["optional-dependencies"][name]
    ]
    return ", ".join(re.split(r"[><=]", each)[0] for each in packages) or "-"


def of_gpiozero() -> Iterator[tuple[str, str, str, str]]:
    """Yield its classes, by what is read of them or told."""
    from esair.drivers.gpiozero import READS, TELLS

    for name, value in READS.items():
        yield f"{words(name)}: `{value}`", f"`gpiozero` `{name}`", "gpiozero", "pins"
    for name, told in TELLS.items():
        what = f"{words(name)}: `{told.attribute}` is told"
        yield what, f"`gpiozero` `{name}`", "gpiozero", "pins"


def of_circuitpython() -> Iterator[tuple[str, str, str, str]]:
    """Yield the parts whose drivers are run by the tests, unchanged."""
    for file, bus in (("", "I²C"), ("_spi", "SPI")):
        text = (ROOT / f"tests/drivers/test_circuitpython{file}.py").read_text("utf-8")
        table = text[text.index("\nSENSORS: ") :].partition("\n}\n")[0]
        found = re.findall(
            r'"(adafruit_(\w+)[\w.]*):(\w+)": \(.*?"([\w()]+)",\s[^"]*?\)', table, re.S
        )
        for module, package, name, value in found:
            package = f"adafruit-circuitpython-{package.replace('_', '-')}"
            yield f"`{value}`", f"`adafruit` `{module}:{name}`", package, bus


def words(name: str) -> str:
    """Return the words of a name of a class; what is in capitals stays so."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name).split()
    first, *rest = (each if each.isupper() else each.lower() for each in apart)
    return " ".join((first if first.isupper() else first.capitalize(), *rest))


def table() -> str:
    """Return the block of the page."""
    lines = [*HEAD, *(f"| {' | '.join(each)} | {NOT_TRIED} |" for each in rows())]
    return "\n".join(["<!-- parts -->", *lines, "<!-- end of parts -->", ""])


def main() -> int:
    """Write the table into its page; return 0."""
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(BLOCK.sub(lambda _: table(), page), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
