"""Arenas of squares: their obstacles, maps that an agent explores, and map descriptors.

A map descriptor holds the explored squares of an arena and their obstacles as two hex strings.
Part 1 begins with the two bits 11, has a bit for each square (1 for explored), and ends with 11.
Part 2 has a bit for each explored square, 1 for an obstacle, and 0s up to a full byte. Squares
go row by row from the bottom, each row from the left. Part 1 of an arena of 15 × 20 squares is
exactly 38 bytes; for other sizes, 0s follow the closing 11, up to a full byte.

Arrays are ``[row, col]`` with row 0 at the top, as in all of navbake.
"""

from __future__ import annotations

from collections.abc import Sequence
from string import hexdigits
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import FormatError, QueryError
from navbake.lengths import format_bounds, format_position
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.lattice import CELL_SLACK, Lattice, count_cells
from navbake.types import Bool, Float, Int
from navbake.voxels.grid import to_finite_array

ARENA_SHAPE = (20, 15)  # rows and columns of the format's arena
SQUARE_EDGE = 0.1  # edge of its squares [m]
PADDING_BITS = np.array([1, 1], dtype=np.uint8)  # before and after the bits of part 1
MAX_SQUARES = 10**8  # of a map
END_SLACK = 1e-6  # a ray that ends this near to a square's side ends in the square behind it [m]
# a ray is parallel to an axis if the other component of its unit vector is at most this
PARALLEL_TOLERANCE = 1e-12

UNEXPLORED = "?"
FREE = "."
OBSTACLE = "#"


def encode(explored: ArrayLike, obstacles: ArrayLike) -> tuple[str, str]:
    """Encode a map as a map descriptor: two hex strings, in the format of this module's docstring.

    Args:
        explored: Shape (rows, cols), row 0 at the top, true for explored squares.
        obstacles: Of the same shape, true for squares with an obstacle; ignored where unexplored.

    Returns:
        Part 1, the explored squares; and part 2, the obstacles in them, empty if nothing is
        explored. Hex digits are capitals.

    Raises:
        FormatError: The arrays have different shapes, or no squares.
    """
    is_explored = _as_flags(explored, "explored")
    is_obstacle = _as_flags(obstacles, "obstacles")
    if is_explored.shape != is_obstacle.shape:
        expected = "explored and obstacles of one shape (rows, cols)"
        raise FormatError(
            f"expected {expected}, got {is_explored.shape} and {is_obstacle.shape}",
            key="obstacles",
            value=is_obstacle.shape,
            expected=expected,
        )
    # the format goes from the bottom row up, arrays from the top row down
    explored_bits = is_explored[::-1].ravel()
    obstacle_bits = is_obstacle[::-1].ravel()
    part1 = _to_hex(np.concatenate([PADDING_BITS, explored_bits, PADDING_BITS]))
    part2 = _to_hex(obstacle_bits[explored_bits])
    return part1, part2


def _to_hex(bits: NDArray[Any]) -> str:
    """Return bits as hexadecimal digits in capitals, with 0s up to a full byte."""
    return np.packbits(bits.astype(np.uint8)).tobytes().hex().upper()


def decode(part1: str, part2: str, shape: Sequence[int] = ARENA_SHAPE) -> tuple[Bool, Bool]:
    """Decode a map from its two hex strings; the inverse of `encode`.

    Lower-case letters are accepted. Part 2 may be padded with 0s to a whole hex digit only, instead
    of a whole byte.

    Args:
        part1: The hex string that says which squares are explored.
        part2: The hex string that says which explored squares have an obstacle.
        shape: Rows and columns of the arena, >= 1 each.

    Returns:
        Two masks, shape (rows, cols), bool, row 0 at the top: the explored squares, and the squares
        with an obstacle. Unexplored squares have no obstacle.

    Raises:
        FormatError: A string is not hexadecimal, too short or too long, or its padding is wrong.
    """
    num_rows, num_cols = check_shape(shape)
    bits, num_digits = _from_hex(part1, "part 1")
    num_bits = num_rows * num_cols + 4
    expected_digits = 2 * -(-num_bits // 8)
    if num_digits != expected_digits:
        raise _make_part_error(
            "part 1",
            part1,
            expected=f"{expected_digits} digits in part 1 for {num_rows} × {num_cols} squares",
            actual=f"{num_digits}",
        )
    for name, bit_pair in (("first", bits[:2]), ("last", bits[num_bits - 2 : num_bits])):
        if not bit_pair.all():
            raise _make_part_error(
                "part 1",
                part1,
                expected=f"the {name} two bits of part 1 to be 11",
                actual=f"{bit_pair[0]}{bit_pair[1]}",
            )
    if bits[num_bits:].any():
        raise _make_part_error(
            "part 1", part1, expected="0s after the closing 11 of part 1", actual="others"
        )
    is_explored = bits[2 : num_bits - 2].astype(np.bool_)
    num_explored = int(is_explored.sum())
    obstacle_bits, num_digits = _from_hex(part2, "part 2")
    min_digits = -(-num_explored // 4)
    full_digits = 2 * -(-num_explored // 8)  # up to a full byte
    if num_digits not in (min_digits, full_digits):
        digits = f"{full_digits}"
        if min_digits != full_digits:
            digits += f" (or {min_digits})"
        squares = f"the {num_explored} squares that part 1 has explored"
        comparison = "more" if num_digits > full_digits else "fewer"
        raise _make_part_error(
            "part 2",
            part2,
            expected=f"{digits} digits in part 2 for {squares}",
            actual=f"{num_digits}: {comparison} than it has",
        )
    if obstacle_bits[num_explored:].any():
        raise _make_part_error(
            "part 2",
            part2,
            expected=f"0s after the {num_explored} bits of part 2",
            actual="more: it is longer than the squares that part 1 has explored",
        )
    is_obstacle = np.zeros(num_rows * num_cols, dtype=np.bool_)
    is_obstacle[is_explored] = obstacle_bits[:num_explored]
    # the format goes from the bottom row up, arrays from the top row down
    return (
        is_explored.reshape(num_rows, num_cols)[::-1].copy(),
        is_obstacle.reshape(num_rows, num_cols)[::-1].copy(),
    )


def _make_part_error(key: str, value: object, *, expected: str, actual: str) -> FormatError:
    """Return an error for a wrong part of a descriptor, or a wrong array of a map."""
    message = f"expected {expected}, got {actual}"
    return FormatError(message, key=key, value=value, expected=expected)


def draw(explored: ArrayLike, obstacles: ArrayLike) -> str:
    """Draw a map as text: ``?`` for unexplored, ``.`` for free, ``#`` for obstacles.

    Args:
        explored: Shape (rows, cols), row 0 at the top, true for explored squares.
        obstacles: Of the same shape, true for squares with an obstacle; ignored where unexplored.

    Returns:
        A line for each row, the top row first.
    """
    is_explored = _as_flags(explored, "explored")
    is_obstacle = _as_flags(obstacles, "obstacles")
    square_marks = np.where(is_explored, np.where(is_obstacle, OBSTACLE, FREE), UNEXPLORED)
    return "\n".join("".join(row) for row in square_marks)


def _as_flags(array: ArrayLike, name: str) -> Bool:
    """Check an array of a map, and convert it to bool; `name` is its name in messages."""
    try:
        flags = np.asarray(array)
    except ValueError:  # rows of several lengths
        flags = np.empty(0)
    if flags.dtype.kind not in "biuf":
        raise _make_part_error(
            name, array, expected=f"{name} of true and false", actual=f"dtype {flags.dtype}"
        )
    if flags.ndim != 2 or 0 in flags.shape:
        raise _make_part_error(
            name, array, expected=f"{name} of shape (rows, cols)", actual=f"{flags.shape}"
        )
    return np.asarray(flags != 0)


def check_shape(shape: Sequence[int]) -> tuple[int, int]:
    """Check the numbers of rows and columns of a map, and return them.

    Raises:
        FormatError: The shape is not two whole numbers >= 1, or has more than 100,000,000 squares.
    """
    shape_sizes = list(shape) if np.iterable(shape) else [shape]
    if len(shape_sizes) != 2 or not all(
        isinstance(size, int | np.integer) and size >= 1 for size in shape_sizes
    ):
        raise _make_part_error(
            "shape", shape, expected="a shape (rows, cols), each >= 1", actual=f"{shape_sizes}"
        )
    num_rows = int(shape_sizes[0])
    num_cols = int(shape_sizes[1])
    if num_rows * num_cols > MAX_SQUARES:
        raise _make_part_error(
            "shape",
            shape,
            expected=f"at most {MAX_SQUARES} squares",
            actual=f"{num_rows} × {num_cols}",
        )
    return num_rows, num_cols


def _from_hex(text: str, name: str) -> tuple[NDArray[np.uint8], int]:
    """Return the bits of hex digits, with 0s up to a full byte, and the number of digits."""
    if not isinstance(text, str):
        raise _make_part_error(
            name,
            text,
            expected=f"{name} as a string of hexadecimal digits",
            actual=f"{text!r}",
        )
    digits = text.strip()
    unexpected_text = digits.strip(hexdigits)
    if unexpected_text:
        raise _make_part_error(
            name, text, expected=f"hexadecimal digits in {name}", actual=f"{unexpected_text[0]!r}"
        )
    hex_bytes = bytes.fromhex(digits + "0" * (len(digits) % 2))
    return np.unpackbits(np.frombuffer(hex_bytes, dtype=np.uint8)), len(digits)


def _make_argument_error(key: str, value: object, *, expected: str, actual: str) -> QueryError:
    """Return an error for a wrong argument."""
    message = f"expected {expected}, got {actual}"
    return QueryError(message, key=key, value=value, expected=expected)


def check_squares(square: float, corner: ArrayLike) -> Float:
    """Check the edge of an arena's squares, and the arena's lower left corner.

    Args:
        square: Edge of a square [m], > 0.
        corner: World x, y of the corner [m].

    Returns:
        The corner, shape (2,), float64.

    Raises:
        QueryError: The edge or the corner is not valid.
    """
    if not (np.isfinite(square) and square > 0):
        raise _make_argument_error(
            "square", square, expected="squares with an edge > 0 m", actual=f"{square:g}"
        )
    position = to_finite_array(corner, (2,))
    if position is None:
        raise _make_argument_error(
            "corner",
            corner,
            expected="the arena's lower left corner as x, y [m]",
            actual=f"{corner!r}",
        )
    return position


def place_squares(
    level: SceneGrid2D,
    *,
    square: float = SQUARE_EDGE,
    corner: ArrayLike | None = None,
    shape: Sequence[int] | None = None,
) -> Lattice:
    """Place the squares of an arena over a level; they may extend beyond the level.

    Args:
        level: The level.
        square: Edge of a square [m], > 0.
        corner: World x, y of the arena's lower left corner [m]; None for the level's corner.
        shape: Rows and columns, >= 1 each; None for as many as are needed to cover the level from
            the corner.

    Returns:
        The squares as the cells of a lattice.

    Raises:
        QueryError: A number is wrong, or the arena lies outside the level.
    """
    level_bounds = level.lattice.bounds
    x_low, y_low, x_high, y_high = level_bounds
    left_x, bottom_y = check_squares(square, (x_low, y_low) if corner is None else corner).tolist()
    if shape is None:
        if not (left_x < x_high and bottom_y < y_high):
            raise QueryError(
                f"the corner ({format_position((left_x, bottom_y))}) leaves nothing of the level, "
                f"which ends at ({format_position((x_high, y_high))})",
                key="corner",
                value=(left_x, bottom_y),
            )
        if max(x_high - left_x, y_high - bottom_y) > MAX_SQUARES * square:
            raise QueryError(
                f"expected larger squares: the level has over {MAX_SQUARES} of {square:g} m",
                key="square",
                value=square,
                expected="larger squares",
            )
        shape = (count_cells(y_high - bottom_y, square), count_cells(x_high - left_x, square))
    num_rows, num_cols = shape
    if num_rows < 1 or num_cols < 1:
        raise _make_argument_error(
            "shape", shape, expected="rows and columns >= 1", actual=f"{num_rows} and {num_cols}"
        )
    if num_rows * num_cols > MAX_SQUARES:
        hint = "take larger squares, or a part of the level"
        raise _make_argument_error(
            "shape",
            shape,
            expected=f"at most {MAX_SQUARES} squares",
            actual=f"{num_rows} × {num_cols} of {square:g} m: {hint}",
        )
    squares = Lattice(left_x, bottom_y + num_rows * square, square, num_cols, num_rows)
    left_x, bottom_y, right_x, top_y = squares.bounds
    if left_x >= x_high or bottom_y >= y_high or right_x <= x_low or top_y <= y_low:
        raise QueryError(
            f"the arena, {format_bounds(squares.bounds)} m, lies beside the level: it spans "
            f"{format_bounds(level_bounds)} m",
            key="corner",
            value=(left_x, bottom_y),
        )
    return squares


def find_obstacles(level: SceneGrid2D, squares: Lattice) -> Bool:
    """Mark the squares of an arena that overlap an obstacle of a level.

    Obstacles are occupied cells and the area outside the level. A square that only touches an
    obstacle doesn't overlap it.

    Args:
        level: The level.
        squares: The squares, as `place_squares` returns them.

    Returns:
        True for squares that overlap an obstacle, shape (rows, cols), bool, row 0 at the top.
    """
    lattice = level.lattice
    is_occupied = np.pad(level.occupancy != 0, 1, constant_values=True)  # one cell around the level
    # a summed-area table (Crow 1984): the sum over any rectangle from its four corners
    summed_occupied = np.pad(
        is_occupied.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0))
    )

    def find_cell_ranges(
        first_edge_distance: float, num_squares: int, num_level_cells: int
    ) -> tuple[Int, Int]:
        """Return the range of rows, or of columns, that each row or column of squares overlaps.

        Args:
            first_edge_distance: the distance from the level's upper or left edge to that of the
                squares [m].
            num_squares: the number of rows or columns of squares.
            num_level_cells: the number of rows or columns of the level.

        Returns:
            The first index of each range and its end, exclusive: indices into `is_occupied`, which
            has one more cell around the level. Shape (num_squares,) each.
        """
        edge_positions = (
            first_edge_distance + np.arange(num_squares + 1) * squares.cell_size
        ) / lattice.cell_size
        start_index = np.floor(edge_positions[:-1] + CELL_SLACK).astype(np.int64) + 1
        end_index = np.ceil(edge_positions[1:] - CELL_SLACK).astype(np.int64) + 1
        start_index = np.clip(start_index, 0, num_level_cells + 1)
        return start_index, np.clip(np.maximum(end_index, start_index + 1), 1, num_level_cells + 2)

    start_rows, end_rows = find_cell_ranges(
        lattice.y_max - squares.y_max, squares.height, lattice.height
    )
    start_cols, end_cols = find_cell_ranges(
        squares.x_min - lattice.x_min, squares.width, lattice.width
    )
    start_rows = start_rows[:, None]
    end_rows = end_rows[:, None]
    num_occupied: Int = summed_occupied[end_rows, end_cols] - summed_occupied[start_rows, end_cols]
    num_occupied = (
        num_occupied
        - summed_occupied[end_rows, start_cols]
        + summed_occupied[start_rows, start_cols]
    )
    return num_occupied > 0


class ExploredMap:
    """A map of squares that an agent fills from its sensors.

    The arena is surrounded by walls, which are no part of it. If a square is observed several
    times, the latest observation counts. Within one call of `observe`, a square in which a ray ends
    is an obstacle, even if other rays pass through it.

    Attributes:
        lattice: The squares in the world.
        explored: Shape (rows, cols), bool, row 0 at the top.
        obstacles: Shape (rows, cols), bool; never true in unexplored squares.

    Example:
        >>> explored = navbake.ExploredMap((20, 15), square=0.1)
        >>> explored.observe(0.75, 1.0, angles=[0.0, 1.57], ranges=[0.4, float("inf")], max_range=2)
        >>> part1, part2 = explored.descriptor()
    """

    def __init__(
        self,
        shape: Sequence[int] = ARENA_SHAPE,
        *,
        square: float = SQUARE_EDGE,
        corner: Sequence[float] = (0.0, 0.0),
    ) -> None:
        """Make an unexplored map.

        Args:
            shape: Rows and columns, >= 1 each.
            square: Edge of a square [m], > 0.
            corner: World x, y of the lower left corner [m].

        Raises:
            FormatError: The shape is not valid.
            QueryError: A number is wrong.
        """
        num_rows, num_cols = check_shape(shape)
        x_min, y_min = check_squares(square, corner).tolist()
        self.lattice = Lattice(x_min, y_min + num_rows * square, square, num_cols, num_rows)
        self.explored = np.zeros((num_rows, num_cols), dtype=np.bool_)
        self.obstacles = np.zeros((num_rows, num_cols), dtype=np.bool_)

    @classmethod
    def from_descriptor(
        cls,
        part1: str,
        part2: str,
        shape: Sequence[int] = ARENA_SHAPE,
        *,
        square: float = SQUARE_EDGE,
        corner: Sequence[float] = (0.0, 0.0),
    ) -> ExploredMap:
        """Make a map from a map descriptor, the two hex strings that `descriptor` returns.

        Args:
            part1: The hex string that says which squares are explored.
            part2: The hex string that says which explored squares are obstacles.
            shape: Rows and columns, >= 1 each.
            square: Edge of a square [m], > 0.
            corner: World x, y of the arena's lower left corner [m].

        Raises:
            FormatError: The descriptor is broken, or the shape is not valid.
            QueryError: A number is wrong.
        """
        explored_map = cls(shape, square=square, corner=corner)
        explored_map.explored, explored_map.obstacles = decode(part1, part2, shape)
        return explored_map

    def enter(self, x: float, y: float) -> None:
        """Mark the square that the agent is in as explored and free.

        Args:
            x: World x of the agent [m].
            y: World y of the agent [m].

        Raises:
            QueryError: The position is outside the arena.
        """
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
            x: World x of the sensors [m].
            y: World y of the sensors [m].
            angles: Directions of the sensors, from the world's x towards its y, shape (n,) [rad].
            ranges: Measured distances, shape (n,) [m], >= 0; infinite, or `max_range` and more,
                for no obstacle; NaN for no measurement.
            max_range: Range of the sensors [m], > 0.

        Raises:
            QueryError: The position is outside the arena, or a number is wrong.
        """
        self._square_at(x, y)
        ray_angles = _check_rays(angles, max_range)
        ray_lengths = _as_numbers(ranges, "ranges [m]")
        if ray_angles.shape != ray_lengths.shape:
            raise _make_argument_error(
                "ranges",
                ranges,
                expected="as many angles as ranges",
                actual=f"{len(ray_angles)} and {len(ray_lengths)}",
            )
        if (ray_lengths < 0).any():
            raise _make_argument_error(
                "ranges", ranges, expected="ranges >= 0 m", actual=f"{np.nanmin(ray_lengths):g}"
            )
        is_passed = np.zeros_like(self.explored)
        is_hit = np.zeros_like(self.explored)
        is_measured = ~np.isnan(ray_lengths)
        for angle, ray_length in zip(
            ray_angles[is_measured], ray_lengths[is_measured], strict=True
        ):
            ends_at_obstacle = ray_length < max_range
            rows, cols, distances = self._trace(
                x, y, angle, min(ray_length, max_range), ends_at_obstacle
            )
            is_ray_end = ends_at_obstacle & (distances >= ray_length - END_SLACK)
            is_passed[rows[~is_ray_end], cols[~is_ray_end]] = True
            is_hit[rows[is_ray_end], cols[is_ray_end]] = True
        self.explored |= is_passed | is_hit
        self.obstacles[is_passed] = False
        self.obstacles[is_hit] = True

    def look(
        self, truth: ArrayLike, x: float, y: float, angles: ArrayLike, max_range: float
    ) -> Float:
        """Simulate the sensors at a place of a known arena, and add their measurements.

        Args:
            truth: Which squares are obstacles, shape (rows, cols), row 0 at the top.
            x: World x of the sensors [m].
            y: World y of the sensors [m].
            angles: Directions of the sensors, from the world's x towards its y, shape (n,) [rad].
            max_range: Range of the sensors [m], > 0.

        Returns:
            The ranges, shape (n,), float64 [m]; infinite for no obstacle.

        Raises:
            QueryError: The position is outside the arena, a number is wrong, or the truth has
                another shape than the map.
        """
        is_obstacle = np.asarray(truth) != 0
        if is_obstacle.shape != self.explored.shape:
            raise _make_argument_error(
                "truth",
                is_obstacle.shape,
                expected=f"`truth` of shape {self.explored.shape}",
                actual=f"{is_obstacle.shape}",
            )
        self._square_at(x, y)
        ray_angles = _check_rays(angles, max_range)
        ranges = np.full(len(ray_angles), np.inf)
        for i, angle in enumerate(ray_angles):
            rows, cols, distances = self._trace(x, y, angle, max_range, False)
            ranges[i] = min(distances[is_obstacle[rows, cols]], default=np.inf)
        self.observe(x, y, ray_angles, ranges, max_range)
        return ranges

    def descriptor(self) -> tuple[str, str]:
        """Return the map as a map descriptor: two hex strings, see `encode`."""
        return encode(self.explored, self.obstacles)

    def __str__(self) -> str:
        """Draw the map, see `navbake.arena.map_descriptor.draw`."""
        return draw(self.explored, self.obstacles)

    def _square_at(self, x: float, y: float) -> tuple[int, int]:
        """Return row and column of a world position [m]; raise a QueryError outside the arena."""
        if np.isfinite([x, y]).all():
            row, col = map(int, self.lattice.rows_cols([x, y]))
            if self.lattice.holds(row, col):
                return row, col
        raise _make_argument_error(
            "position",
            (x, y),
            expected=f"a position within the arena, {format_bounds(self.lattice.bounds)}",
            actual=f"({format_position((x, y))})",
        )

    def _trace(
        self, x: float, y: float, angle: float, ray_length: float, includes_end: bool
    ) -> tuple[Int, Int, Float]:
        """Trace a ray through the squares.

        Args:
            x: World x of the ray's start [m].
            y: World y of the ray's start [m].
            angle: Direction of the ray [rad].
            ray_length: Length of the ray [m].
            includes_end: Whether the last square must be the one that contains the ray's end, or
                begins there; its distance is then the ray's length or more.

        Returns:
            Rows and columns of the squares, nearest first, and the distances where the ray enters
            them [m].
        """
        square_size = self.lattice.cell_size
        num_squares = (self.lattice.width, self.lattice.height)
        # in squares from here on, along columns and rows; rows run against y
        start_position = np.array([x - self.lattice.x_min, self.lattice.y_max - y]) / square_size
        direction = np.array([np.cos(angle), -np.sin(angle)])
        length_in_squares = (ray_length + (2 * END_SLACK if includes_end else 0.0)) / square_size
        # distances along the ray at which it crosses the sides of squares
        crossing_lists = [np.array([0.0, length_in_squares])]
        for coordinate, component, num_squares_along in zip(
            start_position, direction, num_squares, strict=True
        ):
            if abs(component) > PARALLEL_TOLERANCE:
                # sides in the arena only: a ray that leaves it never returns
                low_side, high_side = np.sort(
                    [coordinate, coordinate + component * length_in_squares]
                ).clip(-1.0, num_squares_along + 1.0)
                side_coordinates = np.arange(np.ceil(low_side), np.floor(high_side) + 1)
                crossing_lists.append((side_coordinates - coordinate) / component)
        crossing_distances = np.unique(np.concatenate(crossing_lists).clip(0.0, length_in_squares))
        crossing_distances = crossing_distances[
            np.append(True, np.diff(crossing_distances) > END_SLACK / square_size / 2)
        ]
        distances = crossing_distances[:-1] * square_size
        # a piece between two crossings lies in the square of its middle
        middle_distances = (crossing_distances[:-1] + crossing_distances[1:]) / 2
        middle_positions = (start_position[:, None] + direction[:, None] * middle_distances).clip(
            -1.0, 2.0**31
        )
        cols, rows = np.floor(middle_positions).astype(np.int64)
        if includes_end and len(distances):
            is_last = (rows == rows[-1]) & (cols == cols[-1])
            distances = np.where(is_last, np.maximum(distances, ray_length), distances)
        is_inside = self.lattice.holds(rows, cols)
        return rows[is_inside], cols[is_inside], distances[is_inside]


def _check_rays(angles: ArrayLike, max_range: float) -> Float:
    """Check the angles [rad] and the range [m] of sensors; return the angles, shape (n,)."""
    ray_angles = _as_numbers(angles, "angles [rad]")
    if not np.isfinite(ray_angles).all():
        raise _make_argument_error(
            "angles", angles, expected="finite angles [rad]", actual="others"
        )
    if not (np.isfinite(max_range) and max_range > 0):
        raise _make_argument_error(
            "max_range", max_range, expected="a finite `max_range` > 0 m", actual=f"{max_range:g}"
        )
    return ray_angles


def _as_numbers(array: ArrayLike, name: str) -> Float:
    """Return numbers as an array, shape (n,), float64; a QueryError calls them by `name`."""
    try:
        numbers = np.atleast_1d(np.asarray(array, dtype=np.float64))
    except (TypeError, ValueError):
        numbers = np.empty((0, 0))
    if numbers.ndim != 1:
        expected = f"{name} of shape (n,)"
        raise QueryError(
            f"expected {expected}, got {array!r}"[:200],
            key=name.partition(" ")[0],
            value=array,
            expected=expected,
        )
    return numbers
