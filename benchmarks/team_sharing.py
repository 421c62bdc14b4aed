"""What sharing a map costs: bytes for a voxel, time behind each other, and the load of a team.

    python benchmarks/team_sharing.py wire
    python benchmarks/team_sharing.py link --seconds 20
    python benchmarks/team_sharing.py team --robots 2 4 8 16 32 --seconds 2 --voxel-size 0.1

`wire` counts the bytes of serialized messages (CDR, before the headers of DDS) for the voxels that
each view changes, and beside it OctoMap's file of the whole map. `link` lets two robots map and
measures how far they are behind each other. `team` counts bytes and processor time of each robot.
Robots drive through one simulated hall with 2 views a second, voxels of 5 cm where nothing else
is said.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore

from infomap_ros.mapping.files.octomap_file import write_bt, write_ot
from infomap_ros.messages import RosbagsMessageTypes
from infomap_ros.messages.rows import encode_rows
from infomap_ros.studies.team.team_network import LagMeter, Radio, TeamNetwork
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import decode_update, encode_update

PERIOD = 0.5  # between two views [s]


def serialized(rows: np.ndarray) -> int:
    """Bytes of a message."""
    message = encode_rows(RosbagsMessageTypes(), 0, "map", rows)
    return len(
        get_typestore(Stores.ROS2_JAZZY).serialize_cdr(message, "sensor_msgs/msg/PointCloud2")
    )


def wire(views: int) -> None:
    """Bytes for a changed voxel, and what quantization does."""
    network = TeamNetwork(1, Radio())
    robot = network.robots[0]
    counts, sizes, worst, shifts = np.zeros(2), np.zeros(2), [], []
    for version in range(1, views + 1):
        network.look(robot)
        network.now += PERIOD
        changes = robot.own.take_changes()
        update = MapUpdate.of_changes(changes, 0.05, 0, version)
        for rows in encode_update(update, 60_000):
            part = decode_update(rows)
            surface = int(part.has_gaussian.any())
            counts[surface] += len(part.indices)
            sizes[surface] += serialized(rows)
        chosen = changes.has_gaussian
        whiten = np.linalg.inv(np.linalg.cholesky(changes.covariances[chosen]))
        ratios = np.linalg.eigvalsh(whiten @ update.covariances[chosen] @ whiten.transpose(0, 2, 1))
        worst.append(np.abs(np.sqrt(ratios) - 1.0).max(axis=1))
        shift = update.means[chosen] - changes.means[chosen]
        shifts.append(np.linalg.norm(np.einsum("kij,kj->ki", whiten, shift), axis=1))
    print(f"{views} views, {counts.sum() / views:.0f} changed voxels a view")
    for name, count, size in zip(("occupancy", "with Gaussian"), counts, sizes, strict=True):
        print(f"{name}: {count:.0f} voxels, {size / count:.2f} bytes a voxel")
    for name, values in (("sigma", worst), ("mean", shifts)):
        errors = np.concatenate(values)
        print(
            f"error of the {name} in sigmas: median {np.median(errors):.4f}, max {errors.max():.4f}"
        )
    with tempfile.TemporaryDirectory() as folder:
        for name, write in (("ot", write_ot), ("bt", write_bt)):
            path = Path(folder) / f"map.{name}"
            write(robot.own, path)
            print(f"OctoMap .{name} of the whole map: {path.stat().st_size} bytes")
    print(f"{robot.own.known_voxels} voxels known; {sizes.sum() / views:.0f} bytes told a view")


def link(
    seconds: float, radio: Radio, message_size: int, max_range: float, voxel_size: float
) -> None:
    """How far two robots are behind each other."""
    bandwidth = 0.9 * radio.rate / 8e6
    config = TeamConfig(bandwidth=bandwidth, message_size=message_size)
    network = TeamNetwork(2, radio, config, voxel_size, max_range=max_range)
    meter, views = LagMeter(network), 0
    while network.now < seconds:
        if network.now >= views * PERIOD:
            views += 1
            for robot in network.robots:
                meter.look(robot)
        network.step()
        meter.check()
    end = network.now
    while len({robot.member.replica.hash() for robot in network.robots}) > 1:
        network.step()
        meter.check()
    lags = np.array(meter.lags)
    changed = sum(robot.changed for robot in network.robots)
    sent = sum(sum(robot.sent.values()) for robot in network.robots)
    print(f"loss {radio.loss:.0%}, {radio.rate / 1e6:g} Mbit/s, messages of {message_size} bytes")
    print(
        f"{len(lags)} views of {changed / len(lags):.0f} changed voxels, "
        f"{sent / changed:.2f} bytes each"
    )
    print(f"{4e-6 * sent / seconds:.1f} Mbit/s sent by each robot")
    print(
        f"behind: median {np.median(lags):.2f} s, 95 % {np.percentile(lags, 95):.2f} s, "
        f"max {lags.max():.2f} s; within 2 s: {(lags <= 2.0).mean():.0%}"
    )
    print(f"the same hash {network.now - end:.2f} s after the last view")


def team(sizes: list[int], seconds: float, voxel_size: float) -> None:
    """Bytes and processor time of each robot, for teams of several sizes."""
    print(
        "| robots | sent by each [kB/s] | received by each [kB/s] | processor of each [%] | "
        "memory of each [MB] | same hash |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    for count in sizes:
        network = TeamNetwork(
            count, Radio(rate=1e9, loss=0.0), TeamConfig(bandwidth=2.0), voxel_size
        )
        views = 0
        while network.now < seconds:
            if network.now >= views * PERIOD:
                views += 1
                for robot in network.robots:
                    network.look(robot)
            network.step()
        sent = np.array([sum(robot.sent.values()) for robot in network.robots]) / seconds / 1e3
        load = np.mean([robot.seconds for robot in network.robots]) / seconds
        memory = network.robots[0].member.replica.memory_bytes() / 1e6
        network.run(3.0)
        same = len({robot.member.replica.hash() for robot in network.robots}) == 1
        print(
            f"| {count} | {sent.mean():.0f} | {sent.sum() - sent.mean():.0f} | "
            f"{100 * load:.1f} | {memory:.0f} | {'yes' if same else 'no'} |",
            flush=True,
        )


def main() -> None:
    """Run one of the measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("wire", "link", "team"))
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--loss", type=float, default=0.2)
    parser.add_argument("--rate", type=float, default=10.0, help="[Mbit/s]")
    parser.add_argument("--message-size", type=int, default=1400)
    parser.add_argument("--robots", type=int, nargs="+", default=[2, 4, 8, 16, 32])
    parser.add_argument("--max-range", type=float, default=5.0, help="of `link` [m]")
    parser.add_argument("--voxel-size", type=float, help="[m]; 0.1 for `team`, 0.05 for `link`")
    arguments = parser.parse_args()
    start, size = time.monotonic(), arguments.voxel_size
    if arguments.what == "wire":
        wire(arguments.views)
    elif arguments.what == "link":
        radio = Radio(rate=arguments.rate * 1e6, loss=arguments.loss)
        link(arguments.seconds, radio, arguments.message_size, arguments.max_range, size or 0.05)
    else:
        team(arguments.robots, arguments.seconds, size or 0.1)
    print(f"took {time.monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()
