"""A small world that is quick to build, and the shipped description."""

from __future__ import annotations

import pytest

from infomap_ros.geometry.resources import find_share
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import SceneConfig, rover_rocks

SMALL_SCENE = SceneConfig(size=8.0, spacing=0.1, boulders=6, stones=8, texture_size=256)


@pytest.fixture(scope="session")
def small_scene() -> SceneConfig:
    return SMALL_SCENE


@pytest.fixture(scope="session")
def description() -> str:
    return read_description(find_share("config/rover.urdf"))


@pytest.fixture(scope="session")
def world(description: str) -> World:
    return rover_rocks(SMALL_SCENE, description)
