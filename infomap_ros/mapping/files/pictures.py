"""Pictures of a voxel map: from above, from the side, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.geometry.symmetric import smallest_axes
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxel_map import VoxelMap

_LARGEST_SIDE = 1600  # of a view [px]
_HEADROOM = 2.0  # what lies higher above the floor may be a ceiling [m]
_OVERHANG_SHARE = 0.1  # it is one when it hides more than this share of the columns
LEAST_EVIDENCE = 0.3
"""Voxels with less than this share of the median surface voxel's log-odds are not drawn,"""
MOST_EVIDENCE = 8.0
"""or of this, where the median has more."""
_DARKEST = 0.45  # brightness of a surface seen edge-on; one seen from before has its bar's color
_FLAT = 0.4  # a view that is lower than this share of its width has its color bar below
_LONG = 0.35  # views that are lower than this share of their width lie one below the other
_WIDTH, _HEIGHT, _LEAST_WIDTH = 10.8, 9.0, 6.3  # of the sheet without its color bars [in]
_BARS, _TITLES = 3.2, 0.9  # of its color bars, and of the titles of a row [in]


@dataclass(frozen=True, eq=False)
class _Surface:
    """The surface voxels that are more likely occupied than not, without stray ones.

    Voxels with much less evidence than most, for example of one wrong match, are left out.

    Attributes:
        points: their centers, shape (K, 3) [m].
        sigmas: standard deviations along the normals, shape (K,) [m].
    """

    points: FloatArray
    sigmas: FloatArray

    def __getitem__(self, chosen: NDArray[np.bool_]) -> _Surface:
        return _Surface(self.points[chosen], self.sigmas[chosen])


@dataclass(frozen=True)
class _View:
    """A parallel projection: image axes and the direction from which it is seen.

    Attributes:
        across: index of the map axis that runs to the right.
        up: index of the map axis that runs up.
        towards: index of the axis to the viewer.
        sign: +1 when the viewer is at its positive end, else -1.
        title: what the picture shows.
    """

    across: int
    up: int
    towards: int
    sign: int
    title: str

    @property
    def is_mirrored(self) -> bool:
        """Whether the axis across runs to the left."""
        return (self.towards, self.sign) in ((0, -1), (1, 1))


@dataclass(frozen=True, eq=False)
class MapImage:
    """The surface seen from above, one pixel per cell of the map.

    Attributes:
        pixels: RGBA, rows upwards (along +y), columns along +x, shape (H, W, 4), uint8; nothing
            is transparent.
        low: map coordinates of the lower left corner, shape (2,) [m].
        cell: edge of a pixel [m].
        heights: that the first and the last color stand for [m].
        cut: height above which a ceiling is left out [m]; None where nothing is.
    """

    pixels: NDArray[np.uint8]
    low: FloatArray
    cell: float
    heights: tuple[float, float]
    cut: float | None


def map_from_above(voxel_map: VoxelMap, colors: str = "viridis") -> MapImage:
    """Draw the surface from above, colored by height, shaded, without a ceiling that hides it.

    Args:
        voxel_map: the map.
        colors: name of a color map of matplotlib.

    Raises:
        InvalidInputError: the map has no surface to draw.
    """
    surface = _surface(voxel_map)
    if len(surface.points) == 0:
        raise InvalidInputError("voxel map", "has no surface to draw")
    below, note = _below_ceiling(surface, voxel_map.config.voxel_size)
    top, cell = _View(0, 1, 2, 1, note), _cell(surface.points, voxel_map.config.voxel_size)
    heights = below.points[:, 2]
    scale = _limits(heights)
    pixels = _colored(below, top, cell, heights, matplotlib.cm.ScalarMappable(scale, colors))
    return MapImage(
        np.rint(255.0 * pixels).astype(np.uint8),
        below.points[:, :2].min(axis=0) - 0.5 * cell,
        cell,
        (float(scale.vmin or 0.0), float(scale.vmax or 0.0)),
        float(heights.max()) + 0.5 * voxel_map.config.voxel_size if note else None,
    )


def draw_map_views(
    voxel_map: VoxelMap, path: str | Path, title: str = "", camera_path: FloatArray | None = None
) -> None:
    """Draw the surface from above and from the side, and its standard deviation.

    The axes are those of the map's frame. Where a ceiling hides the room, the view from above is
    cut below it. The side is the one from which most of the surface is seen through free space.

    Args:
        voxel_map: the map.
        path: PNG file to write.
        title: of the sheet; the size of the voxels is added to it.
        camera_path: positions of the camera in their order, shape (N, 3) [m, map]; drawn over the
            map where given.

    Raises:
        InvalidInputError: the map has no surface to draw.
        OSError: the file cannot be written.
    """
    surface = _surface(voxel_map)
    if len(surface.points) == 0:
        raise InvalidInputError("voxel map", "has no surface to draw")
    size = voxel_map.config.voxel_size
    below, note = _below_ceiling(surface, size)
    top, side = _View(0, 1, 2, 1, f"top view{note}"), _open_side(voxel_map, surface.points)
    distance = -side.sign * surface.points[:, side.towards]
    distance -= distance.min()
    heights, distances = _limits(below.points[:, 2]), _limits(distance)
    cell = _cell(surface.points, size)
    track = np.empty((0, 3)) if camera_path is None else camera_path
    tall, flat = _aspect(below.points, track, top), _aspect(surface.points, track, side)
    figure, axes = _sheet(tall, flat)
    _draw(axes[0], below, top, cell, below.points[:, 2], heights, "viridis", "z [m]")
    _draw(axes[1], surface, side, cell, distance, distances, "viridis_r", "distance [m]")
    shown, higher = (below, top) if tall > flat else (surface, side)
    values, higher = 1e3 * shown.sigmas, replace(higher, title="standard deviation")
    sigmas = LogNorm(*_sigma_limits(values))
    _draw(axes[2], shown, higher, cell, values, sigmas, "magma", "sigma [mm]", shaded=False)
    if len(track):
        for one, view in zip(axes, (top, side, higher), strict=True):
            _draw_camera_path(one, track[:, [view.across, view.up]])
        axes[0].legend(loc="best", fontsize="small")
    figure.suptitle(", ".join(filter(None, [title, f"voxels of {100.0 * size:g} cm"])))
    save_figure(figure, path, 110)


def _sheet(tall: float, flat: float) -> tuple[Figure, tuple[Axes, Axes, Axes]]:
    """A sheet that wastes little paper, with axes for the views from above, the side, and sigma.

    Args:
        tall: height over width of the view from above.
        flat: of that from the side. Sigma is drawn in the higher view of the two.
    """
    first, second = ("top", "side") if tall > flat else ("side", "top")
    names, heights = [[first, "sigma"], [second, second]], [max(tall, flat), 2.0 * min(tall, flat)]
    if max(tall, flat) < _LONG:  # one below the other
        names, heights = [["top"], ["side"], ["sigma"]], [tall, flat, max(tall, flat)]
    rows, columns = len(names), len(names[0])
    blank = (rows + 1) * _TITLES  # one for the bar below
    width = float(np.clip(columns * (_HEIGHT - blank) / sum(heights), _LEAST_WIDTH, _WIDTH))
    height = min(width / columns * sum(heights) + blank, _HEIGHT)
    figure = Figure(figsize=(width + _BARS, height), layout="constrained")
    parts: dict[str, Axes] = figure.subplot_mosaic(names, height_ratios=heights)
    return figure, (parts["top"], parts["side"], parts["sigma"])


def _aspect(points: FloatArray, track: FloatArray, view: _View) -> float:
    extent = np.maximum(np.ptp(np.concatenate([points, track]), axis=0), 1e-3)
    return float(extent[view.up] / extent[view.across])


def _draw_camera_path(axes: Axes, path: FloatArray) -> None:
    """The path over the map, its beginning marked; the axes stay as they are."""
    axes.plot(path[:, 0], path[:, 1], "-", color="white", linewidth=3.0)
    axes.plot(path[:, 0], path[:, 1], "-", color="tab:red", linewidth=1.5, label="camera path")
    axes.plot(*path[0], "o", color="tab:red", markeredgecolor="white", label="its start")


def _limits(values: FloatArray) -> Normalize:
    return Normalize(*np.percentile(values, [1.0, 99.0]))


def _surface(voxel_map: VoxelMap) -> _Surface:
    indices, _, covariances = voxel_map.gaussians()
    centers: FloatArray = (indices.astype(np.float64) + 0.5) * voxel_map.config.voxel_size
    evidence = voxel_map.log_odds(centers)
    usual = min(float(np.median(evidence)), MOST_EVIDENCE) if len(evidence) else 0.0
    likely = evidence > max(0.0, LEAST_EVIDENCE * usual)
    variances, _ = smallest_axes(covariances[likely])
    return _Surface(centers[likely], np.sqrt(np.maximum(variances, 0.0)))


def _sigma_limits(sigmas: FloatArray) -> tuple[float, float]:
    low, high = np.percentile(sigmas, [1.0, 99.0])
    low = max(float(low), 1e-6)
    return low, max(float(high), 1.01 * low)


def _cell(points: FloatArray, voxel_size: float) -> float:
    """Size of a pixel: a voxel, or more where the picture would become too large [m]."""
    return max(voxel_size, float(np.ptp(points, axis=0).max()) / _LARGEST_SIDE)


def _below_ceiling(surface: _Surface, voxel_size: float) -> tuple[_Surface, str]:
    """The surface without a ceiling, and a remark where there is one."""
    heights = surface.points[:, 2]
    columns = np.floor(surface.points[:, :2] / (2.0 * voxel_size)).astype(np.int64)
    keys = columns[:, 0] * (1 << 32) + columns[:, 1]
    order = np.argsort(heights)
    lowest = order[np.unique(keys[order], return_index=True)[1]]
    cut = float(np.percentile(heights[lowest], 25.0)) + _HEADROOM
    middle = cut - 0.5 * _HEADROOM
    high, low = np.unique(keys[heights > cut]), np.unique(keys[heights < middle])
    over = np.setdiff1d(high, keys[(heights >= middle) & (heights <= cut)])  # a wall has no gap
    hidden = len(np.intersect1d(over, low, assume_unique=True))
    if hidden < _OVERHANG_SHARE * max(len(low), 1):
        return surface, ""
    return surface[heights <= cut], f", below {cut:.1f} m"


def _open_side(voxel_map: VoxelMap, points: FloatArray) -> _View:
    """Of the four sides, the one from which most of the surface is seen through free space."""
    views = [
        _View(1 - axis, 2, axis, sign, f"side view along {'-' if sign > 0 else '+'}{'xy'[axis]}")
        for axis in (0, 1)
        for sign in (1, -1)
    ]
    return max(views, key=lambda view: _open_pixels(voxel_map, points, view))


def _open_pixels(voxel_map: VoxelMap, points: FloatArray, view: _View) -> int:
    """Number of pixels whose surface has free space before it."""
    size = voxel_map.config.voxel_size
    nearest = _raster(points, view, size, np.arange(float(len(points))))
    seen = points[nearest[np.isfinite(nearest)].astype(np.int64)]
    before = np.zeros(3)
    before[view.towards] = view.sign * 3.0 * size
    return int(np.count_nonzero(voxel_map.log_odds(seen + before) < 0.0))


def _raster(points: FloatArray, view: _View, cell: float, values: FloatArray) -> FloatArray:
    """Value of the nearest point in each pixel, rows upwards; NaN where there is none."""
    low = points.min(axis=0)
    columns = np.rint((points[:, view.across] - low[view.across]) / cell).astype(np.int64)
    rows = np.rint((points[:, view.up] - low[view.up]) / cell).astype(np.int64)
    if view.is_mirrored:
        columns = columns.max() - columns
    image = np.full((rows.max() + 1, columns.max() + 1), np.nan)
    order = np.argsort(view.sign * points[:, view.towards], kind="stable")
    image[rows[order], columns[order]] = values[order]
    return image


def _draw(
    axes: Axes,
    surface: _Surface,
    view: _View,
    cell: float,
    values: FloatArray,
    scale: Normalize,
    colors: str,
    label: str,
    shaded: bool = True,
) -> None:
    """One view: color by value; shaded, darker where the surface turns away from the viewer."""
    mapper = matplotlib.cm.ScalarMappable(scale, colors)
    pixels = _colored(surface, view, cell, values, mapper, shaded)
    left, bottom = surface.points.min(axis=0)[[view.across, view.up]] - 0.5 * cell
    right, top = left + pixels.shape[1] * cell, bottom + pixels.shape[0] * cell
    across = (right, left) if view.is_mirrored else (left, right)
    axes.imshow(pixels, origin="lower", extent=(*across, bottom, top), interpolation="nearest")
    names = [f"{'xyz'[axis]} [m]" for axis in (view.across, view.up)]
    axes.set(title=view.title, xlabel=names[0], ylabel=names[1])
    place = "bottom" if pixels.shape[0] < _FLAT * pixels.shape[1] else "right"
    form: dict[str, Any] = {"shrink": 0.8, "aspect": 40 if place == "bottom" else 20}
    bar = axes.figure.colorbar(mapper, ax=axes, label=label, location=place, **form)
    if isinstance(scale, LogNorm):
        low, high = float(scale.vmin or 1.0), float(scale.vmax or 1.0)
        digits = (1, 2, 5) if high > 10.0 * low else (1, 1.5, 2, 3, 4, 6, 8)
        ticks = [digit * 10.0**power for power in range(-3, 6) for digit in digits]
        ticks = [tick for tick in ticks if low <= tick <= high]
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        bar.minorticks_off()


def _facing(depth: FloatArray, cell: float) -> FloatArray:
    """Cosine between the normal of a drawn surface and the direction to the viewer, (H, W).

    From the drawing itself: far voxels have covariances whose least axis is not their normal. 1
    where a neighbor is missing.

    Args:
        depth: of the surface in each pixel [m]; NaN where there is none.
        cell: edge of a pixel [m].
    """
    steps = [
        np.gradient(depth, cell, axis=axis) if depth.shape[axis] > 1 else np.zeros_like(depth)
        for axis in (0, 1)
    ]
    return np.asarray(
        1.0 / np.sqrt(1.0 + np.nan_to_num(steps[0]) ** 2 + np.nan_to_num(steps[1]) ** 2)
    )


def _colored(
    surface: _Surface,
    view: _View,
    cell: float,
    values: FloatArray,
    mapper: Any,
    shaded: bool = True,
) -> NDArray[Any]:
    """Pixels of a view, RGBA from 0 to 1, transparent where there is nothing."""
    image = _raster(surface.points, view, cell, values)
    pixels: NDArray[Any] = mapper.to_rgba(np.ma.masked_invalid(image))
    if shaded:
        depth = _raster(surface.points, view, cell, surface.points[:, view.towards])
        pixels[..., :3] *= (_DARKEST + (1.0 - _DARKEST) * _facing(depth, cell))[..., None]
    pixels[np.isnan(image)] = (1.0, 1.0, 1.0, 0.0)
    return pixels
