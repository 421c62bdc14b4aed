"""Where frames are in each other at a time, from edges that may carry a covariance."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.records import PoseRecord, TransformRecord
from infomap_ros.geometry.transforms import FloatArray, compose_poses

_MOST_FRAMES = 10_000  # a robot has some hundreds


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
        known = self._edges.get(child)
        poses = None if known is None else known.place
        if not isinstance(poses, PoseBuffer):
            poses = PoseBuffer(self._config)
        jumped = poses.add(pose)
        self._keep(child, _Edge(pose.frame_id, poses))
        return jumped

    def _keep(self, child: str, edge: _Edge) -> None:
        self._edges[child] = edge
        self._edges.move_to_end(child)
        if len(self._edges) > _MOST_FRAMES:
            self._edges.popitem(last=False)

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
