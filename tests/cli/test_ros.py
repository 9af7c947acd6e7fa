"""``esair ros`` where ROS 2 is not."""

from __future__ import annotations

import pytest


@pytest.mark.real_clock
@pytest.mark.promise("ROS-1")
def test_to_find_without_ros_is_one_line(esair_command, capsys, tmp_path) -> None:
    """It names what is missing; there is no traceback."""
    setup = tmp_path / "setup.bash"

    assert esair_command("ros", "--find", "--setup", setup) == 1

    told = capsys.readouterr().err
    assert told.startswith("esair: device of 'ros' is lost: ")
    assert "setup.bash: No such file" in told
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize("seconds", [-1, 0, "nan"])
def test_to_find_for_no_time_is_refused(esair_command, capsys, seconds) -> None:
    """No process of ROS is begun for that."""
    assert esair_command("ros", "--find", "--for", seconds) == 2
    assert capsys.readouterr().err == (
        f"esair: --for: expected seconds > 0, not {seconds}\n"
    )
