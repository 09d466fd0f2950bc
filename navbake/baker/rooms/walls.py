"""Walls: distances to them, the directions that they run in, and the sills that continue them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import TiledShapes, cast_points, tile_shapes
from navbake.baker.core.arrays import Facets
from navbake.baker.core.components import find_row_runs
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.rooms import gap_kernels as kernels
from navbake.baker.rooms.gap_kernels import FAR
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_beside, run_in_chunks
from navbake.types import Bool, Float, Int, Int32

T = TypeVar("T", bound=np.generic)

STRIP = 64  # columns that are worth a thread's while
NO_ROWS = np.empty((0, 0), dtype=np.int32)
# Directions of walls are taken from their geometry, at points about so far apart [m], in bins of so
# many degrees and lines so wide [m], if this share of the points lies on walls with a direction
SPACING = 0.1
FINE_BIN = 1.0
FINE_LINE = 0.01
MOST_POINTS = 0.5
# Else they are measured at this distance from walls [m], in such bins [°] and lines [cells]
OFF_WALL = 0.3
BIN = 5.0
LINE = 0.5
# Each direction needs this length of wall [m], and this share of all
LEAST_WALL = 1.2
LEAST_SHARE = 0.01
# So much of a wall lies on one line; its gaps begin or end so near to it [m]
LINE_WALL = 0.8
NEAR_WALL = 1.5
# The steps in which a direction is refined [bins], by about so many points; an axis of the lattice
# is taken if it is as sharp as this share of the sharpest
FINE = 0.05
ENOUGH = 2000
AS_SHARP = 0.9
# A direction is one of the whole building if it is the first or at right angles to it, within so
# many degrees; others are those of the walls near to them
SQUARE = 1.0
# The lattice's steps disturb what is nearer to a wall [cells]
OFF_STEPS = 5
# Cells round the lattice in which slopes at its edge are measured
PADDING = 2

RAY_HEIGHT = 0.6  # at which walls are measured over the floor, below the sills of windows [m]
HEIGHT_BIN = 0.01  # to which the heights of rays are told [m]
CHUNK = 1 << 14  # triangles that are looked at together
# Rays begin over a cell's width, as a thin wall lies beside the centres of cells that it is in
OVER_CELL = np.array([-0.5, 0.0, 0.5])
NOWHERE = -1e9  # the height of rays from cells without a floor, which meet nothing [m]
# Most rays end within so many cells; of many, the others are cast once more, as far as needed
NEAR_CELLS = 2.5
MANY_RAYS = 200
FAR_DIAGONAL = math.sqrt(2) * FAR
# Walls farther from the centres of doorways' end cells are ignored [m]; farther than those of other
# gaps, `FAR`, as they lean in the lattice where they are at an angle to it
FAR_OF_DOORWAY = 0.6
# A sill is at most this thick [m]; it fills every cell it touches, one more on each side
SILL_THICKNESS = 0.5
# By how much geometry is widened, so that rays between two tiles find it in both [m]
HAIR = 1e-6


def squared_distances(target: Bool, reach: int) -> Int32:
    """Squared distance of each node to the nearest target, ``(reach + 1) ** 2`` beyond `reach`."""
    target, along = np.ascontiguousarray(target), np.empty(target.shape, dtype=np.int16)
    run_in_chunks(kernels.sweep, target.shape[1], target, reach, along, NO_ROWS, least=STRIP)
    squared = np.empty(target.shape, dtype=np.int32)
    run_in_chunks(kernels.sweep, len(target), target, reach, along, squared)
    return squared


def distances_at(open_cells: Bool, reach: int, row: Int, col: Int) -> Int:
    """The `squared_distances` of some nodes to marked ones, see `wall_nodes`."""
    closed = np.pad(~open_cells, 1, constant_values=True)
    along = np.empty(closed.shape, dtype=np.int16)
    far = reach // 2 + 1
    run_in_chunks(kernels.sweep, closed.shape[1], closed, far, along, NO_ROWS, least=STRIP)
    nearest = np.full(len(row), (reach + 1) ** 2)
    over = (row + 1) // 2
    under = (row + 2) // 2
    last = closed.shape[1] - 1
    for shift in range(-(reach // 2) - 1, reach // 2 + 3):
        beside = np.clip(col // 2 + shift, 0, last)
        cells = np.minimum(along[over, beside], along[under, beside]).astype(np.int64)
        down = np.maximum(2 * cells - row % 2, 0)
        right = np.abs(2 * beside - 1 - col) - 1  # cells are two nodes wide
        np.minimum(nearest, down**2 + np.maximum(right, 0) ** 2, out=nearest)
    return nearest


def wall_nodes(open_cells: Bool) -> Bool:
    """Mark the nodes, shape (2 height + 1, 2 width + 1), on a closed cell or the lattice's edge.

    Node (2 r + 1, 2 c + 1) is the centre of cell (r, c); the others are edges' middles and
    corners, so that gaps can be measured to half a cell.
    """
    closed = np.pad(~open_cells, 1, constant_values=True)
    rows = closed.repeat(2, axis=0)[1:-1]
    rows = rows[:-1] | rows[1:]  # each row's upper edge, its centre, …, the last one's lower edge
    cols = rows.repeat(2, axis=1)[:, 1:-1]
    return cols[:, :-1] | cols[:, 1:]


class Direction(NamedTuple):
    """A direction that walls run in."""

    swapped: bool  # rows and columns, to scan it
    shift: Int  # the row of a line in each column less that in the first
    slope: float  # the rows that it goes down with each column
    stretch: float  # the length of a step along it [cells]
    near: Bool  # cells near to walls that run in it


class WallPoints(NamedTuple):
    """Points on walls, from which the directions of these follow."""

    place: Float  # (2, n) [rows, columns]
    angle: Float  # of the wall there, from the columns' axis towards the rows', (n,) [°]
    apart: float  # how far neighbours on a wall are from each other [m]
    each: float  # the bins in which they are counted [°]
    width: float  # of the lines on which they are [cells]


def find_directions(
    open_cells: Bool, cell_size: float, rays: WallRays | None = None
) -> list[Direction]:
    """Find the directions that walls run in.

    They follow from the walls' geometry, or where there is none, or where it is as rough as that of
    a scan, from the slope of the distance to closed cells.
    """
    if rays is not None:
        points, asked = rays.find_points(open_cells)
        directions, explained = _list_directions(points, open_cells.shape, cell_size)
        if asked and explained >= MOST_POINTS * asked:
            return directions
    return _list_directions(_find_points(open_cells, cell_size), open_cells.shape, cell_size)[0]


def _list_directions(
    points: WallPoints, shape: tuple[int, ...], cell_size: float
) -> tuple[list[Direction], int]:
    """The directions that points on walls have, and how many of these have one."""
    foot, angle, apart, each, width = points
    num = round(180 / each)
    bins = np.rint(angle / each).astype(np.int64) % num
    # round the corners of walls the slope has all directions alike
    around = 2.0 * float(np.median(_smooth(np.bincount(bins, minlength=num))))
    least = max(LEAST_WALL / apart, LEAST_SHARE * len(bins))
    directions = list[Direction]()
    main = 0.0
    total = 0
    left = np.ones(len(bins), dtype=np.bool_)
    while True:
        count = _smooth(np.bincount(bins[left], minlength=num))
        best = int(count.argmax())
        if count[best] < least + around:
            return directions, total
        off = np.abs((angle - best * each + 90.0) % 180.0 - 90.0)
        near = left & (off <= 1.5 * each)
        chosen = _align(foot[:, near], best, each, width)
        # points on its walls count for no other direction, a few degrees off
        near = left & (off <= 2.5 * each)
        explained = _on_walls(foot[:, near], chosen, width, LINE_WALL / apart)
        if explained.sum() >= least:
            walls: Bool = np.zeros(shape, dtype=np.bool_)
            row, col = np.rint(foot[:, near][:, explained]).astype(np.int64)
            inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
            walls[row[inside], col[inside]] = True
            found = direction_of(chosen, shape)
            main = main if directions else chosen
            if abs((chosen - main + 45.0) % 90.0 - 45.0) > SQUARE:
                most = round(NEAR_WALL / cell_size)
                found = found._replace(near=squared_distances(walls, most) <= most**2)
            directions.append(found)
            left[near] = ~explained
            total += int(explained.sum())
        else:
            left[near] = False


def _find_points(open_cells: Bool, cell_size: float) -> WallPoints:
    """Points on walls by the slope of the distance to them."""
    reach = max(OFF_STEPS, round(OFF_WALL / cell_size))
    # the edge of the lattice is no wall: what is there goes on beyond it
    closed = np.pad(~open_cells, PADDING, mode="edge")
    squared = squared_distances(closed, reach + 2)
    at = (squared >= (reach - 1) ** 2) & (squared < reach**2)
    at[[0, 1, -2, -1]] = at[:, [0, 1, -2, -1]] = False
    cells = np.flatnonzero(at)
    width = closed.shape[1]
    beside = cells + np.array([[2 * width], [-2 * width], [2], [-2], [0]])
    below, above, after, before, distance = np.sqrt(squared.ravel()[beside], dtype=np.float32)
    down = below - above
    right = after - before
    # a wall runs across the slope; where two walls are as near, there is less of one
    clear = np.hypot(down, right) > 3.2
    cells = cells[clear]
    distance = distance[clear]
    down = down[clear]
    right = right[clear]
    angle = np.mod(np.rad2deg(np.arctan2(down, right)) + 90.0, 180.0)
    slope = np.hypot(down, right)
    foot = np.array(np.divmod(cells, width)) - distance * np.stack([down, right]) / slope
    return WallPoints(foot - PADDING, angle, cell_size, BIN, LINE)


def _smooth(count: Int) -> Int:
    return count + np.roll(count, 1) + np.roll(count, -1)


def _across(foot: Float, angles: Float, width: float) -> Float:
    """In which line each point lies, (angles, n), of lines in directions [°] so wide [cells]."""
    turn = np.deg2rad(angles)[:, None]
    across = foot[0] * np.cos(turn) - foot[1] * np.sin(turn)
    return np.asarray((across - across.min(axis=1, keepdims=True)) / width)


def _on_walls(foot: Float, angle: float, width: float, least: float) -> Bool:
    """Which points lie on two neighbouring lines that have as many as a wall."""
    line = _across(foot, np.array([angle]), width)[0].astype(np.int64)
    count = np.pad(np.bincount(line), 1)
    pairs = count[1:] + count[:-1]  # each line with the one before
    is_wall: Bool = np.maximum(pairs[line], pairs[line + 1]) >= least
    return is_wall


def _align(foot: Float, number: int, each: float, width: float) -> float:
    """The angle within 1.5 bins at which points, (2, n), are on the fewest lines [°].

    It has the sharpest projection of a Radon transform; an axis of the lattice about as sharp wins.
    """
    foot = foot[:, :: max(1, foot.shape[1] // ENOUGH)]
    most = round(1.5 / FINE)
    angles = each * (number + FINE * np.arange(-most, most + 1, dtype=np.float64))
    sharpness = np.zeros(len(angles), dtype=np.int64)
    for k, across in enumerate(_across(foot, angles, width)):
        for phase in (0.0, 0.5):  # so that no wall falls between two lines
            count = np.bincount((across + phase).astype(np.int64))
            # the squares of the sums of two lines next to each other; whole numbers, so exact
            sharpness[k] = max(sharpness[k], count @ count + count[1:] @ count[:-1])
    is_axis = angles % 90.0 == 0.0
    if (sharpness[is_axis] >= AS_SHARP * sharpness.max()).any():
        return float(angles[is_axis][0])
    return float(angles[sharpness.argmax()])


def direction_of(angle: float, shape: tuple[int, ...]) -> Direction:
    """A direction from its angle from the columns' axis towards the rows' [degrees]."""
    swapped = 45.0 < angle < 135.0
    slope = np.tan(np.deg2rad(90.0 - angle if swapped else angle))
    count = shape[0] if swapped else shape[1]
    shift = np.rint(np.arange(count) * slope).astype(np.int64)
    near = np.broadcast_to(np.True_, shape)
    return Direction(swapped, shift, float(slope), float(np.hypot(1.0, slope)), near)


def turned(array: NDArray[T], direction: Direction) -> NDArray[T]:
    """An array as the kernels scan it in a direction: column by column, as it lies in memory."""
    return np.asfortranarray(array.T if direction.swapped else array)


class WallRays:
    """Level rays from cells to the walls' geometry, `RAY_HEIGHT` over the floor."""

    def __init__(self, walls: Shapes, lattice: Lattice, floor: Float) -> None:
        self._lattice = lattice
        self._heights = floor + RAY_HEIGHT
        # a triangle is met at no heights but those of the floor's rays, told to a HEIGHT_BIN
        heights = self._heights[~np.isnan(floor)]
        low = heights.min()
        high = heights.max()
        bins = np.zeros(int((high - low) / HEIGHT_BIN) + 1, dtype=np.int64)
        bins[((heights - low) / HEIGHT_BIN).astype(np.int64)] = 1
        before = np.append(0, np.cumsum(bins))  # of each bin, those with a ray
        bounds = walls.triangles.bounds
        parts = dict[int, Int]()

        def choose(first: int, end: int) -> None:
            for begin in range(first * CHUNK, end * CHUNK, CHUNK):  # which caches hold
                bottom = bounds[begin : begin + CHUNK, 2]
                top = bounds[begin : begin + CHUNK, 5]
                some = np.flatnonzero((bottom <= high) & (top >= low))
                ends = np.stack([bottom[some] - HAIR, top[some] + HAIR]) - low
                one, other = (ends / HEIGHT_BIN).astype(np.int64).clip(0, len(bins) - 1)
                parts[begin] = begin + some[before[other + 1] > before[one]]

        run_in_chunks(choose, -(-len(bounds) // CHUNK))
        chosen = np.concatenate([np.empty(0, np.int64), *(parts[k] for k in sorted(parts))])
        triangles = Facets._make(array.take(chosen, axis=0) for array in walls.triangles)
        self._heights[np.isnan(floor)] = NOWHERE
        # rays from cells at the lattice's edge reach beyond it
        self._reach = max(FAR_DIAGONAL, FAR_OF_DOORWAY / lattice.cell_size)
        self._margin = margin = math.ceil(self._reach) + 1
        rows, cols = (slice(-margin, count + margin) for count in lattice.shape)
        self._tiled = tile_shapes(walls, lattice.cut(rows, cols), HAIR, triangles)
        self._turned: dict[tuple[bool, float], tuple[Float, TiledShapes, Float]] = {}

    def look(self, direction: Direction, cells: Int) -> Float:
        """Cast rays from `cells`, shape (…, 2), back and on along a direction; -1 for none.

        Returns how far walls are from cells' centres as far as that is known, plus 1, 0 where it
        isn't, inf for none [columns]: (cells, 2), as the direction scans them.
        """
        axes, tiled, known = self._turn(direction)
        at = np.nonzero(cells >= 0)
        cell = cells[at]
        way = at[-1]
        new = known[cell, way] == 0.0
        cell = cell[new]
        way = way[new]
        if len(cell):
            row, col = np.divmod(cell, self._heights.shape[0 if direction.swapped else 1])
            row, col = (col, row) if direction.swapped else (row, col)
            away, _ = self._cast(axes, tiled, row, col, way == 1, OVER_CELL)
            known[cell, way] = away / (direction.stretch * self._lattice.cell_size) + 1.0
        return known

    def find_points(self, open_cells: Bool) -> tuple[WallPoints, int]:
        """Points on walls that are met from the open cells beside closed ones; how many are asked.

        Rays along the lattice's axes meet them.
        """
        closed = np.pad(~open_cells, 1, mode="edge")
        size = self._lattice.cell_size
        has_floor = open_cells & (self._heights > NOWHERE)
        every = max(1, int(SPACING / size))
        rows, cols = open_cells.shape
        places = list[Float]()
        angles = list[Float]()
        asked = 0
        for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            beside = closed[1 + down : 1 + down + rows, 1 + right : 1 + right + cols]
            row, col = np.divmod(np.flatnonzero(has_floor & beside), cols)
            some = (row + col) % every == 0
            row = row[some]
            col = col[some]
            axes, tiled, _ = self._turn(direction_of(90.0 * abs(down), open_cells.shape))
            is_after = np.full(len(row), down + right > 0)
            away, normal = self._cast(axes, tiled, row, col, is_after, np.zeros(1))
            # what is steeper to the ray is met by those along the other axis
            own = np.abs(normal[:, 2]) >= np.abs(normal[:, 0])
            met = own & np.isfinite(away)
            asked = asked + int(own.sum())
            row = row[met]
            col = col[met]
            away = away[met] / size
            places.append(np.stack([row + down * away, col + right * away]))
            x, y, _ = axes.T @ normal[met].T
            angles.append(np.mod(np.rad2deg(np.arctan2(-y, x)) + 90.0, 180.0))
        found = np.concatenate(places, axis=1), np.concatenate(angles)
        return WallPoints(*found, every * size, FINE_BIN, FINE_LINE / size), asked

    def _cast(
        self, axes: Float, tiled: TiledShapes, row: Int, col: Int, is_after: Bool, offsets: Float
    ) -> tuple[Float, Float]:
        """Cast rays on or back from cells, at some offsets across them [cells].

        Returns how far walls are [m], inf for none, and the normal there in the rays' frame, (n, 3)
        of 0 for none.
        """
        lattice = self._lattice
        count = len(offsets)
        centers = np.column_stack([lattice.positions(row, col), self._heights[row, col]]) @ axes.T
        # cells of the lattice with its margin
        places = np.stack([row, col]) + (self._margin + 0.5)
        way = np.where(is_after, 1.0, -1.0)
        # how a step across a ray and one along it change the row and the column
        aside, along = axes[[0, 2]][:, [1, 0]] * (-1.0, 1.0)
        away = np.full(len(row), np.inf)
        normal = np.zeros((len(row), 3))
        left = np.arange(len(row))
        # most rays end near their cells, where there is little to look at
        for reach in (NEAR_CELLS, self._reach)[len(row) < MANY_RAYS :]:
            ray = left.repeat(count)
            offset = np.tile(offsets, len(left))
            points = centers[ray, :2]
            points[:, 0] += offset * lattice.cell_size
            ends = np.empty((2, len(ray), 2))
            ends[..., 0] = places[:, ray] + aside[:, None] * offset
            ends[..., 1] = ends[..., 0] + along[:, None] * (way[ray] * reach)
            rows, cols = ends.astype(np.int64)
            hits = cast_points(tiled, rows * tiled.lattice.width + cols, points, axes)
            line = np.repeat(ray, np.diff(hits.start))
            ahead = way[line] * (hits.z - centers[line, 2])
            ahead[~(ahead >= 0.0)] = np.inf
            np.minimum.at(away, line, ahead)
            is_first = np.isfinite(ahead) & (ahead == away[line])
            normal[line[is_first]] = hits.normal[is_first]
            left = left[away[left] > reach * lattice.cell_size]
            if not len(left):
                break
        return away, normal

    def _turn(self, direction: Direction) -> tuple[Float, TiledShapes, Float]:
        """A frame in which the direction is up, its axes as rows; the walls in it; see `look`."""
        key = direction.swapped, direction.slope
        if key not in self._turned:
            way = np.array([1.0, -direction.slope]) / direction.stretch
            x, y = -way[::-1] if direction.swapped else way
            axes = np.array([[-y, x, 0.0], [0.0, 0.0, 1.0], [x, y, 0.0]])
            tiled = replace(self._tiled, shapes=self._tiled.shapes.turned(axes))
            known = np.zeros((self._heights.size, 2))
            self._turned[key] = axes, tiled, known
        return self._turned[key]


def find_windows(low: Bool, wall: Bool, cell_size: float) -> Bool:
    """Mark the cells of sills and parapets that continue a wall.

    Where walls, floors and furniture are one mesh, it blocks `low` cells below heads only, and
    `wall` cells above, too. A sill goes from one piece of wall to the next along the wall's
    direction without a break, and is as thin as a wall, unlike furniture.
    """
    found = np.zeros(low.shape, dtype=np.bool_)
    if not low.any():
        return found
    waiting = []
    for direction in find_directions(~wall, cell_size):
        # drawn sills are as wide as their wall, so that each line of theirs ends at it
        scanned = turned(low, direction), turned(wall, direction)
        bridge = np.zeros_like(scanned[0])
        wait = run_beside(kernels.mark_bridges, *scanned, direction.shift, bridge)
        waiting.append((direction, bridge, wait))
    for direction, bridge, wait in waiting:
        wait()
        most = int(SILL_THICKNESS * direction.stretch / cell_size) + 2
        col, top, end, _ = find_row_runs(bridge.T)
        for k in np.flatnonzero(end - top > most).tolist():
            bridge[top[k] : end[k], col[k]] = False
        found |= bridge.T if direction.swapped else bridge
    return found
