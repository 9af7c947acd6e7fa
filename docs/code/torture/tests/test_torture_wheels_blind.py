"""Wheels: blind.

Found by: esair torture rover.py:robot --seed 7
"""

from pathlib import Path

from esair.torture import Step, survive

ROBOT = Path(__file__).parent / "../rover.py"


def test_wheels_blind() -> None:
    """It was told Twist(linear=0.3, angular=0.0) by wander while avoid could not se..."""
    survive(
        f"{ROBOT}:robot",
        seed=0,
        lasts=2,
        steps=[
            Step(1, "unplugged", "sonar", lasts=1),
        ],
    )
