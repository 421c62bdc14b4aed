"""The three nodes as processes over DDS, as the demo runs them."""

from __future__ import annotations

import json
import re
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.errors import ProcessError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PoseRecord,
    make_transform,
)
from infomap_ros.mapping import VoxelMap
from infomap_ros.nodes.live import bag_demo
from infomap_ros.nodes.live.live_graph import NodeProcesses, private_graph
from infomap_ros.replay.bags.writer import BagWriter

START, STEP, PAIRS = 1_700_000_000_000_000_000, 500_000_000, 6
FRAME = "left_optical_frame"
WIDTH, HEIGHT, FOCAL, BASELINE, DISPARITY = 320, 120, 200.0, 0.1, 16
DEPTH = FOCAL * BASELINE / DISPARITY  # 1.25 m
# The camera looks along +x of the map from 1 m above its origin.
T_MAP_CAMERA = make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0.0, 0.0, 1.0])


def calibration(baseline: float) -> CameraCalibration:
    k = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    p = np.hstack([k, [[-FOCAL * baseline], [0], [0]]])
    return CameraCalibration(WIDTH, HEIGHT, "plumb_bob", np.zeros(5), k, np.eye(3), p)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A textured wall 1.25 m in front of a pair of cameras that stands still."""
    rng = np.random.default_rng(0)
    wall = rng.integers(20, 236, (HEIGHT, WIDTH + DISPARITY), dtype=np.uint8)
    wall = cv2.GaussianBlur(wall, (3, 3), 0)
    with BagWriter(tmp_path / "wall") as writer:
        for index in range(PAIRS):
            stamp = START + index * STEP
            texture = (wall + rng.integers(-2, 3, wall.shape)).astype(np.uint8)
            views = {"left": texture[:, :WIDTH], "right": texture[:, DISPARITY:]}
            for side, pixels in views.items():
                info = calibration(BASELINE if side == "right" else 0.0)
                writer.write(f"/{side}/camera_info", CameraInfoRecord(stamp, FRAME, info))
                image = ImageRecord(stamp, FRAME, np.ascontiguousarray(pixels), "mono8")
                writer.write(f"/{side}/image_raw", image)
            pose = PoseRecord(stamp, "map", T_MAP_CAMERA, 1e-6 * np.eye(6))
            writer.write("/camera_pose", pose)
    return tmp_path / "wall"


def test_the_demo_maps_a_bag_and_leaves_everything(
    bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    out = tmp_path / "out"

    assert bag_demo.main(["--bag", str(bag), "--out", str(out)]) == 0

    figures = json.loads(capfd.readouterr().out)
    assert (figures["pairs"], figures["frames"], figures["frames_dropped"]) == (PAIRS, PAIRS, 0)
    assert json.loads((out / "summary.json").read_text()) == figures
    voxel_map = VoxelMap.load(out / "map.infomap")
    means = voxel_map.gaussians()[1]
    on_wall = np.abs(means[:, 1]) < 0.3
    assert on_wall.sum() > 50
    assert np.median(means[on_wall, 0]) == pytest.approx(DEPTH, abs=0.02)
    assert voxel_map.probability([[0.6, 0.0, 0.0]])[0] < 0.1  # the map begins at the camera
    assert (out / "map.ply").read_bytes().startswith(b"ply")
    assert {"map.png", "depth.png", "sigma.png"} <= {path.name for path in out.iterdir()}
    page = (out / "report.html").read_text()
    assert page.count('src="data:image/png;base64,') == 3
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)


def test_a_demo_without_images_ends_with_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture
) -> None:
    with BagWriter(tmp_path / "empty") as writer:
        writer.write("/camera_pose", PoseRecord(START, "map", np.eye(4), np.eye(6)))

    assert bag_demo.main(["--bag", str(tmp_path / "empty"), "--out", str(tmp_path / "out")]) == 1

    assert capfd.readouterr().err.strip().endswith("it has /camera_pose")


def test_a_process_that_cannot_start_is_told_with_its_reason(tmp_path: Path) -> None:
    with NodeProcesses(tmp_path, environment=private_graph()) as processes:
        processes.start("stereo_range", {"min_depth": -1.0})

        assert processes.wait("stereo_range", 60.0) == 2
        with pytest.raises(ProcessError, match=r"parameter 'min_depth' is -1\.0"):
            processes.check()


def test_processes_end_when_asked_and_none_is_left(tmp_path: Path) -> None:
    with NodeProcesses(tmp_path, environment=private_graph()) as processes:
        pid = processes.start("stereo_range", {})
        log = tmp_path / "stereo_range.log"
        poll = threading.Event()
        for _ in range(2400):
            processes.check()
            if "kernels ready" in log.read_text() or poll.wait(0.05):
                break

        assert processes.stop() == {"stereo_range": 0}

    assert not Path(f"/proc/{pid}").exists()
    assert "Traceback" not in log.read_text()
