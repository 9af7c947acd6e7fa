"""The arm with a blocking driver, on a clock that waits for its threads."""

import asyncio

import pytest
import slow_arm


@pytest.mark.virtual_clock
async def test_who_may_do_what_with_the_arm(capsys) -> None:
    """One moves and configures it, one takes it away for a while, one is denied."""
    async with slow_arm.make_robot() as robot:
        await robot.ended()

        arm = robot.resources.get("arm")
        assert arm.settings["speed"] == 1.0

    denied, refused, speed, held, count = capsys.readouterr().out.splitlines()
    assert denied.startswith("denied: 'visitor' may not WRITE 'arm'")
    assert "at most 2.0 rad/s, not 99.0" in refused
    assert speed == "speed: 1.0 rad/s"
    assert held.startswith("held by guard: priority 10")
    assert count == "5 of 31 writes were refused"
    assert robot.stopped[0].safe


@pytest.mark.virtual_clock
@pytest.mark.promise("BEH-2")
async def test_a_plain_behavior_can_be_removed() -> None:
    """Its thread ends at its next call, and the arm is told its safe command."""
    async with slow_arm.make_robot() as robot:
        await asyncio.sleep(0.5)
        assert robot.resources.why("arm").holder == "inspect"

        await robot.behaviors.remove("inspect")

        assert robot.resources.why("arm").last == slow_arm.Arm.safe
        assert robot.behaviors.zombies == ()
