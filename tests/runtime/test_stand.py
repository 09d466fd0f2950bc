"""Poses of a robot's base that reaches things, against brute force over all cells and headings."""

from __future__ import annotations

import math
import re
from fractions import Fraction
from functools import cache

import numpy as np
import pytest

import navbake
from navbake.errors import QueryError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.runtime.path_finder import PathFinder
from project_paths import GOLDEN

CELL = 0.1
NAMES = {
    "#": {"walls": ["wall"]},
    "D": {"doors": ["door"]},
    "T": {"objects": ["table"]},
    "c": {"objects": ["cup_1", "table"]},
    "d": {"objects": ["cup_2", "table"]},
    "p": {"objects": ["picture"], "walls": ["wall"]},
    "b": {"objects": ["box"]},
    "r": {"objects": ["rug"]},
}
BASE = [(0.17, 0.08), (-0.12, 0.08), (-0.12, -0.08), (0.17, -0.08)]  # its axis isn't its middle

HEIGHTS = {
    "table": (0.0, 0.7),
    "cup_1": (0.7, 0.8),
    "cup_2": (0.7, 0.8),
    "box": (0.0, 0.5),
    "wall": (0.0, 2.4),
}

KITCHEN = """
................
................
................
.....TTTTTT.....
.....TcTTTT.....
.....TTTTTT.....
................
....bb....rr....
....bb..........
################
................
................
"""


def make_level(text, heights=None, ground=0.0, inset=0.0):
    """A level from a map: a dot is free, a space has no floor, letters are in `NAMES`.

    With `heights`, name -> lower and upper end [m], the file has boxes: of the things' cells, and
    smaller by `inset` on each side.
    """
    letters = np.array([list(row) for row in text.strip("\n").split("\n")])
    free = np.isin(letters, [".", "r"])
    height, width = letters.shape
    user_data = {
        cell: NAMES[letter]
        for cell, letter in enumerate(letters.ravel().tolist())
        if letter in NAMES
    }
    boxes = {}
    for name, (bottom, top) in (heights or {}).items():
        cells = np.array([cell for cell, entry in user_data.items() if name in list_names(entry)])
        if len(cells):
            rows, cols = np.divmod(cells, width)
            corners = [
                cols.min() * CELL + inset,
                (height - 1 - rows.max()) * CELL + inset,
                bottom + ground,
                (cols.max() + 1) * CELL - inset,
                (height - rows.min()) * CELL - inset,
                top + ground,
            ]
            boxes[name] = [float(number) for number in corners]
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=CELL,
        min_yup=(0.0, ground, -height * CELL),
        weights=np.where(free, 1.0, np.inf),
        attributes={
            "occupancy": (~free).astype(np.uint8),
            "floorHeight": np.where(letters == " ", np.nan, ground).astype(np.float32),
        },
        user_data=user_data,
        metadata={
            "traversableFloorHeight": 0.25,
            "agentHeight": 1.2,
            "sceneId": "map",
            "navbake": {"boxes": boxes},
        },
    )


def random_map(seed):
    """A map with walls, a table with a cup, boxes and a rug, and the heights of all."""
    rng = np.random.default_rng(seed)
    letters = np.full(rng.integers(10, 18, 2), ".")
    for letter, count in (("r", 2), ("T", 2), ("b", 2), ("#", 3)):
        for _ in range(count):
            row, col = rng.integers(0, np.array(letters.shape) - 2)
            tall, wide = rng.integers(1, 6, 2)
            if letter == "#":
                tall = 1
            letters[row : row + tall, col : col + wide] = letter
    row, col = rng.permutation(np.argwhere(letters == "T"))[0]
    letters[row, col] = "c"
    table = rng.uniform(0.5, 1.1)
    heights = {
        "table": (0.0, table),
        "cup_1": (table, table + 0.1),
        "box": (0.0, rng.uniform(0.3, 1.5)),
        "rug": (0.0, 0.02),
        "wall": (0.0, 2.5),
    }
    return "\n".join("".join(line) for line in letters.tolist()), heights


# ---------------------------------------------------------------- brute force


@cache
def find_crossing(end, cell) -> tuple[Fraction, Fraction]:
    """The shares of a line at which it enters a cell and leaves it.

    The line begins in the middle of cell 0, 0 and ends in that of `end`.
    """
    low, high = Fraction(0), Fraction(1)
    for length, place in zip(end, cell, strict=True):
        sides = [Fraction(2 * place - 1, 2), Fraction(2 * place + 1, 2)]
        if length == 0:
            if not sides[0] < 0 < sides[1]:
                return Fraction(0), Fraction(0)
            continue
        inside = sorted(side / length for side in sides)
        low, high = max(low, inside[0]), min(high, inside[1])
    return low, high


def find_corners(line):
    """The corners that a line runs through: its share up to there, and the two cells beside."""
    (row_0, col_0), (row_1, col_1) = line
    rows, cols = abs(row_1 - row_0), abs(col_1 - col_0)
    for step in range(rows if cols else 0):
        row = Fraction(2 * step + 1, 2)
        col = row * cols / rows
        if col.denominator == 2:
            down, right = math.copysign(1, row_1 - row_0), math.copysign(1, col_1 - col_0)
            above, before = int(row_0 + down * step), int(col_0 + right * (col - Fraction(1, 2)))
            yield row / rows, (int(above + down), before), (above, int(before + right))


def hides(level, cell, lowest, highest, name, aims) -> bool:
    """Whether a thing in a cell is between two heights.

    Nothing hides a target in its cells, and nothing that shares them in the cells beside.
    """
    if cell in aims:
        return False
    companions = {name}
    if any(max(abs(cell[0] - row), abs(cell[1] - col)) == 1 for row, col in aims):
        for row, col in aims:
            companions |= set(level.user_data[row * level.width + col].get("objects", []))
    entry = level.user_data.get(cell[0] * level.width + cell[1], {})
    boxes = level.metadata["navbake"]["boxes"]
    names = list_names(entry)
    if not names:
        return bool(level.occupancy[cell])
    for thing in names:
        bottom, top = (boxes[thing][2], boxes[thing][5]) if thing in boxes else (-9.0, 9.0)
        if thing not in companions and lowest < top - 1e-3 and highest > bottom + 1e-3:
            return True
    return False


def is_in_sight(level, line, name, aims, eye) -> bool:
    box = level.metadata["navbake"]["boxes"].get(name)
    end = eye if box is None else min(max(eye, box[2]), box[5])

    def height_at(share):
        return eye + float(share) * (end - eye)

    (row_0, col_0), (row_1, col_1) = line
    for row in range(min(row_0, row_1), max(row_0, row_1) + 1):
        for col in range(min(col_0, col_1), max(col_0, col_1) + 1):
            low, high = find_crossing((row_1 - row_0, col_1 - col_0), (row - row_0, col - col_0))
            heights = sorted([height_at(low), height_at(high)])
            is_crossed = (row, col) != (row_0, col_0) and low < high
            if is_crossed and hides(level, (row, col), *heights, name, aims):
                return False
    return not any(
        all(hides(level, cell, height_at(share), height_at(share), name, aims) for cell in cells)
        for share, *cells in find_corners(line)
    )


def list_names(entry) -> list[str]:
    return [name for names in entry.values() for name in names]


def find_by_brute_force(level, name, reach, masks, facing, sight, height=None):
    """Each cell where a base can stand, and the headings at which it can.

    Args:
        masks: where the footprint fits, at each of 64 headings; None for a base without one.
    """
    names = {divmod(cell, level.width): entry for cell, entry in level.user_data.items()}
    box = level.metadata["navbake"]["boxes"].get(name)
    own = [cell for cell, entry in names.items() if name in list_names(entry)]
    aims = own
    if sight:
        aims = [
            cell
            for cell in own
            if not {*names[cell].get("walls", []), *names[cell].get("doors", [])} - {name}
        ] or own

    bases = np.argwhere(level.free)

    def measure(cells):
        """From each base to each cell's square: the least distance, the greatest, and its middle.

        A square is cut to the box.
        """
        points = (np.array([0.5, level.height - 0.5]) + bases[:, ::-1] * [1, -1])[:, None] * CELL
        low = (np.array([0, level.height - 1]) + np.array(cells)[:, ::-1] * [1, -1]) * CELL
        high = low + CELL
        if box:
            low, high = np.maximum(low, box[:2]), np.minimum(high, box[3:5])
        gaps = np.maximum(np.maximum(low - points, points - high), 0)
        spans = np.maximum(high - points, points - low)
        # the shoulder's is measured to the nearest height of the box
        gap = 0.0 if height is None else max(box[2] - height, height - box[5], 0)
        least = np.sqrt(np.square(gaps).sum(axis=2) + gap**2)
        greatest = np.sqrt(np.square(spans).sum(axis=2) + gap**2)
        return least, greatest, (low + high) / 2 - points

    nearest = measure(own)[0].min(axis=1)
    _, farthest, middles = measure(aims)
    eye = 1.2 if sight is True else sight
    stands = {}
    for number, base in enumerate(map(tuple, bases.tolist())):
        if nearest[number] < reach[0] - 1e-9:
            continue
        seen = []
        for k in np.flatnonzero(farthest[number] <= reach[1] + 1e-9).tolist():
            if not sight or is_in_sight(level, (base, aims[k]), name, aims, eye):
                seen.append((farthest[number, k], middles[number, k]))
        if not seen:
            continue
        # of squares at one distance, the first counts
        x, y = min(seen, key=lambda distance_and_middle: round(distance_and_middle[0], 9))[1]
        if abs(x) < 1e-9 and abs(y) < 1e-9:
            x, y = middles[number].mean(axis=0)
        headings = {math.atan2(round(y, 9) + 0.0, round(x, 9) + 0.0)}
        if masks is not None:
            tested = range(64)
            if facing:
                tested = {round(heading / (2 * math.pi / 64)) % 64 for heading in headings}
            headings = {k * 2 * math.pi / 64 for k in tested if masks[k][base]}
        if headings:
            stands[base] = headings
    return stands


def angle_between(first, second):
    return abs((first - second + math.pi) % (2 * math.pi) - math.pi)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(
    ("footprint", "facing", "sight"),
    [
        (None, "target", True),
        (None, "target", False),
        (BASE, "target", 0.7),
        (BASE, None, True),
    ],
)
def test_bases_stand_where_brute_force_over_all_cells_and_headings_finds_that_they_can(
    seed, footprint, facing, sight
):
    text, heights = random_map(seed)
    level = make_level(text, heights if seed % 3 else None, inset=0.03 * (seed % 2))
    finder = PathFinder(level)
    masks = None if footprint is None else level.inflate_footprint(footprint, 64)[0]
    rules = {"footprint": footprint, "facing": facing, "sight": sight}
    for name in ("cup_1", "box", "rug", "wall"):
        reach = ((0.0, 0.45), (0.12, 0.3), (0.2, 0.5))[(seed + len(name)) % 3]
        expected = find_by_brute_force(level, name, reach, masks, facing, sight)
        (region,) = finder.stand_region(f"object:{name}", reach=reach, **rules)
        assert set(map(tuple, np.argwhere(region).tolist())) == expected.keys()
        poses = finder.stand_poses(f"object:{name}", reach=reach, count=999, spread=0, **rules)
        assert len(poses) == len(expected)
        assert (name in poses.why_not) == (not expected)
        for position, heading in zip(poses.positions, poses.headings, strict=True):
            cell = finder.cell_at(position)
            headings = expected[cell.row, cell.col]
            if footprint is not None or facing:
                assert min(angle_between(heading, other) for other in headings) < 1e-6


@pytest.mark.parametrize("scene", ["house", "tower"])
def test_a_footprint_fits_on_every_storey_where_it_fits_on_the_whole_grid(scene):
    grid = navbake.load(GOLDEN / f"{scene}.grid.json.gz")
    finder = PathFinder(grid)
    names = finder.search.names.list_objects()[:8]
    targets = [f"object:{name}" for name in names]
    rules = {"reach": (0.2, 0.8), "sight": False, "count": None}
    without_footprint = finder.stand_poses(targets, **rules)
    poses = finder.stand_poses(targets, footprint=BASE, **rules)
    masks = np.concatenate(
        [mask.reshape(64, -1) for mask in grid.inflate_footprint(BASE, 64)], axis=1
    )
    cells = finder.search.flat.cells_at(without_footprint.positions)
    heading_index = np.rint(without_footprint.headings / (2 * math.pi / 64)).astype(int) % 64
    fits = masks[heading_index, cells]
    np.testing.assert_array_equal(poses.positions, without_footprint.positions[fits])
    np.testing.assert_array_equal(poses.target_index, without_footprint.target_index[fits])
    assert len(poses) > 100 and not fits.all()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("height", [0.2, 0.9, 1.4])
def test_a_shoulder_reaches_in_space_what_brute_force_over_points_of_the_box_finds(seed, height):
    text, heights = random_map(seed)
    level = make_level(text, heights, inset=0.02 * (seed % 2))
    finder = PathFinder(level)
    reach = ((0.0, 0.55), (0.3, 0.7))[seed % 2]
    for name in ("cup_1", "box", "table"):
        for sight in (True, False):
            rules = {"reach": reach, "height": height, "sight": sight}
            expected = find_by_brute_force(level, name, reach, None, "target", sight, height)
            poses = finder.stand_poses(f"object:{name}", count=None, **rules)
            cells = level.cells_at(poses.positions)
            stands = set(zip(cells.row.tolist(), cells.col.tolist(), strict=True))
            assert stands == expected.keys()
        # the things' squares as points in space, 11 along each edge, over the height of their box
        x_low, y_low, z_low, x_high, y_high, z_high = level.metadata["navbake"]["boxes"][name]
        steps = np.linspace(0.0, CELL, 11)
        z = np.linspace(z_low, z_high, 21)
        squares = []
        for cell, entry in level.user_data.items():
            if name in list_names(entry):
                row, col = divmod(cell, level.width)
                x = np.clip(col * CELL + steps, x_low, x_high)
                y = np.clip((level.height - 1 - row) * CELL + steps, y_low, y_high)
                squares.append((x, y, z))
        for position, distance in zip(poses.positions, poses.distances, strict=True):
            shoulder = position + np.array([0.0, 0.0, height])
            # the nearest point of a square has the nearest x, the nearest y and the nearest z
            nearest = min(
                math.hypot(
                    *(np.abs(axis - at).min() for axis, at in zip(square, shoulder, strict=True))
                )
                for square in squares
            )
            assert distance <= nearest + 1e-9 and nearest - distance < 0.02
            assert reach[0] - 1e-9 <= nearest <= reach[1] + 1e-9


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("footprint", "tolerance"), [(None, 0.4), (BASE, 0.4), (BASE, None)])
def test_a_pose_reaches_where_brute_force_finds_it_and_faces_the_target(seed, footprint, tolerance):
    text, heights = random_map(seed)
    level = make_level(text, heights, inset=0.02)
    finder = PathFinder(level)
    rng = np.random.default_rng(seed)
    facing = None if tolerance is None else "target"
    masks = None if footprint is None else level.inflate_footprint(footprint, 64)[0]
    expected = find_by_brute_force(level, "box", (0.0, 0.5), masks, facing, True)
    sides = np.array([level.width, level.height]) * CELL
    positions = np.column_stack([rng.uniform(-0.1, sides + 0.1, (800, 2)), np.zeros(800)])
    headings = rng.uniform(-7.0, 7.0, 800)
    reaches = finder.can_reach(
        "object:box",
        positions.reshape(20, 40, 3),
        headings.reshape(20, 40),
        reach=(0.0, 0.5),
        footprint=footprint,
        tolerance=tolerance,
    )
    assert reaches.shape == (20, 40)
    truths = []
    for position, heading in zip(positions, headings, strict=True):
        cell = finder.cell_at(position)
        base = None if cell is None else (cell.row, cell.col)
        truth = base in expected
        if truth and tolerance is not None:
            truth = min(angle_between(heading, other) for other in expected[base]) <= tolerance
        if truth and masks is not None:
            truth = masks[round(heading / (2 * math.pi / 64)) % 64][base]
        truths.append(truth)
    assert reaches.ravel().tolist() == truths and (any(truths) or not expected)


def test_poses_without_a_count_are_in_all_cells_of_the_region():
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    poses = finder.stand_poses(["object:cup_1", "object:box"], count=None)
    for index, name in enumerate(("cup_1", "box")):
        (region,) = finder.stand_region(f"object:{name}")
        cells = finder.grid.cells_at(poses.positions[poses.target_index == index])
        np.testing.assert_array_equal(
            cells.row * region.shape[1] + cells.col, np.flatnonzero(region)
        )
    assert finder.can_reach("object:box", *poses_of(poses, 1)).all()
    assert finder.can_reach(["object:cup_1", "object:box"], poses.positions, poses.headings).all()


def poses_of(poses, target):
    is_of_target = poses.target_index == target
    return poses.positions[is_of_target], poses.headings[is_of_target]


@pytest.mark.parametrize(
    ("headings", "rules", "message"),
    [
        ([0.0, 0.0], {}, r"expected finite headings of shape \(1,\), one for each position"),
        ([math.nan], {}, "expected finite headings"),
        ([0.0], {"tolerance": -0.1}, "expected a tolerance >= 0 rad, or None for any heading"),
    ],
)
def test_a_wrong_heading_is_one_clear_line(headings, rules, message):
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    with pytest.raises(QueryError, match=message):
        finder.can_reach("object:box", [(0.5, 0.5, 0.0)], headings, **rules)


# ---------------------------------------------------------------- reach and sight


def test_a_cup_is_reached_over_its_table_and_not_from_behind_a_wall():
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    poses = finder.stand_poses("object:cup_1", count=99, spread=0.0, reach=(0.1, 0.7))
    cells = [finder.cell_at(position) for position in poses.positions]
    assert {cell.row for cell in cells} >= {0, 1, 2, 6}
    assert all(cell.row < 9 for cell in cells)
    for position, heading in zip(poses.positions, poses.headings, strict=True):
        bearing = math.atan2(0.75 - position[1], 0.65 - position[0])
        assert angle_between(heading, bearing) < 1e-9
    (region,) = finder.stand_region("object:cup_1", reach=(0.1, 0.7), sight=False)
    assert region[10].any()  # through the wall


def test_what_stands_beside_a_thing_hides_it():
    # the box is 0.1 m from the table, and higher or lower: the grid doesn't say
    level = make_level("...........\n....TTT....\n...........\n....bbb....\n...........")
    (region,) = PathFinder(level).stand_region("object:table", reach=(0.05, 0.5))
    assert not region[4, 4:7].any() and region[0, 4:7].all()


def test_a_picture_in_a_wall_is_in_sight_of_the_side_where_it_hangs():
    level = make_level(".......\n.......\n###p###\n...b...\n.......\n.......")
    level.user_data[level.width + 3] = {"objects": ["picture"]}  # 0.1 m before the wall
    finder = PathFinder(level)
    (region,) = finder.stand_region("object:picture", reach=(0.0, 0.5))
    assert region[:2].any() and not region[3:].any()


def test_a_closed_door_hides_what_is_behind_it_and_is_a_target_itself():
    finder = PathFinder(make_level("...bb\n.....\n##D##\n.....\n....."))
    (region,) = finder.stand_region("object:box", reach=(0.0, 0.6))
    assert region[1].any() and not region[3:].any()
    (region,) = finder.stand_region("object:door", reach=(0.0, 0.3))
    assert region[1].any() and region[3].any()


def test_the_distance_to_a_point_is_exact_and_in_space_with_a_height():
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    cup = (0.63, 0.77, 0.8)
    poses = finder.stand_poses(cup, count=999, spread=0.0)
    distances = np.hypot(*(poses.positions[:, :2] - cup[:2]).T)
    np.testing.assert_allclose(poses.distances, distances, rtol=0, atol=1e-12)
    assert len(poses) and (distances >= 0.3).all() and (distances <= 0.8).all()
    assert poses.targets == ("0.63, 0.77, 0.8",)
    bearings = np.arctan2(cup[1] - poses.positions[:, 1], cup[0] - poses.positions[:, 0])
    np.testing.assert_allclose(poses.headings, bearings, rtol=0, atol=1e-12)
    in_space = finder.stand_poses(cup, count=999, spread=0.0, height=1.3)
    shoulder_offsets = in_space.positions - cup + np.array([0.0, 0.0, 1.3])
    distances = np.linalg.norm(shoulder_offsets, axis=1)
    np.testing.assert_allclose(in_space.distances, distances, rtol=0, atol=1e-12)
    assert 0 < len(in_space) < len(poses) and (distances <= 0.8).all()


def test_an_obstacle_that_is_added_is_in_the_way():
    level = make_level(KITCHEN)
    finder = PathFinder(level)
    before = finder.stand_region("object:box", reach=(0.1, 0.4))[0]
    level.block(disc=((0.2, 0.4), 0.1))
    after = finder.stand_region("object:box", reach=(0.1, 0.4))[0]
    assert after.sum() < before.sum() and not (after & ~before).any()


def test_each_level_has_poses_for_what_stands_on_it():
    below = make_level("........\n...bb...\n........")
    above = make_level("........\n........\n...cc...\n........", ground=3.0)
    metadata = below.metadata
    grid = MultiLevelGrid(grids=[below, above], cell_size=CELL, metadata=metadata)
    finder = PathFinder(grid)
    poses = finder.stand_poses(["object:box", "object:cup_1"], reach=(0.0, 0.3), count=4)
    assert (poses.positions[poses.target_index == 0, 2] == 0.0).all()
    assert (poses.positions[poses.target_index == 1, 2] == 3.0).all()
    assert [mask.any() for mask in finder.stand_region("object:box", reach=(0.0, 0.3))] == [
        True,
        False,
    ]


# ---------------------------------------------------------------- which poses, in which order


def test_poses_are_apart_and_no_more_would_fit():
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    poses = finder.stand_poses("object:table", count=999, spread=0.25)
    gaps = np.linalg.norm(poses.positions[:, None] - poses.positions, axis=2)
    assert (gaps[~np.eye(len(poses), dtype=bool)] >= 0.25 - 1e-9).all()
    candidates = finder.stand_poses("object:table", count=999, spread=0.0).positions
    to_nearest = np.linalg.norm(candidates[:, None] - poses.positions, axis=2).min(axis=1)
    assert (to_nearest < 0.25).all()
    few = finder.stand_poses("object:table", count=3, spread=0.25)
    np.testing.assert_array_equal(few.positions, poses.positions[:3])


def test_equal_seeds_give_equal_poses_and_others_begin_elsewhere():
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    firsts = set()
    for seed in range(8):
        poses = finder.stand_poses("object:table", seed=seed, facing=None)
        again = finder.stand_poses("object:table", seed=seed, facing=None)
        np.testing.assert_array_equal(poses.positions, again.positions)
        np.testing.assert_array_equal(poses.headings, again.headings)
        firsts.add(tuple(poses.positions[0]))
    assert len(firsts) > 2


def test_from_a_start_the_shortest_paths_come_first_and_all_lead_there():
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    start = (0.05, 1.15, 0.0)
    poses = finder.stand_poses("object:table", start=start, count=9)
    assert len(poses) and (np.diff(poses.path_lengths) >= 0).all()
    lengths = finder.distances(poses.positions, start, weighted=False)
    np.testing.assert_allclose(poses.path_lengths, lengths, rtol=0, atol=1e-9)
    (region,) = finder.stand_region("object:wall", start=start, reach=(0.0, 0.3))
    assert region[8].any() and not region[10].any()  # the other side of the wall
    assert np.isnan(finder.stand_poses("object:table").path_lengths).all()


def test_several_targets_get_the_poses_that_each_gets_alone():
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    start = (0.05, 1.15, 0.0)
    targets = ["object:table", (0.45, 0.42, 0.0), "object:box"]
    together = finder.stand_poses(targets, start=start, count=5, footprint=BASE)
    assert together.targets == ("table", "0.45, 0.42, 0", "box")
    for index, target in enumerate(targets):
        alone = finder.stand_poses(target, start=start, count=5, footprint=BASE)
        is_own = together.target_index == index
        np.testing.assert_array_equal(together.positions[is_own], alone.positions)
        np.testing.assert_array_equal(together.headings[is_own], alone.headings)
        np.testing.assert_array_equal(together.distances[is_own], alone.distances)
    assert (np.diff(together.target_index) >= 0).all()


def test_a_category_is_each_of_its_objects():
    finder = PathFinder(make_level(KITCHEN.replace("TcTTTT", "TcTTdT"), HEIGHTS))
    poses = finder.stand_poses("category:cup", count=3)
    assert poses.targets == ("cup_1", "cup_2")
    assert np.bincount(poses.target_index).tolist() == [3, 3]
    one, two, both = (
        finder.stand_region(name)[0] for name in ("object:cup_1", "object:cup_2", "category:cup")
    )
    np.testing.assert_array_equal(both, one | two)


# ---------------------------------------------------------------- reasons and errors


@pytest.mark.parametrize(
    ("target", "rules", "reason"),
    [
        ("object:cup_1", {"reach": (0.0, 0.1)}, "no cell at 0 to 0.1 m from cup_1 is free"),
        (
            "object:box",
            {"reach": (0.0, 0.2), "start": (0.05, 0.05, 0.0)},
            "no path leads from the start to the .* free cells in reach of box",
        ),
        (
            (0.45, 0.05, 0.0),
            {"reach": (0.0, 0.2), "start": (0.05, 1.15, 0.0)},
            "no path leads from the start",
        ),
        (
            "object:cup_1",
            {
                "reach": (0.0, 0.4),
                "footprint": [(0.5, 0.3), (-0.5, 0.3), (-0.5, -0.3), (0.5, -0.3)],
            },
            "the footprint fits in none of the .* cells in reach and in sight of cup_1",
        ),
        ((9.0, 9.0, 0.0), {}, "9, 9, 0 is in no cell"),
    ],
)
def test_a_target_without_a_pose_has_a_reason(target, rules, reason):
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    poses = finder.stand_poses(target, **rules)
    assert not len(poses)
    (text,) = poses.why_not.values()
    assert re.match(reason, text)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("height", [None, 1.2])
def test_a_reason_says_how_near_the_nearest_free_cell_is(seed, height):
    text, heights = random_map(seed)
    level = make_level(text, heights, inset=0.02)
    finder = PathFinder(level)
    poses = finder.stand_poses("object:table", reach=(4.0, 5.0), height=height)
    nearest = np.inf
    x_low, y_low, _, x_high, y_high, top = level.metadata["navbake"]["boxes"]["table"]
    for row, col in np.argwhere(level.free).tolist():
        x = (col + 0.5) * CELL
        y = (level.height - row - 0.5) * CELL
        for cell, entry in level.user_data.items():
            if "table" in list_names(entry):
                table_row, table_col = divmod(cell, level.width)
                west = max(table_col * CELL, x_low)
                south = max((level.height - 1 - table_row) * CELL, y_low)
                east = min((table_col + 1) * CELL, x_high)
                north = min((level.height - table_row) * CELL, y_high)
                gaps = (west - x, x - east, 0.0), (south - y, y - north, 0.0)
                gap_z = 0.0 if height is None else max(height - top, 0.0)
                nearest = min(nearest, math.hypot(*map(max, gaps), gap_z))
    assert poses.why_not["table"].endswith(f": the nearest free cell is at {nearest:.2f} m")


def test_poses_come_with_the_box_of_what_they_reach_and_the_outline_of_the_base():
    level = make_level(KITCHEN, {"table": (0.0, 0.7)})
    finder = PathFinder(level)
    targets = ["object:table", "object:box", (0.25, 0.35, 0.5), (9.0, 9.0, 0.0)]
    poses = finder.stand_poses(targets, footprint=BASE)
    expected = [
        (0.5, 0.6, 0.0, 1.1, 0.9, 0.7),
        (0.4, 0.3, 0.0, 0.6, 0.5, 0.0),  # no box: round its cells, on the floor
        (0.25, 0.35, 0.5, 0.25, 0.35, 0.5),
        (9.0, 9.0, 0.0, 9.0, 9.0, 0.0),
    ]
    np.testing.assert_allclose(poses.target_boxes, expected, atol=1e-12)
    np.testing.assert_array_equal(poses.outline, BASE)
    disc = PathFinder(level.inflate(0.2)).stand_poses("object:box", reach=(0.1, 0.8)).outline
    np.testing.assert_allclose(np.hypot(*disc.T), 0.2)


def test_a_hidden_target_names_what_is_in_between():
    level = make_level("...........\n..bbbbbbb..\n..b.TTT.b..\n..bbbbbbb..\n...........")
    level.weights[2, [3, 7]] = np.inf
    poses = PathFinder(level).stand_poses("object:table", reach=(0.0, 0.6))
    reason = r"table is in sight of none of the \d+ free cells in reach: box in between"
    assert re.fullmatch(reason, poses.why_not["table"])


@pytest.mark.parametrize(
    ("target", "rules", "message"),
    [
        ("object:tabel", {}, "no object 'tabel' in 'map': did you mean 'table'"),
        ("category:cop", {}, "no object of category 'cop' in 'map': did you mean 'cup'"),
        ("sofa", {}, "expected a position, object:NAME or category:NAME, got 'sofa'"),
        ([], {}, "expected"),
        ("object:table", {"reach": (0.8, 0.3)}, "expected a reach"),
        ("object:table", {"reach": 0.8}, "expected a reach"),
        ("object:table", {"reach": (0.3, math.inf)}, "expected a reach"),
        ("object:table", {"count": 0}, "expected a count >= 1, or None for all, got 0"),
        ("object:table", {"spread": -1}, "expected a spread >= 0 m, got -1"),
        ("object:table", {"facing": "away"}, "expected target as facing, got 'away'"),
        ("object:table", {"height": math.inf}, "expected a finite height of the shoulder"),
        ("object:rug", {"height": 1.2}, "expected a target of known height .* got rug"),
        ("object:table", {"sight": -1.0}, "expected a sight >= 0 m, got -1"),
        ("object:table", {"footprint": [(0, 0), (1, 0)]}, "expected a polygon"),
        ("object:table", {"start": (0.65, 0.75, 0.0)}, "no agent can stand at 0.65, 0.75, 0"),
    ],
)
def test_what_is_wrong_is_one_clear_line(target, rules, message):
    finder = PathFinder(make_level(KITCHEN, HEIGHTS))
    with pytest.raises(QueryError, match=message):
        finder.stand_poses(target, **rules)


def test_lines_of_sight_that_would_not_fit_into_memory_are_refused():
    finder = PathFinder(make_level("." * 230))
    with pytest.raises(
        QueryError, match=r"expected a reach up to 19.9 m where sight counts, got 21"
    ):
        finder.stand_poses((0.05, 0.05, 0.0), reach=(0.0, 21.0))
    poses = finder.stand_poses((0.05, 0.05, 0.0), reach=(0.0, 21.0), sight=False, count=None)
    assert len(poses) == 211
    small = PathFinder(make_level("." * 30))  # lines end with the grid
    assert len(small.stand_poses((0.05, 0.05, 0.0), reach=(0.0, 1e6), count=None)) == 30
