"""One story as a test: what `esair torture` writes, and what that test calls."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from esair.torture._judge import Violation
from esair.torture._story import Step, Story, repr_of
from esair.torture._target import Target
from esair.torture._world import tell
from esair.values import printable

_TEST = '''\
"""{title}

Found by: esair torture {words} --seed {seed}
"""
{imports}
from esair.torture import Step, survive
{place}

def test_{name}() -> None:
    """{text}"""
    survive(
        {robot},
        seed={story.seed},
        lasts={story.lasts:g},{own}
        steps=[{steps}],
    )
'''


def survive(
    robot: str | os.PathLike[str],
    steps: Sequence[Step] = (),
    *,
    seed: int = 0,
    lasts: float = 3.0,
    own: bool = False,
) -> None:
    """Do to a robot what a story tells, and see to it that all holds that must.

    It runs on the virtual clock, without any hardware.

    Args:
        robot: A robot.toml; or ``module:robot``, ``file.py:robot``.
        steps: What is done to it, in order.
        seed: Decides the order of tasks, and what stand-ins of sensors say.
        lasts: When the robot is stopped, in seconds.
        own: The devices of a module's robot are harmless as they are: use them.

    Raises:
        AssertionError: Something was seen that must never be.
    """
    target = Target.of(os.fspath(robot), own=own)
    outcome = tell(target, Story(seed, tuple(steps), lasts))
    if outcome.violations:
        lines = ["what must never be:", *map(str, outcome.violations)]
        lines += ["what was done:", *map(str, steps)]
        raise AssertionError("\n  ".join(lines))


def write_test(
    target: Target, violation: Violation, story: Story, seed: int, folder: Path
) -> Path:
    """Write a story as a test for pytest.

    Args:
        target: Whose robot.
        violation: What it shows.
        story: The story.
        seed: The seed of the search that has found it.
        folder: Where the test goes; it is made if it is not there.

    Returns:
        The file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rule = violation.rule.replace(" ", "_")
    name = f"{violation.component}_{rule}"
    imports = place = ""
    robot = repr_of(target.name)
    if target.file is not None:
        imports = "\nfrom pathlib import Path\n"
        path = Path(os.path.relpath(target.file.resolve(), folder.resolve()))
        place = f"\nROBOT = Path(__file__).parent / {repr_of(path.as_posix())}\n"
        attribute = repr_of(target.name.rpartition(":")[2])[1:-1]
        robot = "ROBOT"
        if target.file.suffix == ".py":
            attribute = attribute.replace("{", "{{").replace("}", "}}")
            robot = f'f"{{ROBOT}}:{attribute}"'
    steps = "".join(f"\n            {step.source()}," for step in story.steps)
    text = _TEST.format(
        title=_sentence(f"{violation.component}: {violation.rule}"),
        words=repr_of(target.name)[1:-1],
        seed=seed,
        imports=imports,
        place=place,
        name=name,
        text=_sentence(violation.text),
        robot=robot,
        story=story,
        own="\n        own=True," if target.own else "",
        steps=f"{steps}\n        " if steps else "",
    )
    file = folder / f"test_torture_{name}.py"
    file.write_text(text, encoding="utf-8")
    return file


def _sentence(text: str) -> str:
    words = " ".join(text.replace("\\", "/").replace('"', "'").split())
    words = printable(words[:1].upper() + words[1:])
    if len(words) > 80:
        words = words[:77].rstrip() + "..."
    return words if words.endswith(".") else f"{words}."
