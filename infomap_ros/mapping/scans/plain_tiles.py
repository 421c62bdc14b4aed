"""Tiles of an organised scan in which every pixel is measured and depths differ little.

Most tiles are such. Their pixels share the mean of the tile's covariances, and what they have in
common is done for all at once, without a branch. Where depths or covariances differ more, the
tile is left to `infomap_ros.mapping.scans.tiles`, which walks pixel by pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.scans.association import NEAREST
from infomap_ros.mapping.scans.tiles import PIXELS, TILE, group_of
from infomap_ros.mapping.voxels.keys import COORDINATE_LIMIT, pack

_PLAIN, _FAR = 1, 2
_DEPTH_RATIO, _VARIANCE_RATIO = 1.05, 1.5
"""How much depths of a plain tile may differ from that at its centre, and variances within it."""


@kernel
def gather_plain_tile(
    sensor: Any,
    points: Any,
    covariances: Any,
    columns: Any,
    v0: int,
    u0: int,
    margin: float,
    groups: Any,
    lower: Any,
    upper: Any,
    tallies: Any,
) -> int:
    """As `gather_tile` for a plain tile; returns -1 with nothing changed when it is not plain."""
    height, width = points.shape[0], points.shape[1]
    if v0 + TILE > height or u0 + TILE > width:
        return -1
    pixels = groups.pixels
    state = _place_pixels(sensor, points.reshape(-1), width, v0, u0, groups.tile, pixels)
    if state == _FAR:
        _set_depths(pixels, v0, u0, 0.0, lower, upper)
        tallies[1] += PIXELS
        return 0
    if state != _PLAIN:
        return -1
    mean = _mean_covariance(covariances, columns, v0 * width + u0, width, groups.columns)
    if not mean[0] > 0.0:
        return -1
    _set_depths(pixels, v0, u0, margin, lower, upper)
    count = _group_pixels(pixels, groups.pixel_keys, groups.keys, groups.sums)
    sums = groups.sums
    for group in range(count):
        for n in range(6):
            sums[group, 4 + n] = mean[n] * sums[group, 0]
    return count


@kernel
def _place_pixels(
    sensor: Any, flat: Any, width: int, v0: int, u0: int, tile: Any, pixels: Any
) -> int:
    """Depth and position in voxels of every pixel; _PLAIN, _FAR (then depths alone) or 0."""
    for row in range(TILE):
        base = 3 * ((v0 + row) * width + u0)
        for n in range(3 * TILE):
            tile[row * 3 * TILE + n] = flat[np.uint64(base + n)]
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = sensor.rotation
    tx, ty, tz = sensor.position
    scale, squared_range, limit = sensor.inverse_size, sensor.max_range**2, COORDINATE_LIMIT - 128.0
    centre = np.float64(tile[3 * (TILE // 2 * TILE + TILE // 2) + 2])
    near, far = max(centre / _DEPTH_RATIO, NEAREST), centre * _DEPTH_RATIO
    beyond, plain = 0, 0
    for pixel in range(PIXELS):
        x = np.float64(tile[3 * pixel])
        y = np.float64(tile[3 * pixel + 1])
        z = np.float64(tile[3 * pixel + 2])
        mx = (r0 * x + r1 * y + r2 * z + tx) * scale
        my = (r3 * x + r4 * y + r5 * z + ty) * scale
        mz = (r6 * x + r7 * y + r8 * z + tz) * scale
        squared = x * x + y * y + z * z
        is_plain = (z > near) & (z < far) & (squared <= squared_range)
        is_plain &= (abs(mx) < limit) & (abs(my) < limit) & (abs(mz) < limit)
        plain += 1 if is_plain else 0
        is_beyond = (z > NEAREST) & (squared > squared_range) & (squared < np.inf)
        beyond += 1 if is_beyond else 0
        pixels[0, pixel], pixels[1, pixel] = z, mx
        pixels[2, pixel], pixels[3, pixel] = my, mz
    if beyond == PIXELS:
        for pixel in range(PIXELS):
            x, y, z = tile[3 * pixel], tile[3 * pixel + 1], tile[3 * pixel + 2]
            pixels[0, pixel] = z * sensor.max_range / np.sqrt(x * x + y * y + z * z)
        return _FAR
    return _PLAIN if plain == PIXELS else 0


@kernel
def _mean_covariance(covariances: Any, columns: Any, first: int, width: int, work: Any) -> Any:
    """Mean covariance of a tile, (xx, xy, xz, yy, yz, zz); zeros when variances differ much.

    Args:
        covariances: see `gather_tile`, likewise columns.
        columns: see covariances.
        first: row of the tile's first pixel in `covariances`.
        width: of the image [px].
        work: shape (3, 72), float32.
    """
    size = covariances.shape[1]
    flat, row_size = covariances.reshape(-1), TILE * size
    sums, least, most = work[0], work[1], work[2]
    if len(covariances) == 1:
        for n in range(size):
            sums[n] = least[n] = most[n] = flat[n]
        return _checked_mean(columns, size, 1, sums, least, most)
    for row in range(TILE):
        base = (first + row * width) * size
        if row == 0:
            for n in range(row_size):
                value = flat[np.uint64(base + n)]
                sums[n] = least[n] = most[n] = value
        for n in range(row_size if row > 0 else 0):
            value = flat[np.uint64(base + n)]
            sums[n] += value
            least[n] = value if value < least[n] else least[n]
            most[n] = value if value > most[n] else most[n]
    return _checked_mean(columns, size, TILE, sums, least, most)


@kernel
def _checked_mean(columns: Any, size: int, pixels: int, sums: Any, least: Any, most: Any) -> Any:
    """Mean of columns of pixels; zeros when a variance is not positive or they differ much."""
    c0, c1, c2, c3, c4, c5 = columns
    xx = xy = xz = yy = yz = zz = 0.0
    for pixel in range(pixels):
        p = pixel * size
        xx, xy, xz = xx + sums[p + c0], xy + sums[p + c1], xz + sums[p + c2]
        yy, yz, zz = yy + sums[p + c3], yz + sums[p + c4], zz + sums[p + c5]
    is_usual = xx + yy + zz < np.inf and abs(xy) + abs(xz) + abs(yz) < np.inf
    for column in (c0, c3, c5):
        low, high = least[column], most[column]
        for pixel in range(1, pixels):
            low = min(low, least[pixel * size + column])
            high = max(high, most[pixel * size + column])
        is_usual &= low > 0.0 and high < _VARIANCE_RATIO * low
    scale = 1.0 / (pixels * pixels) if is_usual else 0.0
    return xx * scale, xy * scale, xz * scale, yy * scale, yz * scale, zz * scale


@kernel
def _set_depths(pixels: Any, v0: int, u0: int, margin: float, lower: Any, upper: Any) -> None:
    """Smallest and largest depth of every 2 x 2 cell of a plain tile."""
    for row in range(TILE // 2):
        for column in range(TILE // 2):
            pixel = 2 * row * TILE + 2 * column
            a, b = pixels[0, pixel], pixels[0, pixel + 1]
            c, d = pixels[0, pixel + TILE], pixels[0, pixel + TILE + 1]
            v, u = (v0 >> 1) + row, (u0 >> 1) + column
            lower[v, u] = min(min(a, b), min(c, d)) - margin
            upper[v, u] = max(max(a, b), max(c, d)) - margin


@kernel
def _group_pixels(pixels: Any, pixel_keys: Any, keys: Any, sums: Any) -> int:
    """Sum up number and offsets of the pixels of each voxel; returns how many voxels."""
    for pixel in range(PIXELS):
        x, y, z = pixels[1, pixel], pixels[2, pixel], pixels[3, pixel]
        i, j, k = np.floor(x), np.floor(y), np.floor(z)
        pixel_keys[pixel] = pack(np.int64(i), np.int64(j), np.int64(k))
        pixels[1, pixel], pixels[2, pixel], pixels[3, pixel] = x - i - 0.5, y - j - 0.5, z - k - 0.5
    used, first = 0, 0
    while first < PIXELS:
        key, x, y, z = pixel_keys[first], pixels[1, first], pixels[2, first], pixels[3, first]
        last = first + 1
        while last < PIXELS and pixel_keys[last] == key:
            x, y, z = x + pixels[1, last], y + pixels[2, last], z + pixels[3, last]
            last += 1
        group = group_of(keys, used, key)
        if group == used:
            used += 1
            keys[group] = key
            sums[group, 0] = sums[group, 1] = sums[group, 2] = sums[group, 3] = 0.0
        sums[group, 0] += last - first
        sums[group, 1] += x
        sums[group, 2] += y
        sums[group, 3] += z
        first = last
    return used
