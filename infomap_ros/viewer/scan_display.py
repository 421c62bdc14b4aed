"""Shows on a page how a recording is mapped or followed."""

from __future__ import annotations

import time

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.viewer.live_page import LivePage

_MAP_PERIOD = 1.0  # between two pictures of the map at least [s]
_SHARE = 0.2  # of the time may be spent on them


class ScanDisplay:
    """Feeds a page frame by frame.

    Args:
        page: to be fed.
        what: is counted, in the plural.
    """

    def __init__(self, page: LivePage, what: str) -> None:
        self._page, self._what = page, what
        self._next = 0.0

    def show(
        self,
        done: int,
        total: int,
        T_map_camera: FloatArray | None,
        voxel_map: VoxelMap | None = None,
    ) -> None:
        """Show how far it is.

        Args:
            done: so many.
            total: of so many.
            T_map_camera: newest pose of the camera, shape (4, 4); None where it is not known.
            voxel_map: what has been mapped; drawn now and then, where somebody looks.
        """
        page = self._page
        page.panel.show_state(f"{done} of {total} {self._what}", _figures(voxel_map))
        if T_map_camera is not None:
            page.robot.show_camera(T_map_camera, None)
        start = time.monotonic()
        if voxel_map is not None and page.is_watched and start >= self._next:
            page.map.show(voxel_map)
            end = time.monotonic()
            self._next = end + max(_MAP_PERIOD, (end - start) / _SHARE)

    def finish(self, voxel_map: VoxelMap | None, summary: str) -> None:
        """Show the map as it has become, whether or not anybody looks yet."""
        if voxel_map is not None:
            self._page.map.show(voxel_map)
        self._page.panel.show_state("done", _figures(voxel_map))
        self._page.panel.say(summary)


def _figures(voxel_map: VoxelMap | None) -> dict[str, str]:
    if voxel_map is None:
        return {}
    return {
        "surface": f"{voxel_map.surface_voxels:,} voxels",
        "known": f"{voxel_map.known_voxels:,} voxels",
    }
