"""A node of ROS, for its own interpreter: what the robot's tests hear of the real thing.

It reads commands as lines of JSON, and prints what it hears as lines of JSON:
``publish TOPIC TYPE FIELDS RATE``, ``hear TOPIC TYPE``, ``call``, ``goal``, ``cancel``,
``serve``, ``serve_action``, ``names``, ``simulate NODE``: its time, by a clock that stands still.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
import threading
import time

import rclpy
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor

spec = importlib.util.spec_from_file_location("child", sys.argv[1])
assert spec is not None
child = importlib.util.module_from_spec(spec)
assert spec.loader is not None
spec.loader.exec_module(child)


def tell(*told):
    line = json.dumps(told, default=child._blob)
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


class Judge:
    def __init__(self, node):
        self.node = node
        self.group = ReentrantCallbackGroup()
        self.goal_handle = None
        self.kept = []

    def publish(self, topic, kind, fields, rate):
        publisher = self.node.create_publisher(child.found(kind), topic, 10)
        message = child.fill(child.found(kind)(), fields)

        def send():
            publisher.publish(message)
            if rate <= 200.0:  # who floods would flood its reader, too
                tell("sent", topic, time.monotonic())

        self.kept.append(self.node.create_timer(1.0 / rate, send))

    def hear(self, topic, kind):
        self.node.create_subscription(
            child.found(kind),
            topic,
            lambda message: tell("heard", topic, child.plain(message)),
            10,
        )

    def serve(self, name, kind):
        def answer(request, response):
            return child.fill(response, {"success": request.data, "message": "far"})

        self.node.create_service(child.found(kind), name, answer)

    def serve_action(self, name, kind):
        action = child.found(kind)

        async def execute(goal):
            goal.publish_feedback(child.fill(action.Feedback(), {"sequence": [0]}))
            future = rclpy.task.Future()

            def look():
                if goal.is_cancel_requested or goal.request.order < 50:
                    timer.cancel()
                    future.set_result(None)

            timer = self.node.create_timer(0.05, look, callback_group=self.group)
            await future
            if goal.request.order == 13:
                goal.abort()
                return child.fill(action.Result(), {"sequence": [13]})
            if goal.is_cancel_requested:
                tell("cancelled", name)
                goal.canceled()
                return action.Result()
            goal.succeed()
            return child.fill(action.Result(), {"sequence": [0, 1, 1]})

        self.kept.append(
            ActionServer(
                self.node,
                action,
                name,
                execute,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
                callback_group=self.group,
            )
        )

    def call(self, name, kind, fields):
        service = child.found(kind)
        client = self.node.create_client(service, name, callback_group=self.group)
        client.wait_for_service(10.0)
        future = client.call_async(child.fill(service.Request(), fields))
        future.add_done_callback(
            lambda f: tell("answer", name, child.plain(f.result()))
        )

    def goal(self, name, kind, fields):
        action = child.found(kind)
        client = ActionClient(self.node, action, name, callback_group=self.group)
        self.kept.append(client)
        client.wait_for_server(10.0)

        def accepted(future):
            self.goal_handle = future.result()
            tell("accepted", name)
            self.goal_handle.get_result_async().add_done_callback(
                lambda f: tell(
                    "result", name, f.result().status, child.plain(f.result().result)
                )
            )

        sent = client.send_goal_async(
            child.fill(action.Goal(), fields),
            lambda told: tell("feedback", name, child.plain(told.feedback)),
        )
        sent.add_done_callback(accepted)

    def cancel(self):
        self.goal_handle.cancel_goal_async()

    def simulate(self, node):
        name = "/" + node + "/set_parameters"
        client = self.node.create_client(SetParameters, name, callback_group=self.group)
        client.wait_for_service(10.0)
        value = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
        told = SetParameters.Request(
            parameters=[Parameter(name="use_sim_time", value=value)]
        )
        future = client.call_async(told)
        future.add_done_callback(lambda _: tell("simulated", node))

    def names(self):
        tell("names", sorted(self.node.get_node_names()))


rclpy.init()
executor = SingleThreadedExecutor()
judge = Judge(rclpy.create_node("judge"))
executor.add_node(judge.node)


def hear():
    for line in sys.stdin:
        verb, *words = json.loads(line, object_hook=child._unblob)
        executor.create_task(getattr(judge, verb), *words)
    os._exit(0)


threading.Thread(target=hear, daemon=True).start()
tell("ready")
executor.spin()
