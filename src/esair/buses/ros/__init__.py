"""ROS 2: a robot is a node among others, and its side there one more peer.

rclpy runs in a process of ROS's own interpreter (``_child.py``); it is never imported here.
"""

from esair.buses.ros._fake import FakeRos
from esair.buses.ros._forms import (
    READY,
    Form,
    Image,
    Imu,
    Joints,
    Odometry,
    Scan,
    Transform,
    Twist,
    form_of,
)
from esair.buses.ros._ros import Link, Process, Ros, look_at

__all__ = [
    "READY",
    "FakeRos",
    "Form",
    "Image",
    "Imu",
    "Joints",
    "Link",
    "Odometry",
    "Process",
    "Ros",
    "Scan",
    "Transform",
    "Twist",
    "form_of",
    "look_at",
]
