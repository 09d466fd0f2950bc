"""Rooms parted at gaps by their width against the spaces on both sides. # is wall; cells 0.1 m."""

from __future__ import annotations

import os

import numpy as np
import pytest
from scipy import ndimage

from box_worlds import box, stages_of_xml, world
from navbake.baker.rooms import segmentation
from navbake.baker.rooms.flags import LevelFlags
from navbake.baker.rooms.gaps import SpaceMerger, find_gaps
from navbake.baker.rooms.walls import find_directions, find_windows
from offices import Opening, Plan, make_plan
from offices_truth import bake_plan, count_leaks, overlaps

CELL = 0.1
SEEDS = range(1000, 1000 + max(6, int(os.environ.get("NAVBAKE_EXAMPLES", "0"))))


def hall(rows, cols):
    """An empty walled space of so many open cells."""
    is_open = np.zeros((rows + 2, cols + 2), dtype=np.bool_)
    is_open[1:-1, 1:-1] = True
    return is_open


def segment_by_gaps(is_open, cell_size=CELL, min_area=1.0, floor=None, holes=None, width=None):
    """The rooms of open cells, under a roof and away from the edge of the grid; and close calls."""
    none = np.zeros_like(is_open)
    floor = np.zeros(none.shape) if floor is None else floor
    level = LevelFlags(floor, is_open, none if holes is None else holes, none, none, none, none)
    return segmentation.segment_by_gaps(level, cell_size, min_area, width)


def count(is_open, holes=None):
    rooms = segment_by_gaps(is_open, holes=holes)[0]
    assert (rooms[~is_open] == 0).all()
    for quarters in (1, 2, 3):
        there = None if holes is None else np.rot90(holes, quarters)
        turned = segment_by_gaps(np.rot90(is_open, quarters), holes=there)[0]
        assert turned.max() == rooms.max()
    return rooms.max()


@pytest.mark.parametrize(("width", "rooms"), [(8, 2), (14, 2), (22, 2), (24, 2), (28, 1)])
def test_a_doorway_parts_up_to_two_and_a_half_metres(width, rooms):
    is_open = hall(50, 90)
    is_open[:, 45:47] = False
    is_open[10 : 10 + width, 45:47] = True
    assert count(is_open) == rooms


@pytest.mark.parametrize(("width", "rooms"), [(14, 2), (19, 1)])
def test_a_doorway_is_measured_against_the_narrower_space(width, rooms):
    is_open = hall(21, 90)
    is_open[:, 45:47] = False
    is_open[1 : 1 + width, 45:47] = True
    assert count(is_open) == rooms


def two_rooms(gap, thick, size):
    """Two rooms of size x size cells and a gap of so many cells in the wall between them."""
    is_open = hall(size, 2 * size + thick)
    is_open[:, 1 + size : 1 + size + thick] = False
    first = (size + 2 - gap) // 2
    is_open[first : first + gap, 1 + size : 1 + size + thick] = True
    return is_open


@pytest.mark.parametrize("cell_size", [0.05, 0.1, 0.07])
@pytest.mark.parametrize("door_width", [0.8, 1.0, 3.0])
def test_a_gap_wider_than_a_given_door_parts_nothing(cell_size, door_width):
    """Exact at the width along the lattice, and beyond the 2.5 m that hold without it."""
    widest = int(door_width / cell_size + 1e-9)
    for more, rooms in ((-1, 2), (0, 2), (1, 1), (2, 1)):
        is_open = two_rooms(widest + more, 2, max(60, 2 * widest))
        found = segment_by_gaps(is_open, cell_size, 1.0, width=door_width)[0]
        assert found.max() == rooms


def test_a_gap_as_wide_as_the_space_parts_nothing_however_narrow():
    is_open = two_rooms(9, 2, 10)
    assert segment_by_gaps(is_open, CELL, 0.5, width=1.0)[0].max() == 1


@pytest.mark.parametrize("cell_size", [0.05, 0.1])
def test_doors_in_walls_off_the_lattice(cell_size):
    """A wall fills every cell it touches; so gaps look narrower, by less than two cells."""
    rng = np.random.default_rng(0)
    edges = np.arange(0.0, 8.0, cell_size)
    for wall, jamb in rng.uniform(3.5, 4.5, (20, 2)):
        for gap, rooms in ((1.0, 2), (1.2, 1)):
            across = (edges + cell_size > wall) & (edges < wall + 0.12)
            along = (edges + cell_size > jamb + gap) | (edges < jamb)
            is_open = ~(across[None] & along[:, None])
            assert segment_by_gaps(is_open, cell_size, 1.0, width=1.0)[0].max() == rooms


def test_a_niche_an_l_and_pillars_part_nothing():
    niche = hall(40, 60)
    niche[1:11, :] = False
    niche[1:11, 20:38] = True
    assert count(niche) == 1
    corner = hall(60, 60)
    corner[1:38, 1:38] = False
    assert count(corner) == 1
    pillars = hall(60, 100)
    for row in (14, 32, 50):
        for col in (20, 45, 70):
            pillars[row : row + 3, col : col + 3] = False
    assert count(pillars) == 1


def test_a_passage_is_a_room_if_it_is_long():
    for length, rooms in ((30, 1), (90, 2)):
        is_open = hall(70, 70 + length)
        is_open[1:30, 71:] = is_open[50:, 71:] = False
        assert count(is_open) == rooms


def test_wide_doors_opposite_each_other_leave_a_corridor_whole():
    is_open = hall(100, 90)
    is_open[[40, 57]] = False
    for row in (40, 57):
        for col in (10, 55):
            is_open[row, col : col + 20] = True
    is_open[1:40, 44] = is_open[58:-1, 44] = False
    assert count(is_open) == 5


def test_a_wall_that_ends_in_a_wide_opening_goes_on_to_its_line():
    """Two rooms side by side, whose common opening is 3.4 m wide; the wall between stops short."""
    is_open = hall(100, 130)
    is_open[:, 60:62] = False
    is_open[34:68, 60:62] = True
    is_open[50:52, 1:46] = False
    assert count(is_open) == 3


def test_stairs_belong_to_where_they_begin():
    """A flight of 1.2 m between two rooms; without heights it is a corridor."""
    is_open = hall(40, 130)
    is_open[1:15, 45:85] = is_open[27:, 45:85] = False
    rise = np.tile(np.interp(np.arange(132), [45, 85], [0.0, 2.4]), (42, 1))
    for floor in (rise, 2.4 - rise):
        rooms = segment_by_gaps(is_open, floor=floor)[0]
        assert rooms.max() == 2
        assert rooms[20, 65] == rooms[20, 20 if floor is rise else 110]
    assert count(is_open) == 3


def test_what_is_tiny_joins_what_it_opens_to_and_what_is_shut_in_is_none():
    is_open = hall(40, 60)
    is_open[12:18, 30:33] = False
    is_open[13:17, 31] = True  # shut in, 0.04 m²
    is_open[1:9, 45] = is_open[8, 45:] = False
    is_open[4:8, 45] = True  # a closet of less than 1 m²
    rooms = segment_by_gaps(is_open, CELL, 1.2)[0]
    assert rooms.max() == 1
    assert not rooms[13:17, 31].any() and rooms[4, 50] == 1


def test_rooms_hang_together_and_turn_with_the_map():
    rng = np.random.default_rng(3)
    for _ in range(8):
        is_open = ndimage.gaussian_filter(rng.normal(size=(80, 90)), 3) > -0.05
        rooms = segment_by_gaps(is_open, CELL, 0.3)[0]
        assert (rooms[~is_open] == 0).all()
        for room in range(1, int(rooms.max()) + 1):
            assert ndimage.label(rooms == room)[1] == 1
            assert np.count_nonzero(rooms == room) * CELL**2 >= 0.3 - 1e-9


def spread(labels):
    """Labels with the cells filled that have 0; closed ones have -1."""
    label = np.array(labels, dtype=np.int32)
    open_cells = label >= 0
    label[~open_cells] = 0
    segmentation.spread_labels(label, open_cells)
    return label.tolist()


def test_cells_of_gaps_go_to_the_nearest_space():
    assert spread([[1, 0, 0, 0, 0, 2]]) == [[1, 1, 1, 2, 2, 2]]
    assert spread([[2, 0, 1]]) == [[2, 1, 1]] and spread([[1, 0, 2]]) == [[1, 1, 2]]
    assert spread([[1, 0, -1, 0], [0, -1, 0, 0]]) == [[1, 1, 0, 0], [1, 0, 0, 0]]


def test_steep_cells():
    label = np.array([[1, 1, 1, 1, 1, 2, 0, 2]], dtype=np.int32)
    floor = np.array([[0.0, 0.0, 0.2, 0.4, 0.4, 0.4, np.nan, 9.0]])
    steep = segmentation.mark_steep(label, floor, 0.3)  # a cell to both sides
    assert steep.tolist() == [[False, True, True, True, False, False, False, False]]
    assert (segmentation.mark_steep(label.T, floor.T, 0.3) == steep.T).all()


def test_numbers_follow_the_first_cells():
    label = np.array([[0, 7, 7], [2, 0, 7], [2, 9, 0]], dtype=np.int32)
    expected = [[0, 1, 1], [2, 0, 1], [2, 3, 0]]
    np.testing.assert_array_equal(segmentation.renumber(label)[0], expected)
    assert not segmentation.renumber(np.zeros((2, 2), dtype=np.int32))[0].any()


def test_holes_narrow_no_space():
    is_open = hall(32, 100)
    is_open[1:16, 40:70] = False
    holes = np.zeros_like(is_open)
    holes[1:16, 40:70] = True
    assert count(is_open, holes) == 1
    assert count(is_open) > 1


def test_nothing_open_and_no_walls():
    assert not segment_by_gaps(np.zeros((4, 5), dtype=np.bool_))[0].any()
    assert segment_by_gaps(np.ones((40, 50), dtype=np.bool_))[0].min() == 1


@pytest.mark.parametrize("angle", [0.0, 12.0, 33.0, 45.0, 78.0])
def test_walls_at_an_angle(angle):
    """Two rooms with a doorway of 1.6 m, turned."""
    x, y = np.meshgrid(np.arange(-70, 70) * CELL, np.arange(-70, 70) * CELL)
    turn = np.deg2rad(angle)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    is_open = (np.abs(u) < 4.5) & (np.abs(v) < 2.5) & ((np.abs(u) > 0.15) | (np.abs(v) < 0.8))
    assert len(find_directions(is_open, CELL)) == 2
    spaces = find_gaps(is_open, np.zeros_like(is_open), CELL, None)
    merger = SpaceMerger(spaces, CELL, None)
    merger.join_spaces()
    # 0 is for gaps; no cells between their lines are a space
    assert len(np.unique(merger.space_of_label[spaces.label])) == 3
    rooms = segment_by_gaps(is_open)[0]
    assert rooms.max() == 2
    left, right = rooms[is_open & (u < -0.4)], rooms[is_open & (u > 0.4)]
    assert len(np.unique(left)) == len(np.unique(right)) == 1
    assert left[0] != right[0]


def test_close_calls_are_told():
    is_open = hall(25, 90)
    is_open[:, 45:47] = False
    is_open[1:20, 45:47] = True
    (call,) = segment_by_gaps(is_open)[1]
    assert call.width == pytest.approx(1.9)
    assert 44 <= call.row_col[1] <= 47
    is_open[1:10, 45:47] = False
    assert segment_by_gaps(is_open)[1] == []


def test_sills_go_from_wall_to_wall():
    wall = ~hall(30, 60)
    wall[:, 30:32] = True
    wall[10:22, 30:32] = False
    low = np.zeros_like(wall)
    low[10:22, 30:32] = True  # the sill
    low[5:12, 10:20] = True  # a table
    low[1:7, 40:50] = True  # a counter along a wall
    found = find_windows(low, wall, CELL)
    assert found[10:22, 30:32].all()
    assert np.count_nonzero(found) == 24


@pytest.mark.parametrize("angle", [2.0, 4.0, 7.4, 21.0, 44.0, 82.6])
@pytest.mark.parametrize("offset", [0.0, 0.03, 0.05, 0.08])
def test_sills_of_walls_thinner_than_a_cell_at_an_angle(angle, offset):
    """The sill of 3 m in a wall of 0.08 m; in front of it a bookcase along the wall."""
    x, y = np.meshgrid(np.arange(-60, 60) * CELL, np.arange(-60, 60) * CELL)
    turn = np.deg2rad(angle)
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn) - offset
    reach = CELL / 2 * (abs(np.cos(turn)) + abs(np.sin(turn)))  # of a cell, across the wall
    line = (np.abs(v) < 0.04 + reach) & (np.abs(u) < 4.5)
    ends = (np.abs(np.abs(u) - 4.5) < 0.04 + reach) & (np.abs(v) < 4.0)
    sill = line & (np.abs(u) < 1.5)
    wall = (line & ~sill) | ends
    bookcase = (v > 0.04 + reach) & (v < 0.4) & (u > 2.0) & (u < 4.0)
    found = find_windows((sill | bookcase) & ~wall, wall, CELL)
    assert not (found & bookcase & (v > 0.04 + reach + CELL)).any()  # but for cells at the wall
    label, _ = ndimage.label(~wall & ~found & (np.abs(u) < 4.5) & (np.abs(v) < 4.0))
    sides = [set(np.unique(label[(sign * v > 0.5) & (np.abs(u) < 4.0)])) for sign in (-1, 1)]
    assert not (sides[0] & sides[1]) - {0}


@pytest.mark.parametrize("as_mesh", [False, True])
def test_rooms_of_offices_and_flats(tmp_path, as_mesh):
    """A sample; ``scripts/bench_rooms.py`` measures many."""
    shares = []
    for seed in SEEDS:
        plan = make_plan(seed)
        stages = bake_plan(plan, tmp_path, as_mesh=as_mesh)
        rooms = stages.rooms.index[0]
        shares += overlaps(rooms, plan.truth(stages.lattice))
        assert count_leaks(rooms, plan, stages.lattice) == 0
    assert np.mean(np.array(shares) >= 0.8) >= 0.9


@pytest.mark.parametrize("cell_size", [0.05, 0.08, 0.1])
@pytest.mark.parametrize(("width", "rooms"), [(1.85, 2), (1.89, 1)])
def test_a_gap_is_as_wide_as_the_geometry_at_any_size_of_cells(tmp_path, width, rooms, cell_size):
    """A room 2.4 m wide whose doorway is 0.77 or 0.79 of that: 0.78 decides, the cells don't."""
    walls = box("", 0, -0.1, 0, 6, 0, 2.5) + box("", 0, 2.4, 0, 6, 2.5, 2.5)
    walls += box("", -0.1, -0.1, 0, 0, 2.5, 2.5) + box("", 6, -0.1, 0, 6.1, 2.5, 2.5)
    walls += box("", 2.93, 0, 0, 3.03, 2.4 - width, 2.5)
    scene = world(box("floor", -0.1, -0.1, -0.1, 6.1, 2.5, 0) + walls)
    stages = stages_of_xml(tmp_path, scene, grid={"cell_size": cell_size})
    assert len(stages.rooms.table) == rooms


@pytest.mark.parametrize(("wide", "rooms"), [(0.9, 2), (1.2, 3)])
def test_a_cavity_is_no_room(tmp_path, wide, rooms):
    """Two rooms joined by a doorway, and a closed space 3 m long between their walls."""
    walls = box("", 0, 0, 0, 10, 0.1, 2.5) + box("", 0, 4.9, 0, 10, 5, 2.5)
    walls += box("", 0, 0, 0, 0.1, 5, 2.5) + box("", 9.9, 0, 0, 10, 5, 2.5)
    walls += box("", 4, 0, 0, 4.1, 3.2, 2.5) + box("", 4.1 + wide, 0, 0, 4.2 + wide, 3.2, 2.5)
    walls += box("", 4, 3.1, 0, 4.2 + wide, 3.2, 2.5) + box("", 4.5, 4.2, 0, 4.6, 5, 2.5)
    stages = stages_of_xml(tmp_path, world(box("floor", 0, 0, -0.1, 10, 5, 0) + walls))
    assert len(stages.rooms.table) == rooms
    assert (stages.rooms.index[0].flat[stages.lattice.width * 30 + 45] == 0) == (rooms == 2)


def two_rooms_turned(turn, width, thick, door, slant=0.0, chase=None):
    """Two rooms in a row, each `width` by about 4.2 m, turned by so many degrees.

    The wall between them has a doorway, its start and width as given, and may slant: its right end
    is 2 `slant` further up. A chase of so many metres, out of the wall and along it, may stand in
    the middle of the first room's left wall.
    """
    plan = Plan(np.random.default_rng(0), 2.5, np.deg2rad(turn))
    depth, length, half = 4.2, 8.4 + thick, thick / 2
    for end in (-half, length + half):
        plan.wall((-thick, end), (width + thick, end), thick)
    for side in (-half, width + half):
        plan.wall((side, 0.0), (side, length), thick)
    low, high = depth + half - slant, depth + half + slant
    plan.wall((0.0, low), (width, high), thick, [Opening(*door, 0.0, 2.1)])
    off = half * np.hypot(width, 2 * slant) / width
    plan.room((0.0, 0.0), (width, 0.0), (width, high - off), (0.0, low - off))
    plan.room((0.0, low + off), (width, high + off), (width, length), (0.0, length))
    if chase is not None:
        out, along = chase
        plan.pier("wall_chase", (0.0, (depth - along) / 2, out, (depth + along) / 2))
    plan.box("slab", (0.0, 0.0, width, length), -0.2, 0.0)
    return plan


def assert_rooms_at_all_sizes(plan, folder):
    for cell_size in (0.05, 0.08, 0.1):
        stages = bake_plan(plan, folder, as_mesh=False, cell_size=cell_size)
        rooms = stages.rooms.index[0]
        assert rooms.max() == len(plan.rooms)
        assert min(overlaps(rooms, plan.truth(stages.lattice))) > 0.8


@pytest.mark.parametrize(
    ("turn", "width", "thick", "chase"),
    [
        (15.02, 3.35, 0.29, (0.67, 0.59)),
        (64.92, 3.07, 0.15, (0.614, 0.52)),
        (79.94, 2.83, 0.13, (0.566, 0.73)),
    ],
)
def test_a_chase_that_leaves_four_fifths_of_a_room_parts_nothing(
    turn, width, thick, chase, tmp_path
):
    """As wide as the walls stand apart, also where they lean and where a line is in parts."""
    plan = two_rooms_turned(turn, width, thick, (width / 2, 0.9), chase=chase)
    assert_rooms_at_all_sizes(plan, tmp_path)


def test_a_gap_that_ends_at_a_window_ends_at_its_wall(tmp_path):
    plan = two_rooms_turned(48.5, 2.82, 0.14, (1.41, 0.9), chase=(0.56, 0.4))
    plan.boxes = [box for box in plan.boxes if box[1][0] < 2.82]  # all but the right wall
    window = Opening(2.1, 1.6, 0.9, 2.1)
    plan.wall((2.89, 0.0), (2.89, 8.54), 0.14, [window])
    assert_rooms_at_all_sizes(plan, tmp_path)


@pytest.mark.parametrize(
    ("turn", "width", "thick", "door"),
    [(9.68, 2.76, 0.08, (1.33, 0.98)), (60.31, 2.61, 0.16, (1.63, 0.96))],
)
def test_a_doorway_whose_lines_are_not_equally_long(turn, width, thick, door, tmp_path):
    assert_rooms_at_all_sizes(two_rooms_turned(turn, width, thick, door), tmp_path)


@pytest.mark.parametrize(
    ("turn", "width", "thick", "door", "slant"),
    [
        (16.26, 4.01, 0.23, (1.58, 0.85), 0.39),
        (27.33, 4.09, 0.23, (1.78, 1.05), 0.85),
        (29.87, 3.31, 0.08, (1.69, 1.27), 0.86),
    ],
)
def test_a_doorway_in_a_wall_that_slants(turn, width, thick, door, slant, tmp_path):
    assert_rooms_at_all_sizes(two_rooms_turned(turn, width, thick, door, slant), tmp_path)


def test_a_chase_deeper_than_a_wall_beside_a_wide_opening():
    """The opening begins a line above the chase's lower end."""
    is_open = hall(40, 70)
    is_open[:, 30:33] = False
    is_open[24:40, 30:33] = True
    is_open[17:25, 1:7] = False
    rooms = segment_by_gaps(is_open)[0]
    assert rooms[10, 10] == rooms[35, 10] != rooms[10, 50]


@pytest.mark.parametrize("seed", range(8))
def test_floors_that_nothing_divides_are_labelled_as_if_they_were_searched_for_gaps(seed):
    """Levels with and without walls, holes, stairs and small parts, in any order."""
    rng = np.random.default_rng(seed)
    shape = (24, 30)
    none = np.zeros(shape, dtype=np.bool_)
    levels = []
    for kind in rng.permutation(["plain", "wall", "hole", "stair", "empty", "nook", "plain"]):
        is_open = np.ones(shape, dtype=np.bool_)
        row, col = rng.integers(5, 18, 2)
        if kind in ("wall", "hole"):
            is_open[row : row + 2] = False
        if kind == "nook":
            is_open[2, :3] = is_open[:3, 2] = False
        if kind == "empty":
            is_open[:] = False
        floor = np.full(shape, 3.0)
        if kind == "stair":
            floor[:, col - 3 : col + 3] += np.linspace(0.0, 2.0, 6)
            floor[:, col + 3 :] += 2.0
        is_hole = ~is_open & (kind != "wall")
        levels.append(LevelFlags(floor, is_open, is_hole, none, none, none, none))
    segments = segmentation.label_undivided_floors(levels, CELL, 1.0)
    for level, segment in zip(levels, segments, strict=True):
        searched, _ = segmentation.segment_by_gaps(level, CELL, 1.0)
        if segment is not None:
            np.testing.assert_array_equal(segment, searched)
    assert sum(segment is None for segment in segments) == 3  # the wall, the stair and the nook
