"""A choice as text, as it travels from the node that chooses to the one that moves.

Which surface voxels each decision was the first to know, as a short text of the run log.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError, RunLogError
from infomap_ros.exploration.records.run_log import plain
from infomap_ros.exploration.robot import Choice, MapProgress
from infomap_ros.geometry import check_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import pack_all, unpack_all
from infomap_ros.motion.route import ArmPath, Route


def choice_to_text(choice: Choice) -> str:
    """A choice as JSON in one line."""
    route = choice.route
    content = {
        "progress": dataclasses.asdict(choice.progress),
        "pose": None if choice.pose is None else choice.pose.tolist(),
        "route": None if route is None else _route_content(route),
        "reason": choice.reason,
        "explanation": plain(choice.explanation),
    }
    return json.dumps(content)


def route_digest(route: Route) -> str:
    """A short name of a route: two that differ in any number have different ones."""
    return f"{zlib.crc32(json.dumps(_route_content(route)).encode()):08x}"


def choice_from_text(text: str) -> Choice:
    """Read what `choice_to_text` wrote.

    Raises:
        InvalidInputError: it is not such a text, or its numbers are not a route of a robot.
    """
    try:
        content = json.loads(text)
        route = content["route"]
        return Choice(
            MapProgress(**content["progress"]),
            None if content["pose"] is None else _transform(content["pose"]),
            None if route is None else _route(route),
            str(content["reason"]),
            dict(content["explanation"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidInputError("choice", f"cannot be read: {error!r}") from error


def _route_content(route: Route) -> dict[str, Any]:
    return {
        "arm_before": _arm_content(route.arm_before),
        "base_path": route.base_path.tolist(),
        "base_poses": route.base_poses.tolist(),
        "arm_after": _arm_content(route.arm_after),
        "T_map_camera": route.T_map_camera.tolist(),
        "partial": route.partial,
    }


def _arm_content(path: ArmPath) -> dict[str, Any]:
    return {
        "joint_names": list(path.joint_names),
        "positions": path.positions.tolist(),
        "times": path.times.tolist(),
    }


def _route(content: Mapping[str, Any]) -> Route:
    base_path = _numbers(content["base_path"], 3)
    base_poses = [_transform(pose) for pose in content["base_poses"]]
    if len(base_poses) != len(base_path):
        raise ValueError(f"{len(base_path)} places of the base, but {len(base_poses)} poses")
    return Route(
        _arm_path(content["arm_before"]),
        base_path,
        np.array(base_poses).reshape(-1, 4, 4),
        _arm_path(content["arm_after"]),
        _transform(content["T_map_camera"]),
        bool(content["partial"]),
    )


def _arm_path(content: Mapping[str, Any]) -> ArmPath:
    names = tuple(str(name) for name in content["joint_names"])
    positions = _numbers(content["positions"], len(names))
    times = _numbers([content["times"]], len(positions))[0] if len(positions) else np.zeros(0)
    if len(times) and (times[0] < 0.0 or (np.diff(times) <= 0.0).any()):
        raise ValueError("the times of an arm path do not increase")
    return ArmPath(names, positions, times)


def _numbers(rows: object, columns: int) -> FloatArray:
    array = np.array(rows, dtype=np.float64).reshape(-1, columns)
    if not np.isfinite(array).all():
        raise ValueError("holds numbers that are not finite")
    return array


def _transform(rows: object) -> FloatArray:
    return check_transform(np.array(rows, dtype=np.float64), "pose")


LARGEST = 250_000
"""Larger surfaces are not listed: a log must stay small, and a choice quick."""
_KEY_BYTES = 8


class SurfaceGrowth:
    """Lists each surface voxel once."""

    def __init__(self) -> None:
        self._listed = np.empty(0, np.int64)

    def text(self, voxel_map: VoxelMap) -> str:
        """The surface voxels that no text before has listed; empty where there are none.

        Args:
            voxel_map: as it is now.
        """
        if voxel_map.surface_voxels > LARGEST:
            return ""
        new = np.setdiff1d(pack_all(voxel_map.gaussians()[0].astype(np.int64)), self._listed)
        self._listed = np.union1d(self._listed, new)
        steps = np.diff(new, prepend=0).astype("<i8")  # small numbers, which zlib makes short
        return base64.b64encode(zlib.compress(steps.tobytes())).decode("ascii") if len(new) else ""


def grown_voxels(text: str) -> NDArray[np.int64]:
    """Voxel indices of what `SurfaceGrowth` has listed, shape (K, 3).

    Raises:
        RunLogError: it is no such text.
    """
    try:
        unpacker, packed = zlib.decompressobj(), base64.b64decode(text, validate=True)
        unpacked = unpacker.decompress(packed, LARGEST * _KEY_BYTES)
        if packed and not unpacker.eof:
            raise ValueError("it is cut off")
        keys = np.cumsum(np.frombuffer(unpacked, "<i8"))
    except (ValueError, zlib.error) as error:
        raise RunLogError(f"'surface' of a decision cannot be read: {error}") from error
    return unpack_all(keys)
