"""A run as a recording for the viewer rerun, an optional dependency (extra ``rerun``)."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.errors import MissingExtraError
from infomap_ros.exploration.records.log_records import Decision, Message, Motion, Progress
from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.reports.report_page.scene import BASE_ACTIONS
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import surface_vertices

TIMELINE = "run"
"""Time since the start of the run."""

_BASE, _CAMERA, _REJECTED = (213, 94, 0), (0, 114, 178), (141, 149, 157)
_SCALARS = ("known_fraction", "precise_fraction", "entropy_bits", "mean_sigma", "distance", "views")
_LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


def write_recording(
    out: str | Path, log_path: str | Path, voxel_map: VoxelMap | str | Path
) -> RecordedRun:
    """Write a recording (.rrd): map, views, candidates, paths and curves over time.

    Args:
        out: file to write.
        log_path: the run log.
        voxel_map: the map that the run made, or its file; shown at all times.

    Returns:
        The run as it was read.

    Raises:
        MissingExtraError: rerun is not installed.
        RunLogError: the log is not a run log.
        MapFileError: the map file cannot be used.
    """
    rerun = _rerun()
    run = read_run(log_path)
    opened = voxel_map if isinstance(voxel_map, VoxelMap) else VoxelMap.load(voxel_map)
    stream = rerun.RecordingStream("infomap_ros")
    stream.save(str(out))
    _record_map(rerun, stream, opened)
    for record in run.records:
        stream.set_time(TIMELINE, duration=record.time)
        if isinstance(record, Progress):
            _record_progress(rerun, stream, record)
        elif isinstance(record, Decision):
            _record_decision(rerun, stream, run, record)
        elif isinstance(record, Motion):
            _record_motion(rerun, stream, record)
        elif isinstance(record, Message):
            level = _LEVELS.get(record.level, "INFO")
            stream.log("messages", rerun.TextLog(record.text, level=level))
    stream.disconnect()
    return run


def _rerun() -> Any:
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise MissingExtraError("rerun", "rerun-sdk") from error


def _record_map(rerun: Any, stream: Any, voxel_map: VoxelMap) -> None:
    vertices = surface_vertices(voxel_map)
    points = np.column_stack([vertices[axis] for axis in ("x", "y", "z")])
    colors = np.column_stack([vertices[name] for name in ("red", "green", "blue")])
    radius = 0.5 * voxel_map.config.voxel_size
    stream.log("map", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    stream.log("map/surface", rerun.Points3D(points, colors=colors, radii=radius), static=True)


def _record_progress(rerun: Any, stream: Any, progress: Progress) -> None:
    for name in _SCALARS:
        value = float(getattr(progress, name))
        if math.isfinite(value):
            stream.log(f"progress/{name}", rerun.Scalars(value))


def _record_decision(rerun: Any, stream: Any, run: RecordedRun, decision: Decision) -> None:
    """The candidates of the decision, and its view, which stays."""
    possible = [c for c in decision.candidates if not c.rejection]
    rejected = [c for c in decision.candidates if c.rejection]
    for name, group, color in (("possible", possible, None), ("rejected", rejected, _REJECTED)):
        places = np.array([c.position for c in group]).reshape(-1, 3)
        labels = [c.rejection or f"rating {c.rating:.4g}" for c in group]
        options: dict[str, Any] = {"labels": labels, "show_labels": False, "radii": 0.03}
        if color is not None:
            options["colors"] = [color] * len(group)
        stream.log(f"map/candidates/{name}", rerun.Points3D(places, **options))
    stream.log("decisions", rerun.TextLog(f"view {decision.view}: {decision.reason}"))
    for name, value in {**decision.terms, "rating": decision.rating}.items():
        if math.isfinite(value):
            stream.log(f"terms/{name}", rerun.Scalars(value))
    if decision.pose is not None:
        _record_view(rerun, stream, run, decision, decision.pose)


def _record_view(
    rerun: Any, stream: Any, run: RecordedRun, decision: Decision, pose: FloatArray
) -> None:
    path, camera = f"map/views/{decision.view}", run.start.camera
    stream.log(path, rerun.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    if camera is not None:
        size = [camera.width, camera.height]
        stream.log(path, rerun.Pinhole(image_from_camera=camera.matrix, resolution=size))


def _record_motion(rerun: Any, stream: Any, motion: Motion) -> None:
    """The path of a motion, which stays: each has its own name."""
    if len(motion.path) < 2:
        return
    who, color = ("base", _BASE) if motion.action in BASE_ACTIONS else ("camera", _CAMERA)
    strip = rerun.LineStrips3D([motion.path], colors=[color], radii=0.01)
    stream.log(f"map/paths/{who}/{motion.time:.3f}", strip)
