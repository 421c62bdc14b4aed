"""The small simulated camera is a sound pair wherever it looks, and its faults are noticed."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from infomap_ros.errors import SensorFaultError
from infomap_ros.geometry import make_transform
from infomap_ros.pipeline import range_estimator
from infomap_ros.pipeline.range_estimator import StereoHealth
from infomap_ros.simulation.cameras.stereo_camera import (
    DRAWN_FAST,
    ImageSensor,
    StereoCamera,
    StereoCameraConfig,
)
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import make_world
from infomap_ros.stereo import StereoRectifier

Pair = tuple[np.ndarray, np.ndarray]
BASELINE, VIEWS = 0.1, 12
CAMERA = StereoCamera(
    StereoCameraConfig(width=320, height=240, **DRAWN_FAST),
    BASELINE,
)
FAULTS: dict[str, Callable[[Pair], Pair]] = {
    range_estimator.UNLIKE: lambda pair: (pair[0], pair[1][:, ::-1].copy()),
    range_estimator.SWAPPED: lambda pair: (pair[1], pair[0]),
    range_estimator.ROWS_OFF: lambda pair: (pair[0], np.roll(pair[1], 2, 0)),
}


def places(world: World, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Free places of the left camera, 0.4 to 1.2 m above the ground, that look about."""
    low, high = world.region
    while True:
        x, y = rng.uniform(low[:2], high[:2])
        z = float(world.terrain.height(np.array([[x, y]]))[0])
        place = np.array([x, y, z + rng.uniform(0.4, 1.2)])
        if world.surface_distance(place[None])[0] < 0.35:
            continue
        yaw, pitch = rng.uniform(-np.pi, np.pi), rng.uniform(-0.2, 0.8)
        level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        ahead = np.cos(pitch) * level - np.sin(pitch) * np.array([0.0, 0.0, 1.0])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        yield make_transform(np.stack([right, np.cross(ahead, right), ahead], axis=1), place)


def views(name: str) -> list[Pair]:
    world, rng, pairs = make_world(name, 2, size=6.0), np.random.default_rng(1), list[Pair]()
    data, rectifier = world.new_data(), StereoRectifier(CAMERA.left, CAMERA.right)
    with CAMERA.renderer(world.model) as renderer:
        for pose, _ in zip(places(world, rng), range(VIEWS), strict=False):
            beside = pose @ make_transform(np.eye(3), (BASELINE, 0.0, 0.0))
            light, other = CAMERA.capture(renderer, data, pose, beside)
            sensor = ImageSensor(rng)
            sensor.adjust(light)
            pairs.append(rectifier.rectify(sensor.expose(light), sensor.expose(other, 1.02)))
    return pairs


@pytest.mark.parametrize("name", ["mars", "office", "cave"])
def test_the_simulated_camera_has_no_faults_but_those_it_has(name: str) -> None:
    pairs = views(name)
    for pair in pairs:  # a robot that rests looks at the same thing all the time
        watched = StereoHealth()
        for _ in range(5):
            watched.check(*pair, CAMERA.rig)

    for named, fault in FAULTS.items():
        watched = StereoHealth()
        with pytest.raises(SensorFaultError) as raised:
            for pair in pairs:
                watched.check(*fault(pair), CAMERA.rig)
        assert raised.value.fault == named
