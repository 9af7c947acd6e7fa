"""Timers at 100 Hz in one node of ROS 2, run by a Python that has rclpy.

``python benchmarks/ros2_timers.py EXECUTOR TIMERS SECONDS`` prints the CPU of a step in
seconds, and which part of the steps that were due was made.
"""

from __future__ import annotations

import os
import sys
import threading
import time

import rclpy

PERIOD = 0.01


def main() -> None:
    name, timers, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    if name == "EventsExecutor":
        from rclpy.experimental import EventsExecutor as Executor
    else:
        from rclpy.executors import SingleThreadedExecutor as Executor
    rclpy.init()
    node = rclpy.create_node("bench", enable_rosout=False)
    executor = Executor()
    steps = 0

    def step() -> None:
        nonlocal steps
        steps += 1

    kept = [node.create_timer(PERIOD, step) for _ in range(timers)]
    executor.add_node(node)

    def watch() -> None:
        time.sleep(1.0)
        before, cpu, began = steps, time.process_time(), time.monotonic()
        time.sleep(seconds)
        made = steps - before
        cpu, wall = time.process_time() - cpu, time.monotonic() - began
        print(cpu / max(1, made), made / (len(kept) * wall / PERIOD), flush=True)
        os._exit(0)  # some executors do not end

    threading.Thread(target=watch).start()
    executor.spin()


main()
