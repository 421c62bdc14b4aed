"""Compiled distance from points to a body; the public form is `body.body_mask`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

SPHERE, BOX, CYLINDER, POLYTOPE = range(4)

_GROWTH = 0.05  # [rad]; how far beside a solid rays count as meeting it, at most by the margin
_BINS, _BIN = 128, 0.025  # of rays, and their width in x / z


class SolidArrays(NamedTuple):
    """Solids as plain arrays.

    Attributes:
        kinds: SPHERE, BOX, CYLINDER or POLYTOPE, shape (S,).
        sizes: radius; half edges; radius and half length [m], shape (S, 3).
        plane_starts: solid i has the planes [starts[i], starts[i + 1]), shape (S + 1,).
        planes: outward unit normal and offset [m] of polytopes, shape (P, 4).
        centers: origins of the solids [m], shape (S, 3).
        rotations: from each solid's frame to that of the points, shape (S, 3, 3).
        radii: of the bounding spheres [m], shape (S,).
        middle: center of a sphere that holds all bounding spheres [m], shape (3,).
        reach: its radius [m].
    """

    kinds: NDArray[np.int64]
    sizes: NDArray[np.float64]
    plane_starts: NDArray[np.int64]
    planes: NDArray[np.float64]
    centers: NDArray[np.float64]
    rotations: NDArray[np.float64]
    radii: NDArray[np.float64]
    middle: NDArray[np.float64]
    reach: float


@njit(cache=True, nogil=True)
def mark(
    solids: Any,
    points: Any,
    covariances: Any,
    columns: Any,
    margin: float,
    sigmas: float,
    unknown_variance: float,
    rays: bool,
    mask: Any,
) -> None:
    """Mark points, shape (N, 3), that may lie on a solid, or behind one.

    Args:
        solids: a `SolidArrays`.
        points: shape (N, 3) [m].
        covariances: shape (N, k), or (1, k) for all points [m^2].
        columns: columns of xx, yy, zz, xy, xz, yz in `covariances`.
        margin: growth of the solids [m].
        sigmas: further growth, in standard deviations along the direction from the solid.
        unknown_variance: along each axis, where a covariance is not finite [m^2].
        rays: whether points are marked too whose ray from the origin meets a grown solid; one that
            holds the origin, such as a camera's housing, does not count.
        mask: shape (N,), set where a point is marked.
    """
    local, normal, c = np.empty(3), np.empty(3), np.empty(6)
    outline = _outline(solids, margin)
    shared = len(covariances) == 1
    for i in range(len(points)):
        offset = _distance(points[i], solids.middle)
        if math.isnan(offset):
            continue
        if rays and _is_behind(solids, points[i], outline, local):
            mask[i] = True
            continue
        spread = _load_covariance(covariances[0 if shared else i], columns, unknown_variance, c)
        growth = margin + sigmas * spread
        if offset > solids.reach + growth:
            continue
        for s in range(len(solids.kinds)):
            if _distance(points[i], solids.centers[s]) > solids.radii[s] + growth:
                continue
            _into_solid(points[i], solids.centers[s], solids.rotations[s], local)
            if _touches(solids, s, local, c, margin, sigmas, normal):
                mask[i] = True
                break


class _Outline(NamedTuple):
    """The solids as they are seen from the origin.

    Attributes:
        start: the origin in each solid's frame, shape (S, 3).
        growths: by how much each is grown for rays, negative where it is not asked, shape (S,) [m].
        slacks: further growth with which one ray stands for all of its bin, shape (S,) [m].
        far: length beyond which no solid is [m].
        bins: of rays by x / z and y / z, shape (`_BINS`, `_BINS`); 0 not asked yet, 1 nothing is
            met there, 2 something may be.
    """

    start: NDArray[np.float64]
    growths: NDArray[np.float64]
    slacks: NDArray[np.float64]
    far: float
    bins: NDArray[np.uint8]


@njit(cache=True, nogil=True)
def _outline(solids: Any, margin: float) -> Any:
    """See `_Outline`: joints and matchers err by angles, so what is near is grown by less."""
    count = len(solids.kinds)
    start, growths, slacks = np.empty((count, 3)), np.empty(count), np.empty(count)
    origin, normal = np.zeros(3), np.empty(3)
    for s in range(count):
        _into_solid(origin, solids.centers[s], solids.rotations[s], start[s])
        gap = _gap(solids, s, start[s], normal)
        growths[s] = min(margin, _GROWTH * gap) if gap > 0.0 else -1.0
        reach = _distance(origin, solids.centers[s]) + solids.radii[s]
        slacks[s] = min(_BIN * reach, 0.9 * gap)  # the origin stays outside
    far = 2.0 * (_distance(solids.middle, origin) + solids.reach)
    return _Outline(start, growths, slacks, far, np.zeros((_BINS, _BINS), np.uint8))


@njit(cache=True, nogil=True)
def _is_behind(solids: Any, point: Any, outline: Any, local: Any) -> bool:
    """Whether the segment from the origin to a point leads through one of the solids."""
    if point[2] > 0.0:
        row = int(point[1] / point[2] / _BIN + 0.5 * _BINS)
        column = int(point[0] / point[2] / _BIN + 0.5 * _BINS)
        if 0 <= row < _BINS and 0 <= column < _BINS:
            if outline.bins[row, column] == 0:
                ray = np.array([_middle(column), _middle(row), 1.0]) * outline.far
                met = _meets_any(solids, ray, outline, True, local)
                outline.bins[row, column] = 2 if met else 1
            if outline.bins[row, column] == 1:
                return False
    return _meets_any(solids, point, outline, False, local)


@njit(cache=True, nogil=True, inline="always")
def _middle(number: int) -> float:
    return (number + 0.5 - 0.5 * _BINS) * _BIN


@njit(cache=True, nogil=True)
def _meets_any(solids: Any, end: Any, outline: Any, widely: bool, local: Any) -> bool:
    for s in range(len(solids.kinds)):
        growth = outline.growths[s] + (outline.slacks[s] if widely else 0.0)
        if outline.growths[s] < 0.0 or _passes(end, solids.centers[s], solids.radii[s] + growth):
            continue
        _into_solid(end, solids.centers[s], solids.rotations[s], local)
        if _meets(solids, s, outline.start[s], local, growth):
            return True
    return False


@njit(cache=True, nogil=True, inline="always")
def _passes(end: Any, center: Any, radius: float) -> bool:
    """Whether the segment from the origin passes a sphere; most solids are told apart by it."""
    along = end[0] * center[0] + end[1] * center[1] + end[2] * center[2]
    length = end[0] * end[0] + end[1] * end[1] + end[2] * end[2]
    share = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    x, y, z = (share * end[0] - center[0], share * end[1] - center[1], share * end[2] - center[2])
    return bool(x * x + y * y + z * z > radius * radius)


@njit(cache=True, nogil=True)
def _gap(solids: Any, s: int, p: Any, normal: Any) -> float:
    """Distance of a point to a solid, in its frame; of a polytope, at least so much.

    Not above 0 inside; outside, `normal` becomes its direction, but for a polytope.
    """
    kind, size = solids.kinds[s], solids.sizes[s]
    if kind == SPHERE:
        return _from_sphere(p, size, normal)
    if kind == BOX:
        return _from_box(p, size, normal)
    if kind == CYLINDER:
        return _from_cylinder(p, size, normal)
    gap = -math.inf
    for k in range(solids.plane_starts[s], solids.plane_starts[s + 1]):
        plane = solids.planes[k]
        gap = max(gap, plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3])
    return gap


@njit(cache=True, nogil=True)
def _meets(solids: Any, s: int, a: Any, b: Any, growth: float) -> bool:
    """Whether the segment between two points of the solid's frame meets the grown solid.

    The solid is where all its bounds hold; each leaves a part [enter, leave] of the segment.
    """
    kind, size = solids.kinds[s], solids.sizes[s]
    enter, leave = 0.0, 1.0
    if kind == POLYTOPE:
        for k in range(solids.plane_starts[s], solids.plane_starts[s + 1]):
            plane, before, after = solids.planes[k], -growth, -growth
            for j in range(3):
                before += plane[j] * a[j]
                after += plane[j] * b[j]
            enter, leave = _clip(before - plane[3], after - plane[3], enter, leave)
            if enter > leave:
                return False
        return True
    if kind == BOX:
        for j in range(3):
            bound = size[j] + growth
            enter, leave = _clip(a[j] - bound, b[j] - bound, enter, leave)
            enter, leave = _clip(-a[j] - bound, -b[j] - bound, enter, leave)
        return bool(enter <= leave)
    dimensions = 3
    if kind == CYLINDER:
        dimensions, bound = 2, size[1] + growth
        enter, leave = _clip(a[2] - bound, b[2] - bound, enter, leave)
        enter, leave = _clip(-a[2] - bound, -b[2] - bound, enter, leave)
    square, product, rest = 0.0, 0.0, -((size[0] + growth) ** 2)
    for j in range(dimensions):
        square += (b[j] - a[j]) ** 2
        product += a[j] * (b[j] - a[j])
        rest += a[j] * a[j]
    if square == 0.0:
        return bool(rest <= 0.0 and enter <= leave)
    root = product * product - square * rest
    if root < 0.0:
        return False
    root = math.sqrt(root)
    return bool(max(enter, (-product - root) / square) <= min(leave, (-product + root) / square))


@njit(cache=True, nogil=True, inline="always")
def _clip(before: float, after: float, enter: float, leave: float) -> tuple[float, float]:
    """What is left of [enter, leave] where a value that grows evenly from 0 to 1 is below 0."""
    if before > 0.0 and after > 0.0:
        return 1.0, 0.0
    if before > 0.0:
        return max(enter, before / (before - after)), leave
    if after > 0.0:
        return enter, min(leave, before / (before - after))
    return enter, leave


@njit(cache=True, nogil=True, inline="always")
def _distance(a: Any, b: Any) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return math.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, inline="always")
def _load_covariance(row: Any, columns: Any, unknown_variance: float, c: Any) -> float:
    """Fill c = (xx, yy, zz, xy, xz, yz); returns a bound of the standard deviation [m]."""
    total = 0.0
    for k in range(6):
        c[k] = row[columns[k]]
        total += abs(c[k])
    if not math.isfinite(total) or min(c[0], c[1], c[2]) < 0.0:
        c[:3] = unknown_variance
        c[3:] = 0.0
    return math.sqrt(c[0] + c[1] + c[2])


@njit(cache=True, nogil=True)
def _into_solid(point: Any, center: Any, rotation: Any, local: Any) -> None:
    for j in range(3):
        local[j] = 0.0
        for k in range(3):
            local[j] += rotation[k, j] * (point[k] - center[k])


@njit(cache=True, nogil=True)
def _touches(
    solids: Any, s: int, p: Any, c: Any, margin: float, sigmas: float, normal: Any
) -> bool:
    """Whether a point, in the solid's frame, is within the grown solid."""
    rotation = solids.rotations[s]
    if solids.kinds[s] == POLYTOPE:
        for k in range(solids.plane_starts[s], solids.plane_starts[s + 1]):
            plane = solids.planes[k]
            distance = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3]
            if distance > margin and distance > margin + sigmas * _sigma(plane, rotation, c):
                return False
        return True
    distance = _gap(solids, s, p, normal)
    return bool(distance <= margin or distance <= margin + sigmas * _sigma(normal, rotation, c))


@njit(cache=True, nogil=True)
def _sigma(normal: Any, rotation: Any, c: Any) -> float:
    """Standard deviation along a direction given in the solid's frame [m]."""
    x = rotation[0, 0] * normal[0] + rotation[0, 1] * normal[1] + rotation[0, 2] * normal[2]
    y = rotation[1, 0] * normal[0] + rotation[1, 1] * normal[1] + rotation[1, 2] * normal[2]
    z = rotation[2, 0] * normal[0] + rotation[2, 1] * normal[1] + rotation[2, 2] * normal[2]
    variance = c[0] * x * x + c[1] * y * y + c[2] * z * z
    variance += 2.0 * (c[3] * x * y + c[4] * x * z + c[5] * y * z)
    return math.sqrt(max(variance, 0.0))


@njit(cache=True, nogil=True)
def _from_sphere(p: Any, size: Any, normal: Any) -> float:
    """Distance to a sphere, negative inside; outside, `normal` becomes its direction."""
    radius = math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    if radius > size[0]:
        for k in range(3):
            normal[k] = p[k] / radius
    return float(radius - size[0])


@njit(cache=True, nogil=True)
def _from_box(p: Any, size: Any, normal: Any) -> float:
    """Distance to a box, zero inside; outside, `normal` becomes its direction."""
    square = 0.0
    for k in range(3):
        normal[k] = math.copysign(max(abs(p[k]) - size[k], 0.0), p[k])
        square += normal[k] * normal[k]
    distance = math.sqrt(square)
    if distance > 0.0:
        for k in range(3):
            normal[k] /= distance
    return distance


@njit(cache=True, nogil=True)
def _from_cylinder(p: Any, size: Any, normal: Any) -> float:
    """Distance to a cylinder along z, zero inside; outside, `normal` becomes its direction."""
    radius = math.sqrt(p[0] * p[0] + p[1] * p[1])
    radial, axial = max(radius - size[0], 0.0), max(abs(p[2]) - size[1], 0.0)
    distance = math.sqrt(radial * radial + axial * axial)
    if distance > 0.0:
        share = radial / (distance * radius) if radial > 0.0 else 0.0
        normal[0], normal[1] = p[0] * share, p[1] * share
        normal[2] = math.copysign(axial, p[2]) / distance
    return distance
