"""Maps without heights and areas: which cells they close, and what is told of what is lost."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from
from map_grids import sample
from navbake.errors import FormatError, QueryError
from navbake.formats import map_losses
from navbake.formats.map_losses import find_stair_cells
from navbake.navgrid.rooms import Room

# the map that each format makes of one level, read again
READERS = {
    "nav2": ("map.yaml", navbake.from_nav2),
    "procthor": ("map.png", navbake.from_procthor),
    "grscenes": ("map.npy", navbake.from_grscenes),
    "omnigibson": ("map.png", navbake.from_omnigibson),
}


def export(grid, folder, kind, **options):
    """The free cells of a grid's level 0 in a map."""
    name, read = READERS[kind]
    paths = grid.convert(folder / name, kind, level=0, **options)
    is_map = {"map.yaml", "map.png", "map.npy", "map_0.png"}
    (path,) = (path for path in paths if path.name in is_map)
    return read(path).free


def with_areas(level, areas, cells):
    """A level with areas; `cells` has the number of each cell's area, 0 for none."""
    metadata = {**level.metadata, "navbake": {"version": "0.4.0", **areas}}
    layer = {"area": np.array(cells, dtype=np.uint8)}
    return level.with_layers(attributes=layer, metadata=metadata)


@pytest.mark.parametrize("kind", READERS)
def test_stairs_are_occupied_unless_they_are_to_be_free(tmp_path, kind):
    """A stair of the issue: 516 cells of the house, up to 2.8 m over the ground, were white."""
    house = sample("house")
    level = house.levels[0]
    stairs = level.free & (level.floor > level.ground + 0.25 + 0.1)
    assert np.count_nonzero(stairs) == 516 and level.floor[stairs].max() > 2.8
    np.testing.assert_array_equal(export(house, tmp_path, kind), level.free & ~stairs)
    (tmp_path / "free").mkdir()
    np.testing.assert_array_equal(export(house, tmp_path / "free", kind, stairs="free"), level.free)


@pytest.mark.parametrize(
    ("text", "stairs"),
    [
        ("....2468", ".....xxx"),  # up: the first tread is within a step, as a kerb is
        ("....2222", "........"),  # a kerb
        ("....112233", "........xx"),  # risers of 0.1 m
        ("....1234", "........"),  # a ramp of 45 degrees
        ("0004.000", "...x...."),  # a platform
        ("4444444.2", ".......x."),  # most of the level is a platform: what lies below is closed
        ("....#444", "........"),  # nothing leads there: a floor of its own
    ],
)
def test_only_what_steps_lead_to_is_a_stair(text, stairs):
    level = level_from(text)
    expected = np.array([[cell == "x" for cell in stairs]])
    np.testing.assert_array_equal(find_stair_cells(level, 0), expected)


def test_a_step_to_a_cell_that_is_not_free_leads_to_no_floor():
    """The floor behind the wall stayed closed: the step took the place of the wall's cells."""
    house = house_from(
        [level_from("....#444"), level_from("........")], links=[((0, 0, 4), (1, 0, 4))]
    )
    assert not find_stair_cells(house, 0).any()


@pytest.mark.parametrize("slope", [0.0, 0.1, 0.5, 0.95])
@pytest.mark.parametrize("cell_size", [0.02, 0.05, 0.1, 0.125, 0.15, 0.2])
def test_a_ramp_and_what_it_leads_to_stay_free(slope, cell_size):
    level = level_from("\n".join(["." * 60] * 3), cell_size=cell_size)
    rise = np.clip(np.arange(60) - 20, 0, 30) * cell_size * slope
    noise = np.random.default_rng(1).normal(0.0, 0.001, (3, 60))
    level.attributes["floorHeight"] = (rise + noise).astype(np.float32)
    assert not find_stair_cells(level, 0).any()


@pytest.mark.parametrize("riser", [0.1, 0.15, 0.2])
@pytest.mark.parametrize("cell_size", [0.02, 0.05, 0.1, 0.15])
def test_a_flight_is_closed_at_any_cell_size(riser, cell_size):
    num_cells = round(6.0 / cell_size)
    x = (np.arange(num_cells) + 0.5) * cell_size
    floor = riser * np.clip(np.floor((x - 3.0) / 0.28) + 1, 0, 8)
    level = level_from("\n".join(["." * num_cells] * 3), cell_size=cell_size)
    level.attributes["floorHeight"] = np.broadcast_to(floor, (3, num_cells)).astype(np.float32)
    closed = find_stair_cells(level, 0)
    np.testing.assert_array_equal(closed[0], floor > 0.25 + 1e-6)


def test_a_ramp_that_is_as_steep_as_a_stair_is_told_from_it_by_its_even_rise():
    """Whatever its direction, and wherever its foot lies in a cell."""
    rng = np.random.default_rng(3)
    for cell_size in (0.12, 0.15, 0.18):
        num_cells = round(8.0 / cell_size)
        level = level_from("\n".join(["." * num_cells] * num_cells), cell_size=cell_size)
        for yaw in (0.0, *rng.uniform(0, np.pi / 2, 4)):
            y, x = np.mgrid[:num_cells, :num_cells] * cell_size
            along = x * np.cos(yaw) + y * np.sin(yaw) - 4.0 + rng.uniform(0, cell_size)
            rise = rng.uniform(0.12, 0.2)
            tread = rng.uniform(0.26, 0.34)
            ramp = np.clip(along, 0, 8 * tread) * rise / tread
            level.attributes["floorHeight"] = ramp.astype(np.float32)
            assert not find_stair_cells(level, 0).any()
            flight = rise * np.clip(np.floor(along / tread) + 1, 0, 8)
            level.attributes["floorHeight"] = flight.astype(np.float32)
            closed = find_stair_cells(level, 0)
            assert closed[flight > 7.5 * rise].all() or closed[flight < 0.5 * rise].all()


def test_ground_is_the_floor_of_the_rooms_unless_outdoors_is_far_larger():
    """The yard of the sample tower was free, and the whole floor above it closed."""
    tower = sample("tower")
    level = tower.levels[0]
    is_outdoors = level.room_index == 1
    closed = find_stair_cells(tower, 0)
    assert not closed[~is_outdoors & (np.abs(level.floor) < 0.25)].any()
    assert closed[is_outdoors & level.free & (level.floor < -0.26)].all()
    for width, ground in ((20, 1.0), (60, 0.0)):
        yard = level_from("." * width + "5" * 10)
        yard.attributes["roomIndex"] = np.array([[1] * width + [2] * 10], dtype=np.uint16)
        rooms = [Room(1, "0:1", None, 0, 1.0, (0.0, 0.0, 0.0), outdoors=True).to_json()]
        hut = yard.with_layers(metadata={**yard.metadata, "navbake": {"rooms": rooms}})
        free = ~find_stair_cells(hut, 0)[0]
        assert free[:width].all() == (ground == 0.0) and free[width:].all() == (ground == 1.0)


def test_what_steps_from_another_level_lead_to_is_closed_and_another_building_is_not():
    levels = [level_from("....#6.#555"), level_from("      .    ", ground=0.8)]
    levels[0].attributes["floorHeight"][0, 6] = 0.7
    steps = [((0, 0, 6), (1, 0, 6))]
    expected = np.array([[cell == "x" for cell in ".....xx...."]])
    np.testing.assert_array_equal(find_stair_cells(house_from(levels, steps), 0), expected)


def test_grids_without_heights_have_no_stairs():
    assert not find_stair_cells(level_from("..4.#", floors=False), 0).any()
    assert not find_stair_cells(level_from("####"), 0).any()
    level = level_from("..4.")
    level.attributes["floorHeight"][0, 2:] = np.nan  # free cells without a floor
    assert not find_stair_cells(level, 0).any()


@pytest.mark.parametrize("kind", READERS)
def test_barred_areas_are_occupied(tmp_path, kind, caplog):
    areas = {
        "areas": [
            {"name": "lab", "cost": "inf"},
            {"name": "dock", "agents": ["truck"]},
            {"name": "carpet", "cost": 2.0},
        ],
        "agents": {"truck": {}, "cart": {"radius": 0.1}},
    }
    level = with_areas(level_from("......\n......\n######"), areas, [[1, 1, 2, 2, 3, 0]] * 3)
    for agent, free in ((None, "  xxxx"), ("truck", "  xxxx"), ("cart", "    xx")):
        folder = tmp_path / str(agent)
        folder.mkdir()
        caplog.clear()
        found = export(level, folder, kind, agent=agent)
        np.testing.assert_array_equal(found[0], [cell == "x" for cell in free])
        (line,) = caplog.messages
        names = "lab, dock: 0.08" if agent == "cart" else "lab: 0.04"
        assert f"barred areas ({names} m² are occupied)" in line
        assert "carpet" in line and "agents (truck, cart)" in line
    with pytest.raises(QueryError, match="no agent 'cat'"):
        export(level, tmp_path, kind, agent="cat")
    with pytest.raises(FormatError, match="expected occupied or free as stairs, got 'maybe'"):
        export(level, tmp_path, kind, stairs="maybe")


@pytest.mark.parametrize("kind", READERS)
def test_closed_cells_are_found_once_for_each_map(tmp_path, kind, monkeypatch):
    levels = []

    def find_and_count(grid, number):
        levels.append(number)
        return find_stair_cells(grid, number)

    monkeypatch.setattr(map_losses, "find_stair_cells", find_and_count)
    export(level_from("....2468"), tmp_path, kind)
    assert levels == [0]


def test_an_inflation_is_not_of_stairs_and_areas_but_they_stay_closed(tmp_path):
    house = sample("house")
    inflated = house.inflate(0.3).levels[0]
    free = export(house, tmp_path, "nav2", radius=0.3)
    np.testing.assert_array_equal(free, inflated.free & ~find_stair_cells(house, 0))
    values = navbake.from_nav2(
        house.to_nav2(tmp_path / "c.yaml", level=0, mode="raw", radius=0.3, inflation=0.5)[1]
    )
    assert (values.occupancy[find_stair_cells(house, 0)] == 1).all()


def test_a_mesh_leaves_barred_areas_out(tmp_path):
    areas = {"areas": [{"name": "lab", "cost": "inf"}]}
    level = with_areas(level_from("....\n....\n...."), areas, [[1, 0, 0, 0]] * 3)
    (path,) = level.convert(tmp_path / "a.obj")
    rows = [line.split() for line in path.read_text().splitlines()]
    x = [float(row[1]) for row in rows if row and row[0] == "v"]
    assert min(x) == pytest.approx(0.1) and max(x) == pytest.approx(0.4)


def test_what_is_lost_is_one_line_and_nothing_lost_is_none(tmp_path, caplog):
    house = sample("house")
    with caplog.at_level(logging.WARNING):
        house.to_nav2(tmp_path / "map.yaml", level=0)
    (line,) = caplog.messages
    assert line == (
        "nav2 has no place for floor heights (-0.05 to 2.81 m), stairs and floors beyond them "
        "(5.16 m² are occupied; --stairs free leaves them free), steps between levels (20), "
        "doors (8, as they stand)"
    )
    caplog.clear()
    house.to_npz(tmp_path / "a.npz")
    house.convert(tmp_path / "a.json")
    level_from("...#").to_nav2(tmp_path / "flat.yaml")
    assert not caplog.messages


DOCK = """
........
.1234567
.......7
.......7
"""


def drops_of(grid, folder, caplog, **options):
    """What is told of the drops on a map of a grid, if it is."""
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        grid.convert(folder / "map.yaml", "nav2", stairs="free", **options)
    phrases = ", ".join(caplog.messages).split("drops between free cells (")
    return phrases[1].split(";")[0] if len(phrases) > 1 else None


def test_free_cells_beside_a_drop_are_told_until_a_radius_closes_them(tmp_path, caplog):
    floor = level_from(DOCK).floor
    pairs = [np.abs(np.diff(floor, axis=axis)) > 0.25 for axis in (0, 1)]
    count = sum(int(np.count_nonzero(pair)) for pair in pairs)
    grid = level_from(DOCK)
    assert drops_of(grid, tmp_path, caplog) == f"{count * 0.1:.2f} m of edges"
    assert drops_of(grid, tmp_path, caplog, radius=0.05) == f"{count * 0.1:.2f} m of edges"
    assert drops_of(grid, tmp_path, caplog, radius=0.06) is None
    costs = {"mode": "raw", "inflation": 0.3}
    assert drops_of(grid, tmp_path, caplog, **costs) == f"{count * 0.1:.2f} m of edges"
    grid.metadata["agentRadius"] = 0.06  # which costs are for
    assert drops_of(grid, tmp_path, caplog, **costs) is None
    assert drops_of(grid.inflate(0.06), tmp_path, caplog) is None
    over = grid.inflate(0.06, ledges="ignore")
    assert drops_of(over, tmp_path, caplog) == f"{count * 0.1:.2f} m of edges"


def test_steep_ramps_and_closed_cells_are_no_drops(tmp_path, caplog):
    cliff = level_from("...999")
    assert drops_of(cliff, tmp_path, caplog) == "0.10 m of edges"
    with caplog.at_level(logging.WARNING):
        caplog.clear()
        cliff.to_nav2(tmp_path / "closed.yaml")  # what lies beyond is occupied
    assert "drops" not in ", ".join(caplog.messages)
    for link in ((0, 2, 0, 3), (0, 3, 0, 2)):
        ramp = house_from([cliff])
        ramp.metadata["navbake"]["links"] = [list(link)]
        assert drops_of(ramp, tmp_path, caplog, level=0) is None
