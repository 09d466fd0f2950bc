"""What a grid claims of itself excuses nothing: floors, inflations, agents; maps of others."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from box_worlds import box, world
from navbake.errors import FormatError, QueryError
from navbake.testing import assert_true
from navbake.verifier import report as kinds
from verified_scenes import copy_of, kinds_at, walls, write


def with_metadata(grid, **more):
    return grid.with_layers(metadata={**grid.metadata, **more})


def blocked(grid):
    """The grid blocked all over by its weights, its occupancy as it was."""
    return grid.with_layers(weights=np.full(grid.shape, np.inf))


def clear_of_all(grid, distance):
    """Cells that are farther from everything than any rounding."""
    return grid.inflate(distance).free


# ---------------------------------------------------------------- blocked by weights alone


NOT_OURS = [0.3, {"radius": 9}, "all", ["x"], [{"mode": "other", "radius": 9}], [None]]
NOT_OURS += [[{"mode": "exact", "radius": r}] for r in (None, True, float("nan"), 1e6)]


@pytest.mark.parametrize("inflation", [None, *NOT_OURS])
def test_cells_that_weights_alone_block_have_to_touch(room, inflation):
    grid, config = room
    wrong = blocked(grid if inflation is None else with_metadata(grid, inflation=inflation))
    report = navbake.verify(wrong, config)
    apart = {found.cell for found in report.of_kind(kinds.BLOCKED_APART)}
    assert {tuple(cell) for cell in np.argwhere(clear_of_all(grid, 0.15)).tolist()} <= apart
    counts = report.levels[0]
    assert counts.blocked_apart == len(apart) > 500
    assert counts.blocked_blocked + counts.blocked_apart == report.checked
    says_so = any("isn't as navbake writes it" in note for note in report.notes)
    assert says_so == (inflation is not None)


@pytest.mark.parametrize("mode", ["exact", "minos"])
def test_an_inflation_excuses_what_is_within_its_radius(room, mode):
    grid, config = room
    inflated = grid.inflate(0.2, mode=mode)
    report = assert_true(inflated, config)
    assert report.radius == (0.2 if mode == "exact" else None)
    assert any("minos" in note for note in report.notes) == (mode == "minos")
    found = navbake.verify(blocked(inflated), config)
    apart = {found.cell for found in found.of_kind(kinds.BLOCKED_APART)}
    assert apart == {tuple(cell) for cell in np.argwhere(clear_of_all(grid, 0.2)).tolist()}


def test_only_what_is_judged_itself_is_a_reason(room):
    """Neither a free cell that is said to be occupied, nor a layer of solid cells, is one."""
    grid, config = room
    inflated = grid.inflate(0.2)
    clear = clear_of_all(grid, 0.5)
    row, col = np.argwhere(clear)[0].tolist()
    wrong = copy_of(inflated)
    wrong.weights[row, col] = np.inf
    wrong.attributes["occupancy"][row, col + 1] = 1
    assert (kinds.BLOCKED_APART, 0, (row, col)) in kinds_at(navbake.verify(wrong, config))
    solid = np.ones(grid.shape, dtype=np.uint8)
    wrong = blocked(inflated).with_layers(attributes={"solid": solid})
    assert (kinds.BLOCKED_APART, 0, (row, col)) in kinds_at(navbake.verify(wrong, config))


def test_an_exact_inflation_measures_from_what_is_solid(tmp_path):
    """An agent's disc reaches beyond squares: what it alone touches closes no cells for others."""
    wall = box("floor", -2, -1, -0.1, 2, 1, 0) + box("wall", -2, -1, 0, -1.9, 1, 2)
    config = {"scene": {"path": str(write(tmp_path, world(wall)))}, "agent": {"radius": 0.3}}
    grid = navbake.bake(config)
    planted = (kinds.BLOCKED_APART, 0, (10, 5))  # its centre is 0.45 m from the wall
    for mode in ("exact", "minos"):
        inflated = grid.inflate(0.35, mode=mode)
        assert_true(inflated, config)
        wrong = copy_of(inflated)
        assert wrong.free[10, 5] == (mode == "exact")
        assert wrong.occupancy[10, 3:5].tolist() == [1, 0]
        wrong.weights[10, 5] = np.inf
        assert kinds_at(navbake.verify(wrong, config)) == ({planted} if mode == "exact" else set())


def test_what_bounds_cut_away_may_touch_a_larger_agent(tmp_path):
    parts = box("floor", -2, -1, -0.1, 2, 1, 0) + box("wall", -2, -1, 0, -1.9, 1, 2)
    config = {"scene": {"path": str(write(tmp_path, world(parts)))}}
    scene = {**config, "grid": {"bounds": [-1.8, -1, 2, 1]}}
    grid = navbake.bake(scene)
    assert not any("bounds" in note for note in assert_true(grid, scene).notes)
    report = navbake.verify(grid, scene, radius=0.3)
    assert {found.geom for found in report.findings} == {"wall"}
    assert any("`grid.bounds` cut the grid" in note for note in report.notes)


def test_the_rim_of_a_single_level_closes_nothing(room):
    grid, config = room
    wrong = copy_of(grid.inflate(0.2))
    row, col = grid.height - 1, int(np.flatnonzero(clear_of_all(grid, 0.3)[-1])[0])
    assert wrong.free[row, col]
    wrong.weights[row, col] = np.inf
    assert kinds_at(navbake.verify(wrong, config)) == {(kinds.BLOCKED_APART, 0, (row, col))}


# ---------------------------------------------------------------- --radius


def test_an_inflated_grid_is_inflated_further(room):
    grid, config = room
    once, twice = (
        assert_true(one, config, radius=0.3) for one in (grid, grid.inflate(0.1).inflate(0.2))
    )
    assert once.levels == twice.levels and twice.radius == 0.3


def test_an_inflation_is_not_undone(room):
    grid, config = room
    with pytest.raises(QueryError, match=r"inflated for 0\.3 m, which can't be undone for 0\.2 m"):
        navbake.verify(grid.inflate(0.3), config, radius=0.2)
    with pytest.raises(QueryError, match="mode minos, whose cells promise nothing"):
        navbake.verify(grid.inflate(0.1, mode="minos"), config, radius=0.2)


@pytest.mark.parametrize("radius", [0.0, 0.02, 0.3])
def test_a_cells_own_square_is_judged_for_any_radius(room, radius):
    """A disc may be smaller than the square, or hang over a floor that leaves it no room."""
    grid, config = room
    wrong = copy_of(grid)
    row, col = np.argwhere(grid.occupancy == 1)[5].tolist()
    wrong.weights[row, col], wrong.attributes["occupancy"][row, col] = 1.0, 0
    wrong = with_metadata(wrong.inflate(radius))
    wrong.weights[row, col] = 1.0
    assert kinds_at(navbake.verify(wrong, config)) == {(kinds.FREE_TOUCHES, 0, (row, col))}


# ---------------------------------------------------------------- floors


def test_a_grid_without_any_floor_has_lost_its_places(room):
    grid, config = room
    none = np.full(grid.shape, np.nan, dtype=np.float32)
    bare = blocked(grid).with_layers(attributes={"floorHeight": none})
    for wrong, scene in ((bare, config), (with_metadata(bare, navbake={}), config)):
        lost = list(navbake.verify(wrong, scene).of_kind(kinds.PLACE_LOST))
        assert [found.geom for found in lost] == ["floor"]
        assert "there is nothing to stand on under it" in lost[0].text and lost[0].size > 8


def test_a_house_without_any_floor_has_lost_its_storeys(house):
    """Its stairs drop to its own floor, which makes it no top of something."""
    grid, config = house
    levels = []
    for level in grid.levels:
        layers = {**level.attributes, "floorHeight": np.full(level.shape, np.nan, np.float32)}
        levels.append(blocked(level).with_layers(attributes=layers))
    (found,) = navbake.verify(grid.with_levels(levels), config).findings
    assert found.kind == kinds.PLACE_LOST and found.size > 15
    assert found.geom in ("ground floor", "upper floor")


def test_one_floor_that_is_left_hides_nothing(room):
    """Not even the first one, a step from which the search begins."""
    grid, config = room
    wrong = blocked(grid)
    floors = np.full(grid.shape, np.nan, dtype=np.float32)
    row, col = np.argwhere(grid.free)[0].tolist()
    floors[row, col], wrong.weights[row, col] = grid.floor_height[row, col], 1.0
    wrong = wrong.with_layers(attributes={"floorHeight": floors})
    lost = list(navbake.verify(wrong, config).of_kind(kinds.PLACE_LOST))
    assert lost and max(found.size for found in lost) > 8


def test_a_top_over_a_floor_is_not_lost(tmp_path):
    """A platform without walls, as large as a floor, to which no steps lead."""
    parts = [box("floor", -4, -4, -0.1, 4, 4, 0), box("platform", -2, -2, 1.5, 2, 2, 1.6)]
    config = {"scene": {"path": str(write(tmp_path, world("".join(parts))))}}
    report = assert_true(navbake.bake(config), config)
    assert any("the top of furniture" in note for note in report.notes)


def test_a_roof_is_not_lost(tmp_path):
    """It drops to nothing, as the grid ends there, but there is a room under it."""
    parts = [box("floor", 0, 0, -0.1, 5, 4, 0), box("roof", -0.1, -0.1, 2.5, 5.1, 4.1, 2.6)]
    parts += [box(f"wall {k}", *sides) for k, sides in enumerate(walls(0.0))]
    config = {"scene": {"path": str(write(tmp_path, world("".join(parts))))}}
    report = assert_true(navbake.bake(config), config)
    assert any("the top of furniture" in note for note in report.notes)


def test_an_underside_is_no_floor(room):
    grid, config = room
    wrong = copy_of(grid)
    row, col = (int(v) for v in grid.lattice.rows_cols([0.85, -0.15]))
    assert not grid.free[row, col]
    for z, is_off in ((0.6, True), (0.7, False)):  # the table's underside, and its top
        wrong.attributes["floorHeight"][row, col] = z
        found = [f.cell for f in navbake.verify(wrong, config).of_kind(kinds.FLOOR_OFF)]
        assert found == ([(row, col)] if is_off else [])


def test_a_floor_inside_of_a_solid_is_named(tmp_path):
    """The top of a box that is sunk in the floor faces up, but one stands on the floor."""
    parts = [box("floor", -2, -2, -0.3, 2, 2, 0), box("sunk", -1, -1, -0.2, 1, 1, -0.1)]
    config = {"scene": {"path": str(write(tmp_path, world("".join(parts))))}}
    grid = navbake.bake(config)
    assert_true(grid, config)
    wrong = copy_of(grid)
    row, col = (int(v) for v in grid.lattice.rows_cols([0.05, 0.05]))
    wrong.attributes["floorHeight"][row, col] = -0.1
    assert kinds_at(navbake.verify(wrong, config)) == {(kinds.PLACE_LOST, 0, (row, col))}


# ---------------------------------------------------------------- other programs' maps


def of_others(grid, **more):
    """The map that another program makes of a room: weights alone."""
    free = grid.free & (np.nan_to_num(grid.floor_height, nan=1.0) == 0)
    sizes = {key: getattr(grid, key) for key in ("width", "height", "cell_size", "min_yup")}
    return navbake.SceneGrid2D(**sizes, weights=np.where(free, 1.0, np.inf), **more)


def test_a_map_of_others_is_judged_over_its_ground(room):
    grid, config = room
    report = assert_true(of_others(grid), config)
    notes = "\n".join(report.notes)
    for text in ("no digest", "no floors of cells", "of another program"):
        assert text in notes
    counts = report.levels[0]
    assert counts.free_free + counts.blocked_blocked == report.checked and counts.floors == 0
    free = of_others(grid).with_layers(weights=np.ones(grid.shape))
    touching = {found.cell for found in navbake.verify(free, config).of_kind(kinds.FREE_TOUCHES)}
    assert touching == {tuple(cell) for cell in np.argwhere(grid.occupancy == 1).tolist()}


def test_blocked_cells_of_others_are_judged(room):
    grid, config = room
    report = navbake.verify(blocked(of_others(grid)), config)
    apart = {found.cell for found in report.of_kind(kinds.BLOCKED_APART)}
    assert {tuple(cell) for cell in np.argwhere(clear_of_all(grid, 0.15)).tolist()} <= apart
    assert report.levels[0].blocked_blocked > 0


def test_others_may_block_what_has_no_floor(tmp_path):
    parts = [box("floor", -2, -2, -0.1, 0, 2, 0), box("far", 3, -2, -0.1, 4, 2, 0)]
    config = {"scene": {"path": str(write(tmp_path, world("".join(parts))))}}
    grid = navbake.bake(config)
    num_bare = int(np.isnan(grid.floor_height).sum())
    assert num_bare > 0
    report = assert_true(of_others(grid), config)
    assert any(note.startswith(f"{num_bare} blocked cells touch nothing") for note in report.notes)


def test_free_cells_of_others_need_a_floor(tmp_path):
    """Within a step of the level's ground; a crack under a cell's centre is no gap."""
    parts = [box("floor", -2, -1, -0.1, 0.04, 1, 0), box("beyond", 0.06, -1, -0.1, 1, 1, 0)]
    parts += [box("cellar", 1, -1, -1.1, 2, 1, -1), box("kerb", -2, -1, 0, -1.5, 1, 0.2)]
    config = {"scene": {"path": str(write(tmp_path, world("".join(parts))))}}
    weights = np.ones((20, 40))
    wrong = navbake.SceneGrid2D(
        width=40, height=20, cell_size=0.1, min_yup=(-2.0, 0.0, -1.0), weights=weights
    )
    report = navbake.verify(wrong, config)
    over_cellar = {(kinds.NO_FLOOR, 0, (row, col)) for row in range(20) for col in range(30, 40)}
    assert kinds_at(report) == over_cellar
    assert "no floor is within 0.25 m of its level's ground" in report.findings[0].text
    assert report.levels[0].free_free == 600


def test_floors_of_others_count_though_they_are_the_ground(room):
    """What a map states is looked at; an inflation for the verification changes nothing of it."""
    grid, config = room
    floors = np.where(grid.free, 0.0, np.nan).astype(np.float32)
    flat = of_others(grid, attributes={"floorHeight": floors})
    num_floors = int(np.count_nonzero(~np.isnan(floors)))
    for radius in (None, 0.1):
        assert navbake.verify(flat, config, radius=radius).levels[0].floors == num_floors


@pytest.mark.parametrize("radius", [0.1, 0.25])
def test_maps_of_others_are_true_for_larger_agents(room, radius):
    """No floors are asked for, be the map inflated before or for it."""
    grid, config = room
    once = assert_true(of_others(grid), config, radius=radius)
    again = assert_true(of_others(grid).inflate(radius), config)
    assert once.levels == again.levels and once.levels[0].floors == 0


# ---------------------------------------------------------------- the agent


@pytest.mark.parametrize(
    ("metadata", "text"),
    [
        ({"agentHeight": 0}, "`agentHeight` is 0, which is no length > 0"),
        ({"agentHeight": "1.14"}, "`agentHeight` is '1.14', which"),
        ({"agentHeight": 10**400}, "`agentHeight` is 10+…, which is no length > 0"),
        ({"agentRadius": -0.05}, r"`agentRadius` is -0\.05, which is no length >= 0"),
        ({"agentRadius": True}, "`agentRadius` is True, which"),
        ({"traversableFloorHeight": float("nan")}, "`traversableFloorHeight` is nan, which"),
        ({"traversableFloorHeight": [0.25]}, r"`traversableFloorHeight` is \[0\.25\], which"),
        ({"traversableFloorHeight": 1.14}, r"the agent of 1\.14 m takes steps of 1\.14 m"),
        ({"navbake": {"maxSlope": 120}}, "`maxSlope` is 120, which is no slope of 0 to 90"),
    ],
)
def test_sizes_that_no_agent_has_are_refused(room, metadata, text):
    grid, config = room
    with pytest.raises(FormatError, match=text) as caught:
        navbake.verify(with_metadata(grid, **metadata), config, force=True)
    assert "\n" not in str(caught.value)


def test_sizes_that_are_not_stated_are_the_formats(room):
    grid, config = room
    bare = with_metadata(grid, agentHeight=None, agentRadius=None, traversableFloorHeight=None)
    assert assert_true(bare, config).levels == assert_true(grid, config).levels
