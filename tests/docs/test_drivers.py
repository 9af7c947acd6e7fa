"""The table that says how well each driver is tried is complete, and true."""

import ast
import importlib.metadata
import importlib.util
import re
from pathlib import Path

import pytest
from docs import parts_table

from esair.config import check

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/reference/drivers.md").read_text(encoding="utf-8")
ROWS = re.findall(
    r"^\| `(\w+)`[^|]*\| (yes|no) \| (yes|no) \| (yes|no) \| (yes|no) \|$", PAGE, re.M
)
MODULES = {
    point.name: point.value
    for point in importlib.metadata.entry_points(group="esair.drivers")
    if point.value.startswith("esair.")
} | {"feetech": "esair.drivers.servo.feetech"}


def test_every_driver_has_a_row() -> None:
    """Those that can be named in robot.toml."""
    assert sorted(row[0] for row in ROWS) == sorted(MODULES)


@pytest.mark.parametrize(("name", "source", "suite"), [row[:3] for row in ROWS])
def test_a_row_says_what_is_there(name: str, source: str, suite: str) -> None:
    """A docstring that names its source, and a contract suite of `esair.testing`."""
    spec = importlib.util.find_spec(MODULES[name])
    assert spec is not None
    assert spec.origin is not None
    doc = ast.get_docstring(ast.parse(Path(spec.origin).read_text(encoding="utf-8")))
    tests = ROOT / "tests/drivers" / f"test_{name}.py"
    suites = tests.exists() and re.search(r"^class .*Contract", tests.read_text(), re.M)

    assert ("yes" if "\nSource: " in (doc or "") else "no") == source
    assert ("yes" if suites else "no") == suite


def test_the_table_of_parts_is_that_of_the_code() -> None:
    """With the classes of the adapters; ``python -m docs.parts_table`` writes it."""
    pytest.importorskip("gpiozero", reason="the extra 'gpiozero' is missing")

    assert parts_table.table() in PAGE
    for each in ("`gpiozero` `Motor`", "`adafruit_max31855:MAX31855`", "`mavlink`"):
        assert each in PAGE


def test_the_robot_of_the_page_has_no_mistake() -> None:
    """Only that nobody uses its parts."""
    report = check(ROOT / "docs/code/chips.toml")

    assert {found.rule for found in report.findings} == {"unused"}
    assert len(report.findings) == 5
