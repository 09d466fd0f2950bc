"""Map descriptors: the seed's arena to the bit, other sizes, other writers, and what is wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.arena.map_descriptor import decode, draw, encode
from navbake.errors import FormatError

PART1 = "FFC07F80FF01FE03FFFFFFF3FFE7FFCFFF9C7F38FE71FCE3F87FF0FFE1FFC3FF87FF0E0E1C1F"
PART2 = "00000100001C80000000001C0000080000060001C00000080000"
# the document's own table of the explored squares, top row first
EXPLORED = """
000011100000111 000011100000111 000011111111111 000011111111111 000011111111111
000011111111111 000011111111111 001110001111111 001110001111111 001110001111111
001110001111111 001111111111111 001111111111111 001111111111111 111111111111111
111111111111111 111111110000000 111111110000000 111111110000000 111111110000000
"""


def canonical():
    return np.array([[int(c) for c in row] for row in EXPLORED.split()], dtype=bool)


@st.composite
def maps(draw_from):
    shape = draw_from(st.tuples(st.integers(1, 25), st.integers(1, 25)))
    bits = st.lists(st.booleans(), min_size=shape[0] * shape[1], max_size=shape[0] * shape[1])
    return tuple(np.array(draw_from(bits)).reshape(shape) for _ in range(2))


def test_decodes_and_encodes_the_canonical_descriptor():
    explored, obstacles = decode(PART1, PART2)
    np.testing.assert_array_equal(explored, canonical())
    assert (explored.sum(), obstacles.sum()) == (208, 15)
    assert encode(explored, obstacles) == (PART1, PART2)


def test_begins_as_the_seed_says():
    obstacles = np.zeros((20, 15), dtype=bool)
    # the 24th explored square from the bottom left, row by row
    squares = [
        (row, col) for row in range(19, -1, -1) for col in range(15) if canonical()[row, col]
    ]
    obstacles[squares[23]] = True
    part1, part2 = encode(canonical(), obstacles)
    assert (part1[:6], part2[:6]) == ("FFC07F", "000001")


def test_starts_at_the_bottom_left_and_goes_right():
    explored = np.zeros((20, 15), dtype=bool)
    explored[19, 0] = True  # bottom left: the bit after the opening 11
    obstacles = explored.copy()
    part1, part2 = encode(explored, obstacles)
    assert part1 == "E" + "0" * 74 + "3"
    assert part2 == "80"
    explored[19, 0], explored[0, 14] = False, True  # top right: the bit before the closing 11
    assert encode(explored, explored)[0] == "C" + "0" * 74 + "7"


def test_other_sizes_are_filled_up_with_zeros():
    assert encode(np.ones((1, 1)), np.ones((1, 1))) == ("F8", "80")
    assert encode(np.zeros((2, 4)), np.zeros((2, 4))) == ("C030", "")


@given(maps())
def test_what_is_encoded_is_decoded(pair):
    explored, obstacles = pair
    part1, part2 = encode(explored, obstacles)
    assert part1 == part1.upper() and len(part1) % 2 == len(part2) % 2 == 0
    known, filled = decode(part1, part2, explored.shape)
    np.testing.assert_array_equal(known, explored)
    np.testing.assert_array_equal(filled, obstacles & explored)
    assert encode(known, filled) == (part1, part2)


@given(maps())
def test_reads_other_writers(pair):
    explored, obstacles = pair
    part1, part2 = encode(explored, obstacles)
    digits = -(-int(explored.sum()) // 4)  # filled up to a digit, not to a byte
    other = decode(part1.lower(), f" {part2[:digits].lower()}\n", explored.shape)
    np.testing.assert_array_equal(other, decode(part1, part2, explored.shape))


def test_draws_unexplored_free_and_obstacles():
    assert draw([[1, 1, 0], [0, 1, 1]], [[0, 1, 1], [0, 0, 0]]) == ".#?\n?.."


@pytest.mark.parametrize(
    ("part1", "part2", "culprit"),
    [
        (PART1.replace("FFC", "FXC"), PART2, "hexadecimal digits in part 1, got 'X'"),
        (PART1, PART2[:-1] + "g", "hexadecimal digits in part 2, got 'g'"),
        (PART1[:-2], PART2, "expected 76 digits in part 1 for 20 × 15 squares, got 74"),
        (PART1 + "00", PART2, "expected 76 digits in part 1"),
        ("7" + PART1[1:], PART2, "first two bits of part 1 to be 11, got 01"),
        (PART1[:-1] + "E", PART2, "last two bits of part 1 to be 11, got 10"),
        (PART1, PART2 + "00", "expected 52 digits in part 2 .* got 54: more than it has"),
        (PART1, PART2[:-2], "expected 52 digits in part 2 .* 208 squares .* fewer"),
        (PART1, "", "expected 52 digits in part 2"),
    ],
)
def test_says_what_is_wrong(part1, part2, culprit):
    with pytest.raises(FormatError, match=culprit):
        decode(part1, part2)


def test_says_what_is_no_map_at_all():
    for part1, part2 in ((None, PART2), (PART1, None), (12, PART2)):
        with pytest.raises(FormatError, match="as a string of hexadecimal digits, got"):
            decode(part1, part2)
    with pytest.raises(FormatError, match=r"shape \(rows, cols\), each >= 1, got \[3\]"):
        decode(PART1, PART2, 3)
    with pytest.raises(FormatError, match="explored of true and false, got dtype <U1"):
        encode([["?"]], [["."]])
    with pytest.raises(FormatError, match="explored of shape"):
        encode([[1], [1, 0]], [[1]])


def test_padding_that_holds_something_is_wrong():
    with pytest.raises(FormatError, match="0s after the 1 bits of part 2"):
        decode("F8", "C0", (1, 1))
    with pytest.raises(FormatError, match="0s after the closing 11"):
        decode("F9", "80", (1, 1))


def test_refuses_maps_of_two_shapes_or_none():
    with pytest.raises(FormatError, match="one shape"):
        encode(np.ones((2, 3)), np.ones((3, 2)))
    with pytest.raises(FormatError, match=r"explored of shape \(rows, cols\)"):
        encode(np.ones(3), np.ones(3))
    with pytest.raises(FormatError, match="each >= 1"):
        decode("F8", "80", (0, 4))
