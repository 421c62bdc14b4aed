"""Draws the worlds with the rover in them.

``python -m infomap_ros.simulation.worlds.gallery OUT.jpg`` writes one picture of all.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.geometry.atomic_file import replacing
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.worlds.scenes import WORLDS, make_world

import mujoco  # isort: skip  # after the backend has been chosen

_CAMERA = PinholeCamera(640, 480, 420.0, 420.0, 319.5, 239.5)
_HEIGHT = 0.09  # [m] of the base above the ground
_ABOVE = {"mars": (2.2, 1.5, 1.7), "office": (1.3, 1.5, 1.6), "cave": (1.5, 1.2, 0.9)}


def look_at(place: FloatArray, target: FloatArray) -> FloatArray:
    """Pose of an upright optical frame at a place that looks at a target, both shape (3,) [m]."""
    forward = (target - place) / np.linalg.norm(target - place)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return make_transform(np.column_stack([right, np.cross(forward, right), forward]), place)


def picture(name: str, seed: int, description: str) -> NDArray[np.uint8]:
    """The rover at the start of a world, shape (H, W, 3), RGB.

    Raises:
        InvalidInputError: no such world.
        SimulationError: this machine cannot draw images.
    """
    world = make_world(name, seed, description)
    x, y, yaw = world.start
    data = world.new_data()
    base = np.array((x, y, float(world.terrain.height((x, y))) + _HEIGHT))
    data.qpos[:3] = base
    data.qpos[3:7] = np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)
    mujoco.mj_forward(world.model, data)
    pose = look_at(base + np.array(_ABOVE[name]), base + np.array((-0.4, -0.3, 0.2)))
    with Renderer(world.model, _CAMERA.width, _CAMERA.height) as renderer:
        return renderer.color(data, pose, _CAMERA)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write one picture of all worlds side by side."""
    parser = argparse.ArgumentParser(description="Draw the worlds.")
    parser.add_argument("out", type=Path, help="image file")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    description = read_description(find_share("config/rover.urdf"))
    row = np.hstack([picture(name, given.seed, description) for name in WORLDS])
    pixels = cv2.cvtColor(row, cv2.COLOR_RGB2BGR)
    quality = [cv2.IMWRITE_JPEG_QUALITY, 80]
    with replacing(given.out) as file:
        file.write(cv2.imencode(given.out.suffix, pixels, quality)[1].tobytes())


if __name__ == "__main__":
    main()
