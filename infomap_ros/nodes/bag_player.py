"""Node ``bag_player``: plays a bag onto topics, with /clock.

Topics of the bag become relative names, so that namespace and remaps apply; /tf, /tf_static and
/diagnostics stay absolute. Messages are passed on as they are in the bag, without being read. The
replay runs in the worker thread, so that acknowledgements are received while it publishes. When the
bag loops the clock jumps back; that is for the listeners to notice.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import BagError, ConfigError, InfomapError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.messages import encode_clock
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class
from infomap_ros.nodes.common.run import run_node
from infomap_ros.replay.bags.player import BagPlayer, PlayerConfig, Step
from infomap_ros.replay.bags.reader import BagReader

_ABSOLUTE = ("/tf", "/tf_static", "/diagnostics")
_NOT_PLAYED = ("/clock", "/rosout", "/parameter_events")


def advertise_topics(
    node: MonitoredNode, bag: BagReader, wanted: Collection[str]
) -> dict[str, Publisher]:
    """Make a publisher for each topic of a bag whose message type is installed.

    Names become relative, so that namespace and remaps apply, except those that are absolute in
    every graph. What is latched in the bag is latched again. A topic whose type is not installed
    is named in the log and left out.

    Args:
        node: that publishes.
        bag: the bag.
        wanted: topics as they are in the bag.

    Returns:
        Publishers by the topics of the bag.

    Raises:
        BagError: no topic is left.
    """
    publishers = {}
    for name, channel in bag.topics.items():
        if name in _NOT_PLAYED or name not in wanted:
            continue
        try:
            kind = message_class(channel.type_name)
        except (ModuleNotFoundError, AttributeError):
            text = f"{name} is not played: {channel.type_name} is not installed"
            node.get_logger().warning(text)
            continue
        profile = qos.latched(depth=100) if channel.latched else qos.stream(depth=50)
        target = name if name in _ABSOLUTE else name.lstrip("/")
        publishers[name] = node.advertise(kind, target, profile)
    if not publishers:
        raise BagError(f"{bag.path} holds no topic to play")
    return publishers


_SETTLING = 1.0  # [s]
# With acknowledged: the clouds with whose stamp a message of paced_topic has been used.
_RESULT_TOPIC = "map_updates"
_CLOCK_PERIOD = 0.05  # [s]


@dataclass(frozen=True)
class BagPlayerNodeConfig:
    """What bag_player plays, for whom it waits, and what reports that a message was used.

    Raises:
        ConfigError: a value is out of its range.
    """

    bag: str = parameter("", "The bag: rosbag2 folder, .mcap, .db3 or ROS 1 .bag file.")
    topics: tuple[str, ...] = parameter((), "Topics to play, as they are in the bag; empty: all.")
    left_out: tuple[str, ...] = parameter(
        (), "Topics not to play, as they are in the bag, where others publish them anew."
    )
    wait_for_subscribers: tuple[str, ...] = parameter(
        (),
        "Topics that must have a subscriber before the replay starts, a topic given twice two. "
        "Empty: until any has one, and a second more.",
    )
    wait_for_publishers: tuple[str, ...] = setting(
        (), "Topics that others must publish before the replay starts, as what they make of it."
    )
    paced_topic: str = setting(
        "/left/image_raw", "With acknowledged: the topic of the bag whose results are waited for."
    )

    def __post_init__(self) -> None:
        check_config(self)


class BagPlayerNode(MonitoredNode):
    """See the module.

    Attributes:
        finished: done when the bag has ended; its result is the exit status.
    """

    CONFIGS = ((BagPlayerNodeConfig, ""), (PlayerConfig, ""))

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("bag_player", **node_arguments)
        self._config = self.config(BagPlayerNodeConfig)
        self.finished: Future = Future()
        if not self._config.bag:
            raise ConfigError("bag", "", "a bag to play")
        self._reader = BagReader(self._config.bag)
        wanted = set(self._config.topics or self._reader.topics) - set(self._config.left_out)
        self._outlets = advertise_topics(self, self._reader, wanted)
        self._clock_publisher = self.advertise(Clock, "/clock", qos.stream(depth=1))
        self._types = RclpyMessageTypes()
        self._acknowledged = threading.Condition()
        self._player = self._make_player()
        if self._player.config.acknowledged:
            profile = qos.sensor_data(depth=100)
            self.listen(PointCloud2, _RESULT_TOPIC, self._on_result, profile)
        self._stopping = False
        self.start_worker(1).submit(self._play)

    def _make_player(self) -> BagPlayer:
        paced, topics = self._config.paced_topic, tuple(self._outlets)
        config = self.config(PlayerConfig)
        if config.acknowledged and paced not in topics:
            raise BagError(f"paced_topic {paced} is not played; played are {', '.join(topics)}")
        latched = [name for name in topics if self._reader.topics[name].latched]
        return BagPlayer(
            lambda: self._reader.messages(topics),
            config,
            paced=[paced] if config.acknowledged else [],
            latched=latched,
        )

    def _on_result(self, message: PointCloud2) -> None:
        stamp = message.header.stamp
        with self._acknowledged:
            nanoseconds = stamp.sec * 1_000_000_000 + stamp.nanosec
            self._player.acknowledge(self._config.paced_topic, nanoseconds)
            self._acknowledged.notify()

    def _play(self) -> None:
        """Publish until the bag ends; in the worker thread."""
        status = 0
        try:
            self._wait_for_others()
            self.get_logger().info(f"playing {self._config.bag}")
            while not self._stopping and not self._publish_step():
                pass
            for publisher in () if self._stopping else self._outlets.values():
                publisher.wait_for_all_acked(Duration(seconds=5))
        except InfomapError as error:
            self.get_logger().error(str(error))
            status = 1
        self._report_problems()
        self.finished.set_result(status)
        if self.executor is not None:
            self.executor.wake()

    def _publish_step(self) -> bool:
        """Publish what is due and wait for the next; returns whether the bag has ended."""
        with self._acknowledged:
            step: Step = self._player.step(time.monotonic())
        if step.clock is not None:
            self._clock_publisher.publish(encode_clock(self._types, step.clock))
        for message in step.messages:
            self._outlets[message.topic].publish(message.data)
            self.health.produced()
        if not step.finished and step.wait > 0.0:
            with self._acknowledged:
                self._acknowledged.wait(min(step.wait, _CLOCK_PERIOD))
        return step.finished

    def _wait_for_others(self) -> None:
        wanted = [self.resolve_topic_name(name) for name in self._config.wait_for_subscribers]
        names = Counter(wanted or [publisher.topic_name for publisher in self._outlets.values()])
        enough = all if wanted else any
        self._wait_until(
            lambda: enough(self.count_subscribers(name) >= names[name] for name in names),
            lambda: [
                f"subscribers of {name} ({self.count_subscribers(name)} of {least})"
                for name, least in names.items()
                if self.count_subscribers(name) < least
            ],
        )
        results = list(self._config.wait_for_publishers)
        results += [_RESULT_TOPIC] * self._player.config.acknowledged
        made = [self.resolve_topic_name(name) for name in results]
        self._wait_until(
            lambda: all(self.count_publishers(name) for name in made),
            lambda: [f"a publisher of {n}" for n in made if not self.count_publishers(n)],
        )
        if not wanted:
            time.sleep(_SETTLING)

    def _wait_until(self, met: Callable[[], bool], missing: Callable[[], list[str]]) -> None:
        while not self._stopping and not met():
            text = f"waiting for {', '.join(missing())}"
            self.get_logger().info(text, throttle_duration_sec=5.0)
            time.sleep(0.02)

    def _report_problems(self) -> None:
        remarks = [f"{count} skipped, {why}" for why, count in self._reader.skipped.items()]
        if lost := self._player.unacknowledged:
            remarks.append(f"{lost} messages of {self._config.paced_topic} were lost")
        for text in [*self._reader.problems, *remarks]:
            self.get_logger().warning(text)
        count = self._player.published
        self.get_logger().info(f"played {count} messages; this ends, other nodes stay")

    def destroy_node(self) -> None:
        """Stop playing and close the bag."""
        self._stopping = True
        super().destroy_node()
        self._reader.close()


def main() -> int:
    """Run the node until the bag has ended."""
    return run_node(BagPlayerNode, until=lambda node: node.finished)


if __name__ == "__main__":
    raise SystemExit(main())
