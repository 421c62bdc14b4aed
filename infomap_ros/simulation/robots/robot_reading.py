"""Reads a stranger's URDF: what it says, what is guessed where it says nothing, and why."""

from __future__ import annotations

import fnmatch
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.vehicle import VehicleConfig
from infomap_ros.motion.collision.body import CollisionConfig
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.extended_description import (
    CART,
    CART_CASTERS,
    CART_WHEELS,
    DEFAULT_CAMERA,
    extended_description,
    root_link,
)
from infomap_ros.simulation.body.robot import find_description, read_description
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.robots.camera_parts import (
    LEAST_BASELINE,
    ArmEnd,
    CameraPart,
    WheelParts,
    find_arm_ends,
    find_cameras,
    find_telescopes,
    find_wheels,
    joints_between,
    link_extents,
)
from infomap_ros.simulation.robots.home_posture import home_posture, tucked_arms
from infomap_ros.simulation.robots.ready_robot import initial_positions, mended_parts
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.simulation.robots.trial_drive import TrialDrive, try_drive

_FEWEST_JOINTS = 4  # that move a camera by which a robot looks into corners
_FEWEST_WHEELS = 3  # on which planning can have it stand
_BASELINE = 0.06  # of cameras that are assumed, as of common stereo cameras [m]
_SPARE = 0.02  # from the last solid of the arm to a camera that is added [m]
_CART = (0.55, 0.45, 0.3)  # length, width, height [m] under an arm
_WIDEST_FOOT = 0.35  # of an arm, across [m]
_NEAR_GROUND = 0.015  # [m] of the lowest point of what would drag on it
_NEAR_ROOT = 0.05  # [m]: a base whose frame is on the ground
_LOW = 0.3  # what is below is the robot's base [m]
_VISIBLE = re.compile(r"wheel|caster|footprint", re.IGNORECASE)  # of robots with a base
_CAMERA = re.compile(r"cam", re.IGNORECASE)
_PACKAGE = re.compile(r"package://[^/]+/")
_FIXED = "fixed on the base"
_GAIN_DIFFERS = 1.3  # by this factor a measured gain is written down


@dataclass(frozen=True)
class RobotReading:
    """A robot that was read.

    Attributes:
        file: what is to be written down; its `reasons` tell guesses.
        robot: the model with base, camera and arm, at which the drawing looks.
        understood: what the description says, a line each.
        guesses: what it does not say, what is taken, and why.
        warnings: what is wrong with it, and what was done.
        stands: whether it stays upright in simulation.
    """

    file: RobotFile
    robot: RobotModel
    understood: tuple[str, ...]
    guesses: tuple[str, ...]
    warnings: tuple[str, ...]
    stands: bool = True


def read_robot(place: str, camera: str = "") -> RobotReading:
    """Read a robot's URDF and complete what it lacks.

    Args:
        place: path or ``package://`` address of the URDF.
        camera: optical frame of the left camera, or a link on which one is put; empty for the
            one that most joints move.

    Raises:
        ResourceError: there is no such file.
        RobotModelError: it is malformed, has neither a camera nor an arm, or lacks `camera`.
    """
    path = find_description(place)
    if "://" not in place:
        place = str(path)
    return _Reading(read_description(path), camera).result(place)


class _Reading:
    """Collects what is understood of a description, step by step."""

    def __init__(self, text: str, camera: str) -> None:
        self._text, self._wanted = text, camera
        self._tree = ElementTree.fromstring(text)
        self._said: list[str] = []
        self._guesses: list[str] = []
        self._warnings: list[str] = []
        self._reasons: dict[str, str] = {}
        self._setup = RobotSetupConfig(base_frame=root_link(self._tree))
        self._gain, self._stands = 0.0, True
        self._resting: tuple[str, ...] = ()
        self._driver: tuple[str, tuple[str, ...]] = ("none", ())

    def result(self, place: str) -> RobotReading:
        bare = RobotModel.from_urdf(self._text, base_frame=self._setup.base_frame)
        if bare.missing:
            raise RobotModelError(self._missing(bare.missing))
        self._say_base(bare)
        self._find_telescopes(bare)
        self._find_wheels(bare)
        self._find_camera()
        text = extended_description(self._text, self._setup)
        robot = self._model(text)
        self._tuck_others(robot)
        self._find_arm(robot)
        self._say_solids(robot, text)
        self._try_drive()
        wheels = self._ground_links()
        named = "" if self._setup.camera_mount else self._setup.left_camera_frame
        file = RobotFile(
            place,
            replace(self._setup, left_camera_frame=named),
            self._gain,
            _patterns(wheels, VehicleConfig().wheel_links.split(","), robot),
            _patterns((*wheels, *self._setup.hovering), CollisionConfig().ground_links, robot),
            () if self._setup.cart else self._setup.wheels,
            *self._footprint(robot, wheels),
            *self._driver,
            self._reasons,
        )
        found = (tuple(self._said), tuple(self._guesses), tuple(self._warnings))
        return RobotReading(file, robot, *found, self._stands)

    def _model(self, text: str) -> RobotModel:
        setup = self._setup
        frames = setup.left_camera_frame, setup.base_frame
        return RobotModel.from_urdf(text, *frames, mimics=setup.leaders)

    def _guess(self, name: str, text: str, short: str) -> None:
        self._guesses.append(f"{name}: {text}")
        self._reasons[name] = f"GUESSED: {short}"

    def _missing(self, meshes: Sequence[str]) -> str:
        """What to do about collision meshes without which nothing can be planned."""
        names = [mesh.get("filename", "") for mesh in self._tree.iter("mesh")]
        packages = dict.fromkeys(name.split("/")[2] for name in names if _PACKAGE.match(name))
        which = f"the folder that holds {', '.join(packages)} must be in ROS_PACKAGE_PATH"
        advice = (
            f"{which}, or its workspace be sourced" if packages else "they lie as it names them?"
        )
        return f"{len(meshes)} collision meshes cannot be read ({meshes[0]} ...): {advice}"

    def _say_base(self, robot: RobotModel) -> None:
        moving = len(robot.joints)
        self._said.append(
            f"robot '{robot.name}': {len(robot.frames)} links, {moving} moving joints; "
            f"base_frame: {robot.base_frame}, the root"
        )

    def _find_telescopes(self, robot: RobotModel) -> None:
        followers = find_telescopes(robot)
        if not followers:
            return
        pairs = tuple(f"{follower}:{leader}" for follower, leader in followers.items())
        self._setup = replace(self._setup, mimics=pairs)
        names = ", ".join(dict.fromkeys([*followers.values(), *followers]))
        text = f"{names} slide one from another over equal ranges, as if by one motor"
        self._guess("robot.mimics", text, "a telescope with one motor")

    def _find_wheels(self, robot: RobotModel) -> None:
        wheels = find_wheels(robot)
        if wheels.left:
            self._take_wheels(wheels)
            return
        extents = link_extents(robot)
        rolls = any(_VISIBLE.search(name) for name in robot.frames) or _is_base(extents, robot)
        cart = _base_size(list(extents.values())) if rolls else _CART
        kind = "wheels that turn are missing" if rolls else "it is an arm without a base"
        base = self._setup.base_frame if rolls else CART
        lowest = min((low[2] for low, _ in extents.values()), default=0.0) + _NEAR_GROUND
        low_links = [name for name, (low, _) in extents.items() if low[2] < lowest]
        left, right = CART_WHEELS
        self._setup = replace(
            self._setup,
            cart=cart,
            base_frame=base,
            left_wheels=left,
            right_wheels=right,
            casters=CART_CASTERS,
            hovering=tuple(low_links) if rolls else (),
        )
        size = " x ".join(f"{side:g}" for side in cart)
        text = f"{kind}; a base of {size} m with two driven wheels and casters is put under it"
        self._guess("robot.cart", text, f"{kind}; length, width, height")
        if base == CART:
            self._reasons["base_frame"] = "the base that is put under it"

    def _take_wheels(self, wheels: WheelParts) -> None:
        self._setup = replace(
            self._setup,
            left_wheels=wheels.left,
            right_wheels=wheels.right,
            casters=wheels.casters,
            hovering=wheels.hovering,
        )
        for name in ("left_wheels", "right_wheels", "casters"):
            found = getattr(wheels, name.removesuffix("_wheels"))
            if found:
                self._said.append(f"robot.{name}: {', '.join(found)}")

    def _find_camera(self) -> None:
        robot = RobotModel.from_urdf(
            self._text, base_frame=root_link(self._tree), mimics=self._setup.leaders
        )
        cameras = find_cameras(robot)
        arms = [end for end in find_arm_ends(robot) if not self._is_wheel(end)]
        if self._wanted:
            self._take_wanted(robot, cameras, arms)
            return
        best = cameras[0] if cameras else None
        arm = arms[0] if arms else None
        if arm is not None and (
            best is None or len(best.joints) < _FEWEST_JOINTS <= len(arm.joints)
        ):
            self._mount(robot, arm, best)
            return
        if best is None:
            self._wanted = next(filter(_CAMERA.search, robot.frames), "")
            if not self._wanted:
                raise RobotModelError(
                    f"robot '{robot.name}' has no arm, and no link with 'optical' or 'cam' in its "
                    f"name; --camera LINK puts a camera on one of {', '.join(robot.frames[:4])} ..."
                )
            self._take_wanted(robot, cameras, arms)
            return
        self._take(best)
        rivals = [c.frame for c in cameras[1:] if len(c.joints) == len(best.joints)]
        if rivals:
            text = f"{best.frame}, of {', '.join([best.frame, *rivals])} (--camera takes another)"
            self._guess("robot.left_camera_frame", text, "others are alike")

    def _is_wheel(self, end: ArmEnd) -> bool:
        return set(end.joints) <= set(self._setup.wheels) or end.link in self._setup.casters

    def _take(self, camera: CameraPart) -> None:
        self._setup = replace(self._setup, left_camera_frame=camera.frame)
        moved = f"moved by {len(camera.joints)} joints" if camera.joints else _FIXED
        self._said.append(f"robot.left_camera_frame: {camera.frame}, {moved}")
        if camera.right and camera.baseline >= LEAST_BASELINE:
            self._setup = replace(self._setup, right_camera_frame=camera.right)
            self._said.append(
                f"robot.right_camera_frame: {camera.right}, at {camera.baseline:.4g} m"
            )
            return
        self._assume_right_camera(camera)

    def _assume_right_camera(self, camera: CameraPart | None) -> None:
        self._setup = replace(self._setup, baseline=_BASELINE)
        reason = "no right camera beside it"
        if camera is not None and camera.right:
            reason = f"{camera.right} is only {1000.0 * camera.baseline:.0f} mm beside it"
        self._guess("robot.baseline", f"{_BASELINE} m, as {reason}", reason)

    def _take_wanted(
        self, robot: RobotModel, cameras: Sequence[CameraPart], arms: Sequence[ArmEnd]
    ) -> None:
        wanted = self._wanted
        known = next((camera for camera in cameras if camera.frame == wanted), None)
        if known is not None:
            self._take(known)
            return
        if wanted not in robot.frames:
            near = ", ".join(camera.frame for camera in cameras[:4]) or "none"
            raise RobotModelError(f"--camera {wanted} is no link; optical frames: {near}")
        joints = joints_between(robot, wanted)
        arm = next((end for end in arms if end.link == wanted), None)
        looks_along_x = _CAMERA.search(wanted) or not joints
        forward = np.eye(3)[0 if looks_along_x else 2]
        self._mount(robot, arm or ArmEnd(wanted, joints, forward, 0.0), None)

    def _mount(self, robot: RobotModel, arm: ArmEnd, other: CameraPart | None) -> None:
        """Put a camera on the end of an arm, before all that its last joint carries."""
        rest = {joint.name: joint.rest for joint in robot.joints}
        rotation = _optical_on(arm.outward, robot.forward_kinematics(rest, arm.link))
        place = (arm.length + _SPARE) * arm.outward
        turn = pinocchio.rpy.matrixToRpy(rotation)
        numbers = " ".join(f"{value + 0.0:.4g}" for value in (*place, *np.round(turn, 4)))
        self._setup = replace(
            self._setup,
            camera_mount=f"{arm.link}: {numbers}",
            left_camera_frame=DEFAULT_CAMERA,
        )
        lacks = "no optical frame"
        if other is not None:
            on = f"on {len(other.joints)} joints" if other.joints else _FIXED
            lacks = f"only {other.frame}, {on}"
        axis = "xyz"[int(np.argmax(np.abs(arm.outward)))]
        text = (
            f"{lacks}; a camera is put on {arm.link}, behind {len(arm.joints)} joints, "
            f"{place @ arm.outward:.3g} m out along its {axis} axis (--camera takes another link)"
        )
        self._guess("robot.camera_mount", text, f"{lacks}; x y z [m] roll pitch yaw [rad]")
        self._assume_right_camera(None)

    def _tuck_others(self, robot: RobotModel) -> None:
        """Put arms that do not carry the camera where they are not in the way."""
        start = initial_positions(self._tree)
        tucked = tucked_arms(robot, self._setup.wheels)
        if not tucked or start.keys() & set(tucked):
            return
        held = tuple(f"{name}:{position:g}" for name, position in tucked.items())
        self._setup = replace(self._setup, held=held)
        text = "an arm that does not carry the camera is stretched out at zero, and is tucked in"
        self._guess("robot.held", f"{', '.join(held)}: {text}", "tucked in, else it is in the way")

    def _find_arm(self, robot: RobotModel) -> None:
        names = robot.arm.joint_names
        if not names:
            self._said.append("arm_joints: none; the base alone brings the camera to views")
            return
        self._said.append(f"arm_joints: {', '.join(names)}, all between base and camera")
        self._setup = replace(self._setup, arm_joints=names)
        self._driver = ("", (f"arm_controller: {' '.join(names)}",))
        text = "one for the whole arm; ros2 control list_controllers -v says what there is"
        self._guess("controllers", text, "ros2 control list_controllers -v")
        start = initial_positions(self._tree)
        if start.keys() & set(names):
            known = tuple(start.get(name, 0.0) for name in names)
            values = ", ".join(f"{value:g}" for value in known)
            self._setup = replace(self._setup, home=known)
            self._said.append(f"robot.home: {values}, the initial values in <ros2_control>")
            return
        others = self._setup.held_positions
        home = tuple(float(round(value, 3)) + 0.0 for value in home_posture(robot, others))
        self._setup = replace(self._setup, home=home)
        values = ", ".join(f"{value:g}" for value in home)
        text = f"{values}: the camera looks ahead, upright, and the arm touches nothing"
        self._guess("robot.home", text, "the camera looks ahead, the arm touches nothing")

    def _say_solids(self, robot: RobotModel, text: str) -> None:
        meshes = [
            Path(mesh.get("filename", "")).suffix.lower()
            for mesh in self._tree.iterfind("link/collision/geometry/mesh")
        ]
        counts = ", ".join(f"{meshes.count(kind)} {kind}" for kind in dict.fromkeys(meshes))
        plain = len(robot.shapes) - len(meshes)
        links = len(robot.links_with_solids)
        what = ", ".join(filter(None, (counts and f"meshes: {counts}", f"{plain} plain shapes")))
        self._said.append(f"collision: {len(robot.shapes)} solids on {links} links ({what})")
        masses = [float(inertia.mass) for inertia in robot.model.inertias]
        self._said.append(f"mass: {sum(masses):.1f} kg")
        bare = [
            link.get("name", "")
            for link in self._tree.findall("link")
            if link.find("visual") is not None and link.find("collision") is None
        ]
        if bare:
            names = ", ".join(bare[:4]) + (f" and {len(bare) - 4} more" * (len(bare) > 4))
            self._warnings.append(
                f"links that are seen and have no collision solid: {names}; planning ignores them; "
                "they are kept out of the map as far as their meshes can be read"
            )
        self._warnings.extend(mended_parts(text))

    def _try_drive(self) -> None:
        """Take the gain and the friction by which it turns, and warn of what goes wrong."""
        trial = self._try_low_links(try_drive(self._text, self._setup))
        self._stands = trial.stands
        if not trial.problem and not trial.turns:
            rolling = replace(self._setup, rollers=True)
            again = try_drive(self._text, rolling)
            if again.turns:
                self._setup, trial = rolling, again
                text = "its motors cannot turn it while the wheels grip, as if they were mecanum"
                self._guess("robot.rollers", f"true: {text}", "mecanum wheels?")
        turned = trial.fitting_gain
        if turned > 0.0 and not 1.0 / _GAIN_DIFFERS < turned / trial.gain < _GAIN_DIFFERS:
            self._gain = float(round(min(max(turned, 0.5), 5.0), 2))
            text = f"{self._gain:g}, by a turn in simulation (by geometry {trial.gain:.2g})"
            self._guess("drive.turn_gain", text, "measured by a turn in simulation")
        problem = trial.problem or (
            "" if trial.turns else "commanded to turn by 3 rad, it hardly turns"
        )
        if problem:
            wheels = ", ".join(self._setup.wheels)
            self._warnings.append(f"it does not drive on {wheels}: {problem}")
        if trial.contacts:
            self._warnings.append(f"in simulation {trial.contacts}")

    def _try_low_links(self, trial: TrialDrive) -> TrialDrive:
        """Have it rest on links that are drawn down to the ground, where it tips over else."""
        low = self._setup.hovering
        if not low:
            return trial
        names = ", ".join(low)
        if not trial.stands:
            resting = replace(self._setup, casters=(*self._setup.casters, *low), hovering=())
            again = try_drive(self._text, resting)
            if again.stands:
                self._setup, self._resting = resting, low
                text = "it tips over without: casters are drawn into it"
                self._guess("robot.casters", f"{names} slides on the ground; {text}", text)
                return again
        text = "large and drawn down to the ground; taken to be clear of it"
        self._guess("robot.hovering", f"{names} is {text}", text)
        return trial

    def _footprint(
        self, robot: RobotModel, wheels: Sequence[str]
    ) -> tuple[tuple[float, ...], float, float]:
        """What it stands on where fewer than three wheels are to be seen; see `RobotFile`."""
        extents = {name: e for name, e in link_extents(robot).items() if name in wheels}
        rolling = [e for name, e in extents.items() if name not in self._resting]
        if len(rolling) >= _FEWEST_WHEELS or not rolling:
            return (), 0.0, 0.0
        x0, y0, z0 = np.min([low for low, _ in extents.values()], axis=0).round(3)
        x1, y1, _ = np.max([high for _, high in extents.values()], axis=0).round(3)
        corners = tuple(float(value) for value in (x0, y0, x1, y0, x1, y1, x0, y1))
        radius = 0.5 * min(float(high[2] - low[2]) for low, high in rolling)
        step = round(float(VehicleConfig().limits_for(radius)[2]), 3)
        text = f"it has {len(rolling)} wheels and casters; the area of all that touches the ground"
        self._guess("reaching.vehicle.footprint", text, text)
        return corners, float(z0), step

    def _ground_links(self) -> tuple[str, ...]:
        """Links with solids on which it rolls."""
        wheels = set(self._setup.wheels)
        carried = [
            joint.find("child").get("link", "")  # type: ignore[union-attr]
            for joint in ElementTree.fromstring(
                extended_description(self._text, self._setup)
            ).findall("joint")
            if joint.get("name") in wheels
        ]
        return (*carried, *self._setup.casters)


def _optical_on(forward: FloatArray, T_base_link: FloatArray) -> FloatArray:
    """Axes of an optical frame on a link that looks along one of its axes, shape (3, 3).

    Of the four rolls the one is taken whose y axis points down most, the robot at rest.
    """
    down = T_base_link[:3, :3].T @ np.array([0.0, 0.0, -1.0])
    across = [
        sign * axis for axis in np.eye(3) for sign in (1.0, -1.0) if abs(axis @ forward) < 0.5
    ]
    y = max(across, key=lambda axis: float(axis @ down))
    return np.column_stack([np.cross(y, forward), y, forward])


def _is_base(extents: Mapping[str, tuple[FloatArray, FloatArray]], robot: RobotModel) -> bool:
    """Whether what no joint moves is too wide for the foot of an arm, and stands on the ground."""
    still = np.array([extents[shape.link] for shape in robot.shapes if shape.joint == 0])
    if not len(still):
        return False
    low, high = still[:, 0].min(axis=0), still[:, 1].max(axis=0)
    return bool((high - low)[:2].min() > _WIDEST_FOOT and low[2] > -_NEAR_ROOT)


def _base_size(extents: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[float, float, float]:
    """Length and width of what is low [m], and height 0."""
    ground = min(float(low[2]) for low, _ in extents)
    below = [(low, high) for low, high in extents if low[2] < ground + _LOW]
    reach = [max(max(-low[axis], high[axis]) for low, high in below) for axis in (0, 1)]
    return (float(round(2.0 * reach[0], 2)), float(round(2.0 * reach[1], 2)), 0.0)


def _patterns(links: Iterable[str], default: Sequence[str], robot: RobotModel) -> tuple[str, ...]:
    """File-name patterns of links among those with solids; empty where the default has the same."""
    solid = robot.links_with_solids
    wanted = {link for link in links if link in solid}

    def matched(patterns: Iterable[str]) -> set[str]:
        return {k for k in solid if any(fnmatch.fnmatchcase(k, p.strip()) for p in patterns)}

    if matched(default) == wanted:
        return ()
    short = [p for p in ("*wheel*", "*caster*") if (hit := matched([p])) and hit <= wanted]
    return (*short, *sorted(wanted - matched(short)))
