"""Where frames are in each other at a time, from edges that may carry a covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.records import PoseRecord, TransformRecord
from infomap_ros.geometry.transforms import FloatArray, compose_poses


@dataclass(frozen=True)
class _Static:
    """An edge that never changes and is exact."""

    frame_id: str
    transform: FloatArray


class TransformTree:
    """A tree of frames, each placed in its parent: fixed, or by poses in order of time.

    Unlike tf2 an edge may carry a covariance, which goes into that of the whole chain. A fixed
    edge is exact; a chain with a moving edge of unknown covariance has an unknown covariance.
    """

    def __init__(self, config: PoseBufferConfig | None = None) -> None:
        self._config = config or PoseBufferConfig()
        self._static: dict[str, _Static] = {}
        self._moving: dict[str, PoseBuffer] = {}
        self._parents: dict[str, str] = {}

    @property
    def frames(self) -> frozenset[str]:
        """Names of all frames."""
        return frozenset(self._parents) | frozenset(self._parents.values())

    def add_transform(self, edge: TransformRecord) -> None:
        """Keep an edge of tf.

        Raises:
            FrameError: the child moves and has had another parent.
        """
        if edge.is_static:
            self._static[edge.child_frame_id] = _Static(edge.frame_id, edge.transform)
            self._parents[edge.child_frame_id] = edge.frame_id
            return
        pose = PoseRecord(edge.stamp, edge.frame_id, edge.transform, None, edge.child_frame_id)
        self.add_pose(pose, edge.child_frame_id)

    def add_pose(self, pose: PoseRecord, child: str) -> bool:
        """Keep a pose of frame `child`, which takes the place of a fixed edge.

        Returns:
            True when time went backwards and older poses were forgotten.

        Raises:
            FrameError: the child has had another parent.
        """
        poses = self._moving.setdefault(child, PoseBuffer(self._config))
        jumped = poses.add(pose)
        self._static.pop(child, None)
        self._parents[child] = pose.frame_id
        return jumped

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
        while chain[-1] in self._parents:
            chain.append(self._parents[chain[-1]])
            if len(chain) > len(self._parents) + 1:
                raise FrameError(f"the frames above '{frame}' form a circle")
        return chain

    def _edge(self, child: str, stamp: int) -> PoseRecord:
        if child in self._static:
            edge = self._static[child]
            return PoseRecord(stamp, edge.frame_id, edge.transform, np.zeros((6, 6)), child)
        return self._moving[child].at(stamp)


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
