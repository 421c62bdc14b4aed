"""Depth images and their noise in few bytes: quantised, predicted from the left, compressed.

Depth is kept as inverse depth in equal steps, for that is where the noise of stereo is even; its
standard deviation as a logarithm. A code is told as its difference from the code of the pixel to
the left, which is small on surfaces, and the differences are compressed with zlib.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_LARGEST_CODE = 65535
_SIGMA_CODES, _SIGMA_STEP = 255, 0.04
_STEPS_PER_SIGMA = 4.0
_LEAST_SHARE = 0.01
_COMPRESSION = 1  # of zlib: the fastest


@dataclass(frozen=True, eq=False)
class CodedDepth:
    """A depth image in few bytes.

    Attributes:
        shape: (H, W).
        step: of the inverse depth [1/m]; no more than a quarter of its standard deviation in 99 of
            100 pixels, so that rounding adds no more than half a percent to the variance.
        sigma_low: smallest standard deviation of the inverse depth [1/m], 0 where none is kept.
        sigma_step: of its natural logarithm, 0.04 or more: one part in fifty.
        planes: compressed codes: is measured, low and high byte of depth, sigma if it is kept.
    """

    shape: tuple[int, int]
    step: float
    sigma_low: float
    sigma_step: float
    planes: tuple[bytes, ...]

    def memory_bytes(self) -> int:
        """Memory in use by the codes [bytes]."""
        return sum(len(plane) for plane in self.planes)

    def depth(self) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Depth z, shape (H, W) [m], NaN where there is none, and its variance [m^2] or None."""
        codes = [np.frombuffer(zlib.decompress(plane), np.uint8) for plane in self.planes]
        pixels = self.shape[0] * self.shape[1]
        depth, variance = np.empty(pixels, np.float32), np.empty(pixels, np.float32)
        levels = np.exp(self.sigma_step * np.arange(256)) * self.sigma_low
        _decode(np.stack(codes), self.step, levels.astype(np.float64), depth, variance)
        has_sigma = self.sigma_low > 0.0
        return depth.reshape(self.shape), variance.reshape(self.shape) if has_sigma else None


def code_depth(depth: NDArray[np.float32], variance: NDArray[np.float32] | None) -> CodedDepth:
    """Keep a depth image in few bytes.

    Args:
        depth: z, shape (H, W) [m]; what is not positive or not finite is no measurement.
        variance: of z, shape (H, W) [m^2], or None. A pixel without a positive one is not kept.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = 1.0 / depth.astype(np.float64)
        valid = np.isfinite(depth) & (depth > 0.0) & np.isfinite(rho)
        sigma = np.full(depth.shape, np.nan)
        if variance is not None:
            sigma = np.sqrt(variance.astype(np.float64)) * rho * rho
            valid &= np.isfinite(sigma) & (sigma > 0.0)
    step, low, sigma_step = _scales(rho[valid], sigma[valid] if variance is not None else None)
    planes = np.zeros((4 if variance is not None else 3, depth.size), np.uint8)
    _encode(
        rho.ravel(), np.log(sigma / low if low else sigma).ravel(), valid.ravel(), step,
        1.0 / sigma_step, planes,
    )  # fmt: skip
    height, width = depth.shape
    codes = tuple(zlib.compress(plane.data, _COMPRESSION) for plane in planes)
    return CodedDepth((height, width), step, low, sigma_step, codes)


def _scales(
    rho: NDArray[np.float64], sigma: NDArray[np.float64] | None
) -> tuple[float, float, float]:
    """Step of the inverse depth, smallest sigma and step of its logarithm."""
    if not len(rho):
        return 1.0, 0.0 if sigma is None else 1.0, 1.0
    step = float(rho.max()) / (_LARGEST_CODE - 1)
    if sigma is None:
        return step, 0.0, 1.0
    place = int(_LEAST_SHARE * len(sigma))
    typical = float(np.partition(sigma, place)[place])
    low, high = float(sigma.min()), float(sigma.max())
    sigma_step = max(float(np.log(high / low)) / _SIGMA_CODES, _SIGMA_STEP)
    return max(step, typical / _STEPS_PER_SIGMA), low, sigma_step


@njit(cache=True, nogil=True)
def _encode(
    rho: Any, log_sigma: Any, valid: Any, step: float, inverse_sigma_step: float, planes: Any
) -> None:
    """Fill the planes: is measured, low and high byte of depth, sigma; differences but the first.

    Args:
        rho: inverse depth, shape (n,) [1/m].
        log_sigma: logarithm of sigma over the smallest, shape (n,).
        valid: shape (n,).
        step: of rho.
        inverse_sigma_step: 1 / step of log_sigma.
        planes: receives bytes, zero before, shape (3 or 4, n).
    """
    before, sigma_before = np.int64(0), np.int64(0)
    for i in range(len(rho)):
        if not valid[i]:
            continue
        code = np.int64(min(max(rho[i] / step + 0.5, 1.0), 65535.0))
        difference = (code - before) & 0xFFFF
        folded = ((difference << 1) ^ (0xFFFF if difference & 0x8000 else 0)) & 0xFFFF
        planes[0, i] = 1
        planes[1, i], planes[2, i] = folded & 0xFF, folded >> 8
        before = code
        if len(planes) > 3:
            code = np.int64(min(max(log_sigma[i] * inverse_sigma_step + 0.5, 0.0), 255.0))
            planes[3, i] = (code - sigma_before) & 0xFF
            sigma_before = code


@njit(cache=True, nogil=True)
def _decode(planes: Any, step: float, levels: Any, depth: Any, variance: Any) -> None:
    """Inverse of `_encode`: depth [m] and variance [m^2], NaN where not measured.

    Args:
        planes: bytes, shape (3 or 4, n).
        step: of the inverse depth [1/m].
        levels: standard deviation of the inverse depth by code, shape (256,).
        depth: receives z, shape (n,).
        variance: receives its variance, shape (n,).
    """
    code, sigma_code = np.int64(0), np.int64(0)
    for i in range(len(depth)):
        if planes[0, i] == 0:
            depth[i] = variance[i] = np.nan
            continue
        folded = np.int64(planes[1, i]) | (np.int64(planes[2, i]) << 8)
        difference = (folded >> 1) ^ (0xFFFF if folded & 1 else 0)
        code = (code + difference) & 0xFFFF
        z = 1.0 / (code * step)
        depth[i] = z
        if len(planes) > 3:
            sigma_code = (sigma_code + planes[3, i]) & 0xFF
            deviation = levels[sigma_code] * z * z
            variance[i] = deviation * deviation
