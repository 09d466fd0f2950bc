"""What an agent explores of an arena: rays, line of sight, and the descriptor of it."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from navbake.arena.map_descriptor import ExploredMap, decode
from navbake.errors import FormatError, QueryError

ARENA = """
...............
...............
.....##........
.....##........
...............
...............
...............
...............
..#............
..#............
..#............
...............
.........####..
...............
...............
...............
...............
.....#.........
...............
...............
"""


def truth():
    return np.array([[c == "#" for c in row] for row in ARENA.split()])


def all_round(count=720):
    return np.arange(count) * 2 * np.pi / count + 1e-3


def walk_plainly(filled, x, y, angle, max_range, square=0.1):
    """Squares seen along a ray by tiny steps, and whether the last of them is an obstacle."""
    rows, cols = filled.shape
    seen = []
    for step in np.arange(0, max_range, 2e-5):
        px, py = x + step * np.cos(angle), y + step * np.sin(angle)
        col, row = int(np.floor(px / square)), rows - 1 - int(np.floor(py / square))
        if not (0 <= row < rows and 0 <= col < cols):
            return seen, False, step
        if not seen or seen[-1] != (row, col):
            seen.append((row, col))
        if filled[row, col]:
            return seen, True, step
    return seen, False, np.inf


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    st.tuples(st.integers(0, 14), st.integers(0, 19)),
    st.tuples(st.floats(0.01, 0.99), st.floats(0.01, 0.99)),
    st.floats(0, 2 * np.pi),
    st.floats(0.05, 1.5),
)
def test_a_ray_sees_what_tiny_steps_see(square, within, angle, max_range):
    filled = truth()
    x, y = (0.1 * (n + f) for n, f in zip(square, within, strict=True))
    corners = 0.1 * np.argwhere(np.ones((16, 21))) - [x, y]
    beside = corners @ [-np.sin(angle), np.cos(angle)]
    assume(np.abs(beside).min() > 1e-4)  # tiny steps jump over corners of squares
    seen, is_hit, at = walk_plainly(filled, x, y, angle, max_range)
    own = ExploredMap()
    (measured,) = own.look(filled, x, y, [angle], max_range)
    explored = set(zip(*(n.tolist() for n in np.nonzero(own.explored)), strict=True))
    if abs(at - max_range) < 1e-3:
        return  # whether the last step was one too many
    assert set(seen[:-1]) <= explored <= set(seen)
    assert own.obstacles.sum() == is_hit == np.isfinite(measured)
    if is_hit:
        assert measured == pytest.approx(at, abs=1e-4)
        assert own.obstacles[seen[-1]]


def test_nothing_behind_an_obstacle_is_seen():
    own = ExploredMap()
    ranges = own.look(truth(), 0.55, 1.05, [np.pi / 2], 2.0)  # up, towards the block at 1.6 m
    np.testing.assert_allclose(ranges, [0.55])
    column = own.explored[:, 5]
    assert column[3:10].all() and not column[:3].any() and not own.explored[:, 6].any()
    assert own.obstacles[3, 5] and own.obstacles.sum() == 1


def test_looking_round_everywhere_finds_the_arena():
    own, filled = ExploredMap(), truth()
    for row, col in np.argwhere(~filled)[::7]:
        x, y = own.lattice.positions(row, col)
        own.look(filled, x, y, all_round(), 2.5)
    assert own.explored.all()
    np.testing.assert_array_equal(own.obstacles, filled)
    known, obstacles = decode(*own.descriptor())
    assert known.all()
    np.testing.assert_array_equal(obstacles, filled)
    assert str(own) == ARENA.strip()


def test_sensors_with_ranges_of_their_own():
    own = ExploredMap()
    own.observe(0.05, 0.05, [0.0, np.pi / 2, 0.1], [0.35, np.inf, np.nan], max_range=0.3)
    assert str(own).split("\n")[-4:] == [
        ".??????????????",
        ".??????????????",
        ".??????????????",
        "....???????????",
    ]
    own.observe(0.05, 0.05, [0.0], [0.25], max_range=0.3)  # at the face between two squares
    assert str(own).split("\n")[-1] == "...#???????????"
    own.observe(0.05, 0.05, [0.0], [0.1], max_range=0.3)  # within a square
    assert str(own).split("\n")[-1] == ".#.#???????????"


def test_a_range_a_hair_short_of_a_face_was_measured_to_it():
    own = ExploredMap()
    own.observe(0.05, 0.05, [0.0], [np.float32(0.15) - 1e-7], max_range=0.8)
    assert str(own).split("\n")[-1] == "..#????????????"


def test_the_latest_counts_and_an_end_more_than_a_pass():
    own = ExploredMap()
    own.observe(0.05, 0.05, [0.0, 0.0], [0.15, 0.45], max_range=0.8)
    assert str(own).split("\n")[-1] == "..#..#?????????"
    own.observe(0.05, 0.05, [0.0], [0.45], max_range=0.8)
    assert str(own).split("\n")[-1] == ".....#?????????"
    own.enter(0.55, 0.05)
    assert str(own).split("\n")[-1] == "......?????????"


def test_ranges_may_reach_far_beyond_the_arena():
    """A sensor that sees kilometres costs no more than one that sees the arena."""
    near, far = ExploredMap(), ExploredMap()
    angles = np.linspace(0, 2 * np.pi, 90)
    near.observe(0.73, 0.91, angles, np.full(90, np.inf), max_range=3.0)
    far.observe(0.73, 0.91, angles, np.full(90, np.inf), max_range=1e12)
    far.observe(0.73, 0.91, angles, np.full(90, 1e11), max_range=1e12)
    np.testing.assert_array_equal(far.explored, near.explored)
    assert not far.obstacles.any()


def test_walls_of_the_arena_are_no_part_of_it():
    own = ExploredMap()
    own.observe(1.45, 1.95, [0.0, np.pi / 2], [0.05, 0.05], max_range=0.8)
    assert own.explored.sum() == 1 and not own.obstacles.any()


def test_goes_on_from_a_descriptor_elsewhere():
    own = ExploredMap((4, 6), square=0.5, corner=(-1.0, 2.0))
    own.enter(-0.9, 2.1)
    again = ExploredMap.from_descriptor(*own.descriptor(), (4, 6), square=0.5, corner=(-1.0, 2.0))
    again.enter(1.9, 3.9)
    assert again.explored[3, 0] and again.explored[0, 5] and again.explored.sum() == 2


def test_says_what_is_wrong():
    own = ExploredMap()
    with pytest.raises(QueryError, match=r"x 0 to 1\.5, y 0 to 2, got \(1\.6, 0\)"):
        own.enter(1.6, 0)
    with pytest.raises(QueryError, match="within the arena"):
        own.observe(np.nan, 0, [0], [1], 1)
    with pytest.raises(QueryError, match="as many angles as ranges, got 2 and 1"):
        own.observe(0.5, 0.5, [0, 1], [1], 1)
    with pytest.raises(QueryError, match="ranges >= 0 m"):
        own.observe(0.5, 0.5, [0], [-1], 1)
    with pytest.raises(QueryError, match="`max_range` > 0 m, got 0"):
        own.observe(0.5, 0.5, [0], [1], 0)
    with pytest.raises(QueryError, match="finite angles"):
        own.observe(0.5, 0.5, [np.nan], [1], 1)
    with pytest.raises(QueryError, match=r"ranges \[m\] of shape \(n,\), got \['far'\]"):
        own.observe(0.5, 0.5, [0], ["far"], 1)
    free = np.zeros((20, 15))
    with pytest.raises(QueryError, match="`max_range` > 0 m, got inf"):
        own.look(free, 0.5, 0.5, [0], np.inf)
    with pytest.raises(QueryError, match=r"angles \[rad\] of shape \(n,\)"):
        own.look(free, 0.5, 0.5, [[0, 1]], 1)
    with pytest.raises(QueryError, match=r"`truth` of shape \(20, 15\), got \(2, 2\)"):
        own.look(np.zeros((2, 2)), 0.5, 0.5, [0], 1)
    for shape in ((0, 5), (2.5, 5), 20, (1, 2, 3)):
        with pytest.raises(FormatError, match=r"shape \(rows, cols\), each >= 1"):
            ExploredMap(shape)
    with pytest.raises(FormatError, match="at most 100000000 squares"):
        ExploredMap((10**6, 10**6))
    with pytest.raises(QueryError, match="lower left corner as x, y"):
        ExploredMap(corner=(np.nan, 0))
    with pytest.raises(QueryError, match="edge > 0 m, got -1"):
        ExploredMap(square=-1)
