"""What the developer is told: what, where, what to do; the traceback if wanted."""

import subprocess
import sys

import pytest

SCRIPT = """
import esair

class Plan(esair.Behavior):
    restart = esair.Restart(max=0)
    {port}

    async def run(self):
        return {{}}["goal"]

esair.run(esair.Robot(behaviors=[Plan()]))
"""


def said(folder, port: str, *words: str) -> tuple[int, list[str]]:
    file = folder / "rover.py"
    file.write_text(SCRIPT.format(port=port))
    done = subprocess.run(
        [sys.executable, str(file), *words],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stderr.replace(f"{folder}/", "").splitlines()


@pytest.mark.long
@pytest.mark.real_clock
def test_a_crash_ends_a_script_with_one_block(tmp_path) -> None:
    """The line of the user's code, and no line of esair's."""
    code, lines = said(tmp_path, "")

    assert code == 1
    assert lines == [
        "plan: failed for good, 0 restarts did not help: KeyError: 'goal'",
        '  where: rover.py, line 9, in run: return {}["goal"]',
        "BehaviorFailedError: behavior 'plan' failed: KeyError: 'goal'",
        '  where: rover.py, line 9, in run: return {}["goal"]',
        "  to do: mend that line; --traceback shows how it came to that",
    ]
    _, lines = said(tmp_path, "", "--traceback")
    assert "Traceback (most recent call last):" in lines


@pytest.mark.real_clock
def test_a_mistake_names_the_class_that_has_it(tmp_path) -> None:
    """A robot that cannot start says which line to look at."""
    code, lines = said(tmp_path, "wheels = esair.writes(float)")

    assert code == 1
    assert lines == [
        "robot 'robot' cannot start",
        "UnknownNameError: plan: wheels: no resource is named 'wheels'; there are none",
        "  where: rover.py, line 4, class Plan",
        "  to do: nothing was opened, nothing moved: mend it; "
        "--traceback shows how it came to that",
    ]
