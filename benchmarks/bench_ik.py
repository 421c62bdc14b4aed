"""Inverse kinematics of random reachable poses, beside TRAC-IK in the same run; one JSON line.

Every pose is that of random joint positions within the limits, and the search starts at other
random positions. A pose counts as reached when Pinocchio's forward kinematics of the answer is
within 0.1 mm and 1 mrad and the answer is within the limits, whatever the solver says of itself.
TRAC-IK (pytracik) bounds each component of its error in the target's frame alone; so it is judged.
`pinocchio_dls` is what one writes first in Python: damped least squares over Pinocchio's Jacobian
with 10 restarts.

    python benchmarks/bench_ik.py [--poses 1000] [--peer-poses 200] [--timeouts 0.005 0.05]
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio

from infomap_ros.geometry import quaternion_from_transform
from infomap_ros.motion.arm.inverse_kinematics import solve_ik, solve_ik_batch
from infomap_ros.motion.robot.robot_model import RobotModel

try:
    import pytracik
except ImportError:
    sys.exit("bench_ik needs the peer it measures against: pip install 'pytracik>=0.0.3'")

POSITION, ROTATION = 1e-4, 1e-3

Solver = Callable[[np.ndarray, np.ndarray], np.ndarray | None]


def installed(package: str, ending: str) -> Path:
    """A file of an installed distribution."""
    files = importlib.metadata.files(package) or []
    return next(Path(str(file.locate())).resolve() for file in files if str(file).endswith(ending))


def robots() -> dict[str, tuple[Path, str, str]]:
    """URDF, base and camera (or hand) frame of each robot."""
    tiago = installed("example-robot-data", "robots/tiago_no_hand.urdf")
    stretch = installed("hello-robot-stretch-urdf", "SE3_eoa_wrist_dw3_tool_sg3.urdf")
    return {
        "panda": (installed("example-robot-data", "urdf/panda.urdf"), "panda_link0", "panda_hand"),
        "tiago": (tiago, "torso_lift_link", "wrist_ft_tool_link"),
        "stretch": (stretch, "base_link", "gripper_camera_color_optical_frame"),
    }


def load(urdf: Path, base: str, camera: str) -> RobotModel:
    """A robot whose meshes lie beside its URDF or in share/ of its wheel."""
    return RobotModel.from_urdf(urdf, camera, base, package_folders=[urdf.parents[4]])


class Truth:
    """Judges answers by Pinocchio's forward kinematics."""

    def __init__(self, robot: RobotModel) -> None:
        self.robot, self.chain = robot, robot.arm
        self.others = {joint.name: 0.0 for joint in robot.joints}

    def camera(self, q: np.ndarray) -> np.ndarray:
        """Where the camera is at `q`."""
        positions = self.others | self.chain.by_name(q)
        return self.robot.forward_kinematics(positions, self.robot.camera_frame)

    def reached(self, q: np.ndarray | None, target: np.ndarray, per_axis: bool) -> bool:
        """Whether `q` is within the limits and places the camera at the target."""
        if q is None or (q < self.chain.lower - 1e-9).any() or (q > self.chain.upper + 1e-9).any():
            return False
        camera = self.camera(q)
        shift = target[:3, :3].T @ (camera[:3, 3] - target[:3, 3])
        turn = pinocchio.log3(camera[:3, :3].T @ target[:3, :3])
        size = (lambda v: np.abs(v).max()) if per_axis else np.linalg.norm
        return bool(size(shift) <= POSITION and size(turn) <= ROTATION)


def measured(
    solve: Solver, truth: Truth, targets: np.ndarray, starts: np.ndarray, per_axis: bool = False
) -> dict[str, float]:
    """Share of the poses that are reached, and the time of a call [ms]."""
    times, reached = [], 0
    for target, start in zip(targets, starts, strict=True):
        began = time.perf_counter()
        q = solve(target, start)
        times.append(1e3 * (time.perf_counter() - began))
        reached += truth.reached(q, target, per_axis)
    return {
        "reached": round(reached / len(targets), 4),
        "median_ms": round(statistics.median(times), 4),
        "mean_ms": round(statistics.fmean(times), 4),
    }


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Keep what a C++ library prints away from the JSON line."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def tracik(urdf: Path, robot: RobotModel, timeout: float) -> Solver:
    with silent():
        solver = pytracik.TRAC_IK(
            robot.base_frame,
            robot.camera_frame,
            urdf.read_text(encoding="utf-8"),
            timeout,
            POSITION,
            pytracik.SolveType.Speed,
        )
    # It takes limits of zero from a URDF without safety controller.
    pytracik.set_joint_limits(solver, robot.arm.lower, robot.arm.upper)

    def solve(target: np.ndarray, start: np.ndarray) -> np.ndarray | None:
        answer = pytracik.ik(solver, start, *target[:3, 3], *quaternion_from_transform(target))
        return answer[1:] if answer[0] >= 0 else None

    return solve


def pinocchio_dls(robot: RobotModel, restarts: int = 10, iterations: int = 100) -> Solver:
    """Damped least squares in Python; the base must be fixed to the model's root."""
    chain, model = robot.arm, robot.model
    data = model.createData()
    rng = np.random.default_rng(0)
    frame = model.getFrameId(robot.camera_frame)
    columns = [model.joints[model.getJointId(name)].idx_v for name in chain.joint_names]
    rows = [model.joints[model.getJointId(name)].idx_q for name in chain.joint_names]
    full = pinocchio.neutral(model)
    pinocchio.framesForwardKinematics(model, data, full)
    T_root_base = data.oMf[model.getFrameId(robot.base_frame)].copy()

    def solve(target: np.ndarray, start: np.ndarray) -> np.ndarray | None:
        goal, q = T_root_base * pinocchio.SE3(target), start
        for _ in range(restarts + 1):
            for _ in range(iterations):
                full[rows] = q
                pinocchio.framesForwardKinematics(model, data, full)
                jacobian = pinocchio.computeFrameJacobian(model, data, full, frame)[:, columns]
                error = pinocchio.log6(data.oMf[frame].actInv(goal)).vector
                if np.linalg.norm(error[:3]) < POSITION and np.linalg.norm(error[3:]) < ROTATION:
                    return q
                normal = jacobian @ jacobian.T + 1e-4 * np.eye(6)
                step = jacobian.T @ np.linalg.solve(normal, error)
                q = np.clip(q + step, chain.lower, chain.upper)
            q = rng.uniform(chain.lower, chain.upper)
        return None

    return solve


def compare(name: str, arguments: argparse.Namespace) -> dict[str, Any]:
    urdf, base, camera = robots()[name]
    robot = load(urdf, base, camera)
    chain, truth = robot.arm, Truth(robot)
    rng = np.random.default_rng(arguments.seed)
    answers, starts = rng.uniform(chain.lower, chain.upper, (2, arguments.poses, len(chain)))
    targets = np.array([truth.camera(q) for q in answers])
    solve_ik(robot, targets[0])  # compiles
    solve_ik_batch(robot, targets[:2])
    result: dict[str, Any] = {"joints": len(chain)}
    result["solve_ik"] = measured(
        lambda target, start: solve_ik(robot, target, q_start=start).q, truth, targets, starts
    )
    began = time.perf_counter()
    batch = solve_ik_batch(robot, targets, q_start=starts)
    spent = 1e3 * (time.perf_counter() - began) / len(targets)
    reached = [truth.reached(*item, False) for item in zip(batch.q, targets, strict=True)]
    result["solve_ik_batch"] = {"reached": float(np.mean(reached)), "mean_ms": round(spent, 4)}
    shifted = targets.copy()
    shifted[:, :3, 3] += 0.3
    began = time.perf_counter()
    batch = solve_ik_batch(robot, shifted, q_start=starts)
    spent = 1e3 * (time.perf_counter() - began) / len(targets)
    result["solve_ik_batch, 0.5 m beside"] = {
        "reached": float(np.mean(batch.converged)),
        "mean_ms": round(spent, 4),
    }
    for timeout in arguments.timeouts:
        result[f"trac_ik, timeout {1e3 * timeout:g} ms"] = measured(
            tracik(urdf, robot, timeout), truth, targets, starts, per_axis=True
        )
    few = slice(arguments.peer_poses)
    result["pinocchio_dls"] = measured(pinocchio_dls(robot), truth, targets[few], starts[few])
    first = result[f"trac_ik, timeout {1e3 * arguments.timeouts[0]:g} ms"]
    ours = result["solve_ik"]
    result["trac_ik / solve_ik, median"] = round(first["median_ms"] / ours["median_ms"], 2)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--peer-poses", type=int, default=200, help="of pinocchio_dls")
    parser.add_argument("--timeouts", type=float, nargs="+", default=[0.005, 0.05])
    parser.add_argument("--robots", nargs="+", default=list(robots()))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    results = {name: compare(name, arguments) for name in arguments.robots}
    print(json.dumps({"benchmark": "inverse kinematics", "poses": arguments.poses, **results}))


if __name__ == "__main__":
    main()
