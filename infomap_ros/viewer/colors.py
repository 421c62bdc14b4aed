"""Colors of the page: the same maps as in the report of a run."""

from __future__ import annotations

import matplotlib
import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray

ROBOT, BASE_WAY, CAMERA_WAY = (96, 108, 120), (213, 94, 0), (0, 114, 178)
CHOSEN, REJECTED, PLACE = (220, 50, 32), (150, 156, 163), (204, 121, 167)
TEAM = ((31, 119, 180), (255, 127, 14), (44, 160, 44), (148, 103, 189))
"""Of robots by their ids, one after the other."""


def colored(values: FloatArray, low: float, high: float, name: str) -> NDArray[np.uint8]:
    """Colors of values on a color map of matplotlib.

    Args:
        values: shape (N,).
        low: value of the first color.
        high: value of the last color.
        name: of the color map.

    Returns:
        Shape (N, 3), red, green, blue.
    """
    shares = np.clip((np.asarray(values) - low) / max(high - low, 1e-12), 0.0, 1.0)
    return np.asarray(np.rint(255.0 * matplotlib.colormaps[name](shares)[:, :3]), dtype=np.uint8)


def gradient(name: str) -> str:
    """A color map as a gradient of CSS, from left to right."""
    stops = colored(np.linspace(0.0, 1.0, 9), 0.0, 1.0, name)
    return "linear-gradient(to right, " + ", ".join(f"rgb{tuple(map(int, s))}" for s in stops) + ")"
