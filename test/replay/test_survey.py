"""Bags that are mapped in parts, by whom it may be, become one map, the same to the bit."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.geometry import CameraInfoRecord, ImageRecord, PoseRecord
from infomap_ros.replay.bags.reader import BagReader, BagRecord
from infomap_ros.replay.map_inputs import MapOptions
from infomap_ros.replay.map_run import MapRun
from infomap_ros.studies import survey
from infomap_ros.studies.survey import dask_client, map_survey, parts_of

from .scenes import (
    CAMERA,
    COVARIANCE,
    START,
    STEP,
    WALL,
    depth_frames,
    pinhole_calibration,
    pose_at,
    write,
)

FRAMES, LONG = 18, 5  # images of a bag, and how many a part has


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let bags be cut into parts of a few frames."""
    monkeypatch.setattr(survey, "_PART_FRAMES", LONG)


@pytest.fixture
def bags(tmp_path: Path) -> list[Path]:
    """A wall by two depth cameras."""
    return [
        write(tmp_path / "wall", depth_frames(FRAMES)),
        write(tmp_path / "noisy", noisy(2 * LONG)),
    ]


def noisy(count: int) -> Iterator[tuple[str, Any]]:
    """The same wall from its side by a noisy camera, whose camera info comes only once."""
    yield "/depth/camera_info", CameraInfoRecord(START, "optical", pinhole_calibration(CAMERA))
    for index in range(count):
        stamp, rng = START + index * STEP, np.random.default_rng(index)
        yield "/camera_pose", PoseRecord(stamp, "map", pose_at(0.2, 0.7 + 0.02 * index), COVARIANCE)
        depth = (WALL - 0.2) * rng.normal(1.0, 0.005, (CAMERA.height, CAMERA.width))
        pixels = np.round(1000 * depth).astype(np.uint16)
        yield "/depth/image_rect", ImageRecord(stamp, "optical", pixels, "16UC1")


def surveyed(bags: list[Path], cluster: str = "", progress: Any = None) -> MapRun:
    told = progress or (lambda done, of: None)
    with BagReader(bags[0]) as bag:
        run = MapRun(bag, MapOptions())
        map_survey(run, bag, parts_of(bags, (), run.options), cluster, print, told)
    return run


def content(run: MapRun, path: Path) -> bytes:
    run.map.save(path)
    return path.read_bytes()


def alone(path: Path) -> MapRun:
    with BagReader(path) as bag:
        run = MapRun(bag)
        run.run()
    return run


def occupancy(run: MapRun) -> dict[tuple[int, ...], float]:
    indices, log_odds = run.map.voxels()
    return dict(zip(map(tuple, indices.tolist()), log_odds.tolist(), strict=True))


def test_parts_have_the_evidence_and_the_counts_of_the_whole(bags, cut) -> None:
    whole, parts = alone(bags[0]), surveyed(bags[:1])
    assert len(parts_of(bags[:1], (), MapOptions())[0]) == 4
    assert occupancy(parts) == occupancy(whole)
    assert parts.frames == whole.frames == FRAMES
    assert (parts.points, parts.dropped) == (whole.points, whole.dropped)
    np.testing.assert_array_equal(parts.camera_path, whole.camera_path)
    found, expected = surface(parts), surface(whole)
    assert found.keys() == expected.keys()
    for index, (mean, covariance) in found.items():
        np.testing.assert_allclose(mean, expected[index][0], atol=2e-4)
        assert np.linalg.det(covariance) <= 1.01 * np.linalg.det(expected[index][1])
    # Drift is not known to be shared across a cut: the sum claims a little more than the whole.
    ratios = [np.trace(found[i][1]) / np.trace(expected[i][1]) for i in found]
    assert 0.8 < np.median(ratios) <= 1.001


def surface(run: MapRun) -> dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]]:
    return {tuple(i): (m, c) for i, m, c in zip(*run.map.gaussians(), strict=True)}


def test_bags_add(bags, cut) -> None:
    expected = occupancy(alone(bags[0]))
    for index, odds in occupancy(alone(bags[1])).items():
        expected[index] = expected.get(index, 0.0) + odds
    joined = surveyed(bags)
    assert occupancy(joined) == pytest.approx(expected)
    assert (joined.name, joined.summary()["map_frame"]) == ("wall and 1 more", "map")


def test_images_at_a_cut_are_in_one_part_whatever_their_delays(tmp_path, cut) -> None:
    """Stamps of another clock than that of the recorder, and messages that come late."""
    stamps = [START + index * STEP for index in range(2 * LONG)]
    for late in (0, 400_000_000):
        for span in parts_of([write(tmp_path / f"{late}", depth_frames(11))], (), MapOptions())[0]:
            assert span.span.beside > 1_000_000_000
        spans = [part.span._replace(delay=7) for part in _parts_of_a_wall(tmp_path / f"w{late}")]
        for number, stamp in enumerate(stamps):
            entry = BagRecord("/image", stamp + late * (number % 3), _Stamped(stamp))
            assert sum(span.has(entry) for span in spans) == 1


class _Stamped:
    def __init__(self, stamp: int) -> None:
        self.stamp = stamp


def _parts_of_a_wall(path: Path) -> list[Any]:
    return parts_of([write(path, depth_frames(2 * LONG))], (), MapOptions())[0]


def test_what_stops_a_survey_is_told(bags, cut, tmp_path) -> None:
    with pytest.raises(InvalidInputError, match="hold the same session"):
        surveyed([bags[0], write(tmp_path / "again", depth_frames(FRAMES))])
    records = noisy(2 * LONG)
    moved = ((t, replace(r, frame_id="odom") if t == "/camera_pose" else r) for t, r in records)
    with pytest.raises(InvalidInputError, match="poses in frames map, odom"):
        surveyed([bags[0], write(tmp_path / "odom", moved)])
    with pytest.raises(InvalidInputError, match="wall: is given twice"):
        surveyed([bags[0], bags[1], bags[0]])
    with pytest.raises(BagError, match="there is no bag"):
        surveyed([bags[0], tmp_path / "nothing"])


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """The address of a scheduler with three worker processes."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    started = []
    with ExitStack() as stack:
        for role in (["scheduler", "--port", "0", "--no-dashboard"], *[["worker"]] * 3):
            command = [sys.executable, "-m", "dask", *role, "--scheduler-file", str(file)]
            command += ["--host", "127.0.0.1"]
            if role == ["worker"]:
                command += ["--no-nanny", "--nthreads", "1", "--no-dashboard"]
            log = stack.enter_context((tmp_path / f"{len(started)}.log").open("w"))
            started.append(subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path))
        try:
            deadline = time.monotonic() + 60.0
            while not file.exists():
                assert time.monotonic() < deadline, (tmp_path / "0.log").read_text()
                time.sleep(0.1)
            yield json.loads(file.read_text())["address"]
        finally:
            for process in started:
                process.kill()
                process.wait()


def test_a_killed_worker_changes_no_bit(bags, cut, tmp_path, scheduler) -> None:
    expected = content(surveyed(bags), tmp_path / "one.infomap")
    killed: list[int] = []
    with dask_client(scheduler) as client:
        client.wait_for_workers(3, timeout=60.0)
        pids = client.run(os.getpid)
        assert len(set(pids.values())) == 3

        def kill_one(done: int, of: int) -> None:
            holders = [worker for worker, held in client.has_what().items() if held]
            if done >= 1 and holders and not killed:
                killed.append(pids[holders[0]])  # its results are lost with it
                os.kill(killed[0], signal.SIGKILL)

        found = surveyed(bags, scheduler, kill_one)
        assert len(killed) == 1
        assert len(client.scheduler_info()["workers"]) == 2
        assert content(found, tmp_path / "three.infomap") == expected
        with pytest.raises(InvalidInputError, match="hold the same session"):
            surveyed([bags[0], write(tmp_path / "again", depth_frames(FRAMES))], scheduler)


def test_a_scheduler_that_is_not_there_is_told(monkeypatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("infomap_ros.studies.survey._ANSWER", 1.0)
    refused = pytest.raises(InvalidInputError, match="no scheduler at tcp://127")
    with refused, dask_client("tcp://127.0.0.1:9"):
        pass
