"""How much of its image a robot's own body covers, by the posture of the arm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.kernels import place_spheres

MOST_COVERED = 0.2
"""Share of the image beyond which no posture is taken for a view: from what is left neither the
pose of the camera nor the depth at the outlines of the body can be trusted."""

_RAYS = (12, 9)  # across and down the image
_SPARE = 0.1  # of a share; where the body covers more in every posture, so much more than the least


@dataclass(frozen=True, eq=False)
class OwnView:
    """Casts a few rays through the image at the spheres of the links.

    Those of the link that carries the camera do not count: what they cover is always the same, and
    spheres are too coarse for a housing about a lens.

    Attributes:
        body: of the robot.
        rays: unit vectors in the camera frame, shape (R, 3).
        counted: which spheres of the body count, shape (S,).
    """

    body: CollisionBody
    rays: FloatArray
    counted: NDArray[np.bool_]

    @classmethod
    def of(cls, body: CollisionBody, camera: PinholeCamera) -> OwnView:
        """For the camera at the end of the arm."""
        columns, rows = (np.arange(count) + 0.5 for count in _RAYS)
        u, v = np.meshgrid(
            columns / _RAYS[0] * camera.width - 0.5, rows / _RAYS[1] * camera.height - 0.5
        )
        x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
        rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        model = body.robot.model
        frame = model.frames[model.getFrameId(body.robot.camera_frame)]
        counted = body.arrays.bodies != body.tree.bodies[frame.parentJoint]
        return cls(
            body,
            rays / np.linalg.norm(rays, axis=1, keepdims=True),
            np.repeat(counted, np.diff(body.arrays.starts)),
        )

    def covered(self, qs: FloatArray) -> FloatArray:
        """Share of the image that the body covers, shape (M,), in postures, shape (M, n)."""
        shares = np.empty(len(qs))
        if len(qs):
            T_camera_base = np.linalg.inv(self.body.chain.camera_pose(qs))[:, :3]
            tree, arrays = self.body.tree.arrays, self.body.arrays
            _cast(tree, arrays, qs, T_camera_base, self.rays, self.counted, shares)
        return shares


def most_covered(shares: FloatArray) -> float:
    """Share of the image that may be covered, by those in many postures of the arm, shape (M,)."""
    return max(MOST_COVERED, float(shares.min(initial=1.0)) + _SPARE) if len(shares) else 1.0


@njit(cache=True, nogil=True)
def _cast(
    tree: Any, body: Any, qs: Any, T_camera_base: Any, rays: Any, counted: Any, shares: Any
) -> None:
    """Shares of rays, shape (R, 3), that meet a counted sphere, for each posture."""
    spheres, meets = np.empty_like(body.spheres), np.empty(len(rays), np.bool_)
    for k in range(len(qs)):
        place_spheres(tree, body, qs[k], T_camera_base[k], spheres)
        meets[:] = False
        for s in range(len(spheres)):
            if not counted[s]:
                continue
            x, y, z, radius = spheres[s, 0], spheres[s, 1], spheres[s, 2], spheres[s, 3]
            square = x * x + y * y + z * z
            if z < -radius or square <= radius * radius:
                continue
            least = math.sqrt(square - radius * radius)
            for r in range(len(rays)):
                if rays[r, 0] * x + rays[r, 1] * y + rays[r, 2] * z >= least:
                    meets[r] = True
        shares[k] = meets.mean()
