"""Camera pose, fiducials and kept poses with their joint covariance, in invariant errors.

Errors are right-invariant: with the rotation error theta and the position errors xi,

    R_true = Exp(theta) R            p_true = Exp(theta) p + J(theta) xi_p
    f_true = Exp(theta) f + J(theta) xi_f            (J: left Jacobian)

for the camera (R, p) and every fiducial f. A fiducial seen from the camera depends on xi_f - xi_p
alone, so the filter cannot take a rotation or shift of everything for something that it has seen,
whatever the estimate: that makes it consistent where the usual filter becomes too sure of itself.
A kept pose has its own theta and xi. A clone is the error of an earlier pose without its value, so
that what later errors have in common with it can be read from the covariance.

The calibration is off by three small numbers c = (o, s, e) that all measurements share: an inverse
depth 1/z is measured as (1 + s)/z + o, and a focal length f works as (1 + e) f. A point y in the
camera frame was then taken for another, so its error is also ``D(y) c`` (`calibration_shifts`).
Such a point seen from the same place again shows nothing of that, from elsewhere it does. The
offset o is estimated. Scale s and focal length e are considered: nothing that is seen tells the
scale, and all that warps images would be taken for the focal length, so neither is estimated nor
has a say in what is; what their errors do to all others is followed beside the covariance (S. F.
Schmidt, Advances in Control Systems 3, 1966), and counts in what the filter tells.

A. Barrau, S. Bonnabel, "An EKF-SLAM algorithm with consistency properties", arXiv:1510.06263;
T. Zhang et al., IEEE RA-L 2(2), 2017, doi:10.1109/LRA.2017.2651376.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.lie import exponential, left_jacobian, renormalized, skews
from infomap_ros.localization.filter.motion_prior import MotionPrior

IntArray = NDArray[np.int64]

CAMERA_XI = 0
CAMERA_THETA = 1
FIXED_BLOCKS = 3
"""Blocks of the camera and the calibration."""
CALIBRATION = slice(6, 9)
"""Rows of the calibration's error."""
_OFFSET, _CONSIDERED = 6, slice(7, 9)  # rows of the calibration
_LEAST_SHARE = 0.1  # of the prior's sigma, below which the offset is not believed
_BLOCK = 3  # rows of one error vector
_TILE = 160  # rows of the covariance that are updated at a time: they stay in the cache


class InvariantState:
    """The state of the filter: values, and the covariance of their invariant errors.

    The covariance consists of blocks of three: camera xi and theta and the calibration first, then
    the fiducials' xi and the kept poses' and clones' xi and theta in any order.

    Args:
        T_map_camera: shape (4, 4).
        covariance: of the error (xi, theta), shape (6, 6).
        capacity: most blocks of three that will be needed, `FIXED_BLOCKS` included.
        calibration_sigmas: of (o, s, e), shape (3,) [1/m, 1, 1]; 0 where it is exact.
    """

    def __init__(
        self,
        T_map_camera: FloatArray,
        covariance: FloatArray,
        capacity: int,
        calibration_sigmas: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.T_map_camera = T_map_camera.copy()
        self.calibration: FloatArray = np.zeros(3)
        self.ids: IntArray = np.zeros(0, np.int64)
        self.positions: FloatArray = np.zeros((0, 3))
        self.stamps: IntArray = np.zeros(0, np.int64)
        self.kept: FloatArray = np.zeros((0, 4, 4))
        self._fiducial_blocks: IntArray = np.zeros(0, np.int64)
        self._kept_blocks: IntArray = np.zeros((0, 2), np.int64)
        self._clone_blocks: IntArray = np.zeros((0, 2), np.int64)
        self._buffer = np.zeros((_BLOCK * capacity, _BLOCK * capacity))
        self._blocks = FIXED_BLOCKS
        self.P[:6, :6] = covariance
        sigmas = np.asarray(calibration_sigmas, dtype=float)
        self.P[_OFFSET, _OFFSET] = sigmas[0] ** 2
        self._errors_by_considered = np.zeros((_BLOCK * capacity, 2))
        self.considered[_CONSIDERED] = np.diag(sigmas[1:])
        self._least_offset = float(_LEAST_SHARE**2 * self.P[_OFFSET, _OFFSET])

    @property
    def P(self) -> FloatArray:
        """Joint covariance, shape (n, n); a view."""
        size = _BLOCK * self._blocks
        return self._buffer[:size, :size]

    @property
    def considered(self) -> FloatArray:
        """What one sigma of scale and of focal length does to all errors, shape (n, 2); a view."""
        return self._errors_by_considered[: _BLOCK * self._blocks]

    def covariance(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> FloatArray:
        """Of errors, with what was considered; rows and columns broadcast, as in indexing."""
        considered = (self.considered[rows] * self.considered[columns]).sum(axis=-1)
        return np.asarray(self.P[rows, columns] + considered)

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

    def apparent_errors(
        self, indices: NDArray[np.int64], T_map_camera: FloatArray, others: NDArray[np.int64]
    ) -> FloatArray:
        """Covariance of where fiducials seem to be from the camera with errors, shape (3M, K).

        Measured with a wrong calibration a fiducial seems to be elsewhere, so its error as seen is
        ``xi_f - xi_p - R D(y) c``.

        Args:
            indices: of M fiducials.
            T_map_camera: from where they are seen, shape (4, 4).
            others: rows of the other errors, shape (K,).
        """
        errors = self.P[:, others]
        shifts = self._shifts_as_seen(indices, T_map_camera)
        return _apparent(errors, self.fiducial_rows(indices).ravel(), shifts)

    def apparent_considered(
        self, indices: NDArray[np.int64], T_map_camera: FloatArray
    ) -> FloatArray:
        """As `apparent_errors`: what one sigma of scale and focal length does, shape (3M, 2)."""
        shifts = self._shifts_as_seen(indices, T_map_camera)
        return _apparent(self.considered, self.fiducial_rows(indices).ravel(), shifts)

    def apparent_covariance(
        self, indices: NDArray[np.int64], T_map_camera: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Of where fiducials seem to be from the camera, shape (3M, 3M), and with theta, (3, 3M).

        Args:
            indices: of M fiducials.
            T_map_camera: from where they are seen, shape (4, 4).
        """
        count, rows = len(indices), self.fiducial_rows(indices).ravel()
        fixed = _BLOCK * FIXED_BLOCKS
        others = np.concatenate([np.arange(fixed), rows])
        errors = self.apparent_errors(indices, T_map_camera, others)
        shifts = self._shifts_as_seen(indices, T_map_camera)
        covariance = errors[:, fixed:] - np.tile(errors[:, :3], count)
        covariance -= errors[:, CALIBRATION] @ shifts.T
        return covariance, errors[:, 3:6].T

    def _shifts_as_seen(self, indices: NDArray[np.int64], T_map_camera: FloatArray) -> FloatArray:
        rotation, position = T_map_camera[:3, :3], T_map_camera[:3, 3]
        points = (self.positions[indices] - position) @ rotation
        return np.asarray((rotation @ calibration_shifts(points)).reshape(-1, 3))

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

    def learn(self, error: FloatArray, white: FloatArray, white_considered: FloatArray) -> None:
        """Take an error out of the values, and what was learned of it out of the covariance.

        The offset of the disparities is never held to be known beyond a share of its prior, for
        errors of matching are no white noise.

        Args:
            error: shape (n,).
            white: ``L^-1 H P`` of measurements whose innovation has the covariance ``L L^T``, shape
                (k, n).
            white_considered: ``L^-1 H`` times `considered`, shape (k, 2).
        """
        self.add_to_covariance(-white.T, white)
        self.considered[:] -= white.T @ white_considered
        self.P[_OFFSET, _OFFSET] = max(self.P[_OFFSET, _OFFSET], self._least_offset)
        self.correct(error)

    def correct(self, error: FloatArray) -> None:
        """Take an error, shape (n,), out of the values."""
        theta, xi = error[3:6], error[:3]
        turn, jacobian = exponential(theta), left_jacobian(theta)
        moved = self.T_map_camera.copy()
        moved[:3, :3] = turn @ moved[:3, :3]
        moved[:3, 3] = turn @ moved[:3, 3] + jacobian @ xi
        self.T_map_camera = renormalized(moved)
        self.calibration = self.calibration + error[CALIBRATION]
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
            points: in the camera frame, by the calibration as it is known, shape (M, 3) [m].
            covariances: of the points beside that of the calibration, shape (M, 3, 3) [m^2]; of all
                together, shape (3M, 3M), where a size tells how far off they are, not a range.
        """
        by_size = covariances.ndim == 2
        rotation = self.T_map_camera[:3, :3]
        first = self._blocks
        blocks = np.arange(first, first + len(ids), dtype=np.int64)
        self._copy_blocks(np.full(len(ids), CAMERA_XI))
        rows, P = _rows(blocks), self.P
        shifts, added = calibration_shifts(points), rows.ravel()
        if by_size:
            shifts[:, :, ::2] = 0.0
            shifts[:, 2, 2] = points[:, 2]  # a tag in a longer lens looks nearer
        shifts = (rotation @ shifts).reshape(-1, 3)
        self.considered[added] += shifts @ self.considered[CALIBRATION]
        P[added] += shifts @ P[CALIBRATION]
        P[:, added] += P[:, CALIBRATION] @ shifts.T
        if by_size:
            turn = np.kron(np.eye(len(ids)), rotation)
            self._buffer[np.ix_(added, added)] += turn @ covariances @ turn.T
        else:
            self._buffer[rows[:, :, None], rows[:, None, :]] += rotation @ covariances @ rotation.T
        self._name(ids, points @ rotation.T + self.T_map_camera[:3, 3], blocks)

    def place_fiducials(self, ids: IntArray, positions: FloatArray, covariance: FloatArray) -> None:
        """Add points whose places in the map are given.

        Args:
            ids: shape (M,), none of them there yet.
            positions: shape (M, 3) [m].
            covariance: of all together, shape (3M, 3M) [m^2].
        """
        blocks = np.arange(self._blocks, self._blocks + len(ids), dtype=np.int64)
        self._copy_blocks(np.full(len(ids), CAMERA_THETA))
        rows, over = _rows(blocks), skews(positions)  # whatever theta is: xi = noise + f x theta
        for errors in (self.P, self.P.T, self.considered):
            errors[rows] = over @ errors[rows]
        self._buffer[np.ix_(rows.ravel(), rows.ravel())] += covariance
        self._name(ids, positions, blocks)

    def _name(self, ids: IntArray, positions: FloatArray, blocks: IntArray) -> None:
        self.ids = np.concatenate([self.ids, ids])
        self.positions = np.vstack([self.positions, positions])
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
        self.considered[clones[index]] = self.considered[rows]

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
            "calibration": self.calibration.copy(),
            "least_offset": np.array(self._least_offset),
            "ids": self.ids.copy(),
            "positions": self.positions.copy(),
            "stamps": self.stamps.copy(),
            "kept": self.kept.copy(),
            "fiducial_blocks": self._fiducial_blocks.copy(),
            "kept_blocks": self._kept_blocks.copy(),
            "clone_blocks": self._clone_blocks.copy(),
            "covariance": self.P.copy(),
            "considered": self.considered.copy(),
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
        state.calibration = arrays["calibration"].copy()
        state._least_offset = float(arrays["least_offset"])
        state.ids, state.positions = arrays["ids"].copy(), arrays["positions"].copy()
        state.stamps, state.kept = arrays["stamps"].copy(), arrays["kept"].copy()
        state._fiducial_blocks = arrays["fiducial_blocks"].copy()
        state._kept_blocks = arrays["kept_blocks"].copy()
        state._clone_blocks = arrays["clone_blocks"].copy()
        state._blocks = blocks
        state.P[:], state.considered[:] = arrays["covariance"], arrays["considered"]
        return state

    def _copy_blocks(self, sources: IntArray) -> None:
        """Append blocks whose errors equal those of others."""
        old = _BLOCK * self._blocks
        rows = _rows(sources).ravel()
        new = old + len(rows)
        self._buffer[old:new, :old] = self._buffer[rows, :old]
        self._buffer[:old, old:new] = self._buffer[old:new, :old].T
        self._buffer[old:new, old:new] = self._buffer[np.ix_(rows, rows)]
        self._errors_by_considered[old:new] = self._errors_by_considered[rows]
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
        self.considered[target] = self.considered[source]
        for table in (self._fiducial_blocks, self._kept_blocks, self._clone_blocks):
            moved = np.searchsorted(tail, table)
            moved[moved == len(tail)] = 0
            is_moved = np.isin(table, tail)
            table[is_moved] = inside[moved[is_moved]]
        self._blocks = remaining


def _apparent(errors: FloatArray, rows: IntArray, shifts: FloatArray) -> FloatArray:
    """Rows of where fiducials seem to be from the camera: of their own, the camera's, and D."""
    camera = np.tile(np.arange(3), len(rows) // 3)
    return np.asarray(errors[rows] - errors[camera] - shifts @ errors[CALIBRATION])


def calibration_shifts(points: FloatArray) -> FloatArray:
    """Derivatives of points by the calibration with which they were measured, shape (M, 3, 3).

    Args:
        points: in the camera frame, shape (M, 3) [m].
    """
    shifts = np.stack([points[:, 2:] * points, points, -points], axis=2)
    shifts[:, 2, 2] = 0.0
    return np.asarray(shifts)


def _rows(blocks: IntArray) -> IntArray:
    """Rows of blocks, shape (..., 3)."""
    return np.asarray(_BLOCK * blocks[..., None] + np.arange(_BLOCK))
