"""Islands, rooms, bounds and pictures that a finder tells of."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.navgrid.cells import Cell
from navbake.navgrid.grid import MultiLevelGrid
from navbake.navgrid.islands import find_islands
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN


@pytest.mark.parametrize("seed", range(6))
def test_islands_are_those_of_the_grid(seed):
    house = random_house(np.random.default_rng(seed), num_levels=1 + seed % 3, share=0.6)
    finder = PathFinder(house)
    expected = np.concatenate([island.ravel() for island in find_islands(house)])
    np.testing.assert_array_equal(finder.islands.number, expected)
    sizes = np.bincount(expected)
    assert finder.islands.count == len(sizes) - 1
    for island in range(1, len(sizes)):
        assert finder.island_area(island) == pytest.approx(sizes[island] * 0.01)
    assert finder.navigable_area == pytest.approx(sizes[1:].sum() * 0.01)


def test_areas_of_levels_with_cells_of_their_own():
    grids = [level_from("..#.", cell_size=0.5), level_from("...", ground=3.0)]
    finder = PathFinder(MultiLevelGrid(grids=grids, cell_size=0.5))
    areas = [finder.island_area(island) for island in (1, 2, 3)]
    assert areas == pytest.approx([0.03, 0.5, 0.25])
    assert finder.navigable_area == pytest.approx(0.78)


def test_island_of_a_position():
    finder = PathFinder(level_from("...#."))
    assert finder.island_at((0.05, -0.05)) == 1
    assert finder.island_at((0.45, -0.05)) == 2
    assert finder.island_at((0.35, -0.05)) is None
    assert finder.island_at((9.0, 0.0)) is None
    assert finder.same_island((0.05, -0.05), (0.25, -0.05))
    assert not finder.same_island((0.05, -0.05), (0.45, -0.05))
    assert not finder.same_island((0.35, -0.05), (0.35, -0.05))
    with pytest.raises(QueryError, match="no island 0: there are 1 to 2, 1 the largest"):
        finder.island_area(0)


@pytest.fixture(scope="module")
def house():
    return navbake.PathFinder(navbake.load(GOLDEN / "house.grid.json.gz"))


def test_rooms_of_the_sample_house(house):
    rng = np.random.default_rng(0)
    for room in house.rooms.rooms:
        points = house.random_point(rng, 20, room=room.id)
        assert {house.room_at(p) for p in points} == {room.id}
        assert {house.cell_at(p).level for p in points} == {room.level}
        assert house.same_room(points[0], points[1])
        assert house.room_near(points[0], 0.0) == room.id
        assert not house.same_room(points[0], (99.0, 0.0, 0.0))


def test_room_near_a_wall(house):
    walls = np.flatnonzero((house.rooms.number == 0) & house.search.occupied)
    flat = house.search.flat
    in_rooms = np.flatnonzero(house.rooms.number)
    for cell in np.random.default_rng(1).choice(walls, size=30):
        position, level = flat.positions(cell), int(flat.level_of(cell))
        there = in_rooms[flat.level_of(in_rooms) == level]
        distance = np.linalg.norm((flat.positions(there) - position)[:, :2], axis=1)
        nearest = there[distance <= distance.min() + 1e-9]
        rooms = {house.rooms.id_of(int(n)) for n in house.rooms.number[nearest]}
        assert house.room_near(position, level=level) in rooms
        assert house.room_near(position, distance.min() - 0.01, level=level) is None


def test_room_of_an_object(house):
    grid = house.grid
    ids = {(room.level, room.index): room.id for room in grid.rooms}
    cells: dict[str, Counter] = {}
    for number, level in enumerate(grid.levels):
        for cell, entry in level.user_data.items():
            for name in entry.get("objects", ()):
                room = ids.get((number, int(level.room_index.flat[cell])))
                cells.setdefault(name, Counter())[room] += room is not None
    assert len(cells) > 20
    for name, counts in cells.items():
        most = max(counts.values())
        expected = {room for room, count in counts.items() if count == most} if most else {None}
        assert house.room_of(name) in expected
    with pytest.raises(QueryError, match="no object 'no such thing'"):
        house.room_of("no such thing")


def test_room_of_an_object_is_where_most_of_it_is():
    level = level_from("......")
    level.attributes["roomIndex"] = np.array([[1, 1, 2, 2, 2, 0]], dtype=np.uint16)
    level.user_data = {c: {"objects": ["sofa"]} for c in range(1, 6)} | {5: {"objects": ["lamp"]}}
    finder = PathFinder(level)
    assert finder.room_of("sofa") == "0:2"
    assert finder.room_of("lamp") is None


def test_bounds_are_those_of_free_cells_and_their_floors():
    lower = level_from("#...\n####")
    upper = level_from("....\n....\n....", ground=3.0, x=2.0, y_max=1.0)
    low, high = PathFinder(house_from([lower, upper])).bounds
    np.testing.assert_allclose(low, (0.1, -0.1, 0.0), atol=1e-12)
    np.testing.assert_allclose(high, (2.4, 1.0, 3.0), atol=1e-12)
    with pytest.raises(QueryError, match="no cell of 'house' is free"):
        _ = PathFinder(house_from([level_from("##")])).bounds


def test_a_picture_shows_its_own_storey():
    finder = PathFinder(house_from([level_from("..#\n# ."), level_from("##.", ground=3.0)]))
    free, blocked, none = (247, 243, 232), (59, 66, 82), (185, 192, 204)
    assert finder.top_down(0).tolist() == [
        [list(v) for v in row] for row in ((free, free, blocked), (blocked, none, free))
    ]
    assert finder.top_down(1).shape == (1, 3, 3)
    np.testing.assert_array_equal(
        finder.top_down(0, 0.05), finder.top_down(0).repeat(2, 0).repeat(2, 1)
    )
    assert finder.top_down(0, 0.2).shape == (1, 2, 3)
    finder.grid.block(cells=Cell(0, 0, 0))
    assert tuple(finder.top_down(0)[0, 0]) == blocked


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((2,), "no level 2: expected 0 to 1"),
        ((0, 0.0), "metres_per_pixel > 0, got 0.0"),
        ((0, np.nan), "metres_per_pixel > 0, got nan"),
    ],
)
def test_pictures_that_cannot_be_are_refused(arguments, message):
    finder = PathFinder(house_from([level_from(".." * 9), level_from("..", ground=3.0)]))
    with pytest.raises(QueryError, match=message):
        finder.top_down(*arguments)


@pytest.mark.parametrize("name", ["apartment", "house", "terrain"])
def test_samples_in_a_walk_round(name):
    """Nothing here knows of one grid only: places of each sample stand up to every question."""
    finder = navbake.PathFinder(navbake.load(GOLDEN / f"{name}.grid.json.gz"))
    rng = np.random.default_rng(2)
    points = finder.random_point(rng, 50, anywhere=True)
    assert finder.is_navigable(points).all()
    for p in points:
        cell = finder.cell_at(p)
        level = finder.grid.levels[cell.level]
        assert level.free[cell.row, cell.col]
        np.testing.assert_allclose(finder.snap(p), p)
        assert finder.clearance(p) > 0
        moved = finder.try_step(p, p[:2] + rng.normal(size=2) * 0.3)
        assert finder.is_navigable(moved)
        assert finder.same_island(p, moved)
    numbers = finder.islands.number[finder.search.flat.cells_at(points)]
    assert (numbers > 0).all()


def test_room_near_takes_floors_as_they_are():
    """A room's cell without floor, under another level's floor a step above its ground."""
    lower, upper = level_from("# ", ground=0.0), level_from(" .", ground=0.2)
    lower.attributes["roomIndex"] = np.array([[0, 1]], dtype=np.uint16)
    lower.weights[0, 0] = 1.0
    finder = PathFinder(house_from([lower, upper]))
    assert finder.room_near((0.05, -0.05, 0.0)) == "0:1"
    assert finder.room_near((9.0, 0.0, 0.0)) is None


@pytest.mark.parametrize("floors", [False, True])
def test_random_questions_to_third_party_files(floors):
    """No links, islands, clearance, occupancy or metadata; and no floor heights in some."""
    rng = np.random.default_rng(3)
    for _ in range(10):
        shape = rng.integers(3, 20, size=2)
        text = "\n".join("".join(row) for row in rng.choice([".", ".", "#"], size=shape))
        level = level_from(text, floors=floors)
        level.metadata.clear()
        del level.attributes["occupancy"]
        finder = PathFinder(level)
        points = finder.random_point(rng, 20, anywhere=True)
        assert finder.is_navigable(points).all()
        for p in points:
            assert finder.same_island(p, finder.random_point_near(rng, p, 1.0))
            moved = finder.try_step(p, p + rng.normal(size=3) * 0.4)
            assert finder.is_navigable(moved) and finder.same_island(p, moved)
            snapped = finder.snap(p + rng.normal(size=3))
            assert finder.is_navigable(snapped)
            assert finder.is_navigable(finder.random_pose(rng, p, 1.0).position)
            assert finder.room_near(p) is None
            assert level.at(p).island == finder.island_at(p)


def test_third_party_files():
    """No layers at all: what weighs nothing finite is occupied."""
    level = level_from("....\n.##.\n....", floors=False)
    level.metadata.clear()
    level.attributes.clear()
    finder = PathFinder(level)
    assert finder.islands.count == 1
    assert finder.clearance((0.05, -0.05)) == pytest.approx(np.hypot(0.05, 0.05))
    assert finder.room_at((0.05, -0.05)) is None
    assert not finder.line_of_sight((0.05, -0.15), (0.35, -0.15))


@pytest.mark.parametrize(
    "ask",
    [
        lambda f: f.is_navigable([[0, 0, 0], [0, 0]]),
        lambda f: f.is_navigable([10**400, 0, 0]),
        lambda f: f.is_navigable((0, 0, 0), max_drop=None),
        lambda f: f.snap((0, 0, 0), max_distance=None),
        lambda f: f.room_near((0, 0, 0), None),
        lambda f: f.snap((0, 0, 0), max_distance=math.nan),
        lambda f: f.clearance((0.05, -0.05, 0), max_distance="1"),
        lambda f: f.snap((0, 0, 0), room=["hall"]),
        lambda f: f.top_down(None),
        lambda f: f.top_down(0, "1"),
        lambda f: f.grid.position_of(None),
        lambda f: f.grid.position_of((0, 0.5, 0)),
        lambda f: f.grid.with_doors(3),
        lambda f: f.grid.blockers(None, 0),
    ],
)
def test_what_is_no_question_is_refused(ask):
    with pytest.raises(QueryError):
        ask(PathFinder(level_from("#..\n...")))


@pytest.mark.parametrize("seed", range(20))
def test_islands_are_what_paths_join_where_corners_are_cut(seed):
    rng = np.random.default_rng(seed)
    finder = PathFinder(random_house(rng, share=0.5), cut_corners=True)
    search = finder.search
    start = int(rng.choice(np.flatnonzero(search.flat.free)))
    joined = np.isfinite(search.compute_cost_field(np.array([start])))
    np.testing.assert_array_equal(finder.islands.number == finder.islands.number[start], joined)


def test_rooms_and_islands_of_many_positions_are_those_of_each():
    house = navbake.load(GOLDEN / "house.grid.json.gz").inflate(0.25)
    finder = navbake.PathFinder(house)
    rng = np.random.default_rng(4)
    positions = rng.uniform((-6.5, -6.5, -0.5), (6.5, 6.5, 4.0), (4, 100, 3))
    rooms = finder.room_at(positions)
    islands = finder.island_at(positions)
    assert rooms.shape == islands.shape == (4, 100) and islands.dtype == np.int64
    for index in np.ndindex(4, 100):
        assert rooms[index] == finder.room_at(positions[index])
        assert islands[index] == (finder.island_at(positions[index]) or 0)
    assert None in rooms and 0 in islands and len(set(rooms.ravel().tolist())) > 5
    on_level = finder.room_at(positions[0, :, :2], level=1)
    assert on_level.tolist() == [finder.room_at(xy, level=1) for xy in positions[0, :, :2]]
