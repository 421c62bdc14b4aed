"""Landmarks that are given: poses from measurements of points or tags that others have named.

    python benchmarks/given_landmarks.py [--data FOLDER]

`starry_night`: a stereo camera among 20 points of known places, one to twenty in an image or none,
with a gyroscope and a speedometer; poses against motion capture. Prints one JSON line for each row.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, invert_transform, make_transform, skew
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.motion_prior import MotionPrior

Row = dict[str, Any]
STARRY_NIGHT = "starry_night/dataset3.mat"
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


def landmark_section(rows: list[Row]) -> list[str]:
    """The figures as lines of Markdown; none without any."""
    if not rows:
        return []
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
            for row in rows
        ),
        "",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    folder = parser.parse_args().data
    print(json.dumps(starry_night(folder / STARRY_NIGHT)))


if __name__ == "__main__":
    main()
