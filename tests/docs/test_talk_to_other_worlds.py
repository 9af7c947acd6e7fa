"""The parts of the page have no mistake but that nobody uses them."""

from pathlib import Path

import pytest

from esair.config import check

CODE = Path(__file__).parents[2] / "docs" / "code"


@pytest.mark.parametrize(
    ("name", "package"),
    [("house", "aiomqtt"), ("vehicle", "pymavlink"), ("unit", "udsoncan")],
)
def test_a_robot_of_the_page_has_no_mistake(name: str, package: str) -> None:
    """They are read as any robot.toml is."""
    pytest.importorskip(package, reason=f"{package} is missing")

    assert {found.rule for found in check(CODE / f"{name}.toml").findings} == {"unused"}
