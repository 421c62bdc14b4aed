"""What the 3-D viewer draws: small things as JSON, arrays as one compressed block."""

from __future__ import annotations

import base64
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from infomap_ros.exploration.records.log_records import Candidate, Motion
from infomap_ros.exploration.records.recorded_run import RecordedRun, Step
from infomap_ros.exploration.records.run_log import plain
from infomap_ros.exploration.records.surface_growth import grown_voxels
from infomap_ros.exploration.reports.report_page.surface import (
    LOG_ODDS_RANGE,
    SIGMA_RANGE,
    DrawnSurface,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxels.keys import pack_all
from infomap_ros.views.ranking import terms

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
    """Number of the decision that first knew each drawn voxel; the last where none has told."""
    told = [grown_voxels(step.decision.surface) for step in steps]
    if not any(map(len, told)):
        return np.zeros(len(surface.cells), np.uint16)
    keys = pack_all(surface.cells + surface.first)
    order = np.argsort(keys)
    ordered = keys[order]
    seen = np.full(len(keys), len(steps) - 1, np.uint16)
    for number in reversed(range(len(steps))):
        drawn = pack_all(told[number] // surface.merged)
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
