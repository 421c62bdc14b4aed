"""How threads share the work on a scan."""

import threading

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMapConfig
from infomap_ros.mapping.scans.association import Sensor
from infomap_ros.mapping.scans.image_gathering import rows_of_parts
from infomap_ros.mapping.scans.organized import OrganizedScan
from infomap_ros.mapping.scans.workers import Workers

CAMERA = PinholeCamera(width=160, height=116, fx=150.0, fy=150.0, cx=79.5, cy=57.5)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("size", [0, 1, 7, 1000])
def test_shared_work_is_done_once(threads, size):
    done = np.zeros((2, size), int)

    def task(row: int, first: int, last: int) -> None:
        done[row, first:last] += 1

    works = [(lambda first, last, row=row: task(row, first, last), size) for row in range(2)]
    Workers(threads).share(*works)
    assert (done == 1).all()


def test_an_error_is_raised_when_no_task_runs_any_longer():
    finished, failed = threading.Event(), threading.Event()

    def fail() -> None:
        failed.set()
        raise ValueError("here")

    def last() -> None:
        failed.wait(10.0)
        finished.set()

    with pytest.raises(ValueError, match="here"):
        Workers(2).together(fail, last)
    assert finished.is_set()


def image_of(depths: np.ndarray) -> OrganizedScan:
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], 2)
    cells = np.empty((CAMERA.height // 2, CAMERA.width // 2), np.float32)
    return OrganizedScan(
        (rays * depths[..., None]).astype(np.float32),
        np.array([[1, 0, 0, 1, 0, 1]], np.float32) * 1e-4,
        (0, 1, 2, 3, 4, 5),
        np.zeros((6, 6)),
        CAMERA.fx,
        cells,
        cells.copy(),
    )


def rows(depths: np.ndarray, parts: int) -> list[int]:
    config = VoxelMapConfig(voxel_size=0.05, max_range=5.0)
    limits = config.max_range, config.association_sigmas, config.association_limit
    sensor = Sensor(tuple(np.eye(3).ravel()), (0.0, 0.0, 0.0), 20.0, 0.05, *limits)
    return rows_of_parts(image_of(depths), sensor, parts)


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_parts_of_a_wall_are_equal_and_begin_at_tiles(parts):
    found = rows(np.full((CAMERA.height, CAMERA.width), 2.0), parts)
    assert (found[0], found[-1]) == (0, CAMERA.height)
    assert all(row % 8 == 0 for row in found[:-1])
    assert np.ptp(np.diff(found)) <= 16


def test_a_part_may_have_nothing_to_do():
    depths = np.full((CAMERA.height, CAMERA.width), np.nan)
    depths[112:] = 2.0
    found = rows(depths, 5)
    assert found == sorted(found)
    assert (found[0], found[-2], found[-1]) == (0, 112, CAMERA.height)


@pytest.mark.parametrize("above", [np.nan, 30.0])
def test_who_gets_the_sky_gets_more_rows(above):
    depths = np.full((CAMERA.height, CAMERA.width), 2.0)
    depths[:64] = above
    cut = rows(depths, 2)[1]
    assert 72 <= cut <= 96
