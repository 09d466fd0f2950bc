"""Blocking cells for a while, against grids made anew with the same cells blocked."""

import copy
import pickle

import numpy as np
import pytest

from navbake.errors import QueryError
from navbake.navgrid.cells import Cells
from navbake.navgrid.islands import add_layers, find_islands, islands_of, measure_clearance
from navbake.navgrid.links import Agent
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.search import Search
from oracles.ways import make_level, random_grid, stack


def open_level(size=30, **kwargs):
    return make_level(np.ones((size, size)), np.zeros((size, size)), **kwargs)


def assert_same_as_fresh(finder, grid):
    """What a finder has followed equals what one finds that never saw another state."""
    fresh, search = Search(copy.deepcopy(grid)), finder.search
    np.testing.assert_array_equal(search.flat.free, fresh.flat.free)
    np.testing.assert_array_equal(search.flat.weight, fresh.flat.weight)
    np.testing.assert_array_equal(search.graph.moves, fresh.graph.moves)
    for goal in np.flatnonzero(fresh.flat.free)[:3]:
        np.testing.assert_allclose(
            search.compute_cost_field(np.array([goal])),
            fresh.compute_cost_field(np.array([goal])),
            rtol=1e-8,
            atol=1e-12,
        )


def random_cells(grid, rng, count):
    level = rng.integers(0, len(grid.levels), count)
    row = np.array([rng.integers(grid.levels[k].height) for k in level])
    col = np.array([rng.integers(grid.levels[k].width) for k in level])
    return Cells(level, row, col)


@pytest.mark.parametrize("seed", range(40))
def test_any_order_of_blocks_equals_a_fresh_grid(seed):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng)
    grid.metadata["navbake"]["version"] = "0"
    add_layers(grid, ["clearance"])
    before = copy.deepcopy(grid)
    finder, blocks = PathFinder(grid), []
    for _ in range(6):
        if blocks and rng.random() < 0.4:
            blocks.pop(rng.integers(len(blocks))).free()
        elif rng.random() < 0.5:
            blocks.append(grid.block(cells=random_cells(grid, rng, rng.integers(1, 6))))
        else:
            x, y = rng.uniform(-0.5, 1.7), rng.uniform(-1.7, 0.5)
            blocks.append(grid.block(disc=((x, y, 0.0), rng.uniform(0, 0.3)), margin=0.1))
        held = np.concatenate([np.zeros(level.free.size, bool) for level in grid.levels])
        start = finder.search.flat.layout.start
        for block in blocks:
            for k, cells in enumerate(block.cells):
                held[start[k] + cells] = True
        expected = np.concatenate([level.free.ravel() for level in before.levels]) & ~held
        np.testing.assert_array_equal(finder.search.flat.free, expected)
        assert_same_as_fresh(finder, grid)
        for level in grid.levels:
            np.testing.assert_allclose(
                level.attributes["clearance"], measure_clearance(level), atol=1e-6
            )
        freed_grid = grid.without_obstacles()
        for level, old in zip(freed_grid.levels, before.levels, strict=True):
            np.testing.assert_array_equal(level.weights, old.weights)
            np.testing.assert_array_equal(
                level.attributes["clearance"], old.attributes["clearance"]
            )
    for block in blocks:
        block.free()
    for level, old in zip(grid.levels, before.levels, strict=True):
        np.testing.assert_array_equal(level.weights, old.weights)
        np.testing.assert_allclose(level.attributes["clearance"], old.attributes["clearance"])
    assert_same_as_fresh(finder, before)


@pytest.mark.parametrize("seed", range(10))
def test_a_finder_made_while_something_is_blocked_sees_it_freed(seed):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng)
    before = copy.deepcopy(grid)
    with grid.block(cells=random_cells(grid, rng, 10)):
        finder = PathFinder(grid)
        assert_same_as_fresh(finder, grid)
    assert_same_as_fresh(finder, before)


@pytest.mark.parametrize("seed", range(10))
def test_inflated_grids_follow_too(seed):
    rng = np.random.default_rng(seed)
    free = rng.random((25, 25)) < 0.97
    level = make_level(free, np.zeros((25, 25)))
    level.attributes["occupancy"] = (~free).astype(np.uint8)
    grid = level.inflate(0.15)
    finder = PathFinder(grid)
    search = finder.search
    masks = (search.free_diagonally, search.off_center.anywhere, search.graph.moves)
    room = [mask.copy() for mask in masks]
    x, y = rng.uniform(0.5, 2.0), rng.uniform(-2.0, -0.5)
    block = grid.block(disc=((x, y), 0.2))
    gap = np.hypot(*(finder.search.flat.positions(np.arange(625))[:, :2] - (x, y)).T)
    assert (finder.search.flat.free == (room[0] * 0 + grid.free.ravel())).all()
    assert not finder.search.flat.free[gap < 0.35 - 1e-9].any()
    near = gap < 0.2 + np.hypot(0.15, 0.1 / np.sqrt(2)) - 1e-9
    assert not finder.search.free_diagonally[near].any()
    assert not finder.search.off_center.anywhere[gap < 0.35 + 0.1 / np.sqrt(2) - 1e-9].any()
    block.free()
    for now, then in zip(masks, room, strict=True):
        # room for a diagonal step only matters where cells are free
        if now.dtype == bool:
            free_now = finder.search.flat.free
            now, then = now & free_now, then & free_now
        np.testing.assert_array_equal(now, then)


def test_a_disc_takes_what_an_agent_would_meet():
    grid = open_level()
    block = grid.block(disc=((1.5, -1.5), 0.3), margin=0.2)
    x, y = np.meshgrid(grid.lattice.center_x() - 1.5, grid.lattice.center_y() + 1.5)
    squares = np.hypot(np.maximum(abs(x) - 0.05, 0), np.maximum(abs(y) - 0.05, 0)) < 0.3
    expected = squares | (np.hypot(x, y) < 0.5)
    np.testing.assert_array_equal(~grid.free, expected)
    np.testing.assert_array_equal(block.cells[0], np.flatnonzero(expected))


def test_a_box_takes_what_an_agent_would_meet():
    grid = open_level()
    grid.block(box=((1.02, -1.5, 0.0), (1.51, -1.22, 2.0)), margin=0.15)
    x, y = np.meshgrid(grid.lattice.center_x(), grid.lattice.center_y())
    gap = np.hypot(np.maximum(abs(x - 1.265) - 0.245, 0), np.maximum(abs(y + 1.36) - 0.14, 0))
    squares = (abs(x - 1.265) < 0.295) & (abs(y + 1.36) < 0.19)
    np.testing.assert_array_equal(~grid.free, squares | (gap < 0.15))


def test_the_margin_is_the_agents():
    for radius in (0.1, 0.3):
        grid = open_level()
        grid.metadata["agentRadius"] = radius
        grid.block(disc=((1.45, -1.45), 0.0))
        center = np.hypot(
            *np.meshgrid(grid.lattice.center_x() - 1.45, grid.lattice.center_y() + 1.45)
        )
        assert not grid.free[center < radius - 1e-9].any()
        assert grid.free[center > radius + 0.1].all()
    grid = open_level()
    grid.attributes["occupancy"] = np.zeros((30, 30), np.uint8)
    inflated = grid.inflate(0.4)
    block = inflated.block(disc=((1.45, -1.45), 0.0))
    assert len(block.cells[0]) == np.count_nonzero(center < 0.4)
    assert inflated.occupancy.sum() == 1
    assert grid.free.all(), "the grid that it was made of stays as it is"


@pytest.mark.parametrize(("z", "height", "blocked"), [
    (0.0, None, True), (0.0, 0.2, False), (0.0, 0.3, True), (1.2, 1.0, False), (3.0, 1.0, False),
    (-2.0, 1.9, False), (-2.0, 2.3, True),
])  # fmt: skip
def test_only_what_reaches_into_the_agents_height_counts(z, height, blocked):
    grid = open_level()
    grid.metadata["agentHeight"] = 1.14
    grid.block(disc=((1.5, -1.5, z), 0.3), height=height)
    assert grid.free.all() == (not blocked)


def test_levels_are_told_apart_by_height_or_number():
    grid = stack([open_level(), open_level(ground=3.0)], [])
    grid.levels[1].attributes["floorHeight"][:] = 3.0
    with grid.block(disc=((1.5, -1.5, 3.0), 0.3)):
        assert grid.levels[0].free.all()
        assert not grid.levels[1].free.all()
    with grid.block(disc=((1.5, -1.5), 0.3), level=0):
        assert not grid.levels[0].free.all()
        assert grid.levels[1].free.all()


def test_a_block_of_one_level_is_seen_by_finders_of_all():
    grid = stack([open_level(5), open_level(5)], [])
    finder = PathFinder(grid)
    block = grid.levels[1].block(cells=Cells(*np.array([[0], [2], [3]])))
    assert np.flatnonzero(~finder.search.flat.free).tolist() == [25 + 13]
    block.free()
    assert finder.search.flat.free.all()


def test_freeing_twice_is_freeing_once():
    grid = open_level(4)
    one, other = (grid.block(cells=grid.cell_at((0.15, -0.15))) for _ in range(2))
    one.free()
    one.free()
    assert not grid.free[1, 1]
    other.free()
    assert grid.free.all()


def test_occupied_cells_stay_so():
    free = np.ones((4, 4), bool)
    free[1, 1] = False
    grid = make_level(free, np.zeros((4, 4)))
    grid.attributes["occupancy"] = (~free).astype(np.uint8)
    with grid.block(cells=Cells(*np.array([[0, 0], [1, 2], [1, 2]]))):
        assert np.argwhere(grid.occupancy).tolist() == [[1, 1], [2, 2]]
    assert np.argwhere(grid.occupancy).tolist() == [[1, 1]]
    assert np.argwhere(~grid.free).tolist() == [[1, 1]]


@pytest.mark.parametrize("is_inflated", [False, True])
def test_what_only_the_agents_disc_meets_is_occupied_and_not_solid(is_inflated):
    """As in a bake; in an inflated grid, occupancy stays that of the baked radius."""
    grid = open_level()
    for name in ("occupancy", "solid"):
        grid.attributes[name] = np.zeros(grid.shape, dtype=np.uint8)
    grid.metadata |= {"navbake": {"version": "0"}, "agentRadius": 0.25}
    if is_inflated:
        grid = grid.inflate(0.25)
    before = copy.deepcopy(grid)
    first = grid.block(disc=((1.5, -1.5), 0.3))
    second = grid.block(disc=((1.7, -1.5), 0.3))
    expected_occupancy = grid.solid if is_inflated else (~grid.free).astype(np.uint8)
    np.testing.assert_array_equal(grid.occupancy, expected_occupancy)
    assert 0 < grid.solid.sum() < (~grid.free).sum()
    if not is_inflated:
        np.testing.assert_array_equal(grid.with_doors("open").occupancy, expected_occupancy)
    freed_grid = grid.without_obstacles()
    assert not freed_grid.occupancy.any() and not freed_grid.solid.any() and freed_grid.free.all()
    first.free()
    assert grid.occupancy[15, 17] and not grid.free[15, 17]
    second.free()
    for name in ("occupancy", "solid"):
        np.testing.assert_array_equal(grid.attributes[name], before.attributes[name])
    np.testing.assert_array_equal(grid.weights, before.weights)


def test_islands_follow_although_the_file_tells_of_them():
    grid = make_level(np.ones((1, 5)), np.zeros((1, 5)))
    grid.metadata["navbake"] = {"version": "0"}
    add_layers(grid, ["island"])
    with grid.block(cells=grid.cell_at((0.25, -0.05))):
        np.testing.assert_array_equal(islands_of(grid)[0], find_islands(grid)[0])
        assert islands_of(grid)[0].tolist() == [[1, 1, 0, 2, 2]]
    assert islands_of(grid)[0].tolist() == [[1] * 5]


@pytest.mark.parametrize(
    "copy_grid", [copy.deepcopy, lambda grid: pickle.loads(pickle.dumps(grid))]
)
@pytest.mark.parametrize("num_levels", [1, 2])
def test_copies_have_the_islands_of_what_is_blocked(copy_grid, num_levels):
    levels = [make_level(np.ones((1, 5)), np.zeros((1, 5))) for _ in range(num_levels)]
    grid = levels[0] if num_levels == 1 else stack(levels, [])
    grid.metadata["navbake"] = {"version": "0"}
    add_layers(grid, ["island"])
    before = [level.attributes["island"].copy() for level in grid.levels]
    with grid.block(cells=(0, 0, 2)):
        copied = copy_grid(grid)
        for level, islands in zip(copied.levels, find_islands(grid), strict=True):
            np.testing.assert_array_equal(level.attributes["island"], islands)
        # the layer of the grid itself stays, and tells of the grid without obstacles
        for level, islands in zip(grid.levels, before, strict=True):
            np.testing.assert_array_equal(level.attributes["island"], islands)
    assert not copied.is_blocked and not copied.levels[0].free[0, 2]


@pytest.mark.parametrize("seed", range(5))
def test_a_finder_for_a_lower_step_made_while_something_is_blocked_has_true_clearances(seed):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng)
    grid.metadata["navbake"]["version"] = "0"
    add_layers(grid, ["clearance"])
    with grid.block(cells=random_cells(grid, rng, 5)):
        finder = PathFinder(grid, agent=Agent("low", step=0.01))
        assert finder.grid is not grid
        for level in finder.grid.levels:
            np.testing.assert_array_equal(level.attributes["clearance"], measure_clearance(level))
    for level in finder.grid.levels:
        np.testing.assert_allclose(
            level.attributes["clearance"], measure_clearance(level), atol=1e-6
        )


def test_who_missed_too_much_looks_at_all(monkeypatch):
    monkeypatch.setattr("navbake.navgrid.obstacle_state.MAX_LOG", 2)
    grid = open_level(6)
    finder = PathFinder(grid)
    for k in range(5):
        grid.block(cells=Cells(*np.array([[0], [k], [k]])))
    assert_same_as_fresh(finder, grid)


def test_kept_fields_are_not_those_of_before():
    grid = make_level(np.ones((2, 5)), np.zeros((2, 5)))
    finder = PathFinder(grid)
    assert finder.distances((0.05, -0.05), (0.45, -0.05)) == pytest.approx(0.4)
    assert finder.distance_field((0.45, -0.05))[0] is not None
    with grid.block(cells=grid.cell_at((0.25, -0.05))):
        assert finder.distances((0.05, -0.05), (0.45, -0.05)) == pytest.approx(0.48284271)
    assert finder.distances((0.05, -0.05), (0.45, -0.05)) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("kwargs", "expected"),
    [
        ({}, "one of cells, disc and box"),
        ({"disc": ((0, 0), 1), "box": ((0, 0), (1, 1))}, "one of cells, disc and box"),
        ({"disc": ((0, 0), -1)}, "radius of a disc"),
        ({"disc": ((0, np.nan), 1)}, "finite"),
        ({"disc": ((0, 0), 1), "margin": -1}, "margin"),
        ({"disc": ((0, 0), 1), "level": 2}, "no level 2"),
        ({"disc": ([(0, 0)], 1)}, "one centre"),
        ({"box": ((0, 0), (-1, 1))}, "lower and upper corner"),
        ({"cells": (0, 9, 0)}, r"no cell .* \(0, 9, 0\)"),
    ],
)
def test_bad_blocks(kwargs, expected):
    with pytest.raises(QueryError, match=expected):
        open_level(4).block(**kwargs)


@pytest.mark.parametrize("place", [{"disc": ((50, 3, 0), 0.3)}, {"box": ((50, 3, 0), (51, 4, 1))}])
def test_beside_the_grid_nothing_is_blocked_and_the_obstacle_says_so(place):
    grid = open_level()
    beside = grid.block(**place)
    assert repr(beside) == "AddedObstacle(0 cells)" and [len(ids) for ids in beside.cells] == [0]
    assert grid.free.all()
    assert repr(grid.block(cells=(0, 2, 2))) == "AddedObstacle(1 cell)"


@pytest.mark.parametrize("derive", [lambda g: g.inflate(0.1), lambda g: g.with_doors("open")])
def test_a_derived_grid_keeps_what_was_blocked_whatever_happens_to_the_first(derive):
    grid = open_level()
    grid.attributes["occupancy"] = np.zeros(grid.shape, dtype=np.uint8)
    block = grid.block(disc=((1.0, -1.0, 0.0), 0.2))
    derived = derive(grid)
    occupancy, free = derived.occupancy.copy(), derived.free.copy()
    assert occupancy.any()
    block.free()
    grid.block(cells=(0, 2, 2))
    np.testing.assert_array_equal(derived.occupancy, occupancy)
    np.testing.assert_array_equal(derived.free, free)


def test_a_door_that_opens_frees_nothing_that_is_blocked():
    grid = open_level()
    grid.attributes["occupancy"] = np.zeros(grid.shape, dtype=np.uint8)
    grid.attributes["occupancy"][5, 5:9] = 1
    grid.weights[5, 5:9] = np.inf
    closed = [[0, [5 * 30 + 5, 4]]]
    door = {"id": "d", "joint": "d", "rooms": [None, None], "state": "closed"}
    door["cells"] = {"modelled": closed, "closed": closed, "open": []}
    grid.metadata["navbake"] = {"doors": [door]}
    with grid.block(cells=(0, 5, 6)):
        opened = grid.with_doors("open")
    assert opened.free[5, 5:9].tolist() == [True, False, True, True]
    assert opened.occupancy[5, 5:9].tolist() == [0, 1, 0, 0]


@pytest.mark.parametrize(
    "thing",
    [
        {"disc": 3},
        {"disc": (1.0, 2.0, 3.0)},
        {"box": 3},
        {"box": ((0, 0, 0),)},
        {"cells": 3},
        {"cells": (0, 1)},
        {"cells": (0, 1.5, 2)},
        {"cells": (0, np.nan, 2)},
        {"cells": (0, [1, 2], [1, 2, 3])},
    ],
)
def test_things_that_are_none_are_refused(thing):
    with pytest.raises(QueryError, match="expected"):
        open_level().block(**thing)
