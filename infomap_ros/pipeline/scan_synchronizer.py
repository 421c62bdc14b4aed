"""Clouds wait here until the places of camera, robot and teammates at their stamps are known.

When the clock jumps back (a bag that loops), clouds from before the jump still get the poses from
before it, and those after it never do. What still waits when the clouds have jumped is dropped.

Records that come in two messages of one stamp: poses and their uncertainty, say.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, Protocol, TypeVar

from infomap_ros.errors import FrameError, RobotModelError
from infomap_ros.exploration.team.teammate_places import BodyInScan
from infomap_ros.geometry import PlacedSolid, PoseRecord, PoseUncertainty, Record
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.records import WaitingQueue, WaitingQueueConfig
from infomap_ros.pipeline.clock_jumps import ClockGate, JumpingBuffer
from infomap_ros.pipeline.robot_body import RobotBody

Main = TypeVar("Main")
Part = TypeVar("Part")

_CAPACITY = 100  # of each kind; older ones give way


class StampedParts(Generic[Main, Part]):
    """Completes records with the parts of the same stamp, whichever comes first.

    A record waits for its part where parts are published. It goes on without its part when a later
    record is complete, or when too many wait.

    Args:
        are_published: whether there are parts to wait for.
    """

    def __init__(self, are_published: Callable[[], bool]) -> None:
        self._are_published = are_published
        self._mains: dict[int, Main] = {}
        self._parts: dict[int, Part] = {}

    def add(self, stamp: int, record: Main) -> list[tuple[Main, Part | None]]:
        """Add a record; returns those that can go on, with their parts, in order of arrival."""
        self._mains[stamp] = record
        if stamp in self._parts or not self._are_published() or len(self._mains) > _CAPACITY:
            return self._complete(stamp)
        return []

    def add_part(self, stamp: int, part: Part) -> list[tuple[Main, Part | None]]:
        """Add a part; returns as `add`."""
        self._parts[stamp] = part
        while len(self._parts) > _CAPACITY:
            del self._parts[next(iter(self._parts))]
        return self._complete(stamp) if stamp in self._mains else []

    def _complete(self, stamp: int) -> list[tuple[Main, Part | None]]:
        """All records up to one stamp."""
        done = []
        for each in list(self._mains):
            done.append((self._mains.pop(each), self._parts.pop(each, None)))
            if each == stamp:
                break
        return done


Cloud = TypeVar("Cloud")
Other = TypeVar("Other")

CLOCK_JUMPED = "time went backwards"
WRONG_FRAME = "wrong frame"

_VOTES = 9  # last clouds, most of which say in which frame clouds are, where it is not named


@dataclass(frozen=True)
class ScanSynchronizerConfig:
    """Which frames clouds and poses must have.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_frame: str = parameter("map", "Frame of the map; camera_pose must be given in it.")
    camera_frame: str = parameter(
        "",
        "Frame of which camera_pose is the pose; clouds of another frame are placed by tf. Empty: "
        "that of the clouds.",
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class Scan(Generic[Cloud]):
    """A cloud that can be fused.

    Attributes:
        cloud: as it was added.
        pose: of the camera at its stamp.
        body: the robot's solids in the frame of the cloud at its stamp.
        teammates: their bodies there.
    """

    cloud: Cloud
    pose: PoseRecord
    body: Sequence[PlacedSolid] = ()
    teammates: Sequence[BodyInScan] = ()

    def with_cloud(self, cloud: Other) -> Scan[Other]:
        """The scan with its cloud in another form."""
        return Scan(cloud, self.pose, self.body, self.teammates)


class Teammates(Protocol):
    """Knows where teammates were."""

    def check_known_at(self, stamp: int, newest: int) -> None:
        """Raises `PoseUnavailableError` where it may still become known; times [ns]."""

    def bodies_in(self, camera: PoseRecord) -> Sequence[BodyInScan]:
        """Their bodies, placed for a scan from a pose of the camera in the map."""


class NoTeammates:
    """A robot on its own; see `Teammates`."""

    def check_known_at(self, stamp: int, newest: int) -> None:
        """Nothing has to be known."""

    def bodies_in(self, camera: PoseRecord) -> Sequence[BodyInScan]:
        """None."""
        return ()


class CameraPoseSource(Protocol):
    """Poses of the camera by time."""

    def add(self, record: Record) -> object:
        """Take a record that says where the camera was; others are ignored."""

    def at(self, stamp: int) -> PoseRecord:
        """The pose at a time [ns]; raises `PoseUnavailableError`."""

    def others_have_jumped(self, stamp: int) -> None:
        """The clock of the clouds has jumped back to `stamp` [ns]."""


class LocatedPoses:
    """Poses of the camera in the map, as localization publishes them; see `CameraPoseSource`.

    Args:
        map_frame: frame in which they have to be.
        config: of the buffer.
        are_parts_published: whether the parts of their covariances come beside them.

    Attributes:
        map_frame: as above.
    """

    def __init__(
        self,
        map_frame: str,
        config: PoseBufferConfig | None = None,
        are_parts_published: Callable[[], bool] = lambda: False,
    ) -> None:
        self.map_frame, limits = map_frame, config or PoseBufferConfig()
        self._poses = JumpingBuffer(lambda: PoseBuffer(limits), round(limits.max_gap * 1e9))
        self._parts: StampedParts[PoseRecord, PoseUncertainty] = StampedParts(are_parts_published)

    def add(self, record: Record) -> None:
        """Take a pose; other records are ignored.

        Raises:
            FrameError: it is in another frame than the map.
        """
        if not isinstance(record, PoseRecord):
            return
        if record.frame_id != self.map_frame:
            text = f"pose in frame '{record.frame_id}', the map is '{self.map_frame}'"
            raise FrameError(text)
        if record.uncertainty is not None:
            self._poses.add(record)
        else:
            self._keep(self._parts.add(record.stamp, record))

    def add_uncertainty(self, stamp: int, uncertainty: PoseUncertainty) -> None:
        """Take the parts of the covariance of the pose of a stamp [ns]."""
        self._keep(self._parts.add_part(stamp, uncertainty))

    def at(self, stamp: int) -> PoseRecord:
        """See `PoseBuffer.at`."""
        return self._poses.at(stamp)

    def others_have_jumped(self, stamp: int) -> None:
        """See `CameraPoseSource`."""
        self._poses.others_have_jumped(stamp)

    def _keep(self, complete: list[tuple[PoseRecord, PoseUncertainty | None]]) -> None:
        for pose, uncertainty in complete:
            self._poses.add(replace(pose, uncertainty=uncertainty))


class _Arrival(NamedTuple, Generic[Cloud]):
    stamp: int
    frame: str
    cloud: Cloud


class ScanSynchronizer(Generic[Cloud]):
    """Gives out scans in order of time, each when it is complete.

    A cloud waits for its place only once its stamp is to be believed (`ClockGate`): where the next
    cloud goes on from it, or the poses have come there too.

    Args:
        poses: of the camera.
        body: of the robot.
        teammates: of the others.
        waiting: how long clouds wait.
        on_drop: called with the reason, in short and in a sentence, of each cloud that is dropped.
        on_clock_jump: called when the clock of the clouds has jumped back.
    """

    def __init__(
        self,
        poses: CameraPoseSource,
        body: RobotBody,
        teammates: Teammates | None = None,
        waiting: WaitingQueueConfig | None = None,
        on_drop: Callable[[str, str], None] = lambda *_: None,
        on_clock_jump: Callable[[], None] = lambda: None,
    ) -> None:
        self._poses, self._body = poses, body
        self._teammates = teammates or NoTeammates()
        self._on_drop = on_drop
        self._on_clock_jump, self._frames = on_clock_jump, deque[str](maxlen=_VOTES)
        self._newest = self._pose_stamp = 0
        self._gate: ClockGate[_Arrival[Cloud]] = ClockGate(on_drop)
        self._waiting: WaitingQueue[_Arrival[Cloud]] = WaitingQueue(
            self._pose_at,
            waiting or WaitingQueueConfig(),
            lambda _, reason, sentence: on_drop(reason, sentence),
        )

    def add_cloud(self, stamp: int, frame: str, cloud: Cloud) -> None:
        """Add a cloud.

        Args:
            stamp: of the cloud [ns].
            frame: of the cloud.
            cloud: whatever is to be given out, decoded or not.

        Raises:
            FrameError: it is in another frame than most.
        """
        self._frames.append(frame)
        if (wrong := self._wrong_frame(frame)) is not None:
            raise FrameError(wrong)
        self._wait(self._gate.add(stamp, _Arrival(stamp, frame, cloud)))

    def add_pose(self, record: Record) -> None:
        """Add a record that says where the camera was; raises as `CameraPoseSource.add`."""
        self._poses.add(record)
        self._pose_stamp = record.stamp
        if isinstance(record, PoseRecord):
            self._wait(self._gate.agree(record.stamp))

    def take(self, now: int | None = None) -> list[Scan[Cloud]]:
        """The scans that are complete by now.

        Args:
            now: time of the data [ns]; that of the newest cloud where not given.
        """
        scans = []
        if now is not None and now > self._newest:
            self._wait(self._gate.finish())
        for (_, frame, cloud), pose in self._waiting.take(now):
            if (wrong := self._wrong_frame(frame)) is not None:
                self._on_drop(WRONG_FRAME, wrong)
                continue
            try:
                body = self._body.solids_in(frame, pose.stamp)
            except RobotModelError as error:
                self._on_drop("robot description", str(error))
                continue
            scans.append(Scan(cloud, pose, body, self._teammates.bodies_in(pose)))
        return scans

    def _wait(self, passed: list[tuple[_Arrival[Cloud], bool]]) -> None:
        """Have clouds wait until all that belongs to them is known."""
        for arrival, has_jumped in passed:
            if has_jumped:
                self._newest = arrival.stamp
                self._waiting.drop_all(CLOCK_JUMPED)
                self._poses.others_have_jumped(arrival.stamp)
                self._body.others_have_jumped(arrival.stamp)
                self._on_clock_jump()
            self._newest = max(self._newest, arrival.stamp)
            self._waiting.push(arrival.stamp, arrival)

    def _wrong_frame(self, frame: str) -> str | None:
        """What is wrong with the frame of a cloud, in a sentence."""
        expected = Counter(self._frames).most_common(1)[0][0]
        return None if frame == expected else f"cloud in frame '{frame}', most in '{expected}'"

    def _pose_at(self, stamp: int) -> PoseRecord:
        """The camera's pose, once the places of the body and of teammates' are known too."""
        self._body.check_known_at(stamp)
        pose = self._poses.at(stamp)
        newest = max(self._newest, self._pose_stamp, self._body.newest_stamp)
        self._teammates.check_known_at(stamp, newest)
        return pose
