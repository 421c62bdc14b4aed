"""Alignment of a template with an image to a small fraction of a pixel.

Inverse compositional Gauss-Newton (S. Baker and I. Matthews, *Lucas-Kanade 20 years on*, IJCV
56(3), 2004, DOI 10.1023/B:VISI.0000011205.11775.fd) over an affine warp, with the mean and the
contrast of both patches made equal, so that brightness and gain do not matter.

Small kernels on image patches that tracking and sparse stereo share.

Where pixels of one image went in the next: pyramidal Lucas-Kanade, forward and back.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray


@njit(nogil=True, cache=True, error_model="numpy")
def sample_patch(image, u, v, a, b, c, d, patch):  # type: ignore[no-untyped-def]
    """Sample an affinely warped patch by bilinear interpolation.

    ``patch[j, i]`` is the image at ``(u + a x + b y, v + c x + d y)`` with ``x = i - n // 2`` and
    ``y = j - n // 2``.

    Returns:
        Whether all of it lies inside the image; the patch is not to be used otherwise.
    """
    rows, columns = patch.shape
    x0, y0 = -(columns // 2), -(rows // 2)
    height, width = image.shape
    for corner in range(4):
        x = x0 if corner % 2 == 0 else x0 + columns - 1
        y = y0 if corner < 2 else y0 + rows - 1
        s, t = u + a * x + b * y, v + c * x + d * y
        if not (0.0 <= s < width - 1.0 and 0.0 <= t < height - 1.0):
            return False
    for j in range(rows):
        for i in range(columns):
            x, y = float(x0 + i), float(y0 + j)
            s, t = u + a * x + b * y, v + c * x + d * y
            column, row = int(s), int(t)
            f, g = s - column, t - row
            top = image[row, column] * (1.0 - f) + image[row, column + 1] * f
            bottom = image[row + 1, column] * (1.0 - f) + image[row + 1, column + 1] * f
            patch[j, i] = top * (1.0 - g) + bottom * g
    return True


_ITERATIONS = 15
_CONVERGED = 0.01  # [px]
_LARGEST_STEP = 2.0  # [px]
# How much the warp may change from one image to the next, as prior knowledge (sigma).
_WARP_SIGMA = 0.1
# Variance of the photometric noise that the prior is weighed against [gray levels^2].
_PHOTOMETRIC_VARIANCE = 9.0
# Added to the residual: quantization and read noise of two 8-bit images [gray levels^2].
_RESIDUAL_NOISE = 0.2

MARGIN = 6
"""Pixels that templates are kept larger by on every side, so that they can be blurred."""


class Alignment(NamedTuple):
    """Where templates are in an image.

    Attributes:
        pixels: of the templates' centers, shape (N, 2) [px]; NaN where the alignment failed.
        warps: offsets in the image from offsets in the template, shape (N, 2, 2).
        sigmas: standard deviation per axis that the photometric residual leaves (Cramer-Rao),
            shape (N,) [px].
        correlations: normalized cross-correlation with the template, shape (N,).
    """

    pixels: FloatArray
    warps: FloatArray
    sigmas: FloatArray
    correlations: FloatArray


def cut_templates(
    image: NDArray[np.uint8], pixels: FloatArray, warps: FloatArray, size: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Cut warped patches out of an image.

    Args:
        image: shape (H, W).
        pixels: centers, shape (N, 2) [px].
        warps: shape (N, 2, 2).
        size: side of a template without its margin, odd [px].

    Returns:
        Templates with margin, shape (N, size + 2 MARGIN, size + 2 MARGIN), and whether they are
        wholly inside, shape (N,).
    """
    side = size + 2 * MARGIN
    patches = np.zeros((len(pixels), side, side), np.float32)
    inside = np.zeros(len(pixels), np.bool_)
    _cut_all(image, np.ascontiguousarray(pixels), warps, patches, inside)
    return patches, inside


def align_templates(
    image: NDArray[np.uint8],
    templates: NDArray[np.float32],
    pixels: FloatArray,
    warps: FloatArray,
    search: NDArray[np.int64],
    blur: float = 0.0,
) -> Alignment:
    """Find templates in an image near where they are expected.

    Args:
        image: shape (H, W).
        templates: with their margin, shape (N, P + 2 MARGIN, P + 2 MARGIN).
        pixels: where their centers are expected, shape (N, 2) [px].
        warps: how they are expected to be warped, shape (N, 2, 2).
        search: whole pixels about `pixels` that are searched first, shape (N,); 0 for none.
        blur: by how much more the image is blurred than the templates (sigma) [px].
    """
    places = np.array(pixels, dtype=np.float64)
    turned = np.array(warps, dtype=np.float64)
    sigmas, correlations = np.full(len(places), np.nan), np.full(len(places), np.nan)
    _align_all(
        image, _without_margin(templates, blur), places, turned, search, sigmas, correlations
    )
    return Alignment(places, turned, sigmas, correlations)


def _without_margin(templates: NDArray[np.float32], blur: float) -> NDArray[np.float32]:
    """Templates, blurred, less their margin, shape (N, P, P)."""
    inner = slice(MARGIN, templates.shape[1] - MARGIN)
    if blur > 0.0 and len(templates):
        tall = templates.reshape(-1, templates.shape[2])  # the margins keep them apart
        side = 2 * MARGIN + 1
        smooth = np.asarray(cv2.GaussianBlur(tall, (side, side), blur), dtype=np.float32)
        templates = smooth.reshape(templates.shape)
    return np.ascontiguousarray(templates[:, inner, inner])


@njit(nogil=True, cache=True, error_model="numpy")
def _cut_all(image, pixels, warps, patches, inside):  # type: ignore[no-untyped-def]
    for n in range(len(pixels)):
        u, v = pixels[n]
        a = warps[n]
        inside[n] = sample_patch(image, u, v, a[0, 0], a[0, 1], a[1, 0], a[1, 1], patches[n])


@njit(nogil=True, cache=True, error_model="numpy")
def _align_all(image, templates, pixels, warps, search, sigmas, correlations):  # type: ignore[no-untyped-def]
    size = templates.shape[1]
    template, patch = np.empty((size, size)), np.empty((size, size))
    jacobian = np.empty((6, size * size))
    for n in range(len(pixels)):
        template[:] = templates[n]
        template -= template.mean()
        _jacobian(template, jacobian)
        if search[n] > 0:
            _search(image, template, pixels[n], warps[n], search[n], patch)
        good = _align(image, template, jacobian, pixels[n], warps[n], patch)
        if good:
            _assess(template, patch, jacobian, warps[n], n, sigmas, correlations)
        else:
            pixels[n] = np.nan


@njit(nogil=True, cache=True, error_model="numpy")
def _jacobian(template, jacobian):  # type: ignore[no-untyped-def]
    """Derivatives of the template by (du, dv, and the four elements of the warp), mean removed."""
    size = template.shape[0]
    reach = size // 2
    for j in range(size):
        for i in range(size):
            before, after = max(i - 1, 0), min(i + 1, size - 1)
            above, below = max(j - 1, 0), min(j + 1, size - 1)
            gu = (template[j, after] - template[j, before]) / (after - before)
            gv = (template[below, i] - template[above, i]) / (below - above)
            k = j * size + i
            x, y = float(i - reach), float(j - reach)
            jacobian[0, k], jacobian[1, k] = gu, gv
            jacobian[2, k], jacobian[3, k] = gu * x, gu * y
            jacobian[4, k], jacobian[5, k] = gv * x, gv * y
    for p in range(6):
        jacobian[p] -= jacobian[p].mean()


@njit(nogil=True, cache=True, error_model="numpy")
def _normal(jacobian):  # type: ignore[no-untyped-def]
    normal = jacobian @ jacobian.T
    prior = _PHOTOMETRIC_VARIANCE / _WARP_SIGMA**2
    for p in range(6):
        normal[p, p] += 1e-6 if p < 2 else prior
    return normal


@njit(nogil=True, cache=True, error_model="numpy")
def _search(image, template, pixel, warp, reach, patch):  # type: ignore[no-untyped-def]
    """Move `pixel` to the whole-pixel shift with the best correlation."""
    best, best_u, best_v = -2.0, pixel[0], pixel[1]
    for j in range(-reach, reach + 1):
        for i in range(-reach, reach + 1):
            u, v = pixel[0] + i, pixel[1] + j
            if not sample_patch(image, u, v, warp[0, 0], warp[0, 1], warp[1, 0], warp[1, 1], patch):
                continue
            score = _correlation(template, patch)
            if score > best:
                best, best_u, best_v = score, u, v
    pixel[0], pixel[1] = best_u, best_v


@njit(nogil=True, cache=True, error_model="numpy")
def _correlation(template, patch):  # type: ignore[no-untyped-def]
    """Normalized cross-correlation with a template of zero mean."""
    total, square, cross, energy = 0.0, 0.0, 0.0, 0.0
    for j in range(template.shape[0]):
        for i in range(template.shape[1]):
            value, t = patch[j, i], template[j, i]
            total += value
            square += value * value
            cross += value * t
            energy += t * t
    spread = square - total * total / template.size
    return cross / np.sqrt(max(spread * energy, 1.0))


@njit(nogil=True, cache=True, error_model="numpy")
def _align(image, template, jacobian, pixel, warp, patch):  # type: ignore[no-untyped-def]
    """Gauss-Newton; leaves the aligned patch, with the template's mean and contrast, in `patch`."""
    inverse = np.linalg.inv(_normal(jacobian))
    energy = (template * template).sum()
    error = np.empty(template.size)
    step = np.zeros(6)
    for _ in range(_ITERATIONS):
        if not _sample_equal(image, pixel, warp, energy, patch):
            return False
        k = 0
        for j in range(template.shape[0]):
            for i in range(template.shape[1]):
                error[k] = patch[j, i] - template[j, i]
                k += 1
        step[:] = inverse @ (jacobian @ error)
        moved = np.hypot(step[0], step[1])
        if moved > _LARGEST_STEP:
            step *= _LARGEST_STEP / moved
        _compose(pixel, warp, step)
        if moved < _CONVERGED:
            return _sample_equal(image, pixel, warp, energy, patch)
    return False


@njit(nogil=True, cache=True, error_model="numpy")
def _sample_equal(image, pixel, warp, energy, patch):  # type: ignore[no-untyped-def]
    u, v = pixel
    if not sample_patch(image, u, v, warp[0, 0], warp[0, 1], warp[1, 0], warp[1, 1], patch):
        return False
    patch -= patch.mean()
    patch *= np.sqrt(energy / max((patch * patch).sum(), 1.0))
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def _compose(pixel, warp, step):  # type: ignore[no-untyped-def]
    """Warp after the inverse of the step: W(x) <- W(dW^-1(x))."""
    a, b, c, d = 1.0 + step[2], step[3], step[4], 1.0 + step[5]
    det = a * d - b * c
    inverse = np.empty((2, 2))
    inverse[0, 0], inverse[0, 1] = d / det, -b / det
    inverse[1, 0], inverse[1, 1] = -c / det, a / det
    back_u = -(inverse[0, 0] * step[0] + inverse[0, 1] * step[1])
    back_v = -(inverse[1, 0] * step[0] + inverse[1, 1] * step[1])
    pixel[0] += warp[0, 0] * back_u + warp[0, 1] * back_v
    pixel[1] += warp[1, 0] * back_u + warp[1, 1] * back_v
    warp[:] = warp @ inverse


@njit(nogil=True, cache=True, error_model="numpy")
def _assess(template, patch, jacobian, warp, n, sigmas, correlations):  # type: ignore[no-untyped-def]
    correlations[n] = _correlation(template, patch)
    residual = ((patch - template) ** 2).mean() + _RESIDUAL_NOISE
    covariance = residual * np.linalg.inv(_normal(jacobian))[:2, :2]
    there = warp @ covariance @ warp.T
    middle = 0.5 * (there[0, 0] + there[1, 1])
    half = 0.5 * (there[0, 0] - there[1, 1])
    sigmas[n] = np.sqrt(middle + np.sqrt(half * half + there[0, 1] ** 2))


# Brightness is made equal where mean or contrast of the images differ by more than this.
_SAME_MEAN = 3.0  # [gray levels]
_SAME_CONTRAST = 0.03
_LEAST_CONTRAST = 1.0  # [gray levels]


_FLOW_WINDOW = 21  # side of the window, odd [px]
_FLOW_LEVELS = 4  # of the image pyramid; each doubles the step that is followed
_FLOW_ITERATIONS = 20  # most per level
_MAX_ROUND_TRIP = 1.0  # by which a pixel may miss itself, followed forward and back [px]


class OpticalFlow:
    """Follows pixels from the image before to the next.

    B. D. Lucas and T. Kanade, *An iterative image registration technique*, IJCAI 1981, in the
    pyramidal form of J.-Y. Bouguet, as OpenCV has it. A change of the whole image's brightness and
    contrast between the two is taken out first.
    """

    def __init__(self) -> None:
        self._image: NDArray[np.uint8] | None = None

    def remember(self, image: NDArray[np.uint8]) -> None:
        """Take an image, shape (H, W), as the one from which `follow` goes on."""
        self._image = image

    def follow(
        self, image: NDArray[np.uint8], pixels: FloatArray, start: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Find pixels of the remembered image in another, which is remembered in its place.

        Args:
            image: shape (H, W).
            pixels: in the remembered image, shape (N, 2) [px].
            start: where they are expected in `image`, shape (N, 2) [px].

        Returns:
            Where they are, shape (N, 2) [px], and whether they came back, shape (N,).
        """
        before, self._image = self._image, image
        if before is None or len(pixels) == 0:
            return start.copy(), np.zeros(len(pixels), np.bool_)
        now = equalised(image, before)
        places = np.ascontiguousarray(pixels, np.float32)[:, None]
        guess = np.ascontiguousarray(start, np.float32)[:, None]
        there, forward = self._flow(before, now, places, guess)
        back, backward = self._flow(now, before, there, places.copy())
        missed = np.linalg.norm(back - places, axis=2)[:, 0]
        found = (forward & backward)[:, 0] & (missed <= _MAX_ROUND_TRIP)
        return there[:, 0].astype(np.float64), np.asarray(found)

    def _flow(
        self,
        before: NDArray[np.uint8],
        after: NDArray[np.uint8],
        pixels: NDArray[np.float32],
        guess: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        there, status, _ = cv2.calcOpticalFlowPyrLK(
            before,
            after,
            pixels,
            guess.copy(),
            winSize=(_FLOW_WINDOW, _FLOW_WINDOW),
            maxLevel=_FLOW_LEVELS - 1,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _FLOW_ITERATIONS, 0.03),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=1e-4,
        )
        return there, status.astype(np.bool_)


def equalised(image: NDArray[np.uint8], like: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image with the mean and contrast of another; itself where they are alike already."""
    mean, contrast = (float(value[0, 0]) for value in cv2.meanStdDev(image))
    wanted_mean, wanted_contrast = (float(value[0, 0]) for value in cv2.meanStdDev(like))
    gain = max(wanted_contrast, _LEAST_CONTRAST) / max(contrast, _LEAST_CONTRAST)
    if abs(mean - wanted_mean) < _SAME_MEAN and abs(gain - 1.0) < _SAME_CONTRAST:
        return image
    levels = np.clip(np.rint((np.arange(256) - mean) * gain + wanted_mean), 0, 255)
    return np.asarray(cv2.LUT(image, levels.astype(np.uint8)), dtype=np.uint8)
