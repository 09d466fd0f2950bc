"""Closed leaves part rooms, and a leaf is a door where it has a room or a cavity on each side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import navbake
from leaf_plans import box, draw_plan, leaf, room, world
from navbake.baker.bake.stages import open_stages
from navbake.baker.core.clock import StageClock
from navbake.config.settings import parse_config

CELLS = (0.05, 0.08, 0.1)
HALL = room(0, 5, 0, 4)
# a niche of the hall between its northern wall and a wall of its own, 1 m wide and 0.6 m deep
NICHE = HALL + box(1.0, 1.1, 3.4, 4.0)
LEAF_OF_NICHE = leaf("door", 0.0, 3.45, 1.0)


@pytest.fixture
def bake(tmp_path: Path):
    def call(*parts: str, cell_size: float = 0.1, **settings):
        path = tmp_path / "scene.xml"
        path.write_text(world(*parts), encoding="utf-8")
        return navbake.bake(
            {"scene": {"path": str(path)}}, grid={"cell_size": cell_size}, **settings
        )

    return call


@pytest.fixture
def find_rooms(tmp_path: Path):
    """Returns a function that finds the rooms of things whose leaves are taken out."""

    def call(*parts: str, cell_size: float):
        path = tmp_path / "scene.xml"
        path.write_text(world(*parts), encoding="utf-8")
        settings = {"scene": {"path": str(path)}, "grid": {"cell_size": cell_size}}
        return open_stages(parse_config(settings), StageClock())

    return call


def room_at(grid, x: float, y: float) -> int:
    row, col = grid.lattice.rows_cols([x, y])
    return int(grid.room_index[row, col])


def leaf_cells(level, doors) -> np.ndarray:
    mask = np.zeros(level.room_index.shape, dtype=bool)
    for door in doors:
        mask.ravel()[door.cells_in("closed", 1)[0]] = True
    return mask


def neighbours(grid) -> list[tuple[str, str | None]]:
    return sorted((n.kind, n.door) for each in grid.rooms for n in each.neighbours)


# ---------------------------------------------------------------- what is a door


@pytest.mark.parametrize("cell_size", CELLS)
@pytest.mark.parametrize("opening", [1.0, 0.9, 0.8])
def test_the_leaf_of_a_small_room_is_a_door_however_wide_its_opening_is(bake, opening, cell_size):
    """A WC of 1.0 x 1.8 m: its opening is as wide as itself, or as a share of it."""
    jamb = (1.0 - opening) / 2
    parts = [HALL, box(1.0, 1.1, 0.0, 1.9)]
    if jamb > 0:
        parts += [box(0.0, jamb, 1.8, 1.9), box(1.0 - jamb, 1.0, 1.8, 1.9)]
    grid = bake(*parts, leaf("door", jamb, 1.85, opening), cell_size=cell_size)
    (door,) = grid.doors
    inside, outside = room_at(grid, 0.5, 0.9), room_at(grid, 0.5, 3.0)
    assert outside == room_at(grid, 3.0, 2.0) != inside > 0
    assert set(door.rooms) == {f"0:{inside}", f"0:{outside}"}
    assert neighbours(grid) == [("door", "door")] * 2
    opened = navbake.PathFinder(grid.with_doors("open"))
    assert opened.find_path((0.5, 0.9, 0.0), (3.0, 2.0, 0.0)) is not None


@pytest.mark.parametrize("cell_size", CELLS)
@pytest.mark.parametrize("width", [1.6, 2.9, 3.6])
def test_the_two_leaves_of_a_double_door_part_together(bake, width, cell_size):
    first, last = 2.0 - width / 2, 2.0 + width / 2
    grid = bake(
        HALL,
        box(2.0, 2.1, 0.0, first),
        box(2.0, 2.1, last, 4.0),
        leaf("left", 2.05, first, width / 2, along="y"),
        leaf("right", 2.05, last, width / 2, along="y", sign=-1),
        cell_size=cell_size,
    )
    assert [door.id for door in grid.doors] == ["left", "right"]
    assert [set(door.rooms) for door in grid.doors] == [{"0:1", "0:2"}] * 2
    assert len(grid.rooms) == 2


@pytest.mark.parametrize("cell_size", CELLS)
def test_a_cavity_that_a_door_leads_into_is_a_room(bake, cell_size):
    grid = bake(NICHE, LEAF_OF_NICHE, cell_size=cell_size)
    (door,) = grid.doors
    small, large = sorted(grid.rooms, key=lambda each: each.area)
    assert 0.4 < small.area < 0.7  # less than `rooms.min_area`, 1 m²
    assert set(door.rooms) == {small.id, large.id}
    # without a leaf it is no room
    assert len(bake(NICHE, cell_size=cell_size).rooms) == 1


@pytest.mark.parametrize("cell_size", CELLS)
@pytest.mark.parametrize("gap", [0.01, 0.04])
def test_a_niche_that_a_fridge_fills_is_no_cavity(bake, gap, cell_size):
    fridge = box(gap, 1.0 - gap, 3.48, 4.0 - gap, 0.0, 1.8)
    grid = bake(NICHE, fridge, LEAF_OF_NICHE.replace("door", "fridge"), cell_size=cell_size)
    assert grid.doors == ()
    assert len(grid.rooms) == 1


@pytest.mark.parametrize("cell_size", CELLS)
@pytest.mark.parametrize("y", [3.35, 2.0])
def test_the_leaf_of_a_cupboard_changes_no_room(find_rooms, y, cell_size):
    """Boards of furniture are no walls: the space in a cupboard hangs together with the room."""
    boards = "".join(
        [
            '<body name="cupboard">',
            box(1.0, 1.02, y, y + 0.6, 0.0, 2.0),
            box(2.0, 2.02, y, y + 0.6, 0.0, 2.0),
            box(1.0, 2.02, y + 0.58, y + 0.6, 0.0, 2.0),
            box(1.02, 2.0, y, y + 0.58, 0.0, 0.05),
            "</body>",
        ]
    )
    with_leaf = find_rooms(
        HALL, boards, leaf("cupboard_door", 1.02, y + 0.01, 0.98, high=1.9), cell_size=cell_size
    )
    without = find_rooms(HALL, boards, cell_size=cell_size)
    np.testing.assert_array_equal(with_leaf.rooms.index, without.rooms.index)
    is_door = {placed.candidate.id: placed.is_door for placed in with_leaf.doors}
    assert not is_door["cupboard_door"]


def test_a_board_on_a_wall_or_in_a_room_is_no_door(bake):
    for y in (3.99, 3.97, 2.0):  # in the face of a wall, before it
        assert bake(HALL, leaf("board", 1.0, y, 1.2)).doors == ()


def test_a_gate_parts_a_garden_from_the_street(bake):
    ground = box(0, 8, 0, 4, -0.1, 0.0)
    fence = box(4.0, 4.1, 0.0, 1.5, 0.0, 1.6) + box(4.0, 4.1, 2.5, 4.0, 0.0, 1.6)
    grid = bake(ground, fence, leaf("gate", 4.05, 1.5, 1.0, along="y", high=1.6))
    (gate,) = grid.doors
    assert set(gate.rooms) == {"0:1", "0:2"}
    assert [each.outdoors for each in grid.rooms] == [True, True]
    assert neighbours(grid) == [("door", "gate")] * 2


def test_a_leaf_that_a_pattern_names_is_a_door_in_the_middle_of_a_room(bake):
    grid = bake(HALL, leaf("screen", 1.0, 2.0, 1.2), doors={"patterns": ["screen"]})
    assert [door.id for door in grid.doors] == ["screen"]
    assert len(grid.rooms) == 1
    np.testing.assert_array_equal(grid.room_index, bake(HALL).room_index)


def test_a_space_between_two_leaves_is_a_room_if_one_can_be_in_it(bake):
    walls = box(2.0, 2.5, 0.0, 3.5) + box(2.0, 2.5, 4.5, 8.0)
    hall = room(0, 5, 0, 8)
    for at, ends in ((2.47, ("0:3", "0:2")), (2.15, ("0:1", "0:2"))):
        grid = bake(
            hall,
            walls,
            leaf("a", 2.03, 3.5, 1.0, along="y"),
            leaf("b", at, 3.5, 1.0, along="y"),
            cell_size=0.05,
        )
        a, b = grid.doors
        assert b.rooms == ends
        assert a.rooms == ("0:1", "0:3" if "0:3" in ends else "0:2")
        assert {kind for kind, _ in neighbours(grid)} == {"door"}


@pytest.mark.parametrize("cell_size", CELLS)
def test_leaves_close_behind_each_other_part_together(bake, cell_size):
    """Two double doors in an opening so wide that nothing but they part the rooms."""
    opening = (0.8, 5.2)
    leaves = [
        leaf(f"{name}_{side}", at, hinge, 2.2, along="y", sign=sign)
        for name, at in (("a", 2.03), ("b", 2.15))
        for side, hinge, sign in (("south", opening[0], 1), ("north", opening[1], -1))
    ]
    walls = box(2.0, 2.2, 0.0, opening[0]) + box(2.0, 2.2, opening[1], 6.0)
    grid = bake(room(0, 5, 0, 6), walls, *leaves, cell_size=cell_size)
    assert len(grid.rooms) == 2
    assert [set(door.rooms) for door in grid.doors] == [{"0:1", "0:2"}] * 4


# ---------------------------------------------------------------- where rooms meet


@pytest.mark.parametrize("cell_size", CELLS)
@pytest.mark.parametrize("at", [2.03, 2.25, 2.47])
def test_two_rooms_meet_in_the_cells_of_the_leaf(bake, at, cell_size):
    """A leaf at either face of a wall of 0.5 m, and in its middle."""
    walls = box(2.0, 2.5, 0.0, 3.5) + box(2.0, 2.5, 4.5, 8.0)
    grid = bake(room(0, 5, 0, 8), walls, leaf("door", at, 3.5, 1.0, along="y"), cell_size=cell_size)
    room_index = grid.room_index.astype(int)
    is_leaf = leaf_cells(grid, grid.doors)
    y = np.arange(3.6, 4.4, cell_size)
    rows, _ = grid.lattice.rows_cols(np.stack([np.full_like(y, at), y], axis=1))
    for row in rows.tolist():
        line = room_index[row]
        differs = np.flatnonzero((line[:-1] != line[1:]) & (line[:-1] > 0) & (line[1:] > 0))
        assert len(differs) == 1
        assert is_leaf[row, differs[0] : differs[0] + 2].any()


@pytest.mark.parametrize("cell_size", CELLS)
def test_a_threshold_before_the_outside_is_in_no_room(bake, cell_size):
    floor = box(-0.1, 4.3, -0.1, 3.1, -0.1, 0.0)
    walls = box(-0.1, 0, -0.1, 3.1) + box(0, 4.3, -0.1, 0) + box(0, 4.3, 3, 3.1)
    front = box(4.0, 4.3, -0.1, 1.0) + box(4.0, 4.3, 2.0, 3.1)
    front = front.replace('type="box"', 'name="wall_1" type="box"', 1)
    front = front.replace('<geom type="box"', '<geom name="wall_2" type="box"')
    grid = bake(floor, walls, front, leaf("door", 4.03, 1.0, 1.0, along="y"), cell_size=cell_size)
    (door,) = grid.doors
    assert door.rooms == ("0:1", None)
    assert room_at(grid, 3.9, 1.5) == 1
    assert room_at(grid, 4.25, 1.5) == 0


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_rooms_never_continue_through_a_closed_leaf(tmp_path, seed, turned):
    plan = draw_plan(seed, turned)
    path = tmp_path / "plan.xml"
    path.write_text(plan.text, encoding="utf-8")
    grid = navbake.bake({"scene": {"path": str(path)}}, grid={"cell_size": CELLS[seed % 3]})
    assert {door.id for door in grid.doors} == {each.name for each in plan.leaves}
    assert len(grid.rooms) == len(plan.rooms)
    assert {kind for kind, _ in neighbours(grid)} == {"door"}
    assert all(None not in door.rooms and len(set(door.rooms)) == 2 for door in grid.doors)
    room_index = grid.room_index.astype(int)
    closed = leaf_cells(grid, grid.doors) | (grid.occupancy != 0)
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        meet = (room_index[one] != room_index[other]) & (room_index[one] * room_index[other] > 0)
        assert not (meet & ~closed[one] & ~closed[other]).any()


# ---------------------------------------------------------------- what closes an opening


@pytest.mark.parametrize("cell_size", [0.05, 0.08, 0.1])
@pytest.mark.parametrize("bottom", [0.3, 0.8])
@pytest.mark.parametrize("stub", [0.27, 0.46, 0.9])
def test_a_curtain_between_two_rooms_opens_nothing(bake, stub, bottom, cell_size):
    """Also where the stubs of wall beside it are too short to count as walls."""
    width = stub + 1.06 + 0.45

    def scene(*things: str):
        return bake(
            room(0, 8.8, 0, width),
            box(5.35, 5.45, 0.0, stub),
            box(5.35, 5.45, stub + 1.06, width),
            box(5.35, 5.45, stub, stub + 1.06, 2.04),
            *things,
            cell_size=cell_size,
        )

    grid = scene(box(5.39, 5.41, stub, stub + 1.06, bottom, 2.04))
    assert navbake.PathFinder(grid).find_path((1, 0.9, 0), (8, 0.9, 0)) is None
    assert neighbours(grid) == []
