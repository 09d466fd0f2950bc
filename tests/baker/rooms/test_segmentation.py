"""Rooms from walls alone, on maps one can read: # is wall, everything else is open.

A cell is 0.5 m wide, so a door of 1 m is two cells.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from navbake.baker.rooms.segmentation import renumber, segment_rooms, wall_nodes


def read(art):
    rows = art.strip("\n").split("\n")
    width = max(map(len, rows))
    return np.array([[cell != "#" for cell in row.ljust(width)] for row in rows])


def draw(rooms, is_open):
    signs = np.where(is_open, ".", "#")
    for row, col in zip(*np.nonzero(rooms), strict=True):
        signs[row, col] = chr(ord("a") + rooms[row, col] - 1)
    return "\n".join("".join(row) for row in signs)


def check(expected, door_width=1.0, min_area=1.0, floor=None):
    """Segment an expected map's open cells and compare."""
    expected = expected.strip("\n")
    is_open = read(expected)
    rooms = segment_rooms(is_open, 0.5, door_width, min_area, floor)
    assert draw(rooms, is_open) == expected
    for quarters in (1, 2, 3):
        other = segment_rooms(
            np.rot90(is_open, quarters),
            0.5,
            door_width,
            min_area,
            None if floor is None else np.rot90(floor, quarters),
        )
        np.testing.assert_array_equal(other, renumber(np.rot90(rooms, quarters)))


def test_a_door_parts_two_rooms_in_its_middle():
    check("""
#################
#aaaaaa##bbbbbbb#
#aaaaaa##bbbbbbb#
#aaaaaaabbbbbbbb#
#aaaaaaabbbbbbbb#
#aaaaaa##bbbbbbb#
#aaaaaa##bbbbbbb#
#################
""")


def test_a_cell_as_near_to_two_rooms_goes_to_the_larger():
    check("""
###############
#aaaaaa#bbbbbb#
#aaaaaa#bbbbbb#
#aaaaaa#bbbbbb#
#aaaaaabbbbbbb#
#aaaaaabbbbbbb#
#aaaaaa#bbbbbb#
########bbbbbb#
########bbbbbb#
###############
""")


def test_a_wider_gap_parts_nothing():
    check("""
###############
#aaaaaa#aaaaaa#
#aaaaaa#aaaaaa#
#aaaaaaaaaaaaa#
#aaaaaaaaaaaaa#
#aaaaaaaaaaaaa#
#aaaaaa#aaaaaa#
###############
""")


def test_a_narrow_corridor_is_a_room_where_it_goes_on_behind_the_mouths():
    check("""
##########################
#aaaaaa############bbbbbb#
#aaaaaa############bbbbbb#
#aaaaaa############bbbbbb#
#aaaaaa############bbbbbb#
#aaaaaaccccccccccccbbbbbb#
#aaaaaaccccccccccccbbbbbb#
##########################
""")


def test_bends_and_crossings_of_corridors_part_nothing():
    check("""
#########################
#aaaaaaaa#######bbbbbbbb#
#aaaaaaaa#######bbbbbbbb#
#aaaaaaaaacccccbbbbbbbbb#
#aaaaaaaaacccccbbbbbbbbb#
#aaaaaaaa##cc###bbbbbbbb#
###########cc############
###########cc############
###########dd############
#########dddddddd########
#########dddddddd########
#########dddddddd########
#########dddddddd########
#########################
""")
    check("""
########aa########
########aa########
########aa########
aaaaaaaaaaaaaaaaaa
aaaaaaaaaaaaaaaaaa
########aa########
########aa########
########aa########
""")


def test_a_slanting_door_is_cut_from_jamb_to_jamb():
    check("""
#################
#aaaaa#bbbbbbbbb#
#aaaaa#bbbbbbbbb#
#aaaaa##bbbbbbbb#
#aaaaaa#bbbbbbbb#
#aaaaaaabbbbbbbb#
#aaaaaaaa##bbbbb#
#aaaaaaaaa#bbbbb#
#aaaaaaaaa#bbbbb#
#################
""")


def test_what_is_tiny_joins_the_room_it_opens_to_and_what_is_shut_in_is_none():
    check("""
############
#aaaaaa#a###
#aaaaaaaa###
#aaaaaa#####
#aaaaaa#bbb#
#aaaaaa#bbb#
############
""")
    check(
        """
############
#aaaaaa#a###
#aaaaaaaa###
#aaaaaa#####
#aaaaaa#...#
#aaaaaa#...#
############
""",
        min_area=2.0,
    )


def test_a_crack_is_no_room_however_long():
    check(
        """
##################
##################
##################
#aaaaaaaaaaaaaaaa#
#aaaaaaaaaaaaaaaa#
#aaaaaaaaaaaaaaaa#
##################
#................#
##################
""",
        door_width=1.4,
        min_area=4.0,
    )


def test_stairs_belong_to_where_they_begin():
    """Two cells wide: without heights it is a corridor."""
    art = """
######################
#aaaaaa#######bbbbbbb#
#aaaaaa#######bbbbbbb#
#aaaaaaaaaaaabbbbbbbb#
#aaaaaaaaaaaabbbbbbbb#
#aaaaaa#######bbbbbbb#
######################
"""
    rise = np.interp(np.arange(22), [6, 14], [0.0, 2.4])
    floor = np.tile(rise, (7, 1))
    check(art, floor=floor)
    apart = segment_rooms(read(art), 0.5, 1.0, 1.0)
    assert apart.max() == 3


def test_a_door_wider_than_everything():
    rooms = segment_rooms(two_rooms(9, 1), 0.1, 1e9, 1.0)
    assert rooms.max() == 1
    assert (rooms > 0).sum() == two_rooms(9, 1).sum()


def test_nothing_open():
    assert not segment_rooms(np.zeros((4, 5), dtype=bool), 0.1, 1.0, 1.0).any()


def two_rooms(gap, thick, size=60):
    """Two rooms of size x size cells and a gap of so many cells in the wall between them."""
    is_open = np.zeros((size + 2, 2 * size + thick + 2), dtype=bool)
    is_open[1:-1, 1 : 1 + size] = is_open[1:-1, -1 - size : -1] = True
    first = (size + 2 - gap) // 2
    is_open[first : first + gap] |= is_open[1]
    is_open[first : first + gap, 1 + size : 1 + size + thick] = True
    return is_open


@pytest.mark.parametrize("cell_size", [0.05, 0.1, 0.07])
@pytest.mark.parametrize("thick", [1, 2, 3])
@pytest.mark.parametrize("door_width", [0.8, 0.9, 1.0])
def test_exact_at_the_width_along_the_lattice(cell_size, thick, door_width):
    widest = int(door_width / cell_size + 1e-9)
    for gap in (widest - 3, widest - 1, widest):
        assert segment_rooms(two_rooms(gap, thick), cell_size, door_width, 1.0).max() == 2
    for gap in (widest + 1, widest + 2):
        assert segment_rooms(two_rooms(gap, thick), cell_size, door_width, 1.0).max() == 1


@pytest.mark.parametrize("cell_size", [0.05, 0.1])
def test_walls_off_the_lattice(cell_size):
    """A wall fills every cell it touches; so gaps look narrower, by less than two cells."""
    rng = np.random.default_rng(0)
    edges = np.arange(0.0, 8.0, cell_size)
    for _ in range(20):
        wall, jamb = rng.uniform(3.5, 4.5, 2)
        for gap, count in ((1.0, 2), (1.2, 1)):
            across = (edges + cell_size > wall) & (edges < wall + 0.12)
            along = (edges + cell_size > jamb + gap) | (edges < jamb)
            is_open = ~(across[None] & along[:, None])
            assert segment_rooms(is_open, cell_size, 1.0, 1.0).max() == count


@pytest.mark.parametrize("width", [1.6, 1.15])
def test_a_corridor_at_an_angle_is_one_room(width):
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(160) * 0.1 - 8.0, np.arange(160) * 0.1 - 8.0)
    for _ in range(25):
        turn, shift = rng.uniform(0.1, 1.4), rng.uniform(-0.5, 0.5)
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        is_open = (np.abs(across - shift) <= width / 2) & (np.abs(along) <= 6.0)
        assert segment_rooms(is_open, 0.1, 1.0, 1.0).max() == 1


def test_the_same_rooms_after_a_turn():
    """Random floor plans, whose rooms all differ in size."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        is_open = np.ones((90, 110), dtype=bool)
        is_open[[0, -1]] = is_open[:, [0, -1]] = False
        for line in rng.choice(np.arange(15, 75, 4), 3, replace=False):
            is_open[line : line + rng.integers(1, 3)] = False
        for line in rng.choice(np.arange(15, 95, 4), 3, replace=False):
            is_open[:, line : line + rng.integers(1, 3)] = False
        for row, col in zip(rng.integers(2, 80, 30), rng.integers(2, 100, 30), strict=True):
            is_open[row : row + rng.integers(2, 9), col : col + rng.integers(2, 9)] |= True
        rooms = segment_rooms(is_open, 0.1, 0.7, 0.5)
        assert (rooms[~is_open] == 0).all()
        for quarters in (1, 2, 3):
            other = segment_rooms(np.rot90(is_open, quarters), 0.1, 0.7, 0.5)
            np.testing.assert_array_equal(other, renumber(np.rot90(rooms, quarters)))


def test_rooms_hang_together():
    rng = np.random.default_rng(3)
    for _ in range(20):
        is_open = ndimage.gaussian_filter(rng.normal(size=(80, 90)), 3) > -0.05
        rooms = segment_rooms(is_open, 0.1, 0.6, 0.3)
        for room in range(1, int(rooms.max()) + 1):
            assert ndimage.label(rooms == room)[1] == 1
            assert np.count_nonzero(rooms == room) * 0.01 >= 0.3 - 1e-9


def test_wall_nodes_touch_walls():
    is_open = np.array([[True, False], [True, True]])
    nodes = wall_nodes(is_open)
    assert nodes.shape == (5, 5)
    assert nodes[[0, -1]].all()
    assert nodes[:, [0, -1]].all()
    assert draw(nodes[1:-1, 1:-1].astype(int), np.ones((3, 3), dtype=bool)) == ".aa\n.aa\n..."


def test_numbers_follow_the_first_cells():
    label = np.array([[0, 7, 7], [2, 0, 7], [2, 9, 0]], dtype=np.int32)
    expected = [[0, 1, 1], [2, 0, 1], [2, 3, 0]]
    np.testing.assert_array_equal(renumber(label), expected)
    assert not renumber(np.zeros((2, 2), dtype=np.int32)).any()
