"""Connected parts and clearance, against a plain search and a plain minimum."""

from collections import deque

import numpy as np
import pytest

from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers, find_islands, islands_of, measure_clearance


def make_level(rows, step=0.25, unit=1.0, cell_size=0.1, ground=0.0):
    """A level from a map: ``#`` blocked, a digit free with its floor so many times 0.1 m high."""
    cells = np.array([list(row) for row in rows])
    free = cells != "#"
    floor = np.where(free, np.where(free, cells, "0").astype(float) * 0.1 + ground, np.nan)
    return make_grid(free, floor, step, unit, cell_size)


def make_grid(free, floor, step=0.25, unit=1.0, cell_size=0.1):
    height, width = free.shape
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=(0.0, 0.0, 0.0),
        unit=unit,
        weights=np.where(free, 1.0, np.inf),
        attributes={"floorHeight": floor.astype(np.float32)},
        metadata={"traversableFloorHeight": step} if step is not None else {},
    )


def stack(levels, links, step=0.25):
    metadata = {"traversableFloorHeight": step, "navbake": {"links": links}}
    return MultiLevelGrid(grids=levels, cell_size=levels[0].cell_size, metadata=metadata)


def shown(islands):
    return ["".join(".123456789"[number] for number in row) for row in islands]


def test_parts_are_numbered_by_size_then_by_first_cell():
    level = make_level(["0#00", "0#00", "###0", "00##"])
    assert shown(find_islands(level)[0]) == ["2.11", "2.11", "...1", "33.."]


def test_corners_do_not_connect():
    assert shown(find_islands(make_level(["0#", "#0"]))[0]) == ["1.", ".2"]


def test_steps_up_to_the_highest_connect():
    assert shown(find_islands(make_level(["0247"], step=0.25))[0]) == ["1112"]
    assert shown(find_islands(make_level(["0247"], step=0.2))[0]) == ["1112"]
    assert shown(find_islands(make_level(["0247"], step=0.19))[0]) == ["1234"]


def test_exact_steps_connect_at_any_height():
    level = make_level(["01234"], step=0.1, ground=123.4)  # float32 rounds by 4e-6 there
    assert shown(find_islands(level)[0]) == ["11111"]


def test_without_a_stated_step_it_is_a_quarter_of_a_metre():
    assert shown(find_islands(make_level(["0247"], step=None))[0]) == ["1112"]
    assert shown(find_islands(make_level(["0258"], step="high"))[0]) == ["1123"]
    centimetres = make_grid(np.ones((1, 3), bool), np.array([[0.0, 20.0, 46.0]]), None, unit=0.01)
    assert shown(find_islands(centimetres)[0]) == ["112"]


def test_free_cells_without_floor_height_are_level():
    free = np.ones((1, 3), bool)
    assert shown(find_islands(make_grid(free, np.array([[0.0, np.nan, 9.0]])))[0]) == ["111"]


def test_links_join_levels_where_both_cells_are_free():
    lower, upper = make_level(["00#0"]), make_level(["0#0"])
    assert [shown(i) for i in find_islands(stack([lower, upper], []))] == [["11.2"], ["3.4"]]
    joined = stack([lower, upper], [[0, 3, 1, 0], [0, 2, 1, 1], [1, 1, 0, 0]])
    assert [shown(i) for i in find_islands(joined)] == [["11.2"], ["2.3"]]


def test_nothing_free():
    assert shown(find_islands(make_level(["##", "##"]))[0]) == ["..", ".."]


def plain_islands(levels, links, step):
    """Breadth first from each cell in turn."""
    joined = {}
    for a, cell_a, b, cell_b in links:
        one = (a, *divmod(cell_a, levels[a].width))
        two = (b, *divmod(cell_b, levels[b].width))
        joined.setdefault(one, []).append(two)
        joined.setdefault(two, []).append(one)
    parts = []
    seen = set()
    for k, level in enumerate(levels):
        for row, col in np.ndindex(level.shape):
            if (k, row, col) in seen or not level.free[row, col]:
                continue
            part, queue = [], deque([(k, row, col)])
            seen.add((k, row, col))
            while queue:
                here = at, r, c = queue.popleft()
                part.append(here)
                beside = [(at, r + 1, c), (at, r - 1, c), (at, r, c + 1), (at, r, c - 1)]
                near = [cell for cell in beside if can_step(levels, here, cell, step)]
                for there in near + joined.get(here, []):
                    if there not in seen and is_free(levels, there):
                        seen.add(there)
                        queue.append(there)
            parts.append(part)
    parts.sort(key=lambda part: -len(part))  # stable: of equal ones the first found stays first
    islands = [np.zeros(level.shape, dtype=np.int32) for level in levels]
    for number, part in enumerate(parts, start=1):
        for k, row, col in part:
            islands[k][row, col] = number
    return islands


def is_free(levels, cell):
    level, row, col = cell
    height, width = levels[level].shape
    return 0 <= row < height and 0 <= col < width and levels[level].free[row, col]


def can_step(levels, here, there, step):
    if not is_free(levels, there):
        return False
    rise = floor_at(levels, here) - floor_at(levels, there)
    return abs(rise) <= step + 1e-5


def floor_at(levels, cell):
    level, row, col = cell
    return float(levels[level].floor_height[row, col])


@pytest.mark.parametrize("seed", range(60))
def test_islands_equal_a_plain_search(seed):
    rng = np.random.default_rng(seed)
    levels, links = [], []
    for _ in range(rng.integers(1, 4)):
        shape = tuple(rng.integers(1, 14, size=2))
        free = rng.random(shape) < rng.uniform(0.3, 1.0)
        levels.append(make_grid(free, np.where(free, rng.integers(0, 6, shape) * 0.1, np.nan)))
    for _ in range(rng.integers(0, 8)):
        a, b = rng.integers(0, len(levels), size=2)
        ends = (rng.integers(levels[a].free.size), rng.integers(levels[b].free.size))
        links.append([int(a), int(ends[0]), int(b), int(ends[1])])
    expected = plain_islands(levels, links, 0.25)
    for found, plain in zip(find_islands(stack(levels, links)), expected, strict=True):
        assert found.dtype == np.int32
        np.testing.assert_array_equal(found, plain)


@pytest.mark.parametrize("seed", range(20))
def test_clearance_equals_a_plain_minimum(seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 12, size=2))
    free = rng.random(shape) < rng.uniform(0.5, 1.0)
    level = make_grid(free, np.zeros(shape), cell_size=20.0, unit=0.01)
    found = measure_clearance(level)
    blocked = [
        (row, col)
        for row in range(-1, shape[0] + 1)
        for col in range(-1, shape[1] + 1)
        if not is_free([level], (0, row, col))
    ]
    for row, col in np.ndindex(shape):
        expected = 0.0
        if free[row, col]:
            nearest = min(np.hypot(row - r, col - c) for r, c in blocked)
            expected = (nearest - 0.5) * 0.2
        assert found[row, col] == pytest.approx(expected, abs=1e-6)
    assert found.dtype == np.float32


def test_islands_are_found_again_only_when_the_grid_changed():
    level = make_level(["000"])
    first = islands_of(level)
    assert shown(first[0]) == ["111"]
    assert islands_of(level) is first
    level.weights[0, 1] = np.inf
    assert shown(islands_of(level)[0]) == ["1.2"]
    level.weights[0, 1] = 1.0
    level.floor_height[0, 2] = 9.0
    assert shown(islands_of(level)[0]) == ["112"]
    level.metadata["traversableFloorHeight"] = 10.0
    assert shown(islands_of(level)[0]) == ["111"]


def test_islands_of_others_files_are_not_believed():
    level = make_level(["000"])
    level.attributes["island"] = np.array([[7, 7, 9]], dtype=np.uint16)
    assert shown(islands_of(level)[0]) == ["111"]
    level.metadata["navbake"] = {"version": "0"}
    assert islands_of(level)[0].tolist() == [[7, 7, 9]]
    level.attributes["island"][0, 0] = 65535  # may stand for more than one
    assert shown(islands_of(level)[0]) == ["111"]


def test_the_layer_is_what_is_found():
    level = make_level(["0#0"])
    add_layers(level, ["island"])
    level.metadata["navbake"] = {"version": "0"}
    np.testing.assert_array_equal(islands_of(level)[0], find_islands(level)[0])
