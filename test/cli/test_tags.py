"""Tags in photos are found, drawn and placed."""

from __future__ import annotations

import csv

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from infomap_ros.cli.app import new_app
from infomap_ros.cli.tags_command import tags
from infomap_ros.errors import InvalidInputError
from infomap_ros.localization.target.tag_board import FAMILIES, TagBoardConfig, draw_board
from infomap_ros.localization.target.tag_detection import TagFinder

SIDE, FOCAL = 0.1, 600.0
BOARD = TagBoardConfig(family="tag25h9", side=SIDE, columns=2, rows=1, gap=0.04, first_id=7)
PIXELS_PER_METER = 1000.0
"""Of the photo, which is the board straight on: it is at FOCAL / PIXELS_PER_METER = 0.6 m."""


@pytest.fixture
def photo(tmp_path):
    board = draw_board(BOARD, PIXELS_PER_METER)
    page = np.full((480, 640), 255, np.uint8)
    height, width = board.shape
    page[100 : 100 + height, 150 : 150 + width] = board
    cv2.imwrite(str(tmp_path / "photo.jpg"), cv2.GaussianBlur(page, (0, 0), 0.7))
    return tmp_path / "photo.jpg"


def run(*arguments: object):
    app = new_app("")
    app.command()(tags)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_tags_are_found_drawn_and_placed(photo, tmp_path):
    (tmp_path / "k.txt").write_text(f"{FOCAL} 0 319.5\n0 {FOCAL} 239.5\n0 0 1\n")
    out = tmp_path / "out"
    done = run(photo, "--out", out, "--side", SIDE, "--calibration", tmp_path / "k.txt")
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader((out / "tags.csv").open(encoding="utf-8")))
    assert sorted(int(row["id"]) for row in rows) == [7, 8]
    assert {row["family"] for row in rows} == {"tag25h9"}
    for row in rows:
        x, y, z = map(float, row["x y z [m]"].split())
        middle = np.mean([[float(row[f"{axis}{i}_px"]) for axis in "uv"] for i in range(4)], axis=0)
        assert z == pytest.approx(0.6, rel=0.01)
        seen = (middle - [319.5, 239.5]) / FOCAL * z
        assert (x, y) == pytest.approx(tuple(seen), abs=0.003)
    drawn, before = cv2.imread(str(out / "photo_tags.png")), cv2.imread(str(photo))
    assert drawn.shape == before.shape
    assert (np.abs(drawn.astype(int) - before).max(axis=2) > 50).sum() > 300


def test_a_photo_without_tags_is_said(tmp_path):
    cv2.imwrite(str(tmp_path / "blank.png"), np.full((200, 200), 128, np.uint8))
    done = run(tmp_path / "blank.png", "--out", tmp_path / "out")
    assert isinstance(done.exception, InvalidInputError)
    assert "no tag of any family was found" in str(done.exception)


def test_tags_that_repeat_and_photos_without_a_tag_or_of_one_name(tmp_path):
    page = np.full((480, 640), 255, np.uint8)
    one = draw_board(TagBoardConfig(family="tag36h11", columns=1, rows=1), 600.0)
    for left in (20, 220, 420):
        page[100 : 100 + one.shape[0], left : left + one.shape[1]] = one
    images = [tmp_path / name for name in ("blank/1.png", "alike/1.png")]
    for path, image in zip(images, (np.full_like(page, 128), page), strict=True):
        path.parent.mkdir()
        cv2.imwrite(str(path), image)
    (tmp_path / "k.txt").write_text(f"{FOCAL} 0 319.5\n0 {FOCAL} 239.5\n0 0 1\n")
    out = tmp_path / "out"
    (tmp_path / "broken.jpg").write_bytes(b"no image")
    done = run(
        tmp_path / "broken.jpg",
        *images,
        "--out",
        out,
        "--side",
        0.16,
        "--calibration",
        tmp_path / "k.txt",
    )
    assert done.exit_code == 0, done.output
    assert "broken.jpg: is not there or not an image; left out" in done.output
    rows = list(csv.DictReader((out / "tags.csv").open(encoding="utf-8")))
    assert [(row["photo"], row["family"], row["id"]) for row in rows] == [
        ("alike/1.png", "tag36h11", "0")
    ] * 3
    assert sorted(path.name for path in out.glob("*.png")) == [
        "alike_1_tags.png",
        "blank_1_tags.png",
    ]


def test_what_a_place_needs_is_said(photo, tmp_path):
    (tmp_path / "k.txt").write_text(f"{FOCAL} 0 319.5\n0 {FOCAL} 239.5\n0 0 1\n")
    for given in (("--side", SIDE), ("--calibration", tmp_path / "k.txt")):
        done = run(photo, "--out", tmp_path / "out", *given)
        assert isinstance(done.exception, InvalidInputError)
        assert "--calibration" in str(done.exception) and "--side" in str(done.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("family", FAMILIES)
def test_tags_of_every_family_are_found_by_their_family(family, tmp_path):
    page = np.full((480, 640), 255, np.uint8)
    drawn = draw_board(TagBoardConfig(family, columns=1, rows=1, first_id=3), 900.0)
    page[100 : 100 + drawn.shape[0], 200 : 200 + drawn.shape[1]] = drawn
    cv2.imwrite(str(tmp_path / "one.png"), page)
    done = run(tmp_path / "one.png", "--out", tmp_path / "out", "--family", family)
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader((tmp_path / "out" / "tags.csv").open(encoding="utf-8")))
    assert [(row["family"], row["id"]) for row in rows] == [(family, "3")]


def test_that_no_photo_could_be_read_is_said(tmp_path):
    done = run(tmp_path / "missing.png", "--out", tmp_path / "out")
    assert isinstance(done.exception, InvalidInputError)
    assert "none of them could be read" in str(done.exception)


def test_noise_is_of_no_large_family():
    """What of several families could be meant counts by how sure its tags are."""
    sure = TagFinder("tag36h11").evidence
    assert sure > TagFinder("tag16h5").evidence > TagFinder("aruco4x4_1000").evidence > 0
