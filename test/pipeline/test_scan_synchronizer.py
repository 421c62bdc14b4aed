"""Scans come out when all that belongs to them is known, and not before."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import JointStateRecord, PoseRecord, PoseUncertainty, make_transform
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.scan_synchronizer import LocatedPoses, ScanSynchronizer

STEP = 100_000_000
PARTS = PoseUncertainty(1e-4 * np.eye(6), 2e-4 * np.eye(6))
ARM = """<robot name="arm"><link name="base"/><link name="optical"/><link name="hand">
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="mount" type="fixed"><parent link="base"/><child link="optical"/></joint>
<joint name="slide" type="prismatic"><parent link="optical"/><child link="hand"/>
<axis xyz="0 0 1"/><limit lower="0" upper="3" effort="1" velocity="1"/></joint></robot>"""


def pose(stamp: int, frame: str = "map") -> PoseRecord:
    return PoseRecord(stamp, frame, np.eye(4), PARTS.covariance)


def scans_of(poses: LocatedPoses, body: RobotBody | None = None) -> ScanSynchronizer[str]:
    drops.clear()
    return ScanSynchronizer(
        poses, body or RobotBody(), on_drop=lambda reason, _: drops.append(reason)
    )


drops: list[str] = []


@pytest.mark.parametrize("parts_first", [False, True])
def test_a_scan_waits_for_the_parts_of_its_poses_covariance(parts_first: bool) -> None:
    poses = LocatedPoses("map", are_parts_published=lambda: True)
    scans = scans_of(poses)
    scans.add_cloud(STEP, "camera", "cloud")
    if parts_first:
        poses.add_uncertainty(STEP, PARTS)
        assert not scans.take()
        scans.add_pose(pose(STEP))
    else:
        scans.add_pose(pose(STEP))
        assert not scans.take()
        poses.add_uncertainty(STEP, PARTS)
    (scan,) = scans.take()
    assert scan.cloud == "cloud"
    assert scan.pose.uncertainty is PARTS


def test_parts_that_are_lost_do_not_hold_up_what_comes_later() -> None:
    poses = LocatedPoses("map", are_parts_published=lambda: True)
    scans = scans_of(poses)
    for number in (1, 2):
        scans.add_cloud(number * STEP, "camera", str(number))
        scans.add_pose(pose(number * STEP))
    poses.add_uncertainty(2 * STEP, PARTS)
    first, second = scans.take()
    assert (first.pose.uncertainty, second.pose.uncertainty) == (None, PARTS)


def test_without_a_publisher_of_parts_a_pose_is_enough() -> None:
    scans = scans_of(LocatedPoses("map"))
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "camera", "cloud")
    (scan,) = scans.take()
    assert np.array_equal(scan.pose.covariance, PARTS.covariance)


def test_poses_and_clouds_in_other_frames_are_refused() -> None:
    scans = scans_of(LocatedPoses("map"))
    with pytest.raises(FrameError, match="'odom'"):
        scans.add_pose(pose(STEP, "odom"))
    scans.add_cloud(STEP, "camera", "cloud")
    with pytest.raises(FrameError, match="'other'"):
        scans.add_cloud(2 * STEP, "other", "cloud")


def test_a_scan_waits_for_joints_and_comes_with_the_body() -> None:
    body = RobotBody(RobotModel.from_urdf(ARM))
    scans = scans_of(LocatedPoses("map"), body)
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "optical", "cloud")
    assert not scans.take()
    body.add(JointStateRecord(STEP, "", ("slide",), np.array([0.7])))
    (scan,) = scans.take()
    np.testing.assert_allclose(scan.body[0].transform[:3, 3], [0.0, 0.0, 0.7])


@pytest.mark.parametrize("required", [True, False])
def test_a_body_without_the_cameras_frame_drops_scans_or_stays_in_them(required: bool) -> None:
    body = RobotBody(RobotModel.from_urdf(ARM), required=required)
    body.add(JointStateRecord(STEP, "", ("slide",), np.array([0.7])))
    scans = scans_of(LocatedPoses("map"), body)
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "nowhere", "cloud")
    taken = scans.take()
    if required:
        assert (taken, drops) == ([], ["robot description"])
    else:
        assert [list(scan.body) for scan in taken] == [[]]
        assert "nowhere" in body.unknown


def test_scans_do_not_wait_for_joints_that_nobody_tells() -> None:
    body = RobotBody(RobotModel.from_urdf(ARM), are_joints_sent=lambda: False)
    scans = scans_of(LocatedPoses("map"), body)
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "optical", "cloud")
    (scan,) = scans.take()
    assert not scan.body
    assert "joint_states" in body.unknown


class TwoSensors:
    """A robot whose pose and mounts are always known; a sensor's own x says whose it is."""

    places_frames = True

    def __init__(self) -> None:
        self.mounts = {"camera": 0.1, "lidar": 0.7}
        self.jumped = list[int]()
        self.scans: ScanSynchronizer[str] = ScanSynchronizer(
            self,
            RobotBody(),
            on_drop=lambda *why: self.drops.append(why),
            on_clock_jump=lambda: self.jumps.append(True),
        )
        self.drops, self.jumps, self.taken = list[tuple[str, str]](), list[bool](), list[str]()

    def add(self, record: object) -> None:
        """Nothing comes."""

    def at(self, stamp: int, frame: str) -> PoseRecord:
        if frame not in self.mounts:
            raise PoseUnavailableError(f"no {frame}", f"frame {frame} unknown", may_arrive=True)
        place = make_transform(np.eye(3), [self.mounts[frame], 0.0, 1e-9 * stamp])
        return PoseRecord(stamp, "map", place, None, frame)

    def others_have_jumped(self, stamp: int) -> None:
        self.jumped.append(stamp)

    def see(self, frame: str, seconds: float) -> None:
        """A cloud, and whatever is complete then: each at its own sensor's place."""
        stamp = round(1e9 * seconds)
        self.scans.add_cloud(stamp, frame, f"{frame} {stamp}")
        for scan in self.scans.take():
            frame, stamp_text = scan.cloud.split()
            expected = [self.mounts[frame], 0.0, 1e-9 * int(stamp_text)]
            np.testing.assert_allclose(scan.pose.transform[:3, 3], expected)
            self.taken.append(frame)


@pytest.mark.parametrize("off", [0.0, 1.7, -3600.0])
def test_each_sensor_has_its_own_pose_rate_and_clock(off: float) -> None:
    robot = TwoSensors()
    for step in range(120):
        robot.see("camera", 10_000.0 + step / 30)
        if step % 8 == 0:
            robot.see("lidar", 10_000.0 + off + step / 30 + 0.004)
    assert Counter(robot.taken) == {"camera": 120, "lidar": 15}
    assert (robot.drops, robot.jumps) == ([], [])


def test_a_frame_without_a_place_is_dropped_by_name_until_it_has_one() -> None:
    robot = TwoSensors()
    robot.see("odd", 99_000.0)  # once, by another clock
    for step in range(60):
        if step >= 20:
            robot.see("late", 10.0 + step / 10)
        if step == 40:
            robot.mounts["late"] = 3.0
        robot.see("camera", 10.0 + step / 10)
    assert robot.taken.count("camera") == 60
    # A second is waited for a place: so those of the last one are not lost.
    assert 19 <= robot.taken.count("late") <= 31
    assert robot.taken.count("late") + sum("'late'" in text for _, text in robot.drops) == 40
    assert [reason for reason, text in robot.drops if "'odd'" in text] == ["frame odd unknown"]
    assert all("no late" in text or "no odd" in text for _, text in robot.drops)
    assert not robot.jumps


def test_a_clock_that_all_sensors_share_jumps_once() -> None:
    robot = TwoSensors()
    for loop in range(3):
        for step in range(40):
            robot.see("camera", 100.0 + step / 10)
            # The lidar's clouds come half a second later: those of before the jump, too.
            if loop or step >= 5:
                robot.see("lidar", 100.0 + ((step - 5) % 40) / 10)
    assert robot.jumped == [100 * 10**9] * 2
    assert len(robot.jumps) == 2
    assert robot.taken.count("camera") == 120
    assert robot.taken.count("lidar") >= 110
    assert all(reason in ("lone stamp", "time went backwards") for reason, _ in robot.drops)


@pytest.mark.parametrize("step_of_clock", [3600.0, -3600.0])
def test_the_clock_of_one_sensor_steps_and_the_other_goes_on(step_of_clock: float) -> None:
    robot = TwoSensors()
    for step in range(100):
        robot.see("camera", 10_000.0 + step / 10)
        robot.see("lidar", 10_000.03 + step / 10 + step_of_clock * (step >= 50))
    assert robot.taken.count("camera") == 100
    assert robot.taken.count("lidar") >= 98
    assert len(robot.jumps) == (step_of_clock < 0)


def test_names_without_end_hold_nothing_up() -> None:
    robot = TwoSensors()
    for step in range(200):
        robot.see(f"odd{step}", 10.0 + step / 10)
        robot.see("camera", 10.0 + step / 10)
    assert robot.taken.count("camera") == 200
    assert len(robot.scans.frames) <= 16
    assert len(robot.drops) >= 180


def test_poses_of_an_unnamed_camera_are_not_used_for_two_frames() -> None:
    scans, refused, taken = scans_of(LocatedPoses("map")), Counter[str](), Counter[str]()
    for step in range(1, 60):
        scans.add_pose(pose(step * STEP))
        for frame in ("camera", "lidar") if 20 <= step < 40 else ("camera",):
            try:
                scans.add_cloud(step * STEP, frame, frame)
            except FrameError as error:
                assert "'lidar'" in str(error)
                refused[frame] += 1
        taken.update(scan.cloud for scan in scans.take())
    assert taken["lidar"] == 0 and refused["lidar"] == 20
    assert taken["camera"] + refused["camera"] + drops.count("wrong frame") == 59
    assert refused["camera"] >= 18 and taken["camera"] >= 30


def test_the_body_is_unknown_for_one_sensor_and_not_for_the_other() -> None:
    body = RobotBody(RobotModel.from_urdf(ARM), are_joints_sent=lambda: True, required=False)
    body.add(JointStateRecord(STEP, "", ("slide",), np.array([0.7])))
    for _ in range(2):
        assert body.solids_in("nowhere", STEP) == []
        assert len(body.solids_in("optical", STEP)) == 1
        assert "nowhere" in body.unknown
