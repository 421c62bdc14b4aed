"""Which places of the base bring an arm's camera to a view.

Many random postures of the arm are kept with the camera pose that each gives. For a wanted view,
those whose camera looks up or down as steeply, and stands as high above the ground, each name one
place and heading of the base that brings the camera there: the inversion of the arm's reachability
(Vahrenkamp, Asfour and Dillmann 2013, doi:10.1109/ICRA.2013.6630839).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.driving_posture import sample_postures
from infomap_ros.motion.arm.own_view import OwnView, most_covered
from infomap_ros.motion.collision.body import CollisionBody

_HEIGHT_BIN = 0.05  # [m]
_STEEPNESS_BIN = 0.1  # [rad]


@dataclass(frozen=True, eq=False)
class ArmPostures:
    """Random postures that touch nothing of the robot itself and see past it.

    Attributes:
        q: positions of the arm, shape (K, n) [rad or m].
        positions: of the camera, base frame, shape (K, 3) [m].
        azimuths: of its viewing direction about the base's z axis, shape (K,) [rad].
        steepness: angle of its viewing direction above the base's x-y plane, shape (K,) [rad].
        radii: farthest that a camera is from the base's z axis, by its height and steepness in
            bins, 0 where there is none, shape (A, B) [m].
        lowest: height of the first bin [m].
        most_covered: share beyond which a posture is not taken for a view.
    """

    q: FloatArray
    positions: FloatArray
    azimuths: FloatArray
    steepness: FloatArray
    radii: FloatArray
    lowest: float
    most_covered: float

    @classmethod
    def of(cls, body: CollisionBody, count: int, own_view: OwnView | None = None) -> ArmPostures:
        """Draw `count` postures and keep those without contact; always the same.

        Args:
            body: of the robot.
            count: of postures.
            own_view: to leave out those in which the camera sees too much of the robot.
        """
        q = sample_postures(body, count)
        covered = np.zeros(len(q)) if own_view is None else own_view.covered(q)
        most = most_covered(covered)
        q = q[covered <= most]
        poses = body.chain.camera_pose(q)
        positions, directions = poses[:, :3, 3], poses[:, :3, 2]
        steepness = np.arcsin(np.clip(directions[:, 2], -1.0, 1.0))
        lowest = float(positions[:, 2].min(initial=0.0))
        radii = _radii(positions, steepness, lowest)
        azimuths = np.arctan2(directions[:, 1], directions[:, 0])
        return cls(q, positions, azimuths, steepness, radii, lowest, most)

    @property
    def farthest(self) -> float:
        """Farthest that a camera is from the base's z axis [m]."""
        return float(self.radii.max(initial=0.0))

    def radius_for(self, heights: FloatArray, steepness: FloatArray) -> FloatArray:
        """Farthest that a camera of some height and steepness is from the base's z axis.

        Args:
            heights: above the base's origin, shape (...) [m].
            steepness: shape (...) [rad].

        Returns:
            Shape (...) [m]; 0 where no posture comes near, or the height is NaN.
        """
        rows, columns = _bins(np.nan_to_num(heights, nan=-np.inf), steepness, self.lowest)
        inside = (rows >= 0) & (rows < self.radii.shape[0])
        found = self.radii[np.clip(rows, 0, self.radii.shape[0] - 1), columns]
        return np.where(inside, found, 0.0)

    def places_for(
        self, T_map_camera: FloatArray, tolerance: float
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Places of a level base that bring the camera over a point, looking in a direction.

        Args:
            T_map_camera: the wanted view, shape (4, 4).
            tolerance: of the steepness [rad].

        Returns:
            x, y [m] and yaw [rad] of the base, shape (P, 3); the height that its origin must have,
            shape (P,) [m, map]; and the posture of each, shape (P,).
        """
        direction, target = T_map_camera[:3, 2], T_map_camera[:3, 3]
        steepness = np.arcsin(np.clip(direction[2], -1.0, 1.0))
        chosen = np.flatnonzero(np.abs(self.steepness - steepness) <= tolerance)
        yaws = np.arctan2(direction[1], direction[0]) - self.azimuths[chosen]
        x, y = self.positions[chosen, 0], self.positions[chosen, 1]
        cosine, sine = np.cos(yaws), np.sin(yaws)
        places = np.column_stack(
            [target[0] - cosine * x + sine * y, target[1] - sine * x - cosine * y, yaws]
        )
        return places, target[2] - self.positions[chosen, 2], chosen


def _bins(
    heights: FloatArray, steepness: FloatArray, lowest: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    rows = np.floor(np.clip((heights - lowest) / _HEIGHT_BIN, -1.0, 1e6)).astype(np.int64)
    return rows, np.floor((steepness + 0.5 * np.pi) / _STEEPNESS_BIN).astype(np.int64)


def _radii(positions: FloatArray, steepness: FloatArray, lowest: float) -> FloatArray:
    """Largest radius in each bin and its neighbors, as few postures fall into one."""
    rows, columns = _bins(positions[:, 2], steepness, lowest)
    radii = np.zeros((int(rows.max(initial=0)) + 1, int(np.pi / _STEEPNESS_BIN) + 1))
    np.maximum.at(radii, (rows, columns), np.linalg.norm(positions[:, :2], axis=1))
    padded = np.pad(radii, 1)
    shifted = [
        padded[1 + i : 1 + i + radii.shape[0], 1 + j : 1 + j + radii.shape[1]]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
    ]
    return np.asarray(np.max(shifted, axis=0))
