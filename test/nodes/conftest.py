"""Each test has its own ROS graph: own context, random domain, own namespace, this machine only."""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

TIMEOUT = 30.0  # [s]
_DOMAINS = 25  # of a worker; there are 101 on every system


def random_domain() -> int:
    """An ROS domain that no other worker of this run of the tests takes."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return 1 + _DOMAINS * (worker % 4) + random.SystemRandom().randrange(_DOMAINS)


class Graph:
    """A small ROS graph inside one process, spun by the test."""

    def __init__(self) -> None:
        self.domain = random_domain()
        self.namespace = f"/t{random.SystemRandom().getrandbits(40):x}"
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=self.domain)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.nodes: list[Node] = []
        self._subscriptions: dict[tuple[type, str], Any] = {}
        self.tester = self.add(Node, "tester")

    def add(self, node_class: Callable[..., Node], name: str | None = None, **values: Any) -> Any:
        """Start a node with parameter values (``__`` in a name stands for a dot)."""
        overrides = [Parameter(k.replace("__", "."), value=v) for k, v in values.items()]
        names = () if name is None else (name,)
        node = node_class(
            *names,
            context=self.context,
            namespace=self.namespace,
            parameter_overrides=overrides,
        )
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def environment(self) -> dict[str, str]:
        """Of a process that imports this package and is in the domain of the graph."""
        root, given = str(Path(__file__).resolve().parents[2]), os.environ.get("PYTHONPATH")
        path = os.pathsep.join(filter(None, (root, given)))
        return {**os.environ, "ROS_DOMAIN_ID": str(self.domain), "PYTHONPATH": path}

    def publisher(self, message_type: type, topic: str, depth: int = 10) -> Any:
        """A reliable publisher of the tester."""
        return self.tester.create_publisher(message_type, topic, QoSProfile(depth=depth))

    def collect(self, message_type: type, topic: str, profile: QoSProfile | int = 50) -> list[Any]:
        """Subscribe and return the list into which messages come."""
        received: list[Any] = []
        key = message_type, topic
        self._subscriptions[key] = self.tester.create_subscription(*key, received.append, profile)
        return received

    def forget(self, message_type: type, topic: str) -> None:
        """End the last subscription to a topic."""
        self.tester.destroy_subscription(self._subscriptions.pop((message_type, topic)))

    def remove(self, node: Node) -> None:
        """End a node, as at the end of its process."""
        self.executor.remove_node(node)
        self.nodes.remove(node)
        node.destroy_node()

    def spin_until(self, condition: Callable[[], Any], what: str, timeout: float = TIMEOUT) -> None:
        """Serve callbacks until a condition holds; fails the test when it never does."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                pytest.fail(f"waited {timeout} s in vain: {what}")
            self.executor.spin_once(timeout_sec=0.05)

    def connect(self, *publishers: Any, subscribers: int = 1) -> None:
        """Wait until every publisher has found its subscribers."""
        self.spin_until(
            lambda: all(p.get_subscription_count() >= subscribers for p in publishers),
            "subscribers",
        )

    def close(self) -> None:
        """Take the graph down."""
        for node in self.nodes:
            self.executor.remove_node(node)
            node.destroy_node()
        self.executor.shutdown()
        self.context.try_shutdown()


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Iterator[Graph]:
    """A ROS graph of this test alone."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", os.environ.get("ROS_LOG_DIR", "/tmp/infomap_ros_test_log"))
    graph = Graph()
    yield graph
    graph.close()
