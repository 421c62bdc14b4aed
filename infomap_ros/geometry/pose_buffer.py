"""Poses by time: what was the pose when this image was taken?

Where frames are in each other at a time, from edges that may carry a covariance.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.pose_uncertainty import PoseUncertainty
from infomap_ros.geometry.records import PoseRecord, TransformRecord
from infomap_ros.geometry.transforms import (
    FloatArray,
    compose_poses,
    interpolate_transforms,
    invert_transform,
)

_NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class PoseBufferConfig:
    """Configuration of `PoseBuffer`."""

    max_gap: float = parameter(
        0.5,
        "Longest time between two poses across which a pose is interpolated.",
        unit="s",
        low=0.0,
        high=3600.0,
    )
    capacity: int = setting(
        2000, "Number of poses that are kept; the oldest goes first.", low=2, high=10_000_000
    )

    def __post_init__(self) -> None:
        check_config(self)


class PoseBuffer:
    """Stamped poses of one frame in another, in order of time, and the pose between two of them.

    A pose is interpolated between two neighbors that are at most `max_gap` apart and never
    extrapolated. The covariance of an interpolated pose is the same weighted mean of the two
    covariances as the pose itself: whatever the correlation of the two errors, the covariance of
    their weighted mean is not larger than that (convexity of the square). It is unknown where one
    of them is. Motion between the two poses that is not uniform adds an error which this does not
    hold; `max_gap` bounds it.

    Going backwards in time: a pose that is older than the newest by at most `max_gap` is late
    and is put in its place. One that is older than that says that the clock was set back (a bag
    starts again), so all that was kept is forgotten first.
    """

    def __init__(self, config: PoseBufferConfig | None = None) -> None:
        self.config = config or PoseBufferConfig()
        self._max_gap = round(self.config.max_gap * _NANOSECONDS)
        self._stamps: list[int] = []
        self._poses: list[PoseRecord] = []

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def newest_stamp(self) -> int | None:
        """Stamp of the newest pose [ns], None while there is none."""
        return self._stamps[-1] if self._stamps else None

    def clear(self) -> None:
        """Forget all poses."""
        self._stamps.clear()
        self._poses.clear()

    def add(self, pose: PoseRecord) -> bool:
        """Keep a pose; one with the same stamp as another replaces it.

        Returns:
            True when time went backwards and everything older was forgotten.

        Raises:
            FrameError: it is expressed in another frame than the poses before.
        """
        jumped = bool(self._stamps) and pose.stamp < self._stamps[-1] - self._max_gap
        if jumped:
            self.clear()
        if self._poses and pose.frame_id != self._poses[-1].frame_id:
            raise FrameError(
                f"pose is expressed in frame '{pose.frame_id}', "
                f"the poses before in '{self._poses[-1].frame_id}'"
            )
        self._insert(pose)
        return jumped

    def _insert(self, pose: PoseRecord) -> None:
        place = bisect_left(self._stamps, pose.stamp)
        if place < len(self._stamps) and self._stamps[place] == pose.stamp:
            self._poses[place] = pose
            return
        self._stamps.insert(place, pose.stamp)
        self._poses.insert(place, pose)
        if len(self._stamps) > self.config.capacity:
            del self._stamps[0], self._poses[0]

    def at(self, stamp: int) -> PoseRecord:
        """The pose at a time.

        Args:
            stamp: [ns].

        Returns:
            The pose with that stamp, or the one interpolated between its neighbors.

        Raises:
            PoseUnavailableError: the stamp is older than the oldest pose, newer than the newest,
                or between two poses more than `max_gap` apart or of different origins. Its
                `reason` says which, and `may_arrive` whether a later pose can change that.
        """
        place = bisect_left(self._stamps, stamp)
        if place < len(self._stamps) and self._stamps[place] == stamp:
            return self._poses[place]
        if place == len(self._stamps):
            raise self._not_yet(stamp)
        if place == 0:
            early = (self._stamps[0] - stamp) / _NANOSECONDS
            raise PoseUnavailableError(
                f"stamp {stamp} ns is {early:.3f} s before the first pose", "before the first pose"
            )
        return self._between(place, stamp)

    def _not_yet(self, stamp: int) -> PoseUnavailableError:
        if not self._stamps:
            return PoseUnavailableError("no pose has arrived", "no pose", may_arrive=True)
        late = (stamp - self._stamps[-1]) / _NANOSECONDS
        return PoseUnavailableError(
            f"stamp {stamp} ns is {late:.3f} s after the last pose",
            "after the last pose",
            may_arrive=True,
        )

    def _between(self, place: int, stamp: int) -> PoseRecord:
        before, after = self._poses[place - 1], self._poses[place]
        gap = after.stamp - before.stamp
        if gap > self._max_gap:
            raise PoseUnavailableError(
                f"stamp {stamp} ns lies in a gap of {gap / _NANOSECONDS:.3f} s between two poses, "
                f"more than {self.config.max_gap} s",
                "gap between poses",
            )
        if _origin(before) != _origin(after):
            raise PoseUnavailableError(
                f"stamp {stamp} ns lies between poses in maps of different origins",
                "the map began anew",
            )
        fraction = (stamp - before.stamp) / gap
        return PoseRecord(
            stamp,
            before.frame_id,
            interpolate_transforms(before.transform, after.transform, fraction),
            _mean_covariance(before.covariance, after.covariance, fraction),
            before.child_frame_id,
            uncertainty=_mean_uncertainty(before.uncertainty, after.uncertainty, fraction),
        )


def _mean_covariance(
    first: FloatArray | None, second: FloatArray | None, fraction: float
) -> FloatArray | None:
    if first is None or second is None:
        return None
    return (1.0 - fraction) * first + fraction * second


def _mean_uncertainty(
    first: PoseUncertainty | None, second: PoseUncertainty | None, fraction: float
) -> PoseUncertainty | None:
    if first is None or second is None:
        return None
    names = ("drift", "white", "offset", "clock")
    pairs = ((getattr(first, name), getattr(second, name)) for name in names)
    means = ((1.0 - fraction) * one + fraction * other for one, other in pairs)
    return replace(PoseUncertainty(*means), origin=first.origin)


def _origin(pose: PoseRecord) -> int:
    return 0 if pose.uncertainty is None else pose.uncertainty.origin


MOST_FRAMES = 10_000  # a robot has some hundreds


@dataclass(frozen=True)
class _Edge:
    """Where a frame is in its parent: fixed and exact, or by poses in order of time."""

    frame_id: str
    place: FloatArray | PoseBuffer


class TransformTree:
    """A tree of frames, each placed in its parent: fixed, or by poses in order of time.

    Unlike tf2 an edge may carry a covariance, which goes into that of the whole chain. A fixed
    edge is exact; a chain with a moving edge of unknown covariance has an unknown covariance. Of
    more than ten thousand frames the one neither told nor asked for longest is forgotten.
    """

    def __init__(self, config: PoseBufferConfig | None = None) -> None:
        self._config = config or PoseBufferConfig()
        self._edges: OrderedDict[str, _Edge] = OrderedDict()  # by their children, last used last

    def add_transform(self, edge: TransformRecord) -> None:
        """Keep an edge of tf.

        Raises:
            FrameError: the child moves and has had another parent.
        """
        child, parent = edge.child_frame_id, edge.frame_id
        if edge.is_static:
            self._keep(child, _Edge(parent, edge.transform))
        else:
            self.add_pose(PoseRecord(edge.stamp, parent, edge.transform, None, child), child)

    def add_pose(self, pose: PoseRecord, child: str) -> bool:
        """Keep a pose of frame `child`, which takes the place of a fixed edge.

        Returns:
            True when time went backwards and older poses were forgotten.

        Raises:
            FrameError: the child has had another parent.
        """
        poses = known.place if (known := self._edges.get(child)) is not None else None
        if not isinstance(poses, PoseBuffer):
            poses = PoseBuffer(self._config)
        jumped = poses.add(pose)
        self._keep(child, _Edge(pose.frame_id, poses))
        return jumped

    def _keep(self, child: str, edge: _Edge) -> None:
        self._edges[child] = edge
        self._edges.move_to_end(child)
        if len(self._edges) > MOST_FRAMES:
            self._edges.popitem(last=False)

    def others_have_jumped(self, stamp: int) -> None:
        """Those who ask have jumped back to `stamp` [ns]: forget poses from far after it."""
        latest = stamp + round(self._config.max_gap * _NANOSECONDS)
        for edge in self._edges.values():
            if isinstance(edge.place, PoseBuffer) and (edge.place.newest_stamp or 0) > latest:
                edge.place.clear()

    def root_of(self, frame: str) -> str:
        """The topmost frame above `frame`.

        Raises:
            FrameError: the frames form a circle.
        """
        return self._chain_above(frame)[-1]

    def at(self, target: str, source: str, stamp: int) -> PoseRecord:
        """Place of a frame in one above it.

        Args:
            target: the frame above.
            source: the frame that is sought.
            stamp: [ns].

        Returns:
            ``T_target_source`` with its covariance in the target frame, None if unknown.

        Raises:
            FrameError: `target` is not above `source`.
            PoseUnavailableError: an edge is not known at that time.
        """
        chain = self._chain_above(source)
        if target not in chain:
            text = f"frame '{target}' is not above '{source}', whose chain is {' < '.join(chain)}"
            if len(chain) == 1:
                raise PoseUnavailableError(text, f"frame {source} unknown", may_arrive=True)
            raise FrameError(text)
        result = PoseRecord(stamp, source, np.eye(4), np.zeros((6, 6)), source)
        for child in chain[: chain.index(target)]:
            result = _compose(self._edge(child, stamp), result)
        return result

    def between(self, target: str, source: str, stamp: int) -> FloatArray:
        """Place of a frame in one of another branch; what moves above both does not matter.

        Args:
            target: the frame in which it is sought.
            source: the frame that is sought.
            stamp: [ns].

        Returns:
            ``T_target_source``, shape (4, 4).

        Raises:
            FrameError: no frame is above both.
            PoseUnavailableError: an edge is not known at that time.
        """
        above = self._chain_above(target)
        common = next((frame for frame in self._chain_above(source) if frame in above), None)
        if common is None:
            raise FrameError(f"tf does not connect '{source}' with '{target}'")
        T_common_target, T_common_source = (
            self.at(common, frame, stamp).transform for frame in (target, source)
        )
        return np.asarray(invert_transform(T_common_target) @ T_common_source)

    def _chain_above(self, frame: str) -> list[str]:
        chain = [frame]
        while (edge := self._edges.get(chain[-1])) is not None:
            self._edges.move_to_end(chain[-1])
            chain.append(edge.frame_id)
            if len(chain) > len(self._edges) + 1:
                raise FrameError(f"the frames above '{frame}' form a circle")
        return chain

    def _edge(self, child: str, stamp: int) -> PoseRecord:
        edge = self._edges[child]
        if isinstance(edge.place, PoseBuffer):
            return edge.place.at(stamp)
        return PoseRecord(stamp, edge.frame_id, edge.place, np.zeros((6, 6)), child)


def _compose(parent: PoseRecord, child: PoseRecord) -> PoseRecord:
    """``T_a_b @ T_b_c`` with covariances in their parent frames (convention of `transforms`).

    A rotation error dtheta about the origin of b moves the origin of c, which is ``R t`` away, by
    ``-skew(R t) dtheta``.
    """
    covariance = None
    if parent.covariance is not None and child.covariance is not None:
        own = parent.transform, parent.covariance
        _, covariance = compose_poses(*own, child.transform, child.covariance)
    transform = parent.transform @ child.transform
    return PoseRecord(child.stamp, parent.frame_id, transform, covariance, child.child_frame_id)
