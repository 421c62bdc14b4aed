"""What a message costs a node of many topics, by each of rclpy's executors of one thread.

A node with as many subscriptions, timers and services as `next_best_view` receives a thousand joint
states. Prints processor time per message of each, and their ratio (docs/results/speed.md).

    python benchmarks/executors.py
"""

from __future__ import annotations

import os
import random
import threading
import time

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

MESSAGES, TOPICS, TIMERS, SERVICES = 1000, 14, 6, 4
PAUSE = 0.003  # [s] from one message to the next


def cost(executor: Executor, name: str) -> float:
    """Processor time per message, sending included [s]."""
    node = rclpy.create_node(name)
    received: list[JointState] = []
    for topic in range(TOPICS):
        node.create_subscription(JointState, f"{name}/t{topic}", received.append, 10)
    for _ in range(TIMERS):
        node.create_timer(1.0, lambda: None)
    for service in range(SERVICES):
        node.create_service(Trigger, f"{name}/s{service}", lambda _, response: response)
    executor.add_node(node)
    publishers = [node.create_publisher(JointState, f"{name}/t{topic}", 10) for topic in (0, 1)]
    begun: list[float] = []

    def send() -> None:
        while not all(publisher.get_subscription_count() for publisher in publishers):
            time.sleep(PAUSE)
        begun.append(time.process_time())
        for number in range(MESSAGES):
            publishers[number % 2].publish(JointState(name=["joint"] * 8, position=[0.0] * 8))
            time.sleep(PAUSE)

    sender = threading.Thread(target=send, daemon=True)
    sender.start()
    while sender.is_alive():
        executor.spin_once(timeout_sec=0.1)
    return (time.process_time() - begun[0]) / max(len(received), 1)


def main() -> None:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    rclpy.init(domain_id=random.SystemRandom().randint(1, 100))
    usual, quick = cost(SingleThreadedExecutor(), "usual"), cost(EventsExecutor(), "quick")
    for cost_of, executor in ((usual, "SingleThreadedExecutor"), (quick, "EventsExecutor")):
        print(f"{1e6 * cost_of:.0f} us a message by {executor}")
    print(f"ratio {usual / quick:.1f}")
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
