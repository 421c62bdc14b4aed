"""Services whose work is done by a node's worker thread."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from std_srvs.srv import Trigger

from infomap_ros.errors import InfomapError
from infomap_ros.nodes.common.worker import Worker


def offer_order(node: Node, name: str, worker: Worker, order: Callable[[], str]) -> None:
    """Offer a Trigger service that has the worker carry out an order, and answers then.

    Args:
        node: that offers it.
        name: of the service.
        worker: whose thread works; orders never are dropped for other jobs.
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
    node: Node, service_type: type, name: str, worker: Worker, answer: Callable[[Any, Any], object]
) -> None:
    """Offer a service whose requests the worker answers.

    Args:
        node: that offers it.
        service_type: ROS service class.
        name: of the service.
        worker: whose thread works; requests never are dropped for other jobs.
        answer: given request and response, which it fills; an error of the library goes into the
            log, and the response out as it is by then.
    """
    log, requests = node.get_logger(), dict[int, Any]()

    def take(request: Any, response: Any) -> Any:
        requests[id(response)] = request
        return response

    def send_when_answered(response: Any, header: Any) -> None:
        request = requests.pop(id(response))

        def work() -> None:
            try:
                answer(request, response)
            except InfomapError as error:
                log.warning(f"{name}: {error}", throttle_duration_sec=5.0)
            with suppress(InvalidHandle):  # the node has ended meanwhile
                send(response, header)

        worker.submit_always(work)

    # A callback must not wait, and not every executor takes one that is a coroutine.
    service = node.create_service(service_type, name, take)
    send, service.send_response = service.send_response, send_when_answered
