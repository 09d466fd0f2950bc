"""Colours stay apart, for people who see no red or no green, too; heights and rooms differ."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from color_vision import VISIONS, contrast, difference, lab_difference
from navbake.navgrid import colors
from navbake.navgrid.colors import choose_colors, darken_rooms, find_neighbours, rgb_of
from navbake.navgrid.grid import SceneGrid2D
from navbake.views.layers import (
    HEIGHT_STEP,
    VIRIDIS,
    height_scale,
    linear_scale,
    make_panel,
    paint,
)

AT_A_GLANCE = 8.0  # CIEDE2000; 1 is barely seen beside each other
KINDS = {
    name: getattr(colors, name)
    for name in ("FREE", "OCCUPIED", "NO_FLOOR", "CLOSED", "DOOR", "DOORWAY", "ROUTE")
}


def test_the_measure_gives_the_values_of_its_paper():
    # rows 1, 7, 17 and 25 of Sharma, Wu and Dalal's table
    for one, other, expected in (
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 0, 0), (50, -1, 2), 2.3669),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ):
        assert lab_difference(one, other) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("vision", VISIONS)
def test_kinds_of_cells_stay_apart(vision):
    for (name, one), (other_name, other) in combinations(KINDS.items(), 2):
        apart = difference(rgb_of(one), rgb_of(other), vision)
        assert apart > 14, (name, other_name)


@pytest.mark.parametrize("vision", VISIONS)
def test_rooms_stay_apart_from_each_other_and_from_what_is_no_room(vision):
    rooms = [*colors.ROOMS, colors.OUTDOORS]
    for one, other in combinations(rooms, 2):
        assert difference(rgb_of(one), rgb_of(other), vision) > AT_A_GLANCE, (one, other)
    for one in rooms:
        for name in ("OCCUPIED", "NO_FLOOR", "CLOSED", "DOOR", "DOORWAY", "ROUTE"):
            assert difference(rgb_of(one), rgb_of(KINDS[name]), vision) > AT_A_GLANCE, (one, name)
        dark = darken_rooms(np.array(rgb_of(one), dtype=np.uint8))
        assert difference(rgb_of(one), dark, vision) > 15
        assert difference(dark, rgb_of(colors.OCCUPIED), vision) > 10


@pytest.mark.parametrize("vision", VISIONS)
def test_marks_stay_apart(vision):
    for one, other in combinations(colors.MARKS, 2):
        assert difference(rgb_of(one), rgb_of(other), vision) > AT_A_GLANCE, (one, other)
    for one in colors.MARKS:
        for name in ("FREE", "OCCUPIED", "NO_FLOOR", "CLOSED"):
            assert difference(rgb_of(one), rgb_of(KINDS[name]), vision) > AT_A_GLANCE, (one, name)
    ways = (colors.LINK_UP, colors.LINK_DOWN, colors.LINK_ACROSS, colors.ROUTE)
    for one, other in combinations((*ways, colors.FREE), 2):
        assert difference(rgb_of(one), rgb_of(other), vision) > 10, (one, other)
    assert difference(rgb_of(colors.FREE), rgb_of(colors.OUTDOORS), vision) > 10


def test_links_stand_out_from_walls():
    """A contrast of 3 to 1, as WCAG 2.2 asks of graphics."""
    for color in (colors.LINK_UP, colors.LINK_DOWN, colors.LINK_ACROSS):
        assert contrast(rgb_of(color), rgb_of(colors.OCCUPIED)) >= 3, color


def test_the_scale_gets_lighter_all_the_way():
    bar = linear_scale(np.array([0.0, 1.0]), "z").bar(101).astype(float)
    light = bar @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(light) > 0).all()
    for vision in VISIONS:
        steps = [difference(bar[i], bar[i + 10], vision) for i in range(0, 91, 10)]
        assert min(steps) > 5, vision
        assert difference(rgb_of(VIRIDIS[0]), rgb_of(colors.OCCUPIED), vision) > AT_A_GLANCE


def heights_shown(heights):
    """The picture of floors, shape (height, width, 3)."""
    level = SceneGrid2D(
        width=heights.shape[1],
        height=heights.shape[0],
        cell_size=0.05,
        min_yup=(0.0, 0.0, 0.0),
        weights=np.ones(heights.shape),
        attributes={"floorHeight": heights.astype(np.float32)},
    )
    return paint(make_panel(level, "floor", 0))


def test_a_sill_of_2_cm_and_a_storey_of_3_m_show_in_one_picture():
    heights = np.zeros((40, 60))
    heights[:, 20:23] = 0.02  # a sill
    heights[10:20, 30:] = 0.02  # a rug
    heights[30:, 30:] = 3.0  # a storey
    picture = heights_shown(heights)
    floor, rug, storey = picture[5, 5], picture[15, 45], picture[35, 45]
    for vision in VISIONS:
        assert difference(floor, rug, vision) > 5
        assert difference(rug, storey, vision) > 30
        # both edges of the sill, against the floors beside them
        assert difference(picture[5, 20], picture[5, 19], vision) > 4
        assert difference(picture[5, 23], picture[5, 24], vision) > 4


def test_a_sill_shows_beside_stairs_that_take_the_whole_scale():
    heights = np.repeat(np.arange(18) * 0.17, 5)[None].repeat(60, axis=0)
    heights[30:, :] = 0.0
    heights[40:, 30:33] = 0.02
    picture = heights_shown(heights)
    for vision in VISIONS:
        assert difference(picture[50, 30], picture[50, 29], vision) > 4
        assert difference(picture[50, 33], picture[50, 34], vision) > 4
        for tread in range(17):
            one, other = picture[10, 5 * tread + 2], picture[10, 5 * tread + 7]
            assert difference(one, other, vision) > 2.5
        assert difference(picture[10, 2], picture[10, -2], vision) > 40


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=30))
def test_heights_keep_their_order_and_the_ticks_their_values(heights):
    array = np.array(heights)
    scale = height_scale(array, "z [m]")
    places = np.interp(np.sort(array), scale.values, scale.positions)
    assert (np.diff(places) >= -1e-12).all()
    assert (places >= 0).all() and (places <= 1).all()
    assert scale.ticks
    for tick in scale.ticks:
        value = np.interp(tick.position, scale.positions, scale.values)
        assert float(tick.text) == pytest.approx(value, abs=HEIGHT_STEP)
    assert all(
        b.position - a.position > 0.1 for a, b in zip(scale.ticks, scale.ticks[1:], strict=False)
    )


def test_flat_floors_look_flat():
    bumps = np.array([0.0, 0.01, 0.02])
    colors_of = height_scale(bumps, "z").color(bumps)
    assert difference(colors_of[0], colors_of[2]) < difference(*height_scale(bumps, "z").bar(2)) / 2
    assert len(height_scale(np.zeros(3), "z").ticks) == 1
    assert [tick.text for tick in height_scale(np.zeros(3), "z").ticks] == ["0.00"]
    assert height_scale(np.zeros(0), "z").ticks  # no floor at all


@pytest.mark.parametrize(
    ("low", "high", "texts"),
    [
        (0, 1, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]),
        (1, 10, ["2", "4", "6", "8", "10"]),
        (-0.03, 0.11, ["0.00", "0.05", "0.10"]),
        (1, 1, ["1"]),
        (0, 254, ["0", "50", "100", "150", "200", "250"]),
    ],
)
def test_ticks_of_a_scale_are_round_numbers(low, high, texts):
    scale = linear_scale(np.array([low, high], dtype=np.float64), "cost")
    assert [tick.text for tick in scale.ticks] == texts
    for tick in scale.ticks:
        value = np.interp(tick.position, scale.positions, scale.values)
        assert value == pytest.approx(float(tick.text))


def slow_neighbours(index, reach):
    """Pairs of regions with at most `reach` cells of none between them in a row or a column."""
    pairs = set()
    for lines in (index, index.T):
        for line in lines:
            seen = [(place, int(region)) for place, region in enumerate(line) if region]
            for (place, one), (next_place, other) in pairwise(seen):
                if one != other and next_place - place - 1 <= reach:
                    pairs.add((min(one, other), max(one, other)))
    return pairs


@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_neighbours_are_what_a_slow_search_finds(seed, reach):
    rng = np.random.default_rng(seed)
    index = rng.integers(0, 5, rng.integers(1, 9, 2)) * (rng.random() < 0.9)
    assert find_neighbours(index.astype(np.uint16), reach) == slow_neighbours(index, reach)


@given(st.integers(0, 2**32 - 1))
def test_neighbours_differ_while_there_are_colours(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 12))
    pairs = {tuple(sorted(rng.choice(count, 2, replace=False) + 1)) for _ in range(count - 1)}
    chosen = choose_colors(count, pairs, 12)
    assert all(chosen[one] != chosen[other] for one, other in pairs)
    assert len(set(choose_colors(3, [(1, 2), (2, 3), (1, 3)], 2)[1:])) == 2  # too few: no crash


def test_rooms_with_a_wall_between_differ():
    index = np.zeros((12, 24), dtype=np.uint16)
    for number in range(8):  # 2 rows of 4 rooms, walls of 2 cells
        row, col = divmod(number, 4)
        index[row * 6 : row * 6 + 4, col * 6 : col * 6 + 4] = number + 1
    level = SceneGrid2D(
        width=24,
        height=12,
        cell_size=0.1,
        min_yup=(0.0, 0.0, 0.0),
        weights=np.ones(index.shape),
        attributes={"roomIndex": index, "floorHeight": np.zeros(index.shape, dtype=np.float32)},
    )
    rgb = make_panel(level, "rooms", 0).rgb
    color = {number: tuple(rgb[tuple(np.argwhere(index == number)[0])]) for number in range(1, 9)}
    pairs = find_neighbours(index, 6)
    assert (1, 2) in pairs and (1, 5) in pairs and (1, 6) not in pairs
    assert all(color[one] != color[other] for one, other in pairs)
