"""Arenas of squares: their obstacles, maps that an agent explores, and map descriptors.

A map descriptor has the explored squares of an arena and their obstacles as two hex strings.
Part 1 has a bit for each square, 1 for explored, between two bits 11 and two bits 11.
Part 2 has a bit for each explored square, 1 for an obstacle, and 0s up to a full byte. Squares
go row by row from the bottom, each row from the left. An arena of 15 × 20 squares fills 38 bytes
in part 1; other sizes get 0s after the closing 11, up to a full byte.

Arrays are ``[row, col]`` with row 0 at the top, as in all of navbake.
"""

from __future__ import annotations

from collections.abc import Sequence
from string import hexdigits
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import FormatError, QueryError
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.lattice import CELL_SLACK, Lattice, num_cells
from navbake.types import Bool, Float, Int
from navbake.voxels.grid import finite_array

ARENA = (20, 15)  # rows and columns of the format's arena
SQUARE = 0.1  # edge of its squares [m]
PAD = np.array([1, 1], dtype=np.uint8)
MOST = 10**8  # squares of a map
HAIR = 1e-6  # a range that ends this near before a face ends on it [m]

UNEXPLORED = "?"
FREE = "."
OBSTACLE = "#"


def encode(explored: ArrayLike, obstacles: ArrayLike) -> tuple[str, str]:
    """Encode a map.

    Args:
        explored: shape (rows, cols), row 0 at the top, true for explored squares.
        obstacles: the same, true for obstacles; unexplored squares are ignored.

    Returns:
        Part 1 and part 2, in capitals; part 2 is empty if nothing is explored.

    Raises:
        FormatError: the two aren't of one shape, or of no squares.
    """
    known = _flags(explored, "explored")
    filled = _flags(obstacles, "obstacles")
    if known.shape != filled.shape:
        both = f"{known.shape} and {filled.shape}"
        raise FormatError(f"expected explored and obstacles of one shape (rows, cols), got {both}")
    # the format goes from the bottom row up, arrays from the top row down
    squares = known[::-1].ravel()
    content = filled[::-1].ravel()
    parts = np.concatenate([PAD, squares, PAD]), content[squares]
    part1, part2 = (np.packbits(bits.astype(np.uint8)).tobytes().hex().upper() for bits in parts)
    return part1, part2


def decode(part1: str, part2: str, shape: Sequence[int] = ARENA) -> tuple[Bool, Bool]:
    """Decode a map; the inverse of `encode`.

    Also reads small letters, and a part 2 that is filled up to a digit instead of a byte.

    Args:
        shape: rows and columns, >= 1 each.

    Returns:
        explored and obstacles, shape (rows, cols), bool, row 0 at the top; unexplored squares
        have no obstacle.

    Raises:
        FormatError: a string isn't hexadecimal, too short or too long, or its padding is wrong.
    """
    rows, cols = check_shape(shape)
    bits, got = _from_hex(part1, "part 1")
    count = rows * cols + 4
    digits = 2 * -(-count // 8)
    if got != digits:
        squares = f"{rows} × {cols} squares"
        raise FormatError(f"expected {digits} digits in part 1 for {squares}, got {got}")
    for name, (a, b) in (("first", bits[:2]), ("last", bits[count - 2 : count])):
        if not (a and b):
            raise FormatError(f"expected the {name} two bits of part 1 to be 11, got {a}{b}")
    if bits[count:].any():
        raise FormatError("expected 0s after the closing 11 of part 1, got others")
    explored = bits[2 : count - 2].astype(np.bool_)
    known = int(explored.sum())
    content, got = _from_hex(part2, "part 2")
    digits = -(-known // 4)
    whole = 2 * -(-known // 8)
    if got not in (digits, whole):
        expected = f"{whole}" if digits == whole else f"{whole} (or {digits})"
        squares = f"the {known} squares that part 1 has explored"
        got_what = f"{got}: {'more' if got > whole else 'fewer'} than it has"
        raise FormatError(f"expected {expected} digits in part 2 for {squares}, got {got_what}")
    if content[known:].any():
        why = "it is longer than the squares that part 1 has explored"
        raise FormatError(f"expected 0s after the {known} bits of part 2, got more: {why}")
    obstacles = np.zeros(rows * cols, dtype=np.bool_)
    obstacles[explored] = content[:known]
    return explored.reshape(rows, cols)[::-1].copy(), obstacles.reshape(rows, cols)[::-1].copy()


def draw(explored: ArrayLike, obstacles: ArrayLike) -> str:
    """Draw a map: ``?`` unexplored, ``.`` free, ``#`` obstacle; a line a row, the top one first."""
    known = _flags(explored, "explored")
    filled = _flags(obstacles, "obstacles")
    marks = np.where(known, np.where(filled, OBSTACLE, FREE), UNEXPLORED)
    return "\n".join("".join(row) for row in marks)


def _flags(values: ArrayLike, name: str) -> Bool:
    try:
        flags = np.asarray(values)
    except ValueError:  # rows of several lengths
        flags = np.empty(0)
    if flags.dtype.kind not in "biuf":
        raise FormatError(f"expected {name} of true and false, got dtype {flags.dtype}")
    if flags.ndim != 2 or 0 in flags.shape:
        raise FormatError(f"expected {name} of shape (rows, cols), got {flags.shape}")
    return np.asarray(flags != 0)


def check_shape(shape: Sequence[int]) -> tuple[int, int]:
    """Rows and columns of a map; a FormatError if they aren't whole numbers >= 1, or too many."""
    sizes = list(shape) if np.iterable(shape) else [shape]
    if len(sizes) != 2 or not all(isinstance(n, int | np.integer) and n >= 1 for n in sizes):
        raise FormatError(f"expected a shape (rows, cols), each >= 1, got {sizes}")
    rows = int(sizes[0])
    cols = int(sizes[1])
    if rows * cols > MOST:
        raise FormatError(f"expected at most {MOST} squares, got {rows} × {cols}")
    return rows, cols


def _from_hex(text: str, name: str) -> tuple[NDArray[np.uint8], int]:
    """The bits, filled up to a full byte, and the number of digits."""
    if not isinstance(text, str):
        raise FormatError(f"expected {name} as a string of hexadecimal digits, got {text!r}")
    digits = text.strip()
    if odd := digits.strip(hexdigits):
        raise FormatError(f"expected hexadecimal digits in {name}, got {odd[0]!r}")
    data = bytes.fromhex(digits + "0" * (len(digits) % 2))
    return np.unpackbits(np.frombuffer(data, dtype=np.uint8)), len(digits)


def check_squares(square: float, corner: ArrayLike) -> Float:
    """The corner as an array, shape (2,); a QueryError if it or the edge of squares is wrong."""
    if not (np.isfinite(square) and square > 0):
        raise QueryError(f"expected squares with an edge > 0 m, got {square:g}")
    place = finite_array(corner, (2,))
    if place is None:
        raise QueryError(f"expected the arena's lower left corner as x, y [m], got {corner!r}")
    return place


def place_squares(
    level: SceneGrid2D,
    *,
    square: float = SQUARE,
    corner: ArrayLike | None = None,
    shape: Sequence[int] | None = None,
) -> Lattice:
    """Lay the squares of an arena over a level; they may reach beyond it.

    Args:
        square: edge of a square [m], > 0.
        corner: the arena's lower left corner, x and y, world frame [m]; the level's if None.
        shape: rows and columns, >= 1 each; as many as cover the rest of the level if None.

    Raises:
        QueryError: a number is wrong, or the arena lies outside the level.
    """
    x0, y0, x1, y1 = level.lattice.bounds
    left, bottom = check_squares(square, (x0, y0) if corner is None else corner).tolist()
    if shape is None:
        if not (left < x1 and bottom < y1):
            text = f"the corner ({left:g}, {bottom:g}) leaves nothing of the level"
            raise QueryError(f"{text}, which ends at ({x1:g}, {y1:g})")
        if max(x1 - left, y1 - bottom) > MOST * square:
            raise QueryError(f"expected larger squares: the level has over {MOST} of {square:g} m")
        shape = num_cells(y1 - bottom, square), num_cells(x1 - left, square)
    rows, cols = shape
    if rows < 1 or cols < 1:
        raise QueryError(f"expected rows and columns >= 1, got {rows} and {cols}")
    if rows * cols > MOST:
        got = f"{rows} × {cols} of {square:g} m: take larger squares, or a part of the level"
        raise QueryError(f"expected at most {MOST} squares, got {got}")
    squares = Lattice(left, bottom + rows * square, square, cols, rows)
    left, bottom, right, top = squares.bounds
    if left >= x1 or bottom >= y1 or right <= x0 or top <= y0:
        own = f"x {left:g} to {right:g}, y {bottom:g} to {top:g}"
        other = f"x {x0:g} to {x1:g}"
        text = f"the arena, {own} m, lies beside the level"
        raise QueryError(f"{text}: it spans {other}, y {y0:g} to {y1:g} m")
    return squares


def find_obstacles(level: SceneGrid2D, squares: Lattice) -> Bool:
    """Mark the squares that overlap an obstacle: (rows, cols), bool, row 0 at the top.

    Obstacles are occupied cells and the area outside the level. Touching is no overlap.
    """
    lattice = level.lattice
    filled = np.pad(level.occupancy != 0, 1, constant_values=True)  # outside the level, too
    # a summed-area table (Crow 1984): the sum over any rectangle from its four corners
    sums = np.pad(filled.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))

    def spans(first: float, count: int, limit: int) -> tuple[Int, Int]:
        """The first and last cells of each square along an axis, in the padded array."""
        edges = (first + np.arange(count + 1) * squares.cell_size) / lattice.cell_size
        start = np.floor(edges[:-1] + CELL_SLACK).astype(np.int64) + 1
        end = np.ceil(edges[1:] - CELL_SLACK).astype(np.int64) + 1
        start = np.clip(start, 0, limit + 1)
        return start, np.clip(np.maximum(end, start + 1), 1, limit + 2)

    row0, row1 = spans(lattice.y_max - squares.y_max, squares.height, lattice.height)
    col0, col1 = spans(squares.x_min - lattice.x_min, squares.width, lattice.width)
    row0 = row0[:, None]
    row1 = row1[:, None]
    inside: Int = sums[row1, col1] - sums[row0, col1] - sums[row1, col0] + sums[row0, col0]
    return inside > 0


class ExploredMap:
    """A map of squares that an agent fills from its sensors.

    The arena is surrounded by walls, which are no part of it. The latest observation of a square
    counts; within one call of `observe`, a square in which some ray ends is an obstacle, even if
    other rays pass through it.

    Attributes:
        lattice: of the squares in the world.
        explored: shape (rows, cols), bool, row 0 at the top.
        obstacles: the same; never true in unexplored squares.
    """

    def __init__(
        self,
        shape: Sequence[int] = ARENA,
        *,
        square: float = SQUARE,
        corner: Sequence[float] = (0.0, 0.0),
    ) -> None:
        """Make an unexplored map.

        Args:
            shape: rows and columns, >= 1 each.
            square: edge of a square [m], > 0.
            corner: the lower left corner, x and y, world frame [m].

        Raises:
            FormatError: the shape is invalid.
            QueryError: a number is wrong.
        """
        rows, cols = check_shape(shape)
        left, bottom = check_squares(square, corner).tolist()
        self.lattice = Lattice(left, bottom + rows * square, square, cols, rows)
        self.explored = np.zeros((rows, cols), dtype=np.bool_)
        self.obstacles = np.zeros((rows, cols), dtype=np.bool_)

    @classmethod
    def from_descriptor(
        cls, part1: str, part2: str, shape: Sequence[int] = ARENA, **squares: Any
    ) -> ExploredMap:
        """Make a map from a map descriptor, see `navbake.arena.map_descriptor.decode`."""
        own = cls(shape, **squares)
        own.explored, own.obstacles = decode(part1, part2, shape)
        return own

    def enter(self, x: float, y: float) -> None:
        """Mark the agent's square at a world position [m] as explored and free."""
        row, col = self._square_at(x, y)
        self.explored[row, col] = True
        self.obstacles[row, col] = False

    def observe(
        self, x: float, y: float, angles: ArrayLike, ranges: ArrayLike, max_range: float
    ) -> None:
        """Add the measurements of range sensors at one place.

        Each ray marks the squares that it passes as explored and free. A range below `max_range`
        ends in an obstacle: the square that contains the ray's end, or begins there. Squares
        behind it, and the area outside the arena, don't change.

        Args:
            x, y: the sensors' world position [m].
            angles: their directions, from the world's x towards its y, shape (n,) [rad].
            ranges: measured distances, shape (n,) [m], >= 0; infinite, or `max_range` and more,
                for no obstacle; NaN for no measurement.
            max_range: of the sensors [m], > 0.

        Raises:
            QueryError: the position is outside the arena, or a number is wrong.
        """
        self._square_at(x, y)
        ways = _check_rays(angles, max_range)
        lengths = _numbers(ranges, "ranges [m]")
        if ways.shape != lengths.shape:
            got = f"{len(ways)} and {len(lengths)}"
            raise QueryError(f"expected as many angles as ranges, got {got}")
        if (lengths < 0).any():
            raise QueryError(f"expected ranges >= 0 m, got {np.nanmin(lengths):g}")
        passed = np.zeros_like(self.explored)
        hit = np.zeros_like(self.explored)
        is_measured = ~np.isnan(lengths)
        for angle, length in zip(ways[is_measured], lengths[is_measured], strict=True):
            is_hit = length < max_range
            rows, cols, starts = self._trace(x, y, angle, min(length, max_range), is_hit)
            ends = is_hit & (starts >= length - HAIR)
            passed[rows[~ends], cols[~ends]] = True
            hit[rows[ends], cols[ends]] = True
        self.explored |= passed | hit
        self.obstacles[passed] = False
        self.obstacles[hit] = True

    def look(
        self, truth: ArrayLike, x: float, y: float, angles: ArrayLike, max_range: float
    ) -> Float:
        """Simulate the sensors at a place of a known arena, and add their measurements.

        Args:
            truth: the obstacles, shape (rows, cols), row 0 at the top.
            x, y, angles, max_range: see `observe`.

        Returns:
            The ranges, shape (n,), float64 [m]; infinite for no obstacle.

        Raises:
            QueryError: see `observe`; or the truth has another shape.
        """
        filled = np.asarray(truth) != 0
        if filled.shape != self.explored.shape:
            raise QueryError(f"expected `truth` of shape {self.explored.shape}, got {filled.shape}")
        self._square_at(x, y)
        ways = _check_rays(angles, max_range)
        ranges = np.full(len(ways), np.inf)
        for i, angle in enumerate(ways):
            rows, cols, starts = self._trace(x, y, angle, max_range, False)
            ranges[i] = min(starts[filled[rows, cols]], default=np.inf)
        self.observe(x, y, ways, ranges, max_range)
        return ranges

    def descriptor(self) -> tuple[str, str]:
        """Part 1 and part 2 of the map descriptor."""
        return encode(self.explored, self.obstacles)

    def __str__(self) -> str:
        """Draw the map, see `navbake.arena.map_descriptor.draw`."""
        return draw(self.explored, self.obstacles)

    def _square_at(self, x: float, y: float) -> tuple[int, int]:
        if np.isfinite([x, y]).all():
            row, col = map(int, self.lattice.rows_cols([x, y]))
            if self.lattice.holds(row, col):
                return row, col
        x0, y0, x1, y1 = self.lattice.bounds
        arena = f"the arena, x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
        raise QueryError(f"expected a position within {arena}, got ({x:g}, {y:g})")

    def _trace(
        self, x: float, y: float, angle: float, length: float, beyond: bool
    ) -> tuple[Int, Int, Float]:
        """The rows and columns of squares along a ray, nearest first, and their distances [m].

        With `beyond`, the square that contains or follows the ray's end has the ray's length or
        more, once.
        """
        size = self.lattice.cell_size
        counts = (self.lattice.width, self.lattice.height)
        # in squares from here on, columns and rows; rows run against y
        start = np.array([x - self.lattice.x_min, self.lattice.y_max - y]) / size
        way = np.array([np.cos(angle), -np.sin(angle)])
        far = (length + (2 * HAIR if beyond else 0.0)) / size
        stops = [np.array([0.0, far])]
        for place, speed, count in zip(start, way, counts, strict=True):
            if abs(speed) > 1e-12:
                # the arena's own grid lines only: a ray that leaves it never returns
                ends = np.sort([place, place + speed * far]).clip(-1.0, count + 1.0)
                lines = np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1)
                stops.append((lines - place) / speed)
        # a piece between two crossings lies in its middle's square
        t = np.unique(np.concatenate(stops).clip(0.0, far))
        t = t[np.append(True, np.diff(t) > HAIR / size / 2)]
        starts = t[:-1] * size
        middles = (t[:-1] + t[1:]) / 2
        places = (start[:, None] + way[:, None] * middles).clip(-1.0, 2.0**31)
        cols, rows = np.floor(places).astype(np.int64)
        if beyond and len(starts):
            last = (rows == rows[-1]) & (cols == cols[-1])
            starts = np.where(last, np.maximum(starts, length), starts)
        inside = self.lattice.holds(rows, cols)
        return rows[inside], cols[inside], starts[inside]


def _check_rays(angles: ArrayLike, max_range: float) -> Float:
    ways = _numbers(angles, "angles [rad]")
    if not np.isfinite(ways).all():
        raise QueryError("expected finite angles [rad], got others")
    if not (np.isfinite(max_range) and max_range > 0):
        raise QueryError(f"expected a finite `max_range` > 0 m, got {max_range:g}")
    return ways


def _numbers(values: ArrayLike, what: str) -> Float:
    try:
        numbers = np.atleast_1d(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError):
        numbers = np.empty((0, 0))
    if numbers.ndim != 1:
        raise QueryError(f"expected {what} of shape (n,), got {values!r}"[:200])
    return numbers
