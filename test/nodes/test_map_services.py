"""The map for other programs: OctoMap, a grid by service, a region taken out of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap

from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.octomap_file import write_bt, write_ot
from infomap_ros.messages.encode import OCTOMAP
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import message_class

from .test_map_fusion import START, Bench, as_replica, cloud, pose, replica, stamp_of


def ask(graph: Any, kind: type, service: str, **fields: Any) -> Any:
    client = graph.tester.create_client(kind, service)
    graph.spin_until(client.service_is_ready, service)
    answer = client.call_async(kind.Request(**fields))
    graph.spin_until(answer.done, f"the answer of {service}")
    return answer.result()


def saved_map(bench: Bench, path: Path) -> VoxelMap:
    assert bench.call("save").success
    return VoxelMap.load(path)


def test_octomap_reads_from_topic_and_service_what_is_in_the_map(
    graph: Any, tmp_path: Path
) -> None:
    pytest.importorskip("octomap_msgs")
    import pyoctomap

    bench = Bench(graph, map_file=str(tmp_path / "map.infomap"))
    heard = graph.collect(message_class(OCTOMAP), "octomap_full", qos.latched())
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    graph.spin_until(lambda: heard, "octomap_full")
    kind = message_class("octomap_msgs/srv/GetOctomap")
    full, binary = (ask(graph, kind, f"octomap_{name}").map for name in ("full", "binary"))
    known = saved_map(bench, tmp_path / "map.infomap")
    for message, write in ((full, write_ot), (binary, write_bt), (heard[-1], write_ot)):
        write(known, tmp_path / "tree")
        header, _, data = (tmp_path / "tree").read_bytes().partition(b"\ndata\n")
        assert message.data.tobytes() == data
        assert (message.header.frame_id, stamp_of(message)) == ("map", START)
        assert (message.id, message.resolution) == ("OcTree", 0.1)
        assert message.binary == (b"binary" in header)
    nodes = known.voxels()[0]
    path = tmp_path / "sent.ot"
    write_ot(known, path)  # for the number of nodes in its header
    path.write_bytes(path.read_bytes().partition(b"data\n")[0] + b"data\n" + full.data.tobytes())
    tree = pyoctomap.OcTree(1.0).read(str(path))
    read = [tree.search((index + 0.5) * 0.1).getLogOdds() for index in nodes[::50]]
    np.testing.assert_allclose(read, known.voxels()[1][::50])


def test_a_grid_is_given_by_service_as_on_its_topic(graph: Any) -> None:
    bench = Bench(graph)
    heard = graph.collect(OccupancyGrid, "projected_map", qos.latched())
    bench.send(pose(), cloud())
    graph.spin_until(lambda: heard and heard[-1].data, "projected_map")
    given = ask(graph, GetMap, "projected_map").map
    assert given.data == heard[-1].data
    assert (given.info, given.header) == (heard[-1].info, heard[-1].header)
    assert 100 in given.data


def test_a_region_is_cleared_in_the_map_and_at_its_listeners(graph: Any, tmp_path: Path) -> None:
    pytest.importorskip("octomap_msgs")
    bench = Bench(graph, map_file=str(tmp_path / "map.infomap"))
    bench.send(pose(), cloud())
    bench.wait_for_results(1)
    before = saved_map(bench, tmp_path / "map.infomap")
    query = message_class("octomap_msgs/srv/BoundingBoxQuery")
    low, high = Point(x=1.5, y=-0.3, z=0.7), Point(x=2.5, y=0.3, z=1.3)
    ask(graph, query, "map_fusion/clear_region", min=low, max=high)
    after = saved_map(bench, tmp_path / "map.infomap")
    corners = (1.5, -0.3, 0.7), (2.5, 0.3, 1.3)
    old, new = as_replica(before), as_replica(after)
    gone = {index for index in old if index not in new}
    inside = [
        ((np.array(i) + 0.5) * 0.1 > corners[0]).all()
        and ((np.array(i) + 0.5) * 0.1 < corners[1]).all()
        for i in gone
    ]
    assert len(gone) > 20
    assert all(inside)
    assert all(old[index][0] > 0 for index in gone)  # what is free stays free
    assert {index: old[index] for index in new} == new
    bench.wait_for_map(new)
    assert replica(bench.updates) == new

    ask(graph, query, "map_fusion/clear_region", min=high, max=low)
    assert as_replica(saved_map(bench, tmp_path / "map.infomap")) == new
