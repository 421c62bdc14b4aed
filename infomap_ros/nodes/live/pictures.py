"""Pictures of what a live run measures: the first depth image and its uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from sensor_msgs.msg import PointCloud2

from infomap_ros.geometry.organized import fit_pinhole_camera
from infomap_ros.messages.rows import decode_rows
from infomap_ros.nodes.live.live_run import LiveRun
from infomap_ros.replay.mapping.range_pictures import draw_depth, draw_sigma
from infomap_ros.stereo import PACKED_FIELDS, RangeCloud


class LivePictures:
    """Keeps the cloud with the most points that a run has published.

    Args:
        run: the run that is watched.
    """

    def __init__(self, run: LiveRun) -> None:
        self._best: PointCloud2 | None = None
        self._points = 0
        run.subscribe(PointCloud2, "points2", self._on_cloud)

    def _on_cloud(self, message: PointCloud2) -> None:
        z = packed_cloud(message)[::8, ::8, 2]
        points = int(np.isfinite(z).sum())
        if points > self._points:
            self._best, self._points = message, points

    def write(self, out: Path) -> list[tuple[Path, str]]:
        """Write depth.png and sigma.png; returns them with their captions."""
        if self._best is None:
            return []
        packed = packed_cloud(self._best)
        camera = fit_pinhole_camera(packed[..., :3])
        if camera is None:
            return []
        cloud = RangeCloud(camera, packed, packed[..., 2], error_correlation=0.0)
        draw_depth(cloud, out / "depth.png")
        draw_sigma(cloud, out / "sigma.png")
        return [
            (out / "depth.png", "Depth of one pair"),
            (out / "sigma.png", "Its predicted standard deviation"),
        ]


def packed_cloud(message: PointCloud2) -> np.ndarray:
    """The numbers of a cloud of stereo_range, shape (H, W, 10), float32."""
    rows = decode_rows(message)[2]
    return rows.view(np.float32).reshape(message.height, message.width, len(PACKED_FIELDS))
