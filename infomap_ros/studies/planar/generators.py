"""Seeded planar worlds of 100 x 100 m: clutter, rooms, caves, and one like that of Fig. 10."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy import ndimage

from infomap_ros.errors import ConfigError
from infomap_ros.studies.planar.world import BoolArray, PlanarWorld

_SIDE = 100.0  # [m]
_CLEAR = 3.0  # radius about the start without obstacles [m]
_LEAST_OPEN = 0.35  # share of a world that can be entered, else it is drawn again

Draw = Callable[[np.random.Generator, int, float], BoolArray]


def clutter(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Discs and turned boxes of 1 to 6 m until they cover a seventh of the ground."""
    x, y = np.meshgrid(*[(np.arange(side) + 0.5) * cell] * 2, indexing="ij")
    occupied = np.zeros((side, side), np.bool_)
    while occupied.mean() < 1.0 / 7.0:
        middle, angle = rng.uniform(0.0, side * cell, 2), rng.uniform(0.0, np.pi)
        half = rng.uniform(0.5, 3.0, 2)
        dx, dy = x - middle[0], y - middle[1]
        u = dx * np.cos(angle) + dy * np.sin(angle)
        v = dy * np.cos(angle) - dx * np.sin(angle)
        is_disc = rng.random() < 0.5
        box = (np.abs(u) < half[0]) & (np.abs(v) < half[1])
        occupied |= np.hypot(u, v) < half[0] if is_disc else box
    return occupied


def rooms(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Rooms that are cut out of the whole, and out of each other, by walls with doors."""
    occupied = np.zeros((side, side), np.bool_)
    wall, least, door = (max(1, round(width / cell)) for width in (0.5, 10.0, 2.0))
    parts = [(0, 0, side, side)]
    while parts:
        left, low, right, high = parts.pop()
        across = (right - left) >= (high - low)
        first, last = (left, right) if across else (low, high)
        if last - first < 2 * least + wall or (last - first < 3 * least and rng.random() < 0.2):
            continue
        at = int(rng.integers(first + least, last - least - wall + 1))
        begin, end = (low, high) if across else (left, right)
        line = np.ones(end - begin, np.bool_)
        for part in np.array_split(np.arange(end - begin), max(1, (end - begin) // (4 * least))):
            gap = int(rng.integers(part[0] + wall, part[-1] - door - wall + 1))
            line[gap : gap + door] = False
        if across:
            occupied[at : at + wall, begin:end] |= line
            parts += [(left, low, at, high), (at + wall, low, right, high)]
        else:
            occupied[begin:end, at : at + wall] |= line[:, None]
            parts += [(left, low, right, at), (left, at + wall, right, high)]
    return occupied


def caves(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Noise, smoothed over 2.5 m and cut so that two fifths are rock."""
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)), 2.5 / cell, mode="wrap")
    return np.asarray(noise > np.quantile(noise, 0.6))


def unstructured(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Rugged islands of 3 to 15 m: the kind of world that Fig. 10 shows."""
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)), 4.0 / cell, mode="wrap")
    rugged = ndimage.gaussian_filter(rng.normal(size=(side, side)), 1.0 / cell, mode="wrap")
    noise = noise / noise.std() + 0.35 * rugged / rugged.std()
    return np.asarray(noise > np.quantile(noise, 0.8))


KINDS: Mapping[str, Draw] = {
    "fig10": unstructured,
    "clutter": clutter,
    "rooms": rooms,
    "caves": caves,
}
"""Kinds of worlds by name."""


def make_world(kind: str, seed: int, cell: float = 0.5) -> PlanarWorld:
    """Draw a world; the sensor starts in its middle.

    Args:
        kind: one of `KINDS`.
        seed: of the random numbers; a draw of which less than a third can be entered is repeated.
        cell: edge of a cell [m].

    Raises:
        ConfigError: there is no such kind.
    """
    if kind not in KINDS:
        raise ConfigError("kind", kind, "one of " + ", ".join(KINDS))
    rng = np.random.default_rng([seed, *kind.encode()])
    side = round(_SIDE / cell)
    place = (np.arange(side) + 0.5) * cell - 0.5 * _SIDE
    clear = np.hypot(place[:, None], place) < _CLEAR
    while True:
        occupied = np.pad(KINDS[kind](rng, side, cell) & ~clear, 1, constant_values=True)
        start = (np.array([side // 2 + 1, side // 2 + 1]) + 0.5) * cell
        world = PlanarWorld(f"{kind}_{seed}", kind, occupied, cell, start)
        if np.mean(world.mappable & ~occupied) > _LEAST_OPEN:
            return world
