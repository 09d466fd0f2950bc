"""The graph of a grid's steps, made by plain loops, and random grids to make it of."""

import math

import numpy as np
from scipy.sparse import coo_array

from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D

STEP = 0.25


def make_level(free, floor, weights=None, *, col0=0, row0=0, cell_size=0.1, ground=0.0):
    """A level whose first cell is (row0, col0) of the scene's lattice."""
    free = np.asarray(free, dtype=bool)
    height, width = free.shape
    weights = np.ones(free.shape) if weights is None else weights
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=(col0 * cell_size, ground, row0 * cell_size),
        weights=np.where(free, weights, np.inf),
        attributes={"floorHeight": np.asarray(floor, dtype=np.float32)},
        metadata={"traversableFloorHeight": STEP},
    )


def stack(levels, links):
    metadata = {"traversableFloorHeight": STEP, "navbake": {"links": links}}
    return MultiLevelGrid(grids=levels, cell_size=levels[0].cell_size, metadata=metadata)


def random_grid(rng, *, weighted=True, within=True):
    """Up to three levels with holes, steps, weights and links, also between far cells.

    Args:
        rng: where the numbers come from.
        weighted: weights differ.
        within: links may lead to the same level.
    """
    levels, links = [], []
    for _ in range(rng.integers(1, 4)):
        shape = tuple(rng.integers(1, 14, size=2))
        free = rng.random(shape) < rng.uniform(0.55, 1.0)
        floor = np.where(rng.random(shape) < 0.05, np.nan, rng.integers(0, 4, shape) * 0.1)
        weights = rng.choice([1.0, 1.5, 10.0, 0.0], shape, p=[0.6, 0.2, 0.15, 0.05])
        levels.append(
            make_level(
                free,
                floor,
                weights if weighted else None,
                col0=int(rng.integers(-3, 4)),
                row0=int(rng.integers(-3, 4)),
            )
        )
    for _ in range(rng.integers(0, 8)):
        a, b = rng.integers(0, len(levels), size=2)
        ends = rng.integers(levels[a].free.size), rng.integers(levels[b].free.size)
        if a != b or within:
            links.append([int(a), int(ends[0]), int(b), int(ends[1])])
    return stack(levels, links)


def step_graph(grid, *, cut_corners=False):
    """Costs of all steps, as a sparse matrix over flat ids: length times weight of the target.

    A step that costs nothing is 1e-300 there, as scipy takes 0 for no step.
    """
    slopes = [slopes_of(grid, number) for number in range(len(grid.levels))]
    start = np.cumsum([0] + [level.free.size for level in grid.levels])
    steps = {}
    for k, level in enumerate(grid.levels):
        floors = floors_of(level)
        for row, col in np.ndindex(level.shape):
            for r in (row - 1, row, row + 1):
                for c in (col - 1, col, col + 1):
                    if may_step(floors, (row, col), (r, c), cut_corners, slopes[k]):
                        length = level.cell_size * math.hypot(r - row, c - col)
                        a, b = (start[k] + y * level.width + x for y, x in ((row, col), (r, c)))
                        add(steps, a, b, length * level.weights[r, c])
    for a, cell_a, b, cell_b in grid.step_array.tolist():
        for (i, one), (j, other) in (((a, cell_a), (b, cell_b)), ((b, cell_b), (a, cell_a))):
            levels = grid.levels[i], grid.levels[j]
            places = [
                divmod(cell, level.width) for cell, level in zip((one, other), levels, strict=True)
            ]
            if all(level.free[place] for level, place in zip(levels, places, strict=True)):
                centers = [
                    level.lattice.positions(*place)
                    for level, place in zip(levels, places, strict=True)
                ]
                short, long = sorted(np.abs(centers[0] - centers[1]))
                length = max(long + (math.sqrt(2) - 1) * short, grid.cell_size)
                add(steps, start[i] + one, start[j] + other, length * levels[1].weights[places[1]])
    size = int(start[-1])
    ends = np.array(list(steps), dtype=np.int64).reshape(-1, 2)
    costs = np.maximum(np.array(list(steps.values()), dtype=float), 1e-300)
    return coo_array((costs, (ends[:, 0], ends[:, 1])), shape=(size, size)).tocsr()


def add(steps, a, b, cost):
    if a != b:
        steps[a, b] = min(cost, steps.get((a, b), math.inf))


def slopes_of(grid, number):
    """The pairs of neighbours on a level that a link joins, as sets of (row, col)."""
    width = grid.levels[number].width
    links = [link for link in grid.step_array.tolist() if link[0] == link[2] == number]
    return {frozenset((divmod(a, width), divmod(b, width))) for _, a, _, b in links}


def floors_of(level):
    """The heights of the floors of a level's free cells, by (row, col) [m]."""
    cells, heights = np.argwhere(level.free).tolist(), level.floor_height[level.free].tolist()
    return {(row, col): height for (row, col), height in zip(cells, heights, strict=True)}


def may_step(floors, here, there, cut_corners, slopes):
    """Whether a step leads from a cell to one of its eight neighbours.

    A diagonal one goes round both of its corners; with corners cut, it needs that only where it is
    itself more than a step, which it may be where one of the steps round a corner is, too.
    """
    if here == there:
        return False
    if here[0] == there[0] or here[1] == there[1]:
        return is_joined(floors, here, there, slopes)
    if cut_corners and is_level(floors, here, there):
        return True
    beside = [(here[0], there[1]), (there[0], here[1])]
    ways = [pair for b in beside for pair in ((here, b), (b, there))]
    if not all(is_joined(floors, *pair, slopes) for pair in ways):
        return False
    return is_level(floors, here, there) or not all(is_level(floors, *pair) for pair in ways)


def is_joined(floors, a, b, slopes):
    """A step, or neighbours of free cells that a link joins."""
    if is_level(floors, a, b):
        return True
    return frozenset((a, b)) in slopes and a in floors and b in floors


def is_level(floors, a, b):
    """Both cells are there and free, and their floors at most a step apart."""
    return a in floors and b in floors and not abs(floors[a] - floors[b]) > STEP + 1e-5
