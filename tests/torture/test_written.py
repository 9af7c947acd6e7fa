"""The test that `torture` writes is a test, whatever the robot's folder is called."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from esair.torture import Story, Target, write_test
from esair.torture._judge import Violation
from esair.torture._kinds import repr_of

EVIL = 'x"""\nimport os; os.system("touch ran")\n"""\\'


@pytest.mark.promise("SEC-1")
@pytest.mark.parametrize("form", ["robot.toml", "it.py:robot", "module"])
def test_the_name_of_a_folder_is_no_code(tmp_path: Path, form: str) -> None:
    """Quotes, line ends and braces in it are text, in the docstring and in the path."""
    place = tmp_path / EVIL / "{1 + 1}"
    place.mkdir(parents=True)
    name = f"{place}/{form}" if form != "module" else f"{EVIL}:robot"
    target = Target(name, lambda: pytest.fail("nothing is made"))
    if form != "module":
        target.file = Path(f"{place}/{form}".removesuffix(":robot"))
    violation = Violation("stop", "sonar", 'a device says """\nimport os\x1b', 1.0)
    file = write_test(target, violation, Story(1), 7, tmp_path / "tests")

    tree = ast.parse(file.read_text())
    assert [
        type(node).__name__ for node in tree.body if not isinstance(node, ast.Assign)
    ] == [
        "Expr",
        *["ImportFrom"] * (1 + (form != "module")),
        "FunctionDef",
    ]
    function = tree.body[-1]
    assert isinstance(function, ast.FunctionDef)
    assert len(function.body) == 2
    called = {
        ast.unparse(each.func) for each in ast.walk(tree) if isinstance(each, ast.Call)
    }
    assert called <= {"survive", "Path"}


@pytest.mark.parametrize(
    "text", ["a", 'a"b', "it's", "a\\", '\\"', "\n\x1b\u202e", "\udc80{}"]
)
def test_a_text_is_written_as_it_is(text: str) -> None:
    """Python reads it back."""
    assert ast.literal_eval(repr_of(text)) == text
    assert repr_of(text).isprintable()
