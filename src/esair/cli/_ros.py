"""``esair ros``: what a robot is in ROS 2, and what of ROS it could use."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Annotated, Any

from cyclopts import Parameter

from esair.cli._errors import CANNOT_USE, show, wrong_seconds
from esair.cli._options import AsJson, Which
from esair.cli._peers import of_status
from esair.seat import connect
from esair.values import printable

_OF_EVERY_NODE = ("rcl_interfaces/", "type_description_interfaces/")
_MOTIONS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")


def ros(
    *,
    find: bool = False,
    python: str = "/usr/bin/python3",
    setup: Annotated[str | None, Parameter(name="--setup")] = None,
    domain: int | None = None,
    seconds: Annotated[float, Parameter(name="--for")] = 3.0,
    robot: Which = None,
    machine: AsJson = False,
) -> int:
    """Show how a robot that runs is heard in ROS 2; or find what there is in ROS.

    Exit code: 0 it is there, or something was found; 1 not.

    Args:
        find: Look at the running graph, and print the lines for robot.toml.
        python: The interpreter that has rclpy.
        setup: A script to source before, such as /opt/ros/jazzy/setup.bash.
        domain: ROS_DOMAIN_ID; as in the environment unless given.
        seconds: How long it is looked, in seconds.
    """
    if not find:
        with connect(robot) as client:
            status = client.do("status")
        found = {each["name"]: each for each in of_status(status)}.get("ros")
        if machine:
            print(json.dumps(found))  # noqa: T201 - this is the output
        elif found is None:
            show("it has no [ros]")
        else:
            trip = found["round_trip"]
            told = f"{found['state']}" + (f", {1000 * trip:.1f} ms" if trip else "")
            shown = (told, found["error"] or "", *found["used"])
            print("\n".join(filter(None, map(printable, shown))))  # noqa: T201
        return int(found is None or found["state"] != "ready")
    if wrong_seconds(seconds):
        return CANNOT_USE
    from esair.buses.ros import Process, look_at

    graph = look_at(Process(python, setup), seconds=seconds, domain=domain)
    if machine:
        print(json.dumps(graph))  # noqa: T201
        return int(not any(graph.values()))
    lines = list(lines_of(graph))
    head = ["[ros]", f"python = {json.dumps(python)}"]
    head += [f"setup = {json.dumps(setup)}"] if setup else []
    head += [f"domain = {domain}"] if domain is not None else []
    print("\n".join([*head, *lines]))  # noqa: T201
    return int(not lines)


def lines_of(graph: dict[str, Any]) -> Iterator[str]:
    """Yield lines of a robot.toml for what is in a graph: each to be made fit."""
    parts, names = {"ros", "wheels"}, set[str]()
    for kind, found in graph.items():
        for name, every, gives, takes in found:
            types = [each for each in every if not each.startswith(_OF_EVERY_NODE)]
            if name in names or "/_" in name or not types:  # it is hidden
                continue
            part = name.strip("/").replace("/", "_").lower()
            while part in parts:
                part += "_"
            parts.add(part)
            names.add(name)  # a robot has one table of a name
            ends = (("published", gives), ("heard", takes))
            who = "; ".join(f"{did} by {', '.join(each)}" for did, each in ends if each)
            yield ""
            yield f"[ros.{kind}.{json.dumps(name)}]" + (who and f"  # {printable(who)}")
            yield f"type = {json.dumps(types[0])}"
            if len(types) > 1:
                told = printable(", ".join(types[1:]))
                yield f"# also {told}: they do not meet"
            if kind != "topics":
                yield f"behavior = {json.dumps(part)}"
                yield 'request = "module:Class"'
            elif not gives:
                yield 'publish = "a sensor of this robot"'
            elif types[0] in _MOTIONS:
                yield 'drive = "wheels"'
                yield "priority = 5"
            else:
                yield f"sensor = {json.dumps(part)}"
