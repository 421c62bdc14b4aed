"""The node next_best_view as the exploration sees it: asked by service, waited for.

The topic route_status: next_best_view states there whether the planned route is still free.

The explorer stops the robot when it is not. The status names the route by its digest, so that one
about an earlier route stops nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.client import Client
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from infomap_ros.errors import ExplorationError, TeammatesBusyError
from infomap_ros.exploration.mission import HOME, LAST_LOOK
from infomap_ros.exploration.records.choice_text import choice_from_text, route_digest
from infomap_ros.exploration.robot import Choice, FailedView, KnownPlace, RobotState
from infomap_ros.exploration.team.team_planner import WAITING
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
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


_PLANNER = "next_best_view"  # name of the node that chooses the views
_RETRY = 0.25  # [s] between two looks at a planner that is not there, answers not or has no plan


@dataclass(frozen=True)
class RemotePlannerConfig:
    """How long the explorer bears with next_best_view.

    Raises:
        ConfigError: a value is out of its range.
    """

    planner_timeout: float = setting(
        120.0,
        "When next_best_view has given no plan for so long, nor said that it works on one, the "
        "exploration has failed. It may be restarted meanwhile.",
        unit="s",
        low=1.0,
        high=3600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


class RemotePlanner:
    """Implements `infomap_ros.exploration.robot.Planner`; called by one thread that may block.

    Args:
        node: whose executor serves the answers in another thread.
        report_failure: reports to next_best_view a view that brought nothing.
        stopped: whether an answer is not waited for any more.
    """

    def __init__(
        self,
        node: MonitoredNode,
        report_failure: Callable[[FailedView], None],
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._node, self._config = node, node.config(RemotePlannerConfig)
        self._log, self._report, self._stopped = node.get_logger(), report_failure, stopped
        self._plan = node.create_client(Trigger, f"{_PLANNER}/plan")
        self._routes = {
            HOME.name: node.create_client(Trigger, f"{_PLANNER}/plan_home"),
            LAST_LOOK.name: node.create_client(Trigger, f"{_PLANNER}/plan_back"),
        }
        self._arm = node.create_client(Trigger, f"{_PLANNER}/plan_arm")
        self._route_status = RouteStatusListener(node)
        self._plan_search = node.create_client(Trigger, f"{_PLANNER}/plan_search")
        self._last_sign = -float("inf")  # last sign that it works on a plan
        node.listen(Empty, f"{_PLANNER}/{WORKING}", self._on_working, qos.stream(), required=False)

    def _on_working(self, _: Empty) -> None:
        self._last_sign = time.monotonic()

    def _is_late(self, begin: float) -> bool:
        """Whether what was asked at a time [s] has been waited for too long."""
        since = max(begin, self._last_sign)
        return time.monotonic() > since + self._config.planner_timeout

    @property
    def is_there(self) -> bool:
        """Whether somebody offers plans."""
        return bool(self._plan.service_is_ready())

    def choose(self, state: RobotState) -> Choice:
        """Ask for the next best view; next_best_view knows the state from its own topics.

        Raises:
            TeammatesBusyError: it has to wait for teammates.
            ExplorationError: there is no plan for too long, or it cannot be read.
        """
        return self._begin(self._ask(self._plan))

    def route_to(self, state: RobotState, place: KnownPlace) -> Choice:
        """Ask for the route to a place that next_best_view knows from exploration_status.

        Raises:
            ExplorationError: there is no plan for too long, or it cannot be read.
        """
        return self._begin(self._ask(self._routes[place.name]))

    def plan_arm(self, state: RobotState, T_map_camera: FloatArray) -> Choice:
        """Ask for the arm's motion to the view that next_best_view planned last.

        Raises:
            ExplorationError: there is no plan for too long, or it cannot be read.
        """
        return self._begin(self._ask(self._arm))

    def route_problem(self, state: RobotState) -> str:
        """What next_best_view states on route_status of the route that it planned last."""
        return self._route_status.problem

    def look_for_target(self) -> Choice:
        """Ask where to look for the target, in the frame of odometry.

        Raises:
            ExplorationError: there is no plan for too long, or it cannot be read.
        """
        return self._ask(self._plan_search)

    def failed(self, view: FailedView) -> None:
        """Report to next_best_view that a view brought nothing."""
        self._report(view)

    def _begin(self, choice: Choice) -> Choice:
        """Take what route_status says from now on for this choice's route."""
        self._route_status.begin(choice.route)
        return choice

    def _ask(self, client: Client) -> Choice:
        begin, problem = time.monotonic(), "nobody offers it"
        while not (self._is_late(begin) or self._stopped()):
            if client.wait_for_service(timeout_sec=_RETRY):
                answer = self._call(client, begin)
                if answer is not None and answer.success:
                    return choice_from_text(answer.message)
                problem = "it does not answer" if answer is None else answer.message
                if problem.startswith(WAITING):
                    raise TeammatesBusyError(problem)
                self._log.info(f"no plan yet: {problem}", throttle_duration_sec=5.0)
                time.sleep(_RETRY)
        raise ExplorationError(f"no plan from {client.srv_name}: {problem}")

    def _call(self, client: Client, begin: float) -> Trigger.Response | None:
        """One call; None where the node went away meanwhile or did not answer in time.

        A node that was killed counts as there for some time, and what it was asked is lost. When
        it is started again, one more offers the service than when it was asked.
        """
        answered, servers = threading.Event(), self._servers(client)
        future = client.call_async(Trigger.Request())
        future.add_done_callback(lambda _: answered.set())
        while not answered.wait(_RETRY):
            restarted = self._servers(client) > servers
            given_up = self._stopped() or self._is_late(begin)
            if restarted or given_up or not client.service_is_ready():
                client.remove_pending_request(future)
                return None
        return future.result()

    def _servers(self, client: Client) -> int:
        """How many offer the service."""
        return int(self._node.count_services(client.srv_name))
