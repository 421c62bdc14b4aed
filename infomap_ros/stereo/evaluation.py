"""How far predicted disparity sigmas can be trusted, against true disparities.

Stereo pairs with known disparity, for the calibration of the noise model.

A folder may hold

- a Middlebury scene: ``im0.png``, ``im1.png``, ``disp0.pfm`` (or ``disp0GT.pfm``), ``calib.txt``;
- ``NAME_left.png``, ``NAME_right.png``, ``NAME_disp.npz`` (one array, infinity or NaN = none);
- ``NAMEL.jpg``, ``NAMER.jpg``, ``NAMEGT.png`` (8 bit, whole pixels, 0 = none).

The last two need ``calib.txt`` in the Middlebury format beside them, or a name whose published
calibration is known here: motorcycle (2014, quarter size, as in scikit-image) and aloe (2006,
full size, as in the OpenCV samples).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CalibrationError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, StereoRig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.images import gray
from infomap_ros.stereo.matching import SUBPIXELS, DisparityMatcher, disparity_range
from infomap_ros.stereo.noise import MatchTerms, match_terms
from infomap_ros.stereo.sensor import StereoRangeSensor

#: Standard deviation of the rounding of a truth in whole pixels [px].
ROUNDING_SIGMA = 1.0 / math.sqrt(12.0)
_KNOWN = {
    "motorcycle": "cam0=[994.978 0 311.193; 0 994.978 254.877; 0 0 1]\n"
    "cam1=[994.978 0 342.279; 0 994.978 254.877; 0 0 1]\nbaseline=193.001\nndisp=70\n",
    "aloe": "cam0=[3740 0 640.5; 0 3740 554.5; 0 0 1]\n"
    "cam1=[3740 0 910.5; 0 3740 554.5; 0 0 1]\nbaseline=160\nndisp=224\n",
}


@dataclass(frozen=True, eq=False)
class StereoPair:
    """A rectified pair with its true disparity.

    Attributes:
        name: for reports.
        left: shape (H, W) or (H, W, 3) RGB, uint8.
        right: shape (H, W) or (H, W, 3) RGB, uint8.
        truth: disparity of the left pixels, shape (H, W), float32 [px]; NaN where unknown.
        rig: the rectified pair.
        disparities: number of disparities from 0 up that the scene needs [px].
        truth_sigma: standard deviation of the truth itself [px].
        scene: name that all sizes of one scene share.
    """

    name: str
    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    truth: NDArray[np.float32]
    rig: StereoRig
    disparities: int
    truth_sigma: float = 0.0
    scene: str = ""

    def __post_init__(self) -> None:
        size = (self.rig.left.height, self.rig.left.width)
        for name in ("left", "right", "truth"):
            shape = getattr(self, name).shape[:2]
            if shape != size:
                raise InvalidInputError(f"{self.name}: {name}", f"size {shape}, expected {size}")

    def search(self, config: StereoConfig) -> StereoConfig:
        """`config` with the depth range that the scene needs."""
        nearest = float(self.rig.depth_from_disparity(self.disparities))
        # One pixel beyond the horizon of the scene, so that a disparity of 0 is still in range.
        farthest = float(self.rig.depth_from_disparity(-0.999))
        farthest = farthest if math.isfinite(farthest) else 1e6
        return replace(config, min_depth=nearest, max_depth=farthest, max_search=0.8)

    def halved(self) -> StereoPair:
        """The pair at half resolution, to see how the noise depends on it."""
        height, width = (side // 2 * 2 for side in self.truth.shape)

        def shrink(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
            cut = image[:height, :width]
            small = cv2.resize(cut, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
            return np.asarray(small, dtype=np.uint8)

        rig = self.rig
        cameras = (rig.left.scaled(0.5), rig.right.scaled(0.5))
        left, right = (replace(c, width=width // 2, height=height // 2) for c in cameras)
        return StereoPair(
            f"{self.name}, half size",
            shrink(self.left),
            shrink(self.right),
            self.truth[:height:2, :width:2] / 2.0,
            StereoRig(left, right, rig.baseline),
            math.ceil(self.disparities / 2),
            self.truth_sigma / 2.0,
            self.scene or self.name,
        )


def load_pairs(folder: Path | str) -> list[StereoPair]:
    """Load every pair with truth in a folder.

    Raises:
        InvalidInputError: the folder holds no pair, or one that is incomplete.
        CalibrationError: a pair has no calibration or an impossible one.
    """
    folder = Path(folder)
    pairs = [_middlebury(folder)] if (folder / "im0.png").is_file() else []
    pairs += [
        _named(path, "_disp.npz", "_left.png", "_right.png") for path in _all(folder, "_disp.npz")
    ]
    pairs += [_named(path, "GT.png", "L.jpg", "R.jpg") for path in _all(folder, "GT.png")]
    if not pairs:
        raise InvalidInputError(str(folder), "holds no stereo pair with true disparity")
    return pairs


def _all(folder: Path, ending: str) -> list[Path]:
    return sorted(path for path in folder.glob(f"*{ending}") if path.is_file())


def _middlebury(folder: Path) -> StereoPair:
    truths = [folder / name for name in ("disp0.pfm", "disp0GT.pfm") if (folder / name).is_file()]
    if not truths:
        raise InvalidInputError(str(folder), "holds im0.png but no disp0.pfm")
    truth = _read(truths[0], cv2.IMREAD_UNCHANGED)
    return _pair(folder.name, folder / "im0.png", folder / "im1.png", truth, 0.0)


def _named(path: Path, ending: str, left: str, right: str) -> StereoPair:
    name = path.name.removesuffix(ending)
    whole = ending == "GT.png"
    if whole:
        gray = _read(path, cv2.IMREAD_GRAYSCALE).astype(np.float32)
        truth = np.where(gray > 0.0, gray, np.nan)
    else:
        with np.load(path) as arrays:
            truth = arrays[arrays.files[0]]
    images = (path.with_name(name + left), path.with_name(name + right))
    return _pair(name, *images, truth, ROUNDING_SIGMA if whole else 0.0)


def _pair(
    name: str, left: Path, right: Path, truth: NDArray[np.generic], truth_sigma: float
) -> StereoPair:
    images = [_read(path, cv2.IMREAD_COLOR)[..., ::-1] for path in (left, right)]
    disparity = np.asarray(truth, dtype=np.float32)
    disparity = np.where(np.isfinite(disparity), disparity, np.float32(np.nan))
    height, width = images[0].shape[:2]
    rig, count = _calibration(left.parent, name, width, height)
    first, second = (np.ascontiguousarray(image, dtype=np.uint8) for image in images)
    return StereoPair(name, first, second, disparity, rig, count, truth_sigma)


def _read(path: Path, mode: int) -> NDArray[np.generic]:
    image = cv2.imread(str(path), mode) if path.is_file() else None
    if image is None:
        raise InvalidInputError(str(path), "is missing or no image")
    return np.asarray(image)


def _calibration(folder: Path, name: str, width: int, height: int) -> tuple[StereoRig, int]:
    file = folder / "calib.txt"
    if not file.is_file() and name not in _KNOWN:
        raise CalibrationError(f"{folder}: pair '{name}' has no calib.txt")
    text = file.read_text() if file.is_file() else _KNOWN[name]
    fields = dict(re.findall(r"^\s*(\w+)\s*=\s*(.+?)\s*$", text, re.MULTILINE))
    try:
        cameras = [_camera(fields[key], width, height) for key in ("cam0", "cam1")]
        rig = StereoRig(cameras[0], cameras[1], float(fields["baseline"]) / 1000.0)
        return rig, int(fields["ndisp"])
    except (KeyError, ValueError) as error:
        raise CalibrationError(f"{file}: {error} is missing or malformed") from error


def _camera(text: str, width: int, height: int) -> PinholeCamera:
    rows = [[float(number) for number in row.split()] for row in text.strip("[]").split(";")]
    return PinholeCamera(width, height, rows[0][0], rows[1][1], rows[0][2], rows[1][2])


#: Larger disparity errors are mismatches (bad pixels), which no sigma describes [px].
INLIER_LIMIT = 3.0
#: Shares of a Gaussian within 1, 2 and 3 standard deviations.
GAUSSIAN_SHARES = (0.6827, 0.9545, 0.9973)
_SHIFTS = ((5, 0), (0, 5), (6, 6), (6, -6), (10, 0), (0, 10), (9, 9), (9, -9), (15, 0), (0, 15))


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Disparity errors of the kept pixels of one pair.

    Attributes:
        pair: the pair.
        kept: pixels that the sensor kept and that have a truth, shape (H, W).
        error: measured minus true disparity, shape (H, W) [px]; NaN where not kept.
        sigma: predicted standard deviation, shape (H, W) [px]; NaN where not kept.
        terms: of the variance of the disparity, shape (H, W) each.
        density: kept pixels per pixel with a truth.
        plain_bad: share of errors above 3 px of the same matcher without filters.
        plain_density: of the same.
    """

    pair: StereoPair
    kept: NDArray[np.bool_]
    error: NDArray[np.float32]
    sigma: NDArray[np.float32]
    terms: MatchTerms
    density: float
    plain_bad: float
    plain_density: float

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """Kept pixels with an error of at most 3 px, shape (H, W)."""
        return self.kept & (np.abs(self.error) <= INLIER_LIMIT)

    @property
    def bad(self) -> float:
        """Share of kept pixels with an error above 3 px."""
        return 1.0 - float(self.inliers.sum() / max(self.kept.sum(), 1))

    def shares(self, with_truth_sigma: bool = True) -> tuple[float, float, float]:
        """Shares of the inliers within 1, 2 and 3 predicted standard deviations.

        Args:
            with_truth_sigma: add the variance of the truth itself to the predicted one.
        """
        extra = self.pair.truth_sigma if with_truth_sigma else 0.0
        inliers = self.inliers
        return shares_within(self.error[inliers], np.hypot(self.sigma[inliers], extra))

    def error_correlation(self) -> float:
        """Mean correlation of the errors of two inliers 5 to 15 px apart.

        Not centered: an offset that neighbors share is correlation. The variance of the truth is
        taken out of the denominator, as it is hardly shared.
        """
        error = np.where(self.inliers, self.error, np.nan).astype(np.float64)
        products = [_shifted_product(error, *shift) for shift in _SHIFTS]
        variance = float(np.nanmean(error**2)) - self.pair.truth_sigma**2
        return float(np.clip(np.mean(products) / max(variance, 1e-12), 0.0, 1.0))


def shares_within(
    error: NDArray[np.floating], sigma: NDArray[np.floating]
) -> tuple[float, float, float]:
    """Shares of errors within 1, 2 and 3 sigma; both of shape (N,)."""
    ratio = np.abs(error) / sigma
    one, two, three = (float(np.mean(ratio <= k)) for k in (1, 2, 3))
    return one, two, three


def _shifted_product(error: FloatArray, right: int, down: int) -> float:
    height, width = error.shape
    rows = slice(max(0, down), height + min(0, down))
    other_rows = slice(max(0, -down), height + min(0, -down))
    here, there = error[rows, right:], error[other_rows, : width - right]
    return float(np.nanmean(here * there))


def measure_errors(pair: StereoPair, config: StereoConfig) -> PairErrors:
    """Run the sensor and the plain matcher on a pair with truth.

    Args:
        pair: images, rig and truth.
        config: parameters; its depth range is replaced by the scene's.
    """
    config = pair.search(config)
    sensor = StereoRangeSensor(pair.rig, config)
    left, right = gray(pair.left), gray(pair.right)
    cloud = sensor.measure(pair.left, pair.right)
    _, quality = sensor.assess(left, right, sensor.match(left, right))
    assert cloud.disparity is not None and cloud.disparity_sigma is not None
    known = np.isfinite(pair.truth)
    kept = cloud.valid & known
    plain_bad, plain_density = _plain(pair, config)
    return PairErrors(
        pair,
        kept,
        np.where(kept, cloud.disparity - pair.truth, np.float32(np.nan)),
        np.where(kept, cloud.disparity_sigma, np.float32(np.nan)),
        match_terms(quality),
        float(kept.sum() / known.sum()),
        plain_bad,
        plain_density,
    )


def _plain(pair: StereoPair, config: StereoConfig) -> tuple[float, float]:
    """Bad share and density of the matcher with its filters off.

    OpenCV's own left-right check of 1 px cannot be switched off by its documented parameters, so
    it stays on, and the comparison is the stricter one.
    """
    plain = replace(config, uniqueness=0, left_right_tolerance=1)
    matcher = DisparityMatcher(disparity_range(pair.rig, plain), plain)
    disparity = matcher.match(gray(pair.left), gray(pair.right))
    known = np.isfinite(pair.truth)
    found = known & (disparity > matcher.invalid)
    error = disparity[found] / SUBPIXELS - pair.truth[found]
    return float(np.mean(np.abs(error) > INLIER_LIMIT)), float(found.sum() / known.sum())
