"""Clouds wait here until the places of sensor, robot and teammates at their stamps are known.

The clouds of each frame are a stream of their own: they have their own rate and may have a clock of
their own, so none is too late because another sensor is ahead.

When the clock jumps back (a bag that loops), clouds from before the jump still get the poses from
before it, and those after it never do. What still waits when the clouds have jumped is dropped.

Records that come in two messages of one stamp: poses and their uncertainty, say.
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, NamedTuple, Protocol, TypeVar

from infomap_ros.errors import FrameError, RobotModelError
from infomap_ros.exploration.team.teammate_places import BodyInScan
from infomap_ros.geometry import PlacedSolid, PoseRecord, PoseUncertainty, Record
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.records import WaitingQueue, WaitingQueueConfig
from infomap_ros.pipeline.clock_jumps import CLOCK_JUMP, ClockGate, JumpingBuffer
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
_ODD = 1  # as many of them may be of another frame
_MOST_SENSORS = 16  # of one robot; the one silent longest gives way
_SILENT = 60_000_000_000  # [ns], for which others go on until a sensor is forgotten


@dataclass(frozen=True)
class ScanSynchronizerConfig:
    """Which frames clouds and poses must have.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_frame: str = parameter("map", "Frame of the map; camera_pose must be given in it.")
    camera_frame: str = parameter(
        "",
        "Frame of which camera_pose is the pose; clouds of other frames are placed from it by tf. "
        "Empty: that of the clouds, which must all be of one frame then.",
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class Scan(Generic[Cloud]):
    """A cloud that can be fused.

    Attributes:
        cloud: as it was added.
        pose: of the sensor at its stamp. It names its child frame where that is not the camera's
            of which localization gives the pose.
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
        """Their bodies, placed for a scan from a pose of the sensor in the map."""


class NoTeammates:
    """A robot on its own; see `Teammates`."""

    def check_known_at(self, stamp: int, newest: int) -> None:
        """Nothing has to be known."""

    def bodies_in(self, camera: PoseRecord) -> Sequence[BodyInScan]:
        """None."""
        return ()


class CameraPoseSource(Protocol):
    """Poses of the camera, or of each sensor, by time."""

    @property
    def places_frames(self) -> bool:
        """Whether it knows where each frame is; else all clouds must be of the camera's."""

    def add(self, record: Record) -> object:
        """Take a record that says where the camera was; others are ignored."""

    def at(self, stamp: int, frame: str) -> PoseRecord:
        """The pose of a sensor's frame at a time [ns]; raises `PoseUnavailableError`."""

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

    places_frames = False

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

    def at(self, stamp: int, frame: str = "") -> PoseRecord:
        """See `PoseBuffer.at`; the frame is the camera's."""
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


@dataclass(eq=False)
class _Stream(Generic[Cloud]):
    """The clouds of one frame.

    Attributes:
        gate: lets them pass.
        waiting: those that have passed.
        jumps: of the clock, up to the last in which it took part.
        newest: stamp [ns].
        passed: time that has passed by its stamps, steps of its clock left out [ns].
        came: how much had passed by those of any stream when its newest cloud came [ns].
    """

    gate: ClockGate[_Arrival[Cloud]]
    waiting: WaitingQueue[_Arrival[Cloud]]
    jumps: int
    newest: int = 0
    passed: int = 0
    came: int = 0


class ScanSynchronizer(Generic[Cloud]):
    """Gives out scans in order of time, each when it is complete.

    A cloud waits for its place only once its stamp is to be believed (`ClockGate`): where the next
    cloud of its frame goes on from it, or the poses have come there too.

    The first frame whose clouds jump back takes all with it; those that follow jump no further.

    Args:
        poses: of the sensors.
        body: of the robot.
        teammates: of the others.
        waiting: how long clouds wait, and how many of each frame.
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
        self._on_drop, self._limits = on_drop, waiting or WaitingQueueConfig()
        self._on_clock_jump, self._votes = on_clock_jump, deque[str](maxlen=_VOTES)
        self._passed = self._pose_stamp = self._jumps = 0
        self._streams: OrderedDict[str, _Stream[Cloud]] = OrderedDict()  # last used last

    @property
    def frames(self) -> Collection[str]:
        """Frames of which clouds come."""
        return self._streams.keys()

    def add_cloud(self, stamp: int, frame: str, cloud: Cloud) -> None:
        """Add a cloud.

        Args:
            stamp: of the cloud [ns].
            frame: of the cloud.
            cloud: whatever is to be given out, decoded or not.

        Raises:
            FrameError: it is not known where this frame is, but for that of most clouds.
        """
        self._votes.append(frame)
        if (wrong := self._wrong_frame(frame)) is not None:
            raise FrameError(wrong)
        stream = self._stream(frame)
        self._wait(stream, stream.gate.add(stamp, _Arrival(stamp, frame, cloud)))

    def add_pose(self, record: Record) -> None:
        """Add a record that says where the camera was; raises as `CameraPoseSource.add`."""
        self._poses.add(record)
        self._pose_stamp = record.stamp
        if isinstance(record, PoseRecord):
            for stream in self._streams.values():
                self._wait(stream, stream.gate.agree(record.stamp))

    def take(self, now: int | None = None) -> list[Scan[Cloud]]:
        """The scans that are complete by now.

        Args:
            now: time of the data [ns]; that of the newest cloud where not given.
        """
        ready = []
        for frame, stream in list(self._streams.items()):
            if now is not None and now > stream.newest:
                self._wait(stream, stream.gate.finish())
            since = self._passed - stream.came  # by the clouds of other frames
            by_others = stream.newest + since if since else None
            ready += stream.waiting.take(by_others if now is None else now)
            if since > _SILENT:
                self._forget(frame)
        ready.sort(key=lambda each: each[1].stamp)
        found = (self._scan(arrival, pose) for arrival, pose in ready)
        return [scan for scan in found if scan is not None]

    def _scan(self, arrival: _Arrival[Cloud], pose: PoseRecord) -> Scan[Cloud] | None:
        """A cloud with what belongs to it; None where it cannot be used."""
        if (wrong := self._wrong_frame(arrival.frame)) is not None:
            self._on_drop(WRONG_FRAME, wrong)
            return None
        try:
            body = self._body.solids_in(arrival.frame, pose.stamp)
        except RobotModelError as error:
            self._on_drop("robot description", str(error))
            return None
        return Scan(arrival.cloud, pose, body, self._teammates.bodies_in(pose))

    def _stream(self, frame: str) -> _Stream[Cloud]:
        """That of a frame, a new one for a new frame."""
        if frame not in self._streams:
            if len(self._streams) >= _MOST_SENSORS:
                self._forget(next(iter(self._streams)))
            drop, pose_at = partial(self._drop, frame), partial(self._pose_at, frame=frame)
            waiting: WaitingQueue[_Arrival[Cloud]] = WaitingQueue(
                pose_at, self._limits, lambda _, *why: drop(*why)
            )
            self._streams[frame] = _Stream(ClockGate(drop), waiting, self._jumps)
        self._streams.move_to_end(frame)
        return self._streams[frame]

    def _forget(self, frame: str) -> None:
        """Give up a stream, and say so of what still waits."""
        stream = self._streams.pop(frame)
        for arrival, _ in stream.gate.finish():
            stream.waiting.push(arrival.stamp, arrival)
        stream.waiting.drop_all("frame went silent")

    def _drop(self, frame: str, reason: str, sentence: str) -> None:
        self._on_drop(reason, f"cloud in frame '{frame}': {sentence}")

    def _wait(self, stream: _Stream[Cloud], passed: list[tuple[_Arrival[Cloud], bool]]) -> None:
        """Have clouds wait until all that belongs to them is known."""
        for arrival, has_jumped in passed:
            if has_jumped:
                self._jump(stream, arrival.stamp)
            step = arrival.stamp - stream.newest
            if step >= 0:
                stream.passed = stream.passed + step if step <= CLOCK_JUMP else self._passed
                self._passed = stream.came = max(self._passed, stream.passed)
                stream.newest = arrival.stamp
            stream.waiting.push(arrival.stamp, arrival)

    def _jump(self, stream: _Stream[Cloud], stamp: int) -> None:
        """A stream has jumped back, as the first one or after others."""
        stream.newest = stamp
        stream.waiting.drop_all(CLOCK_JUMPED)
        if stream.jumps < self._jumps:
            stream.jumps = self._jumps
            return
        stream.jumps = self._jumps = self._jumps + 1
        for other in self._streams.values():
            other.waiting.drop_all(CLOCK_JUMPED)
        self._poses.others_have_jumped(stamp)
        self._body.others_have_jumped(stamp)
        self._on_clock_jump()

    def _wrong_frame(self, frame: str) -> str | None:
        """What is wrong with the frame of a cloud, in a sentence."""
        if self._poses.places_frames:
            return None
        (expected, _), *others = Counter(self._votes).most_common(2)
        if frame != expected:
            return f"cloud in frame '{frame}', most in '{expected}'"
        if others and others[0][1] > _ODD:
            frames = f"'{frame}' and '{others[0][0]}'"
            return f"clouds in frames {frames}: name that of the poses (camera_frame)"
        return None

    def _pose_at(self, stamp: int, frame: str) -> PoseRecord:
        """A sensor's pose, once the places of the body and of teammates are known too."""
        self._body.check_known_at(stamp)
        pose = self._poses.at(stamp, frame)
        newest = max(self._streams[frame].newest, self._pose_stamp, self._body.newest_stamp)
        self._teammates.check_known_at(stamp, newest)
        return pose
