"""Information metrics of others, for comparison.

Isler et al. (2016, doi:10.1109/ICRA.2016.7487527) and Delmerico et al. (2018,
doi:10.1007/s10514-017-9634-0) sum the information of the voxels that rays cross up to the first
surface, ray by ray: a voxel that many rays cross counts as often. Average entropy is Kriegel et al.
(2015, doi:10.1007/s11554-013-0386-6), the area factor Vasquez-Gomez et al. (2014,
doi:10.5772/58759), both as Delmerico et al. compare them.

Sums are over the sensor's own pixels, one ``pixel_angle`` squared each, whatever number of rays is
cast for them. An unknown voxel has p = 1/2 and hides accordingly. Voxels outside the region hide
what is behind them but do not count. The noise of the sensor does not matter to any of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_cdt

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import OCCUPIED, VoxelMap
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE
from infomap_ros.views.information import crossing_kernels as sums_of
from infomap_ros.views.information.field import VisibleField, workers_of
from infomap_ros.views.information.observation_value import entropy_of
from infomap_ros.views.information.view_query import FINEST, ViewQuery

IntArray = NDArray[np.int64]

_WANTED_OCCUPIED, _WANTED_OCCPLANE = 0.2, 0.8


def occlusion_aware(query: ViewQuery) -> FloatArray:
    """Sum of the entropies of all voxels times the probability to see them, shape (M,) [bits]."""
    return _sums(query)[:, sums_of.OCCLUSION_AWARE]


def unobserved_voxels(query: ViewQuery) -> FloatArray:
    """As `occlusion_aware`, of unknown voxels only, shape (M,) [bits]."""
    return _sums(query)[:, sums_of.UNOBSERVED]


def rear_side_voxel(query: ViewQuery) -> FloatArray:
    """Pixels whose ray meets a surface from its unknown rear side, shape (M,) [1]."""
    return _sums(query)[:, sums_of.REAR_SIDE]


def rear_side_entropy(query: ViewQuery) -> FloatArray:
    """As `occlusion_aware`, of surfaces met from behind and of the unknown voxels before them.

    Shape (M,) [bits]; of the unknown voxels those in a row right before the surface.
    """
    return _sums(query)[:, sums_of.REAR_SIDE_ENTROPY]


def proximity_count(query: ViewQuery) -> FloatArray:
    """Sum over unknown voxels of how much nearer than ``proximity`` a surface is, shape (M,).

    In steps from voxel to voxel [voxels]. Isler et al. count voxels behind surfaces, by the
    distance behind; here any unknown voxel near a surface, which does not need a record of the
    scans.
    """
    return _sums(query, near_surfaces=True)[:, sums_of.PROXIMITY]


def average_entropy(query: ViewQuery) -> FloatArray:
    """Mean entropy of the voxels on rays that end at a surface, shape (M,) [bits per voxel]."""
    sums = _sums(query)
    count = sums[:, sums_of.SURFACE_RAY_VOXELS]
    return np.asarray(sums[:, sums_of.SURFACE_RAY_ENTROPY] / np.where(count > 0.0, count, 1.0))


def area_factor(query: ViewQuery) -> FloatArray:
    """How near the image comes to one fifth known surface and four fifths occlusion, shape (M,).

    In [0, 2], without unit: f(share of rays that meet a surface first) + f(share that leave free
    space into unknown first), f being 1 at the wanted share and 0 at 0 and 1.
    """
    sums = _sums(query)
    rays = sums[:, sums_of.RAYS]
    occupied = sums[:, sums_of.FIRST_SURFACE] / np.where(rays > 0.0, rays, 1.0)
    occplane = sums[:, sums_of.FIRST_UNKNOWN] / np.where(rays > 0.0, rays, 1.0)
    return near_share(occupied, _WANTED_OCCUPIED) + near_share(occplane, _WANTED_OCCPLANE)


def near_share(share: ArrayLike, wanted: float) -> FloatArray:
    """Cubics with f(0) = f(1) = 0 and a flat top f(wanted) = 1 (Vasquez-Gomez et al. 2014)."""
    x = np.asarray(share, dtype=np.float64)
    t = np.where(x <= wanted, x / wanted, (1.0 - x) / (1.0 - wanted))
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _sums(query: ViewQuery, near_surfaces: bool = False) -> FloatArray:
    """Sums over the pixels of each view, shape (M, sums_of.COLUMNS)."""
    sums = np.zeros((len(query.poses), sums_of.COLUMNS))
    if len(query.poses) == 0:
        return sums
    m, config, field = query.voxel_map, query.config, query.finest_field()
    placed = query.placed_in(field)
    p, known = FINEST.probabilities(), FINEST.known()
    nearness, first_near = np.zeros((0, 0, 0), np.float32), np.zeros(3, np.int64)
    if near_surfaces:
        nearness, first_near = _nearness(m, field, config.proximity)

    def cast(_: int, first: int, last: int) -> None:
        sums_of.add_crossings(
            placed.poses[first:last], placed.rays, placed.angles / config.pixel_angle**2,
            placed.box, query.max_range / m.config.voxel_size, field.directory, field.codes, p,
            entropy_of(p), known, nearness, first_near, sums[first:last],
        )  # fmt: skip

    workers_of(query.threads).run(cast, len(sums))
    return sums


def _nearness(m: VoxelMap, field: VisibleField, reach: int) -> tuple[NDArray[np.float32], IntArray]:
    """`reach` less the steps to the nearest surface, at least 0, by voxel.

    Returns:
        An array that holds the field and all voxels within reach of it, float32; and the index of
        its first voxel relative to the field, shape (3,).
    """
    size = field.voxel_size
    low = (field.first * BLOCK_SIDE - 2 * reach + 0.5) * size
    shape = np.array(field.directory.shape) * BLOCK_SIDE + 4 * reach
    surface = m.window(low, low + (shape - 1) * size).states() == OCCUPIED
    first = np.full(3, -2 * reach)
    if not surface.any():
        return np.zeros((0, 0, 0), np.float32), first
    steps = distance_transform_cdt(~surface, "taxicab")
    return np.maximum(reach - steps, 0).astype(np.float32), first
