"""Landmarks that are given: poses from measurements of points or tags that others have named.

    python benchmarks/given_landmarks.py [--data FOLDER]

`starry_night`: a stereo camera among 20 points of known places, one to twenty in an image or none,
with a gyroscope and a speedometer; poses against motion capture. `tag_corners`: corners of tags as
another detector found them in images of a moving camera, by the localizer that the node runs with
`use_detections`; poses against TagSLAM's optimum over all images. Prints one JSON line for each
row.
"""

from __future__ import annotations

import argparse
import bz2
import json
import tempfile
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import yaml
from rosbags.highlevel import AnyReader
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, invert_transform, make_transform, skew
from infomap_ros.geometry.transforms import FloatArray, transform_from_quaternion
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.fiducials.range_view import DepthView
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig, make_detector
from infomap_ros.localization.target.scene_tags import SceneTagsConfig
from infomap_ros.localization.target.tag_board import TagBoardConfig
from infomap_ros.localization.target.tag_detection import TagDetectionsRecord, believed_tags
from infomap_ros.localization.target.tag_detector import TagTargetConfig
from infomap_ros.localization.target.target import invert_pose
from infomap_ros.messages.fiducials import decode_tag_detections
from infomap_ros.stereo import RangeCloud

Row = dict[str, Any]
STARRY_NIGHT = "starry_night/dataset3.mat"
TAG_SETS = (
    ("test_16", ("cam0",)),
    ("test_17", ("cam0",)),
    ("test_4", tuple(f"cam{number}" for number in range(1, 8))),
    ("test_1", ("cam0",)),
    ("test_2", ("cam0",)),
    ("test_2", ("cam1",)),
)
"""Sets of `tag_corners` and cameras that see tags whose places are given. Not of test_10: its tags
are given to 0.5 m and its reference is as uncertain; nor of test_15: tags of three sizes on the
target, and a reference of the last two images alone."""
FAMILY = "tag36h11"
START = np.diag(np.square([0.01] * 3 + [0.01] * 3))  # of the first pose [m^2, rad^2]


class StarryNight:
    """The data set "Starry Night" as images of a camera half-way between the two.

    How far both images share their errors is not told: a place in the image is taken to have the
    error of one, and the disparity that of both. Rows are scaled so that errors of row and column
    are alike.
    """

    def __init__(self, path: Path) -> None:
        data = loadmat(str(path))
        self.seconds = data["t"].ravel()
        focal, baseline = data["fu"].item(), data["b"].item()
        variances, self._seen = data["y_var"].ravel(), data["y_k_j"]
        u_sigma, v_sigma = np.sqrt(variances[::2].mean()), np.sqrt(variances[1::2].mean())
        self._v_scale = float(u_sigma / v_sigma)
        self._unit = 1.0 / (focal * baseline)
        self._sigmas = float(u_sigma), self._unit * float(np.sqrt(2.0) * u_sigma)
        fv, cv = data["fv"].item() * self._v_scale, data["cv"].item() * self._v_scale
        self.camera = PinholeCamera(640, 480, focal, fv, data["cu"].item(), cv)
        self.landmarks = data["rho_i_pj_i"].T
        turns = Rotation.from_rotvec(data["theta_vk_i"].T).as_matrix()
        vehicle = zip(turns, data["r_i_vk_i"].T, strict=True)
        half = data["C_c_v"].T @ [0.5 * baseline, 0.0, 0.0]
        self._T_vehicle_camera = make_transform(data["C_c_v"].T, data["rho_v_c_v"].ravel() + half)
        self.truth = [make_transform(*pose) @ self._T_vehicle_camera for pose in vehicle]
        self._rates = np.hstack([data["v_vk_vk_i"].T, data["w_vk_vk_i"].T])
        self._variances = np.concatenate([data["v_var"].ravel(), data["w_var"].ravel()])

    def observations(self, step: int) -> FiducialObservations:
        """Landmarks in the image of a step; the landmark j has the id -j - 1."""
        seen = np.flatnonzero(self._seen[0, step] >= 0.0)
        left_u, left_v, right_u, right_v = self._seen[:, step, seen]
        pixels = np.column_stack([left_u + right_u, (left_v + right_v) * self._v_scale]) / 2.0
        sigma, depth_sigma = (np.full(len(seen), value) for value in self._sigmas)
        inverse = self._unit * (left_u - right_u)
        return FiducialObservations(-seen - 1, pixels, sigma, inverse, depth_sigma)

    def motion(self, step: int) -> MotionPrior:
        """Motion of the camera from a step to the next, as speed and turn rate tell it."""
        seconds = self.seconds[step + 1] - self.seconds[step]
        shift, turn = seconds * self._rates[step, :3], seconds * self._rates[step, 3:]
        vehicle = make_transform(Rotation.from_rotvec(turn).as_matrix(), shift)
        mount, into = self._T_vehicle_camera, self._T_vehicle_camera[:3, :3].T
        over = np.kron(np.eye(2), into)
        over[:3, 3:] = -into @ skew(vehicle[:3, :3] @ mount[:3, 3])
        covariance = over @ np.diag(seconds**2 * self._variances) @ over.T
        return MotionPrior(invert_transform(mount) @ vehicle @ mount, covariance)


def starry_night(path: Path) -> Row:
    """Errors and consistency of the poses of `StarryNight`."""
    data = StarryNight(path)
    pose_filter = FiducialFilter(data.camera)
    pose_filter.start(data.truth[0], START)
    ids = -1 - np.arange(len(data.landmarks))
    pose_filter.add_landmarks(ids, data.landmarks, np.zeros((3 * len(ids),) * 2), in_map=True)
    images = updated = 0
    off, nees = [], []
    for step, truth in enumerate(data.truth):
        if step:
            pose_filter.predict(data.motion(step - 1))
        observed = data.observations(step)
        images += len(observed) > 0
        updated += len(observed) > 0 and pose_filter.update(observed).is_consistent
        pose, covariance = pose_filter.pose
        turned = Rotation.from_matrix(truth[:3, :3] @ pose[:3, :3].T).as_rotvec()
        error = np.concatenate([truth[:3, 3] - pose[:3, 3], turned])
        off.append(error)
        nees.append(error @ np.linalg.solve(covariance, error) / 6.0)
    errors = np.array(off)
    return {
        "sequence": "starry_night",
        "images": images,
        "updated": updated,
        "ape_mm": 1e3 * float(np.sqrt((errors[:, :3] ** 2).sum(axis=1).mean())),
        "rotation_deg": float(np.degrees(np.sqrt((errors[:, 3:] ** 2).sum(axis=1).mean()))),
        "nees_median": float(np.median(nees)),
        "nees_mean": float(np.mean(nees)),
    }


class TagCorners:
    """A set of `tag_corners`, as one of its cameras sees the body on which tags are given.

    Images are rectified to the focal length of the raw ones, those of a fisheye to half of it:
    what it sees aside is stretched.

    Args:
        folder: of the set.
        name: of the camera.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._folder, self._name = folder, name
        self._camera = yaml.safe_load((folder / "cameras.yaml").read_text())[name]
        layout = yaml.safe_load((folder / "tagslam.yaml").read_text())
        bodies = {key: body for one in layout["bodies"] for key, body in one.items()}
        self.body = next(key for key, body in bodies.items() if body.get("tags"))
        given = bodies[self.body]
        # TagSLAM's tags are turned by 180 degrees to OpenCV's.
        over, turned = _pose(given.get("pose")), make_transform(np.diag([-1.0, -1.0, 1.0]), [0] * 3)
        poses = [over @ _pose(tag["pose"]) @ turned for tag in given["tags"]]
        turns = Rotation.from_matrix([pose[:3, :3] for pose in poses]).as_rotvec()
        numbers = np.hstack([[pose[:3, 3] for pose in poses], turns]).ravel().tolist()
        self.moves = not given["is_static"]  # and the cameras stand still
        self.side = given["default_tag_size"]
        ids = tuple(tag["id"] for tag in given["tags"])
        self.board = TagBoardConfig(FAMILY, self.side, ids=ids, poses=tuple(numbers))
        fx, fy, cx, cy = self._camera["intrinsics"]
        self._matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        self._is_fisheye = self._camera["distortion_model"] == "equidistant"
        share = 0.5 if self._is_fisheye else 1.0
        self.camera = PinholeCamera(*self._camera["resolution"], share * fx, share * fy, cx, cy)

    def detections(self) -> Iterator[TagDetectionsRecord]:
        """What the other detector has found, image by image, as the node gets it."""
        topic = self._camera["tagtopic"].lstrip("/")
        for name, message in _messages(self._folder / "tag_detections.bag.bz2"):
            if name.lstrip("/") == topic:
                tags = [self._detection(tag) for tag in message.apriltags]
                yield decode_tag_detections(SimpleNamespace(header=message.header, detections=tags))

    def _detection(self, tag: Any) -> SimpleNamespace:
        raw = np.array([[(corner.x, corner.y)] for corner in tag.corners])
        undistort: Any = cv2.fisheye.undistortPoints if self._is_fisheye else cv2.undistortPoints
        coefficients = np.array(self._camera["distortion_coeffs"])
        places = undistort(raw, self._matrix, coefficients, P=self.camera.matrix).reshape(4, 2)
        corners = [SimpleNamespace(x=float(x), y=float(y)) for x, y in places + 0.5]
        found = {"id": tag.id, "hamming": tag.hamming, "decision_margin": 100.0}  # not told
        return SimpleNamespace(family=FAMILY, corners=corners, **found)

    def truth(self) -> dict[int, FloatArray]:
        """TagSLAM's poses of the camera by stamp [ns], in the frame in which tags are given."""
        frames: dict[str, FloatArray] = {"map": np.eye(4)}
        moving: dict[int, FloatArray] = {}
        for _, message in _messages(self._folder / "reference.bag.bz2"):
            for one in getattr(message, "transforms", ()):
                if one.child_frame_id in (self._name, self._camera["rig_body"]):
                    frames[one.child_frame_id] = _placed(one.transform, "translation", "rotation")
            if hasattr(message, "pose"):
                stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                moving[stamp] = _placed(message.pose.pose, "position", "orientation")
        mount = frames[self._name]
        if self.moves:
            T_map_camera = frames[self._camera["rig_body"]] @ mount
            return {stamp: invert_transform(pose) @ T_map_camera for stamp, pose in moving.items()}
        return {stamp: pose @ mount for stamp, pose in moving.items()}


def _pose(entry: Any) -> FloatArray:
    if entry is None:
        return np.eye(4)
    turn, place = ([entry[name][axis] for axis in "xyz"] for name in ("rotation", "position"))
    return make_transform(Rotation.from_rotvec(turn).as_matrix(), place)


def _placed(pose: Any, place: str, turn: str) -> FloatArray:
    p, q = getattr(pose, place), getattr(pose, turn)
    return transform_from_quaternion([q.x, q.y, q.z, q.w], [p.x, p.y, p.z])


def _messages(path: Path) -> Iterator[tuple[str, Any]]:
    """Topics and messages of a compressed bag."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / path.stem
        bag.write_bytes(bz2.decompress(path.read_bytes()))
        with AnyReader([bag]) as reader:
            for connection, _, data in reader.messages():
                yield connection.topic, reader.deserialize(data, connection.msgtype)


def tag_corners(folder: Path, cameras: Sequence[str], most: int | None = None) -> Row:
    """Errors and consistency of what moves, by localizers that get the tags of a set.

    Args:
        folder: of the set.
        cameras: each is located for itself.
        most: images that are taken of each.
    """
    images = 0
    errors: list[FloatArray] = []
    nees: list[float] = []
    for name in cameras:
        data = TagCorners(folder, name)
        config = LocalizerConfig(scene_tags=SceneTagsConfig(FAMILY, data.side))
        target = TargetConfig("tags", tags=TagTargetConfig(data.board))
        localizer = Localizer(data.camera, config, make_detector(target))
        blank = np.zeros((data.camera.height, data.camera.width), np.uint8)
        nothing = np.full(blank.shape, np.nan, np.float32)
        packed = np.broadcast_to(np.float32(np.nan), (*blank.shape, 10))
        cloud, truth = RangeCloud(data.camera, packed, nothing, 0.0), data.truth()
        for found in islice(data.detections(), most):
            tags = believed_tags(found.tags, blank.shape, lambda *_: None)
            view = DepthView(found.stamp, blank, cloud)
            view.tags = tags[np.isin(tags["id"], data.board.ids)] if data.moves else tags
            images += len(view.tags) > 0 and found.stamp in truth
            located = localizer.locate(view)
            if located.state != "tracking" or found.stamp not in truth:
                continue
            assert located.T_map_camera is not None and located.covariance is not None
            true, pose, spread = truth[found.stamp], located.T_map_camera, located.covariance
            if data.moves:
                true, (pose, spread) = invert_transform(true), invert_pose(pose, spread)
            turned = Rotation.from_matrix(true[:3, :3] @ pose[:3, :3].T).as_rotvec()
            error = np.concatenate([true[:3, 3] - pose[:3, 3], turned])
            errors.append(error)
            nees.append(error @ np.linalg.solve(spread, error) / 6.0)
    off = np.array(errors).reshape(-1, 6)
    return {
        "sequence": f"{folder.name}, {' to '.join(dict.fromkeys([cameras[0], cameras[-1]]))}",
        "images": images,
        "updated": len(off),
        "median_mm": 1e3 * float(np.median(np.linalg.norm(off[:, :3], axis=1))),
        "median_deg": float(np.degrees(np.median(np.linalg.norm(off[:, 3:], axis=1)))),
        "nees_median": float(np.median(nees)),
        "nees_mean": float(np.mean(nees)),
    }


def landmark_rows(data: Path, absent: list[str]) -> list[Row]:
    """Figures of all that is there; names of what is not are appended."""
    rows = []
    if (data / STARRY_NIGHT).is_file():
        rows.append(starry_night(data / STARRY_NIGHT))
    else:
        absent.append("starry_night")
    for name, cameras in TAG_SETS:
        folder = data / "tag_corners" / name
        if folder.is_dir():
            rows.append(tag_corners(folder, cameras))
        else:
            absent.append(f"tag_corners {name}")
    return rows


def landmark_section(rows: list[Row]) -> list[str]:
    """The figures as lines of Markdown; none without any."""
    if not rows:
        return []
    points, tags = ([row for row in rows if key in row] for key in ("ape_mm", "median_mm"))
    return [
        "## Given landmarks",
        "",
        "Of landmarks whose places are given each image shows one to twenty, or none; speed and "
        "turn rates are measured between. Root mean squares of the errors against motion capture, "
        "by the noise that the data tell.",
        "",
        "| sequence | images with landmarks | that corrected the pose | position [mm] "
        "| rotation [deg] | NEES/6 median, mean |",
        "|" + " --- |" * 6,
        *(
            f"| {row['sequence']} | {row['images']} | {row['updated']} | {row['ape_mm']:.0f} "
            f"| {row['rotation_deg']:.2f} | {row['nees_median']:.2f}, {row['nees_mean']:.2f} |"
            for row in points
        ),
        "",
        *(tag_section(tags) if tags else []),
    ]


def tag_section(rows: list[Row]) -> list[str]:
    """The figures of `tag_corners` as lines of Markdown."""
    return [
        "`tag_corners`: corners of tags as another detector found them, by the localizer of a node "
        "with `use_detections`, without range, odometry or anything else to follow. The tags of "
        "`tagslam.yaml` are the target, all others tags of the scene. Median errors of the pose of "
        "what moves (of test_4 the wand before seven cameras, each for itself) against TagSLAM's "
        "optimum over all images, which serves for nothing else. Left out: test_10, whose tags are "
        "given to 0.5 m, and test_15, with tags of three sizes on one body and a reference of two "
        "images.",
        "",
        "Cameras of test_1 and test_2 are fisheyes: corners are off by 0.3 px in all of the raw "
        "image, in the rectified one by more the farther aside, while one sigma holds for all. "
        "TagSLAM's optimum itself misses the corners of test_2, cam0 by 0.1 to 0.5 px to one side. "
        "The wand of test_4 shows a camera one or two tags at a time; the reference has all "
        "cameras.",
        "",
        "| set | images with tags | that located it | position [mm] | rotation [deg] "
        "| NEES/6 median, mean |",
        "|" + " --- |" * 6,
        *(
            f"| {row['sequence']} | {row['images']} | {row['updated']} | {row['median_mm']:.1f} "
            f"| {row['median_deg']:.2f} | {row['nees_median']:.2f}, {row['nees_mean']:.2f} |"
            for row in rows
        ),
        "",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    absent: list[str] = []
    rows = landmark_rows(parser.parse_args().data, absent)
    for row in rows:
        print(json.dumps(row))
    print(json.dumps({"absent": absent}))
    print("\n".join(landmark_section(rows)))


if __name__ == "__main__":
    main()
