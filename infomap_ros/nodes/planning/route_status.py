"""The topic route_status: next_best_view states there whether the planned route is still free.

The explorer stops the robot when it is not. The status names the route by its digest, so that one
about an earlier route stops nothing.
"""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from infomap_ros.exploration.records.choice_text import route_digest
from infomap_ros.motion.route import Route
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode

WORKING = "working"
"""Topic below the name of next_best_view on which it says, each second, that it works on a plan."""
ROUTE_STATUS = "route_status"
_FREE = "free"


class RouteStatusPublisher:
    """Publishes each change: OK with a new route, ERROR with the reason where it is blocked.

    Args:
        node: next_best_view.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._publisher = node.advertise(DiagnosticStatus, ROUTE_STATUS, qos.latched())
        self._digest, self._problem, self._log = "", "", node.get_logger()

    def begin(self, route: Route) -> None:
        """A new route was planned; it is free."""
        self._digest, self._problem = route_digest(route), ""
        self._publish()

    def report(self, problem: str) -> None:
        """Why what is left of the route is blocked; empty where it is free."""
        if problem == self._problem:
            return
        self._problem = problem
        self._log.info(f"route: {problem or _FREE}")
        self._publish()

    def _publish(self) -> None:
        self._publisher.publish(
            DiagnosticStatus(
                level=DiagnosticStatus.ERROR if self._problem else DiagnosticStatus.OK,
                name="route",
                message=self._problem or _FREE,
                values=[KeyValue(key="route", value=self._digest)],
            )
        )


class RouteStatusListener:
    """What next_best_view states of the route that is being carried out.

    Args:
        node: the explorer.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._digest = ""
        self._problems: dict[str, str] = {}
        node.listen(DiagnosticStatus, ROUTE_STATUS, self._receive, qos.latched(), required=False)

    def begin(self, route: Route | None) -> None:
        """The robot is about to be moved along a route."""
        self._digest = "" if route is None else route_digest(route)

    @property
    def problem(self) -> str:
        """Why the route that is carried out is blocked; empty where it is free."""
        return self._problems.get(self._digest, "")

    def _receive(self, message: DiagnosticStatus) -> None:
        digest = next((pair.value for pair in message.values if pair.key == "route"), "")
        problem = message.message if message.level == DiagnosticStatus.ERROR else ""
        self._problems = {digest: problem}
