"""Small scenes that are easily baked wrong: what must come out of each, cell for cell.

Each is built here, and baked once more from the file in `SHARED_DATA` where that is there.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from box_truth import STEP, TINY, centers, occupied_by_boxes, within
from hard_cases import CASES, SHARED, write_case
from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.config.settings import parse_config
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.islands import find_islands
from navbake.runtime.path_finder import PathFinder

Bake = Callable[..., BakeResult]
HOUSES = [name for name in CASES if name.startswith("2_")]
ONE_LEVEL = [name for name in CASES if name != "12_crack.xml"]
# what boxes don't make up: thin things, a ramp, a tilted panel
NOT_BOXES = ("1_thin_wall.xml", "6_dock.xml", "7_ramp15.xml", "9_stray", "14_panel", "12_crack")


@pytest.fixture(params=["built", "shared"])
def bake(request, tmp_path_factory) -> Bake:
    """Bakes a case by its name, as it is built here or as it is shared."""
    if request.param == "shared" and not SHARED.is_dir():
        pytest.skip(f"no scenes in {SHARED}")
    kept: dict[str, BakeResult] = _kept(request.param)

    def run(name: str, **more) -> BakeResult:
        key = f"{name} {more}"
        if key not in kept:
            path = SHARED / name
            if request.param == "built":
                path = write_case(tmp_path_factory.mktemp("case"), name)
            settings = {**CASES[name].settings, **more}
            scene = {"path": str(path), **settings.pop("scene", {})}
            kept[key] = run_bake(parse_config({"scene": scene, **settings}))
        return kept[key]

    return run


@cache
def _kept(param: str) -> dict[str, BakeResult]:
    return {}


def level_of(result: BakeResult) -> SceneGrid2D:
    assert isinstance(result.grid, SceneGrid2D)
    return result.grid


def tops(result: BakeResult) -> list[str]:
    return [warning for warning in result.warnings if warning.startswith("not a floor")]


def joins(level: SceneGrid2D, *places: tuple[float, float]) -> bool:
    """Whether one can walk between places, given as x and y."""
    finder = PathFinder(level)
    cells = level.lattice.rows_cols(np.array(places))
    floors = level.floor_height[cells]
    start, *others = [(x, y, float(z)) for (x, y), z in zip(places, floors, strict=True)]
    return all(finder.find_path(start, other) is not None for other in others)


# ---------------------------------------------------------------- all of them


@pytest.mark.parametrize("name", ONE_LEVEL)
def test_it_has_one_level(bake, name):
    result = bake(name)
    assert len(result.grid.levels) == 1
    assert not [warning for warning in result.warnings if "no step leads to 'level" in warning]


@pytest.mark.parametrize("name", [n for n in CASES if not n.startswith(NOT_BOXES)])
def test_boxes_occupy_the_cells_that_they_meet_and_no_others(bake, name):
    level = level_of(bake(name))
    has_floor = ~np.isnan(level.floor_height)
    blocked = occupied_by_boxes(level, CASES[name].boxes)
    np.testing.assert_array_equal(level.occupancy == 1, blocked | ~has_floor)
    np.testing.assert_array_equal(level.free, has_floor & ~blocked)


def test_every_shared_scene_is_tested():
    if not SHARED.is_dir():
        pytest.skip(f"no scenes in {SHARED}")
    files = {path.name for path in SHARED.iterdir()} - {"README.md", "8_house.stl"}
    assert files == set(CASES)


# ---------------------------------------------------------------- walls and solids


@pytest.mark.parametrize("name", ["1_thin_wall.xml", "1b_thick_wall_one_mesh.obj"])
@pytest.mark.parametrize("radius", [0.0, 0.05, 0.3])
def test_wall_blocks_on_both_sides_at_any_radius(bake, name, radius):
    level = level_of(bake(name, agent={"radius": radius}))
    x, _ = centers(level)
    blocked = abs(x) < max(0.1, radius + (0.1 if name.startswith("1b") else 0.0)) - TINY
    np.testing.assert_array_equal(level.free, ~blocked)
    assert (level.floor_height[level.free] == 0).all()
    for wider in (0.0, 0.1, 0.35, 0.7):
        finder = PathFinder(level.inflate(max(wider, radius)))
        for y in (-1.25, 0.0, 1.15):
            assert finder.is_navigable((-1.2, y, 0)) and finder.is_navigable((1.2, y, 0))
            assert finder.find_path((-1.2, y, 0), (1.2, y, 0)) is None
            assert not finder.line_of_sight((-1.2, y, 0), (1.2, y, 0))


def test_nothing_is_free_in_a_crate(bake):
    result = bake("3_crate_one_mesh.obj")
    level = level_of(result)
    assert not level.free[within(level, -1.5, -1.5, 1.5, 1.5)].any()
    assert (level.floor_height[level.free] == 0).all()
    assert level.free.sum() == 100**2 - 31**2
    [warning] = tops(result)
    assert "(9.0 m² at 2.50 m)" in warning


def test_nothing_is_free_in_a_pillar_beside_a_stray_triangle(bake):
    level = level_of(bake("9_stray_triangle.stl"))
    x, y = centers(level)
    inside = within(level, -1, -1, 1, 1)
    # the closed squares that the triangle touches: those around (4, 4), but not its far corner's
    stray = within(level, 3.9, 3.9, 4.2, 4.2) & (x + y < 8.25)
    np.testing.assert_array_equal(level.free, ~inside & ~stray)
    assert (level.floor_height[level.free] == 0).all()


# ---------------------------------------------------------------- floors and furniture


@pytest.mark.parametrize("name", HOUSES)
def test_house_on_its_slab_is_a_floor_wherever_its_walls_end(bake, name):
    level, other = level_of(bake(name)), level_of(bake(HOUSES[0]))
    for layer in ("floorHeight", "occupancy", "roomIndex"):
        np.testing.assert_array_equal(level.attributes[layer], other.attributes[layer])
    inside = within(level, 0, 0, 8, 8)
    at_slab = np.isclose(level.floor_height, 0.1, atol=1e-6)
    # 8 × 8 m less walls: a room of 154 × 154 cells, and 20 × 3 in the door
    room = within(level, 0.15, 0.15, 7.85, 7.85) | within(level, 3.5, 0, 4.5, 0.2)
    assert room.sum() == 154**2 + 20 * 3 and at_slab[room].all()
    # the agent's disc is as wide as two cells, so it keeps off the walls by one
    assert (level.free & inside).sum() == 152**2 + 18 * 4
    # the ground on both sides of the house: 60 columns less one beside its walls
    outside = level.free & ~inside
    assert outside.sum() == 2 * 59 * 160
    stones = outside & ~(level.floor_height == 0)
    assert stones.sum() == 8 and at_slab[stones].all()
    # the house stands at the grid's edge, so that nothing but its door parts it from the ground
    assert joins(level, (1, 1), (7, 7), (4, 0.1))
    assert sorted((room.outdoors, round(room.area, 4)) for room in level.rooms) == [
        (False, 59.44),
        (True, 48.0),
    ]


def test_garage_is_one_level_and_one_walk(bake):
    level = level_of(bake("4_garage.xml"))
    assert (abs(level.floor_height[level.free]) < TINY).all()
    inside = within(level, 0.2, 0.2, 7.8, 5.8)  # the walls occupy half of the cells along them
    assert inside.sum() == 76 * 56 and level.free[inside].all()
    assert find_islands(level)[0].max() == 1
    assert joins(level.inflate(0.3), (4, 3), (4, -2), (10, 8))


def test_rack_is_furniture_but_for_its_lowest_shelf(bake):
    result = bake("4b_rack.xml")
    level = level_of(result)
    shelf = within(level, 0, 0, 8.1, 1.1)
    np.testing.assert_array_equal(level.floor_height, np.float32(np.where(shelf, 0.2, 0.0)))
    assert level.free.all() and find_islands(level)[0].max() == 1
    [warning] = tops(result)
    assert "(8.9 m² at 1.70 m)" in warning


def test_tops_of_thick_walls_are_no_floor(bake):
    result = bake("5_thick_walls.xml")
    level = level_of(result)
    floor = within(level, 0, 0, 5, 5) | within(level, 5.8, 0, 10.8, 5) | within(level, 5, 2, 5.8, 3)
    np.testing.assert_array_equal(level.free, floor)
    assert (level.floor_height[floor] == 0).all() and floor.sum() == 2 * 50**2 + 8 * 10
    assert find_islands(level)[0].max() == 1
    [warning] = tops(result)
    assert "(31.0 m² at 2.50 m)" in warning


def test_counter_is_furniture_under_a_sheet_that_faces_up(bake):
    result = bake("10_counter_under_sheet.stl")
    level = level_of(result)
    assert (level.floor_height[level.free] == 0).all()
    assert not level.free[within(level, -1.1, -1.1, 1.1, 1.1)].any()
    assert level.free.sum() == 78**2 - 22**2
    assert find_islands(level)[0].max() == 1


# ---------------------------------------------------------------- levels


@pytest.mark.parametrize(
    ("name", "islands"), [("11_closet_with_beam.xml", 2), ("14_panel_and_barn.xml", 1)]
)
def test_roofs_are_no_levels(bake, name, islands):
    level = level_of(bake(name))
    assert (level.floor_height[level.free] == 0).all()
    blocked = occupied_by_boxes(level, CASES[name].boxes)
    if name.startswith("14"):
        # the post; the panel's lower edge is at 1.48 m, over the agent's head
        x, y = centers(level)
        blocked |= np.hypot(np.maximum(abs(x) - 0.05, 0), np.maximum(abs(y) - 0.05, 0)) < 0.1 - TINY
    np.testing.assert_array_equal(level.free, ~blocked)
    assert find_islands(level)[0].max() == islands


def test_storey_with_a_crack_is_one_floor_and_one_walk(bake):
    ground, storey = bake("12_crack.xml").grid.levels
    # the crack is closed up to its open end at the slabs' edge
    has_floor = ~np.isnan(storey.floor_height)
    assert has_floor.sum() == 50 * 101 and (storey.floor_height[has_floor] == np.float32(3.1)).all()
    assert (storey.free == has_floor).all()
    assert (find_islands(storey)[0][storey.free] == 1).all()
    assert joins(storey, (-4, 0), (4, 0), (0, -2), (0, 2))
    assert ground.free.all() and (ground.floor_height == 0).all()
    assert find_islands(ground)[0].max() == 1


# ---------------------------------------------------------------- ledges, ramps, corners


def test_dock_has_no_free_cell_within_the_radius_of_the_drop(bake):
    level = level_of(bake("6_dock.xml"))
    x, y = centers(level)
    assert level.free.all()
    large = level.inflate(0.4)
    ignoring = level.inflate(0.4, ledges="ignore")
    top = np.isclose(level.floor_height, 1.0, atol=1e-6) & within(level, 1, -2, 5, 2)
    assert top.sum() == 40 * 40
    # seen from above: how far each cell's centre is from the edge, where no ramp leads down
    side = np.minimum(np.minimum(x - 1, 5 - x), 2 - abs(y))
    assert (ignoring.free & top)[side < 0.4].any()
    near_ramp = top & (x < 1.5) & (abs(y) < 1.0)
    np.testing.assert_array_equal((large.free & top)[~near_ramp], (top & (side > 0.4))[~near_ramp])
    # by the rule's words: no square within the radius is more than a step higher or lower
    _no_drop_near(large, 0.4)
    assert joins(large, (-5, 0), (3, 0))
    sides = (abs(y) > 0.2) & (abs(y) < 0.6) & (x > -1.9) & (x < 1)
    assert level.free[sides].all() and not large.free[sides].any()


def _no_drop_near(level: SceneGrid2D, radius: float) -> None:
    cell, reach = level.cell_size, int(radius / level.cell_size) + 1
    floor = level.floor_height
    for row in range(-reach, reach + 1):
        for col in range(-reach, reach + 1):
            gap = np.hypot(max(abs(row) - 0.5, 0), max(abs(col) - 0.5, 0)) * cell
            if gap < radius - 1e-9:
                inner = (slice(reach, -reach),) * 2
                beside = np.roll(floor, (row, col), axis=(0, 1))[inner]
                assert (abs(beside - floor[inner])[level.free[inner]] <= STEP + 1e-6).all()


def test_ramp_is_one_walk(bake):
    level = level_of(bake("7_ramp15.xml"))
    area = level.free.sum() * level.cell_size**2
    assert area == pytest.approx(88.8, rel=0.01)
    assert find_islands(level)[0].max() == 1
    finder = PathFinder(level)
    for y in (-2.9, 0.0, 2.9):
        path = finder.find_path((-5.5, y, 0), (8.5, y, 1.0))
        assert path is not None and path.length == pytest.approx(14, abs=0.03)
    assert joins(level.inflate(0.4), (-5.5, 0), (2, 1))
    # floors as high as geometry says: two level ones, and a line between them
    x, _ = centers(level)
    truth = np.clip((x + 0.0259) * np.tan(np.radians(15)), 0.0, 1.0)
    assert abs(level.floor_height - truth)[level.free].max() < 0.01


def test_straight_path_has_no_three_waypoints_in_a_line(bake):
    level = level_of(bake("15_corner.xml"))
    large = level.inflate(0.3)
    path = PathFinder(large).find_path((-5, -1, 0), (5, -1, 0))
    assert path is not None
    ways = np.diff(path.positions[:, :2], axis=0)
    assert len(ways) == 3  # past two corners
    assert all(abs(a[0] * b[1] - a[1] * b[0]) > 1e-6 for a, b in pairwise(ways))
    # a taut string round discs of 0.3 m about the corners, but for cells' size
    assert path.length == pytest.approx(2 * np.hypot(2, 1) + 6, abs=0.45)
    for start, way in zip(path.positions[:-1, :2], ways, strict=True):
        at = start + np.linspace(0, 1, 500)[:, None] * way
        beside = np.maximum(abs(at) - (3, 2), 0)
        assert np.hypot(*beside.T).min() > 0.3 - 0.05
        assert large.free[large.lattice.rows_cols(at)].all()


# ---------------------------------------------------------------- buildings and rooms


def test_building_in_one_mesh_counts_by_its_triangles(bake):
    result = bake("8_building_hull.xml")
    level = level_of(result)
    assert result.warnings == [
        "mesh geom 'house' counts by its triangles, because its convex hull hides room to stand "
        "in; MuJoCo collides the hull: set `scene.meshes` to surface or hull to say which"
    ]
    assert abs(level.floor_height[level.free]).max() < 1e-6
    inside = within(level, -3.9, -3.9, 3.9, 3.9)
    sofa = within(level, 0.2, 0.6, 1.8, 1.4)
    np.testing.assert_array_equal(level.free, inside & ~sofa)
    assert find_islands(level)[0].max() == 1


@pytest.mark.parametrize("name", ["13_window.xml", "13_window.stl"])
def test_window_joins_no_rooms(bake, name):
    result = bake(name)
    level = level_of(result)
    assert [round(room.area, 4) for room in level.rooms] == [15.6, 15.6]
    assert not any(room.outdoors for room in level.rooms)
    for sign in (-1, 1):
        x, y = centers(level)
        half = (sign * x > 0.1) & (sign * x < 4) & (abs(y) < 2)
        assert len(np.unique(level.room_index[half])) == 1 and level.room_index[half].all()
    assert find_islands(level)[0].max() == 2
    assert PathFinder(level).find_path((-2, 0, 0), (2, 0, 0)) is None
    # what the window parts is told of, and nothing else
    [warning] = result.warnings
    assert "no step leads to 15.6 m² of 'level 0'" in warning


# ---------------------------------------------------------------- scenes 16 to 29

MORE = SHARED.parent / "hard_cases_2"
STEPS = (0.05, 0.08, 0.1)


class Expected(NamedTuple):
    """What has to come out of a scene of `MORE`.

    Attributes:
        grounds: of its levels [m].
        free: from how much to how much is free on all levels [m²].
        rooms, outdoors, doors: how many.
        walks: how many islands there are of 0.2 m² or more; None if that is not said.
        warning: what warnings say, in their order; several are parted by "|".
        steps: sizes of cells [m].
    """

    grounds: tuple[float, ...] = (0.0,)
    free: tuple[float, float] = (0.0, 1e6)
    rooms: int = 1
    outdoors: int = 0
    doors: int = 0
    walks: int | None = 1
    warning: str = ""
    steps: tuple[float, ...] = (0.1,)


NINE_ROOMS = Expected(rooms=9, walks=None, steps=STEPS)
SCENES = {
    "16_stair_fills_its_hole.xml": Expected((0, 2.8), (87, 90), 2, steps=(*STEPS, 0.11)),
    "17_treads_under_slab.xml": Expected((0, 2.8), (101, 102), 2, warning="cells of 'geom"),
    "18_deck_boards.xml": Expected(free=(9, 9)),
    "19_terraces.xml": Expected(
        free=(11.5, 12.1), outdoors=1, warning=r"1\.60 m, and 3 more.*keeps", steps=(*STEPS, 0.13)
    ),
    "20_doorway_0.9.xml": NINE_ROOMS,
    "20b_doorway_1.0.xml": NINE_ROOMS._replace(doors=1),
    "20c_room_split.xml": NINE_ROOMS._replace(doors=3),
    "21_basement_under_plane.xml": Expected(
        (0.1,), warning=r"inside of an endless plane.*50\.8 m² at -2\.70 m under 'ground'; leave"
    ),
    "22_labyrinth.xml": Expected(free=(116, 116), warning="the top of 'w0_0'"),
    "23_oblique_sliding_door.xml": Expected(rooms=2, doors=1, walks=2),
    "24_fixed_pane.xml": Expected(rooms=2, outdoors=1, walks=None),
    "25_house_y_up.glb": Expected(free=(40, 41), rooms=2),
    "26_scan_y_down.ply": Expected((-0.01,), (19, 20), warning="with -y up|a hole of 1.43 m²"),
    "27_plenum.xml": Expected(free=(72, 73), warning=r"the void over 'ceiling' \(73\.0 m²"),
    "28_eaves.obj": Expected(free=(42.7, 42.8), warning="the roof '28_eaves'"),
    "29_hollow_wall.xml": Expected(rooms=2, walks=2),  # one of them inside the wall
}


def bake_more(name: str, cell_size: float = 0.1, **scene) -> BakeResult:
    if not MORE.is_dir():
        pytest.skip(f"no scenes in {MORE}")
    scene = {"path": str(MORE / name), **scene}
    return run_bake(parse_config({"scene": scene, "grid": {"cell_size": cell_size}}))


@pytest.mark.parametrize(
    ("name", "step"), [(name, step) for name, case in SCENES.items() for step in case.steps]
)
def test_what_must_come_out_does(name, step):
    case, result = SCENES[name], bake_more(name, step)
    levels = result.grid.levels
    assert [level.ground for level in levels] == pytest.approx(case.grounds, abs=0.005)
    free = sum(level.free.sum() for level in levels) * step**2
    assert case.free[0] - 1e-6 <= free <= case.free[1] + 1e-6
    rooms = [room for level in levels for room in level.rooms]
    assert len(rooms) == case.rooms
    assert sum(room.outdoors for room in rooms) == case.outdoors
    assert sum(len(level.doors) for level in levels) == case.doors
    if case.walks is not None:
        size = np.bincount(np.concatenate([part.ravel() for part in find_islands(result.grid)]))
        assert np.count_nonzero(size[1:] * step**2 >= 0.2) == case.walks
    wanted = case.warning.split("|") if case.warning else []
    assert len(result.warnings) == len(wanted)
    for text, found in zip(wanted, result.warnings, strict=True):
        assert re.search(text, found)


def test_every_scene_of_the_second_set_is_tested():
    if not MORE.is_dir():
        pytest.skip(f"no scenes in {MORE}")
    assert {path.name for path in MORE.iterdir()} - {"README.md"} == set(SCENES)


def test_a_house_as_gltf_stands_upright():
    level = level_of(bake_more("25_house_y_up.glb"))
    assert level.shape == (60, 80)
    assert (level.floor_height == 0).all()


def test_a_pane_parts_a_room_from_outdoors():
    level = level_of(bake_more("24_fixed_pane.xml"))
    parts = np.unique(find_islands(level)[0][level.free], return_counts=True)[1] * 0.01
    assert sorted(parts[parts > 1]) == pytest.approx([32.0, 35.3], abs=0.5)


@pytest.mark.parametrize("up", ["auto", "-y"])
def test_a_scan_with_y_down_has_its_floor_and_no_holes(up):
    level = level_of(bake_more("26_scan_y_down.ply", up=up, scan=True))
    assert np.nanmax(np.abs(level.floor_height)) < 0.03
    assert level.free.sum() * 0.01 > 20
    assert level.free[level.attributes["unseen"] == 1].all()
    assert 1.0 < level.attributes["unseen"].sum() * 0.01 < 2.0


def test_a_scan_upside_down_is_told_to_have_a_ceiling_for_a_floor():
    warnings = bake_more("26_scan_y_down.ply", up="y").warnings
    assert any("may be a ceiling" in text and "`scene.up: -y`" in text for text in warnings)
