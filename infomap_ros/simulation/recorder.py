"""Records a bag in simulation: stereo images, calibrations, joints, odometry, poses and truth.

Run as ``python -m infomap_ros.simulation.recorder OUT`` to record a bag with the default
configuration.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, RobotModelError
from infomap_ros.geometry import (
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    Record,
    TextRecord,
    TransformRecord,
    invert_transform,
    perturb_transform,
    transform_points,
)
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.resources import find_share
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.replay.bags.writer import BagWriter
from infomap_ros.simulation.body.base_motion import level_pose
from infomap_ros.simulation.body.robot import (
    LEFT_OPTICAL_FRAME,
    RIGHT_OPTICAL_FRAME,
    RobotState,
    fixed_frames,
    read_description,
    stereo_baseline,
)
from infomap_ros.simulation.body.wheel_odometry import Odometry, OdometryConfig
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.cameras.stereo_camera import (
    ImageSensor,
    StereoCamera,
    StereoCameraConfig,
)
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import SceneConfig, build_scene, describe_scene
from infomap_ros.simulation.worlds.terrain import Terrain

import mujoco  # isort: skip  # after the backend has been chosen

WHEEL_SUFFIX = "_wheel"
_SETTLING_STEPS = 4


class Chassis:
    """Wheels of a robot and the pose in which they stand on a terrain.

    Args:
        model: the compiled world.
        data: its state; the robot is moved by it.
        robot: the robot in it; links named ``*_wheel`` are its wheels.
        prefix: as given to `robot.add_robot`.

    Raises:
        RobotModelError: the robot has fewer than three wheels.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        robot: RobotState,
        prefix: str = "rover/",
    ) -> None:
        names = [model.body(index).name for index in range(model.nbody)]
        self.wheels = tuple(
            name[len(prefix) :]
            for name in names
            if name.startswith(prefix) and name.endswith(WHEEL_SUFFIX)
        )
        if len(self.wheels) < 3:
            raise RobotModelError(f"the robot has {len(self.wheels)} wheels, expected at least 3")
        robot.place(np.eye(4), {})
        self._axles = np.stack([robot.frame(wheel)[:3, 3] for wheel in self.wheels])
        first_geom = int(model.body(prefix + self.wheels[0]).geomadr[0])
        self.wheel_radius = float(model.geom_size[first_geom, 0])

    def rest(self, terrain: Terrain, x: float, y: float, heading: float) -> FloatArray:
        """Pose in which the wheels stand on the ground, in the least squares sense.

        Args:
            terrain: the ground.
            x: of the base's origin [m].
            y: of the base's origin [m].
            heading: yaw [rad].

        Returns:
            ``T_world_base``, shape (4, 4).
        """
        axles = self._axles - self._axles.mean(axis=0)
        pose = level_pose((x, y, float(terrain.height((x, y))) + self.wheel_radius), heading)
        for _ in range(_SETTLING_STEPS):
            world = transform_points(pose, self._axles)
            gap = terrain.height(world[:, :2]) + self.wheel_radius - world[:, 2]
            design = np.column_stack([np.ones(len(axles)), axles[:, :2]])
            lift, slope_x, slope_y = np.linalg.lstsq(design, gap, rcond=None)[0]
            tilt = Rotation.from_euler("yx", (-np.arctan(slope_x), np.arctan(slope_y)))
            pose[:3, :3] = pose[:3, :3] @ tilt.as_matrix()
            pose[2, 3] += lift
        return pose

    def wheel_turn(self, previous: FloatArray, present: FloatArray) -> dict[str, float]:
        """Turn of each wheel [rad] on the motion between two base poses, without slip."""
        local = transform_points(invert_transform(previous) @ present, self._axles) - self._axles
        return {
            f"{wheel}_joint": float(offset[0] / self.wheel_radius)
            for wheel, offset in zip(self.wheels, local, strict=True)
        }


ARM_JOINTS = ("arm_pan_joint", "arm_shoulder_joint", "arm_elbow_joint", "arm_wrist_joint")

# Share of the survey: base x, y [m]; arm pan, shoulder, elbow and camera pitch (down positive)
# [rad]. Far sweep, near sweep with the deck in view, a look from low down, far sweep from the end.
_KEYS = np.array(
    [
        (0.00, -0.30, 0.00, 0.95, -0.35, 0.65, 0.38),
        (0.12, -0.10, 0.00, 0.30, -0.35, 0.65, 0.34),
        (0.28, 0.10, 0.01, -0.95, -0.30, 0.65, 0.42),
        (0.38, 0.22, 0.03, -0.80, -0.45, 0.90, 0.85),
        (0.54, 0.40, 0.06, 0.75, -0.55, 0.95, 0.95),
        (0.64, 0.55, 0.09, 1.15, 0.10, 0.75, 0.48),
        (0.74, 0.72, 0.12, 0.55, 0.45, 0.85, 0.26),
        (0.87, 0.88, 0.12, -0.35, 0.05, 0.80, 0.28),
        (1.00, 0.98, 0.10, -1.25, -0.15, 0.75, 0.40),
    ]
)


@dataclass(frozen=True)
class SurveyState:
    """Where everything should be at one time.

    Attributes:
        x: of the base in the world [m].
        y: of the base in the world [m].
        heading: yaw of the base, along the path [rad].
        joints: arm joint angles by name [rad].
    """

    x: float
    y: float
    heading: float
    joints: dict[str, float]


class Survey:
    """The script, stretched over a duration.

    Args:
        duration: of the whole survey [s].
        keys: rows as in `_KEYS`: share of the duration, base x, y [m], pan, shoulder, elbow,
            camera pitch [rad].
    """

    def __init__(self, duration: float, keys: FloatArray = _KEYS) -> None:
        self.duration = duration
        times = keys[:, 0] * duration
        pan, shoulder, elbow, pitch = keys[:, 3:].T
        arm = np.column_stack([pan, shoulder, elbow, pitch - shoulder - elbow])
        self._path = _smooth(times, keys[:, 1:3])
        self._arm = PchipInterpolator(times, arm)
        self._velocity = self._path.derivative()

    def at(self, time: float) -> SurveyState:
        """State at a time [s] from the start; held still before the start and after the end."""
        inside = float(np.clip(time, 0.0, self.duration))
        x, y = self._path(inside)
        direction = self._velocity(inside)
        return SurveyState(
            float(x),
            float(y),
            float(np.arctan2(direction[1], direction[0])),
            dict(zip(ARM_JOINTS, self._arm(inside).tolist(), strict=True)),
        )


def _smooth(times: FloatArray, points: FloatArray) -> CubicHermiteSpline:
    """A path through points with the mean slope at each, so that the heading never jumps."""
    return CubicHermiteSpline(times, points, np.gradient(points, times, axis=0))


_SECOND = 1_000_000_000


@dataclass(frozen=True)
class RecorderConfig:
    """Parameters of a recording; the parts have their own."""

    pairs: int = parameter(34, "Number of stereo pairs", low=2, high=100000)
    rate: float = parameter(2.0, "Stereo pairs per second", unit="Hz", low=0.1, high=60.0)
    state_rate: float = parameter(
        20.0, "Joint states and odometry per second", unit="Hz", low=0.1, high=1000.0
    )
    seed: int = parameter(11, "Seed of all noise of the recording", low=0)
    baseline: float = parameter(
        0.0, "Stereo baseline; 0 = as in the robot description", unit="m", low=0.0, high=2.0
    )
    position_noise: float = parameter(
        0.003, "Standard deviation of camera_pose, each axis", unit="m", low=0.0, high=1.0
    )
    rotation_noise: float = parameter(
        0.0026, "Standard deviation of camera_pose, each axis", unit="rad", low=0.0, high=0.5
    )
    joint_noise: float = parameter(
        0.0005, "Standard deviation of the joint angles", unit="rad", low=0.0, high=0.1
    )
    gain_mismatch: float = parameter(
        0.02, "Sensitivity of the right sensor over the left, minus 1", low=-0.5, high=0.5
    )
    start: float = parameter(
        1_000_000_000.0, "Stamp of the first message", unit="s", low=1.0, high=4e9
    )
    description: str = parameter(
        "config/rover.urdf", "Robot description, below the package's share folder"
    )
    scene: SceneConfig = field(default_factory=SceneConfig)
    camera: StereoCameraConfig = field(default_factory=StereoCameraConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)
        if 0.0 < self.baseline < 0.01:
            raise ConfigError("baseline", self.baseline, "0, or at least 0.01 m")

    @property
    def duration(self) -> float:
        """Time from the first to the last pair [s]."""
        return (self.pairs - 1) / self.rate


class Recorder:
    """Drives the rover through its survey and yields what its topics would carry.

    Args:
        config: the parameters.
    """

    def __init__(self, config: RecorderConfig | None = None) -> None:
        self.config = config = config or RecorderConfig()
        self.description = read_description(find_share(config.description), config.baseline or None)
        self.scene = describe_scene("rover_rocks", config.scene)
        self.world: World = build_scene(self.scene, self.description)
        self.camera = StereoCamera(config.camera, stereo_baseline(self.description))
        self._data = self.world.new_data()
        self._robot = RobotState(self.world.model, self._data)
        self._chassis = Chassis(self.world.model, self._data, self._robot)
        self._survey = Survey(config.duration)
        self._wheels = {f"{wheel}_joint": 0.0 for wheel in self._chassis.wheels}
        noise = np.random.SeedSequence(config.seed).spawn(3)
        self._rng, sensor_rng, odometry_rng = (np.random.default_rng(seed) for seed in noise)
        self._sensor = ImageSensor(sensor_rng)
        self._odometry = Odometry(config.odometry, odometry_rng)
        self._base: FloatArray | None = None
        self._time = 0.0

    def fixed_frames(self) -> list[TransformRecord]:
        """What ``/tf_static`` carries."""
        return fixed_frames(self.description, self._stamp(0.0))

    def records(self) -> Iterator[tuple[str, Record]]:
        """Topic and record of all other topics, in order of time. Runs once."""
        start = self._stamp(0.0)
        yield "/robot_description", TextRecord(start, "", self.description)
        yield "/ground_truth/scene", TextRecord(start, "", self.scene)
        with self.camera.renderer(self.world.model) as renderer:
            for time, is_image in _schedule(self.config):
                duration = time - self._time
                self._move(time)
                yield from self._state_records(time, duration)
                if is_image:
                    yield from self._pose_records(time)
                    yield from self._image_records(time, renderer)

    def _stamp(self, time: float) -> int:
        return round((self.config.start + time) * 1e6) * 1000

    def _move(self, time: float) -> None:
        state = self._survey.at(time)
        base = self._chassis.rest(self.world.terrain, state.x, state.y, state.heading)
        if self._base is not None:
            for joint, turn in self._chassis.wheel_turn(self._base, base).items():
                self._wheels[joint] += turn
        self._base, self._time = base, time
        self._robot.place(base, {**state.joints, **self._wheels})

    def _state_records(self, time: float, duration: float) -> Iterator[tuple[str, Record]]:
        state, stamp = self._survey.at(time), self._stamp(time)
        angles = {**state.joints, **self._wheels}
        positions = np.array(list(angles.values()))
        noisy = positions + self._rng.normal(0.0, self.config.joint_noise, len(positions))
        yield "/joint_states", JointStateRecord(stamp, "", tuple(angles), noisy)
        assert self._base is not None
        estimate = self._odometry.step(self._base, duration)
        yield (
            "/odom",
            OdometryRecord(
                stamp,
                "odom",
                estimate.transform,
                estimate.covariance,
                "base_link",
                estimate.twist,
                estimate.twist_covariance,
            ),
        )

    def _pose_records(self, time: float) -> Iterator[tuple[str, Record]]:
        truth, stamp = self._robot.frame(LEFT_OPTICAL_FRAME), self._stamp(time)
        sigma = np.repeat([self.config.position_noise, self.config.rotation_noise], 3)
        measured = perturb_transform(truth, self._rng.normal(0.0, sigma))
        covariance = np.diag(sigma**2) if sigma.all() else None
        yield "/camera_pose", PoseRecord(stamp, "map", measured, covariance)
        yield "/ground_truth/camera_pose", PoseRecord(stamp, "map", truth)

    def _image_records(self, time: float, renderer: Renderer) -> Iterator[tuple[str, Record]]:
        stamp = self._stamp(time)
        poses = [self._robot.frame(name) for name in (LEFT_OPTICAL_FRAME, RIGHT_OPTICAL_FRAME)]
        lights = self.camera.capture(renderer, self._data, poses[0], poses[1])
        self._sensor.adjust(lights[0])
        sides = (
            ("/left", LEFT_OPTICAL_FRAME, self.camera.left, 1.0),
            ("/right", RIGHT_OPTICAL_FRAME, self.camera.right, 1.0 + self.config.gain_mismatch),
        )
        for (topic, frame, calibration, gain), light in zip(sides, lights, strict=True):
            pixels = self._sensor.expose(light, gain)
            yield f"{topic}/camera_info", CameraInfoRecord(stamp, frame, calibration)
            yield f"{topic}/image_raw", ImageRecord(stamp, frame, pixels, "mono8")


def record_bag(path: Path | str, config: RecorderConfig | None = None) -> Path:
    """Record the survey as a rosbag2 (mcap, zstd).

    Args:
        path: folder to write; a bag that is there is replaced.
        config: the parameters.

    Returns:
        The folder.

    Raises:
        BagError: the folder cannot be written.
        SimulationError: this machine cannot draw images.
    """
    recorder = Recorder(config)
    with BagWriter(path, overwrite=True) as writer:
        writer.write_transforms("/tf_static", recorder.fixed_frames())
        for topic, record in recorder.records():
            writer.write(topic, record)
    return Path(path)


def _schedule(config: RecorderConfig) -> list[tuple[float, bool]]:
    """Times [s] from the start at which something is recorded, and whether images are."""
    images = np.arange(config.pairs) / config.rate
    states = np.arange(0.0, config.duration, 1.0 / config.state_rate)
    far = np.abs(states[:, None] - images[None, :]).min(axis=1) > 1e-4
    times = [(float(t), True) for t in images] + [(float(t), False) for t in states[far]]
    return sorted(times)


def main(arguments: Sequence[str] | None = None) -> None:
    """Record a bag from the command line."""
    defaults = RecorderConfig()
    parser = argparse.ArgumentParser(
        prog="infomap record-demo-bag",
        description="Record a stereo bag in simulation.",
        epilog="Example: infomap record-demo-bag my_bag --pairs 20",
    )
    parser.add_argument("out", type=Path, help="folder of the bag")
    parser.add_argument("--pairs", type=int, default=defaults.pairs)
    parser.add_argument("--rate", type=float, default=defaults.rate, help="pairs per second [Hz]")
    parser.add_argument("--seed", type=int, default=defaults.seed, help="seed of the noise")
    parser.add_argument("--world-seed", type=int, default=defaults.scene.seed)
    parser.add_argument("--width", type=int, default=defaults.camera.width, help="[px]")
    parser.add_argument("--height", type=int, default=defaults.camera.height, help="[px]")
    given = parser.parse_args(arguments)
    record_bag(
        given.out,
        RecorderConfig(
            pairs=given.pairs,
            rate=given.rate,
            seed=given.seed,
            scene=SceneConfig(seed=given.world_seed),
            camera=StereoCameraConfig(width=given.width, height=given.height),
        ),
    )


if __name__ == "__main__":
    main()
