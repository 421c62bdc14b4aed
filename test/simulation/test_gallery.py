from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.simulation.worlds import gallery


def test_the_camera_looks_at_its_target_and_stands_upright(rng: np.random.Generator) -> None:
    place, target = rng.uniform(-2.0, 2.0, (2, 3))
    pose = gallery.look_at(place, target)
    ahead = np.linalg.inv(pose) @ np.append(target, 1.0)
    np.testing.assert_allclose(ahead[:2], 0.0, atol=1e-12)
    assert ahead[2] == pytest.approx(np.linalg.norm(target - place))
    assert pose[2, 0] == pytest.approx(0.0)  # image rows are level
    assert pose[2, 1] < 0.0  # down in the image is down


def test_one_picture_of_all_worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "WORLDS", ("office",))
    gallery.main([str(tmp_path / "worlds.jpg")])
    pixels = cv2.imread(str(tmp_path / "worlds.jpg"))
    assert pixels is not None
    assert pixels.shape == (480, 640, 3)
    assert pixels.std() > 20.0
