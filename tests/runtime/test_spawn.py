"""Starts for many agents: apart from each other and from everything, even by area."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import chisquare

import navbake
from grid_maps import house_from, level_from, random_house
from navbake.errors import QueryError
from navbake.runtime.draws import Spacing, bound_num_agents, sort_along_hilbert_curve
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN

OPEN = "\n".join(["." * 20] * 20)  # 2 m by 2 m


def make_rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def apartment():
    return PathFinder(navbake.load(GOLDEN / "apartment.grid.json.gz").inflate(0.18))


def nearest_pair(positions, height=np.inf):
    """The smallest distance on the map of two that are on floors of one height."""
    offset = positions[:, None] - positions
    distance = np.hypot(offset[..., 0], offset[..., 1])
    distance[np.abs(offset[..., 2]) >= height] = np.inf
    return distance[np.triu_indices(len(positions), 1)].min(initial=np.inf)


@pytest.mark.parametrize("stratify", [None, "area", "room", "island"])
@pytest.mark.parametrize("min_distance", [None, 0.5])
def test_all_that_was_asked_for_holds(apartment, stratify, min_distance):
    clear = apartment.grid.inflate(0.25)
    for seed in range(20):
        positions, headings = apartment.spawn(
            make_rng(seed),
            12,
            rooms=["kitchen", "living_room"],
            island=1,
            clearance=0.25,
            min_distance=min_distance,
            stratify=stratify,
        )
        assert positions.shape == (12, 3) and headings.shape == (12,)
        assert clear.values_at("free", positions).all()
        assert {apartment.room_at(p) for p in positions} <= {"kitchen", "living_room"}
        assert {apartment.island_at(p) for p in positions} == {1}
        assert nearest_pair(positions) >= (min_distance or 0.5) - 1e-9
        assert (np.abs(headings) <= np.pi).all()


def test_agents_never_touch_however_near_they_may_be(apartment):
    for min_distance in (0.0, 0.1):
        positions, _ = apartment.spawn(make_rng(), 60, min_distance=min_distance)
        assert nearest_pair(positions) > 0.36 + 1e-9


@pytest.mark.parametrize("seed", range(10))
def test_agents_over_one_another_may_be_near_on_the_map(seed):
    grid = random_house(make_rng(seed), 3, 0.9)
    grid.metadata["agentHeight"] = 1.14  # storeys are 2 m apart
    positions, _ = PathFinder(grid).spawn(make_rng(seed), 60, min_distance=0.3)
    assert nearest_pair(positions) < 0.3 - 1e-9
    assert nearest_pair(positions, 1.14) >= 0.3 - 1e-9


def test_agents_on_floors_that_overlap_keep_apart():
    low, high = level_from("." * 10), level_from("." * 10, ground=0.5)
    grid = house_from([low, high])
    grid.metadata["agentHeight"] = 1.14
    positions, _ = PathFinder(grid).spawn(make_rng(), 4, min_distance=0.3)
    assert nearest_pair(positions) >= 0.3 - 1e-9


def test_the_same_generator_draws_the_same(apartment):
    for stratify in (None, "area", "room"):
        one, other, another = (
            apartment.spawn(make_rng(seed), 15, stratify=stratify) for seed in (1, 1, 2)
        )
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_array_equal(one.headings, other.headings)
        assert not np.array_equal(one.positions, another.positions)


@pytest.mark.parametrize("stratify", [None, "area"])
def test_ten_thousand_draws_are_even_by_area(apartment, stratify):
    rng, n = make_rng(5), 10
    draws = [apartment.spawn(rng, n, stratify=stratify).positions for _ in range(1000)]
    flat = apartment.search.flat
    cells = flat.cells_at(np.concatenate(draws))
    # blocks of neighbouring cells, of one area each, as near as may be
    free = sort_along_hilbert_curve(flat, np.flatnonzero(flat.free))
    block = np.empty(flat.num_cells, dtype=np.int64)
    block[free] = np.arange(len(free)) * 40 // len(free)
    counts, sizes = np.bincount(block[cells]), np.bincount(block[free])
    assert chisquare(counts, sizes * (len(cells) / len(free))).pvalue > 0.01
    # and of all shapes: each room, each distance to a wall
    for value in (apartment.rooms.number, _distance_bins(apartment)):
        counts, sizes = np.bincount(value[cells]), np.bincount(value[free])
        expected = sizes[sizes > 0] * (len(cells) / len(free))
        assert chisquare(counts[sizes > 0], expected).pvalue > 0.001
    headings = apartment.spawn(rng, 40).headings
    assert headings.min() < -2 and headings.max() > 2


def _distance_bins(finder):
    flat = finder.search.flat
    cells = np.flatnonzero(flat.free)
    bins = np.zeros(flat.num_cells, dtype=np.int64)
    bins[cells] = np.digitize(finder.clearance(flat.positions(cells)), [0.2, 0.3, 0.45, 0.6])
    return bins


def test_parts_of_one_area_have_an_agent_each():
    finder = PathFinder(level_from(OPEN))
    for seed in range(20):
        positions, _ = finder.spawn(make_rng(seed), 4, stratify="area")
        quarters = {(x > 1.0, y > -1.0) for x, y, _ in positions}
        assert len(quarters) >= 2  # parts begin anywhere along the curve
    counts = [len(set(_sixteenths(finder, seed, "area"))) for seed in range(50)]
    plain = [len(set(_sixteenths(finder, seed, None))) for seed in range(50)]
    assert np.mean(counts) > np.mean(plain) + 1


def _sixteenths(finder, seed, stratify):
    positions, _ = finder.spawn(make_rng(seed), 16, stratify=stratify)
    return [(int(x / 0.5), int(-y / 0.5)) for x, y, _ in positions]


def test_parts_of_unlike_size_are_even_by_area_too():
    finder, rng = PathFinder(level_from(".....")), make_rng()
    draws = [finder.spawn(rng, 2, stratify="area").positions[:, 0] for _ in range(2000)]
    counts = np.bincount((np.concatenate(draws) / 0.1).astype(int))
    assert chisquare(counts).pvalue > 0.01


def test_rooms_have_as_many_each_give_or_take_one(apartment):
    positions, _ = apartment.spawn(make_rng(), 17, stratify="room")
    rooms = [apartment.room_at(p) for p in positions]
    assert sorted(rooms.count(room.id) for room in apartment.grid.rooms) == [3, 3, 3, 4, 4]


def test_what_does_not_fit_into_a_part_goes_to_others():
    finder = PathFinder(level_from("." + "#" + "." * 20))
    positions, _ = finder.spawn(make_rng(), 8, min_distance=0.2, stratify="island")
    assert sorted(finder.island_at(p) for p in positions) == [1] * 7 + [2]


def test_agents_face_where_they_are_told_to(apartment):
    target = (0.5, 0.4, 0.0)
    positions, headings = apartment.spawn(make_rng(), 10, facing=target)
    away = np.array(target[:2]) - positions[:, :2]
    np.testing.assert_allclose(headings, np.arctan2(away[:, 1], away[:, 0]))
    assert (apartment.spawn(make_rng(), 3, facing=2.5).headings == 2.5).all()
    np.testing.assert_allclose(apartment.spawn(make_rng(), 1, facing=4.0).headings, 4 - 2 * np.pi)


def test_agents_are_reachable_and_blocks_count(apartment):
    home = apartment.random_point(make_rng(), room="hall")
    with apartment.grid.block(disc=((1.07, -0.27, 0.0), 0.5)):
        positions, _ = apartment.spawn(make_rng(), 20, reachable_from=home)
        assert all(apartment.same_island(home, p) for p in positions)
        other = 1 if apartment.island_at(home) != 1 else 2
        with pytest.raises(QueryError, match="can't be reached"):
            apartment.spawn(make_rng(), 1, island=other, reachable_from=home)
    with apartment.grid.block(box=((-9, -9), (9, 9))), pytest.raises(QueryError, match="no free"):
        apartment.spawn(make_rng(), 1)


# --- what fits -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(16))
def test_no_more_fit_than_the_bound_says(seed):
    rng = make_rng(seed)
    free = rng.random((4, 5)) < 0.7
    finder = PathFinder(level_from("\n".join("".join(".#"[not v] for v in row) for row in free)))
    flat = finder.search.flat
    cells = np.flatnonzero(flat.free)
    apart = float(rng.uniform(0.05, 0.4))
    p = flat.positions(cells)[:, :2]
    near = np.linalg.norm(p[:, None] - p, axis=-1) < apart - 1e-9
    most = largest_crowd(near)
    assert bound_num_agents(flat, cells, Spacing(apart, 1.14)) >= most
    # a crowd that fits is found; the largest of all may not be, and that is said
    for n in range(1, most):
        try:
            positions, _ = finder.spawn(rng, n, min_distance=apart)
        except QueryError as error:
            said = str(error)
            break
        assert len(positions) == n
        assert nearest_pair(positions) >= apart - 1e-9
    else:
        return
    assert "were found" in said and n >= 0.7 * most


def largest_crowd(near):
    """How many places no two of which are near there are, by trying all ways."""

    def best(left):
        if not left:
            return 0
        first, rest = left[0], left[1:]
        with_first = 1 + best([k for k in rest if not near[first, k]])
        if all(not near[first, k] for k in rest):
            return with_first
        return max(with_first, best(rest))

    return best(list(range(len(near))))


def test_the_bound_counts_storeys_by_themselves():
    house = house_from([level_from("."), level_from(".", ground=3.0)])
    flat = PathFinder(house).search.flat
    assert bound_num_agents(flat, np.arange(2), Spacing(1.0, 1.14)) == 2
    assert bound_num_agents(flat, np.arange(2), Spacing(1.0, 4.0)) == 1


def test_a_row_that_is_just_long_enough_is_packed():
    finder = PathFinder(level_from("." * 41))
    positions, _ = finder.spawn(make_rng(), 9, min_distance=0.5)
    np.testing.assert_allclose(np.sort(positions[:, 0]), 0.05 + 0.5 * np.arange(9))


@pytest.mark.parametrize(
    ("n", "given", "message"),
    [
        (30, {"min_distance": 2, "rooms": "kitchen"}, "30 agents 2 m apart: at most 4 fit in 'kit"),
        (900, {}, "900 agents of radius 0.18 m: at most [0-9]+ fit in 'apartment'"),
        (25, {"min_distance": 2}, "places for 1[0-9] were found in 'apartment', and more than 30"),
        (3, {"clearance": 3.0}, "no free cell with 3 m round in 'apartment'"),
        (0, {}, "expected a number of agents n >= 1, got 0"),
        (-3, {}, "n >= 1, got -3"),
        (2.5, {}, "n >= 1, got 2.5"),
        (True, {}, "n >= 1, got True"),
        (2, {"rooms": "kitchn"}, "no room 'kitchn' in 'apartment': did you mean 'kitchen'?"),
        (2, {"rooms": ["kitchen", "x"]}, "no room 'x'"),
        (2, {"rooms": 3}, "no room 3 in .apartment."),
        (2, {"rooms": []}, "at least one room"),
        (2, {"level": 1}, "no level 1"),
        (2, {"island": 99}, "no island 99"),
        (2, {"min_distance": np.nan}, "expected a min_distance >= 0 m, got nan"),
        (2, {"clearance": -1.0}, "as clearance, got -1.0"),
        (2, {"clearance": np.nan}, "as clearance, got nan"),
        (2, {"stratify": "rooms"}, "expected area, room, island or None as stratify, got 'rooms'"),
        (2, {"facing": np.nan}, "finite heading"),
        (2, {"facing": "door"}, "expected world positions"),
        (2, {"facing": np.zeros((2, 3))}, "one position or heading as facing"),
        (2, {"reachable_from": (99.0, 0.0, 0.0)}, "no agent can stand at 99, 0, 0"),
    ],
)  # fmt: skip
def test_what_can_not_be_is_said(apartment, n, given, message):
    with pytest.raises(QueryError, match=message):
        apartment.spawn(make_rng(), n, **given)
    assert len(apartment.spawn(make_rng(), 2).positions) == 2


def test_a_seed_is_no_generator(apartment):
    with pytest.raises(QueryError, match=r"numpy\.random\.default_rng"):
        apartment.spawn(7, 2)


def test_rooms_are_needed_to_stratify_by_them():
    with pytest.raises(QueryError, match=r"no room of .* has a free cell"):
        PathFinder(level_from(OPEN)).spawn(make_rng(), 2, stratify="room")


# --- Hilbert's curve -------------------------------------------------------------------------


def test_neighbours_sort_along_hilbert_curves_curve_are_neighbours():
    flat = PathFinder(level_from("\n".join(["." * 16] * 16))).search.flat
    row, col = np.divmod(sort_along_hilbert_curve(flat, np.arange(256)), 16)
    assert (np.abs(np.diff(row)) + np.abs(np.diff(col)) == 1).all()
    assert len(set(zip(row.tolist(), col.tolist(), strict=True))) == 256
    for one, other in itertools.pairwise(range(0, 256 + 1, 64)):  # quarters
        assert len(set(row[one:other] // 8)) == len(set(col[one:other] // 8)) == 1
