"""A bag becomes a map of what is in it, and what is wrong with the bag is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from infomap_ros.cli.command_options import all_settings, with_settings
from infomap_ros.errors import BagError, CapacityError, ConfigError
from infomap_ros.geometry import (
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    OdometryRecord,
    PinholeCamera,
    PoseRecord,
    TextRecord,
    TransformRecord,
    transform_points,
)
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion.robot.robot_model import DescriptionConfig
from infomap_ros.replay import map_inputs
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.map_inputs import MapInputConfig, MapOptions
from infomap_ros.replay.map_run import MapRun
from infomap_ros.replay.sequences import LAYOUTS, SequenceReader

from .real_sequences import KITCHEN_FLOOR, REAL
from .scenes import (
    COVARIANCE,
    START,
    STEP,
    WALL,
    depth_frames,
    fill_after,
    pinhole_calibration,
    pose_at,
    stereo_frames,
    write,
)

ROBOT = """<robot name="arm"><link name="base"/><link name="optical"/><link name="hand">
<collision><geometry><box size="0.2 0.4 0.4"/></geometry></collision></link>
<joint name="mount" type="fixed"><parent link="base"/><child link="optical"/></joint>
<joint name="slide" type="prismatic"><parent link="optical"/><child link="hand"/>
<axis xyz="0 0 1"/><limit lower="0" upper="3" effort="1" velocity="1"/></joint></robot>"""


def mapped(path, **options) -> MapRun:
    with BagReader(path) as bag:
        run = MapRun(bag, MapOptions(**options))
        run.run()
    return run


def check_wall(voxel_map: VoxelMap, tolerance: float = 0.02) -> None:
    """Surface where the wall is and nowhere else; free before it, unknown behind it."""
    _, means, _ = voxel_map.gaussians()
    assert len(means) > 100
    np.testing.assert_allclose(np.median(means[:, 0]), WALL, atol=tolerance)
    assert np.percentile(np.abs(means[:, 0] - WALL), 95) < 3 * tolerance
    before, behind = [[1.0, 0.0, 0.0]], [[WALL + 0.5, 0.0, 0.0]]
    assert voxel_map.probability(before)[0] < 0.3
    assert not voxel_map.is_known(behind)[0]


def test_depth_camera(tmp_path):
    run = mapped(write(tmp_path / "bag", depth_frames()))
    check_wall(run.map)
    summary = run.summary()
    assert (summary["frames"], summary["frames_dropped"]) == (6, 0)
    assert summary["points"] == run.points > 10000
    assert summary["known_voxels"] == run.map.known_voxels
    assert summary["map_frame"] == "map"
    assert run.builder.assumed_poses == 0


def test_stereo_pair(tmp_path):
    run = mapped(write(tmp_path / "bag", stereo_frames()))
    check_wall(run.map, tolerance=0.03)
    assert run.frames == 3


def test_a_large_scene_is_mapped_as_far_as_it_is_known(tmp_path):
    path = write(tmp_path / "bag", stereo_frames(scale=20.0))
    run = mapped(path)
    size, reach = run.map.config.voxel_size, run.map.config.max_range
    assert run.fitted and 20.0 * WALL < reach < 60.0 * WALL and 0.1 <= size <= reach / 100.0
    _, means, _ = run.map.gaussians()
    assert np.median(means[:, 0]) == pytest.approx(20.0 * WALL, rel=0.02)
    kept = mapped(path, map=VoxelMapConfig(voxel_size=0.2))
    assert not kept.fitted and kept.map.config.max_range == 5.0 and kept.points == 0
    usual = mapped(path, input=MapInputConfig(fit_scene=False))
    assert not usual.fitted and usual.map.config.voxel_size == 0.05
    assert not mapped(write(tmp_path / "near", stereo_frames())).fitted


def test_a_large_scene_that_is_nowhere_known_well_keeps_the_usual_sizes(tmp_path, monkeypatch):
    monkeypatch.setattr(map_inputs, "_KNOWN", 0.001)
    run = mapped(write(tmp_path / "bag", stereo_frames(scale=20.0)))
    assert not run.fitted and run.map.config.max_range == 5.0


@pytest.mark.parametrize("fit_scene", [True, False])
def test_judging_the_scene_counts_nothing_that_cannot_be_read(tmp_path, fit_scene):
    options = MapOptions(input=MapInputConfig(fit_scene=fit_scene))
    with BagReader(write(tmp_path / "bag", stereo_frames(scale=20.0))) as bag:
        records = bag.records

        def with_one_bad(topics):
            bag.skipped["malformed"] += "/right/image_rect" in topics
            return records(topics)

        bag.records = with_one_bad
        run = MapRun(bag, options)
        assert run.fitted == fit_scene
        run.run()
        assert bag.skipped == {"malformed": 1}


def test_same_bag_gives_the_same_map(tmp_path):
    path = write(tmp_path / "bag", depth_frames())
    first, second = mapped(path).map.state(), mapped(path).map.state()
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])


def test_every_frame_is_reported(tmp_path):
    told = []
    with BagReader(write(tmp_path / "bag", depth_frames(4))) as bag:
        MapRun(bag).run(lambda done, total: told.append((done, total)))
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_unknown_covariance_is_assumed_and_counted(tmp_path):
    entries = list(depth_frames(covariance=None))
    run = mapped(write(tmp_path / "bag", entries))
    assert run.builder.assumed_poses == 6
    sure = mapped(write(tmp_path / "sure", depth_frames()))
    sigmas = [np.sqrt(r.map.gaussians()[2][:, 0, 0]).mean() for r in (run, sure)]
    assert sigmas[0] > 3 * sigmas[1]


def test_pose_that_comes_after_its_image(tmp_path):
    entries = [e for e in depth_frames() if e[0] != "/camera_pose"]
    poses = [
        (
            "/camera_pose",
            PoseRecord(START + i * STEP - STEP // 3, "map", pose_at(0.1 * i - 1 / 30), COVARIANCE),
        )
        for i in range(8)
    ]
    path = tmp_path / "bag"
    merged = sorted(entries + poses, key=lambda entry: entry[1].stamp)
    run = mapped(write(path, merged))
    check_wall(run.map)
    assert run.frames == 6


def test_frames_without_a_pose_are_counted_by_reason(tmp_path):
    entries = [
        (topic, record)
        for topic, record in depth_frames(10)
        if topic != "/camera_pose" or START + 2 * STEP <= record.stamp <= START + 7 * STEP
    ]
    run = mapped(write(tmp_path / "bag", entries))
    assert run.frames == 6
    assert run.dropped == {"before the first pose": 2, "after the last pose": 2}
    assert run.summary()["dropped: before the first pose"] == 2


def test_odometry_and_mounted_camera(tmp_path):
    """The pose is that of the base; tf_static leads to the camera."""
    T_base_camera = pose_at(0.3, 0.1)
    base = [T @ np.linalg.inv(T_base_camera) for T in (pose_at(0.1 * i) for i in range(6))]
    entries = [e for e in depth_frames() if e[0] != "/camera_pose"]
    entries += [
        ("/odom", OdometryRecord(START + i * STEP, "odom", T, COVARIANCE, "base_link"))
        for i, T in enumerate(base)
    ]
    entries.append(("/tf_static", TransformRecord(START, "base_link", "optical", T_base_camera)))
    run = mapped(write(tmp_path / "bag", sorted(entries, key=lambda e: e[1].stamp)))
    check_wall(run.map)
    assert run.inputs.map_frame == "odom"
    assert run.builder.assumed_poses == 0


def test_tf_alone(tmp_path):
    T_base_camera = pose_at(0.3)
    entries = [e for e in depth_frames() if e[0] != "/camera_pose"]
    entries.append(("/tf_static", TransformRecord(START, "base_link", "optical", T_base_camera)))
    for i in range(6):
        stamp = START + i * STEP
        T_odom_base = pose_at(0.1 * i) @ np.linalg.inv(T_base_camera)
        entries.append(("/tf", TransformRecord(stamp, "map", "odom", np.eye(4))))
        entries.append(("/tf", TransformRecord(stamp, "odom", "base_link", T_odom_base)))
    run = mapped(write(tmp_path / "bag", sorted(entries, key=lambda e: e[1].stamp)))
    check_wall(run.map)
    assert run.inputs.map_frame == "map"
    assert run.builder.assumed_poses == 6


def with_hand(entries, place: float, joints: bool = True):
    """Put a hand before the camera: it hides the middle of the image."""
    yield "/robot_description", TextRecord(START, "", ROBOT)
    for topic, record in entries:
        if topic == "/depth/image_rect":
            depth = record.pixels.copy()
            depth[40:80, 50:110] = round(1000 * (place - 0.2))
            record = replace(record, pixels=depth)
            if joints:
                state = JointStateRecord(record.stamp, "", ("slide",), np.array([place]))
                yield "/joint_states", state
        yield topic, record


def test_robot_body_stays_out_of_the_map(tmp_path):
    path = write(tmp_path / "bag", with_hand(depth_frames(), 0.8))
    run = mapped(path)
    hand = [[0.6 + x, 0.0, 0.0] for x in np.linspace(0.0, 0.5, 11)]
    assert run.builder.points_cut > 1000
    assert (run.map.probability(hand) < 0.6).all()
    kept = mapped(path, input=MapInputConfig(remove_body=False))
    assert (kept.map.probability(hand) > 0.6).any()


def test_joints_that_the_bag_does_not_hold_can_be_assumed(tmp_path):
    wheel = (
        '<joint name="roll" type="continuous"><parent link="base"/><child link="wheel"/></joint>'
    )
    shape = '<link name="wheel"><collision><geometry><sphere radius="0.1"/></geometry></collision>'
    xml = ROBOT.replace("</robot>", f"{shape}</link>{wheel}</robot>")
    path = write(tmp_path / "bag", with_hand(depth_frames(), 0.8))
    with pytest.raises(BagError, match="'roll'; if nobody reports it, name it in assumed_joints"):
        mapped(path, robot=xml)
    run = mapped(path, robot=xml, description=DescriptionConfig(assumed_joints=("roll",)))
    assert run.builder.points_cut > 1000


def test_robot_without_joint_states_is_mapped_with_its_body(tmp_path):
    run = mapped(write(tmp_path / "bag", with_hand(depth_frames(), 0.8, joints=False)))
    assert run.frames == 6
    assert run.inputs.body_note == "no joint states"


def test_calibration_that_does_not_fit_is_dropped_and_named(tmp_path):
    wrong = PinholeCamera(80, 60, 60.0, 60.0, 39.5, 29.5)
    entries = [
        (topic, CameraInfoRecord(record.stamp, "optical", pinhole_calibration(wrong)))
        if topic == "/depth/camera_info"
        else (topic, record)
        for topic, record in depth_frames()
    ]
    with pytest.raises(BagError, match=r"6 x .*160x120.*80x60"):
        mapped(write(tmp_path / "bag", entries))


def test_encoding_that_is_no_depth_is_dropped_and_named(tmp_path):
    entries = [
        (topic, ImageRecord(record.stamp, "optical", np.zeros((120, 160), np.uint8), "mono8"))
        if topic == "/depth/image_rect"
        else (topic, record)
        for topic, record in depth_frames()
    ]
    with pytest.raises(BagError, match=r"no frame could be mapped: 6 x .*'mono8' of a depth image"):
        mapped(write(tmp_path / "bag", entries), topics={"depth": "/depth/image_rect"})


def test_left_without_right_is_counted(tmp_path):
    entries = list(stereo_frames())
    del entries[-1]
    run = mapped(write(tmp_path / "bag", entries))
    assert run.frames == 2
    assert run.dropped == {"image without its partner": 1}


def test_bag_without_images_says_so(tmp_path):
    path = write(tmp_path / "bag", [("/pose", PoseRecord(START, "map", np.eye(4)))])
    with pytest.raises(BagError, match=r"no stereo pair.*no depth camera"):
        mapped(path)


def test_full_map_keeps_what_it_has(tmp_path, monkeypatch):
    fill_after(monkeypatch, frames=2)
    run = mapped(write(tmp_path / "bag", depth_frames()))
    assert run.full == "no room"
    assert run.frames == 2
    check_wall(run.map)


def test_map_too_small_for_one_frame_says_so(tmp_path):
    tiny = VoxelMapConfig(voxel_size=0.002, memory_limit=0.001)
    with pytest.raises(CapacityError, match="not one frame fits"):
        mapped(write(tmp_path / "bag", depth_frames(1)), map=tiny)


def test_settings_by_name():
    options = with_settings(MapOptions(), ["map.voxel_size=0.01", "input.remove_body=false"])
    assert options.map.voxel_size == 0.01
    assert options.input.remove_body is False
    triple = with_settings(options, ["stereo.printed_t=1,2,3"]).stereo.printed_t
    assert triple == (1.0, 2.0, 3.0)
    assert "stereo.max_depth" in all_settings(options)


@pytest.mark.parametrize(
    "setting",
    ["voxel_size=1", "map.voxel_size", "map.nothing=1", "topics.x=1", "map.voxel_size=big",
     "map.threads=1.5", "input.remove_body=maybe", "map.voxel_size=-1"],
)  # fmt: skip
def test_wrong_settings_are_refused(setting):
    with pytest.raises(ConfigError):
        with_settings(MapOptions(), [setting])


def test_real_frames_agree_with_the_map_that_all_of_them_made(real_data):
    """Points of single frames lie on the map's surface, and the floor is where it was measured."""
    folder, options = real_data / "rgbd_kitchen", REAL["kitchen"].options
    with SequenceReader(folder, LAYOUTS["rgbd"](folder, options)) as bag:
        run = MapRun(bag)
        run.run()
        assert run.frames == 250
        pose = run.inputs.poses.at(run.first.stamp)
    points = transform_points(pose.transform, run.first.cloud.points[::97])
    _, means, _ = run.map.gaussians()
    distances, _ = cKDTree(means).query(points)
    assert np.percentile(distances, 90) < run.map.config.voxel_size
    assert abs(np.percentile(means[:, 2], 1) - KITCHEN_FLOOR) < 0.1
