"""Draws what was understood of a robot: its parts, where its camera gets, and what it sees."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import ConvexHull, QhullError

from infomap_ros.errors import SimulationError
from infomap_ros.geometry import Box, Cylinder, PinholeCamera, PlacedSolid, transform_points
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.body_shapes import BodyShape
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import random_postures
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.body.robot_body import PREFIX
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.cameras.rendering import Renderer
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.simulation.robots.robot_reading import RobotReading
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.gallery import look_at
from infomap_ros.simulation.worlds.scenes import make_world

import mujoco  # isort: skip  # after the backend has been chosen

_BODY, _WHEEL, _CASTER, _ARM = "#a7adb5", "#2b6cb0", "#2f9e77", "#d9822b"
_CAMERA, _REACH, _INK = "#c2255c", "#f3d9e4", "#333a44"
_VIEW = 0.8  # drawn length of the camera's view [m]
_POSTURES = 20000
_CELL = 0.04  # of the picture of the reach [m]
_AROUND, _AWAY, _ABOVE = 12, 2.4, 1.0  # places from which it may be seen; over its height
_PHOTO = PinholeCamera(720, 600, 700.0, 700.0, 359.5, 299.5)
_WORLD, _SEED, _SIZE = "office", 1, 7.0


def draw_robot(reading: RobotReading, path: Path) -> None:
    """Draw a robot in its start posture: from the side, from above, in the office, and its image.

    The body is that of the collision solids. On a machine that cannot render, the two lower
    pictures say so.

    Args:
        reading: of the robot.
        path: of the picture.

    Raises:
        OSError: the picture cannot be written.
    """
    figure = Figure(figsize=(12.0, 11.4), dpi=110, facecolor="white")
    axes = figure.subplots(2, 2, height_ratios=(1.1, 1.0))
    _draw_projections(axes[0], reading)
    _draw_photos(axes[1], reading.file)
    figure.suptitle(_title(reading), x=0.02, ha="left", fontsize=15, color=_INK, weight="bold")
    handles = _legend(reading.file.setup)
    place = {"loc": "upper left", "bbox_to_anchor": (0.012, 0.962), "ncols": len(handles)}
    figure.legend(handles=handles, fontsize=9, frameon=False, columnspacing=1.4, **place)
    guesses = [textwrap.shorten(text, 150) for text in reading.guesses]
    note = "\n".join(f"guessed  {text}" for text in guesses)
    figure.text(0.02, 0.012, note, fontsize=8.5, color=_INK, va="bottom", family="monospace")
    bottom = 0.02 + 0.0135 * len(guesses)
    figure.tight_layout(rect=(0.0, bottom, 1.0, 0.945), h_pad=1.2, w_pad=1.5)
    save_figure(figure, path)


def _title(reading: RobotReading) -> str:
    setup = reading.file.setup
    wheels, joints = len(setup.wheels), len(setup.arm_joints)
    return (
        f"{reading.robot.name}: {_many(wheels, 'driven wheel')}, "
        f"{_many(len(setup.casters), 'caster')}, "
        f"camera {'on ' + _many(joints, 'joint') if joints else 'fixed on the base'}"
    )


def _many(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _draw_projections(axes: NDArray[np.object_], reading: RobotReading) -> None:
    robot, setup = reading.robot, reading.file.setup
    home = dict(zip(setup.arm_joints, setup.home, strict=True))
    joints = {joint.name: joint.rest for joint in robot.joints} | home
    outlines = _outlines(robot, joints)
    colors = _colors(robot, reading.file)
    cameras = robot.arm.camera_pose(random_postures(robot, _POSTURES, np.random.default_rng(0)))
    camera = robot.forward_kinematics(joints, robot.camera_frame)
    ground = min(float(points[:, 2].min()) for _, points in outlines)
    views = ((0, 2, "from the side"), (0, 1, "from above"))
    for ax, (across, up, title) in zip(axes, views, strict=True):
        _draw_reach(ax, cameras[:, [across, up], 3])
        order = 1 if up == 2 else 2
        for link, points in sorted(outlines, key=lambda item: _depth(item[1], order)):
            is_hidden = up == 1 and link in colors
            _draw_hull(ax, points[:, [across, up]], colors.get(link, _BODY), is_hidden)
        places = [robot.forward_kinematics(joints, link)[:3, 3] for link in _arm_links(robot)]
        chain = np.array([*places, camera[:3, 3]])[:, [across, up]]
        ax.plot(*chain.T, "o-", color=_ARM, lw=1.6, ms=4.5, zorder=5)
        _draw_view(ax, camera, across, up)
        if up == 2:
            ax.axhline(ground, color=_INK, lw=1.2, zorder=0)
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_title(title, loc="left", fontsize=11, color=_INK)
        ax.set_xlabel("x [m]")
        ax.set_ylabel("z [m]" if up == 2 else "y [m]")
        ax.grid(color="#e8eaee", lw=0.6)
        ax.set_axisbelow(True)


def _legend(setup: RobotSetupConfig) -> list[Patch | Line2D]:
    """What the colors mean."""
    casters = [Patch(color=_CASTER, label="casters")] if setup.casters else []
    return [
        Patch(color=_WHEEL, label="driven wheels"),
        *casters,
        Patch(color=_BODY, label="collision solids"),
        Line2D([], [], color=_ARM, marker="o", ms=4.5, label="joints that move the camera"),
        Line2D([], [], color=_CAMERA, label=f"its view, {_VIEW:g} m of it"),
        Patch(color=_REACH, label="where the camera gets"),
    ]


def _depth(points: FloatArray, axis: int) -> float:
    """What is drawn later lies nearer to the viewer: on the right side, or above."""
    return float(-points[:, axis].mean() if axis == 1 else points[:, axis].max())


def _colors(robot: RobotModel, file: RobotFile) -> Mapping[str, str]:
    """Color of each link that is not plain body."""
    model, setup = robot.model, file.setup
    colors = dict.fromkeys(setup.casters, _CASTER)
    for name in setup.wheels:
        index = int(model.getJointId(name))
        frames = [f for f in model.frames if int(f.parentJoint) == index]
        colors |= {str(f.name): _WHEEL for f in frames if f.type == pinocchio.FrameType.BODY}
    return colors


def _arm_links(robot: RobotModel) -> list[str]:
    """A link that each joint of the arm carries, from the base on, at the joint itself."""
    model, links = robot.model, []
    for name in robot.arm.joint_names:
        index = int(model.getJointId(name))
        links += [
            str(frame.name)
            for frame in model.frames
            if int(frame.parentJoint) == index and frame.type == pinocchio.FrameType.BODY
        ][:1]
    return links


def _outlines(robot: RobotModel, joints: Mapping[str, float]) -> list[tuple[str, FloatArray]]:
    """Links and points of the outline of each of their solids, base frame [m]."""
    solids = robot.solids_in(robot.base_frame, joints)
    pairs = zip(robot.shapes, solids, strict=True)
    return [(shape.link, _points(shape, solid)) for shape, solid in pairs]


def _points(shape: BodyShape, placed: PlacedSolid) -> FloatArray:
    solid = placed.solid
    if isinstance(solid, Box):
        signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
        return transform_points(placed.transform, signs * np.array(solid.size))
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    if isinstance(solid, Cylinder):
        ends = [ring * solid.radius + (0.0, 0.0, z * solid.length) for z in (-0.5, 0.5)]
        return transform_points(placed.transform, np.concatenate(ends))
    vertices = shape.vertices
    if vertices is not None:
        return transform_points(placed.transform, vertices)
    rings = [np.roll(ring, turn, axis=1) * solid.bounding_radius for turn in range(3)]
    return transform_points(placed.transform, np.concatenate(rings))


def _draw_hull(ax: Axes, points: FloatArray, color: str, is_hidden: bool) -> None:
    """Fill the hull of points, shape (N, 2) [m]; what is hidden is outlined over the others."""
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:
        return  # a plate seen from its edge
    if is_hidden:
        ax.add_patch(Polygon(corners, fill=False, edgecolor=color, lw=1.6, zorder=4))
    else:
        face = Polygon(corners, facecolor=color, edgecolor=_INK, lw=0.5, alpha=0.9, zorder=2)
        ax.add_patch(face)


def _draw_reach(ax: Axes, points: FloatArray) -> None:
    """Fill the region in which points, shape (N, 2) [m], lie densely enough."""
    low, high = points.min(axis=0) - 5 * _CELL, points.max(axis=0) + 5 * _CELL
    bins = [np.arange(a, b + _CELL, _CELL) for a, b in zip(low, high, strict=True)]
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=bins)[0].T
    smooth = gaussian_filter((counts > 0).astype(float), 1.2)
    x, y = (0.5 * (edges[1:] + edges[:-1]) for edges in bins)
    ax.contourf(x, y, smooth, levels=[0.35, 2.0], colors=[_REACH], zorder=0)
    ax.contour(x, y, smooth, levels=[0.35], colors=[_CAMERA], linewidths=0.7, zorder=0)


def _draw_view(ax: Axes, camera: FloatArray, across: int, up: int) -> None:
    config = StereoCameraConfig()
    wide = np.tan(0.5 * config.field_of_view)
    tall = wide * config.height / config.width
    rays = np.array([(u * wide, v * tall, 1.0) for u in (-1.0, 1.0) for v in (-1.0, 1.0)])
    ends = transform_points(camera, _VIEW * rays)
    corners = np.vstack([camera[:3, 3], ends])[:, [across, up]]
    hull = corners[ConvexHull(corners).vertices]
    ax.add_patch(Polygon(hull, facecolor=_CAMERA, alpha=0.13, zorder=3))
    ax.add_patch(Polygon(hull, fill=False, edgecolor=_CAMERA, lw=1.3, zorder=6))
    axis = np.vstack([camera[:3, 3], camera[:3, 3] + 0.25 * camera[:3, 2]])[:, [across, up]]
    ax.annotate("", axis[1], axis[0], arrowprops={"arrowstyle": "->", "color": _CAMERA}, zorder=7)


def _draw_photos(axes: NDArray[np.object_], file: RobotFile) -> None:
    titles = (f"at the start of the {_WORLD}", "what its left camera sees there")
    pictures: list[NDArray[np.uint8]] = []
    try:
        pictures = _photos(file)
    except SimulationError as error:
        for ax in axes:
            ax.text(0.5, 0.5, textwrap.fill(str(error), 60), ha="center", va="center", fontsize=8)
    for ax, title in zip(axes, titles, strict=True):
        ax.set_title(title, loc="left", fontsize=11, color=_INK)
        ax.set_xticks([])
        ax.set_yticks([])
    for ax, picture in zip(axes, pictures, strict=False):
        ax.imshow(picture, cmap="gray", vmin=0, vmax=255)


def _photos(file: RobotFile) -> list[NDArray[np.uint8]]:
    """The robot in the office, (H, W, 3), and what it sees, (H, W)."""
    world = make_world(_WORLD, _SEED, size=_SIZE)
    config = SimulatorConfig(robot=file.setup)
    robot = Simulator(world, read_description(file.description_path), config)
    seen = robot.capture().left
    base = robot.true_pose()[:3, 3]
    top = float(_heights(robot).max() - base[2])
    middle = base + np.array((0.15, 0.0, 0.5 * top))
    photo = _best_photo(robot, middle, max(top, 0.8))
    robot.close()
    return [photo, seen]


def _heights(robot: Simulator) -> FloatArray:
    """Of the middles of its solids and visuals in the world, shape (G,) [m]."""
    model, data = robot.scene
    return np.array(data.geom_xpos[_is_own(model)][:, 2])


def _is_own(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which geoms are the robot's, shape (G,)."""
    bodies = [model.body(int(body)).name for body in model.geom_bodyid]
    return np.array([name.startswith(PREFIX) for name in bodies], dtype=bool)


def _best_photo(robot: Simulator, middle: FloatArray, size: float) -> NDArray[np.uint8]:
    """The robot from that place around it from which most of it is seen, shape (H, W, 3)."""
    model, data = robot.scene
    own = _is_own(model)
    best, most = look_at(middle + np.array((1.0, -1.0, 1.0)), middle), -1
    with Renderer(model, _PHOTO.width, _PHOTO.height) as renderer:
        for angle in np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False) + 0.5:
            away = np.array([_AWAY * np.cos(angle), _AWAY * np.sin(angle), _ABOVE])
            eye = look_at(middle + size * away, middle)
            ids = renderer.geom_ids(data, eye, _PHOTO)
            shown = int(own[ids[ids >= 0]].sum())
            if shown > most:
                best, most = eye, shown
        return renderer.color(data, best, _PHOTO)
