"""What the 3-D viewer draws: small things as JSON, arrays as one compressed block.

The surface of a map as the 3-D viewer draws it: one small record per voxel.
"""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from infomap_ros.exploration.records.choice_text import grown_voxels
from infomap_ros.exploration.records.recorded_run import RecordedRun, Step
from infomap_ros.exploration.records.run_log import Candidate, Motion, plain
from infomap_ros.geometry.symmetric import smallest_axes
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import LEAST_EVIDENCE, MOST_EVIDENCE
from infomap_ros.mapping.voxels.keys import pack_all
from infomap_ros.views.ranking import terms

LARGEST_SURFACE = 250_000
"""More voxels than this are merged to larger ones: a browser has to draw them smoothly."""

SIGMA_RANGE = (1e-4, 1.0)
"""Standard deviations that are told apart [m]; coded on a logarithmic scale."""

LOG_ODDS_RANGE = (0.0, MOST_EVIDENCE)
"""Evidence that is told apart [nats]: probabilities from 0.5 to 0.9997."""


@dataclass(frozen=True, eq=False)
class DrawnSurface:
    """Surface voxels for drawing.

    Attributes:
        cells: index of the voxel above `first`, shape (K, 3), uint16.
        normals: unit normals times 127, turned upwards, shape (K, 3), int8.
        sigmas: standard deviation along the normal on the scale of `SIGMA_RANGE`, (K,), uint8.
        evidence: log-odds on the scale of `LOG_ODDS_RANGE`, shape (K,), uint8.
        first: index of the voxel of cell (0, 0, 0), shape (3,).
        size: edge of a drawn voxel [m].
        merged: how many voxels of the map along each edge of a drawn one.
    """

    cells: NDArray[np.uint16]
    normals: NDArray[np.int8]
    sigmas: NDArray[np.uint8]
    evidence: NDArray[np.uint8]
    first: NDArray[np.int64]
    size: float
    merged: int

    @property
    def min_evidence(self) -> int:
        """Code of the evidence below which a voxel is likely a stray one."""
        return int(LEAST_EVIDENCE * np.median(self.evidence)) if len(self.evidence) else 0

    @property
    def centers(self) -> FloatArray:
        """Centers of the drawn voxels, shape (K, 3) [m, map]."""
        return np.asarray((self.cells + self.first + 0.5) * self.size)


def drawn_surface(voxel_map: VoxelMap, most: int = LARGEST_SURFACE) -> DrawnSurface:
    """The surface voxels of a map, merged to larger ones where there are more than `most`."""
    indices, _, covariances = voxel_map.gaussians()
    size = voxel_map.config.voxel_size
    evidence = voxel_map.log_odds((indices + 0.5) * size)
    variances, axes = smallest_axes(covariances)
    normals = axes * np.where(axes[:, 2:] < 0.0, -1.0, 1.0)
    values = np.column_stack([normals, np.sqrt(np.maximum(variances, 1e-12)), evidence])
    cells, merged = indices.astype(np.int64), 1
    while len(cells) > most:
        cells, values = _merge(cells >> 1, values)
        merged *= 2
    first = cells.min(axis=0) if len(cells) else np.zeros(3, np.int64)
    lengths = np.maximum(np.linalg.norm(values[:, :3], axis=1, keepdims=True), 1e-9)
    return DrawnSurface(
        (cells - first).astype(np.uint16),
        np.rint(values[:, :3] / lengths * 127.0).astype(np.int8),
        coded(np.log(values[:, 3]), *np.log(SIGMA_RANGE)),
        coded(values[:, 4], *LOG_ODDS_RANGE),
        first,
        size * merged,
        merged,
    )


def coded(values: FloatArray, low: float, high: float) -> NDArray[np.uint8]:
    """Values as 0 (low) to 255 (high), beyond these clipped."""
    share = (np.asarray(values) - low) / (high - low)
    return np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)


def _merge(cells: NDArray[np.int64], values: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Mean of the values of equal cells."""
    _, first, owners = np.unique(pack_all(cells), return_index=True, return_inverse=True)
    counts = np.bincount(owners)
    means = [np.bincount(owners, column) / counts for column in values.T]
    return cells[first], np.column_stack(means)


COLOR_MAPS = {
    "height": "viridis",
    "sigma": "cividis",
    "probability": "cividis",
    "rating": "plasma",
}
"""Color maps by what they show; all of even steps of lightness, readable for the color-blind."""

BASE_ACTIONS = ("drive", "home")
"""Motions whose path is the base's; that of others is the camera's."""

_UNITS = {
    term.name: term.unit
    for term in vars(terms).values()
    if isinstance(getattr(term, "name", None), str) and hasattr(term, "unit")
}
LARGEST_CHOICE = 60_000
"""Of more candidates than this in all decisions, each decision shows every so many."""

_LEAST_STEP = 0.01  # of a path: points closer than this are left out [m]


def scene_of(surface: DrawnSurface, cut: float | None, run: RecordedRun | None) -> dict[str, Any]:
    """Everything that the viewer draws.

    Args:
        surface: of the map.
        cut: height above which the surface is hidden at first [m]; None: nothing is.
        run: whose paths and views are drawn; None: the map alone.

    Returns:
        ``manifest``, plain values for JSON, and ``arrays``, numpy arrays by name.
    """
    centers = surface.centers[surface.evidence >= surface.min_evidence]
    manifest: dict[str, Any] = {
        "voxel": surface.size,
        "merged": surface.merged,
        "first": surface.first.tolist(),
        "bounds": _bounds(centers, surface.size, 0.1),
        "focus": _bounds(centers, surface.size, 2.0),
        "cut": cut,
        "heights": _heights(centers, cut),
        "sigma": {"scale": SIGMA_RANGE, "shown": _sigma_limits(surface)},
        "logOdds": LOG_ODDS_RANGE,
        "least": surface.min_evidence / 255.0,
    }
    arrays: dict[str, NDArray[Any]] = {
        "cells": surface.cells,
        "normals": surface.normals,
        "sigmas": surface.sigmas,
        "evidence": surface.evidence,
        "seen": _first_seen(surface, [] if run is None else run.steps),
    }
    for name in set(COLOR_MAPS.values()):
        arrays[f"map_{name}"] = _colors(name)
    manifest["colorMaps"] = COLOR_MAPS
    if run is not None:
        _add_run(manifest, arrays, run)
    return {"manifest": manifest, "arrays": arrays}


def _first_seen(surface: DrawnSurface, steps: Sequence[Step]) -> NDArray[np.uint16]:
    """Number of the decision that first knew each drawn voxel; the last where none is listed."""
    grown = [grown_voxels(step.decision.surface) for step in steps]
    if not any(map(len, grown)):
        return np.zeros(len(surface.cells), np.uint16)
    keys = pack_all(surface.cells + surface.first)
    order = np.argsort(keys)
    ordered = keys[order]
    seen = np.full(len(keys), len(steps) - 1, np.uint16)
    for number in reversed(range(len(steps))):
        drawn = pack_all(grown[number] // surface.merged)
        places = np.searchsorted(ordered, np.intersect1d(drawn, ordered))
        seen[order[places]] = number
    return seen


def add_camera_path(scene: dict[str, Any], path: FloatArray) -> None:
    """Add to a scene without a run where the camera was, shape (N, 3) [m]."""
    thinned = [_thinned(path)]
    scene["arrays"]["path_points"] = thinned[0].astype(np.float32)
    scene["arrays"]["path_starts"] = _starts(thinned)
    scene["manifest"]["paths"] = [{"who": "camera", "time": 0.0, "fail": ""}]


def pack(arrays: Mapping[str, NDArray[Any]]) -> tuple[dict[str, Any], str]:
    """Arrays one after the other, compressed with zlib, as base64 text, and where each one is."""
    places, parts, offset = {}, [], 0
    for name, array in arrays.items():
        data = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()
        kind = f"{array.dtype.kind}{array.dtype.itemsize}"
        places[name] = {"type": kind, "offset": offset, "count": int(array.size)}
        padding = -len(data) % 8
        parts.append(data + bytes(padding))
        offset += len(data) + padding
    return places, base64.b64encode(zlib.compress(b"".join(parts), 9)).decode("ascii")


def _add_run(manifest: dict[str, Any], arrays: dict[str, NDArray[Any]], run: RecordedRun) -> None:
    camera = run.start.camera
    manifest["camera"] = None if camera is None else _corner_rays(camera.matrix, camera)
    manifest["steps"] = [_step(step) for step in run.steps]
    paths = [motion for motion in run.of(Motion) if len(motion.path) > 1]
    thinned = [_thinned(motion.path) for motion in paths]
    arrays["path_points"] = _stack(thinned, 3).astype(np.float32)
    arrays["path_starts"] = _starts(thinned)
    manifest["paths"] = [
        {"who": "base" if m.action in BASE_ACTIONS else "camera", "time": m.time, "fail": m.outcome}
        for m in paths
    ]
    _add_candidates(manifest, arrays, run)


def _add_candidates(
    manifest: dict[str, Any], arrays: dict[str, NDArray[Any]], run: RecordedRun
) -> None:
    most = max(20, LARGEST_CHOICE // max(len(run.steps), 1))
    listed = [_spread(step.decision.candidates, most) for step in run.steps]
    every = [candidate for group in listed for candidate in group]
    names = term_names([*every, *(step.decision for step in run.steps)])
    reasons = list(dict.fromkeys(candidate.rejection for candidate in every))
    numbers = {reason: number for number, reason in enumerate(reasons)}
    values = [[candidate.terms.get(name, math.nan) for name in names] for candidate in every]
    manifest |= {
        "terms": names,
        "rejections": reasons,
        "units": {name: unit_of(name) for name in names},
    }
    arrays["candidate_starts"] = _starts(listed)
    arrays["candidate_positions"] = _stack([c.position[None] for c in every], 3).astype(np.float32)
    directions = _stack([c.direction[None] for c in every], 3)
    arrays["candidate_directions"] = np.rint(directions * 127.0).astype(np.int8)
    arrays["candidate_ratings"] = np.array([c.rating for c in every], np.float32)
    arrays["candidate_rejections"] = np.array([numbers[c.rejection] for c in every], np.uint16)
    arrays["candidate_terms"] = np.array(values, np.float32).reshape(len(every), len(names))


def term_names(rated: Sequence[Candidate | Any]) -> list[str]:
    """Names of all terms of ratings, in the order in which they first come."""
    return list(dict.fromkeys(name for entry in rated for name in entry.terms))


def unit_of(term: str) -> str:
    """Unit of a term of the rating in brackets; empty for a number or a term of the user's own."""
    return f"[{_UNITS[term]}]" if _UNITS.get(term) else ""


def _step(step: Step) -> dict[str, Any]:
    decision = step.decision
    return {
        "view": decision.view,
        "time": plain(decision.time),
        "pose": None if decision.pose is None else plain(decision.pose.ravel()),
        "base": plain(decision.base),
        "strategy": decision.strategy,
        "rating": plain(decision.rating),
        "terms": plain(decision.terms),
        "reason": decision.reason,
        "considered": decision.considered,
        "seconds": plain(decision.seconds),
        "outcome": step.outcome,
        "taken": step.taken,
    }


def _spread(candidates: Sequence[Candidate], most: int) -> Sequence[Candidate]:
    """All candidates, or every so many of them."""
    return candidates[:: max(1, -(-len(candidates) // most))]


def _corner_rays(matrix: FloatArray, camera: Any) -> list[list[float]]:
    """Rays through the image corners, camera frame, depth 1, clockwise from the top left."""
    u, v = (-0.5, camera.width - 0.5), (-0.5, camera.height - 0.5)
    corners = [(u[0], v[0], 1.0), (u[1], v[0], 1.0), (u[1], v[1], 1.0), (u[0], v[1], 1.0)]
    rays = np.linalg.solve(matrix, np.array(corners).T).T
    return [[float(f"{value:.5g}") for value in ray] for ray in rays]


def _bounds(centers: FloatArray, size: float, outside: float = 0.0) -> list[list[float]]:
    """Box of the voxels [m]; without the outermost percents at each end where `outside` is set."""
    if not len(centers):
        return [[-1.0] * 3, [1.0] * 3]
    low, high = np.percentile(centers, [outside, 100.0 - outside], axis=0)
    return [[round(float(x), 4) for x in corner] for corner in (low - size / 2, high + size / 2)]


def _heights(centers: FloatArray, cut: float | None) -> list[float]:
    """Range of heights below the cut that the colors span [m]."""
    shown = centers[:, 2] if cut is None else centers[centers[:, 2] <= cut, 2]
    if not len(shown):
        return [0.0, 1.0]
    low, high = np.percentile(shown, [1.0, 99.0])
    return [float(low), max(float(high), float(low) + 1e-3)]


def _sigma_limits(surface: DrawnSurface) -> list[float]:
    """Range of standard deviations that the colors span [m]."""
    if not len(surface.sigmas):
        return list(SIGMA_RANGE)
    low, high = np.log(SIGMA_RANGE)
    shares = np.percentile(surface.sigmas, [1.0, 99.0]) / 255.0
    shown = np.exp(low + shares * (high - low))
    return [float(shown[0]), max(float(shown[1]), 1.2 * float(shown[0]))]


def _thinned(path: FloatArray) -> FloatArray:
    """The path without points that are closer than a step to the one before, ends kept."""
    kept = [path[0]]
    for point in path[1:-1]:
        if np.linalg.norm(point - kept[-1]) >= _LEAST_STEP:
            kept.append(point)
    return np.array([*kept, path[-1]])


def _starts(groups: Sequence[Any]) -> NDArray[np.uint32]:
    return np.cumsum([0, *(len(group) for group in groups)]).astype(np.uint32)


def _stack(parts: Sequence[FloatArray], columns: int) -> FloatArray:
    return np.concatenate([np.empty((0, columns)), *parts])


def _colors(name: str) -> NDArray[np.uint8]:
    colors = matplotlib.colormaps[name](np.linspace(0.0, 1.0, 256))[:, :3]
    return np.asarray(np.rint(colors * 255.0), dtype=np.uint8)
