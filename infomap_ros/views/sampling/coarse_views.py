"""What a few rays per view meet: cheap sums over the space in sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.information.information_weights import InformationWeights
from infomap_ros.views.information.rays import camera_rays
from infomap_ros.views.sampling import sight_kernels
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation

_RAYS = (9, 7)  # of a coarse_view, across and down
_RAYS_IN_PLANE = 45
_STEP = 0.1  # [m] of the march along them
_FADE = 0.5  # [m] of unknown space behind which a glance expects little


@dataclass(frozen=True, eq=False)
class CoarseViews:
    """What a few rays per view meet; volumes as seen through the pyramids that rays stand for.

    Attributes:
        unknown: unknown volume in sight, shape (M,) [m^3].
        known: known volume in sight, shape (M,) [m^3].
        wanted: share of what the view tells of the region that is wanted, by interests, shape (M,).
        left: share of what is wanted that teammates leave, shape (M,).
    """

    unknown: FloatArray
    known: FloatArray
    wanted: FloatArray
    left: FloatArray


def full_volume(situation: Situation) -> float:
    """Volume that the camera sees where nothing hides it [m^3]; in a plane that of one layer."""
    camera, reach = situation.camera, situation.max_range
    if situation.is_planar:
        size = situation.voxel_map.config.voxel_size
        return float(camera_rays(camera, 1.0, planar=True)[1].sum()) * reach**2 / 2.0 * size
    return camera.width * camera.height / (camera.fx * camera.fy) * reach**3 / 3.0


def coarse_view_at(
    situation: Situation,
    surroundings: Surroundings,
    information_weights: InformationWeights,
    poses: FloatArray,
) -> CoarseViews:
    """Send a few rays from each view.

    Args:
        situation: what is known.
        surroundings: its known space.
        information_weights: what of the information is wanted, by voxel.
        poses: ``T_map_camera``, shape (M, 4, 4).
    """
    size = surroundings.voxel_size
    rays, angle = _rays(situation)
    bounds = np.stack([situation.region.low, situation.region.high]) / size
    sums = np.zeros((len(poses), 5))
    sight_kernels.coarse_view(
        surroundings.states,
        information_weights.kinds,
        information_weights.weights,
        bounds - surroundings.window.first,
        poses[:, :3, 3] / size - surroundings.window.first,
        np.ascontiguousarray(rays @ poses[:, :3, :3].transpose(0, 2, 1)),
        situation.max_range / size,
        max(1.0, _STEP / size),
        _FADE / size,
        1 if situation.is_planar else 2,
        sums,
    )
    volume = angle * size**3
    told, wanted = np.maximum(sums[:, 2], 1e-12), np.maximum(sums[:, 3], 1e-12)
    return CoarseViews(
        sums[:, 0] * volume, sums[:, 1] * volume, sums[:, 3] / told, sums[:, 4] / wanted
    )


def _rays(situation: Situation) -> tuple[FloatArray, float]:
    """Unit directions in the camera frame, (N, 3), and the angle that each stands for [sr]."""
    camera = situation.camera
    if situation.is_planar:
        rays, angles = camera_rays(camera, camera.field_of_view[0] / _RAYS_IN_PLANE, planar=True)
        return rays, float(angles.mean())
    u, v = np.meshgrid(*((np.arange(n) + 0.5) / n for n in _RAYS))
    pixels = u * camera.width - 0.5, v * camera.height - 0.5
    rays = np.stack(
        [
            (pixels[0] - camera.cx) / camera.fx,
            (pixels[1] - camera.cy) / camera.fy,
            np.ones(u.shape),
        ],
        axis=-1,
    ).reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1, keepdims=True)
    solid_angle = 1.0 / (camera.fx * camera.fy) * camera.width * camera.height / len(rays)
    return rays / lengths, solid_angle * float(np.mean(lengths**-3))
