"""Paths: what leads to goals, and which cells are next to an object."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from navbake.errors import FormatError, QueryError
from navbake.runtime import no_path
from navbake.runtime.path_finder import PathFinder
from navbake.runtime.paths import cells_next_to_object
from oracles.ways import make_level, random_grid, stack
from project_paths import GOLDEN


def from_map(rows, **kwargs):
    """A level from a map: ``#`` blocked, a digit free with its floor so many times 0.1 m high."""
    cells = np.array([list(row) for row in rows])
    free = cells != "#"
    return make_level(free, np.where(free, cells, "0").astype(float) * 0.1, **kwargs)


@pytest.fixture(scope="module")
def house():
    return navbake.load(GOLDEN / "house.grid.json.gz")


@pytest.fixture(scope="module")
def apartment():
    return navbake.load(GOLDEN / "apartment.grid.json.gz")


def test_a_path_without_smoothing_runs_through_centres():
    finder = PathFinder(from_map(["000", "0#0", "000"]))
    path = finder.find_path((0.05, -0.05), (0.25, -0.25), smooth=False)
    assert path.cells.tolist() in (
        [[0, 0, 0], [0, 1, 0], [0, 2, 0], [0, 2, 1], [0, 2, 2]],
        [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 1, 2], [0, 2, 2]],
    )
    np.testing.assert_allclose(path.positions[[0, -1]], [[0.05, -0.05, 0], [0.25, -0.25, 0]])
    assert len(path.positions) == 5
    assert path.length == pytest.approx(0.4)
    assert path.cost == pytest.approx(0.4)
    assert path.levels.tolist() == [0] * 5


def test_corners_may_be_cut():
    grid = from_map(["000", "0#0", "000"])
    finder = PathFinder(grid, cut_corners=True)
    path = finder.find_path((0.05, -0.05), (0.25, -0.25))
    assert path.cost == pytest.approx(0.2 + 0.1 * np.sqrt(2))


def test_a_path_begins_and_ends_where_it_was_asked_to():
    finder = PathFinder(from_map(["0000", "0000"]))
    for smooth in (False, True):
        path = finder.find_path((0.01, -0.02), (0.39, -0.18), smooth=smooth)
        np.testing.assert_allclose(path.positions[0], [0.01, -0.02, 0.0])
        np.testing.assert_allclose(path.positions[-1], [0.39, -0.18, 0.0])
    assert path.length == pytest.approx(np.hypot(0.38, 0.16))
    assert len(path.positions) == 2


def test_the_cheapest_of_several_goals():
    finder = PathFinder(from_map(["0000000"]))
    path = finder.find_path((0.25, -0.05), [(0.65, -0.05), (0.05, -0.05), (9.0, 9.0)])
    np.testing.assert_allclose(path.positions[-1], [0.05, -0.05, 0.0])


def test_start_and_goal_in_one_place():
    finder = PathFinder(from_map(["00"]))
    path = finder.find_path((0.05, -0.05), (0.05, -0.05))
    assert path.length == 0.0
    assert path.cost == 0.0
    assert len(path.positions) == 1


def test_no_path_is_none():
    finder = PathFinder(from_map(["00#0"]))
    assert finder.find_path((0.05, -0.05), (0.35, -0.05)) is None
    assert finder.find_path((0.05, -0.05), (0.25, -0.05)) is None
    assert finder.find_path((0.25, -0.05), (0.05, -0.05)) is None
    assert finder.find_path((0.05, -0.05), (5.0, 5.0)) is None
    assert finder.find_path((5.0, 5.0), (0.05, -0.05)) is None


def test_heights_follow_the_floor():
    finder = PathFinder(from_map(["0011223344"]))
    path = finder.find_path((0.05, -0.05), (0.95, -0.05))
    for x, z in ((0.05, 0.0), (0.15, 0.0), (0.2, 0.05), (0.25, 0.1), (0.75, 0.3), (0.95, 0.4)):
        np.testing.assert_allclose(path.at(x - 0.05), [x, -0.05, z], atol=2e-3)


def test_a_smooth_path_does_not_cross_what_is_dear():
    weights = np.ones((9, 9))
    weights[:8, 4] = 50.0
    grid = make_level(np.ones((9, 9)), np.zeros((9, 9)), weights)
    path = PathFinder(grid).find_path((0.05, -0.05), (0.85, -0.05))
    crossing = path.positions[np.argmin(np.abs(path.positions[:, 0] - 0.45))]
    assert crossing[1] < -0.8


def test_levels_are_crossed_by_links():
    lower, upper = from_map(["000"]), from_map(["2200"], col0=3)
    path = PathFinder(stack([lower, upper], [[0, 2, 1, 0]])).find_path(
        (0.05, -0.05, 0.0), (0.65, -0.05, 0.0)
    )
    assert path.cells[:, 0].tolist() == [0, 0, 0, 1, 1, 1, 1]
    assert path.levels[0] == 0
    assert path.levels[-1] == 1
    np.testing.assert_allclose(path.at(0.2), [0.25, -0.05, 0.0], atol=2e-3)
    np.testing.assert_allclose(path.at(0.3), [0.35, -0.05, 0.2], atol=2e-3)


def test_rooms_and_doors_on_the_way(apartment):
    finder = PathFinder(apartment)
    center = {room.id: room.centroid for room in apartment.rooms}
    path = finder.find_path(center["kitchen"], "room:bedroom")
    assert path.rooms == ["kitchen", "hall", "bedroom"]
    assert path.doors == ["door_kitchen", "door_bedroom"]


def test_next_to_an_object(apartment):
    finder = PathFinder(apartment)
    names = {n for e in apartment.user_data.values() for n in e.get("objects", ())}
    start = next(room.centroid for room in apartment.rooms if room.id == "hall")
    for name in sorted(names):
        # also what hangs over a table or stands on it, from beside the table
        path = finder.find_path(start, f"object:{name}")
        assert path is not None, name
        carriers = np.array(
            [c for c, e in apartment.user_data.items() if name in e.get("objects", ())]
        )
        rows, cols = np.divmod(carriers, apartment.width)
        _, row, col = path.cells[-1]
        assert np.hypot(rows - row, cols - col).min() * 0.1 <= 1.1
    assert len(names) == 49


def test_fields_and_distances_agree_with_paths(house):
    finder = PathFinder(house)
    rng = np.random.default_rng(0)
    flat = finder.search.flat
    cells = rng.choice(np.flatnonzero(flat.free), 20)
    positions = flat.positions(cells)
    goal = positions[0]
    distances = finder.distances(positions, goal)
    field = np.concatenate([part.ravel() for part in finder.distance_field(goal)])
    np.testing.assert_array_equal(distances, field[cells])
    for position, distance in zip(positions, distances, strict=True):
        path = finder.find_path(position, goal)
        assert (path is None) == np.isinf(distance)
        if path:
            assert path.cost == pytest.approx(distance)


def test_distances_outside_are_infinite():
    finder = PathFinder(from_map(["00"]))
    found = finder.distances([[0.05, -0.05], [9.0, 9.0]], (0.15, -0.05))
    assert found.tolist() == [pytest.approx(0.1), np.inf]


@pytest.mark.parametrize(
    ("start", "goal", "expected"),
    [
        ((np.nan, 0), (0.05, -0.05), "finite"),
        ((0.05,), (0.05, -0.05), "shape"),
        ([[0.05, -0.05]], (0.05, -0.05), "one start"),
        ((0.05, -0.05), (0.05, np.inf), "finite"),
        ((0.05, -0.05), [], "shape|position"),
        ((0.05, -0.05), "kitchen", "room:NAME"),
        ((0.05, -0.05), "room:kitchn", "no room 'kitchn'"),
        ((0.05, -0.05), "object:tabel", "did you mean 'table'"),
    ],
)
def test_bad_questions(start, goal, expected):
    grid = from_map(["00"])
    grid.user_data = {1: {"objects": ["table", "chair"]}}
    with pytest.raises(QueryError, match=expected):
        PathFinder(grid).find_path(start, goal)


def test_unknown_rooms_are_refused_with_the_nearest(apartment):
    with pytest.raises(QueryError, match="did you mean 'kitchen'"):
        PathFinder(apartment).find_path((0, 0, 0), "room:kitchn")


def test_rooms_below_and_above_are_joined_by_stairs(house):
    finder = PathFinder(house)
    rooms = house.rooms
    for below in (room for room in rooms if room.level == 0):
        for above in (room for room in rooms if room.level == 1):
            cells = finder.rooms.cells(below.id)
            start = finder.search.flat.positions(cells[finder.search.flat.free[cells]][:1])[0]
            path = finder.find_path(start, f"room:{above.id}")
            assert path is not None
            assert path.rooms[-1] == above.id
            assert set(path.levels) == {0, 1}


@pytest.mark.parametrize("seed", range(25))
def test_smooth_paths_stay_free(seed):
    rng = np.random.default_rng(seed)
    grid = random_grid(rng, weighted=False, within=False)
    finder = PathFinder(grid)
    if finder.islands.count:
        assert_paths_stay_free(finder, rng, 8)


@pytest.mark.parametrize("name", ["house", "apartment"])
def test_smooth_paths_of_the_samples_stay_free(name, request):
    finder = PathFinder(request.getfixturevalue(name))
    assert assert_paths_stay_free(finder, np.random.default_rng(1), 40) > 30


def assert_paths_stay_free(finder, rng, count):
    """Every centimetre is in a free cell, on its floor, and no longer than the route.

    Returns how many of the random places are joined by a path: all on one island are.
    """
    found = 0
    for a, b in finder.random_point(rng, 2 * count).reshape(count, 2, 3):
        jitter = rng.uniform(-0.049, 0.049, (2, 2))
        a[:2], b[:2] = a[:2] + jitter[0], b[:2] + jitter[1]
        path = finder.find_path(a, b)
        assert (path is not None) == finder.same_island(a, b)
        if path is None:
            continue
        found += 1
        rough = finder.find_path(a, b, smooth=False)
        assert path.length <= rough.length + 1e-9
        crosses = np.diff(path.levels) != 0
        beside = crosses | np.append(crosses[1:], False) | np.append(False, crosses[:-1])
        for k in np.flatnonzero(~beside):
            one, other, i = path.positions[k], path.positions[k + 1], path.levels[k]
            if np.hypot(*(other - one)[:2]) == 0:
                continue  # a step straight up or down
            level = finder.grid.levels[i]
            steps = int(np.hypot(*(other - one)[:2]) / 0.01) + 2
            line = one + np.linspace(0, 1, steps)[:, None] * (other - one)
            rows, cols = level.lattice.rows_cols(line)
            assert level.free[rows, cols].all()
            floor = level.floor_height[rows, cols]
            off = np.abs(line[:, 2] - np.where(np.isnan(floor), level.ground, floor))
            assert off.max() <= 0.3 + 5e-3  # it rises from one cell's middle to the next one's
    return found


def test_next_to_an_object_is_on_this_side_of_the_wall():
    grid = from_map(["00000000", "########", "0##00000", "00000000"])
    grid.attributes["occupancy"] = (~grid.free).astype(np.uint8)
    grid.user_data = {17: {"objects": ["shelf"]}, 18: {"objects": ["shelf"]}}
    found = cells_next_to_object(PathFinder(grid).search, "shelf")
    assert found.tolist() == [16, 19, 20, 24, 25, 26, 27]
    grid.weights[2, 3:] = grid.weights[2, 0] = np.inf  # as an inflation leaves it
    grid.weights[3, 1:4] = np.inf
    # two islands, each with its nearest cells
    assert cells_next_to_object(PathFinder(grid).search, "shelf").tolist() == [24, 28, 29]


@pytest.mark.parametrize(
    ("seed", "radius"),
    [(0, 0.1), (1, 0.15), (2, 0.2), (3, 0.25), (4, 0.32), (5, 0.12), (6, 0.06), (7, 0.157)],
)
@pytest.mark.parametrize("smooth", [True, False])
def test_paths_keep_the_radius_that_a_grid_was_inflated_for(seed, radius, smooth):
    """Every centimetre, the disc meets no occupied cell's square."""
    rng = np.random.default_rng(seed)
    free = rng.random((40, 40)) < 0.985
    grid = make_level(free, np.zeros((40, 40)))
    grid.attributes["occupancy"] = (~free).astype(np.uint8)
    finder = PathFinder(grid.inflate(radius))
    squares = grid.lattice.positions(*np.nonzero(~free))
    nearest, found = np.inf, 0
    for a, b in finder.random_point(rng, 80).reshape(40, 2, 3):
        a[:2], b[:2] = a[:2] + rng.uniform(-0.04, 0.04, 2), b[:2] + rng.uniform(-0.04, 0.04, 2)
        path = finder.find_path(a, b, smooth=smooth)
        assert (path is not None) == finder.same_island(a, b)
        if path is None:
            continue
        found += 1
        line = path.at(np.arange(0, path.length + 0.01, 0.01))[:, :2]
        gap = np.abs(line[:, None] - squares) - 0.05
        nearest = min(nearest, np.hypot(*np.maximum(gap, 0).transpose(2, 0, 1)).min())
    assert found > 0
    assert nearest >= radius - 1e-9


@pytest.mark.parametrize("entry", [{"objects": None}, {"objects": "a sofa"}, {"objects": [{}]}])
def test_user_data_that_name_nothing(entry):
    level = make_level(np.ones((3, 3)), np.zeros((3, 3)))
    level.user_data = {4: entry, 8: {"objects": ["sofa"], "doors": "d"}}
    finder = PathFinder(level)
    assert finder.find_path((0.05, -0.05, 0.0), "object:sofa").doors == []
    with pytest.raises(QueryError, match="it has sofa"):
        finder.find_path((0.05, -0.05, 0.0), "object:chair")


NAMES = {
    "T": {"objects": ["thing"]},
    "o": {"objects": ["table"]},
    "b": {"blockers": ["table"]},
    "W": {"walls": ["wall"]},
    "w": {"blockers": ["wall"]},
    "B": {"objects": ["table"], "walls": ["wall"]},
}


def beside_thing(*rows: str) -> list[str]:
    """A map with an x for each cell next to the thing, T.

    Cells: free (``.``), too near to something (``~``), solid (``#``), or with names and solid.
    """
    cells = np.array([list(row) for row in rows])
    grid = make_level(cells == ".", np.zeros(cells.shape))
    grid.attributes["occupancy"] = (cells != ".").astype(np.uint8)
    grid.attributes["solid"] = (~np.isin(cells, (".", "~"))).astype(np.uint8)
    grid.metadata["navbake"] = {"version": "0"}  # else `solid` may be anything
    grid.user_data = {n: NAMES[cell] for n, cell in enumerate(cells.flat) if cell in NAMES}
    cells.ravel()[cells_next_to_object(PathFinder(grid).search, "thing")] = "x"
    return ["".join(row) for row in cells.tolist()]


def test_the_nearest_ring_and_the_next():
    found = beside_thing("......", "......", "..T...", "......", "......")
    assert found == ["..x...", ".xxx..", "xxTxx.", ".xxx..", "..x..."]


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ("...T#..", ".xxT#.."),
        ("T#..", "T#.."),
        # on a table: beyond it, but not beyond a wall, whatever else is in the wall's cells
        ("To..", "Toxx"),
        ("Tob..", "Tobxx"),
        ("To#..", "To#.."),
        ("ToW..", "ToW.."),
        ("ToB..", "ToB.."),
        ("Tow..W", "Tow..W"),
        # nothing stands where only the agent's radius blocks, up to 1 m away
        ("T~~..", "T~~xx"),
        ("T" + 8 * "~" + "...", "T" + 8 * "~" + "xx."),
        ("T" + 10 * "~" + "...", "T" + 10 * "~" + "..."),
    ],
)
def test_next_to_it_as_far_as_nothing_stands(row, expected):
    assert beside_thing(row) == [expected]


def test_an_object_is_reached_from_the_island_of_the_start():
    """A tub 0.2 m from where one walks, with a gap to the wall that is an island by itself."""
    grid = from_map(["0000", "####", "0000", "0000", "0000", "####", "####", "000#"])
    solid = np.zeros(grid.shape, dtype=np.uint8)
    solid[1] = solid[6, :3] = solid[5:, 3] = 1  # a wall, the tub, and what ends it
    grid.attributes |= {"occupancy": (~grid.free).astype(np.uint8), "solid": solid}
    grid.metadata["navbake"] = {"version": "0"}
    grid.user_data = {cell: {"objects": ["tub"]} for cell in (24, 25, 26)}
    finder = PathFinder(grid)
    start, gap, beyond = (0.05, -0.25, 0.0), (0.05, -0.75, 0.0), (0.05, -0.05, 0.0)
    assert finder.island_at(start) != finder.island_at(gap) != finder.island_at(beyond)
    assert finder.find_path(start, "object:tub").cells[-1].tolist() == [0, 3, 0]
    assert finder.find_path(gap, "object:tub").cells[-1].tolist() == [0, 7, 0]
    assert finder.why_not(start, "object:tub") is None
    distances = finder.distances([start, gap, beyond], "object:tub")
    np.testing.assert_allclose(distances, [0.1, 0.0, np.inf], rtol=1e-9)
    # the wall is between: the goal stays where others reach it
    assert finder.find_path(beyond, "object:tub") is None
    assert "the goal is in island" in finder.why_not(beyond, "object:tub")


def test_an_object_on_a_table_is_reached_from_all_sides_of_the_table():
    assert beside_thing("..oTooo..") == ["xxoToooxx"]
    assert beside_thing("..Tooo..") == ["xxTooo.."]  # it isn't shut in


def test_a_path_and_its_finder_say_what_they_are_in_one_line(house):
    finder = PathFinder(house)
    path = finder.find_path((0.0, -4.8, 0.0), "room:1:1")
    assert str(finder) == repr(finder)
    assert repr(finder).startswith("PathFinder('house', ") and "m² free, islands:" in repr(finder)
    for text in (repr(path), repr(finder)):
        assert "\n" not in text and len(text) < 200
    assert f"Path({path.length:.2f} m" in repr(path) and path.rooms[-1] in repr(path)
    assert path.points is path.positions


def test_a_finder_takes_the_file_of_a_grid(tmp_path, apartment):
    path = tmp_path / "a.grid.json"
    apartment.save(path)
    for file in (path, str(path)):
        assert PathFinder(file).navigable_area == pytest.approx(48.1, abs=0.1)
    with pytest.raises(FormatError, match=r"b\.grid\.json"):
        PathFinder(tmp_path / "b.grid.json")


def test_a_cost_counts_steps_between_centres_and_a_length_the_way_itself():
    finder = PathFinder(from_map(["00000"]))
    centre, goal = finder.search.flat.positions(np.array([0, 4]))
    aside = np.array([0.02, 0.0, 0.0])
    inner, outer = (finder.find_path(start, goal) for start in (centre + aside, centre - aside))
    assert inner.cost == outer.cost == pytest.approx(inner.length + 0.02)
    assert outer.cost == pytest.approx(outer.length - 0.02)


def test_reasons_write_lengths_as_people_read_them():
    assert no_path.format_point((-0.001, 2.004, -0.0)) == "(0.00, 2.00, 0.00)"
    assert no_path.round_down(0.158114) == 0.158  # 0.16 would not pass
    assert no_path.round_down(0.29) == 0.29
