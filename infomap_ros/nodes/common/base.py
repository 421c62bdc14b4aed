"""What all nodes share: configuration, guarded inputs, diagnostics.

Errors of the library are translated here, once: the data are dropped, the drop is counted with its
reason, and a throttled warning says what was wrong. Any other exception is a defect and ends the
process, unless a message of another robot caused it: that is one dropped message.

Each is a lifecycle node, active from its start unless ``start_active`` is false. An inactive one
neither uses nor publishes data; what is to be checked and compiled, it has done by then.
"""

from __future__ import annotations

import traceback
import weakref
from collections import deque
from collections.abc import Callable
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSLivelinessChangedInfo,
    QoSPublisherMatchedInfo,
    SubscriptionEventCallbacks,
)
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from infomap_ros.errors import (
    CalibrationError,
    CapacityError,
    ConfigError,
    FrameError,
    InfomapError,
    InvalidInputError,
    MalformedMessageError,
    MapFileError,
    PoseUnavailableError,
    RobotModelError,
    SensorFaultError,
    UpdateRefusedError,
)
from infomap_ros.geometry.config import all_parameters
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.health import Health, as_line
from infomap_ros.nodes.common.interrupts import part_soon, release_when_leaving
from infomap_ros.nodes.common.lockstep import LockstepConfig, LockstepReporter
from infomap_ros.nodes.common.memory import heap_in_use
from infomap_ros.nodes.common.parameters import changed_config, declare_config
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.team.team_radio import TeamRadioConfig, loses

Config = TypeVar("Config")

DIAGNOSTICS_PERIOD = 1.0  # [s]
_REASONS: dict[type[InfomapError], str] = {
    MalformedMessageError: "malformed message",
    CalibrationError: "calibration",
    FrameError: "wrong frame",
    PoseUnavailableError: "no pose at the stamp",
    CapacityError: "out of capacity",
    InvalidInputError: "invalid data",
    RobotModelError: "robot description",
    MapFileError: "map file",
}
_MOST_KEPT = 1000  # latched messages that come while a node is inactive
_OF_ONE_SOURCE = {
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/msg/CameraInfo",
    "nav_msgs/msg/Odometry",
}


class MonitoredNode(LifecycleNode):
    """A node whose inputs are guarded and whose condition is published on /diagnostics.

    Args:
        name: default node name.
        node_arguments: passed on to `rclpy.node.Node`, for example context.

    Attributes:
        CONFIGS: configuration classes of the node with the prefix of their parameters.
        SETTABLE: file-name patterns of the parameters that may be set while it runs.
        lockstep: counts messages, where a simulator's time waits for them.
        is_active: whether data are used and published.
        begins: called when the node has become active again.
        ends: called before it becomes inactive.

    Raises:
        ConfigError: a parameter has an impossible value.
    """

    CONFIGS: ClassVar[tuple[tuple[type, str], ...]] = ()
    SETTABLE: ClassVar[tuple[str, ...]] = ()

    def __init__(self, name: str, **node_arguments: Any) -> None:
        super().__init__(name, **node_arguments)
        release_when_leaving(partial(_release, weakref.ref(self)))
        self.begins: Callable[[], object] = lambda: None
        self.ends: Callable[[], object] = lambda: None
        self.is_active = False
        self._kept: deque[Callable[[], None]] = deque(maxlen=_MOST_KEPT)
        about = ParameterDescriptor(description="Else when a manager says.", read_only=True)
        if self.declare_parameter("start_active", True, about).value:
            self.trigger_configure()
            self.trigger_activate()
        self.health = Health()
        self._listened: dict[str, tuple[str, QoSProfile]] = {}
        self._configs: dict[type, Any] = {
            kind: declare_config(self, kind, prefix, self.SETTABLE) for kind, prefix in self.CONFIGS
        }
        self.add_on_set_parameters_callback(self._judge_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        self._warn_of_unknown_parameters()
        self._workers: list[Worker] = []
        self._is_in_callback = False
        self.lockstep = None
        if self._configs.get(LockstepConfig, LockstepConfig()).lockstep:
            self.lockstep = LockstepReporter(self, self._rests)
        self._advertised: list[Publisher] = []
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.stream())
        self.repeat(DIAGNOSTICS_PERIOD, self._publish_diagnostics)

    def repeat(self, period: float, action: Callable[[], None]) -> None:
        """Do something each so many seconds [s], of a clock that nobody sets."""
        self.create_timer(period, action, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Use and publish data from now on, the latched ones that have come meanwhile first."""
        result = super().on_activate(state)
        self.is_active = True
        while self._kept:
            self._kept.popleft()()
        self.begins()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stand still, then neither use nor publish data."""
        self.ends()
        self.is_active = False
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As `on_deactivate`: process and services go on until they are interrupted."""
        return self.on_deactivate(state)

    def config(self, kind: type[Config]) -> Config:
        """The validated configuration of one of the classes in `CONFIGS`, as it is now."""
        found: Config = self._configs[kind]
        return found

    def judge_config(self, config: object) -> None:
        """Refuse a configuration that its class accepts, and this node cannot use.

        Args:
            config: with values that are about to be set.

        Raises:
            ConfigError: it cannot be used.
        """

    def take_config(self, config: object) -> None:
        """A configuration has become another; nodes that do not ask for it each time use it now."""

    def _judge_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept new values that their configurations accept."""
        try:
            for config in self._changed_configs(parameters):
                self.judge_config(config)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, parameters: list[Parameter]) -> None:
        for config in self._changed_configs(parameters):
            self._configs[type(config)] = config
            self.take_config(config)

    def _changed_configs(self, parameters: list[Parameter]) -> list[Any]:
        """The configurations that become others by new values."""
        values = {parameter.name: parameter.value for parameter in parameters}
        pairs = [(self._configs.get(kind), prefix) for kind, prefix in self.CONFIGS]
        changed = [(old, changed_config(old, prefix, values)) for old, prefix in pairs if old]
        return [new for old, new in changed if new is not old]

    def listen(
        self,
        message_type: type,
        topic: str,
        handle: Callable[[Any], None],
        profile: QoSProfile,
        *,
        required: bool = True,
        from_peer: bool = False,
        on_lost: Callable[[], object] | None = None,
    ) -> Subscription:
        """Subscribe; arrivals are counted, errors of the library become counted drops.

        Args:
            message_type: ROS message class.
            topic: relative name.
            handle: called with each message.
            profile: quality of service, overridable by parameters.
            required: whether its absence is worth a warning.
            from_peer: whether other robots publish it; then see `guard_peer`.
            on_lost: called when a publisher of an `alive` topic was killed or hangs.
        """
        name = self.resolve_topic_name(topic)
        profile = self._quality(profile)
        latched = profile.durability == qos.latched().durability
        self.health.watch(name, required=required, latched=latched)
        self._listened[name] = _type_name(message_type), profile
        if self.lockstep is not None:
            self.lockstep.listens(name, latched)
        radio = self._configs.get(TeamRadioConfig, TeamRadioConfig())
        guard = self.guard_peer if from_peer else self.guard

        def use(message: Any) -> None:
            self._is_in_callback = True
            guard(name, lambda: handle(message))
            self._is_in_callback = False

        def receive(message: Any) -> None:
            if loses(radio, topic):
                self.drop("simulated loss")
                return
            self.health.arrived(name)
            if self.is_active:
                use(message)
            elif latched:
                self._kept.append(partial(use, message))
            if self.lockstep is not None:
                self.lockstep.used(name)

        def on_liveliness(event: QoSLivelinessChangedInfo) -> None:
            if on_lost is not None and event.not_alive_count_change > 0:
                on_lost()

        events = SubscriptionEventCallbacks(liveliness=on_liveliness) if on_lost else None
        how = {"qos_overriding_options": qos.overridable(), "event_callbacks": events}
        return self.create_subscription(message_type, topic, receive, profile, **how)

    def advertise(
        self,
        message_type: type,
        topic: str,
        profile: QoSProfile,
        on_subscriber: Callable[[], object] | None = None,
    ) -> Publisher:
        """Create a publisher whose quality of service parameters can override.

        Args:
            message_type: ROS message class.
            topic: relative name.
            profile: quality of service.
            on_subscriber: called when a subscriber has appeared.
        """

        def on_matched(event: QoSPublisherMatchedInfo) -> None:
            if on_subscriber is not None and event.total_count_change > 0:
                on_subscriber()

        profile = self._quality(profile)
        events = PublisherEventCallbacks(matched=on_matched) if on_subscriber else None
        how = {"qos_overriding_options": qos.overridable(), "event_callbacks": events}
        publisher = self.create_lifecycle_publisher(message_type, topic, profile, **how)
        if self.is_active:
            publisher.on_activate(None)
        self._advertised.append(publisher)
        if self.lockstep is not None:
            self.lockstep.count(publisher)
        return publisher

    def _quality(self, profile: QoSProfile) -> QoSProfile:
        """In lockstep nothing may be lost, as time waits for all that was sent."""
        return profile if self.lockstep is None else qos.complete(profile)

    @property
    def is_working(self) -> bool:
        """Whether a worker still does a job, which at the end of a node is one broken off."""
        return any(worker.alive for worker in self._workers)

    def start_worker(self, capacity: int, last_job: float = 10.0) -> Worker:
        """Start a thread for long work; jobs that are dropped are counted as drops.

        Args:
            capacity: number of jobs that may wait.
            last_job: how long the node's end waits for the job at hand [s].
        """
        name, overflow = self.get_name(), partial(self.drop, "too slow")
        rest = (lambda: None) if self.lockstep is None else self.lockstep.report
        worker = Worker(name, capacity, overflow, last_job, rest)
        self._workers.append(worker)
        return worker

    def _rests(self) -> bool:
        """Whether neither a callback nor a worker is at work."""
        return not self._is_in_callback and not any(worker.waiting for worker in self._workers)

    @property
    def motion_clock(self) -> Clock:
        """What motions are timed by: the clock of a simulator, or one that nobody sets.

        The time of the machine may be stepped, by hours, while something moves.
        """
        if self.get_parameter("use_sim_time").value:
            return self.get_clock()
        return Clock(clock_type=ClockType.STEADY_TIME)

    def guard(self, origin: str, action: Callable[[], object]) -> bool:
        """Run an action; an error of the library becomes a counted drop.

        Args:
            origin: topic or task that the data belong to.
            action: what to do.

        Returns:
            Whether the action succeeded.
        """
        try:
            action()
        except InfomapError as error:
            reason = _REASONS.get(type(error), type(error).__name__)
            if isinstance(error, UpdateRefusedError):
                reason = error.reason
            elif isinstance(error, SensorFaultError):
                reason = str(error)
            self.drop(reason, f"{origin}: {error}")
            return False
        return True

    def guard_peer(self, origin: str, action: Callable[[], object]) -> bool:
        """As `guard`, for a message of another robot: any error is one counted drop.

        What others send must not end this node, also where it meets a defect of this program; the
        drop names the exception and the line.
        """
        try:
            return self.guard(origin, action)
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}, line {place.lineno}"
            self.drop(f"failed: {type(error).__name__}", f"{origin}: {error} ({where})")
            return False

    def drop(self, reason: str, detail: str = "") -> None:
        """Count data that were not used, and say so at most every five seconds per reason."""
        reason, detail = as_line(reason), as_line(detail)
        if self.health.dropped(reason, detail):
            self.get_logger().warning(f"dropped ({reason}) {detail * (detail != reason)}".rstrip())

    def destroy_node(self) -> None:
        """Stop the workers, then the node."""
        for worker in self._workers:
            worker.stop()
        part_soon()
        super().destroy_node()

    def _publish_diagnostics(self) -> None:
        if not all(worker.alive for worker in self._workers):
            raise RuntimeError("the worker thread has ended by an error, see above")
        if self.is_active:
            self._warn_of_missing_inputs()
        self._note_memory()
        if self.lockstep is not None:
            self.lockstep.report(again=True)
        for publisher in self._advertised:
            name = f"{publisher.topic_name} subscribers"
            self.health.note(name, str(publisher.get_subscription_count()))
        complaints = self.health.complaints() + self._mixed_sources() if self.is_active else []
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if complaints else DiagnosticStatus.OK,
            name=f"{self.get_fully_qualified_name()}: data",
            message="; ".join(complaints) or ("ok" if self.is_active else "inactive"),
            hardware_id=self.get_fully_qualified_name(),
            values=[KeyValue(key=k, value=v) for k, v in self.health.values().items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _mixed_sources(self) -> list[str]:
        """Streams of one sensor that more than one node publishes, in words."""
        found = []
        for topic, (type_name, _) in self._listened.items():
            if type_name in _OF_ONE_SOURCE and self.count_publishers(topic) > 1:
                publishers = self.get_publishers_info_by_topic(topic)
                names = sorted(f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in publishers)
                found.append(f"{topic} is published by {' and '.join(names)}")
        return found

    def _warn_of_missing_inputs(self) -> None:
        """Say every few seconds what never came, with what is known of it, and what has stopped."""
        never, stopped = self.health.newly_missing()
        if never:
            wanted = "; ".join(self._describe_input(topic) for topic in never)
            self.get_logger().warning(f"nothing has come on {wanted}. Try `infomap doctor`")
        if stopped:
            self.get_logger().warning(f"nothing comes any more on {', '.join(stopped)}")

    def _describe_input(self, topic: str) -> str:
        """A topic with its type, quality of service, and how many publish it."""
        type_name, profile = self._listened[topic]
        reliability = profile.reliability.name.lower().replace("_", " ")
        durability = ", latched" if profile.durability == qos.latched().durability else ""
        count = self.count_publishers(topic)
        publishers = f"{count or 'no'} publisher{'s' if count != 1 else ''}"
        return f"{topic} ({type_name}, {reliability}{durability}, {publishers})"

    def _warn_of_unknown_parameters(self) -> None:
        """Name values that were given for parameters which this node does not have."""
        known = {prefix + name for kind, prefix in self.CONFIGS for name in all_parameters(kind)}
        known |= {name for name in self._parameters if not name.startswith("qos_overrides.")}
        given = self._parameter_overrides
        unknown = [n for n in given if n not in known and not n.startswith("qos_overrides.")]
        if not unknown:
            return
        # A robot's file is for all nodes, and each takes what it knows. Imported here, as that
        # looks for a graphics card, which other starts need not wait for.
        from infomap_ros.simulation.robots.robot_file import PARAMETERS

        for name in unknown:
            if name not in PARAMETERS:
                near = get_close_matches(name, known, n=1)
                hint = f": is {near[0]} meant?" if near else ""
                self.get_logger().warning(f"parameter {name} is not known and not used{hint}")

    def _note_memory(self) -> None:
        """Note what of the heap is in use, and how many jobs have waited."""
        in_use = heap_in_use()
        if in_use is not None:
            self.health.note("heap in use [bytes]", str(in_use))
        if self._workers:
            most = max(worker.most_waiting for worker in self._workers)
            self.health.note("most jobs waiting", str(most))


def _type_name(message_type: type) -> str:
    """As ROS writes it, such as sensor_msgs/msg/Image."""
    package, kind, *_ = message_type.__module__.split(".")
    return f"{package}/{kind}/{message_type.__name__}"


def _release(node: weakref.ref[MonitoredNode]) -> None:
    """Give back what a node has of the middleware."""
    if (alive := node()) is not None:
        Node.destroy_node(alive)
