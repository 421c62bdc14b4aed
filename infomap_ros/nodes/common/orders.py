"""Services whose work is done by a node's worker thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from infomap_ros.errors import InfomapError
from infomap_ros.nodes.common.worker import Worker


def offer_order(node: Node, name: str, worker: Worker, order: Callable[[], str]) -> None:
    """Offer a Trigger service that has the worker carry out an order, and answers then.

    Args:
        node: that offers it.
        name: of the service.
        worker: whose thread works; orders never give way to other jobs.
        order: what to do; returns the answer, or raises an error of the library, which becomes
            the answer of a call without success.
    """
    log = node.get_logger()

    async def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        done: Future = Future(executor=node.executor)

        def work() -> None:
            try:
                done.set_result((True, order()))
            except InfomapError as error:
                done.set_result((False, str(error)))
                log.warning(f"{name}: {error}", throttle_duration_sec=5.0)
            node.executor.wake()

        worker.submit_always(work)
        answer: tuple[bool, Any] = await done
        response.success, response.message = answer
        return response

    # A callback that waits would keep all others of its group from being called.
    node.create_service(Trigger, name, serve, callback_group=ReentrantCallbackGroup())
