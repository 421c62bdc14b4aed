"""Why a base gets hardly anywhere, in words."""

from __future__ import annotations

from collections import Counter

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.vehicle import Vehicle

_CONFINED = 0.3  # [m]; a base that gets no farther does not drive
_HEADINGS = 8
_EDGE = "outside"  # of the terrain: a wide body comes there before it says why


def why_confined(planner: BasePlanner, here: FloatArray) -> str:
    """Why the base cannot leave the place where it stands, or empty where it can.

    Args:
        planner: of the base.
        here: x, y [m] and yaw [rad] of the base in the map, shape (3,).

    Returns:
        What is in the way where it stands, else what is most often in the way 0.3 m from there.
    """
    area, terrain = planner.reachable_area(here), planner.terrain
    cells = np.argwhere(area)
    away = np.hypot(*(terrain.centers_of(cells) - here[:2]).T) if len(cells) else np.zeros(1)
    if away.max() > _CONFINED:
        return ""
    reason = _reason_at(planner.vehicle, terrain, here)
    if len(cells):
        return (
            f"it gets {away.max():.1f} m from its place: {_around(planner.vehicle, terrain, here)}"
        )
    return reason or f"no pose next to it is safe: {_around(planner.vehicle, terrain, here)}"


def _around(vehicle: Vehicle, terrain: Terrain, here: FloatArray) -> str:
    """What most often speaks against poses beside a place, and turned at it."""
    bearings = here[2] + np.arange(_HEADINGS) * (2.0 * np.pi / _HEADINGS)
    poses = [np.array([*here[:2], bearing]) for bearing in bearings[1:]]
    for bearing in bearings:
        beside = here[:2] + _CONFINED * np.array([np.cos(bearing), np.sin(bearing)])
        poses += [np.array([*beside, here[2]]), np.array([*beside, bearing])]
    found = [reason for pose in poses if (reason := _reason_at(vehicle, terrain, pose))]
    if not found:
        return "no way was found between poses that are safe"
    told = [reason for reason in found if not reason.startswith(_EDGE)] or found
    kinds = Counter(reason.split(" at (")[0] for reason in told)
    kind, count = kinds.most_common(1)[0]
    example = next(reason for reason in told if reason.startswith(kind))
    return f"in {count} of {len(poses)} poses about it {example}"


def _reason_at(vehicle: Vehicle, terrain: Terrain, pose: FloatArray) -> str:
    x, y, yaw = (float(value) for value in pose)
    return vehicle.stance(terrain, x, y, yaw).reason
