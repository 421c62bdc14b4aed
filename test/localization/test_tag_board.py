"""A board of tags: its geometry, and its drawing as another implementation reads it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from infomap_ros import cli
from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.localization.target.tag_board import (
    FAMILIES,
    TagBoard,
    TagBoardConfig,
    dictionary,
    draw_board,
    save_board,
)


def read_by_opencv(image: np.ndarray, family: str) -> dict[int, np.ndarray]:
    detector = cv2.aruco.ArucoDetector(dictionary(family), cv2.aruco.DetectorParameters())
    quads, ids, _ = detector.detectMarkers(image)
    return {int(one): quad.reshape(4, 2) for one, quad in zip(np.ravel(ids), quads, strict=True)}


@pytest.mark.parametrize("family", ["tag36h11", "tag25h9", "tag16h5", "aruco4x4_50"])
def test_opencv_reads_the_drawn_tags_in_place(family: str) -> None:
    config = TagBoardConfig(family=family, columns=3, rows=2, first_id=4, side=0.1, gap=0.05)
    found = read_by_opencv(draw_board(config, 1000.0), family)
    board = TagBoard(config)
    assert set(found) == set(board.ids) == set(range(4, 10))
    for one, corners in zip(board.ids, board.corners, strict=True):
        # upright: y to the right, z up; a pixel's center is half a pixel from its edge
        right, up = corners[:, 1], corners[:, 2]
        width, height = board.size
        expected = np.column_stack([right + 0.5 * width, 0.5 * height - up]) * 1000.0 - 0.5
        assert np.abs(found[one] - expected).max() < 1.0


def test_an_upright_board_faces_along_x_with_z_up() -> None:
    corners = TagBoard(TagBoardConfig(columns=1, rows=1, side=0.2)).corners[0]
    expected = [[0, -0.1, 0.1], [0, 0.1, 0.1], [0, 0.1, -0.1], [0, -0.1, -0.1]]
    np.testing.assert_allclose(corners, expected, atol=1e-12)


def test_a_flat_board_faces_along_z() -> None:
    board = TagBoard(TagBoardConfig(mounting="flat", columns=2, rows=1, side=0.2, gap=0.1))
    np.testing.assert_allclose(board.corners[1].mean(axis=0), [0.15, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(board.corners[1][0], [0.05, 0.1, 0.0], atol=1e-12)


def test_ids_and_poses_can_be_given() -> None:
    config = TagBoardConfig(ids=(7, 3), poses=(1.0, 0, 0, 0, 0, 0, 0, 2.0, 0, 0, np.pi / 2, 0))
    board = TagBoard(config)
    assert board.ids == (7, 3)
    np.testing.assert_allclose(board.corners.mean(axis=1), [[1, 0, 0], [0, 2, 0]], atol=1e-12)
    # turned by 90 degrees about y: the tag's x shows along -z
    along = board.corners[1][1] - board.corners[1][0]
    np.testing.assert_allclose(along, [0.0, 0.0, -0.16], atol=1e-12)


def test_a_cut_pixel_gets_its_share_of_gray() -> None:
    config = TagBoardConfig(columns=1, rows=1, side=0.16, margin=0.02)
    image = draw_board(config, 101.3)
    dark = 1.0 - image.astype(float).sum() / 255.0 / image.size
    fine = draw_board(config, 2000.0)
    dark_fine = 1.0 - fine.astype(float).sum() / 255.0 / fine.size
    area = np.prod(image.shape) / 101.3**2 / (np.prod(fine.shape) / 2000.0**2)
    assert dark * area == pytest.approx(dark_fine, rel=0.005)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"first_id": 586}, "first_id"),
        ({"ids": (1, 1, 2, 3)}, "ids"),
        ({"ids": (1, 2)}, "ids"),
        ({"poses": (1.0, 2.0)}, "poses"),
        ({"gap": 0.001}, "gap"),
        ({"side": 0.0}, "side"),
        ({"family": "qr"}, "family"),
    ],
)
def test_an_impossible_board_is_refused(values: dict[str, object], name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        TagBoardConfig(**values)  # type: ignore[arg-type]
    assert caught.value.parameter == name


def test_scattered_tags_cannot_be_drawn() -> None:
    with pytest.raises(ConfigError, match="poses"):
        draw_board(TagBoardConfig(poses=(0.0,) * 6), 100.0)


@pytest.mark.parametrize("scale", [1.0, 1e6, -5.0])
def test_an_image_without_sense_is_refused(scale: float) -> None:
    with pytest.raises(InvalidInputError, match="pixels_per_meter"):
        draw_board(TagBoardConfig(side=0.05, columns=1, rows=1), scale)


def test_a_saved_png_knows_its_scale(tmp_path: Path) -> None:
    save_board(TagBoardConfig(columns=1, rows=1), tmp_path / "board.png", dots_per_inch=200)
    with Image.open(tmp_path / "board.png") as image:
        meters = np.array(image.size) / np.array(image.info["dpi"]) * 0.0254
    np.testing.assert_allclose(meters, [0.24, 0.24], rtol=2e-3)


def test_a_saved_pdf_has_a_page_of_the_board_size(tmp_path: Path) -> None:
    save_board(TagBoardConfig(columns=1, rows=1), tmp_path / "board.pdf")
    box = (tmp_path / "board.pdf").read_bytes().split(b"/MediaBox [")[1].split(b"]")[0]
    points = np.array([float(number) for number in box.split()])
    np.testing.assert_allclose(points[2:] / 72.0 * 0.0254, [0.24, 0.24], rtol=2e-3)


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="board"):
        save_board(TagBoardConfig(), tmp_path / "board.tiff")


def test_the_command_draws_a_board_and_names_its_settings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = [
        "draw-target",
        "--out",
        str(tmp_path / "board.png"),
        "--side",
        "0.1",
        "--rows",
        "3",
    ]
    monkeypatch.setattr(sys, "argv", ["infomap", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert not ended.value.code
    summary = json.loads(capsys.readouterr().out)
    assert summary["settings"] == (
        "--set target.kind=tags --set target.tags.board.side=0.1 --set target.tags.board.rows=3"
    )
    image = cv2.imread(summary["file"], cv2.IMREAD_GRAYSCALE)
    assert set(read_by_opencv(image, "tag36h11")) == set(range(6))
    np.testing.assert_allclose([summary["width"], summary["height"]], [0.32, 0.46])


def test_all_families_of_opencv_are_known() -> None:
    theirs = {name.upper() for name in dir(cv2.aruco) if name.startswith("DICT_")}
    assert theirs == set(FAMILIES.values())
