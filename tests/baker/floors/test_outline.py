"""How regions end: edge by edge, on scenes of a few boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navbake.baker.bake.stages import bake_stages
from navbake.baker.core.arrays import HeightRange
from navbake.baker.floors.outline import (
    BARRIER,
    BORDER,
    DROP,
    OPEN,
    WALL,
    RegionContext,
)
from navbake.baker.floors.regions import find_large_regions
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import check_occupancy
from standable import regions_of

GROUND = '<geom type="plane" size="4 4 .1"/>'
# a block of 2 x 2 m, 0.6 m high, on the ground
BLOCK = '<geom type="box" size="1 1 .3" pos="0 0 .3"/>'
EAST, SOUTH, WEST, NORTH = range(4)


def wall(x0: float, x1: float, z0: float, z1: float) -> str:
    """A wall along y, over the block's length."""
    size = f"{(x1 - x0) / 2} 1 {(z1 - z0) / 2}"
    pos = f"{(x0 + x1) / 2} 0 {(z0 + z1) / 2}"
    return f'<geom type="box" size="{size}" pos="{pos}"/>'


@pytest.fixture
def endings_at(tmp_path: Path):
    """Return a function that finds how the region at a height ends in the east, and in the west."""

    def find(geoms: str, z: float) -> tuple[set[int], set[int]]:
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
        config = {"scene": {"path": str(path)}, "grid": {"bounds": [-3, -3, 3, 3]}}
        stages = bake_stages(config)
        agent = stages.config.agent
        tiles = stages.shape_source
        columns = stages.columns
        point = agent.model_copy(update={"radius": 0.0})
        narrow = Footprint.for_agent(point, stages.lattice.cell_size)

        def is_occupied(cells, floors, band: HeightRange | None = None, /):
            volume = narrow if band is None else narrow.with_heights(band)
            return check_occupancy(columns, tiles, volume, cells, floors).occupied

        regions = regions_of(stages)
        settings = stages.config.floors
        is_large = find_large_regions(regions, regions.num_surfaces > 0, settings)
        members = [regions.surfaces_of(region) for region in range(regions.num_regions)]
        at_height = is_large & [np.isclose(surfaces.z, z).any() for surfaces in members]
        context = RegionContext(
            regions=regions,
            is_large=is_large,
            columns=columns,
            is_cropped=np.zeros(4, dtype=np.bool_),
            agent=agent,
            settings=settings,
            is_occupied=is_occupied,
        )
        edges = context.select_edges(at_height, 4)
        ending, landing, floor, _ = context.classify_edges(edges)
        assert ((floor >= 0) == (ending == DROP)).all()
        assert (np.isnan(landing) == (ending != DROP)).all()
        # not the corners: a wall along a side meets their other edge, too
        row = edges.cell // stages.lattice.width
        y = stages.lattice.center_y()[row]
        at = [(edges.direction == direction) & (abs(y) < 0.85) for direction in (EAST, WEST)]
        return set(ending[at[0]].tolist()), set(ending[at[1]].tolist())

    return find


def test_block_drops_all_around(endings_at):
    assert endings_at(GROUND + BLOCK, 0.6) == ({DROP}, {DROP})


def test_floor_ends_at_the_border(endings_at):
    assert endings_at(GROUND, 0.0) == ({BORDER}, {BORDER})


def test_without_ground_the_edge_is_open(endings_at):
    assert endings_at(BLOCK, 0.6) == ({OPEN}, {OPEN})


@pytest.mark.parametrize("top", [2.499, 2.5, 2.501])
@pytest.mark.parametrize(("x0", "x1"), [(1.0, 1.3), (0.96, 0.99), (1.01, 1.04), (0.9, 1.2)])
def test_wall_however_it_ends_at_the_ceiling(endings_at, top, x0, x1):
    """Thin walls lie between the centres of two cells, on this side of the edge or beyond."""
    ceiling = '<geom type="box" size="1.3 1 .1" pos="0 0 2.6"/>'
    assert endings_at(GROUND + BLOCK + wall(x0, x1, 0.6, top) + ceiling, 0.6) == ({WALL}, {DROP})


def test_wall_without_thickness(endings_at):
    region = '<geom type="plane" size="1 1 .1" pos="1.02 0 1.6" euler="0 90 0"/>'
    assert endings_at(GROUND + BLOCK + region, 0.6) == ({WALL}, {DROP})


@pytest.mark.parametrize("height", [0.3, 0.9, 1.1])
def test_what_is_lower_than_an_agent_is_a_barrier(endings_at, height):
    back = wall(1.0, 1.1, 0.0, 0.6 + height)
    assert endings_at(GROUND + BLOCK + back, 0.6) == ({BARRIER}, {DROP})


def test_lintel_is_no_wall(endings_at):
    assert endings_at(GROUND + BLOCK + wall(1.0, 1.1, 1.2, 3.0), 0.6) == ({DROP}, {DROP})


def test_one_looks_over_a_frame(endings_at):
    assert endings_at(GROUND + BLOCK + wall(1.0, 1.2, 0.0, 0.4), 0.6) == ({DROP}, {DROP})
    assert endings_at(GROUND + BLOCK + wall(1.0, 1.8, 0.0, 0.3), 0.6) == ({OPEN}, {DROP})


def test_nobody_drops_to_where_there_is_no_room(endings_at):
    """Fences stand so close beside the block that nobody fits in between."""
    fences = "".join(wall(x, x + 0.01, 0.0, 0.5) for x in (1.02, 1.12, 1.22, 1.32))
    assert endings_at(GROUND + BLOCK + fences, 0.6) == ({OPEN}, {DROP})


@pytest.mark.parametrize("height", [2.0, 1.2])
def test_nobody_drops_through_a_slab_that_only_lacks_headroom(endings_at, height):
    """A slab at 2.9 m over the ground: beyond x = 1, a beam leaves too little headroom."""
    slab = '<geom type="box" size="2.5 1 .1" pos="0 0 2.8"/>'
    beam = f'<geom type="box" size=".75 1 .1" pos="1.75 0 {2.9 + height + 0.1 - 0.3}"/>'
    endings = endings_at(GROUND + slab + beam, 2.9)[0]
    assert (endings == {DROP}) == (height == 2.0)
    if height == 1.2:
        assert endings == {OPEN}


def test_one_does_not_look_past_a_parapet_on_a_frame(endings_at):
    frame = wall(1.0, 1.1, 0.0, 0.4) + wall(1.11, 1.19, 0.0, 1.2)
    assert endings_at(GROUND + BLOCK + frame, 0.6) == ({BARRIER}, {DROP})
