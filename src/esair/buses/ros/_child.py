"""The robot's side in ROS: one file for ROS's own interpreter, which needs rclpy alone.

It is started with a socket as its standard input, and speaks as a peer does: with beats,
and with the newest beat of the robot in all it says. So what was kept back here, or on
the way, is known as old there. Nothing of esair is imported here, and nothing of rclpy
before it is started.
"""

from __future__ import annotations

import array
import base64
import collections
import importlib
import itertools
import json
import os
import queue
import random
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

BEAT = 0.05  # how often it beats, in seconds
LOOK = 20  # beats after which it looks for other types, and tells what it wants
GHOST = 25  # looks for which the graph still has a node that was killed
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # as DDS calls a node of which it has not heard yet
SHARE = 4  # readings of one topic that may wait to be sent; what comes then is dropped
KEPT = 1 << 20  # bytes that may wait: beyond that one reading of a topic
LARGEST = 1 << 22  # bytes that a frame may have: a message of 1 MiB as text, and more
MESSAGE = 1 << 20  # bytes that a message of a topic may have
ITEMS = 20_000  # numbers, or others, that a frame may have: the robot reads no more
PAUSE = 3.0  # how much longer other work is done after a reading than that has taken
WAITING = 64  # frames of the robot that may wait, and beats for it
MOST = 1024  # of anything; a robot that does not listen is no robot, and it ends
ASKED = 64  # requests of ROS that may be under way; what is asked then is refused


def pack(frame: Any) -> bytes:
    """Return a frame as bytes: its length, then JSON, with bytes in base 64."""
    blobs: list[Any] = []

    def blob(value: Any) -> dict[str, str]:
        blobs.append(value)
        return _blob(value)

    # Within a text there is no line break: it counts what there is.
    data = json.dumps(frame, default=blob, separators=(",\n", ": ")).encode()
    if data.count(b'"#": ') > len(blobs):
        raise ValueError("no field of ROS is called '#'")
    return struct.pack(">I", len(data)) + data


def unpack(data: bytes) -> Any:
    """Return the frame of some JSON."""
    return json.loads(data.decode(), object_hook=_unblob)


def _blob(value: Any) -> dict[str, str]:
    return {"#": base64.b64encode(value).decode()}


def _unblob(value: Any) -> Any:
    return base64.b64decode(value["#"]) if "#" in value else value


class Room:
    """What waits to be sent: each topic has its share, and none crowds out another."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.waiting: dict[str, int] = {}
        self.count = self.bytes = 0

    def has(self, frame: Any) -> bool:
        """Tell whether a frame may wait."""
        if frame[0] == "reading":
            there = self.waiting.get(str(frame[6:7]), 0)
            return there < (SHARE if self.bytes < KEPT else 1)
        return self.count < (WAITING if frame[0] == "beat" else MOST)

    def add(self, frame: Any, size: int, number: int = 1) -> None:
        """Count it; with -1 it has been sent."""
        with self.lock:
            self.count += number
            self.bytes += number * size
            if frame[0] == "reading":
                topic = str(frame[6:7])
                self.waiting[topic] = self.waiting.get(topic, 0) + number


class Outbox:
    """Sends to the robot what waits for that, in a thread of its own."""

    def __init__(self, write: Any, end: Any) -> None:
        self.write = write
        self.end = end
        self.room = Room()
        self.waiting: queue.Queue[tuple[Any, bytes]] = queue.Queue()
        threading.Thread(target=self._run, daemon=True).start()

    def send(self, frame: Any) -> bool:
        """Let a frame wait; tells whether there was room."""
        if self.room.has(frame):
            data = pack(frame)
            if len(data) > LARGEST or data.count(b"\n", 4) > ITEMS:
                told = f"{frame[0]} {frame[6]} is larger than 1 MiB, or {ITEMS} items"
                data = pack(["bad", *frame[1:6], told])
            self.room.add(frame, len(data))
            self.waiting.put((frame, data))
            return True
        if self.room.count >= MOST:
            self.end("the robot does not listen: too much waits for it")
        return False

    def _run(self) -> None:
        while True:
            frame, data = self.waiting.get()
            self.write(data)
            self.room.add(frame, len(data), -1)


class Bridge:
    """What is said between the robot and a graph, with beats."""

    def __init__(self, send: Any, clock: Any = time.monotonic) -> None:
        self.send = send
        self.clock = clock
        self.graph: Any = None
        self.run = random.getrandbits(63)
        self.beats = self.its_run = self.its_beat = 0
        self.heard_at = self.ticked = clock()
        self.gap = 0.0
        self.dropped = 0
        self.followed: dict[str, float] = {}
        self.due: dict[str, float] = {}
        self.newest: dict[str, tuple[float, Any]] = {}  # since when, and how it is read
        self.served: dict[int, tuple[Any, Any]] = {}
        self.feeds: dict[str, float] = {}
        self.numbers = itertools.count(1)

    def begin(self, graph: Any, feeds: Any) -> None:
        """Speak for a graph; feeds are the robot's sensors that are published."""
        self.graph, self.feeds, self.ticked = graph, feeds, self.clock()

    def say(self, what: str, *parts: Any) -> bool:
        """Tell the robot something; tells whether there was room."""
        held = self.clock() - self.heard_at if self.its_run else 0.0
        head = (self.run, self.beats, self.its_run, self.its_beat, held)
        is_sent: bool = self.send([what, *head, *parts])
        self.dropped += not is_sent
        return is_sent

    def tick(self) -> None:
        """Beat."""
        now = self.clock()
        gap, self.ticked = now - self.ticked, now
        self.gap = gap if gap > 3 * BEAT else 0.0
        self.beats += 1
        self.say("beat")
        for topic in tuple(self.newest):
            self._hand_on(topic, now)
        if self.beats % LOOK == 1:
            self.say("follow", self.feeds)
            self.say("pending", list(self.served))  # of others the robot knows nothing
            if self.dropped:
                told, self.dropped = self.dropped, 0
                self.say("dropped", told)
            for name, ours, other, who in self.graph.strangers():
                self.say("warn", name, ours, other, who)

    def took(self, frame: list[Any]) -> None:
        """Take what the robot says."""
        what, run, beat, _, _, _, *parts = frame
        if run != self.its_run:  # it has begun anew
            self.its_run, self.its_beat, self.followed = run, -1, {}
        if beat > self.its_beat:
            self.its_beat, self.heard_at = beat, self.clock()
        # What it does not do itself the graph does: publish, ask, cancel.
        handle = getattr(self, "_" + what, None) or getattr(self.graph, what, None)
        if handle is not None:
            handle(*parts)

    def _ready(self) -> None:
        self.say("follow", self.feeds)

    def _follow(self, wanted: Any) -> None:
        for name in wanted:
            if name not in self.followed or name not in self.graph.topics:
                told = self.graph.missing.get(name, "it is not in [ros.topics]")
                self.say("gone", name, "" if name in self.graph.topics else told)
        self.followed = wanted

    def heard(self, topic: str, read: Any) -> None:
        """Hand on what came by a topic, if it is wanted: read makes it plain.

        What comes too soon, or finds no room, waits for a beat; the newest is kept.
        """
        if topic not in self.followed:
            return
        now = self.clock()
        # What came while nothing was done here may be as old as that time is long.
        since = now - self.ticked
        age = self.gap + since if self.gap else since if since > 3 * BEAT else 0.0
        self.newest[topic] = now - age, read
        self._hand_on(topic, now)

    def _hand_on(self, topic: str, now: float) -> None:
        if now >= self.due.get(topic, 0.0):
            since, read = self.newest.pop(topic)
            try:
                is_said = self.say("reading", topic, now - since, read())
            except Exception as error:  # others can be read
                is_said = self.say("bad", f"{topic}: {error}")
            if is_said:
                end, pause = self.clock(), 0.9 / self.followed.get(topic, 1.0)
                self.due[topic] = max(now + pause, end + PAUSE * (end - now))
            else:
                self.newest[topic] = since, read

    def asked(self, name: str, message: Any, end: Any, progress: Any) -> int:
        """Ask the robot; how it ends is told with end(how, value)."""
        number = next(self.numbers)
        if len(self.served) >= ASKED:
            self.dropped += 1
            end("declined", "too much of ROS waits for the robot")
            return number
        self.served[number] = end, progress
        self.say("ask", number, name, message)
        return number

    def _answer(self, number: int, how: str, value: Any) -> None:
        if number in self.served:
            self.served.pop(number)[0](how, value)

    def _progress(self, number: int, value: Any) -> None:
        if number in self.served:
            self.served[number][1](value)

    def _pending(self, wanted: list[int]) -> None:
        for number in self.graph.asked.keys() ^ set(wanted):
            if number in self.graph.asked:
                self.graph.cancel(number)
            else:
                self.say("answer", number, "lost", "it is not known there")

    def give_up(self, number: int) -> None:
        """Ask for it no more."""
        if number in self.served:
            self.say("cancel", number)
            self._answer(number, "cancelled", "by who asked")


def plain(value: Any, roots: Any = ()) -> Any:
    """Return a message as plain data: dictionaries, lists, numbers, texts and bytes.

    With *roots* these fields alone, however much there is in the others.
    """
    if hasattr(value, "get_fields_and_field_types"):
        fields = roots or value.get_fields_and_field_types()
        return {name: plain(getattr(value, name)) for name in fields}
    if getattr(value, "typecode", "") == "B":
        return value.tobytes()
    if hasattr(value, "tolist"):  # of numpy, too
        return value.tolist()
    if isinstance(value, (list, tuple)):
        if value and all(isinstance(each, bytes) for each in value):
            return b"".join(value)
        return [plain(each) for each in value]
    return value


def found(kind: str) -> Any:
    """Return the class of a type such as ``std_msgs/msg/String``."""
    package, _, name = kind.replace("/", ".").rpartition(".")
    if "." not in package:
        package += ".msg"  # as types of fields are written
    return getattr(importlib.import_module(package), name)


def fill(message: Any, value: Any) -> Any:
    """Set the fields of a message from plain data."""
    kinds = message.get_fields_and_field_types()
    if not isinstance(value, dict):  # a lone value is the only field, or the outcome
        only = [each for each in kinds if each != "structure_needs_at_least_one_member"]
        if len(only) != 1 and "success" in kinds:
            only, value = ["success"], value is None or value
        if value is None:
            return message
        if len(only) != 1:
            raise ValueError("expected a value for each of " + ", ".join(only))
        value = {only[0]: value}
    for name, part in value.items():
        if name not in kinds:
            raise ValueError("{} is no field: {}".format(name, ", ".join(kinds)))
        now = getattr(message, name)
        if hasattr(now, "get_fields_and_field_types"):
            fill(now, part)
        elif isinstance(part, (list, tuple)) and "/" in kinds[name]:
            inner = kinds[name].rpartition("<")[2].partition(",")[0].rstrip(">")
            inner = inner.partition("[")[0]
            setattr(message, name, [fill(found(inner)(), each) for each in part])
        elif isinstance(now, float):
            setattr(message, name, float(part))
        elif isinstance(now, array.array):
            if not isinstance(part, bytes):
                part = map(float if now.typecode in "fd" else int, part)
            setattr(message, name, array.array(now.typecode, part))
        elif hasattr(now, "tolist"):
            now[:] = list(part)
        elif "octet" in kinds[name] and isinstance(now, (list, tuple)):
            part = [bytes([it]) if isinstance(it, int) else it for it in part]
            setattr(message, name, part)
        elif isinstance(now, (bytes, list, tuple)):
            setattr(message, name, part)
        else:
            setattr(message, name, type(now)(part))
    return message


class Graph:
    """The node, with its topics, services and actions."""

    def __init__(self, bridge: Any, node: Any, links: Any) -> None:
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.clock import Clock, ClockType

        self.bridge, self.node = bridge, node
        self.group = ReentrantCallbackGroup()  # who waits keeps nobody else waiting
        self.links = {link["name"]: link for link in links}
        self.topics: dict[str, Any] = {}
        self.told: set[tuple[str, str]] = set()
        self.looked: collections.Counter[tuple[str, str]] = collections.Counter()
        self.asked: dict[int, Any] = {}
        self.servers: dict[int, Any] = {}  # of the calls: name, whether it is there
        self.publishers: dict[str, Any] = {}
        self.clients: dict[str, Any] = {}
        self.served: list[Any] = []
        self.missing: dict[str, str] = {}
        for link in links:
            try:
                link["class"] = found(link["type"])
                getattr(self, "_{kind}_{flow}".format(**link))(link["name"], link)
            except Exception as error:  # no package of its type: others are there
                why = self.missing[link["name"]] = f"{link['type']}: {error}"
                node.get_logger().error(why)
        # The node's own clock stands still when the time of day is set back, or simulated.
        told = {"clock": Clock(clock_type=ClockType.STEADY_TIME)}
        node.create_timer(BEAT, bridge.tick, self.group, **told)
        node.create_timer(1.0, self._miss, self.group, **told)

    def _qos(self, link: dict[str, Any]) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        if link["latched"]:
            return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        if link["flow"] == "in":
            return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        return QoSProfile(depth=10)

    def _topic_in(self, name: str, link: dict[str, Any]) -> None:
        from rclpy.serialization import deserialize_message

        def read(data: bytes) -> Any:
            if len(data) > MESSAGE:  # to look into it would take too long
                raise ValueError("it is larger than 1 MiB")
            return plain(deserialize_message(data, link["class"]), link["roots"])

        self.topics[name] = self.node.create_subscription(
            *(link["class"], name),
            lambda data: self.bridge.heard(name, lambda: read(data)),
            self._qos(link),
            callback_group=self.group,
            raw=True,
        )

    def _topic_out(self, name: str, link: dict[str, Any]) -> None:
        about = link["class"], name, self._qos(link)
        self.publishers[name] = self.node.create_publisher(*about)

    def _service_out(self, name: str, link: dict[str, Any]) -> None:
        self.clients[name] = self.node.create_client(
            link["class"], name, callback_group=self.group
        )

    def _action_out(self, name: str, link: dict[str, Any]) -> None:
        from rclpy.action import ActionClient

        self.clients[name] = ActionClient(
            self.node, link["class"], name, callback_group=self.group
        )

    def _service_in(self, name: str, link: dict[str, Any]) -> None:
        from rclpy.task import Future

        async def serve(request: Any, response: Any) -> Any:
            future = Future()
            about = name, plain(request), lambda *end: future.set_result(end)
            self.bridge.asked(*about, lambda _: None)
            return self._filled(name, response, *await future)[0]

        self.node.create_service(link["class"], name, serve, callback_group=self.group)

    def _filled(self, name: str, response: Any, *end: Any) -> tuple[Any, bool]:
        """Return a response, and whether it is an answer that fits."""
        how, value = end
        if how == "answered":
            try:
                return fill(response, value), True
            except Exception as error:  # one that does not fit ends this call alone
                how, value, response = "failed", error, type(response)()
        if how != "cancelled":
            self.node.get_logger().warning(f"{name}: {how}: {value}")
        for name, part in (("success", False), ("message", str(value))):
            if hasattr(response, name):
                setattr(response, name, part)
        return response, False

    def _action_in(self, name: str, link: dict[str, Any]) -> None:
        from rclpy.action import ActionServer, CancelResponse
        from rclpy.task import Future

        kind, numbers = link["class"], {}

        async def execute(goal: Any) -> Any:
            future = Future()

            def progress(value: Any) -> None:
                goal.publish_feedback(fill(kind.Feedback(), value))

            about = name, plain(goal.request), lambda *end: future.set_result(end)
            number = self.bridge.asked(*about, progress)
            numbers[bytes(goal.goal_id.uuid)] = number
            if goal.is_cancel_requested:
                self.bridge.give_up(number)
            result, is_done = self._filled(name, kind.Result(), *await future)
            del numbers[bytes(goal.goal_id.uuid)]
            if is_done:
                goal.succeed()
            elif goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
            return result

        def cancel(goal: Any) -> Any:
            self.bridge.give_up(numbers.get(bytes(goal.goal_id.uuid)))
            return CancelResponse.ACCEPT

        server = ActionServer(
            *(self.node, kind, name, execute),
            cancel_callback=cancel,
            callback_group=self.group,
        )
        self.served.append(server)

    def _class(self, name: str) -> Any:
        if name in self.missing:
            raise ValueError(self.missing[name])
        return self.links[name]["class"]

    def publish(self, topic: str, age: float, message: Any) -> None:
        """Publish plain data; a header without a time gets that of the reading."""
        made = fill(self._class(topic)(), message)
        from rclpy.time import Time

        now = self.node.get_clock().now().nanoseconds  # 0 where time is simulated
        at = Time(nanoseconds=max(0, now - round(age * 1e9))).to_msg()
        if hasattr(made, "angle_max") and made.angle_max == 0.0:  # a scan
            steps = max(0, len(made.ranges) - 1)  # to the last beam: SLAM counts them
            made.angle_max = made.angle_min + made.angle_increment * steps
            made.range_min = made.range_min or 0.001  # 0.0 is not measured
            made.range_max = made.range_max or float("inf")
        for each in (made, *getattr(made, "transforms", ())):
            header = getattr(each, "header", None)
            if header is not None and header.stamp == type(header.stamp)():
                header.stamp = at
        self.publishers[topic].publish(made)

    def ask(self, number: int, name: str, message: Any) -> None:
        """Call a service, or send a goal."""
        say, kind, client = self.bridge.say, self._class(name), self.clients[name]
        is_action = self.links[name]["kind"] == "action"
        is_there = client.server_is_ready if is_action else client.service_is_ready
        if not is_there():
            say("answer", number, "declined", f"nobody serves {name} in ROS")
            return
        self.servers[number] = name, is_there
        if not is_action:
            future = client.call_async(fill(kind.Request(), message))
            self.asked[number] = lambda: client.remove_pending_request(future)

            def answered(future: Any) -> None:
                self.asked.pop(number, None)
                say("answer", number, "answered", plain(future.result()))

            future.add_done_callback(answered)
            return

        def feedback(told: Any) -> None:
            say("progress", number, plain(told.feedback))

        def accepted(future: Any) -> None:
            goal = future.result()
            if not goal.accepted:
                self.asked.pop(number, None)
                say("answer", number, "declined", name + " has rejected it")
                return
            if self.asked.get(number) is None:  # it was cancelled meanwhile
                goal.cancel_goal_async()
            self.asked[number] = goal.cancel_goal_async
            goal.get_result_async().add_done_callback(ended)

        def ended(future: Any) -> None:
            self.asked.pop(number, None)
            status, result = future.result().status, plain(future.result().result)
            how = "answered" if status == 4 else "failed"  # STATUS_SUCCEEDED
            told = {5: "it was cancelled in ROS", 6: f"{name} has aborted it: {result}"}
            say("answer", number, how, told.get(status, result))

        self.asked[number] = lambda: None
        sent = client.send_goal_async(fill(kind.Goal(), message), feedback)
        sent.add_done_callback(accepted)

    def _miss(self) -> None:
        """End the calls whose server has gone: ROS says nothing of them any more."""
        self.servers = {n: each for n, each in self.servers.items() if n in self.asked}
        for number, (name, is_there) in self.servers.items():
            if not is_there():
                self.cancel(number)
                told = f"nobody serves {name} in ROS any more"
                self.bridge.say("answer", number, "lost", told)

    def cancel(self, number: int) -> None:
        """Let nobody work on it any more."""
        if number in self.asked:
            self.asked.pop(number)()

    def strangers(self) -> Iterator[tuple[str, str, str, str]]:
        """Yield what has the name of one of ours and another type, once each."""
        from rclpy.action import get_action_names_and_types as actions

        node, there = self.node, {}
        me = node.get_name(), node.get_namespace()
        is_double = node.get_node_names_and_namespaces().count(me) > 1
        self.looked[me] = self.looked[me] + 1 if is_double else 0
        if self.looked[me] == GHOST:
            node.get_logger().warning("another node has this name: end one of them")
        there["topic"] = dict(node.get_topic_names_and_types())
        there["service"] = dict(node.get_service_names_and_types())
        there["action"] = dict(actions(node))
        for name, link in self.links.items():
            whole = node.resolve_topic_name(name)
            for other in there[link["kind"]].get(whole, ()):
                if other != link["type"] and (name, other) not in self.told:
                    ends = []
                    if link["kind"] == "topic":
                        ends += node.get_publishers_info_by_topic(whole)
                        ends += node.get_subscriptions_info_by_topic(whole)
                    who = {end.node_name for end in ends if end.topic_type == other}
                    self.looked[name, other] += 1
                    if UNKNOWN in who and self.looked[name, other] < 4:
                        continue  # the name of a node comes later
                    self.told.add((name, other))
                    yield name, link["type"], other, ", ".join(sorted(who))


def graph_of(node: Any) -> dict[str, list[Any]]:
    """Return what other nodes have: name, type and who gives or takes it."""
    from rclpy.action import get_action_names_and_types as actions

    found: dict[str, list[Any]] = {"topics": [], "services": [], "actions": []}
    for name, kinds in node.get_topic_names_and_types():
        ends = [
            [each.node_name for each in get(name) if each.node_name != node.get_name()]
            for get in (
                node.get_publishers_info_by_topic,
                node.get_subscriptions_info_by_topic,
            )
        ]
        found["topics"].append([name, kinds, *ends])
    for kind, all_of in (
        ("services", node.get_service_names_and_types()),
        ("actions", actions(node)),
    ):
        found[kind] += [[name, kinds, [], []] for name, kinds in all_of]
    return found


def end(why: str) -> None:
    """Say why, and end: a lost peer, that begins anew."""
    os.write(2, why.encode() + b"\n")
    os._exit(1)


def main() -> None:
    """Speak for the robot until that ends."""
    robot = socket.socket(fileno=os.dup(0))
    stream = robot.makefile("rb")

    def take() -> Any:
        size = stream.read(4)
        if len(size) < 4:
            os._exit(0)  # the robot is gone
        return unpack(stream.read(struct.unpack(">I", size)[0]))

    setup = take()

    os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # 300 in an uint8 would be sent as 44
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(
        domain_id=setup["domain"], signal_handler_options=SignalHandlerOptions.NO
    )
    node = rclpy.create_node(setup["node"], namespace=setup["namespace"])
    if "find" in setup:
        time.sleep(setup["find"])
        robot.sendall(pack(["found", graph_of(node)]))
        os._exit(0)
    executor = SingleThreadedExecutor()
    bridge = Bridge(Outbox(robot.sendall, end).send)
    bridge.begin(Graph(bridge, node, setup["links"]), setup["feeds"])
    executor.add_node(node)

    room = threading.Semaphore(WAITING)  # then the robot's end of the socket is full
    told: set[str] = set()

    def hear() -> None:
        while True:
            room.acquire()
            executor.create_task(took, take())

    def took(frame: list[Any]) -> None:
        room.release()
        try:
            bridge.took(frame)
        except Exception as error:  # what does not fit a type of ROS harms nobody else
            name = frame[6] if frame[0] == "publish" else frame[0]
            if (line := f"{name}: {error}") not in told and len(told) < MOST:
                told.add(line)
                node.get_logger().error(line)
            if frame[0] == "ask":
                bridge.say("answer", frame[6], "declined", str(error))

    threading.Thread(target=hear, daemon=True).start()
    executor.spin()


if __name__ == "__main__":
    try:
        main()
    except Exception as error:
        end(f"{type(error).__name__}: {error}")
