"""Camera pose, fiducials and kept poses with their joint covariance, in invariant errors.

Errors are right-invariant: with the rotation error theta and the position errors xi,

    R_true = Exp(theta) R            p_true = Exp(theta) p + J(theta) xi_p
    f_true = Exp(theta) f + J(theta) xi_f            (J: left Jacobian)

for the camera (R, p) and every fiducial f. A fiducial seen from the camera depends on xi_f - xi_p
alone, so the filter cannot take a rotation or shift of everything for something that it has seen,
whatever the estimate: that makes it consistent where the usual filter becomes too sure of itself.
A kept pose has its own theta and xi. A clone is the error of an earlier pose without its value, so
that what later errors have in common with it can be read from the covariance.

A. Barrau, S. Bonnabel, "An EKF-SLAM algorithm with consistency properties", arXiv:1510.06263;
T. Zhang et al., IEEE RA-L 2(2), 2017, doi:10.1109/LRA.2017.2651376.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.lie import exponential, left_jacobian, renormalized, skews
from infomap_ros.localization.filter.motion_prior import MotionPrior

IntArray = NDArray[np.int64]

CAMERA_XI = 0
CAMERA_THETA = 1
_BLOCK = 3  # rows of one error vector
_TILE = 160  # rows of the covariance that are updated at a time: they stay in the cache


class InvariantState:
    """The state of the filter: values, and the covariance of their invariant errors.

    The covariance consists of blocks of three: camera xi and theta first, then the fiducials' xi
    and the kept poses' and clones' xi and theta in any order.

    Args:
        T_map_camera: shape (4, 4).
        covariance: of the error (xi, theta), shape (6, 6).
        capacity: most blocks of three that will be needed, the camera's two included.
    """

    def __init__(self, T_map_camera: FloatArray, covariance: FloatArray, capacity: int) -> None:
        self.T_map_camera = T_map_camera.copy()
        self.ids: IntArray = np.zeros(0, np.int64)
        self.positions: FloatArray = np.zeros((0, 3))
        self.stamps: IntArray = np.zeros(0, np.int64)
        self.kept: FloatArray = np.zeros((0, 4, 4))
        self._fiducial_blocks: IntArray = np.zeros(0, np.int64)
        self._kept_blocks: IntArray = np.zeros((0, 2), np.int64)
        self._clone_blocks: IntArray = np.zeros((0, 2), np.int64)
        self._buffer = np.zeros((_BLOCK * capacity, _BLOCK * capacity))
        self._blocks = 2
        self.P[:] = covariance

    @property
    def P(self) -> FloatArray:
        """Joint covariance, shape (n, n); a view."""
        size = _BLOCK * self._blocks
        return self._buffer[:size, :size]

    def fiducial_rows(self, indices: NDArray[np.int64] | slice) -> IntArray:
        """Rows of fiducials' errors, shape (M, 3)."""
        return _rows(self._fiducial_blocks[indices])

    def kept_rows(self) -> IntArray:
        """Rows of kept poses' errors (xi, theta), shape (K, 6)."""
        return _rows(self._kept_blocks).reshape(-1, 2 * _BLOCK)

    def clone_rows(self) -> IntArray:
        """Rows of clones' errors (xi, theta), shape (C, 6)."""
        return _rows(self._clone_blocks).reshape(-1, 2 * _BLOCK)

    def motion_noise(self, T_map_camera: FloatArray, turn: FloatArray) -> FloatArray:
        """How the error of a motion enters all errors, shape (n, 6).

        Args:
            T_map_camera: pose after the motion, at which to linearize, shape (4, 4).
            turn: rotation from the frame of the motion's error to the map, shape (3, 3).
        """
        noise = np.zeros((_BLOCK * self._blocks, 6))
        noise[:3, :3] = turn
        noise[:3, 3:] = skews(T_map_camera[:3, 3]) @ turn
        noise[3:6, 3:] = turn
        noise[self.fiducial_rows(slice(None)).ravel(), 3:] = (skews(self.positions) @ turn).reshape(
            -1, 3
        )
        return noise

    def expected(self, motion: MotionPrior) -> tuple[FloatArray, FloatArray]:
        """The pose after a motion, shape (4, 4), and what that adds to its error, shape (6, 6)."""
        pose = self.T_map_camera @ motion.T_before_after
        noise = self.motion_noise(pose, self.T_map_camera[:3, :3])[:6]
        return pose, noise @ motion.covariance @ noise.T

    def add_to_covariance(self, left: FloatArray, right: FloatArray) -> None:
        """Add the symmetric product ``left @ right``, shapes (n, k) and (k, n), in place."""
        P = self.P
        for begin in range(0, len(P), _TILE):
            end = min(begin + _TILE, len(P))
            P[begin:end, begin:] += left[begin:end] @ right[:, begin:]
            P[end:, begin:end] = P[begin:end, end:].T
            diagonal = P[begin:end, begin:end]
            diagonal[:] = 0.5 * (diagonal + diagonal.T)

    def correct(self, error: FloatArray) -> None:
        """Take an error, shape (n,), out of the values."""
        theta, xi = error[3:6], error[:3]
        turn, jacobian = exponential(theta), left_jacobian(theta)
        moved = self.T_map_camera.copy()
        moved[:3, :3] = turn @ moved[:3, :3]
        moved[:3, 3] = turn @ moved[:3, 3] + jacobian @ xi
        self.T_map_camera = renormalized(moved)
        fiducials = error[self.fiducial_rows(slice(None))]
        self.positions = self.positions @ turn.T + fiducials @ jacobian.T
        rows = self.kept_rows()
        turns, jacobians = exponential(error[rows[:, 3:]]), left_jacobian(error[rows[:, 3:]])
        self.kept[:, :3] = turns @ self.kept[:, :3]
        self.kept[:, :3, 3] += np.einsum("kij,kj->ki", jacobians, error[rows[:, :3]])

    def add_fiducials(self, ids: IntArray, points: FloatArray, covariances: FloatArray) -> None:
        """Add points seen from the camera.

        Args:
            ids: shape (M,), none of them there yet.
            points: in the camera frame, shape (M, 3) [m].
            covariances: of the points, shape (M, 3, 3) [m^2].
        """
        rotation = self.T_map_camera[:3, :3]
        first = self._blocks
        blocks = np.arange(first, first + len(ids), dtype=np.int64)
        self._copy_blocks(np.full(len(ids), CAMERA_XI))
        rows = _rows(blocks)
        self._buffer[rows[:, :, None], rows[:, None, :]] += rotation @ covariances @ rotation.T
        self.ids = np.concatenate([self.ids, ids])
        self.positions = np.vstack([self.positions, points @ rotation.T + self.T_map_camera[:3, 3]])
        self._fiducial_blocks = np.concatenate([self._fiducial_blocks, blocks])

    def keep_pose(self, stamp: int) -> None:
        """Keep the camera's present pose."""
        first = self._blocks
        self._copy_blocks(np.array([CAMERA_XI, CAMERA_THETA]))
        self.stamps = np.append(self.stamps, np.int64(stamp))
        self.kept = np.concatenate([self.kept, self.T_map_camera[None]])
        self._kept_blocks = np.vstack([self._kept_blocks, [[first, first + 1]]])

    def add_clone(self) -> None:
        """Add a clone of the camera's present error."""
        first = self._blocks
        self._copy_blocks(np.array([CAMERA_XI, CAMERA_THETA]))
        self._clone_blocks = np.vstack([self._clone_blocks, [[first, first + 1]]])

    def replace_clone(self, index: int, source: int | None = None) -> None:
        """Put another clone's error, or the camera's present one, in the place of a clone's."""
        clones, P = self.clone_rows(), self.P
        rows = np.arange(2 * _BLOCK) if source is None else clones[source]
        P[clones[index]] = P[rows]
        P[:, clones[index]] = P[:, rows]

    def remove_fiducials(self, chosen: NDArray[np.bool_]) -> None:
        """Remove the fiducials of a mask, shape (N,)."""
        self._free_blocks(self._fiducial_blocks[chosen])
        self.ids, self.positions = self.ids[~chosen], self.positions[~chosen]
        self._fiducial_blocks = self._fiducial_blocks[~chosen]

    def remove_kept(self, chosen: NDArray[np.bool_]) -> None:
        """Remove the kept poses of a mask, shape (K,)."""
        self._free_blocks(self._kept_blocks[chosen].ravel())
        self.stamps, self.kept = self.stamps[~chosen], self.kept[~chosen]
        self._kept_blocks = self._kept_blocks[~chosen]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of everything, for `resume`."""
        return {
            "T_map_camera": self.T_map_camera.copy(),
            "ids": self.ids.copy(),
            "positions": self.positions.copy(),
            "stamps": self.stamps.copy(),
            "kept": self.kept.copy(),
            "fiducial_blocks": self._fiducial_blocks.copy(),
            "kept_blocks": self._kept_blocks.copy(),
            "clone_blocks": self._clone_blocks.copy(),
            "covariance": self.P.copy(),
        }

    @classmethod
    def resume(cls, arrays: Mapping[str, NDArray[Any]], capacity: int) -> InvariantState:
        """The state that `arrays` came from.

        Raises:
            InvalidInputError: it does not fit into the capacity.
        """
        blocks = len(arrays["covariance"]) // _BLOCK
        if blocks > capacity:
            raise InvalidInputError("covariance", f"{blocks} errors, at most {capacity} fit")
        state = cls(arrays["T_map_camera"], np.zeros((6, 6)), capacity)
        state.ids, state.positions = arrays["ids"].copy(), arrays["positions"].copy()
        state.stamps, state.kept = arrays["stamps"].copy(), arrays["kept"].copy()
        state._fiducial_blocks = arrays["fiducial_blocks"].copy()
        state._kept_blocks = arrays["kept_blocks"].copy()
        state._clone_blocks = arrays["clone_blocks"].copy()
        state._blocks = blocks
        state.P[:] = arrays["covariance"]
        return state

    def _copy_blocks(self, sources: IntArray) -> None:
        """Append blocks whose errors equal those of others."""
        old = _BLOCK * self._blocks
        rows = _rows(sources).ravel()
        new = old + len(rows)
        self._buffer[old:new, :old] = self._buffer[rows, :old]
        self._buffer[:old, old:new] = self._buffer[old:new, :old].T
        self._buffer[old:new, old:new] = self._buffer[np.ix_(rows, rows)]
        self._blocks += len(sources)

    def _free_blocks(self, freed: IntArray) -> None:
        """Take blocks out of the covariance; the last ones fill the gaps."""
        remaining = self._blocks - len(freed)
        inside = freed[freed < remaining]
        tail = np.setdiff1d(np.arange(remaining, self._blocks), freed)
        source, target = _rows(tail).ravel(), _rows(inside).ravel()
        P = self.P
        P[target] = P[source]
        P[:, target] = P[:, source]
        for table in (self._fiducial_blocks, self._kept_blocks, self._clone_blocks):
            moved = np.searchsorted(tail, table)
            moved[moved == len(tail)] = 0
            is_moved = np.isin(table, tail)
            table[is_moved] = inside[moved[is_moved]]
        self._blocks = remaining


def _rows(blocks: IntArray) -> IntArray:
    """Rows of blocks, shape (..., 3)."""
    return np.asarray(_BLOCK * blocks[..., None] + np.arange(_BLOCK))
