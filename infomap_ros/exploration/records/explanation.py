"""A decision as the run log and the report have it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from infomap_ros.exploration.planar import planar_pose
from infomap_ros.exploration.robot import RobotState
from infomap_ros.views.decision import RatedView, ViewDecision

_LISTED = 300


def explain(decision: ViewDecision, state: RobotState) -> dict[str, Any]:
    """A decision as the run log has it; the best candidates and some of each kind rejected."""
    chosen = decision.chosen
    return {
        "pose": None if chosen is None else chosen.pose.ravel(),
        "base": planar_pose(state.T_map_base),
        "position_sigma": float(np.sqrt(np.trace(state.pose_covariance[:3, :3]))),
        "strategy": decision.strategy,
        "rating": None if chosen is None else chosen.rating,
        "terms": {} if chosen is None else chosen.terms,
        "reason": decision.reason,
        "considered": len(decision.candidates),
        "seconds": decision.seconds,
        "rejections": dict(decision.rejections()),
        "candidates": [_listed(view) for view in _worth_listing(decision.candidates)],
    }


def _worth_listing(views: Sequence[RatedView]) -> list[RatedView]:
    """The best rated views; of the others every so many."""
    rated = sorted(
        (view for view in views if np.isfinite(view.rating)), key=lambda view: -view.rating
    )
    rest = [view for view in views if not np.isfinite(view.rating)]
    best = rated[: _LISTED // 2]
    others = [*rated[_LISTED // 2 :], *rest]
    step = max(1, -(-len(others) // (_LISTED // 2)))
    return [*best, *others[::step]]


def _listed(view: RatedView) -> dict[str, Any]:
    return {
        "position": view.pose[:3, 3],
        "direction": view.pose[:3, 2],
        "rating": view.rating,
        "terms": view.terms,
        "rejection": view.rejection,
    }
