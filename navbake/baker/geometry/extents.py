"""Upright boxes round geoms, turned as the geoms lie."""

from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import Solids
from navbake.baker.geometry.shapes import Shapes, support_distances
from navbake.baker.geometry.triangle_kernels import RIGHT, find_facing_directions, measure_spans
from navbake.threads import run_in_chunks
from navbake.types import Float, Int, Int32

# How many directions of upright faces are distinguished, over a right angle
DIRECTIONS = 180
CHUNK = 1 << 16  # triangles that are looked at together


class Extents(NamedTuple):
    """Upright boxes round geoms, by geom id; NaN for infinite planes and what isn't counted."""

    center: Float  # (n, 2) [m]
    across: Float  # unit vectors along the shorter sides, (n, 2)
    thin: Float  # the shorter sides [m]
    long: Float
    low: Float  # heights of bottom and top [m]
    high: Float

    @property
    def along(self) -> Float:
        """Unit vectors along the longer sides, shape (n, 2), float64."""
        return np.stack([-self.across[:, 1], self.across[:, 0]], axis=1)

    def half_widths(self, geoms: Int, way: Float) -> Float:
        """How far geoms, ids (k,), reach from their middles along a way, (2,) or (k, 2), in [m]."""
        on_thin = np.abs((self.across[geoms] * way).sum(axis=-1))
        on_long = np.abs((self.along[geoms] * way).sum(axis=-1))
        return np.asarray((on_thin * self.thin[geoms] + on_long * self.long[geoms]) / 2)


def measure_extents(shapes: Shapes, num_geoms: int) -> Extents:
    """Measure the counted geoms.

    A solid's box follows whichever of its own axes makes it smallest, that of triangles the
    direction that most of their upright faces look in.
    """
    pairs = (np.full((num_geoms, 2), np.nan) for _ in range(2))
    extents = Extents(*pairs, *(np.full(num_geoms, np.nan) for _ in range(4)))
    _measure_solids(shapes.solids, extents)
    for triangles in shapes.triangles_of_some():
        if len(triangles.geom):
            _measure_triangles(triangles.geom, triangles.corners, extents)
    return extents


def _measure_solids(solids: Solids, out: Extents) -> None:
    axes = solids.mat.reshape(-1, 3, 3)
    best = np.full(len(solids.geom), np.inf)
    for number in range(3):
        way = axes[:, :2, number]
        length = np.hypot(way[:, 0], way[:, 1])
        way = np.where(length[:, None] > 1e-6, way / np.maximum(length, 1e-6)[:, None], [1.0, 0.0])
        turned = np.stack([-way[:, 1], way[:, 0]], axis=1)
        ways = (np.einsum("nij,ni->nj", axes[:, :2], along) for along in (way, turned))
        one, other = (support_distances(solids.kind, along, solids.size) for along in ways)
        area = one * other
        smaller = area < best * (1 - 1e-9)  # rounding alone never picks another axis
        best[smaller] = area[smaller]
        is_thin = (one <= other)[:, None]
        geom = solids.geom[smaller]
        out.across[geom] = np.where(is_thin, way, turned)[smaller]
        out.thin[geom] = 2 * np.minimum(one, other)[smaller]
        out.long[geom] = 2 * np.maximum(one, other)[smaller]
    out.center[solids.geom] = solids.pos[:, :2]
    out.low[solids.geom] = solids.bounds[:, 2]
    out.high[solids.geom] = solids.bounds[:, 5]


def _measure_triangles(geom: Int32, corners: Float, out: Extents) -> None:
    first = np.flatnonzero(np.diff(geom, prepend=np.int32(-1)))
    which = geom[first]
    group = np.repeat(np.arange(len(first), dtype=np.int32), np.diff(first, append=len(geom)))
    angle = facing_angles(corners, group, len(first))
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    turned = np.stack([-way[:, 1], way[:, 0]], axis=1)
    low = np.full((len(first), 3), np.inf)
    high = np.full((len(first), 3), -np.inf)
    measure_spans(corners, group, way, low, high)
    one, other, _ = (high - low).T
    middle = (low + high) / 2
    out.across[which] = np.where((one <= other)[:, None], way, turned)
    out.thin[which] = np.minimum(one, other)
    out.long[which] = np.maximum(one, other)
    out.center[which] = way * middle[:, :1] + turned * middle[:, 1:2]
    out.low[which] = low[:, 2]
    out.high[which] = high[:, 2]


def facing_angles(corners: Float, group: Int32, num: int) -> Float:
    """The angle, modulo a right one, that most upright faces of each group look at, (num,) [rad].

    Takes corners of triangles, (m, 3, 3) [m], and the group of each, below `num`, (m,).
    """
    votes, sums = np.zeros((2, num * DIRECTIONS))
    way = np.empty(CHUNK, np.int32)
    weight = np.empty(CHUNK)
    off = np.empty(CHUNK)
    for first in range(0, len(group), CHUNK):
        some = corners[first : first + CHUNK]
        run_in_chunks(
            find_facing_directions, len(some), some, DIRECTIONS, way, weight, off, least=4096
        )
        at = group[first : first + CHUNK] * np.int64(DIRECTIONS) + way[: len(some)]
        np.add.at(votes, at, weight[: len(some)])
        np.add.at(sums, at, off[: len(some)])
    votes = votes.reshape(num, DIRECTIONS)
    sums = sums.reshape(num, DIRECTIONS)
    most = votes.argmax(axis=1)
    total = votes[np.arange(num), most]
    rest = sums[np.arange(num), most]
    angle: Float = most * (RIGHT / DIRECTIONS) + rest / np.where(total > 0.0, total, 1.0)
    return angle
