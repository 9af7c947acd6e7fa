"""Drive two wheels with a gamepad: the left stick steers while the left shoulder is held.

The wheels are drives of CiA 402 on a CAN bus; any actuators of rad/s will do. Who puts the
pad down, lets the shoulder go or pulls its cable stops the robot. The start button hands it
to a behavior that turns on the spot, and takes it back::

    python examples/pad_drive.py can0 usb:045e:028e
"""

import sys

import esair
from esair.buses import CanBus
from esair.drivers.canopen.drive import Drive
from esair.drivers.gamepad import Gamepad, Pad

FASTEST = 10.0  # rad/s of a wheel
UNIT = 0.001  # rad/s for one unit of a drive


class Steer(esair.Reaction):
    """Forward and turn, as the stick says."""

    pad = esair.reads(Pad, max_age=0.2)
    left = esair.writes(float)
    right = esair.writes(float)
    rate = 20.0

    def react(self, pad: Pad) -> dict[str, float]:
        forward, turn = pad.axis("y"), 0.5 * pad.axis("x")
        return {
            "left": FASTEST * max(-1.0, min(1.0, forward + turn)),
            "right": -FASTEST * max(-1.0, min(1.0, forward - turn)),  # it is mirrored
        }


class Turn(esair.Behavior):
    """On the spot, until somebody takes the wheels back."""

    left = esair.writes(float)
    right = esair.writes(float)

    async def run(self) -> None:
        async for _ in esair.every(0.1):
            await self.left.write(0.2 * FASTEST)
            await self.right.write(0.2 * FASTEST)


class Switch(esair.Behavior):
    """Goes to the other mode each time that start is pressed."""

    pad = esair.reads(Pad)

    async def run(self) -> None:
        was_pressed, mode = False, "drive"
        async for pad in self.pad:
            is_pressed = "start" in pad.buttons
            if is_pressed and not was_pressed:
                mode = "turn" if mode == "drive" else "drive"
                await self.supervisor.switch(mode, reason="start was pressed")
            was_pressed = is_pressed


def make_robot(bus: CanBus, pad: Gamepad) -> esair.Robot:
    """Return the robot."""
    wheels = [
        Drive(name=name, bus=bus, node=node, factor=UNIT, limits=(-FASTEST, FASTEST))
        for name, node in (("left", 5), ("right", 6))
    ]
    return esair.Robot(
        resources=[pad, *wheels],
        behaviors=[Steer(), Turn(), Switch()],
        modes={"drive": ["steer"], "turn": ["turn"]},
        mode="drive",
        policies=[esair.Policy.behaviors(allow={"switch": "manage"})],
    )


are_named = __name__ == "__main__" and len(sys.argv) == 3
channel, device = sys.argv[1:] if are_named else ("can0", "usb:045e:028e")
robot = make_robot(
    CanBus(name="drive", channel=channel),
    Gamepad(name="pad", device=device, dead_man="tl"),
)

if __name__ == "__main__":
    esair.run(robot)
