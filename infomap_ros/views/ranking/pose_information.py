"""What an uncertain pose costs in bits: w_LE of eq. (11), derived from the map's own information.

A scan is merged with the pose error that all its points share, once. A surface voxel gets from it
the variance r^2 + s^2 along its normal instead of r^2, where r is the sigma of the range in a voxel
(`observation_value.voxel_observation`) and s the pose's sigma along the normal. So the scan tells

    b(s) = 0.5 log2((r^2 + s^2) / r^2)

bits less about where the surface is, and a way on which s grows from s0 to s1 costs b(s1) - b(s0)
bits in each surface voxel that the view sees. A surface that fills the image, faces the camera and
is L away has n = Omega L^2 / v^2 voxels of size v, with the image's solid angle Omega. For L stands
half the camera's range. Over the bits F of a view into nothing but unknown space this is

    LE = n (b(s1) - b(s0)) / F    [full views]

which is subtracted with the weight 1. F is proportional to Omega as well, so that the field of view
does not count. With v the number n grows as v^-2 and F as v^-3: in finer maps a millimeter costs a
smaller share of a full view, as their full views tell more. Normals point anywhere, so s^2 is a
third of the trace of the position covariance. A pair of 640 x 480 pixels, f = 457 px and 12 cm
between the cameras, has r = 9 mm at 2 m; where s is 6 mm, growth of the root of the trace by 1 mm
costs 0.0013 full views in voxels of 5 cm and 0.0009 in voxels of 2 cm, and growth by 10 mm 0.014
and 0.010.

Not counted: what the rotation error moves, and that an offset of the whole map (the target's error)
is in every scan and cannot be avoided by another way.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.information.information_config import InformationConfig
from infomap_ros.views.information.observation_value import voxel_observation
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.situation import Situation

_SURFACE = 0.5
"""Distance of the surface that fills the image, as a share of the camera's range."""


def pose_information_loss(
    situation: Situation, sensor: InformationConfig, errors: ArrayLike
) -> FloatArray:
    """Share of a full view that scans lose by the growth of the pose's sigma; see the module.

    Args:
        situation: pose covariance, camera and map now.
        sensor: noise law.
        errors: growth of the position sigma (root of the trace) up to each view, shape (M,) [m].

    Returns:
        Shape (M,) [full views]; negative where the pose gets better known.
    """
    grid, camera = situation.voxel_map.config, situation.camera
    distance = _SURFACE * situation.max_range
    across, down = 0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy
    solid_angle = 4.0 * np.arctan2(across * down, np.sqrt(1.0 + across**2 + down**2))
    voxels = solid_angle * (distance / grid.voxel_size) ** 2
    bits = lost_bits(range_variance(situation, sensor), situation.pose_covariance, errors)
    return voxels * bits / _bits_of(sensor).full_view(situation)


def range_variance(situation: Situation, sensor: InformationConfig) -> float:
    """Variance of a surface in a voxel of that surface by one scan from a known pose [m^2]."""
    distance = _SURFACE * situation.max_range
    sigma, _ = voxel_observation(distance, situation.voxel_map.config, sensor)
    return float(sigma) ** 2


def lost_bits(variance: float, covariance: FloatArray, errors: ArrayLike) -> FloatArray:
    """Bits that a scan loses in a surface voxel, shape (M,).

    Args:
        variance: of the surface in the voxel by a scan from a known pose [m^2].
        covariance: of the pose now, shape (6, 6).
        errors: growth of the root of its position's trace, shape (M,) [m].
    """
    before = float(np.trace(covariance[:3, :3]))
    after = np.maximum(np.sqrt(before) + np.asarray(errors, dtype=np.float64), 0.0) ** 2
    return np.asarray(0.5 * np.log2((variance + after / 3.0) / (variance + before / 3.0)))


@lru_cache(maxsize=8)
def _bits_of(sensor: InformationConfig) -> ExpectedInformation:
    """Counts full views in bits, whatever metric rates the candidates."""
    return ExpectedInformation(config=sensor)
