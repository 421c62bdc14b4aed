"""The default metric: what a view is expected to take off the entropy of the map."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.information.field import VisibleField, workers_of
from infomap_ros.views.information.gains import field_around, ray_arrays
from infomap_ros.views.information.ray_kernels import view_bits
from infomap_ros.views.information.view_query import ViewQuery


def expected_entropy_reduction(query: ViewQuery) -> FloatArray:
    """Bits that one scan from each pose is expected to take off the map's entropy, shape (M,).

    The sum over the voxels in view of what one observation of each is expected to tell, see
    `views.observation_value`, times the probability that known obstacles before it do not hide it.
    An unknown voxel has 1 bit to lose, as `VoxelMap.entropy_bits` counts it; a known one counts
    with ``known_weight``. It is 0 if everything in view is known and empty; falls when the view is
    occluded; grows with every unknown voxel in view; and grows where known voxels are nearer to
    0.5: the intent that Sujan and Dubowsky (2005, doi:10.1177/0278364905051774) state for eqs. (7)
    to (9). With a ``wanted_sigma`` it also counts what the scan tells about where surfaces lie.

    Bits depend on the voxel size, as entropy does; bits times the volume of a voxel is a volume of
    unknown space that does not.
    """
    if len(query.poses) == 0:
        return np.zeros(0)
    m, config = query.voxel_map, query.config
    return bits_in(field_around(m, query.places, query.max_range, config, query.threads), query)


def bits_in(field: VisibleField, query: ViewQuery) -> FloatArray:
    """The same by a field that was prepared about the views."""
    threads = query.threads
    arrays = ray_arrays(field, query.voxel_map, query.max_range, query.config)
    poses, rays, angles, box = query.placed_in(field)
    parts = np.zeros((threads, len(poses)))

    def cast(part: int, first: int, last: int) -> None:
        view_bits(poses, rays[first:last], angles[first:last], box, arrays, parts[part])

    workers_of(threads).run(cast, len(rays))
    return np.asarray(parts.sum(axis=0))
