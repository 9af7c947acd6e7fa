"""Messages of ROS as values of this robot, and back: by a path for each field.

A path is ``twist.twist.linear.x``. ``:yaw`` makes an angle of a quaternion, ``:xyz`` and
``:xyzw`` a tuple of what has such parts, ``:measured`` a row with 0.0 for what is no number.
Units are those of ROS: metres, radians, seconds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final

import attrs

from esair.codec import Kinds


@attrs.frozen
class Twist:
    """``geometry_msgs/msg/Twist``: m/s forward and to the left, rad/s counter-clockwise."""

    linear: float
    angular: float
    lateral: float = 0.0


@attrs.frozen
class Scan:
    """``sensor_msgs/msg/LaserScan``: distances in metres, counter-clockwise.

    Infinite: nothing in reach. 0.0: not measured. ``first`` and ``step`` are in radians.
    """

    first: float
    step: float
    ranges: tuple[float, ...]
    frame: str = ""


@attrs.frozen
class Odometry:
    """``nav_msgs/msg/Odometry``: metres and rad in ``frame``, speeds in that of ``child``."""

    x: float
    y: float
    heading: float
    linear: float = 0.0
    angular: float = 0.0
    frame: str = ""
    child: str = ""


@attrs.frozen
class Joints:
    """``sensor_msgs/msg/JointState``: rad or m, rad/s or m/s, N m or N, by name.

    A velocity or effort of 0.0 may be one that was not measured.
    """

    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()
    efforts: tuple[float, ...] = ()


@attrs.frozen
class Imu:
    """``sensor_msgs/msg/Imu``: quaternion x, y, z, w; rad/s; m/s² with gravity."""

    orientation: tuple[float, ...]
    rotation: tuple[float, ...]
    acceleration: tuple[float, ...]
    frame: str = ""


@attrs.frozen
class Image:
    """``sensor_msgs/msg/Image``: rows of ``step`` bytes, in an encoding such as ``rgb8``."""

    width: int
    height: int
    encoding: str
    step: int
    data: bytes
    frame: str = ""


@attrs.frozen
class Transform:
    """``geometry_msgs/msg/TransformStamped``: where ``child`` is in ``parent``, in metres."""

    parent: str
    child: str
    translation: tuple[float, ...]
    rotation: tuple[float, ...]


def _paths(text: str) -> dict[str, str]:
    """Return the paths of ``field=path``; a lone word is both."""
    found = (each.partition("=") for each in text.split())
    return {name: path or name for name, _, path in found}


_TWIST: Final = "linear={0}linear.x lateral={0}linear.y angular={0}angular.z"
_STAMPED: Final = _TWIST.format("twist.") + " frame=header.frame_id"
_SCAN: Final = """first=angle_min step=angle_increment ranges=ranges:measured
    frame=header.frame_id"""
_ODOMETRY: Final = f"""{_TWIST.format("twist.twist.")}
    x=pose.pose.position.x y=pose.pose.position.y heading=pose.pose.orientation:yaw
    child=child_frame_id frame=header.frame_id"""
_JOINTS: Final = """names=name positions=position velocities=velocity:measured
    efforts=effort:measured frame=header.frame_id"""
_IMU: Final = """orientation=orientation:xyzw rotation=angular_velocity:xyz
    acceleration=linear_acceleration:xyz frame=header.frame_id"""
_IMAGE: Final = "width height encoding step data frame=header.frame_id"
_MOVED: Final = """frame=header.frame_id parent=header.frame_id child=child_frame_id
    translation=transform.translation:xyz rotation=transform.rotation:xyzw
    x=transform.translation.x y=transform.translation.y heading=transform.rotation:yaw"""

READY: Final[Mapping[str, tuple[type, Mapping[str, str]]]] = {
    "geometry_msgs/msg/Twist": (Twist, _paths(_TWIST.format(""))),
    "geometry_msgs/msg/TwistStamped": (Twist, _paths(_STAMPED)),
    "sensor_msgs/msg/LaserScan": (Scan, _paths(_SCAN)),
    "nav_msgs/msg/Odometry": (Odometry, _paths(_ODOMETRY)),
    "sensor_msgs/msg/JointState": (Joints, _paths(_JOINTS)),
    "sensor_msgs/msg/Imu": (Imu, _paths(_IMU)),
    "sensor_msgs/msg/Image": (Image, _paths(_IMAGE)),
    "geometry_msgs/msg/TransformStamped": (Transform, _paths(_MOVED)),
    "tf2_msgs/msg/TFMessage": (Transform, _paths(_MOVED)),
}
"""Types of ROS with a class here, and the paths of what fields may be called."""

_ROWS: Final = {"tf2_msgs/msg/TFMessage": "transforms"}
_ONE: Final = re.compile(r"std_msgs/msg/(Float|U?Int|String|Bool)?(?!.*Array)")
_FRAMES: Final = {"header.frame_id", "child_frame_id"}
_OF_ONE: Final = {"Float": float, "Int": int, "UInt": int, "String": str, "Bool": bool}


@attrs.frozen
class Form:
    """What messages of one type are here.

    Attributes:
        kind: The class; None for plain data as it comes.
        fields: The path of each of its fields; one path for what is no class.
        fixed: What is published at some paths, whatever the value.
        rows: Where the rows of messages are that each stand for one value.
    """

    kind: Any = None
    fields: Mapping[str, str] | str = ""
    fixed: Mapping[str, Any] = attrs.field(factory=dict)
    rows: str = ""

    @property
    def type(self) -> Any:
        """The type of the values, as far as it is known."""
        return tuple if self.rows else self.kind or Any

    def value(self, message: Any) -> Any:
        """Return what a message is here.

        Raises:
            ValueError: It has not what is expected.
        """
        if self.rows:
            inner = attrs.evolve(self, rows="")
            return tuple(inner.value(each) for each in message[self.rows])
        try:
            if isinstance(self.fields, str):
                return _get(message, self.fields) if self.fields else _plain(message)
            found = {name: _get(message, path) for name, path in self.fields.items()}
            return self.kind(**found)
        except (LookupError, TypeError) as error:
            raise ValueError(f"{type(error).__name__}: {error}") from None

    def message(self, value: Any) -> Any:
        """Return what a value is in ROS, as plain data.

        Raises:
            ValueError: It has not what is expected.
        """
        if self.rows:
            inner = attrs.evolve(self, rows="")
            values = value if type(value) in {tuple, list} else (value,)
            return {self.rows: [inner.message(each) for each in values]}
        made: dict[str, Any] = {}
        for path, fixed in self.fixed.items():
            _put(made, path, fixed)
        if self.fields == "":
            return {**value, **made} if isinstance(value, dict) else value
        if isinstance(self.fields, str):
            _put(made, self.fields, value)
            return made
        try:
            for name, path in self.fields.items():
                if (part := getattr(value, name)) != "" or path not in self.fixed:
                    _put(made, path, part)
        except AttributeError as error:
            raise ValueError(str(error)) from None
        return made


def form_of(
    ros: str,
    kind: Any = None,
    fields: Mapping[str, str] | str | None = None,
    fixed: Mapping[str, Any] | None = None,
) -> Form:
    """Return what messages of a type are here.

    Args:
        ros: The type, such as ``sensor_msgs/msg/LaserScan``.
        kind: The class; that for the type if there is one ready, else plain data.
        fields: The path of a field, where it is not called as a ready one, or as in ROS.
        fixed: What is published at some paths, whatever the value.

    Raises:
        ValueError: A field has no path, or the type has not what is fixed.
    """
    ready, paths = READY.get(ros, (None, None))
    fixed = fixed or {}
    there = () if ros.startswith("std_msgs/") else paths and paths.values()
    for path in _FRAMES & fixed.keys():
        if there is not None and path not in there:
            raise ValueError(f"{ros} has no {path}")
    if isinstance(fields, str):
        return Form(kind, fields, fixed)
    of: Any = kind or ready
    kinds = Kinds([of])
    if of not in kinds:
        if fields is None and (one := _ONE.match(ros)) is not None:
            return Form(kind or _OF_ONE.get(one[1]), "data", fixed)
        if ready is not None and kind in _OF_ONE.values():
            hint = f"expected fields = 'PATH', or a class such as {ready.__name__}"
            raise ValueError(f"{ros} is more than one {kind.__name__}: {hint}")
        return Form(kind, "", fixed)
    shape, fields = kinds.shape(of), fields or {}
    known = {**(dict.fromkeys(shape.fields) if paths is None else paths), **fields}
    for name in shape.fields:
        if name not in known and name not in shape.defaults:
            raise ValueError(
                f"{of.__qualname__}.{name} is none of {', '.join(paths or ())} of {ros}: "
                f"expected its path, fields = {{ {name} = '...' }}"
            )
    if unknown := set(fields) - set(shape.fields):
        raise ValueError(f"{of.__qualname__} has no field {min(unknown)!r}")
    told = {name: known[name] or name for name in shape.fields if name in known}
    return Form(of, told, fixed, _ROWS.get(ros, ""))


def _get(message: Any, path: str) -> Any:
    path, _, how = path.partition(":")
    for step in path.split("."):
        message = message[step]
    if how == "yaw":
        x, y, z, w = (message[each] for each in "xyzw")
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    if how == "measured":
        return tuple(0.0 if each != each else each for each in message)
    return tuple(message[each] for each in how) if how else _plain(message)


def _plain(part: Any) -> Any:
    """Return rows as tuples."""
    if isinstance(part, list):
        return tuple(map(_plain, part))
    if isinstance(part, dict):
        return {name: _plain(each) for name, each in part.items()}
    return part


def _put(message: dict[str, Any], path: str, value: Any) -> None:
    path, _, how = path.partition(":")
    *steps, last = path.split(".")
    for step in steps:
        message = message.setdefault(step, {})
    if how == "yaw":
        half = value / 2.0
        value = {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)}
    elif how.startswith("x"):
        value = dict(zip(how, map(float, value), strict=True))
    message[last] = value
