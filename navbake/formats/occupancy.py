"""Levels as the values of ROS's ``nav_msgs/OccupancyGrid``: -1 unknown, 0 free to 100 occupied.

Arrays have row 0 at the top (largest y), as everywhere in navbake; a message has it at the bottom.
Values from 1 to 98 are costs from 1 to 252, as ``nav2_costmap_2d`` publishes costmaps, and 99 is a
cell that the robot's centre can't be on.

Source: nav2's ``costmap_2d_publisher.cpp`` for the values of costs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError, QueryError
from navbake.formats.allowance import MAX_PIXELS
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.runtime.inflation import NAV2_SCALING, nav2_costs
from navbake.types import Bool, Float, Json

ndimage = lazy("scipy.ndimage")

UNKNOWN = -1
FREE = 0
INSCRIBED = 99
OCCUPIED = 100
# of a cell that isn't blocked
LEAST_COST = 1
MOST_COST = 252
LETHAL = 253  # least cost of a blocked cell
QUARTER = math.pi / 2
SLACK = 0.1  # [cells] by which the farthest corner of a map may be off one turned by quarters
LEAST_COVER = 0.01  # share of a cell that occupied ones have to cover to make it occupied
PIECE = 1 << 18  # cells compared at once, to limit memory

Values = NDArray[np.int8]


def compute_occupancy_values(grid: NavGrid, number: int) -> Values:
    """The values of a level's cells, shape (height, width), int8.

    Unknown where a grid with floors has none; free at finite weights, with a cost for weights above
    1; occupied at obstacles; and 99 in cells that only an inflation or a block closed.
    """
    level = grid.levels[number]
    with np.errstate(invalid="ignore"):
        costs = np.where(level.weights > 1, np.clip(level.weights, LEAST_COST, MOST_COST), 0)
    values = _publish(costs.astype(np.uint8))
    values[~level.free] = INSCRIBED
    values[~level.free & (level.occupancy != 0)] = OCCUPIED
    if "floorHeight" in level.attributes:
        values[~level.free & np.isnan(level.floor_height)] = UNKNOWN
    return values


def compute_costmap_values(
    grid: NavGrid, number: int, radius: float, inflation: float, scaling: float = NAV2_SCALING
) -> Values:
    """The values of a level's costmap: its obstacles inflated by nav2's formula.

    Cells blocked for a robot of this inscribed radius [m] for other reasons (a drop, another
    level's obstacle) cost as much as those within the radius of an obstacle. `inflation` is nav2's
    ``inflation_radius`` [m], at least the radius; `scaling` its ``cost_scaling_factor``.
    """
    if not inflation >= radius:
        raise QueryError(
            f"expected an inflation of at least the radius {radius:g} m, got {inflation:g}"
        )
    inflated = grid.inflate(radius, inflation - radius, costs="nav2", scaling=scaling)
    values = compute_occupancy_values(inflated, number)
    costs = nav2_costs(grid.levels[number], radius, inflation, scaling)
    is_free = (values >= FREE) & (values < INSCRIBED)
    values[is_free] = np.maximum(values, _publish(costs))[is_free]
    return values


def _publish(costs: NDArray[np.uint8]) -> Values:
    """nav2's published values of costs from 0 to 252."""
    table = 1 + 97 * (np.arange(256) - 1) // 251
    table[0] = FREE
    table[LETHAL:] = INSCRIBED
    return table.astype(np.int8)[costs]


def level_from_values(
    values: Values, lattice: Lattice, ground: float, metadata: Json
) -> SceneGrid2D:
    """Make a level of values on the cells of a lattice; `ground` is the floor's world z [m].

    100 is occupied, 99 blocked, -1 has no floor, and 1 to 98 become the least cost that is
    published as that value. All other cells have a flat floor, occupied ones too.
    """
    costs: Float = 1 + np.ceil(251 * (np.arange(OCCUPIED + 1) - 1) / 97)
    costs[0] = 1
    blocked = (values < FREE) | (values >= INSCRIBED)
    return SceneGrid2D(
        width=lattice.width,
        height=lattice.height,
        cell_size=lattice.cell_size,
        min_yup=(lattice.x_min, ground, 0.0 - lattice.y_max),
        weights=np.where(blocked, np.inf, costs[np.clip(values, 0, OCCUPIED)]),
        attributes={
            "floorHeight": np.where(values == UNKNOWN, np.float32(np.nan), np.float32(ground)),
            "occupancy": ((values == OCCUPIED) | (values == UNKNOWN)).astype(np.uint8),
        },
        metadata=metadata,
    )


def level_from_rooms(
    free: Bool,
    rooms: NDArray[np.uint16],
    names: Mapping[int, str],
    lattice: Lattice,
    ground: float,
    scene_id: str,
) -> SceneGrid2D:
    """Make a flat level of a map that has free cells and rooms.

    `free` is where an agent can stand, shape (height, width); `rooms` has numbers from 1, 0 for
    none, of the same shape; `names` are the rooms' by number; `ground` is the floor's world z [m].
    """
    values = np.where(free, np.int8(FREE), np.int8(OCCUPIED))
    level = level_from_values(values, lattice, ground, {"sceneId": scene_id})
    level.attributes["roomIndex"] = rooms
    table = [{**room.to_json(), "name": names.get(room.index)} for room in level.measure_rooms()]
    level.metadata["navbake"] = {"rooms": table}
    return level


def align_with_axes(
    values: Values, origin: tuple[float, float, float], resolution: float
) -> tuple[Values, Lattice]:
    """Resample a map with any yaw onto cells along the world's axes.

    A yaw of whole quarter turns, to a tenth of a cell over the map's diagonal, only permutes the
    cells. Otherwise a new cell has the value of the map at its centre, or -1 outside of the map;
    but it is occupied if occupied cells of the map cover at least 1 % of it. `origin` is the outer
    corner of the map's lower left cell, world x, y [m], and its yaw, counter-clockwise [rad]. Also
    returns the lattice of the new cells.
    """
    x, y, yaw = origin
    height, width = values.shape
    quarters = round(yaw / QUARTER)
    if abs(yaw - quarters * QUARTER) * math.hypot(width, height) <= SLACK:
        left, below = ((0, 0), (height, 0), (width, height), (0, width))[quarters % 4]
        turned = np.ascontiguousarray(np.rot90(values, quarters % 4))
        return turned, lattice_from_corner(
            turned, x - left * resolution, y - below * resolution, resolution
        )
    # in cells, from the map's own corner
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    xs = 0, width * cos, width * cos - height * sin, -height * sin
    ys = 0, width * sin, width * sin + height * cos, height * cos
    lattice = Lattice.cover((min(xs), min(ys), max(xs), max(ys)), 1.0)
    if lattice.width * lattice.height > MAX_PIXELS:
        raise FormatError(f"the turned map has {lattice.width} × {lattice.height} cells, too many")
    # the centre of cell [row, col] in the map, from the centre of its cell [0, 0]
    first_x = lattice.x_min + 0.5
    first_y = lattice.y_max - 0.5
    matrix = [[cos, sin], [-sin, cos]]
    start = height - 0.5 + sin * first_x - cos * first_y, cos * first_x + sin * first_y - 0.5
    turned = ndimage.affine_transform(
        values, matrix, start, lattice.shape, order=0, mode="grid-constant", cval=UNKNOWN
    )
    covered = np.zeros(lattice.shape)  # share of each cell, where it isn't occupied already
    full_rows, full_cols = np.nonzero(values == OCCUPIED)
    for begin in range(0, len(full_rows), PIECE):
        part = slice(begin, begin + PIECE)
        right = full_cols[part] + 0.5
        up = height - full_rows[part] - 0.5
        centers = np.stack([cos * right - sin * up, sin * right + cos * up], axis=-1)
        _add_cover(covered, turned, lattice, centers, cos, sin)
    turned[covered >= LEAST_COVER] = OCCUPIED
    x = x + lattice.x_min * resolution
    y = y + lattice.bounds[1] * resolution
    return turned, lattice_from_corner(turned, x, y, resolution)


def lattice_from_corner(values: Values, x: float, y: float, cell_size: float) -> Lattice:
    """The lattice of a map's cells from its lower left corner [m]."""
    height, width = values.shape
    return Lattice(x, y + height * cell_size, cell_size, width, height)


def _add_cover(
    covered: Float, turned: Values, lattice: Lattice, centers: Float, cos: float, sin: float
) -> None:
    """Add how much of the cells that aren't occupied the turned unit squares round centres cover.

    By separating axes, two squares overlap where their centres are nearer than half of their
    extents together along each side's direction. The area is half the sum of the cross products of
    the ends of all sides' parts in the other square (Green's theorem).
    """
    reach = (1.0 + abs(cos) + abs(sin)) / 2  # half extents along any of the four directions
    row, col = lattice.rows_cols(centers)
    for down, right in np.ndindex(3, 3):
        rows = row + down - 1
        cols = col + right - 1
        dx = lattice.x_min + cols + 0.5 - centers[:, 0]
        dy = lattice.y_max - rows - 0.5 - centers[:, 1]
        u = cos * dx + sin * dy
        v = cos * dy - sin * dx
        meets = np.max(np.abs([dx, dy, u, v]), axis=0) < reach
        meets &= (rows >= 0) & (rows < lattice.height) & (cols >= 0) & (cols < lattice.width)
        meets[meets] = turned[rows[meets], cols[meets]] != OCCUPIED
        own = np.stack([dx, dy], axis=-1)[meets]  # of the cell, from the square
        seen = np.stack([u, v], axis=-1)[meets]  # the same along the square's sides
        # both about the square's centre: the cell's sides in its frame, its own in the cell's
        area = _sides_inside(seen, cos, -sin, True) + _sides_inside(-own, cos, sin, False)
        np.add.at(covered, (rows[meets], cols[meets]), area)


def _sides_inside(centers: Float, cos: float, sin: float, about_origin: bool) -> Float:
    """Half the cross products of the parts of a turned square's sides in a unit square at 0, 0.

    The turned squares have these centres, shape (n, 2); the products are about the origin or about
    each centre. Sides are cut by Liang and Barsky's algorithm. Returns shape (n,).
    """
    total = np.zeros(len(centers))
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    corners = corners @ [[cos, sin], [-sin, cos]]
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        begin = centers + start
        way = end - start
        shares = np.sort([(-0.5 - begin) / way, (0.5 - begin) / way], axis=0)
        enter = np.maximum(shares[0].max(axis=1), 0.0)[:, None]
        leave = np.minimum(shares[1].min(axis=1), 1.0)[:, None]
        one = begin + enter * way
        other = begin + np.maximum(leave, enter) * way
        if not about_origin:
            one = one - centers
            other = other - centers
        total += (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    return total
