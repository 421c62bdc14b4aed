"""Tiles of an organized scan in which every pixel is measured and depths differ little.

Most tiles are such. Their pixels share the mean of the tile's covariances, and what they have in
common is done for all at once, without a branch. Where depths or covariances differ more, the
tile is left to `infomap_ros.mapping.scans.plain_tiles`, which walks pixel by pixel.

The points of one tile of an organized scan, sorted into groups that lie in one voxel each.

`infomap_ros.mapping.scans.plain_tiles` does most of them faster.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import inlined_kernel
from infomap_ros.mapping.scans.association import NEAREST, voxel_position, within_limit
from infomap_ros.mapping.scans.scan import SUM_COLUMNS
from infomap_ros.mapping.voxels.keys import COORDINATE_LIMIT, pack

TILE = 8
PIXELS = TILE * TILE
_NOTHING = (0.0,) * 10


class TileGroups(NamedTuple):
    """Groups of the points of one tile, and memory to find them.

    Attributes:
        keys: of the voxel of each group, int64.
        sums: number of points, sums of their offsets from the voxel's center [voxels] (3) and of
            their covariances in the sensor frame [m^2] (6).
        tile: the points of the tile, float32, shape (192,).
        pixels: depth, position in the map [voxels] (3), shape (4, 64).
        pixel_keys: of the pixels' voxels, int64.
        work: whole numbers of each pixel, int64, shape (4, 64).
        columns: sums, smallest and largest of the covariances of each column of pixels, float32,
            shape (3, 72).
        reach: half the association segment, map frame, shape (3,) [voxels].
        axis: unit normal, map frame, shape (3,).
        normal: unit normal, sensor frame, shape (3,).
        one: a group as `add_group` takes it, shape (16,), float32.
    """

    keys: NDArray[np.int64]
    sums: NDArray[np.float64]
    tile: NDArray[np.float32]
    pixels: NDArray[np.float64]
    pixel_keys: NDArray[np.int64]
    work: NDArray[np.int64]
    columns: NDArray[np.float32]
    reach: NDArray[np.float64]
    axis: NDArray[np.float64]
    normal: NDArray[np.float64]
    one: NDArray[np.float32]


def empty_groups() -> TileGroups:
    """Memory for the groups of a tile."""
    return TileGroups(
        np.empty(PIXELS, np.int64),
        np.empty((PIXELS, 10)),
        np.empty(3 * PIXELS, np.float32),
        np.empty((4, PIXELS)),
        np.empty(PIXELS, np.int64),
        np.empty((4, PIXELS), np.int64),
        np.empty((3, 9 * TILE), np.float32),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.zeros(SUM_COLUMNS, np.float32),
    )


@inlined_kernel
def group_of(keys: Any, used: int, key: int) -> int:
    """Number of the group of a voxel, `used` when there is none."""
    group = 0
    while group < used and keys[group] != key:
        group += 1
    return group


@inlined_kernel
def _add_run(keys: Any, sums: Any, used: int, key: int, run: Any) -> int:
    """Add consecutive points of a voxel to its group; returns the number of groups then.

    Args:
        keys: of the groups, likewise sums.
        sums: see keys.
        used: number of groups.
        key: of the voxel.
        run: number of points, sums of their offsets (3) and covariances (6).
    """
    if run[0] == 0.0:
        return used
    group = group_of(keys, used, key)
    if group == used:
        used += 1
        keys[group] = key
        for n in range(10):
            sums[group, n] = 0.0
    for n in range(10):
        sums[group, n] += run[n]
    return used


@inlined_kernel
def gather_tile(
    sensor: Any, image: Any, v0: int, u0: int, margin: float, groups: Any, tallies: Any
) -> int:
    """Sort the points of one tile into `groups`; returns how many there are.

    Args:
        sensor: a `Sensor`.
        image: an `infomap_ros.mapping.scans.organized.OrganizedScan`.
        v0: first row of the tile.
        u0: first column of the tile.
        margin: what is taken off a measured depth before space counts as empty [m].
        groups: a `TileGroups`.
        tallies: see `infomap_ros.mapping.scans.organized.gather_organized`.
    """
    points, covariances, columns = image.points, image.covariances, image.columns
    lower, upper = image.lower, image.upper
    height, width = points.shape[0], points.shape[1]
    keys, sums, used = groups.keys, groups.sums, 0
    squared_range = sensor.max_range**2
    stride = 0 if len(covariances) == 1 else 1
    corner, key, run = (np.inf, np.inf, np.inf), np.int64(0), _NOTHING
    for v in range(v0, min(v0 + TILE, height)):
        for u in range(u0, min(u0 + TILE, width)):
            x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            squared = x * x + y * y + z * z
            if not (z > NEAREST and squared < np.inf):
                continue
            depth = z - margin
            if squared > squared_range:
                depth = z * sensor.max_range / np.sqrt(squared)
                tallies[1] += 1
            else:
                covariance = _covariance(covariances, stride * (v * width + u), columns)
                if not _has_variances(covariance):
                    tallies[3] += 1
                    continue
                place = voxel_position(sensor, x, y, z)
                if not within_limit(place[0], place[1], place[2]):
                    tallies[2] += 1
                    continue
                if not _lies_in(place, corner):
                    used = _add_run(keys, sums, used, key, run)
                    corner = np.floor(place[0]), np.floor(place[1]), np.floor(place[2])
                    key, run = pack(int(corner[0]), int(corner[1]), int(corner[2])), _NOTHING
                run = _with_point(run, place, corner, covariance)
            lower[v >> 1, u >> 1] = min(lower[v >> 1, u >> 1], depth)
            upper[v >> 1, u >> 1] = max(upper[v >> 1, u >> 1], depth)
    return _add_run(keys, sums, used, key, run)


@inlined_kernel
def _covariance(covariances: Any, row: int, columns: Any) -> Any:
    """Upper triangle of a covariance as a tuple."""
    c0, c1, c2, c3, c4, c5 = columns
    c = covariances
    return c[row, c0], c[row, c1], c[row, c2], c[row, c3], c[row, c4], c[row, c5]


@inlined_kernel
def _has_variances(c: Any) -> bool:
    """Whether the variances of an upper triangle are positive and finite."""
    return c[0] > 0.0 and c[3] > 0.0 and c[5] > 0.0 and c[0] + c[3] + c[5] < np.inf


@inlined_kernel
def _lies_in(place: Any, corner: Any) -> bool:
    """Whether a point lies in the voxel with this lower corner [voxels]."""
    dx, dy, dz = place[0] - corner[0], place[1] - corner[1], place[2] - corner[2]
    return 0.0 <= dx < 1.0 and 0.0 <= dy < 1.0 and 0.0 <= dz < 1.0


@inlined_kernel
def _with_point(run: Any, place: Any, corner: Any, c: Any) -> Any:
    """A run as `_add_run` takes it, with one more point of its voxel."""
    count, ox, oy, oz, xx, xy, xz, yy, yz, zz = run
    ox, oy = ox + (place[0] - corner[0] - 0.5), oy + (place[1] - corner[1] - 0.5)
    oz = oz + (place[2] - corner[2] - 0.5)
    xx, xy, xz = xx + c[0], xy + c[1], xz + c[2]
    return count + 1.0, ox, oy, oz, xx, xy, xz, yy + c[3], yz + c[4], zz + c[5]


PLAIN, FAR = 1, 2
_ONE = np.uint64(1)
_UNIT, _FRACTION = 2.0**32, 2**32 - 1
_DEPTH_RATIO, _VARIANCE_RATIO = 1.05, 1.5
"""How much depths of a plain tile may differ from that at its center, and variances within it."""


@inlined_kernel
def place_tile(
    sensor: Any, image: Any, flat: Any, v0: int, u0: int, groups: Any, tallies: Any
) -> int:
    """Place the pixels of a tile in the map, and do all there is to do where it is FAR.

    Args:
        sensor: a `Sensor`.
        image: an `infomap_ros.mapping.scans.organized.OrganizedScan`.
        flat: its points in one row.
        v0: first row of the tile.
        u0: first column of the tile.
        groups: a `TileGroups`.
        tallies: see `infomap_ros.mapping.scans.organized.gather_organized`.

    Returns:
        PLAIN where `gather_plain_tile` may do the rest, FAR where all points are out of range, or
        0.
    """
    height, width = image.points.shape[0], image.points.shape[1]
    if v0 + TILE > height or u0 + TILE > width:
        return 0
    state = _place_pixels(sensor, flat, width, v0, u0, groups.tile, groups.pixels)
    if state == FAR:
        _set_depths(groups.pixels, v0, u0, 0.0, image.lower, image.upper)
        tallies[1] += PIXELS
    return state


@inlined_kernel
def gather_plain_tile(image: Any, table: Any, v0: int, u0: int, margin: float, groups: Any) -> int:
    """As `gather_tile` for a tile that has been placed and is PLAIN.

    Args:
        image: see `place_tile`, likewise v0, u0 and groups.
        table: the covariances in one row.
        v0: see image.
        u0: see image.
        margin: see `gather_tile`.
        groups: see image.

    Returns:
        Number of groups, or -1 with nothing changed when the covariances differ much.
    """
    pixels, width = groups.pixels, image.points.shape[1]
    first, work = v0 * width + u0, groups.columns
    mean = _mean_covariance(image.covariances, table, image.columns, first, width, work)
    if not mean[0] > 0.0:
        return -1
    _set_depths(pixels, v0, u0, margin, image.lower, image.upper)
    count = _group_near(pixels, groups.work, groups.keys, groups.sums)
    if count < 0:
        count = _group_pixels(pixels, groups.pixel_keys, groups.keys, groups.sums)
    sums = groups.sums
    for group in range(count):
        for n in range(6):
            sums[group, 4 + n] = mean[n] * sums[group, 0]
    return count


@inlined_kernel
def _place_pixels(
    sensor: Any, flat: Any, width: int, v0: int, u0: int, tile: Any, pixels: Any
) -> int:
    """Depth and position in voxels of every pixel; PLAIN, FAR (then depths alone) or 0."""
    row_size = len(tile) // TILE  # not a constant here, or numbers are copied one by one
    for row in range(TILE):
        base, start = 3 * ((v0 + row) * width + u0), row * row_size
        for n in range(row_size):
            tile[np.uint64(start + n)] = flat[np.uint64(base + n)]
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = sensor.rotation
    tx, ty, tz = sensor.position
    scale, squared_range, limit = sensor.inverse_size, sensor.max_range**2, COORDINATE_LIMIT - 128.0
    center = np.float64(tile[3 * (TILE // 2 * TILE + TILE // 2) + 2])
    near, far = max(center / _DEPTH_RATIO, NEAREST), center * _DEPTH_RATIO
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
        return FAR
    return PLAIN if plain == PIXELS else 0


@inlined_kernel
def _mean_covariance(
    covariances: Any, table: Any, columns: Any, first: int, width: int, work: Any
) -> Any:
    """Mean covariance of a tile, (xx, xy, xz, yy, yz, zz); zeros when variances differ much.

    Args:
        covariances: see `gather_tile`, likewise columns.
        table: the covariances in one row.
        columns: see covariances.
        first: row of the tile's first pixel in `covariances`.
        width: of the image [px].
        work: shape (3, 72), float32.
    """
    size = covariances.shape[1]
    row_size = TILE * size
    sums, least, most = work[0], work[1], work[2]
    if len(covariances) == 1:
        for n in range(size):
            sums[n] = least[n] = most[n] = table[n]
        return _checked_mean(columns, size, 1, sums, least, most)
    for row in range(TILE):
        base = (first + row * width) * size
        if row == 0:
            for n in range(row_size):
                value = table[np.uint64(base + n)]
                sums[n] = least[n] = most[n] = value
        for n in range(row_size if row > 0 else 0):
            value = table[np.uint64(base + n)]
            sums[n] += value
            least[n] = value if value < least[n] else least[n]
            most[n] = value if value > most[n] else most[n]
    return _checked_mean(columns, size, TILE, sums, least, most)


@inlined_kernel
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


@inlined_kernel
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


@inlined_kernel
def _group_near(pixels: Any, work: Any, keys: Any, sums: Any) -> int:
    """As `_group_pixels` for pixels within 4 x 4 x 4 voxels, without a branch; else -1.

    Positions are whole numbers of 2^-32 voxels, so that a sum does not ask for an order.
    """
    bx, by, bz = _corner(pixels[1]), _corner(pixels[2]), _corner(pixels[3])
    present, used_bits = np.uint64(0), np.int64(0)
    for n in range(PIXELS):
        x = np.int64((pixels[1, n] - bx) * _UNIT)
        y = np.int64((pixels[2, n] - by) * _UNIT)
        z = np.int64((pixels[3, n] - bz) * _UNIT)
        used_bits |= x | y | z
        place = (x >> 32) | ((y >> 32) << 2) | ((z >> 32) << 4)
        work[0, n] = place
        work[1, n], work[2, n], work[3, n] = x & _FRACTION, y & _FRACTION, z & _FRACTION
        present |= _ONE << np.uint64(place & 63)
    if used_bits >> 34:
        return -1
    used, pixel = 0, 0
    while present:
        place = work[0, pixel]
        pixel += 1
        if not (present >> np.uint64(place)) & _ONE:
            continue
        present &= ~(_ONE << np.uint64(place))
        points, dx, dy, dz = 0, 0, 0, 0
        for n in range(PIXELS):
            is_here = work[0, n] == place
            points += 1 if is_here else 0
            dx += work[1, n] if is_here else 0
            dy += work[2, n] if is_here else 0
            dz += work[3, n] if is_here else 0
        i, j, k = place & 3, (place >> 2) & 3, place >> 4
        keys[used] = pack(np.int64(bx) + i, np.int64(by) + j, np.int64(bz) + k)
        sums[used, 0] = points
        sums[used, 1] = dx / _UNIT - 0.5 * points
        sums[used, 2] = dy / _UNIT - 0.5 * points
        sums[used, 3] = dz / _UNIT - 0.5 * points
        used += 1
    return used


@inlined_kernel
def _corner(places: Any) -> float:
    """Lowest of four voxels in a row that hold the corner pixels of a tile if any four do."""
    last, row = PIXELS - 1, TILE - 1
    low = min(min(places[0], places[row]), min(places[last - row], places[last]))
    high = max(max(places[0], places[row]), max(places[last - row], places[last]))
    lowest = np.floor(low)
    return lowest - 1.0 if high - lowest < 2.0 else lowest


@inlined_kernel
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
