"""Rooms in whole bakes: the samples, floor plans made here, mazes that others made."""

from __future__ import annotations

import copy
import re
from collections import deque
from functools import cache

import numpy as np
import pytest

from box_worlds import body, box, stages_of_xml, world
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.bake.stages import open_stages
from navbake.baker.core.clock import StageClock
from navbake.baker.core.constants import WALL
from navbake.baker.rooms.rooms import Opening, find_openings, find_rooms, match_doors
from navbake.baker.rooms.segmentation import assign_unmarked
from navbake.config.settings import load_config, parse_config
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Neighbour
from project_paths import ROOT

APARTMENT = ROOT / "configs" / "apartment.yaml"
DATA = ROOT.parent / "shared" / "data"


@cache
def bake_apartment(*overrides):
    return run_bake(load_config(APARTMENT, overrides)).grid


def masks(grid, level=0):
    index = grid.levels[level].room_index
    return [index == room.index for room in grid.rooms if room.level == level]


def check_iou(found, expected, at_least=0.95):
    """Each expected room has its own found one, and there are no more."""
    assert len(found) == len(expected)
    best = []
    for room in expected:
        iou = [(room & other).sum() / (room | other).sum() for other in found]
        assert max(iou) >= at_least
        best.append(int(np.argmax(iou)))
    assert len(set(best)) == len(expected)


# ---------------------------------------------------------------- apartment


@pytest.mark.parametrize("cell_size", [0.1, 0.05])
def test_annotated_and_automatic_rooms_agree(cell_size):
    size = f"grid.cell_size={cell_size}"
    marked, auto = bake_apartment(size), bake_apartment(size, "rooms=auto")
    assert [room.name for room in marked.rooms] == [
        "bedroom", "bathroom", "kitchen", "hall", "living_room",
    ]  # fmt: skip
    assert {room.source for room in marked.rooms} == {"geoms"}
    assert {room.source for room in auto.rooms} == {"auto"}
    check_iou(masks(auto), masks(marked))


def test_furniture_parts_nothing():
    text = (ROOT / "configs/scenes/apartment.xml").read_text()
    bodies = re.findall(r'<body name="(?!door_)(\w+)"', text)
    bare = bake_apartment("rooms=auto", f"scene.exclude.bodies=[{', '.join(bodies)}]")
    assert bare.levels[0].free.sum() > 1.3 * bake_apartment().levels[0].free.sum()
    check_iou(masks(bare), masks(bake_apartment()))
    check_iou(masks(bare), masks(bake_apartment("rooms=auto")))


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_turned_rooms_are_the_same(quarters, tmp_path):
    text = (ROOT / "configs/scenes/apartment.xml").read_text()
    quat = {1: "1 0 0 1", 2: "0 0 0 1", 3: "1 0 0 -1"}[quarters]
    (tmp_path / "assets").symlink_to(ROOT / "configs/scenes/assets")
    path = tmp_path / "turned.xml"
    # a frame turns all that is in it, bodies with free joints too
    text = text.replace("<worldbody>", f'<worldbody><frame quat="{quat}">')
    text = text.replace("</worldbody>", "</frame></worldbody>")
    text = re.sub(r"<keyframe>.*</keyframe>", "", text, flags=re.DOTALL)
    path.write_text(text)
    for rooms in ("auto", "{from: [geoms]}"):
        turned = run_bake(load_config(APARTMENT, [f"scene.path={path}", f"rooms={rooms}"])).grid
        straight = bake_apartment(f"rooms={rooms}")
        expected = [np.rot90(mask, quarters) for mask in masks(straight)]
        check_iou(masks(turned), expected, at_least=1.0)


def test_a_way_through_rooms_and_doors_can_be_read_off_the_table():
    rooms = {room.id: room for room in bake_apartment().rooms}
    for start in rooms:
        came_by = {start: []}
        queue = deque([start])
        while queue:
            room = queue.popleft()
            for neighbour in rooms[room].neighbours:
                back = Neighbour(room, "door", neighbour.door)
                assert back in rooms[neighbour.room].neighbours
                if neighbour.room not in came_by:
                    came_by[neighbour.room] = [*came_by[room], neighbour.door]
                    queue.append(neighbour.room)
        assert came_by.keys() == rooms.keys()
        assert all(door.startswith("door_") for way in came_by.values() for door in way)
    assert {n.room for n in rooms["kitchen"].neighbours} == {"hall"}


def test_area_and_centroid():
    grid = bake_apartment()
    x, y = np.meshgrid(grid.lattice.center_x(), grid.lattice.center_y())
    for room, mask in zip(grid.rooms, masks(grid), strict=True):
        assert room.area == pytest.approx(mask.sum() * 0.01)
        assert room.centroid[:2] == pytest.approx([x[mask].mean(), y[mask].mean()], abs=1e-5)
    assert not np.any(grid.room_index[np.isnan(grid.floor_height)])


def test_walls_belong_to_no_room():
    grid = bake_apartment()
    walls = [cell for cell, names in grid.user_data.items() if names.get("walls")]
    blocked = [cell for cell in walls if grid.occupancy.flat[cell]]
    assert len(blocked) > 500
    share = np.mean(grid.room_index.ravel()[blocked] == 0)
    assert share > 0.95  # a lintel stands over the floor of a doorway


# ---------------------------------------------------------------- made here


def wall(x, y, half_x, half_y):
    return f'<geom type="box" pos="{x} {y} 1.25" size="{half_x} {half_y} 1.25"/>'


def make_plan(rows, cols, side=3.0, door=0.8, names=None):
    """Rooms in rows and columns, each with a door to the right and to the next row."""
    width, height = cols * side, rows * side
    parts = []
    if names is None:
        parts.append(
            f'<geom type="box" pos="{width / 2} {height / 2} -.1" '
            f'size="{width / 2} {height / 2} .1"/>'
        )
    else:
        for number, name in enumerate(names):
            x, y = (number % cols + 0.5) * side, (number // cols + 0.5) * side
            size = f"{side / 2} {side / 2} .1"
            parts.append(f'<geom name="{name}" type="box" pos="{x} {y} -.1" size="{size}"/>')
    piece = (side - door) / 4
    for row in range(rows + 1):
        for col in range(cols):
            x, y = col * side, row * side
            if row in (0, rows):
                parts.append(wall(x + side / 2, y, side / 2, 0.05))
            else:
                parts += [wall(x + piece, y, piece, 0.05), wall(x + side - piece, y, piece, 0.05)]
    for row in range(rows):
        for col in range(cols + 1):
            x, y = col * side, row * side
            if col in (0, cols):
                parts.append(wall(x, y + side / 2, 0.05, side / 2))
            else:
                parts += [wall(x, y + piece, 0.05, piece), wall(x, y + side - piece, 0.05, piece)]
    return "".join(parts)


def bake_text(tmp_path, body, **settings):
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    return run_bake(parse_config({"scene": {"path": path}, **settings}))


def test_numbers_go_row_by_row(tmp_path):
    grid = bake_text(tmp_path, make_plan(2, 3), rooms="auto").grid
    centers = [room.centroid[:2] for room in grid.rooms]
    expected = [[1.5, 4.5], [4.5, 4.5], [7.5, 4.5], [1.5, 1.5], [4.5, 1.5], [7.5, 1.5]]
    np.testing.assert_allclose(centers, expected, atol=0.05)
    assert [room.id for room in grid.rooms] == [f"0:{k}" for k in range(1, 7)]
    assert [room.name for room in grid.rooms] == [None] * 6
    assert [n.room for n in grid.rooms[0].neighbours] == ["0:2", "0:4"]
    assert {n.kind for room in grid.rooms for n in room.neighbours} == {"open"}


def test_more_rooms_than_a_byte_holds(tmp_path):
    result = bake_text(
        tmp_path,
        make_plan(15, 18, side=2.5, door=0.7),
        grid={"cell_size": 0.1},
        rooms={"from": ["auto"], "door_width": 0.8},
    )
    grid = result.grid
    assert len(grid.rooms) == 270
    assert grid.room_index.max() == 270
    assert grid.room_index.dtype == np.uint16
    path = tmp_path / "large.grid.json"
    grid.save(path)
    import navbake

    again = navbake.load(path)
    np.testing.assert_array_equal(again.room_index, grid.room_index)
    assert again.rooms == grid.rooms


def test_names_in_any_script_and_ids_that_are_unique(tmp_path):
    names = ["floor|客厅", "floor|Küche", "floor|0:1", "floor_客厅"]
    grid = bake_text(tmp_path, make_plan(2, 2, names=names), rooms={"geoms": ["floor*"]}).grid
    # the second row is the upper one
    assert [room.name for room in grid.rooms] == ["0:1", "客厅", "客厅", "Küche"]
    assert [room.id for room in grid.rooms] == ["0:1", "0:2", "0:3", "Küche"]


def test_none(tmp_path):
    grid = bake_text(tmp_path, make_plan(1, 2), rooms="none").grid
    assert not grid.room_index.any()
    assert grid.rooms == ()


def test_gaps_between_marked_floors_go_to_the_rooms_they_touch(tmp_path):
    """Floors that end at the walls, as in houses of separate pieces; a hall without a mark."""
    names = ["floor|a", "floor|b", "other", "floor|c"]
    body = make_plan(2, 2, names=names)
    ground = '<geom type="box" pos="3 3 -.103" size="3 3 .1"/>'
    body = re.sub(r'(<geom name="floor[^>]* size=")1.5 1.5', r"\g<1>1.4 1.4", body)
    grid = bake_text(tmp_path, ground + body, grid={"cell_size": 0.05}).grid
    found = {(room.name, room.source): room.area for room in grid.rooms}
    assert found.keys() == {("a", "geoms"), ("b", "geoms"), ("c", "geoms"), (None, "auto")}
    assert max(found.values()) - min(found.values()) < 0.15
    plan = bake_text(tmp_path, ground + body, grid={"cell_size": 0.05}, rooms="auto").grid
    check_iou(masks(grid), masks(plan), at_least=0.98)


def test_what_marks_leave_is_rooms_by_itself():
    """Cells of 0.25 m: two segments, 2.5 m high, and a doorway of two cells between them."""
    segment = np.ones((10, 21), dtype=np.int32)
    segment[:, 10:] = 2
    owner = np.zeros_like(segment)
    owner[:, :8] = 1  # most of the first one; what is left of it is as wide as a doorway is deep
    owner[:2, 10:] = 2
    taken, new = assign_unmarked(owner, segment, 0.25, 1.0)
    np.testing.assert_array_equal(taken, owner)
    assert (new[:, 8:10] == 1).all() and (new[2:, 10:] == 2).all() and new.max() == 2
    assert not new[owner > 0].any()
    # too narrow for a room: it goes to the room that it touches most
    owner[:, 8] = 1
    taken, new = assign_unmarked(owner, segment, 0.25, 0.5)
    assert (taken[:, 9] == 1).all() and (new[2:, 10:] == 1).all() and new.max() == 1
    # too small for one
    taken, new = assign_unmarked(owner, segment, 0.25, 6.0)
    assert not new.any() and (taken[2:, 10:] == 2).all()


@pytest.mark.parametrize("ring", [1, 2, 4])
def test_a_mark_changes_no_other_space(ring):
    """Cells of 0.1 m: a room, and a narrow ring round its walls, which are two cells thick."""
    segment = np.ones((40, 60), dtype=np.int32)
    segment[ring:-ring, ring:-ring] = 0
    room = (slice(ring + 2, -ring - 2), slice(ring + 2, -ring - 2))
    segment[room] = 2
    owner = np.zeros_like(segment)
    owner[10:20, 10:20] = 1
    taken, new = assign_unmarked(owner, segment, 0.1, 1.0)
    np.testing.assert_array_equal(taken, owner)
    np.testing.assert_array_equal(new, np.where(owner > 0, 0, segment))
    # reaching over the wall, it takes its own cells; the rest of the ring is as wide as ever
    owner[10:20, :20] = 1
    owner[segment == 0] = 0
    taken, new = assign_unmarked(owner, segment, 0.1, 1.0)
    np.testing.assert_array_equal(taken, owner)
    np.testing.assert_array_equal(new, np.where(owner > 0, 0, segment))


def test_rooms_depend_on_their_flags_alone():
    config = load_config(ROOT / "configs" / "house.yaml")
    stages = open_stages(config, StageClock())
    flags, step = stages.room_flags, config.agent.traversable_floor_height
    leaves = [leaf.closed_leaf for leaf in stages.leaf_cells]
    again = find_rooms(copy.deepcopy(flags), config.rooms, step, leaves)
    assert again.table == stages.rooms.table
    assert again.room_pairs_across_levels == stages.rooms.room_pairs_across_levels
    np.testing.assert_array_equal(again.index, stages.rooms.index)


def test_storeys_are_linked_by_steps():
    config = ROOT / "configs" / "house.yaml"
    grid = run_bake(load_config(config)).grid
    rooms = {room.id: room for room in grid.rooms}
    links = [(room.id, n.room) for room in grid.rooms for n in room.neighbours if n.kind == "link"]
    assert len(links) == 4  # two stairs, both ways
    assert all((b, a) in links for a, b in links)
    assert all(rooms[a].level != rooms[b].level for a, b in links)
    # three rooms and the ground outside; a gallery round the stairs, its end beside
    # the open stair, and two bedrooms
    assert [room.level for room in grid.rooms] == [0, 0, 0, 0, 1, 1, 1, 1]


@pytest.mark.parametrize(
    ("floor", "rooms", "slopes", "expected"),
    [
        ([[0.0, 0.3, 0.6, 0.9]], [[1, 1, 2, 2]], [], []),
        ([[0.0, 0.3, 0.6, 0.9]], [[1, 1, 2, 2]], [(1, 2)], [((1, 2), [1, 2])]),
        # within a room, or to none
        ([[0.0, 0.3, 0.6, 0.9]], [[1, 1, 1, 0]], [(0, 1), (1, 2), (2, 3)], []),
        # a slope beside a step is one opening with it
        ([[0.0, 0.2], [0.0, 0.3]], [[1, 2], [1, 2]], [], [((1, 2), [0, 1])]),
        ([[0.0, 0.2], [0.0, 0.3]], [[1, 2], [1, 2]], [(2, 3)], [((1, 2), [0, 1, 2, 3])]),
    ],
)
def test_openings_are_where_steps_and_slopes_lead_to_another_room(floor, rooms, slopes, expected):
    links = np.array([(0, a, 0, b) for a, b in slopes], dtype=np.int64).reshape(-1, 4)
    index = np.array(rooms, dtype=np.uint16)
    free = np.zeros(index.shape, dtype=np.bool_)
    openings = find_openings([index], [np.array(floor)], [free], links, 0.25)
    assert [(o.rooms, o.cells.tolist()) for o in openings] == expected
    # what stands on all of one side closes it
    openings = find_openings([index], [np.array(floor)], [index == 1], links, 0.25)
    assert openings == []


def test_doors_go_to_the_opening_they_are_in():
    lattice = Lattice(0.0, 10.0, 0.1, 100, 100)
    openings = [
        Opening(0, (1, 2), np.array([1010, 1011])),
        Opening(0, (1, 2), np.array([5010, 5011])),
        Opening(1, (1, 3), np.array([5010, 5011])),
    ]
    ids = {(level, room): f"{level}:{room}" for level in (0, 1) for room in (1, 2, 3)}
    none, rooms = np.empty(0, dtype=np.int64), ("0:1", "0:2")
    doors = {
        "first": (rooms, [np.array([1109, 1110]), none]),  # a row further
        "second": (rooms, [np.array([5010]), none]),
        "upper": (("1:1", "1:3"), [none, np.array([5011, 5012])]),
        "double": (rooms, [np.array([5011]), none]),
        "cupboard": (rooms, [np.array([9000]), none]),
        # beside an opening that is none between its own rooms
        "front": (("0:1", None), [np.array([1010]), none]),
        "third": (("0:1", "0:3"), [np.array([1010]), none]),
    }
    assert match_doors(openings, doors, ids, lattice) == {
        0: ["first"],
        1: ["double", "second"],
        2: ["upper"],
    }


# ---------------------------------------------------------------- made by others


def make_maze(seed, path):
    """A labmaze saved as MJB; its letters, its walls, and the centre and step of its blocks."""
    labmaze = pytest.importorskip("labmaze")
    mazes = pytest.importorskip("dm_control.locomotion.arenas.mazes")
    import mujoco

    layout = labmaze.RandomMaze(height=21, width=21, random_seed=seed)
    arena = mazes.MazeWithTargets(maze=layout, xy_scale=2.0, z_height=2.0)
    arena.regenerate()
    model = mujoco.MjModel.from_xml_string(
        arena.mjcf_model.to_xml_string(), arena.mjcf_model.get_assets()
    )
    mujoco.mj_saveModel(model, str(path), None)
    first, right, down = arena.grid_to_world_positions([(0, 0), (0, 1), (1, 0)])
    step = right[0] - first[0], down[1] - first[1]
    letters = np.array(layout.variations_layer)
    return letters, np.array(layout.entity_layer) == "*", (first[0], first[1]), step


def letter_of_cells(letters, first, step, lattice):
    col = np.rint((lattice.center_x() - first[0]) / step[0]).astype(int)
    row = np.rint((lattice.center_y() - first[1]) / step[1]).astype(int)
    inside = (row >= 0) & (row < len(letters))
    assert inside.all()
    return letters[row[:, None], col[None, :]]


@pytest.mark.parametrize("seed", range(3))
def test_labmaze(seed, tmp_path):
    """Openings are 2 m wide there, rooms 6 m and more."""
    path = tmp_path / "maze.mjb"
    letters, _, first, step = make_maze(seed, path)
    polygons = []
    for letter in sorted(set(letters.ravel()) - {"."}):
        squares = []
        for row, col in zip(*np.nonzero(letters == letter), strict=True):
            x, y = first[0] + col * step[0], first[1] + row * step[1]
            squares.append([[x - 1, y - 1], [x + 1, y - 1], [x + 1, y + 1], [x - 1, y + 1]])
        polygons.append({"name": letter, "points": squares[0], "rings": squares[1:]})
    settings = {
        "scene": {"path": path},
        "levels": [{"ground": 0.0, "top": 0.25}],
        "grid": {"cell_size": 0.2},
    }
    given = {"from": ["polygons"], "polygons": polygons}
    marked = run_bake(parse_config({**settings, "rooms": given})).grid
    auto_rooms = {"from": ["auto"], "door_width": 2.0}
    auto = run_bake(parse_config({**settings, "rooms": auto_rooms})).grid
    cells = letter_of_cells(letters, first, step, marked.lattice)
    is_room = marked.free & (cells != ".")
    assert is_room.any()
    names = np.array([".", *(room.name for room in marked.rooms)])
    np.testing.assert_array_equal(names[marked.room_index][marked.free], cells[marked.free])
    for letter in sorted(set(letters.ravel()) - {"."}):
        found = auto.room_index[(cells == letter) & auto.free]
        assert np.bincount(found).max() >= 0.9 * len(found)
        assert np.bincount(found).argmax() > 0


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no real scenes in {DATA}")
def test_aws_small_house():
    """No gap is as narrow as 1 m: one room. At 3.5 m: bedroom, gym, and the rest; and cavities."""
    scene = {"path": DATA / "aws_small_house/scene.xml", "meshes": "surface"}
    settings = {"scene": scene, "grid": {"cell_size": 0.05}}
    grid = run_bake(parse_config({**settings, "rooms": {"door_width": 1.0}})).grid
    assert [room.area > 150 for room in grid.rooms if room.area > 3] == [True]
    grid = run_bake(parse_config({**settings, "rooms": {"door_width": 3.5}})).grid
    at = {"bed": (-6.2, 1.0), "gym": (-6.2, -3.5), "sofa": (1.0, -1.5), "kitchen": (7.5, -1.0)}
    rows, cols = grid.lattice.rows_cols(list(at.values()))
    bed, gym, sofa, kitchen = grid.room_index[rows, cols]
    assert len({bed, gym, sofa}) == 3
    assert sofa == kitchen
    assert len([room for room in grid.rooms if room.area > 3]) == 3
    auto = run_bake(parse_config(settings)).grid
    bed, gym, sofa, _ = auto.room_index[rows, cols]
    assert len({bed, gym, sofa}) == 3


# two spaces of 4 x 3.6 m, and an opening between them that is too wide to part rooms, over a sill
PARTED = (
    box("floor", 0, 0, -0.1, 8.1, 3.6, 0)
    + box("s", 0, -0.1, 0, 8.1, 0, 2.5)
    + box("n", 0, 3.6, 0, 8.1, 3.7, 2.5)
    + box("w", -0.1, -0.1, 0, 0, 3.7, 2.5)
    + box("e", 8.1, -0.1, 0, 8.2, 3.7, 2.5)
    + box("one", 4, 0, 0, 4.1, 0.5, 2.5)
    + box("other", 4, 3.1, 0, 4.1, 3.6, 2.5)
    + box("sill", 3.9, 0.5, 0, 4.2, 3.1, 0.1)
)


@pytest.mark.parametrize("angle", [0, 30, 77])
@pytest.mark.parametrize(
    ("joint", "rooms"),
    [
        ("", 2),  # a fixed pane
        ('<joint type="slide" axis="0 1 0" range="0 1"/>', 1),
    ],
)
def test_a_pane_in_an_opening_closes_it_unless_it_can_move(tmp_path, joint, rooms, angle):
    pane = joint + '<geom type="box" size="0.01 1.3 1"/>'
    pane = body("pane", pane, 'pos="4.05 1.8 1.1"')
    scene = world(body("house", PARTED + pane, f'euler="0 0 {angle}"'))
    stages = stages_of_xml(tmp_path, scene, doors={"find": False})
    assert len(stages.rooms.table) == rooms


def test_walls_that_are_named_objects_still_part_rooms(tmp_path):
    parted = PARTED + box("pane", 4.04, 0.5, 0, 4.06, 3.1, 2.1)
    stages = stages_of_xml(tmp_path, world(parted), names={"walls": ["one"]})
    assert len(stages.rooms.table) == 2
    walls = stages.standing_occupants.kinds == WALL
    assert walls.tolist() == [geom.name == "one" for geom in stages.scene.geoms]
