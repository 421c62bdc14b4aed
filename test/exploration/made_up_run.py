"""A small map and the log of a run that could have made it, from a seed."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.exploration.records.choice_text import SurfaceGrowth
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

CAMERA = PinholeCamera(width=80, height=60, fx=64.0, fy=64.0, cx=39.5, cy=29.5)
MAX_RANGE = 4.0
STONES = ((0.6, 0.9, 0.35), (-1.2, 0.4, 0.25), (1.4, -0.7, 0.45), (-0.4, -1.5, 0.3))
REJECTIONS = (
    "no inverse kinematics: position error 0.031 m",
    "base path: unknown ground",
    "in collision: forearm and map",
    "not free: probability 0.31",
)


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """T_map_camera of an optical frame at `position` that looks at `target`, z of the map up."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return make_transform(axes, position)


def ground(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the ground with its stones [m]."""
    height = 0.08 * np.sin(1.3 * x) + 0.06 * np.cos(1.7 * y + 0.5 * x)
    for a, b, radius in STONES:
        height = height + np.sqrt(np.maximum(radius**2 - (x - a) ** 2 - (y - b) ** 2, 0.0))
    return height


def seen_points(pose: np.ndarray) -> np.ndarray:
    """What the camera measures, shape (H, W, 3) [m], NaN where the ground is out of range."""
    rays = CAMERA.back_project(np.ones((CAMERA.height, CAMERA.width))).astype(float)
    turned = rays @ pose[:3, :3].T
    depth = np.full(rays.shape[:2], np.nan)
    for z in np.arange(0.15, MAX_RANGE, 0.02):
        places = pose[:3, 3] + z * turned
        below = np.isnan(depth) & (places[..., 2] < ground(places[..., 0], places[..., 1]))
        depth[below] = z
    return (rays * depth[..., None]).astype(np.float32)


def views(count: int) -> list[np.ndarray]:
    """Poses on a spiral that look about."""
    angles = 2.4 * np.arange(count)
    radii = 0.35 + 0.11 * np.arange(count)
    places = [(r * math.cos(a), r * math.sin(a), 0.9) for r, a in zip(radii, angles, strict=True)]
    ahead = [
        (r * math.cos(a + 0.9) * 2.2, r * math.sin(a + 0.9) * 2.2, 0.0)
        for r, a in zip(radii, angles, strict=True)
    ]
    return [look_at(np.array(p), np.array(q)) for p, q in zip(places, ahead, strict=True)]


def made_up_map(count: int = 12, voxel_size: float = 0.05) -> VoxelMap:
    """The map that the views make."""
    *_, voxel_map = growing_map(count, voxel_size)
    return voxel_map


def growing_map(count: int, voxel_size: float) -> Iterator[VoxelMap]:
    """The map before the first view, and after each."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=voxel_size, max_range=MAX_RANGE))
    rng = np.random.default_rng(1)
    yield voxel_map
    for pose in views(count):
        points = seen_points(pose)
        noise = 1.0 + 0.003 * points[..., 2:] * rng.standard_normal((*points.shape[:2], 1))
        depth = np.nan_to_num(points[..., 2], nan=1.0)
        covariances = np.zeros((*depth.shape, 6))
        covariances[..., [0, 3]] = 1e-6
        covariances[..., 5] = (0.004 * depth**2) ** 2
        voxel_map.integrate(points * noise, pose, covariances, camera=CAMERA)
        yield voxel_map


def entries(count: int = 12, candidates: int = 60) -> list[dict[str, Any]]:
    """The entries of the log, in their order."""
    rng = np.random.default_rng(2)
    found, time, distance = [_start()], 0.0, 0.0
    before = np.zeros(2)
    for view, pose in enumerate(views(count)):
        time += float(rng.uniform(3.0, 8.0))
        found.append(_progress(view, distance, time, count))
        found.append(_decision(view, pose, time, rng, candidates))
        base = pose[:2, 3] * 0.7
        places = np.linspace(before, base, 20)
        path = np.column_stack([places, ground(places[:, 0], places[:, 1])])
        distance += float(np.linalg.norm(base - before))
        before = base
        blocked = view == 5
        outcome = "blocked after 0.4 m" if blocked else ""
        found.append(
            {
                "t": time + 1.0,
                "kind": "motion",
                "action": "drive",
                "outcome": outcome,
                "path": path.tolist(),
            }
        )
        if blocked:
            text = "drive: blocked after 0.4 m"
            found.append({"t": time + 1.1, "kind": "message", "text": text, "level": "warning"})
            continue
        arm = np.linspace([*base, 0.7], pose[:3, 3], 12)
        found.append(
            {
                "t": time + 2.0,
                "kind": "motion",
                "action": "arm",
                "outcome": "",
                "path": arm.tolist(),
            }
        )
        found.append(
            {"t": time + 2.5, "kind": "motion", "action": "look", "outcome": "", "path": []}
        )
    found.append(_progress(count, distance, time + 4.0, count))
    found.append(_no_decision(count, time + 5.0, rng, candidates))
    detail = "97.1 % of the reachable surface is known, mean sigma 6.2 mm"
    found.append({"t": time + 6.0, "kind": "end", "reason": "done", "detail": detail})
    return found


def write_log(
    path: Path, count: int = 12, candidates: int = 60, voxel_size: float | None = None
) -> Path:
    """Write the log as a file; it tells how the surface grew where a voxel size is given."""
    told = entries(count, candidates)
    if voxel_size is not None:
        growth, maps = SurfaceGrowth(), growing_map(count, voxel_size)
        for entry in told:
            if entry["kind"] == "decision":
                entry["surface"] = growth.text(next(maps))
    lines = (json.dumps(entry) for entry in told)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _start() -> dict[str, Any]:
    task = {
        "region_low": [-3.0, -3.0, -0.6],
        "region_high": [3.0, 3.0, 1.4],
        "known_fraction": 0.95,
    }
    task |= {"surface_sigma": 0.007, "max_views": 80, "max_distance": 300.0}
    camera = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    names = {"robot": "rover", "world": "stones", "strategy": "look_ahead"}
    return {
        "t": 0.0,
        "kind": "start",
        "task": task,
        **names,
        "voxel_size": 0.05,
        "camera": camera,
        "max_range": MAX_RANGE,
    }


def _progress(view: int, distance: float, time: float, count: int) -> dict[str, Any]:
    share = 1.0 - math.exp(-3.6 * view / count)
    return {
        "t": time,
        "kind": "progress",
        "views": view,
        "distance": distance,
        "known_fraction": share,
        "entropy_bits": 48000.0 * (1.0 - 0.9 * share),
        "mean_sigma": None if view == 0 else 0.006 + 0.009 * math.exp(-0.3 * view),
        "surface_voxels": int(18000 * share),
        "known_voxels": int(90000 * share),
        "precise_fraction": 0.9 * share,
        "state": "choosing",
    }


def _terms(rng: np.random.Generator) -> dict[str, float]:
    return {
        "information": float(rng.uniform(200.0, 4000.0)),
        "distance": -float(rng.uniform(0.0, 600.0)),
        "localization_error": -float(rng.uniform(0.0, 90.0)),
        "risk": -float(rng.uniform(0.0, 30.0)),
    }


def _candidate(rng: np.random.Generator) -> dict[str, Any]:
    direction = rng.normal(size=3) * (1.0, 1.0, 0.4)
    terms = _terms(rng)
    rejected = rng.random() < 0.6
    return {
        "position": [*rng.uniform(-2.2, 2.2, 2), float(rng.uniform(0.5, 1.3))],
        "direction": (direction / np.linalg.norm(direction)).tolist(),
        "rating": None if rejected and rng.random() < 0.5 else sum(terms.values()),
        "terms": terms,
        "rejection": str(rng.choice(REJECTIONS, p=[0.5, 0.25, 0.15, 0.1])) if rejected else "",
    }


def _decision(
    view: int, pose: np.ndarray, time: float, rng: np.random.Generator, candidates: int
) -> dict[str, Any]:
    terms = _terms(rng)
    return {
        "t": time,
        "kind": "decision",
        "view": view,
        "pose": pose.reshape(-1).tolist(),
        "base": [*(pose[:2, 3] * 0.7), float(rng.uniform(-3.0, 3.0))],
        "strategy": "look_ahead",
        "rating": sum(terms.values()),
        "terms": terms,
        "reason": f"most information for its way: {terms['information']:.0f} bits",
        "seconds": {"candidates": 0.21, "information": 0.62, "reach": float(rng.uniform(0.2, 0.9))},
        "candidates": [_candidate(rng) for _ in range(candidates)],
    }


def _no_decision(
    view: int, time: float, rng: np.random.Generator, candidates: int
) -> dict[str, Any]:
    found = _decision(view, np.eye(4), time, rng, candidates)
    nothing = {"pose": None, "base": None, "rating": None, "terms": {}}
    return {**found, **nothing, "reason": "the task is done"}
