"""Where keys are in a file."""

import pytest

from esair.config._mistakes import Lines

TEXT = '''\
title = """
[robot]
x = 1
"""
[robot]
name = "r"
sensor.a.rate = 3
[ sensor . "b.c" ]   # a comment
'driver' = "x"
safe = { left = 0 }
[actuator.d.sim]
'''


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("title", 1),
        ("robot", 5),
        ("robot.name", 6),
        ("robot.sensor.a.rate", 7),
        ("robot.sensor.a", 7),
        ("sensor.'b.c'", 8),
        ("sensor.'b.c'.driver", 9),
        ("sensor.'b.c'.safe.left", 10),
        ("sensor.'b.c'.missing", 8),
        ("actuator.d", 11),
        ("bus.x", None),
        ("x", None),
    ],
)
def test_a_key_is_found_at_its_line_or_that_of_its_table(key, line) -> None:
    """Headers, dotted keys, quoted keys, inline tables; not the insides of strings."""
    assert Lines(TEXT).of(key) == line
