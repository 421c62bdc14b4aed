"""The studies on the command line: ``infomap study NAME``.

Each leaves its figures and ``summary.json``, one flat object, in the folder that it is given, and
exits with 1 when it does not find what is claimed.
"""

from __future__ import annotations

from infomap_ros.cli.app import LateCommand, add_commands, new_app

_HERE = "infomap_ros.cli"
COMMANDS = {
    "drift": LateCommand(
        f"{_HERE}.study_consistency:drift",
        "How far the position drifts by scene fiducials alone (Fig. 15), by three methods.",
    ),
    "pose-consistency": LateCommand(
        f"{_HERE}.study_consistency:pose_consistency",
        "Are the poses as sure as they should be? Their errors against their own covariances.",
    ),
    "planar": LateCommand(
        f"{_HERE}.study_planar:planar",
        "Figs. 10, 11, 13, 14: one sensor in planar worlds, many strategies.",
    ),
    "two": LateCommand(
        f"{_HERE}.study_planar:two",
        "Fig. 12: two sensors that share their map by the messages of a team, and keep apart.",
    ),
    "rover": LateCommand(
        f"{_HERE}.study_rover:rover",
        "Figs. 17, 18: the rover in a rough world, largest information against raster scans.",
    ),
    "metrics": LateCommand(
        f"{_HERE}.study_metrics:metrics",
        "Every information metric in the same loop and worlds, with the same strategy.",
    ),
    "map-consistency": LateCommand(
        f"{_HERE}.study_consistency:map_consistency",
        "Is the map as sure as it should be? Its errors against its own covariances.",
    ),
}

app = new_app("Experiments with the package, and their figures.")
add_commands(app, COMMANDS)
