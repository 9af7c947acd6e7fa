"""What ROS sends too much of: what waits is bounded and counted, and the robot keeps its pace."""

from __future__ import annotations

import asyncio
import queue
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import pytest
from tests.ros.parts import Beating, Citizen, Motion, twist

import esair
from esair.buses import ros
from esair.buses.ros import Link, Process, form_of
from esair.buses.ros._child import (
    ASKED,
    KEPT,
    LARGEST,
    MOST,
    SHARE,
    Bridge,
    Outbox,
    pack,
    plain,
    unpack,
)

HEAD = [7, 1, 0, 0, 0.0]
CHILD = str(Path(ros.__file__).parent / "_child.py")


@pytest.mark.virtual_clock
@pytest.mark.promise("ROS-2")
async def test_what_ros_asks_and_says_at_once_is_bounded_and_counted() -> None:
    """What there is no room for is refused, or dropped, and the robot knows how much."""
    citizen = Citizen()
    async with citizen.running():
        asked = [
            citizen.fake.call("/count", {"order": number}) for number in range(500)
        ]
        for _ in range(1000):
            citizen.fake.publish("/range", {"data": 1.0})
        assert citizen.fake._frames.qsize() <= ASKED + SHARE
        await asyncio.sleep(2.0)
        done = [each.result() for each in asked if each.done()]
        assert len(done) >= len(asked) - ASKED
        assert {how for how, _ in done} == {"declined"}
        assert citizen.bus.stats.dropped == len(asked) - ASKED
        citizen.lamp.go.set()
        await asyncio.sleep(0.5)
        assert all(each.done() for each in asked)
        citizen.fake.publish("/cmd_vel", twist(0.3))
        await citizen.wheels.until(Motion(0.3, 0.0), timeout=1.0)


@pytest.mark.virtual_clock
@pytest.mark.promise("ROS-1")
async def test_what_ros_has_cancelled_is_forgotten() -> None:
    """Goals that are given up leave nothing behind, however many there are."""
    citizen = Citizen()
    async with citizen.running():
        for _ in range(20):
            goal = citizen.fake.call("/count", {"order": 3})
            await asyncio.sleep(0.1)
            goal.cancel()
            await asyncio.sleep(0.1)
        assert citizen.lamp.cancelled == 20
        assert citizen.network._served == {}


@pytest.mark.promise("ROS-2")
def test_what_is_too_large_is_told_and_not_sent() -> None:
    """The robot takes no frame of more than four megabytes, and would end the process."""
    sent: queue.Queue[bytes] = queue.Queue()
    box = Outbox(sent.put, None)
    assert box.send(["reading", *HEAD, "/big", 0.0, "x" * LARGEST])
    told = unpack(sent.get(timeout=10.0)[4:])
    assert told == ["bad", *HEAD, "reading /big is larger than 1 MiB, or 20000 items"]


@pytest.mark.promise("ROS-2")
def test_what_the_robot_would_read_for_too_long_is_not_sent() -> None:
    """It takes 20,000 items; a text is one, whatever is in it."""
    sent: queue.Queue[bytes] = queue.Queue()
    box = Outbox(sent.put, None)
    box.send(["reading", *HEAD, "/map", 0.0, [[0.5] * 100] * 201])
    told = unpack(sent.get(timeout=10.0)[4:])
    assert told == ["bad", *HEAD, "reading /map is larger than 1 MiB, or 20000 items"]

    text = "a, b,\n" * 30_000
    box.send(["reading", *HEAD, "/text", 0.0, {"data": text}])
    assert unpack(sent.get(timeout=10.0)[4:])[-1] == {"data": text}


@pytest.mark.promise("ROS-1", "ROS-2")
@pytest.mark.parametrize(
    ("kind", "fields", "wanted"),
    [
        ("nav_msgs/msg/OccupancyGrid", "info.width", {"info": {"width": 7}}),
        ("tf2_msgs/msg/TFMessage", None, {"transforms": []}),
        ("nav_msgs/msg/OccupancyGrid", None, {"info": {"width": 7}, "transforms": []}),
    ],
)
def test_of_a_message_is_read_what_is_looked_at(
    kind: str, fields: str | None, wanted: dict[str, Any]
) -> None:
    """Whatever else is in it, and however much: of a map one number can be had."""

    class Message:
        def __init__(self, **parts: Any) -> None:
            self.__dict__ = parts

        def get_fields_and_field_types(self) -> dict[str, Any]:
            return self.__dict__

    form = form_of(kind, int if fields else None, fields)
    link = Link("/map", kind, "topic", "in", "map", form)
    message = Message(info=Message(width=7), transforms=[])
    assert plain(message, link.roots) == wanted


@pytest.mark.promise("ROS-1", "ROB-3")
def test_a_message_that_cannot_be_read_is_told() -> None:
    """The process does not end by it, and hands on what comes after."""
    said: list[Any] = []

    class Graph:
        topics: ClassVar[dict[str, Any]] = {"/map": None}
        missing: ClassVar[dict[str, str]] = {}

    bridge = Bridge(lambda frame: not said.append(frame), lambda: 0.0)  # type: ignore[func-returns-value]
    bridge.begin(Graph(), {})
    bridge.took(["follow", *HEAD, {"/map": 10.0}])
    bridge.heard("/map", lambda: bytes(-1))
    assert [said[-1][0], *said[-1][6:]] == ["bad", "/map: negative count"]
    bridge.due.clear()
    bridge.heard("/map", lambda: 1.0)
    assert said[-1][6:] == ["/map", 0.0, 1.0]


@pytest.mark.promise("ROS-1")
def test_bytes_are_bytes_and_no_dictionary_is_taken_for_them() -> None:
    """What marks bytes is no name of a field in ROS: it is refused where it is sent."""
    assert unpack(pack(["x", {"a": b"\0\1"}])[4:]) == ["x", {"a": b"\0\1"}]
    for odd in ({"#": 5}, {"a": [{"#": "AAE="}]}):
        with pytest.raises(ValueError, match="no field of ROS is called '#'"):
            pack(["x", odd, b"\0\1"])


@pytest.mark.promise("ROS-1", "NET-3")
def test_an_ask_that_is_not_known_there_is_lost() -> None:
    """Its answer was too large, or the process is another one by now."""
    said: list[Any] = []

    class Graph:
        asked: ClassVar[dict[int, Any]] = {}

    def send(frame: Any) -> bool:
        said.append(frame)
        return True

    bridge = Bridge(send)
    bridge.begin(Graph(), {})
    bridge.took(["pending", *HEAD, [5]])
    assert said[-1][6:] == [5, "lost", "it is not known there"]


STALLED = """
import importlib.util, socket, sys, time
spec = importlib.util.spec_from_file_location("child", sys.argv[1])
child = importlib.util.module_from_spec(spec)
spec.loader.exec_module(child)

def end(why):
    print(why)
    raise SystemExit(3)

deaf, robot = socket.socketpair()
box = child.Outbox(robot.sendall, end)
def flood(topic, size):
    frame = ["reading", 1, 1, 1, 1, 0.0, topic, 0.0, "x" * size]
    taken = 0
    while True:
        taken += sum(box.send(frame) for _ in range(5000))
        there = box.waiting.qsize()
        time.sleep(0.1)
        if box.waiting.qsize() == there > 0:
            break  # the socket takes no more
    print(taken, box.waiting.qsize(), box.room.bytes, flush=True)

flood("/scan", 1000)
flood("/cmd_vel", 100)
flood("/image", 1 << 19)
flood("/more", 1 << 10)
for number in range(5000):
    box.send(["ask", 1, 1, 1, 1, 0.0, number, "/light", {}])
"""


@pytest.mark.real_clock
@pytest.mark.promise("ROS-2")
def test_a_robot_that_does_not_listen_is_given_up() -> None:
    """Each topic has its share of what waits; with 1,024 of anything the process ends."""
    done = subprocess.run(
        [sys.executable, "-c", STALLED, CHILD],
        capture_output=True,
        text=True,
        check=False,
        timeout=30.0,
    )
    *counts, told = done.stdout.splitlines()
    scans, commands, images, more = [list(map(int, each.split())) for each in counts]
    assert scans[0] < 5000  # what a socket keeps, and what waits
    assert scans[1] <= SHARE
    assert commands[0] == SHARE  # others have taken nothing of it
    assert images[0] <= 3
    assert images[2] < KEPT + (1 << 20)  # the last of them came when there was room
    assert more[0] == 1
    assert told == "the robot does not listen: too much waits for it"
    assert done.returncode == 3
    assert MOST == 1024


FLOODING = """#!{python}
import importlib.util, os, socket, struct, sys, threading, time
spec = importlib.util.spec_from_file_location("child", {child!r})
child = importlib.util.module_from_spec(spec)
spec.loader.exec_module(child)
robot = socket.socket(fileno=os.dup(0))
stream = robot.makefile("rb")

def take():
    size = stream.read(4)
    if len(size) < 4:
        os._exit(0)
    return child.unpack(stream.read(struct.unpack(">I", size)[0]))

class Graph:
    topics, asked, missing = {{"/cmd_vel": None, "/range": None}}, {{}}, {{}}
    publish = call = cancel = lambda *_: None
    strangers = lambda _: ()

setup = take()
box = child.Outbox(robot.sendall, lambda _: os._exit(1))
bridge = child.Bridge(box.send)
bridge.begin(Graph(), setup["feeds"])

def hear():
    while True:
        bridge.took(take())

threading.Thread(target=hear, daemon=True).start()
due = time.monotonic()
while True:
    if time.monotonic() >= due:
        due += child.BEAT
        bridge.tick()
        bridge.say("reading", "/cmd_vel", 0.0, {twist})
    bridge.say("reading", "/range", 0.0, {{"data": 1.0}})
    if not box.room.has(["reading", 0, 0, 0, 0, 0.0, "/range"]):
        time.sleep(0.0005)
"""


@pytest.mark.real_clock
@pytest.mark.long
@pytest.mark.promise("ROS-2")
async def test_a_process_that_says_all_it_can_slows_nothing(tmp_path: Path) -> None:
    """The robot's own work at 50 Hz is on time, what comes by ROS still drives it."""
    flooding = tmp_path / "python3"
    flooding.write_text(
        FLOODING.format(python=sys.executable, child=CHILD, twist=twist(0.3))
    )
    flooding.chmod(0o755)
    citizen, beating = Citizen(Process(str(flooding))), Beating()
    async with citizen.robot(beating) as robot:
        await citizen.wheels.until(Motion(0.3, 0.0), timeout=10.0)
        told, received = len(citizen.wheels.commands), citizen.bus.stats.received
        beating.late.clear()
        await asyncio.sleep(3.0)
        late = sorted(beating.late)
        came = citizen.bus.stats.received - received
        assert came > 1000
        assert len(late) >= 140
        assert late[len(late) * 95 // 100] < 0.01, late[-10:]
        assert len(citizen.wheels.commands) - told >= 55
        assert robot.resources.query("ros").state is esair.ResourceState.READY
