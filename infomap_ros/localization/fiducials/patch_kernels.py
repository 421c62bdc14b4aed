"""Small kernels on image patches that tracking and sparse stereo share."""

from __future__ import annotations

from numba import njit


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
