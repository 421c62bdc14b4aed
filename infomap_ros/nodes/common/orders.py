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

    def answer(_: Trigger.Request, response: Trigger.Response) -> None:
        try:
            response.success, response.message = True, order()
        except InfomapError as error:
            response.success, response.message = False, str(error)
            raise

    offer_service(node, Trigger, name, worker, answer)


def offer_service(
    node: Node,
    service_type: type,
    name: str,
    worker: Worker,
    answer: Callable[[Any, Any], object],
) -> None:
    """Offer a service whose requests the worker answers.

    Args:
        node: that offers it.
        service_type: ROS service class.
        name: of the service.
        worker: whose thread works; requests never give way to other jobs.
        answer: given request and response, which it fills; an error of the library goes into the
            log, and the response out as it is by then.
    """
    log = node.get_logger()

    async def serve(request: Any, response: Any) -> Any:
        done: Future = Future(executor=node.executor)

        def work() -> None:
            try:
                answer(request, response)
            except InfomapError as error:
                log.warning(f"{name}: {error}", throttle_duration_sec=5.0)
            done.set_result(None)
            node.executor.wake()

        worker.submit_always(work)
        await done
        return response

    # A callback that waits would keep all others of its group from being called.
    node.create_service(service_type, name, serve, callback_group=ReentrantCallbackGroup())
