"""The services that steer an exploration, called from another thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from infomap_ros.errors import ExplorationError

_FINDING = 2.0  # for which a service is looked for: it may just have come up [s]
_TIMEOUT = 30.0  # for which an answer is waited for: a busy explorer answers late [s]
_ORDERS = ("start", "pause", "resume", "home", "stop")


def exploration_orders(node: Node, explorer: str) -> dict[str, Callable[[], str]]:
    """What the services of an explorer do, by the labels of buttons.

    Args:
        node: whose executor runs in another thread than the orders are given in.
        explorer: name of the node that offers them.
    """
    clients = {name: node.create_client(Trigger, f"{explorer}/{name}") for name in _ORDERS}
    return {name.capitalize(): partial(_call, client) for name, client in clients.items()}


def _call(client: Client) -> str:
    """Call a service and wait for its answer.

    Raises:
        ExplorationError: nobody offers it or answers, or the answer is a refusal.
    """
    name = client.srv_name
    if not client.wait_for_service(_FINDING):
        raise ExplorationError(f"nobody offers the service {name}")
    done = threading.Event()
    answer: Future = client.call_async(Trigger.Request())
    answer.add_done_callback(lambda _: done.set())
    if not done.wait(_TIMEOUT):
        raise ExplorationError(f"{name} does not answer")
    response = answer.result()
    if not response.success:
        raise ExplorationError(response.message)
    return str(response.message)
